"""Cells of one tiling whose faces are lenses from border to border, with their borders and nodes, in arrays.

A cell is *plain* where each of its lens faces covers it without a rim, above its land and clear of its
other face. A border is *plain* where the lenses of its two plain cells coincide along it or are separated by
one plane wall. All others (crossing lenses, rims, borders of the outline, saddles) are left to
`clacad.solid.tilings`, cell by cell. Lengths in mm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Ints
from clacad.sheet.lattice import Lattice
from clacad.solid.node_sectors import CornerRing, rings
from clacad.solid.rational_conics import LensArray
from clacad.solid.shells import Loop, NodeVertices, ShellCounts
from clacad.solid.wall_segments import RULED_BELOW

Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class SharedParts:
    """Parts that plain cells share with cells that are described one by one, made on request.

    node : The node at a corner of a cell: (number of the cell, corner) → NodeVertices.
    vertex, vertical : A node's vertex at a level; its vertical edge above a level on a ray.
    side : Edges of a face of a cell along a side, counter-clockwise: (number of the cell, side, face) → Loop.
    """

    node: Callable[[int, int], NodeVertices]
    vertex: Callable[[NodeVertices, int], int]
    vertical: Callable[[NodeVertices, int, int], int]
    side: Callable[[int, int, int], Loop]


@runtime_checkable
class CellWriter(Protocol):
    """A `clacad.solid.shells.Writer` that takes plain cells in arrays."""

    def cells(self, cells: CellArrays, shared: SharedParts) -> tuple[Ints, Ints]:
        """Make all plain cells and borders: number of the cell that owns every face, and of the face."""


ROWS = 2048
"""Cells of one batch."""

_ALONG = 0.5 - 0.5 * np.cos(np.pi * np.arange(17) / 16)
_WITHIN = (0.0, 0.25, 0.5, 0.75, 1.0)
_CLEAR = 0.02
"""Least distance of a plain lens from its land, as a share of the lens's depth."""


@dataclass(frozen=True, eq=False)
class SkinNodes:
    """Vertices of one lens face on the lines of the nodes.

    place : (nodes, sectors). Level of the cell in every sector, from 0.
    z : (nodes, sectors), mm. Height of every level.
    count : (nodes,). Number of levels.
    shift : mm. Largest distance of a height from its level.
    """

    place: Ints
    z: Floats
    count: Ints
    shift: float


@dataclass(frozen=True, eq=False)
class SkinBorders:
    """Borders of one lens face: side k of every cell, k < half the sides.

    stepped, high : (n, half) bool
        Whether a wall separates the lenses; whether that of the cell itself is the higher one.
    apart : mm. Largest distance of two lenses that share an edge.
    merged : Number of shared edges whose lenses differ.
    """

    stepped: Bools
    high: Bools
    apart: float
    merged: int


@dataclass(frozen=True, eq=False)
class CellArrays:
    """Plain cells, borders and nodes of one tiling.

    cells : (n, 2)
    centres : (n, 2), mm
    tile : (m, 2), mm
    neighbours : (n, m). Number of the cell across every side; −1 for none.
    nodes : (n, m). Number of the node at every corner; −1 where its first cell does not exist.
    rings : Per corner of the tile.
    plain : (n,) bool
    borders : (n, m) bool. Whether the border along every side is plain.
    mixed : (nodes,) bool. Nodes of plain cells at which borders that are not plain end.
    whole : (nodes,) bool. Nodes with plain cells all round.
    skin_nodes, skin_borders : per lens face
    """

    cells: Ints
    centres: Floats
    tile: Floats
    lenses: tuple[LensArray, ...]
    neighbours: Ints
    nodes: Ints
    rings: tuple[CornerRing, ...]
    plain: Bools
    borders: Bools
    whole: Bools
    mixed: Bools
    skin_nodes: tuple[SkinNodes, ...]
    skin_borders: tuple[SkinBorders, ...]

    def count(self, counts: ShellCounts) -> None:
        """Add the elements of plain cells to the counts of a body."""
        half = len(self.tile) // 2
        own = self.borders[:, :half]
        for nodes, borders in zip(self.skin_nodes, self.skin_borders, strict=True):
            walls = int((own & borders.stepped).sum())
            counts.faces["lens"] += int(self.plain.sum())
            if walls:
                counts.faces["wall"] += walls
            counts.merged_steps += borders.merged
            counts.largest_shift = max(counts.largest_shift, nodes.shift, borders.apart)
            levels = nodes.count[self.whole & ~self.mixed]
            counts.vertices += int(levels.sum())
            counts.edges += int(own.sum()) + walls + int((levels - 1).sum())


