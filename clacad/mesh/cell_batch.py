"""Cells of a non-uniform sheet in batches: a few array operations give heights, borders and nodes of many.

A cell is *regular* where its borders have as many samples as the grid and its lenses cover its optical zone.
Its triangles are those of every regular cell, at its own levels. Other cells are rare; they are cut one by
one, on demand, and dropped some rows later.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache, partial

import numpy as np

from clacad.base.arrays import unique_rows
from clacad.base.sign_changes import keeps_away, resolving_nodes
from clacad.base.types import Bools, Bytes, Floats, Ints
from clacad.mesh import cell_triangulation as pl
from clacad.mesh.border_samples import border_samples, settle, touching
from clacad.mesh.cell_template import Offset, TemplateMaker
from clacad.mesh.integer_heights import NONE, CellLevels
from clacad.mesh.prototile import make_prototile, outermost, regular_prototile
from clacad.sheet.pattern import Step, node_cells
from clacad.sheet.window import Body
from clacad.topology.borders import compared

LOW, HIGH = -(2**50), 2**50
"""Levels of the lenses of the regular cell from which the triangles of all are copied."""


class Listed:
    """Distinct cells, and the position of a cell among them."""

    def __init__(self, *cells: Ints) -> None:
        self.cells, self.number = unique_rows(np.concatenate(cells))
        self._low = self.cells.min(axis=0)
        self._width = int(self.cells[:, 1].max() - self._low[1]) + 1
        self._keys = self._key(self.cells)

    def _key(self, cells: Ints) -> Ints:
        return np.asarray((cells[:, 0] - self._low[0]) * self._width + cells[:, 1] - self._low[1])

    def find(self, cells: Ints) -> Ints:
        """Positions (n,) of listed cells (n, 2)."""
        return np.searchsorted(self._keys, self._key(cells))


@dataclass(frozen=True, eq=False)
class SharedBorders:
    """Borders of one class between cells and their neighbours.

    left : Left cells (b, 2).
    t : (b, s). Parameters of the samples.
    levels : (b, s, 4). Left front, left back, right front, right back.
    regular : (b,) bool. Whether a border has as many samples as the grid; else its row is meaningless.
    """

    left: Listed
    t: Floats
    levels: Ints
    regular: Bools


@dataclass(frozen=True, eq=False)
class CellBatch:
    """Cells (n, 2) and what surrounds them.

    regular : (n,) bool
    own, there, nodes
        As in `clacad.mesh.compiled_walls.CellColumns`, of regular cells; absent cells count as kept.
    xy : (n, p, 2) lengths. Points of the footprint relative to the centre of the cell that owns each.
    """

    cells: Ints
    regular: Bools
    own: Ints
    there: Ints
    nodes: Ints
    xy: Floats


class RegularCell:
    """What all regular cells of a tiling have in common.

    make : Levels of any cell of the tiling.
    """

    def __init__(self, make: CellLevels, quads: int) -> None:
        lattice = make.window.lattice_of(make.tiling.array)
        self.tile = regular_prototile(make, quads, (LOW, HIGH))
        self.maker = TemplateMaker(self.tile, lattice, _no_neighbour)
        self.m = len(lattice.steps)
        self.steps = np.array(lattice.steps)
        self.seamed = make.window.land.seam > 0.0
        self.nodes = node_cells(lattice)
        plan = self.tile.plan
        self.count = len(plan.xy)
        self.segments = np.array([len(side) - 1 for side in plan.sides])
        self.sides = np.zeros((self.m, int(self.segments.max()) + 1), dtype=np.int64)
        for k, side in enumerate(plan.sides):
            self.sides[k, : len(side)] = side
        self.zone = np.unique(plan.triangles[plan.zone])
        self.zone_triangles = plan.triangles[plan.zone]
        self.t = self.tile.side_t[: self.m // 2]
        self.whole = not (self.tile.part == 2).any()

    @cached_property
    def caps(self) -> Ints:
        """Point, face and level (t, 3, 3) of the corners of both caps; face 2: that level in all cells."""
        point, level, triangles, _ = self.maker.caps
        face = np.where(level == LOW, 0, np.where(level == HIGH, 1, 2))
        return np.stack([point, face, level], axis=1)[triangles]

    @cached_property
    def inside(self) -> Bools:
        """Whether a point lies on no side of the cell, (p,)."""
        inside = np.ones(self.count, dtype=bool)
        inside[np.concatenate(self.tile.plan.sides)] = False
        return inside

    @property
    def kinds(self) -> Bytes:
        """Kinds (t,) of the caps' triangles."""
        return self.maker.caps[3]

    @cached_property
    def inner(self) -> Ints:
        """Edges (e, 3) between lens and land: two points, whether the lens is on the left."""
        left = [int(self.tile.plan.zone[one[2]]) for one in self.maker.inner]
        found = [(p, q, lens) for (p, q, *_), lens in zip(self.maker.inner, left)]
        return np.array(found, dtype=np.int64).reshape(-1, 3)

    def corner(self, k: int) -> tuple[int, int]:
        """Class of the node at corner k, and the cell's place among the cells around it."""
        return next(
            (n, at) for n, cells in enumerate(self.nodes) for at, (_, c) in enumerate(cells) if c == k
        )

    def around(self, k: int) -> list[Step]:
        """Index steps from a cell to the cells around its corner k, in canonical order."""
        number, place = self.corner(k)
        here = self.nodes[number][place][0]
        return [(s[0] - here[0], s[1] - here[1]) for s, _ in self.nodes[number]]

    @cached_property
    def places(self) -> Ints:
        """(m, 3): place of the cell around its corner k, then of its neighbour across side k at both ends."""
        found = []
        for k in range(self.m):
            step = tuple(self.steps[k].tolist())
            ends = [self.around(corner % self.m).index(step) for corner in (k, k + 1)]
            found.append((self.corner(k)[1], *ends))
        return np.array(found)


