"""Comparison of lens faces found in a file of solids with the design, each in some of its placements. Lengths
in mm.

Readers of the file, of its text or with OCC, provide points of its lens faces in the frame of their part, and
the placements of the parts.

One sheet of several in a file: which parts of an assembly belong to it, in its own frame. Lengths in mm.

A file of sheets behind one another is cut at planes between them. A part belongs to the sheet between whose
planes the middle of its height lies, so every part belongs to exactly one sheet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from clacad.base.types import Bools, Floats, Ints
from clacad.base.units import millimetres
from clacad.formats.placements import Placements, applied, turns
from clacad.formats.step.shape_parts import ShapePart, box, moved
from clacad.sheet.window import WALL, Window, lens_height_and_normal


@dataclass(frozen=True, eq=False)
class LensPoints:
    """Points of curved faces.

    place : (n, 3), mm, in the frame of the part
    outward : (n, 3), unit
    patch : (n,)
        The face each point belongs to, ascending.
    part : (patches,)
        The part each face belongs to.
    """

    place: Floats
    outward: Floats
    patch: Ints
    part: Ints

    @classmethod
    def none(cls) -> LensPoints:
        """No points."""
        nobody = np.empty(0, dtype=np.int64)
        return cls(np.empty((0, 3)), np.empty((0, 3)), nobody, nobody)

    @classmethod
    def joined(cls, several: Sequence[LensPoints]) -> LensPoints:
        """Points of groups, with patches numbered consecutively."""
        return cls(
            *(
                np.concatenate([getattr(one, name) for one in several])
                for name in ("place", "outward", "patch", "part")
            )
        )

    def of_part(self, part: int) -> LensPoints:
        """Points of one part, patches numbered from 0."""
        kept = np.flatnonzero(self.part == part)
        chosen = np.isin(self.patch, kept)
        return LensPoints(
            self.place[chosen],
            self.outward[chosen],
            np.searchsorted(kept, self.patch[chosen]),
            self.part[kept],
        )


@dataclass(frozen=True, eq=False)
class Measured:
    """Patches compared with the design, each in s placements.

    error, slope : (s, p)
        Largest distance (mm) and angle (rad) of a patch's points to the lens face it is nearest to.
    face : (s, p)
        Number of that face in `Window.faces`; −1 for a wall.
    cell : (s, p, 2)
        The cell it lies over, in the grid of that face's array.
    """

    error: Floats
    slope: Floats
    face: Ints
    cell: Ints


def on_lenses(window: Window, place: Floats, outward: Floats) -> tuple[Floats, Floats, Ints]:
    """Distances of points from the lens faces of a window.

    Parameters
    ----------
    window : Window
    place : (n, 3), mm, sheet frame
    outward : (n, 3), unit

    Returns
    -------
    distance : (n,), mm
        Along the normal, to the nearest lens face of that side; infinite where there is none.
    angle : (n,), rad
        Between the normals.
    face : (n,)
        Number of that lens face in `Window.faces`, −1 where there is none.
    """
    scale = millimetres(window.unit)
    best, angle = np.full(len(place), np.inf), np.full(len(place), np.inf)
    which = np.full(len(place), -1, dtype=np.int64)
    for number, face in enumerate(window.faces):
        if face.array is None:
            continue
        chosen = np.flatnonzero((outward[:, 2] < 0.0) == (face.side > 0))
        at = place[chosen] / scale
        index, x, y = window.locate(face.array, at[:, 0], at[:, 1])
        places = window.lenses(face, index)
        z, expected = lens_height_and_normal(face, *places.seen(x, y))
        away = np.abs((at[:, 2] - places.raised(z)) * expected[:, 2]) * scale
        turned = np.linalg.norm(np.cross(expected, outward[chosen]), axis=1)
        with np.errstate(invalid="ignore"):
            closer = away < best[chosen]
        rows = chosen[closer]
        best[rows], angle[rows], which[rows] = away[closer], turned[closer], number
    return best, angle, which


def measured(window: Window, lenses: LensPoints, placements: Floats) -> Measured:
    """Compare the patches of one part with the design, in the placements (s, 3, 4)."""
    many, patches = len(placements), len(lenses.part)
    place = applied(placements, lenses.place[None])
    outward = lenses.outward[None] @ np.swapaxes(placements[:, :, :3], 1, 2)
    outward = outward / np.linalg.norm(outward, axis=2, keepdims=True)
    away, angle, face = on_lenses(window, place.reshape(-1, 3), outward.reshape(-1, 3))
    first = np.searchsorted(lenses.patch, np.arange(patches))
    upright = _worst(np.abs(outward[..., 2]), lenses.patch, patches)
    face = np.where(upright > WALL, face.reshape(many, -1)[:, first], -1)
    counts = np.bincount(lenses.patch, minlength=patches)
    middle = np.stack([np.add.reduceat(place[..., k], first, axis=1) for k in (0, 1)], axis=-1)
    middle /= counts[:, None] * millimetres(window.unit)
    cell = np.zeros((many, patches, 2), dtype=np.int64)
    for number, one in enumerate(window.faces):
        if one.array is not None:
            chosen = face == number
            cell[chosen] = window.locate(one.array, *middle[chosen].T)[0]
    error, slope = (_worst(one.reshape(many, -1), lenses.patch, patches) for one in (away, angle))
    return Measured(error, slope, face, cell)


def _worst(values: Floats, patch: Ints, patches: int) -> Floats:
    """Largest value (s, patches) of the points (s, n) of every patch."""
    return np.asarray(np.maximum.reduceat(values, np.searchsorted(patch, np.arange(patches)), axis=1))


@dataclass(frozen=True, slots=True)
class SheetPlace:
    """Position of a sheet in a file.

    Parameters
    ----------
    low, high : float, mm
        Planes between which it lies; infinite at the ends of the file.
    z : float, mm
        Height of the sheet's own z = 0.
    """

    low: float
    high: float
    z: float

    def holds(self, middle: Floats) -> Bools:
        """Which heights (n,) lie between the planes."""
        return np.asarray((middle >= self.low) & (middle < self.high))

    def own(self, placements: Floats) -> Floats:
        """Placements (k, 3, 4) of the file in the sheet's frame."""
        return np.asarray(placements - np.array([[0.0] * 4, [0.0] * 4, [0.0, 0.0, 0.0, self.z]]))

    def of_pieces(self, several: Sequence[ShapePart]) -> list[ShapePart]:
        """The pieces of a file that belong to the sheet, each with the placements that do."""
        found = []
        for piece in several:
            own = self._of_piece(piece)
            if len(own):
                found.append(replace(piece, placements=own))
        return found

    def _of_piece(self, piece: ShapePart) -> Placements:
        """Placements of a piece that belong to the sheet, in its frame."""
        placements = piece.placements
        if _rows_level(placements):
            return self._of_rows(placements, float(np.array(box(piece.shape))[:, 2].mean()))
        kept = [np.empty((0, 3, 4))]
        for turn, moves in turns(placements.all()):
            corners = np.array(box(moved(piece.shape, turn)))
            inside = self.holds(corners[:, 2].mean() + moves[:, 2])
            placed = np.repeat(turn[None], int(inside.sum()), axis=0)
            placed[:, :, 3] = moves[inside]
            kept.append(placed)
        return Placements(self.own(np.concatenate(kept)))

    def of_parts(self, lenses: LensPoints, parts: Sequence[Placements]) -> list[Placements]:
        """Placements of each part that belong to the sheet, decided by the part's lenses."""
        found = []
        for number, placements in enumerate(parts):
            place = lenses.of_part(number).place
            if not len(place):
                found.append(Placements(np.empty((0, 3, 4))))
            elif _rows_level(placements):
                found.append(self._of_rows(placements, float(place.mean(axis=0)[2])))
            else:
                every = placements.all()
                middle = applied(every, place.mean(axis=0)[None, None])[:, 0, 2]
                found.append(Placements(self.own(every[self.holds(middle)])))
        return found

    def _of_rows(self, placements: Placements, middle: float) -> Placements:
        """Placements of a part in rows of the sheet, its middle at that height (mm) in its own frame."""
        inside = self.holds(middle + placements.outer[:, 2, 3])
        return replace(placements, outer=self.own(placements.outer[inside]))


def _rows_level(placements: Placements) -> bool:
    """Whether parts only move, those of one row not in height."""
    return placements.unturned and not placements.inner[:, 2, 3].any()