def cell_arrays(
    lattice: Lattice,
    places: Lattice,
    scale: float,
    shift: Floats,
    lenses: tuple[LensArray, ...],
    merge: float,
) -> CellArrays:
    """Find plain cells, borders and nodes.

    lattice : The cells that exist.
    places : Their positions.
    scale : mm per design unit.
    shift : (2,), mm
    merge : mm. Heights closer than this are one.
    """
    cells, tile = lattice.cells(), places.tile() * scale
    number = _numbers(cells)
    half = len(tile) // 2
    neighbours = np.stack([number(cells + np.array(step)) for step in places.steps], axis=1)
    plain = _plain_cells(len(cells), tile, lenses, merge)
    ring = tuple(rings(places))
    firsts = sorted({one.cells[0][1] for one in ring})
    nodes = np.stack([_node(number, cells, one, firsts) for one in ring], axis=1)
    around = _sectors(number, cells, ring, firsts)
    whole = np.asarray((around[0] >= 0).all(axis=1) & plain[around[0]].all(axis=1))
    skin_nodes = []
    for lens in lenses:
        levels, saddle = _levels(lens, tile, *around, whole, merge)
        skin_nodes.append(levels)
        whole &= ~saddle
    borders = plain[:, None] & (neighbours[:, :half] >= 0) & plain[neighbours[:, :half]]
    for end in (nodes[:, :half], nodes[:, 1 : half + 1]):
        borders &= (end >= 0) & whole[end]
    offsets = [np.array(places.offset(*step)) * scale for step in places.steps[:half]]
    skin_borders = []
    for lens, levels in zip(lenses, skin_nodes, strict=True):
        parted = _parted(levels, nodes, ring)
        found, usable = _borders(lens, tile, offsets, neighbours, parted, borders, merge)
        skin_borders.append(found)
        borders &= usable
    if len(lenses) == 2:
        borders &= _clear_of_the_other(lenses, tile, offsets, neighbours, borders, merge)
    every = _all_sides(borders, neighbours)
    centres = places.centres(cells) * scale + shift
    mixed = _mixed(every, *around, whole)
    skins = tuple(skin_nodes), tuple(skin_borders)
    return CellArrays(
        cells, centres, tile, lenses, neighbours, nodes, ring, plain, every, whole, mixed, *skins
    )


def _parted(levels: SkinNodes, nodes: Ints, ring: tuple[CornerRing, ...]) -> Bools:
    """Whether the two lenses have different levels at both ends of every border, (n, half)."""
    sector = np.array([one.sector for one in ring])
    many, half = len(ring), len(ring) // 2
    k = np.arange(half)
    start, end = nodes[:, k], nodes[:, k + 1]
    return np.asarray(
        (levels.place[start, sector[k]] != levels.place[start, sector[(k + half + 1) % many]])
        & (levels.place[end, sector[k + 1]] != levels.place[end, sector[k + half]])
    )


def _all_sides(borders: Bools, neighbours: Ints) -> Bools:
    """Borders of all sides (n, m), from those of the first half of the sides."""
    half = borders.shape[1]
    away = [(neighbours[:, k + half] >= 0) & borders[neighbours[:, k + half], k] for k in range(half)]
    return np.column_stack([borders, *away])


