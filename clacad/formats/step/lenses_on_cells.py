"""Whether every cell of the design has each of its lenses once, and the deviation of a file's lenses from
their cells.

A part in rows is compared as rows. Where its copies fill the lattice, each cell once, one of its rows and one
copy of every row decide. Copies in other orders are checked one by one. Lengths in mm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Ints
from clacad.base.units import millimetres
from clacad.formats.placements import UNPLACED, Placements, applied, by_turn, fill, inverse, product
from clacad.formats.step.lens_placements import LensErrors, LensPoints, measured
from clacad.sheet.window import Window

SAMPLE = 20_000
"""Patches, in their placements, with points compared with the design; every instance's position is."""

NEAR = 1e-5
"""Pitches within which a lens counts as on its cell when the pose of the whole part is found."""

MOVED = 1e-7
"""Pitches from its cell beyond which a lens is reported as off the lattice."""

LOST = 128.0 * 2.0**-52
"""Relative to the farthest coordinates: more than the rounding of five positions, of eight each."""

TURNS = 8
"""Copies of a part, turned, up to which every lens of each is compared with the design by its points."""

Cell = tuple[int, int]


def lens_facts(window: Window, lenses: LensPoints, parts: Sequence[Placements]) -> dict[str, Any]:
    """Compare every lens of a file with the design, in all placements of its part.

    parts : Of every part.
    Returns: patches, patch_error (mm), patch_slope_error (rad); placement: instances, lattice_error (mm,
        largest distance of an instance of a repeated part from its cell; for copies in rows the worst row
        plus the worst within a row, which no copy exceeds except by rounding), lattice_cell, lattice_body
        (where), moved (instances farther than 1e-7 of the pitch), missing and doubled ((cell, body) without a
        lens, and with several), missing_cell, doubled_cell, `standing` (share of the requested lenses that
        are within 1e-5 of the pitch); owners: by the number of a part, the body whose lenses it has.
    Raises UnreadableFile: There are too many copies to check one by one, and they do not fill the lattice.
    """
    board = _Board(window)
    patches, error, slope, owners = 0, 0.0, 0.0, dict[int, str]()
    once = np.array([len(placements) == 1 for placements in parts], dtype=np.bool_)
    groups = [(number, parts[number], lenses.of_part(number)) for number in np.flatnonzero(~once).tolist()]
    if once.any():  # a part that is not repeated is compared where it is placed
        first = np.array([p.one(0) if one else UNPLACED for p, one in zip(parts, once, strict=True)])
        groups.append((-1, Placements(UNPLACED[None]), lenses.of_parts(once).placed(first)))
    for number, placements, mine in groups:
        if not len(mine.part) or not len(placements):
            continue
        few = len(placements) <= TURNS and not placements.unturned
        chosen = np.arange(len(placements)) if few else _sampled(placements, len(mine.part))
        seen = measured(window, mine, placements.at(chosen))
        real = np.asarray((seen.face >= 0).any(axis=0), dtype=np.bool_)
        if not real.any():
            continue
        patches += int(real.sum())
        error = max(error, float(seen.error[:, real].max()))
        slope = max(slope, float(seen.slope[:, real].max()))
        if number < 0:
            board.take_once(seen, mine.part, real)
        elif few:
            board.take_turned(seen, placements, mine.part, real)
        else:
            board.take(seen, placements, chosen, real)
        owners |= _owners(window, seen.face[:, real].max(axis=0) // 2, mine.part[real])
    if not patches:
        return {"patches": 0, "patch_error": None, "patch_slope_error": None, "placement": None, "owners": {}}
    return {
        "patches": patches,
        "patch_error": error,
        "patch_slope_error": slope,
        "placement": board.facts(),
        "owners": owners,
    }


def _owners(window: Window, body: Ints, part: Ints) -> dict[int, str]:
    """Name of the body that most patches of each part lie on: body (n,) and part (n,) of every patch."""
    numbers, row = np.unique(part, return_inverse=True)
    times = np.zeros((len(numbers), len(window.bodies)), dtype=np.int64)
    np.add.at(times, (row, body), 1)
    most = times.argmax(axis=1).tolist()
    return {number: window.bodies[one].name for number, one in zip(numbers.tolist(), most, strict=True)}


def _sampled(placements: Placements, patches: int) -> Ints:
    """Placements that are compared with the design point by point: all, or some and one of every rotation."""
    many = max(1, SAMPLE // patches)
    if len(placements) <= many:
        return np.arange(len(placements))
    turns = [0] if placements.unturned else [int(rows[0]) for rows in by_turn(placements.all())]
    even = np.linspace(0, len(placements) - 1, many).astype(np.int64)
    return np.unique(np.concatenate([even, turns[:many]]))


@dataclass(frozen=True, eq=False)
class _Copies:
    """One lens of a part in all placements of the part.

    number : Index of the placement at which its cell was found.
    array : Array whose grid it lies on.
    cell : (i, j)
    """

    window: Window
    placements: Placements
    number: int
    array: int
    cell: Cell

    def off(self, placements: Floats) -> tuple[Ints, Floats]:
        """Cells (k, 2) of the lens in placements (k, 3, 4), and its deviation from their centres (k, 3),
        design units.
        """
        window, scale = self.window, millimetres(self.window.unit)
        moves = product(placements, inverse(self.placements.one(self.number)))
        at = np.append(window.centres(self.array, np.array(self.cell)), 0.0) * scale
        place = applied(moves, at[None])[:, 0] / scale
        index, x, y = window.locate(self.array, place[:, 0], place[:, 1])
        return index, np.stack([x, y, place[:, 2]], axis=-1)

    @cached_property
    def each(self) -> tuple[Ints, Floats]:
        """Cells (k, 2) of all copies, and their distances from the centres (k,), mm.

        Raises UnreadableFile: There are too many.
        """
        index, off = self.off(self.placements.all())
        return index, _lengths(off) * millimetres(self.window.unit)

    @cached_property
    def filling(self) -> tuple[float, Cell] | None:
        """Largest deviation, mm, and its cell, where the copies fill the lattice, each cell once and within
        `MOVED`.

        None where rows do not decide. The deviation of a copy is that of its row plus that of its position in
        the row.
        """
        lattice, outer, inner = self.window.lattice, self.placements.outer, self.placements.inner
        if not self.placements.in_rows or (len(inner), len(outer)) != lattice.count:
            return None
        row, column = divmod(self.number, len(inner))
        down, down_off = self.off(self.placements.at(np.arange(len(outer)) * len(inner) + column))
        along, along_off = self.off(self.placements.at(row * len(inner) + np.arange(len(inner))))
        if not fill(lattice, down, along - np.array(self.cell)):
            return None
        scale = millimetres(self.window.unit)
        away = _lengths(down_off) * scale, _lengths(along_off - along_off[column]) * scale
        worst = float(away[0].max() + away[1].max())
        reach = sum(float(np.abs(moves[..., 3]).max()) for moves in (outer, inner))
        reach += max(map(abs, self._extent())) * scale
        if not worst + LOST * reach <= MOVED * min(lattice.pitch) * scale:
            return None
        i, j = down[int(np.argmax(away[0]))] + along[int(np.argmax(away[1]))] - np.array(self.cell)
        return worst, (int(i), int(j))

    def _extent(self) -> tuple[float, ...]:
        return self.window.placements[self.array].extent(self.window.lattice)


def _lengths(off: Floats) -> Floats:
    x, y, z = off.T
    return np.asarray(np.sqrt(x * x + y * y + z**2))


@dataclass(frozen=True, eq=False)
class _Held:
    """Content of the cells of the lattice for one lens: (cells,) each.

    times : number of lenses
    repeated : whether from a part with several placements
    right : whether one lies within `NEAR`
    """

    times: Ints
    repeated: NDArray[np.bool_]
    right: NDArray[np.bool_]


class _Board:
    """Count of each lens in each cell, and the distance of the farthest instance."""

    def __init__(self, window: Window) -> None:
        self._window = window
        self._scale = millimetres(window.unit)
        self._near = NEAR * min(window.lattice.pitch) * self._scale
        self._filled: dict[
            int, list[bool]
        ] = {}  # by face: for every part that fills the lattice, whether right
        self._held: dict[int, _Held] = {}
        self._instances, self._moved, self._worst = 0, 0, (0.0, -1, (0, 0))

    @cached_property
    def _cells(self) -> Ints:
        return self._window.lattice.cells()

    @cached_property
    def _low(self) -> Ints:
        return np.asarray(self._cells.min(axis=0))

    @cached_property
    def _table(self) -> Ints:
        """Number of the cell at every index from the lowest on, −1 for none."""
        table = np.full(tuple(np.ptp(self._cells, axis=0) + 1), -1, dtype=np.int64)
        table[tuple((self._cells - self._low).T)] = np.arange(len(self._cells))
        return table

    def take_turned(
        self, seen: LensErrors, placements: Placements, part: Ints, real: NDArray[np.bool_]
    ) -> None:
        """Count the lenses of one part with few placements, each as it is; the part (p,) of every patch."""
        for copy in range(len(placements)):
            one = LensErrors(*(array[copy : copy + 1] for array in vars(seen).values()))
            self.take_once(one, part, real, repeated=True)
        self._instances += len(placements)
        best = int(np.argmin(np.where(real, seen.error, 0.0).max(axis=1)))
        rows = np.flatnonzero(real & (seen.face[best] >= 0))
        apart, moved = seen.cell[best, rows] - seen.cell[best, rows[0]], np.zeros(len(placements))
        for row in (rows[0], rows[int(np.argmax((apart**2).sum(axis=1)))]):
            face, (i, j) = int(seen.face[best, row]), seen.cell[best, row].tolist()
            array = self._window.faces[face].array
            assert array is not None
            index, away = _Copies(self._window, placements, best, array, (i, j)).each
            moved, worst = np.maximum(moved, away), int(np.argmax(away))
            self._farthest(face, float(away[worst]), (int(index[worst, 0]), int(index[worst, 1])))
        self._moved += int((moved > MOVED * min(self._window.lattice.pitch) * self._scale).sum())

    def take_once(
        self, seen: LensErrors, part: Ints, real: NDArray[np.bool_], repeated: bool = False
    ) -> None:
        """Count the lenses of parts that have one placement each; the part (p,) of every patch."""
        rows = np.flatnonzero(real & (seen.face[0] >= 0))
        keys = np.column_stack([part[rows], seen.face[0, rows], seen.cell[0, rows]])
        order = np.lexsort(keys.T[::-1])
        keys, error = keys[order], seen.error[0, rows][order]
        starts = np.flatnonzero(np.concatenate([[True], (keys[1:] != keys[:-1]).any(axis=1)]))
        away = np.maximum.reduceat(error, starts)
        for face in np.unique(keys[:, 1]).tolist():
            mine = keys[starts, 1] == face
            self._count(face, keys[starts][mine, 2:], away[mine], repeated)

    def take(self, seen: LensErrors, placements: Placements, chosen: Ints, real: NDArray[np.bool_]) -> None:
        """Count the lenses of one repeated part in all its placements."""
        judged = np.where(real, seen.error, 0.0)
        best = int(np.argmin(judged.max(axis=1)))
        lenses: dict[tuple[int, int, int], float] = {}
        for patch in np.flatnonzero(real & (seen.face[best] >= 0)):
            i, j = seen.cell[best, patch].tolist()
            key = (int(seen.face[best, patch]), i, j)
            lenses[key] = max(lenses.get(key, 0.0), float(seen.error[best, patch]))
        self._instances += len(placements)
        stand: dict[tuple[int, int, int], _Copies] = {}
        for (face, i, j), error in lenses.items():
            array = self._window.faces[face].array
            assert array is not None
            found = _Copies(self._window, placements, int(chosen[best]), array, (i, j))
            copies = stand.setdefault((array, i, j), found)  # both faces of a lens are at the same position
            if copies.filling is not None:
                self._filled.setdefault(face, []).append(error <= self._near)
                self._farthest(face, *copies.filling)
            else:
                self._instanced(face, error, *copies.each)

    def _instanced(self, face: int, error: float, index: Ints, away: Floats) -> None:
        """One lens of a part, moved from its best fit to all placements: cells (k, 2), offsets (k,) mm."""
        self._count(face, index, np.maximum(away, error), repeated=True)
        self._moved += int((away > MOVED * min(self._window.lattice.pitch) * self._scale).sum())
        worst = int(np.argmax(away))
        self._farthest(face, float(away[worst]), (int(index[worst, 0]), int(index[worst, 1])))

    def _farthest(self, face: int, away: float, cell: Cell) -> None:
        if away > self._worst[0]:
            self._worst = (away, face, cell)

    def _count(self, face: int, cells: Ints, away: Floats, repeated: bool) -> None:
        at = cells - self._low
        inside = ((at >= 0) & (at < self._table.shape)).all(axis=1)
        number = self._table[tuple(at[inside].T)]
        kept = number >= 0
        number, away = number[kept], away[inside][kept]
        if face not in self._held:
            self._held[face] = self._nothing()
        held = self._held[face]
        np.add.at(held.times, number, 1)
        held.repeated[number] |= repeated
        held.right[number[away <= self._near]] = True

    def _nothing(self) -> _Held:
        many = len(self._cells)
        return _Held(
            np.zeros(many, dtype=np.int64), np.zeros(many, dtype=np.bool_), np.zeros(many, dtype=np.bool_)
        )

    def _whole(self, face: int) -> _Held | None:
        """Content of all cells for a lens; None unless one part alone fills the lattice with it."""
        filled, held = self._filled.get(face, []), self._held.get(face)
        if held is None and len(filled) == 1:
            return None
        one = self._nothing() if held is None else held
        return _Held(one.times + len(filled), one.repeated | bool(filled), one.right | any(filled))

    def facts(self) -> dict[str, Any]:
        """Report on the placement."""
        window, cells = self._window, self._window.lattice.cell_count
        names = [body.name for body in window.bodies for _ in range(2)]
        lens = [number for number, face in enumerate(window.faces) if face.array is not None]
        counted = {
            face
            for face in lens
            if face in self._filled or (face in self._held and self._held[face].times.any())
        }
        held = {names[face] for face in counted}
        asked = [face for face in lens if names[face] in held]
        right = dict.fromkeys(lens, 0)
        missing, doubled = _Tally(), _Tally()
        for face in asked:
            whole = self._whole(face)
            if whole is None:
                right[face] = cells * self._filled[face][0]
                continue
            right[face] = int(whole.right.sum())
            missing = missing.with_those(names[face], whole.times == 0, self._cells)
            doubled = doubled.with_those(names[face], (whole.times > 1) & whole.repeated, self._cells)
        worst, face, cell = self._worst
        return {
            "instances": self._instances,
            "lattice_error": worst,
            "lattice_cell": list(cell),
            "lattice_body": names[face] if face >= 0 else "",
            "moved": self._moved,
            "missing": missing.count,
            "doubled": doubled.count,
            "lenses": len(asked) * cells,
            "missing_cell": missing.first,
            "doubled_cell": doubled.first,
            "bodies": [body.name for body in window.bodies if body.name in held],
            "standing": _share(sum(right.values()), len(lens) * cells),
            "standing_held": _share(sum(right[face] for face in asked), len(asked) * cells),
        }


@dataclass(frozen=True)
class _Tally:
    """Number of (cell, lens) of a kind, and the first: the body's name and the cell."""

    count: int = 0
    first: list[Any] | None = None

    def with_those(self, body: str, where: NDArray[np.bool_], cells: Ints) -> _Tally:
        """Extend by the cells for which `where` (cells,) holds."""
        found = np.flatnonzero(where)
        if not len(found):
            return self
        return _Tally(self.count + len(found), self.first or [body, *map(int, cells[found[0]])])


def _share(part: int, whole: int) -> float:
    return part / whole if whole else 0.0
