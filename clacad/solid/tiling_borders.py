"""The borders of the cells of one tiling, described to `Shells` by index arithmetic. Lengths in mm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from clacad.base.types import Floats
from clacad.sheet.lattice import Lattice
from clacad.sheet.pattern import Step
from clacad.solid.edge_classes import Post, SegmentClass, segment_class
from clacad.solid.node_sectors import Corner, Nodes, State
from clacad.solid.outline_path import Path
from clacad.solid.repeated_cell import Cell
from clacad.solid.shells import Loop, LoopEdge, Segment, Shells
from clacad.solid.wall_segments import Column, column_of_side, segment_shape


@dataclass(frozen=True, eq=False)
class Layer:
    """Cells of one tiling between two faces: a whole body, or half of a displaced slab.

    Attributes
    ----------
    cell : Cell
    shift : (2,), mm
        Displacement of the tiling's cells against the lattice.
    outside : Column or None
        The land between the cells and the outline.
    breaks : tuple of (n,) parameters, or None
        Per class of borders between two cells: parameters at which anything changes, from the cell complex.
    own : callable or None
        The cell with an index, in a non-uniform sheet; `cell` is then one of them, of the same tile.
    pattern : Lattice or None
        Of the layer's array, if it has its own pitch.
    """

    cell: Cell
    shift: Floats
    outside: Column | None
    breaks: tuple[Floats, ...] | None = None
    own: Callable[[Step], Cell] | None = None
    pattern: Lattice | None = None

    def at(self, index: Step) -> Cell:
        """The cell with an index."""
        return self.cell if self.own is None else self.own(index)

    def places(self, lattice: Lattice) -> Lattice:
        """Positions of the layer's cells about its own middle; `lattice` defines which cells exist."""
        return lattice if self.pattern is None else self.pattern


class Surround(NamedTuple):
    """Surroundings of the cells of a body.

    path : Path or None
        The outline.
    owner : int
        Owner of the walls of the land out to the outline; −1 without an outline.
    hollow : bool
        Describe only the land, without the cells themselves.
    """

    path: Path | None
    owner: int
    hollow: bool


class Sided(NamedTuple):
    """A segment as seen from one of its columns; `forward`: it runs counter-clockwise around the cell."""

    segment: Segment
    column: int
    forward: bool

    def all_runs(self, face: int) -> Loop:
        """The edges of a face (0 front, 1 back) of the column all along the segment."""
        runs = self.segment.kind.shape.runs[self.column][face]
        return [use for number in range(len(runs)) for use in self.run(face, number)]

    def run(self, face: int, number: int) -> Loop:
        """The edges of one stretch (counted counter-clockwise) of a face of the column along the segment."""
        kind = self.segment.kind
        runs = kind.shape.runs[self.column][face]
        pieces = runs[number] if self.forward else runs[len(runs) - 1 - number][::-1]
        return [
            LoopEdge(self.segment.edges[i][n], self.forward, use.parameters)
            for i in pieces
            for n, edge in enumerate(kind.pieces[i].edges)
            for use in edge.uses
            if use.column == self.column and use.face == face
        ]