def _mixed(every: Bools, round_it: Ints, corners: Ints, whole: Bools) -> Bools:
    """Nodes (nodes,) of plain cells at which borders that are not plain end."""
    mixed = np.zeros(len(whole), dtype=np.bool_)
    for cell, corner in zip(round_it.T, corners.T, strict=True):
        mixed |= whole & ~(every[cell, corner] & every[cell, corner - 1])
    return mixed


def _numbers(cells: Ints) -> Callable[[Ints], Ints]:
    """Number of the cell at an index (..., 2); −1 for none."""
    low = cells.min(axis=0) - 2
    table = np.full(tuple(np.ptp(cells, axis=0) + 5), -1, dtype=np.int64)
    table[tuple((cells - low).T)] = np.arange(len(cells))

    def number(index: Ints) -> Ints:
        at = index - low
        inside = ((at >= 0) & (at < table.shape)).all(axis=-1)
        at = np.where(inside[..., None], at, 0)
        return np.where(inside, table[at[..., 0], at[..., 1]], -1)

    return number


def _node(number: Callable[[Ints], Ints], cells: Ints, ring: CornerRing, firsts: list[int]) -> Ints:
    anchor = number(cells + np.array(ring.shift))
    return np.where(anchor >= 0, firsts.index(ring.cells[0][1]) * len(cells) + anchor, -1)


def _sectors(
    number: Callable[[Ints], Ints], cells: Ints, ring: tuple[CornerRing, ...], firsts: list[int]
) -> tuple[Ints, Ints]:
    """Cells round every node (nodes, sectors), −1 for none, and their corners there."""
    round_it, corners = [], []
    for first in firsts:
        around = ring[first].cells
        round_it.append(np.stack([number(cells + np.array(step)) for step, _ in around], axis=1))
        corners.append(np.broadcast_to([corner for _, corner in around], (len(cells), len(around))))
    return np.concatenate(round_it), np.concatenate(corners)


def _plain_cells(count: int, tile: Floats, lenses: tuple[LensArray, ...], merge: float) -> Bools:
    """Which cells (count,) each of the lenses covers, clear of its land and of the other lens."""
    share = np.array(_WITHIN)
    border = np.concatenate([a + share[:, None] * (b - a) for a, b in zip(tile, np.roll(tile, -1, axis=0))])
    x, y = np.concatenate([border * r for r in _WITHIN]).T
    plain = np.ones(count, dtype=np.bool_)
    for chosen in _batches(count):
        heights = []
        for lens in lenses:
            z = lens.of(chosen).heights(x, y)
            heights.append(z)
            good = np.isfinite(z).all(axis=1)
            if lens.land is not None:
                depth = np.ptp(z, axis=1)
                good &= (lens.side * (lens.land - z)).min(axis=1) > np.maximum(_CLEAR * depth, 10.0 * merge)
            plain[chosen] &= good
        if len(heights) == 2:
            between = heights[1] - heights[0]
            plain[chosen] &= between.min(axis=1) > np.maximum(_CLEAR * np.ptp(between, axis=1), 10.0 * merge)
    return plain


def _batches(count: int) -> list[Ints]:
    return [np.arange(at, min(at + ROWS, count)) for at in range(0, count, ROWS)]


