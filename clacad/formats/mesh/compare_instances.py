"""Repeated parts of a mesh file: every place is compared with the lattice without expanding the instances.

A sheet of 40,000 cells of 130,000 facets has 5e9 facets when every cell is expanded. Without expansion it has
130,000 facets and 40,000 places, or 400 places in a file that stores one row and one cell. Rows that fill
the lattice are compared as rows; otherwise every place is compared.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from operator import itemgetter

import numpy as np

from clacad.base.arrays import unique_rows
from clacad.base.types import Floats, Ints
from clacad.base.vectors import doubled_normals
from clacad.formats.mesh.file_mesh import FileMesh, Part, kinds
from clacad.formats.mesh.measure import objects
from clacad.formats.placements import fill
from clacad.sheet.feasibility import body_range, inner_range
from clacad.sheet.volume_and_extent import whole_extent
from clacad.sheet.window import WALL, Body, Face, Window

COVERED = 0.02
"""Least share of a cell's area that a part's facets must cover to represent that cell; lenses may be
small."""

SPILT = 1e-6
"""Share of a cell's area below which facets over it are slivers on its border."""

SURE = 4.0
"""Factor on the row error that bounds the residual of any place from the mean position error of all places.
Along each axis, the position errors of two places differ by at most twice the row error.
"""

Cell = tuple[int, int]
Side = tuple[int, int]
"""Body, and 0 for its front or 1 for its back."""


# -- places --------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class PartPlaces:
    """Places of one object on the lattice.

    parts : Meshes that share the places.
    cells : Cells (k, 2) that the object covers at its first place, by body and side.
    step : (m, 2) ints. Nearest whole index steps from the first place to each place.
    off : (m,) lengths, design units
        Largest distance of a corner of its box from its lattice position, in the orientation of most places.
    spills : Whether facets reach into cells that it does not cover.
    """

    parts: tuple[Part, ...]
    cells: dict[Side, Ints]
    step: Ints
    off: Floats
    spills: bool

    @property
    def one_cell(self) -> bool:
        """Whether the object has facets over one cell, the same on all sides, and over no other."""
        return _only_cell(self.cells, self.spills) is not None

    @property
    def count(self) -> int:
        """How many places they are."""
        return len(self.off)

    @property
    def worst(self) -> tuple[float, Cell]:
        """Largest distance of a place from the lattice (design units), and its cell."""
        number = int(np.argmax(self.off))
        i, j = next(iter(self.cells.values()))[0] + self.step[number]
        return float(self.off[number]), (int(i), int(j))


@dataclass(frozen=True, eq=False)
class RowPlaces:
    """Places of one object of one cell in rows that fill the lattice, each cell once.

    parts : Meshes that share the places.
    sides : tuple of (body, side). Sides on which it has facets.
    rows, columns : (m, 2), (n, 2) ints
        Cell of the first place of each row, and index steps from there to the other places of a row.
    worst : (length, (i, j)). Sum of the largest row error and the largest error within a row, and the cell
        where both apply. No place has a larger error, except for rounding.
    """

    parts: tuple[Part, ...]
    sides: tuple[Side, ...]
    rows: Ints
    columns: Ints
    worst: tuple[float, Cell]

    @property
    def count(self) -> int:
        """How many places they are."""
        return len(self.rows) * len(self.columns)

    def over(self, cell: Cell) -> int:
        """Number of the place over a cell of the lattice."""
        row = int(np.flatnonzero(self.rows[:, 1] == cell[1])[0])
        column = int(np.flatnonzero(self.columns[:, 0] == cell[0] - self.rows[row, 0])[0])
        return row * len(self.columns) + column


def _only_cell(cells: dict[Side, Ints], spills: bool) -> Cell | None:
    """The one cell that an object covers on all its sides; None if it covers other cells too."""
    found = np.unique(np.concatenate(list(cells.values())), axis=0)
    return (int(found[0, 0]), int(found[0, 1])) if len(found) == 1 and not spills else None