def _no_neighbour(_step: Step) -> TemplateMaker:
    raise AssertionError("the regular cell has no neighbours")


ROWS = 4
"""Number of rows of cells kept: a row borders on the ones below and above it, and these on theirs."""


class OwnTemplates:
    """Makers of the cells of one tiling, one per cell.

    base : Heights of the tiling, for no specific cell.
    quads : Grid steps per cell side.
    """

    def __init__(self, base: CellLevels, quads: int) -> None:
        self._base, self.quads = base, quads
        room = ROWS * (base.window.lattice.count[0] + 2)
        self.levels_at = lru_cache(maxsize=room)(self._make_levels)
        self._makers = lru_cache(maxsize=room)(self._make)

    def at(self, index: Offset) -> TemplateMaker:
        """The maker of the kept cell at `index`."""
        return self._makers(index)

    def body_at(self, index: Offset) -> Body:
        """The body of the uniform equivalent of the cell at `index`."""
        return self.levels_at(index).body

    def _make_levels(self, index: Offset) -> CellLevels:
        return self._base.of_cell(index, self.levels_at)

    def _make(self, index: Offset) -> TemplateMaker:
        tile = make_prototile(self.levels_at(index), self.quads)
        return TemplateMaker(tile, self._base.window.lattice, partial(self._beside, index))

    def _beside(self, index: Offset, step: Offset) -> TemplateMaker:
        return self._makers((index[0] + step[0], index[1] + step[1]))