class Borders:
    """All borders of one tiling, described on first use.

    Parameters
    ----------
    shells : Shells
    layer : Layer
    lattice : Lattice
        In design units; `scale` mm per unit.
    around : Surround

    Attributes
    ----------
    nodes : Nodes
    touching : dict
        Borders on the outline: identity of the node at which they start → edges of front and back face.
    """

    def __init__(
        self, shells: Shells, layer: Layer, lattice: Lattice, scale: float, around: Surround
    ) -> None:
        self.touching: dict[int, tuple[Loop, Loop]] = {}
        self._shells, self._layer, self._lattice = shells, layer, layer.places(lattice)
        self._scale, self._around = scale, around
        self._kept = {(int(i), int(j)) for i, j in lattice.cells()}
        self.nodes = Nodes(
            shells, layer.cell, lattice, self.centre, self._state, layer.outside, around.path, layer.own
        )
        self._classes: dict[tuple[object, ...], SegmentClass] = {}
        self._segments: dict[tuple[int, int, int], Segment] = {}
        self._owners: dict[Step, int] = {}

    def centre(self, index: Step) -> Floats:
        """Centre (2,) of the cell with an index, mm."""
        return np.asarray(self._lattice.centres(np.array(index)) * self._scale + self._layer.shift)

    def bare(self, index: Step) -> bool:
        """Whether a neighbour of a cell is not kept."""
        return not all((index[0] + di, index[1] + dj) in self._kept for di, dj in self._lattice.steps)

    def owner(self, index: Step) -> int:
        """Owner of the walls of a cell's column; −1: none."""
        state = self._state(index)
        if state != "cell":
            return self._around.owner if state == "outside" else -1
        if index not in self._owners:
            self._owners[index] = self._shells.owner()
        return self._owners[index]

    def at(self, index: Step, k: int) -> Sided:
        """The segment along side k of a cell, as seen from that cell."""
        half = len(self._lattice.steps) // 2
        step = self._lattice.steps[k]
        column = 0 if k < half else 1
        left = index if column == 0 else (index[0] + step[0], index[1] + step[1])
        key = (*left, k % half)
        if key not in self._segments:
            self._segments[key] = self._make(left, k % half)
        return Sided(self._segments[key], column, column == 0)

    def _state(self, index: Step) -> State:
        if index in self._kept:
            return "empty" if self._around.hollow else "cell"
        return "outside" if self._layer.outside is not None else "empty"

    def _make(self, left: Step, k: int) -> Segment:
        """Make the segment along side k of a cell that is on its left."""
        step = self._lattice.steps[k]
        right = (left[0] + step[0], left[1] + step[1])
        a, b = self.nodes.at(left, k), self.nodes.at(left, (k + 1) % len(self._lattice.steps))
        # Counter-clockwise around node a the right cell comes just before the left one, around b just after.
        states = (a.sectors.states[a.first], a.sectors.states[a.before])
        kind = self._known_class(left, k, states, a, b)
        owners = (
            -1 if states[0] == "beyond" else self.owner(left),
            -1 if states[1] == "beyond" else self.owner(right),
        )
        offset = np.append(self.centre(left), 0.0)
        bare = "beyond" in states
        made = self._shells.segment(kind, offset, (a.node, b.node), owners, bare)
        if bare:
            self._touch(made, states.index("beyond") ^ 1)
        return made

    def _touch(self, made: Segment, column: int) -> None:
        """Record a border along which a cell (the segment's `column`) touches the outline."""
        hollow = self._around.hollow
        if not hollow:
            self._shells.join(made.owners[column], self._around.owner)
        side = Sided(made, column, column == 0)
        start = made.nodes[0 if column == 0 else -1]
        self.touching[id(start)] = ([], []) if hollow else (side.all_runs(0), side.all_runs(1))

    def _known_class(
        self, left: Step, k: int, states: tuple[State, State], a: Corner, b: Corner
    ) -> SegmentClass:
        """The class of a segment: one for all in a uniform sheet, else its own."""
        if self._layer.own is not None:
            return self._class(left, k, states, a, b)
        key = (k, states, a.sectors, b.sectors)
        if key not in self._classes:
            self._classes[key] = self._class(left, k, states, a, b)
        return self._classes[key]

    def _class(self, left: Step, k: int, states: tuple[State, State], a: Corner, b: Corner) -> SegmentClass:
        """The class of segments along side k between columns in these states, from node a to node b."""
        start = Post(a.node.levels, (a.first, a.before), (-1, a.before))
        end = Post(b.node.levels, (b.last, b.after), (b.last, -1))
        tile, merge = self._layer.cell.tile, self._shells.merge
        step = self._lattice.steps[k]
        right = (left[0] + step[0], left[1] + step[1])
        offset = np.array(self._lattice.offset(*step)) * self._scale
        columns = (
            self._column(left, states[0], k, np.zeros(2), False),
            self._column(right, states[1], k + len(tile) // 2, offset, True),
        )
        breaks = (
            self._layer.breaks[k] if states == ("cell", "cell") and self._layer.breaks is not None else None
        )
        shape = segment_shape(tile[k], tile[(k + 1) % len(tile)], columns, merge, breaks)
        return segment_class(shape, columns, start, end, merge)

    def _column(self, index: Step, state: State, k: int, offset: Floats, against: bool) -> Column | None:
        if state in ("empty", "beyond"):
            return None
        return (
            self._layer.outside
            if state == "outside"
            else column_of_side(self._layer.at(index), k, offset, against)
        )