@dataclass(frozen=True, eq=False)
class Standing:
    """Comparison of every place of a file with the lattice.

    count : Number of places that were compared.
    worst : design units
    worst_cell : (i, j) or None. Cell of the place with the largest error.
    limit : design units. Rounding of the places' coordinates to float32.
    missing, doubled, outside : lists of (i, j)
        Cells without a place, cells with several places, and places outside the sheet; the first few.
    faults : (int, int, int). Number of each of the three.
    """

    places: tuple[PartPlaces, ...] | tuple[RowPlaces, ...]
    count: int
    worst: float
    worst_cell: Cell | None
    limit: float
    missing: list[Cell]
    doubled: list[Cell]
    outside: list[Cell]
    faults: tuple[int, int, int]

    @property
    def sound(self) -> bool:
        """Whether every place lies on a cell of the lattice, and each cell has exactly one."""
        return self.worst <= self.limit and not any(self.faults)

    @property
    def words(self) -> str:
        """Text of the result, with numbers."""
        found = []
        listed = (self.missing, self.doubled, self.outside)
        for cells, number, (many, one) in zip(listed, self.faults, _FAULTS, strict=True):
            if number:
                found.append(f"{number} {many}, such as {cells[0]}" if number > 1 else one.format(cells[0]))
        if self.worst > self.limit:
            found.append(f"the instance over cell {self.worst_cell} lies {self.worst:.4g} off the lattice")
        return "; ".join(found) or (
            f"each of {self.count} instances lies on a cell of its array, each cell has one; "
            f"farthest off the lattice {self.worst:.4g}"
        )


_FAULTS = (
    ("cells have no instance", "cell {} has no instance"),
    ("cells have more than one", "cell {} has more than one instance"),
    ("instances lie outside the sheet", "an instance lies outside the sheet, where cell {} would be"),
)
"""Words on cells without a place, cells with several, places outside: of many, and of one."""


def standing(mesh: FileMesh, window: Window, factor: float) -> Standing | None:
    """Compare every place of the parts that represent cells with the lattice; None where there are none.

    factor : Design units per file unit.
    """
    limit = placing_room(window)
    if in_rows := _in_rows(mesh, window, factor, limit):
        off, cell = max((p.worst for p in in_rows), key=itemgetter(0))
        return Standing(in_rows, sum(p.count for p in in_rows), off, cell, limit, [], [], [], (0, 0, 0))
    found = [p for parts in objects(mesh) if (p := _stand(parts, window, factor)) is not None]
    if not found:
        return None
    off, cell = max((p.worst for p in found), key=itemgetter(0))
    return Standing(
        tuple(found), sum(p.count for p in found), off, cell, limit, *_covering(found, mesh, window, factor)
    )


def placing_room(window: Window) -> float:
    """Largest error (length) of a place due to rounding to float32."""
    reach = max(abs(v) for v in (*whole_extent(window), *window.z_range))
    return 2.0**-23 * reach


def _in_rows(mesh: FileMesh, window: Window, factor: float, limit: float) -> tuple[RowPlaces, ...]:
    """Repeated parts of a file whose rows fill the lattice within the limit; empty if any does not."""
    found: list[RowPlaces] = []
    for parts in objects(mesh):
        one = _row_places(parts, window, factor)
        if one is None or not SURE * one.worst[0] <= limit:
            return ()
        found.append(one)
    sides = [side for one in found for side in one.sides]
    return tuple(found) if len(set(sides)) == len(sides) else ()


def _row_places(parts: list[Part], window: Window, factor: float) -> RowPlaces | None:
    """One repeated part in rows that fill the lattice; None if its rows do not show this."""
    places, lattice = parts[0].places, window.lattice
    if not places.in_rows or (len(places.inner), len(places.outer)) != lattice.count:
        return None
    cells, spills = _covered(parts, window, parts[0].placed_at(np.zeros(1, dtype=np.int64))[0], factor)
    cell = _only_cell(cells, spills) if cells else None
    if cell is None:
        return None
    basis = np.array([lattice.a1, lattice.a2])
    (down, down_off), (along, along_off) = (
        _steps((moves[:, :, 3] - moves[0, :, 3]) * factor, basis, 0) for moves in (places.outer, places.inner)
    )
    rows = np.array(cell) + down
    if not fill(lattice, rows, along):
        return None
    away = [np.linalg.norm(off, axis=1) for off in (down_off, along_off)]
    i, j = rows[int(np.argmax(away[0]))] + along[int(np.argmax(away[1]))]
    return RowPlaces(
        tuple(parts), tuple(cells), rows, along, (float(away[0].max() + away[1].max()), (int(i), int(j)))
    )


