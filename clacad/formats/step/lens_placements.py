"""How lens faces found in a file of solids lie on the design, each in all its placements. Lengths in mm.

Whoever read the file, from its text or with OCC, gives points of its lens faces in the frame of their part,
and where the parts stand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Ints
from clacad.base.units import millimetres
from clacad.formats.step.placements import applied, by_turn, inverse, product
from clacad.sheet.window import WALL, Window, lens_height_and_normal

SAMPLE = 20_000
"""Patches, in their placements, whose points are held against the design; the place of every instance is checked."""

NEAR = 1e-5
"""Pitches within which a lens stands on its cell as far as telling where the whole part lies goes."""


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
        """Points of groups whose patches are numbered on."""
        return cls(*(np.concatenate([getattr(one, name) for one in several]) for name in ("place", "outward", "patch", "part")))  # fmt: skip

    def of_part(self, part: int) -> LensPoints:
        """Those of one part, patches numbered from 0."""
        kept = np.flatnonzero(self.part == part)
        chosen = np.isin(self.patch, kept)
        return LensPoints(
            self.place[chosen], self.outward[chosen], np.searchsorted(kept, self.patch[chosen]), self.part[kept]
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Measured:
    """Patches held against the design, each in s placements.

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
    """How far points lie from the lens faces of a window.

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


def lens_facts(window: Window, lenses: LensPoints, parts: Sequence[Floats]) -> dict[str, Any]:
    """Hold every lens of a file against the design, in all placements of its part.

    Parameters
    ----------
    window : Window
    lenses : LensPoints
    parts : sequence of (k, 3, 4)
        Placements of every part.

    Returns
    -------
    dict
        patches, patch_error (mm), patch_slope_error (rad); placement: instances, lattice_error (mm, largest distance of
        an instance of a repeated part from its cell), lattice_cell, lattice_body (where), moved (instances farther than 1e-7
        of the pitch), missing and doubled ((cell, body) without a lens, and with several), missing_cell, doubled_cell,
        standing (share of the lenses asked for that stand right to 1e-5 of the pitch).
    """
    board = _Board(window)
    patches, error, slope = 0, 0.0, 0.0
    for number, placements in enumerate(parts):
        mine = lenses.of_part(number)
        if not len(mine.part) or not len(placements):
            continue
        chosen = _sampled(placements, len(mine.part))
        seen = measured(window, mine, placements[chosen])
        real = np.asarray((seen.face >= 0).any(axis=0), dtype=np.bool_)
        if not real.any():
            continue
        patches += int(real.sum())
        error = max(error, float(seen.error[:, real].max()))
        slope = max(slope, float(seen.slope[:, real].max()))
        board.take(seen, placements, chosen, real)
    if not patches:
        return {"patches": 0, "patch_error": None, "patch_slope_error": None, "placement": None}
    return {"patches": patches, "patch_error": error, "patch_slope_error": slope, "placement": board.facts()}


def measured(window: Window, lenses: LensPoints, placements: Floats) -> Measured:
    """Hold the patches of one part against the design, in the placements (s, 3, 4)."""
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


def _sampled(placements: Floats, patches: int) -> Ints:
    """Which placements are held against the design point by point: all, or some and one of every turn."""
    many = max(1, SAMPLE // patches)
    if len(placements) <= many:
        return np.arange(len(placements))
    turns = np.array([rows[0] for rows in by_turn(placements)])
    even = np.linspace(0, len(placements) - 1, many).astype(np.int64)
    return np.unique(np.concatenate([even, turns[:many]]))


class _Board:
    """Which cell holds which lens how often, and how far from it the farthest instance stands."""

    def __init__(self, window: Window) -> None:
        self._window = window
        self._scale = millimetres(window.unit)
        self._cells = window.lattice.cells()
        self._low = self._cells.min(axis=0)
        self._table = np.full(tuple(np.ptp(self._cells, axis=0) + 1), -1, dtype=np.int64)
        self._table[tuple((self._cells - self._low).T)] = np.arange(len(self._cells))
        shape = (len(window.faces), len(self._cells))
        self._held = np.zeros(shape, dtype=np.int64)
        self._repeated = np.zeros(shape, dtype=bool)
        self._right = np.zeros(shape, dtype=bool)
        self._near = NEAR * min(window.lattice.pitch) * self._scale
        self._instances, self._moved, self._worst = 0, 0, (0.0, -1, (0, 0))

    def take(self, seen: Measured, placements: Floats, chosen: Ints, real: NDArray[np.bool_]) -> None:
        """Count the lenses of one part in all its placements."""
        judged = np.where(real, seen.error, 0.0)
        best = int(np.argmin(judged.max(axis=1)))
        lenses: dict[tuple[int, int, int], float] = {}
        for patch in np.flatnonzero(real & (seen.face[best] >= 0)):
            i, j = seen.cell[best, patch].tolist()
            key = (int(seen.face[best, patch]), i, j)
            lenses[key] = max(lenses.get(key, 0.0), float(seen.error[best, patch]))
        if len(placements) == 1:
            for (face, *cell), error in lenses.items():
                self._count(face, np.array([cell]), np.array([error]), repeated=False)
            return
        self._instances += len(placements)
        moves = product(placements, inverse(placements[chosen[best]]))
        stand: dict[tuple[int, int, int], tuple[Ints, Floats]] = {}
        for (face, *cell), error in lenses.items():
            array = self._window.faces[face].array
            assert array is not None
            key = (array, cell[0], cell[1])
            if key not in stand:  # both faces of a lens stand alike
                stand[key] = self._moved_cell(array, np.array(cell), moves)
            self._instanced(face, error, *stand[key])

    def _moved_cell(self, array: int, cell: Ints, moves: Floats) -> tuple[Ints, Floats]:
        """Cells (k, 2) of an array where moves (k, 3, 4) take one, and how far from their centres it then is (k,) mm."""
        window = self._window
        at = np.append(window.centres(array, cell), 0.0) * self._scale
        place = applied(moves, at[None])[:, 0] / self._scale
        index, x, y = window.locate(array, place[:, 0], place[:, 1])
        return index, np.sqrt(x * x + y * y + place[:, 2] ** 2) * self._scale

    def _instanced(self, face: int, error: float, index: Ints, away: Floats) -> None:
        """One lens of a part, moved from where it fits best to all its places, cells (k, 2), `away` (k,) mm from them."""
        self._count(face, index, np.maximum(away, error), repeated=True)
        self._moved += int((away > 1e-7 * min(self._window.lattice.pitch) * self._scale).sum())
        worst = int(np.argmax(away))
        if away[worst] > self._worst[0]:
            self._worst = (float(away[worst]), face, (int(index[worst, 0]), int(index[worst, 1])))

    def _count(self, face: int, cells: Ints, away: Floats, repeated: bool) -> None:
        at = cells - self._low
        inside = ((at >= 0) & (at < self._table.shape)).all(axis=1)
        number = self._table[tuple(at[inside].T)]
        kept = number >= 0
        number, away = number[kept], away[inside][kept]
        np.add.at(self._held[face], number, 1)
        self._repeated[face, number] |= repeated
        self._right[face, number[away <= self._near]] = True

    def facts(self) -> dict[str, Any]:
        window = self._window
        names = [body.name for body in window.bodies for _ in range(2)]
        lens = np.array([face.array is not None for face in window.faces])
        held = {name for name, row in zip(names, self._held, strict=True) if row.any()}
        asked = lens & np.array([name in held for name in names])
        missing = (self._held == 0) & asked[:, None]
        doubled = (self._held > 1) & self._repeated
        worst, face, cell = self._worst
        return {
            "instances": self._instances, "lattice_error": worst, "lattice_cell": list(cell),
            "lattice_body": names[face] if face >= 0 else "", "moved": self._moved,
            "missing": int(missing.sum()), "doubled": int(doubled.sum()), "lenses": int(asked.sum()) * len(self._cells),
            "missing_cell": self._first(missing, names), "doubled_cell": self._first(doubled, names),
            "bodies": [body.name for body in window.bodies if body.name in held],
            "standing": float(self._right[lens].mean()) if lens.any() else 0.0,
            "standing_held": float(self._right[asked].mean()) if asked.any() else 0.0,
        }  # fmt: skip

    def _first(self, where: NDArray[np.bool_], names: list[str]) -> list[Any] | None:
        found = np.argwhere(where)
        if not len(found):
            return None
        face, number = found[0]
        return [names[face], *map(int, self._cells[number])]
