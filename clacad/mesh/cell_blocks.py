"""Triangles in blocks of cells: copies of one template, or of many regular cells each at its own levels."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.arrays import unique_rows
from clacad.base.types import Bools, Bytes, Floats, Ints
from clacad.mesh.cell_template import CELL, NOTHING, PLAIN, WALL, Template
from clacad.mesh.integer_heights import FAR, NONE

if TYPE_CHECKING:
    from clacad.mesh.cell_batch import CellBatch, OwnMeshCells
    from clacad.mesh.land_ring import Tiled

BLOCK = 200_000
"""Number of triangles of a block, about: some megabytes."""

MOST_CELLS = 4096
"""Largest number of cells of a block."""


@dataclass(frozen=True, eq=False)
class CellBlock:
    """Cells of one row that share a template.

    cells : (n, 2) int64
    """

    template: Template
    cells: Ints
    tiled: Tiled

    def corners(self, first: int, last: int) -> Floats:
        """Triangle corners (k, 3, 3) of cells first … last − 1."""
        return self.vertices(first, last)[:, self.template.triangles].reshape(-1, 3, 3)

    def tags(self, first: int, last: int) -> tuple[Bytes, Ints]:
        """Kind (k,) and cell (k, 2) of the triangles of cells first … last − 1."""
        cells = self.cells[first:last]
        return np.tile(self.template.kind, len(cells)), np.repeat(cells, len(self.template.triangles), axis=0)

    def places(self, first: int, last: int) -> tuple[Ints, Ints, Bools]:
        """Where the corners of cells first … last − 1 lie; see `clacad.formats.mesh.measure.CornerPlaces`."""
        corners = self.template.triangles.ravel()
        start = len(corners) * np.arange(last - first + 1)
        return start, np.tile(corners, last - first), self.template.inner

    def keys(self) -> Ints:
        """Owner cell, canonical point and level of each vertex, (n, 4)."""
        t = self.template
        owner = self.cells[:, None, :] + t.owner[None]
        rest = np.broadcast_to(np.stack([t.point, t.level], axis=1), (*owner.shape[:2], 2))
        return np.concatenate([owner, rest], axis=2).reshape(-1, 4)

    def triangles(self, first: int) -> Ints:
        """Vertex numbers (t, 3), those of `keys` from `first` on."""
        start = first + len(self.template.z) * np.arange(len(self.cells))
        return np.asarray((self.template.triangles[None] + start[:, None, None]).reshape(-1, 3))

    def vertices(self, first: int, last: int) -> Floats:
        """Vertices (cells, v, 3) of cells first … last − 1: the owner's centre plus its frame's x, y."""
        t, shift = self.template, np.array(self.tiled.shift)
        steps, which = t.owners
        centres = self.tiled.lattice.centres(self.cells[first:last, None, :] + steps[None]) + shift
        out = np.empty((last - first, len(t.z), 3))
        out[:, :, :2] = centres[:, which, :]
        out[:, :, :2] += t.xy
        out[:, :, 2] = t.z
        return out


def number_rows(key: Ints) -> Ints:
    """Index (n,) of each key (n, 4) of a vertex among the distinct keys, ascending."""
    point = np.unique(key[:, 2], return_inverse=True)[1]  # small numbers: a key fits into one word
    return unique_rows(np.column_stack([key[:, :2], point.reshape(-1), key[:, 3]]))[1]


@dataclass(frozen=True, eq=False)
class OwnBlock:
    """Triangles of some cells of a non-uniform sheet.

    cells : (n, 2) int64
    start : (n + 1,) int64. First triangle of each cell.
    facets : (t, 3, 3) lengths
    points, levels : (t, 3) int64
        Point of the footprint and level of each corner of regular cells; point −1 in rare ones.
    rare : cell of the block → Template
    xy : (n, p, 2) lengths. Points of the footprint of regular cells, sheet frame.
    """

    cells: Ints
    start: Ints
    facets: Floats
    points: Ints
    levels: Ints
    rare: Mapping[int, Template]
    tiled: Tiled
    xy: Floats

    def corners(self, _first: int, _last: int) -> Floats:
        """Triangle corners (t, 3, 3) of all cells."""
        return self.facets

    def tags(self, _first: int, _last: int) -> tuple[Bytes, Ints]:
        """Kind (t,) and cell (t, 2) of the triangles."""
        assert self.tiled.own is not None
        same = self.tiled.own.regular
        kind = np.full(len(self.facets), WALL, dtype=np.uint8)
        chosen = np.setdiff1d(np.arange(len(self.cells)), list(self.rare))
        kind[self.start[chosen][:, None] + np.arange(len(same.caps))] = same.kinds
        for n, template in self.rare.items():
            kind[self.start[n] : self.start[n + 1]] = template.kind
        return kind, self._owners()

    def _owners(self) -> Ints:
        return np.repeat(self.cells, np.diff(self.start), axis=0)

    def places(self, _first: int, _last: int) -> tuple[Ints, Ints, Bools]:
        """Where the corners lie; see `clacad.formats.mesh.measure.CornerPlaces`; unknown in rare cells."""
        assert self.tiled.own is not None
        return 3 * self.start, self.points.ravel(), self.tiled.own.regular.inside

    def optical(self, kind: int) -> tuple[Ints, Ints, Ints, Ints]:
        """Corners of the facets of a kind: cells (n,) that are regular, and the points (z,) that each of them
        has; in `which` (t, 3) the row of each corner among these n z and, from there on, its place among the
        corners of the facets (k,) of rare cells; −1 for those of other kinds.
        """
        assert self.tiled.own is not None
        same, found = self.tiled.own.regular, np.full(self.points.shape, -1, dtype=np.int64)
        chosen = np.setdiff1d(np.arange(len(self.cells)), list(self.rare))
        mine = np.flatnonzero(same.kinds == kind)
        points, which = np.unique(same.caps[mine, :, 0], return_inverse=True)
        rows = self.start[chosen][:, None] + mine
        found[rows] = len(points) * np.arange(len(chosen))[:, None, None] + which.reshape(-1, 3)
        apart = [self.start[n] + np.flatnonzero(one.kind == kind) for n, one in self.rare.items()]
        facets = np.concatenate([*apart, np.empty(0, dtype=np.int64)]).astype(np.int64)
        found[facets] = len(chosen) * len(points) + np.arange(3 * len(facets)).reshape(-1, 3)
        return chosen, points, found, facets

    def keys(self) -> Ints:
        """Owner cell, canonical point and level of each vertex, (n, 4)."""
        return self._welded[0]

    def vertices(self, _first: int, _last: int) -> Floats:
        """Vertices (n, 3)."""
        return self._welded[1]

    def triangles(self, first: int) -> Ints:
        """Vertex numbers (t, 3), those of `keys` from `first` on."""
        return self._welded[2] + first

    @cached_property
    def _welded(self) -> tuple[Ints, Floats, Ints]:
        """Keys (n, 4), positions (n, 3) and triangles (t, 3) of shared vertices."""
        key = self._corner_keys()
        number = number_rows(key)
        first = np.empty(int(number.max()) + 1, dtype=np.int64)
        first[number[::-1]] = np.arange(len(number))[::-1]
        return key[first], self.facets.reshape(-1, 3)[first], number.reshape(-1, 3)

    def _corner_keys(self) -> Ints:
        """Owner cell, canonical point and level of each corner, (3 t, 4)."""
        assert self.tiled.own is not None
        step, canonical = self.tiled.own.regular.maker.places
        owner = self._owners()[:, None] + step[self.points]
        key = np.concatenate([owner, canonical[self.points][..., None], self.levels[..., None]], axis=2)
        for n, template in self.rare.items():
            block = CellBlock(template, self.cells[n : n + 1], self.tiled)
            key[self.start[n] : self.start[n + 1]] = block.keys()[template.triangles]
        return key.reshape(-1, 4)


def own_blocks(
    tiled: Tiled, rows: Iterable[Ints], states: Callable[[Ints], Bytes], most: int = BLOCK
) -> Iterator[OwnBlock]:
    """Yield the triangles of the cells (n, 2) of rows; `states` returns the states of their neighbours.

    most : Number of triangles of a block, about.
    """
    assert tiled.own is not None
    caps = tiled.own.regular.caps
    many = max(1, min(MOST_CELLS, most // (2 * max(1, len(caps)))))
    waiting: list[Ints] = []
    for row in rows:
        waiting.append(row)
        if sum(map(len, waiting)) >= many:
            cells = np.concatenate(waiting)
            for first in range(0, len(cells) - len(cells) % many, many):
                yield _block(tiled, cells[first : first + many], states)
            waiting = [cells[len(cells) - len(cells) % many :]]
    cells = np.concatenate(waiting)
    if len(cells):
        yield _block(tiled, cells, states)


def _block(tiled: Tiled, cells: Ints, states: Callable[[Ints], Bytes]) -> OwnBlock:
    """The triangles of some cells (n, 2)."""
    own = tiled.own
    assert own is not None
    batch, around = own.batch(cells), states(cells)
    chosen = np.flatnonzero(batch.regular)
    walls, first = _walls(own, batch, around, chosen)
    made = {}
    counts = np.empty(len(cells), dtype=np.int64)
    counts[chosen] = len(own.regular.caps) + np.diff(first)
    for n in np.flatnonzero(~batch.regular).tolist():
        made[n] = own.rare.at((int(cells[n, 0]), int(cells[n, 1]))).template(around[n])
        counts[n] = len(made[n].triangles)
    start = np.concatenate([[0], np.cumsum(counts)])
    total = int(start[-1])
    facets = np.empty((total, 3, 3))
    points, levels = np.full((total, 3), -1, dtype=np.int64), np.zeros((total, 3), dtype=np.int64)
    xy = _place(tiled, batch, (chosen, walls, first, start), (facets, points, levels))
    for n, template in made.items():
        block = CellBlock(template, cells[n : n + 1], tiled)
        facets[start[n] : start[n + 1]] = block.corners(0, 1)
    return OwnBlock(cells, start, facets, points, levels, made, tiled, xy)


def _walls(own: OwnMeshCells, batch: CellBatch, states: Bytes, chosen: Ints) -> tuple[Ints, Ints]:
    """Walls (w, 3, 2) of the chosen cells of a batch, and the first of each of these cells."""
    from clacad.mesh.compiled_walls import ROOM, CellColumns, Edges, join_walls

    same, land = own.regular, own.base.land
    plain = land if land[0] != NONE and land[1] != -NONE else (NONE, -NONE)
    place = {step: n for n, step in enumerate(same.maker.offsets)}
    there, nodes = batch.there.copy(), batch.nodes.copy()
    drawn = np.ones((len(batch.cells), same.m), dtype=bool)
    apart = FAR in np.abs(land)
    for state, column in ((PLAIN, plain), (NOTHING, (NONE, -NONE))):
        for k in range(same.m):
            absent = states[:, place[tuple(same.steps[k].tolist())]] == state
            there[absent, k] = column
            for n, step in enumerate(same.around(k)):
                if step != (0, 0):
                    nodes[states[:, place[step]] == state, k, n] = column
            if state == NOTHING and apart:
                drawn[absent, k] = False
    for k in range(same.m // 2, same.m):
        drawn[states[:, place[tuple(same.steps[k].tolist())]] == CELL, k] = False
    edges = Edges(same.sides, same.segments, same.inner, same.places, np.array(land))
    room = 2 * ROOM + len(chosen) * (4 * int(same.segments.sum()) + 4 * len(same.inner))
    first = np.empty(len(chosen) + 1, dtype=np.int64)
    while True:
        walls = np.empty((room, 3, 2), dtype=np.int64)
        used = join_walls(chosen, CellColumns(batch.own, there, nodes, drawn), edges, _work(), first, walls)
        if used == -1:
            raise ValueError("two heights cross inside an edge of the footprint: a crossing was missed")
        if used >= 0:
            return walls[:used], first
        room *= 2


@lru_cache(maxsize=1)
def _work() -> Any:
    """Arrays that the kernel writes for itself."""
    columns, lines, chains = (np.empty(shape, dtype=np.int64) for shape in ((4, 2), (4, 4), (2, 32)))
    levels, lengths = np.empty(16, dtype=np.int64), np.empty(2, dtype=np.int64)
    rings, at, counts = (np.empty(shape, dtype=np.int64) for shape in ((2, 4, 2), (2, 2), 2))
    return columns, rings, at, counts, (columns, lines, chains, levels, lengths)


def _place(
    tiled: Tiled, batch: CellBatch, wanted: tuple[Ints, Ints, Ints, Ints], found: tuple[Floats, Ints, Ints]
) -> Floats:
    """Write corners, points and levels of the triangles of the chosen cells of a batch; returns positions
    (n, p, 2) of the points of its cells.
    """
    from clacad.mesh.compiled_walls import place_corners

    assert tiled.own is not None
    chosen, walls, first, start = wanted
    steps, which = np.unique(tiled.own.regular.maker.places[0], axis=0, return_inverse=True)
    centres = tiled.lattice.centres(batch.cells[:, None] + steps) + np.array(tiled.shift)
    xy = centres[:, which.ravel()] + batch.xy
    place_corners(
        chosen,
        tiled.own.regular.caps,
        batch.own,
        xy,
        walls,
        (first, start[chosen], tiled.own.base.step),
        found,
    )
    return np.asarray(xy)
