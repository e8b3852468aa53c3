"""Corners of the cells of a tiling: the sectors around each, and the vertices on its vertical line.

Around a corner on the outline there are also sectors beyond the outline; the outline may then cut a missing
cell's sector in two. Lengths in mm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import atan2, pi, tau
from typing import TYPE_CHECKING, Literal

import numpy as np

from clacad.base.types import Floats
from clacad.sheet.pattern import NodeCells, Step, node_cells
from clacad.solid.edge_classes import Levels, linked_levels
from clacad.solid.wall_segments import Column, column_of_side

if TYPE_CHECKING:
    from clacad.sheet.lattice import Lattice
    from clacad.solid.outline_path import Path
    from clacad.solid.repeated_cell import Cell
    from clacad.solid.shells import NodeVertices, Shells

State = Literal["cell", "outside", "empty", "beyond"]


@dataclass(frozen=True, slots=True)
class CornerRing:
    """The cells around one corner of a cell, counter-clockwise from the node's canonical first cell.

    cells : (((di, dj), corner), ...). Relative to the canonical cell.
    shift : (di, dj). From the given cell to the canonical cell.
    sector : Index of the given cell in `cells`.
    """

    cells: NodeCells
    shift: Step
    sector: int


@dataclass(frozen=True, slots=True)
class Sectors:
    """Sectors around a node: states counter-clockwise, and the sectors of each cell of the ring.

    `cells[s]` = (first, last) sector of cell s of the ring; ray r lies between sectors r and r + 1.
    """

    states: tuple[State, ...]
    corners: tuple[int, ...]
    cells: tuple[tuple[int, int], ...]


@dataclass(frozen=True, eq=False, slots=True)
class Touch:
    """A node on the outline.

    position : (side, parameter) on the path
    out, back : rays along the outline, forwards and backwards
    leaving, arriving : sectors inside the outline next to those rays
    """

    node: NodeVertices
    position: tuple[int, float]
    out: int
    back: int
    leaving: int
    arriving: int


@dataclass(frozen=True, slots=True)
class Corner:
    """A node as seen from one of its cells."""

    node: NodeVertices
    sectors: Sectors
    cell: int

    @property
    def first(self) -> int:
        """The cell's first sector."""
        return self.sectors.cells[self.cell][0]

    @property
    def last(self) -> int:
        """The cell's last sector."""
        return self.sectors.cells[self.cell][1]

    @property
    def before(self) -> int:
        """The sector clockwise of the cell; also the ray between the two."""
        return (self.first - 1) % len(self.sectors.states)

    @property
    def after(self) -> int:
        """The sector counter-clockwise of the cell."""
        return (self.last + 1) % len(self.sectors.states)


def rings(lattice: Lattice) -> list[CornerRing]:
    """Return, for every corner of a tile, the ring of cells that meet there.

    It begins at the least corner.
    """
    found: dict[int, CornerRing] = {}
    for round_node in node_cells(lattice):
        first = min(range(len(round_node)), key=lambda i: round_node[i][1])
        order = round_node[first:] + round_node[:first]
        (i, j), _ = order[0]
        cells = tuple(((di - i, dj - j), corner) for (di, dj), corner in order)
        for sector, ((di, dj), corner) in enumerate(cells):
            found[corner] = CornerRing(cells, (-di, -dj), sector)
    return [found[corner] for corner in range(len(lattice.steps))]