def _levels(
    lens: LensArray, tile: Floats, round_it: Ints, corners: Ints, whole: Bools, merge: float
) -> tuple[SkinNodes, Bools]:
    """Levels at the nodes (see `clacad.solid.edge_classes.linked_levels`), and which nodes are saddles."""
    at_corners = lens.heights(*tile.T)
    if lens.alike:
        heights = at_corners[0][corners]
    else:
        heights = at_corners[np.maximum(round_it, 0), corners]
    heights = np.where(whole[:, None], heights, 0.0)
    order = np.argsort(heights, axis=1, kind="stable")
    ordered = np.take_along_axis(heights, order, axis=1)
    cluster = np.zeros(heights.shape, dtype=np.int64)
    cluster[:, 1:] = np.cumsum(np.diff(ordered, axis=1) > merge, axis=1)
    place = np.empty_like(cluster)
    np.put_along_axis(place, order, cluster, axis=1)
    count, z, shift = cluster[:, -1] + 1, np.zeros(heights.shape), 0.0
    saddle = np.zeros(len(heights), dtype=np.bool_)
    for level in range(heights.shape[1]):
        inside = cluster == level
        there = level < count
        low = np.where(there, np.where(inside, ordered, np.inf).min(axis=1), 0.0)
        high = np.where(there, np.where(inside, ordered, -np.inf).max(axis=1), 0.0)
        z[:, level] = 0.5 * (low + high)
        shift = max(shift, float((0.5 * (high - low)).max(initial=0.0)))
        below = place <= level
        changes = (below != np.roll(below, 1, axis=1)).sum(axis=1)
        saddle |= (level < count - 1) & (changes != 2)
    return SkinNodes(place, z, count, shift), saddle


def _border_heights(
    lens: LensArray, tile: Floats, k: int, offset: Floats, left: Ints, right: Ints
) -> tuple[Floats, Floats]:
    """Heights of the lenses on both sides of side k of cells `left`, at places along it."""
    points = tile[k] + _ALONG[:, None] * (tile[(k + 1) % len(tile)] - tile[k])
    own = lens.of(left).heights(*points.T)
    return own, lens.of(right).heights(*(points - offset).T)


def _borders(
    lens: LensArray,
    tile: Floats,
    offsets: list[Floats],
    neighbours: Ints,
    parted: Bools,
    borders: Bools,
    merge: float,
) -> tuple[SkinBorders, Bools]:
    """Compare the lenses along every border; the second result is which borders are plain."""
    usable = np.zeros(borders.shape, dtype=np.bool_)
    stepped, high = np.zeros_like(usable), np.zeros_like(usable)
    apart, merged = 0.0, 0
    for k, offset in enumerate(offsets):
        candidates = np.flatnonzero(borders[:, k])
        for batch in _batches(len(candidates)):
            left = candidates[batch]
            own, other = _border_heights(lens, tile, k, offset, left, neighbours[left, k])
            gap = np.abs(own - other)
            least, most = gap.min(axis=1), gap.max(axis=1)
            one_way = np.abs(np.sign(own - other).sum(axis=1)) == gap.shape[1]
            bent = [np.abs(z[:, 8] - 0.5 * (z[:, 0] + z[:, -1])) for z in (own, other)]
            room = np.maximum(RULED_BELOW * np.maximum(*bent), 2.0 * merge)
            together = most <= merge
            step = one_way & (least > room) & parted[left, k]
            usable[left, k] = together | step
            stepped[left, k] = step
            high[left, k] = (own - other)[:, 8] > 0.0
            apart = max(apart, float(np.where(together, most, 0.0).max(initial=0.0)))
            merged += int(np.broadcast_to(together & (most > 1e-12), left.shape).sum())
    return SkinBorders(stepped, high, apart, merged), usable


def _clear_of_the_other(
    lenses: tuple[LensArray, ...],
    tile: Floats,
    offsets: list[Floats],
    neighbours: Ints,
    borders: Bools,
    merge: float,
) -> Bools:
    """Whether along every border both fronts lie below both backs."""
    clear = np.zeros(borders.shape, dtype=np.bool_)
    for k, offset in enumerate(offsets):
        candidates = np.flatnonzero(borders[:, k])
        for batch in _batches(len(candidates)):
            left = candidates[batch]
            front, back = (
                _border_heights(lens, tile, k, offset, left, neighbours[left, k]) for lens in lenses
            )
            clear[left, k] = (np.minimum(*back) - np.maximum(*front)).min(axis=1) > 10.0 * merge
    return clear