class OwnMeshCells:
    """The cells of one tiling of a non-uniform sheet.

    base : Heights of the tiling, for no specific cell.
    quads : Grid steps per cell side.
    first : (i, j). A kept cell.
    """

    def __init__(self, base: CellLevels, quads: int, first: Step) -> None:
        self.base, self.quads = base, quads
        self.rare = OwnTemplates(base, quads)
        self.rare.at(first)  # its lenses decide the diagonals of the grid
        self.regular = RegularCell(base, quads)

    def batch(self, cells: Ints) -> CellBatch:
        """Cells (n, 2) with their borders and nodes."""
        same, make = self.regular, self.base
        nodes = [self._nodes(number, cells) for number in range(len(same.nodes))]
        borders = [self._borders(k, cells, nodes) for k in range(same.m // 2)]
        lens = make.heights_of(cells, same.tile.plan.xy)
        levels = settle(make, make.levels(lens))
        there = np.zeros((len(cells), *same.sides.shape, 2), dtype=np.int64)
        regular = np.full(len(cells), same.whole)
        xy = np.broadcast_to(same.maker.xy, (len(cells), same.count, 2)).copy()
        for k in range(same.m):
            border, right = borders[k % len(borders)], k >= len(borders)
            rows = border.left.find(cells - same.steps[k - len(borders)] if right else cells)
            regular &= border.regular[rows]
            mine, turn = slice(0, same.segments[k] + 1), -1 if right else 1
            both = border.levels[rows][:, ::turn]
            levels[:, same.sides[k, mine]] = both[..., 2:] if right else both[..., :2]
            there[:, k, mine] = both[..., :2] if right else both[..., 2:]
            inner = same.sides[k, 1 : same.segments[k]]
            xy[:, inner] = self._on_border(k % len(borders), border.t[rows])[:, 1:-1][:, ::turn]
        around = np.stack([self._around(k, cells, nodes) for k in range(same.m)], axis=1)
        regular &= self._covered(levels) & self._clear(there) & self._clear(around)
        own = outermost(levels, make.land, make.outermost)
        if same.seamed:
            own[:, same.sides], there[:], around[:] = make.land, make.land, make.land
        return CellBatch(
            cells,
            regular,
            own,
            outermost(there, make.land, make.outermost),
            outermost(around, make.land, make.outermost),
            xy,
        )

    def border_levels(self, segments: Ints, face: int) -> list[tuple[int, int]]:
        """Levels of one face at both ends of segments (s, 4): cell i, j, side and number of the segment."""
        if not len(segments):
            return []
        cells, same = Listed(segments[:, :2]), self.regular
        batch, found = self.batch(cells.cells), []
        for row, (i, j, k, n) in zip(cells.find(segments[:, :2]), segments.tolist(), strict=True):
            maker = same.maker if batch.regular[row] else self.rare.at((i, j))
            ends = maker.border_levels(k, n, face)
            if batch.regular[row]:
                own = batch.own[row, same.sides[k, n : n + 2], face].tolist()
                a, b = (mine if level in (LOW, HIGH) else level for mine, level in zip(own, ends))
                ends = a, b
            found.append(ends)
        return found

    def as_regular(self, cells: Ints) -> Bools:
        """Which cells (n, 2) have the very footprint of the regular cell, (n,)."""
        batch = self.batch(cells)
        return np.asarray(batch.regular & (batch.xy == self.regular.maker.xy).all(axis=(1, 2)))

    def _nodes(self, number: int, cells: Ints) -> tuple[Listed, Ints]:
        """First cells of the nodes of one class around some cells, and the columns (n, c, 2) there."""
        around, tile = self.regular.nodes[number], self.base.tiling.tile
        first = Listed(*(cells - np.array(step) for step, _ in around))
        rows = [
            self.base.levels(self.base.heights_of(first.cells + np.array(step), tile[corner : corner + 1]))
            for step, corner in around
        ]
        return first, settle(
            self.base, np.concatenate(rows, axis=1).reshape(len(first.cells), 1, -1)
        ).reshape(len(first.cells), -1, 2)

    def _around(self, k: int, cells: Ints, nodes: list[tuple[Listed, Ints]]) -> Ints:
        """CellColumns (n, c, 2) of the cells around corner k of some cells."""
        number, place = self.regular.corner(k)
        first, levels = nodes[number]
        return levels[first.find(cells - np.array(self.regular.nodes[number][place][0]))]

    def _on_border(self, k: int, t: Floats) -> Floats:
        """Points (b, s, 2) at parameters (b, s) of border class k, in the frame of the left cell."""
        tile = self.base.tiling.tile
        return pl.side_points(tile[k], tile[(k + 1) % len(tile)], t.ravel()).reshape(*t.shape, 2)

    def _sides_of(self, k: int, cells: Ints, t: Floats) -> Ints:
        """Levels (b, s, 4) of both cells at parameters (s,) of border class k."""
        return self.base.levels(self._heights(self.base, k, cells, t)).reshape(len(cells), len(t), 4)

    def _heights(self, make: CellLevels, k: int, cells: Ints, t: Floats) -> Floats:
        """Heights (b, s, 2, 2) of left and right cell at parameters (s,) of border class k."""
        tile, m = make.tiling.tile, self.regular.m
        left = make.heights_of(cells, pl.side_points(tile[k], tile[(k + 1) % m], t))
        other = pl.side_points(tile[(k + m // 2 + 1) % m], tile[k + m // 2], t)
        return np.stack([left, make.heights_of(cells + self.regular.steps[k], other)], axis=2)

    def _borders(self, k: int, cells: Ints, nodes: list[tuple[Listed, Ints]]) -> SharedBorders:
        """Borders of class k around some cells."""
        same, m = self.regular, self.regular.m
        left = Listed(cells, cells - same.steps[k])
        t = np.broadcast_to(same.t[k], (len(left.cells), len(same.t[k]))).copy()
        levels = np.empty((*t.shape, 4), dtype=np.int64)
        levels[:, 1:-1] = settle(self.base, self._sides_of(k, left.cells, same.t[k][1:-1]))
        right = left.cells + same.steps[k]
        for at, mine, theirs in ((0, k, (k + m // 2 + 1) % m), (-1, (k + 1) % m, k + m // 2)):
            for where, corner, faces in ((left.cells, mine, slice(0, 2)), (right, theirs, slice(2, 4))):
                levels[:, at, faces] = self._around(corner, where, nodes)[:, same.corner(corner)[1]]
        regular = np.ones(len(t), dtype=bool)
        if not same.seamed:
            alike = touching(levels)
            doubtful = (alike[:, 1:] & alike[:, :-1]).any(axis=1) | ~self._without_roots(k, left.cells)
            for n in np.flatnonzero(doubtful).tolist():
                found = border_samples(self.rare.levels_at(_step(left.cells[n])), k, int(same.segments[k]))
                regular[n] = len(found.t) == t.shape[1]
                if regular[n]:
                    t[n], levels[n] = found.t, found.levels
        return SharedBorders(left, t, levels, regular)

    def _without_roots(self, k: int, cells: Ints) -> Bools:
        """Whether nothing on border class k to the right of some cells changes sign, (b,)."""
        u = resolving_nodes()
        away = np.ones(len(cells), dtype=bool)
        for make in (self.base, *self.base.joined):
            heights = self._heights(make, k, cells, u)
            lines = heights[:, :, 0], heights[:, :, 1]
            for values, noise in compared(make.body, make.tiling.array, make.cells.columnar, lines):
                away &= keeps_away(values, noise)
        return away

    def _covered(self, levels: Ints) -> Bools:
        """Whether the lenses of cells cover their optical zones, (n,); levels (n, p, 2)."""
        covered = np.ones(len(levels), dtype=bool)
        for above in self._above(levels[:, self.regular.zone]):
            covered &= (above > 0).all(axis=1)
        return covered

    def _clear(self, levels: Ints) -> Bools:
        """Whether no rim passes a point of a border, (n,); levels (n, ..., 2)."""
        if self.regular.seamed:
            return np.ones(len(levels), dtype=bool)
        clear = np.ones(len(levels), dtype=bool)
        for above in self._above(levels):
            clear &= (above > 0).reshape(len(levels), -1).all(axis=1)
        return clear

    def _above(self, levels: Ints) -> list[Ints]:
        """How far lenses are above what could end them, at levels (..., 2)."""
        make, found = self.base, []
        if make.cells.columnar:
            found.append(levels[..., 1] - levels[..., 0])
        for side, sign in ((0, -1), (1, 1)):
            if not make.held[side] and make.land[side] not in (NONE, -NONE) and make.meshed()[side]:
                found.append(sign * (levels[..., side] - make.land[side]))
        return found


def _step(cell: Ints) -> Step:
    return int(cell[0]), int(cell[1])