class Nodes:
    """All nodes of one tiling, created on first use.

    shells, cell, lattice
    centre : Centre (2,) of the cell with an index, mm.
    state : State of the cell with an index.
    outside : The land around the cells.
    path : The outline.
    own : The cell with an index, in a non-uniform sheet.
    """

    def __init__(
        self,
        shells: Shells,
        cell: Cell,
        lattice: Lattice,
        centre: Callable[[Step], Floats],
        state: Callable[[Step], State],
        outside: Column | None,
        path: Path | None,
        own: Callable[[Step], Cell] | None = None,
    ) -> None:
        self.touches: list[Touch] = []
        self._shells, self._cell, self._rings = shells, cell, rings(lattice)
        self._centre, self._state, self._outside, self._path = centre, state, outside, path
        self._own = own
        self._levels: dict[tuple[int, tuple[State, ...]], Levels] = {}
        self._made: dict[tuple[int, int, int], tuple[NodeVertices, Sectors]] = {}

    def at(self, index: Step, corner: int) -> Corner:
        """The node at a corner of the cell with an index (kept or not)."""
        ring = self._rings[corner]
        first = ring.cells[0][1]
        key = (index[0] + ring.shift[0], index[1] + ring.shift[1], first)
        if key not in self._made:
            self._made[key] = self._make((key[0], key[1]), ring)
        node, sectors = self._made[key]
        return Corner(node, sectors, ring.sector)

    def _make(self, anchor: Step, ring: CornerRing) -> tuple[NodeVertices, Sectors]:
        states = tuple(self._state((anchor[0] + a, anchor[1] + b)) for (a, b), _ in ring.cells)
        corners = tuple(corner for _, corner in ring.cells)
        place = self._centre(anchor) + self._cell.tile[corners[0]]
        origin = np.append(place, 0.0)
        position = None
        if self._path is not None and "outside" in states:
            position = self._path.position(place)
        round_it = tuple((anchor[0] + a, anchor[1] + b) for (a, b), _ in ring.cells)
        if position is not None:
            return self._touch(origin, position, states, corners, round_it)
        sectors = Sectors(states, corners, tuple((s, s) for s in range(len(states))))
        if self._own is not None:
            return self._shells.node(origin, self._levels_round(sectors, round_it)), sectors
        key = (corners[0], states)
        if key not in self._levels:
            self._levels[key] = self._levels_round(sectors, round_it)
        return self._shells.node(origin, self._levels[key]), sectors

    def _touch(
        self,
        origin: Floats,
        position: tuple[int, float],
        states: tuple[State, ...],
        corners: tuple[int, ...],
        round_it: tuple[Step, ...],
    ) -> tuple[NodeVertices, Sectors]:
        assert self._path is not None
        sectors = self._cut(states, corners, self._path.rays(*position))
        node = self._shells.node(origin, self._levels_round(sectors, round_it))
        count = len(sectors.states)
        beyond = [state == "beyond" for state in sectors.states]
        out = next(r for r in range(count) if beyond[r] and not beyond[(r + 1) % count])
        back = next(r for r in range(count) if not beyond[r] and beyond[(r + 1) % count])
        self.touches.append(Touch(node, position, out, back, (out + 1) % count, back))
        return node, sectors

    def _cut(self, states: tuple[State, ...], corners: tuple[int, ...], rays: tuple[float, float]) -> Sectors:
        """Cut the sectors of missing cells by the outline's two rays."""
        tile = self._cell.tile
        out, back = rays
        found: list[State] = []
        sides: list[int] = []
        cells = []
        for state, corner in zip(states, corners):
            first = len(found)
            if state != "outside":
                found.append(state)
            else:
                ahead, behind = tile[(corner + 1) % len(tile)] - tile[corner], tile[corner - 1] - tile[corner]
                start = atan2(ahead[1], ahead[0])
                width = (atan2(behind[1], behind[0]) - start) % tau
                cuts = sorted(
                    a for a in ((out - start) % tau, (back - start) % tau) if 1e-6 < a < width - 1e-6
                )
                stops = [0.0, *cuts, width]
                for low, high in zip(stops[:-1], stops[1:]):
                    way = start + 0.5 * (low + high)
                    inside = (way - out) % tau < ((back - out) % tau or pi)
                    found.append("outside" if inside else "beyond")
            sides += [corner] * (len(found) - first)
            cells.append((first, len(found) - 1))
        return Sectors(tuple(found), tuple(sides), tuple(cells))

    def _levels_round(self, sectors: Sectors, round_it: tuple[Step, ...]) -> Levels:
        """Levels on the line of a node, from the columns of its sectors; `round_it`: cells of the ring."""
        whose = {
            s: step for step, (first, last) in zip(round_it, sectors.cells) for s in range(first, last + 1)
        }
        heights = np.full((len(sectors.states), 2), np.nan)
        for s, (state, corner) in enumerate(zip(sectors.states, sectors.corners)):
            if state in ("empty", "beyond"):
                continue
            cell = self._own(whose[s]) if self._own is not None and state == "cell" else self._cell
            column = column_of_side(cell, corner, np.zeros(2), False)
            if state == "outside":
                assert self._outside is not None
                column = self._outside
            kinds = [column.kind(f, 0.0) for f in (0, 1)]
            if "none" in kinds:
                continue
            x, y = self._cell.tile[corner][:, None]
            heights[s] = [float(column.faces[f].height(kinds[f], x, y)[0]) for f in (0, 1)]
        return linked_levels(heights, self._shells.merge)