def _stand(parts: list[Part], window: Window, factor: float) -> PartPlaces | None:
    """Places of one repeated part among the cells of the window; None where it covers none."""
    placements = parts[0].placements
    turns = kinds(parts[0])
    usual, rows = turns[0]
    cells, spills = _covered(parts, window, placements[rows[0]], factor)
    if not cells:
        return None
    boxes = [part.own_box() for part in parts]
    low, high = np.min([b[0] for b in boxes], axis=0), np.max([b[1] for b in boxes], axis=0)
    middle = 0.5 * (low + high)
    centre = (np.einsum("x,mxy->my", middle, placements[:, :3]) + placements[:, 3]) * factor
    basis = np.array([window.lattice.a1, window.lattice.a2])
    step, off = _steps(centre, basis, int(rows[0]))
    distance = np.linalg.norm(off, axis=1)
    corners = np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )
    for linear, turned in turns[1:]:
        bent = (corners - middle) @ (linear - usual) * factor
        distance[turned] = np.linalg.norm(off[turned, None] + bent, axis=2).max(axis=1)
    return PartPlaces(tuple(parts), cells, step, distance, spills)


def _steps(centre: Floats, basis: Floats, first: int) -> tuple[Ints, Floats]:
    """Whole index steps (m, 2) of centres (m, 3) from number `first`; residuals (m, 3) from the majority."""
    u = np.linalg.solve(basis.T, (centre[:, :2] - centre[first, :2]).T).T
    # phase of the majority between two whole steps: a mean of phases, which one stray place hardly changes
    phase = np.angle(np.exp(2j * np.pi * u).mean(axis=0)) / (2.0 * np.pi)
    step = np.rint(u - phase)
    step -= step[first]
    left = centre.copy()
    left[:, :2] -= step @ basis
    return step.astype(np.int64), left - np.median(left, axis=0)


def _covered(
    parts: Sequence[Part], window: Window, place: Floats, factor: float
) -> tuple[dict[Side, Ints], bool]:
    """Cells (k, 2) under the lens facets at one place (4, 3), by body and side; whether the facets spill."""
    area: dict[tuple[Side, Cell], float] = {}
    for part in parts:
        for corners, _ in part.pairs_at(place):
            for side, index, flat in _lying(corners * factor, window):
                cells, which = unique_rows(index)
                for cell, size in zip(cells.tolist(), np.bincount(which, weights=flat), strict=True):
                    key = (side, (cell[0], cell[1]))
                    area[key] = area.get(key, 0.0) + float(size)
    whole = window.lattice.cell_area
    most: dict[Side, float] = {}
    for (side, _), size in area.items():
        most[side] = max(size, most.get(side, 0.0))
    found: dict[Side, list[Cell]] = {}
    spills = False
    for (side, cell), size in area.items():
        if size >= max(COVERED * whole, 0.5 * most[side]):
            found.setdefault(side, []).append(cell)
        else:
            spills |= size > SPILT * whole
    return {side: np.array(sorted(cells), dtype=np.int64) for side, cells in found.items()}, spills


