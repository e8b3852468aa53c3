"""Comparison of lens faces found in a file of solids with the design, each in some of its placements. Lengths
in mm.

Readers of the file, of its text or with OCC, provide points of its lens faces in the frame of their part, and
the placements of the parts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.base.units import millimetres
from clacad.formats.placements import applied
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
        return cls(*(np.concatenate([getattr(one, name) for one in several]) for name in ("place", "outward", "patch", "part")))  # fmt: skip

    def of_part(self, part: int) -> LensPoints:
        """Points of one part, patches numbered from 0."""
        kept = np.flatnonzero(self.part == part)
        chosen = np.isin(self.patch, kept)
        return LensPoints(
            self.place[chosen], self.outward[chosen], np.searchsorted(kept, self.patch[chosen]), self.part[kept]
        )  # fmt: skip


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