def _lying(corners: Floats, window: Window) -> Iterator[tuple[Side, Ints, Floats]]:
    """Cells (k, 2) and areas (k,) seen along z of the facets (n, 3, 3) of each lens face."""
    normal = doubled_normals(corners)
    optical = np.abs(normal[:, 2]) > WALL * np.linalg.norm(normal, axis=1)
    middle = corners.mean(axis=1)
    body = body_facing(levels(window), middle[:, 2], normal[:, 2])
    for number, piece in enumerate(window.bodies):
        for side, face in enumerate((piece.front, piece.back)):
            rows = np.flatnonzero(optical & (body == number) & ((normal[:, 2] > 0.0) == bool(side)))
            if (face.array is not None or piece.layer) and len(rows):
                shift = window.shifts[owner(piece, face)]
                index, _, _ = window.lattice.locate(middle[rows, 0] - shift[0], middle[rows, 1] - shift[1])
                yield (number, side), index, 0.5 * np.abs(normal[rows, 2])


def _covering(
    found: Sequence[PartPlaces], mesh: FileMesh, window: Window, factor: float
) -> tuple[list[Cell], list[Cell], list[Cell], tuple[int, int, int]]:
    """Cells without a place, cells with several, places outside the sheet: the first few, and the counts."""
    lattice = window.lattice
    whole = {number for number in range(len(window.bodies)) if not _stands_once(mesh, window, number, factor)}
    missing, doubled, outside = [_NONE], [_NONE], [_NONE]
    for side in {side for places in found for side in places.cells}:
        index = np.concatenate(
            [
                (places.step[:, None] + places.cells[side][None]).reshape(-1, 2)
                for places in found
                if side in places.cells
            ]
        )
        inside = lattice.contains(index)
        outside.append(_numbers(index[~inside]))
        cells, times = np.unique(_numbers(index[inside]), return_counts=True)
        doubled.append(cells[times > 1])
        if side[0] in whole and len(cells) < lattice.cell_count:
            missing.append(np.setdiff1d(_numbers(lattice.cells()), cells))
    faults = [np.unique(np.concatenate(numbers)) for numbers in (missing, doubled, outside)]
    few = [[(int(i), int(j)) for i, j in _indices(numbers[:64])] for numbers in faults]
    return few[0], few[1], few[2], (len(faults[0]), len(faults[1]), len(faults[2]))


def _stands_once(mesh: FileMesh, window: Window, body: int, factor: float) -> bool:
    """Whether an unrepeated part reaches into a body and may therefore be the missing cell."""
    low, high = body_range(window, window.bodies[body])
    for part in mesh.parts:
        if not part.repeated and part.facet_count:
            ends = FileMesh(mesh.format, (part,)).box()
            if ends[0][2] * factor < high and ends[1][2] * factor > low:
                return True
    return False


_NONE = np.zeros(0, dtype=np.int64)


def _numbers(index: Ints) -> Ints:
    """One number for each pair of indices (k, 2)."""
    return np.asarray((index[:, 1] << 32) + (index[:, 0] + (1 << 31)))


def _indices(numbers: Ints) -> Ints:
    return np.column_stack([(numbers & 0xFFFFFFFF) - (1 << 31), numbers >> 32])


# -- bodies of a window --------------------------------------------------------------------------
def owner(body: Body, face: Face) -> int:
    """Array whose grid is used for a face: its own, or for a plane that of the body."""
    if face.array is not None:
        return face.array
    return body.arrays[0]


def levels(window: Window) -> Floats:
    """Heights (3, bodies − 1) between the bodies of a window: for fronts, for backs, and for walls.

    Midway between two bodies with air between them; two facets of a joint differ by where they face.
    """
    ranges = [body_range(window, body) for body in window.bodies]
    found = np.array([[0.5 * (a[1] + b[0]) for a, b in pairwise(ranges)]] * 3)
    for number, (before, body) in enumerate(pairwise(window.bodies)):
        if body.joined:
            high, low = inner_range(window, before)[0], inner_range(window, body)[1]
            found[:2, number] = 0.5 * (high + ranges[number + 1][0]), 0.5 * (ranges[number][1] + low)
    return found


def body_facing(between: Floats, height: Floats, facing: Floats) -> Ints:
    """Body (n,) of facets at heights (n,) that face −z or +z, by the sign of `facing` (n,).

    between : (3, bodies − 1) from `levels`
    """
    front, back = (np.searchsorted(between[side], height) for side in (0, 1))
    return np.asarray(np.where(facing > 0.0, back, front))
