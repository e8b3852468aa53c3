"""Borders and cells of one tiling, described to `Shells` by index arithmetic: faces, walls and zones inside a
seam.

Lengths in mm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats
from clacad.sheet.pattern import Step
from clacad.solid.cell_arrays import CellWriter, SharedParts, cell_arrays
from clacad.solid.edge_classes import Levels, Plane, Post, SegmentClass, linked_levels, segment_class
from clacad.solid.node_sectors import Corner, Nodes, State, Touch
from clacad.solid.shells import Loop, LoopEdge, Segment, Shells, reverse
from clacad.solid.wall_segments import TOLERANCE, Column, column_of_side, segment_shape, zone_columns

if TYPE_CHECKING:
    from clacad.sheet.lattice import Lattice
    from clacad.solid.face_pattern import Region
    from clacad.solid.outline_path import Path
    from clacad.solid.rational_conics import Arc, LensArray
    from clacad.solid.repeated_cell import Cell, CellFace


@dataclass(frozen=True, eq=False)
class Layer:
    """Cells of one tiling between two faces: a whole body, or half of a displaced slab.

    shift : (2,), mm. Displacement of the tiling's cells against the lattice.
    outside : The land between the cells and the outline.
    breaks : tuple of (n,) parameters, or None
        Per class of borders between two cells: parameters at which anything changes, from the cell complex.
    own : The cell with an index, in a non-uniform sheet; `cell` is then one of them, of the same tile.
    pattern : Of the layer's array, if it has its own pitch.
    lenses : Lens faces of all cells, if they may be described in batches (`clacad.solid.cell_arrays`).
    """

    cell: Cell
    shift: Floats
    outside: Column | None
    breaks: tuple[Floats, ...] | None = None
    own: Callable[[Step], Cell] | None = None
    pattern: Lattice | None = None
    lenses: tuple[LensArray, ...] = ()

    def at(self, index: Step) -> Cell:
        """The cell with an index."""
        return self.cell if self.own is None else self.own(index)

    def places(self, lattice: Lattice) -> Lattice:
        """Positions of the layer's cells about its own middle; `lattice` defines which cells exist."""
        return lattice if self.pattern is None else self.pattern


class Surround(NamedTuple):
    """Surroundings of the cells of a body.

    path : The outline.
    owner : Owner of the walls of the land out to the outline; −1 without an outline.
    hollow : Describe only the land, without the cells themselves.
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

    lattice : In design units; `scale` mm per unit.
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

    def describe_plain(self, lattice: Lattice, writer: CellWriter) -> NDArray[np.bool_]:
        """Describe the plain cells of a lattice in arrays; which of its cells (n,) they are."""
        shells, layer = self._shells, self._layer
        found = cell_arrays(lattice, self._lattice, self._scale, layer.shift, layer.lenses, shells.merge)
        steps: list[Step] = [(i, j) for i, j in found.cells.tolist()]
        shared = SharedParts(
            lambda cell, corner: self.nodes.at(steps[cell], corner).node,
            shells.vertex,
            shells.vertical,
            lambda cell, k, face: self.at(steps[cell], k).all_runs(face),
        )
        owners = [self.owner(step) if there else -1 for step, there in zip(steps, found.plain.tolist())]
        for k in range(len(found.tile) // 2):
            left = np.flatnonzero(found.borders[:, k])
            for one, other in zip(left.tolist(), found.neighbours[left, k].tolist()):
                shells.join(owners[one], owners[other])
        cells, faces = writer.cells(found, shared)
        for cell, face in zip(cells.tolist(), faces.tolist()):
            shells.faces[owners[cell]].append(face)
        found.count(shells.counts)
        return found.plain

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


RimEdges = tuple[list[int], list[int]]  # edges of a chain, vertices of a chain


class Columns:
    """One tiling of a body, described to `Shells`.

    shells, layer, lattice, scale, around : As for `Borders`.
    """

    def __init__(
        self, shells: Shells, layer: Layer, lattice: Lattice, scale: float, around: Surround
    ) -> None:
        self.shells, self.cell, self.lattice = shells, layer.cell, lattice
        self._layer, self._scale, self._hollow = layer, scale, around.hollow
        self._borders = Borders(shells, layer, lattice, scale, around)
        self._lands: dict[int, int] = {}
        self._repeat(layer.cell)

    def _repeat(self, cell: Cell) -> None:
        """Compute common data of all cells like this one: patches, sides of an island, curves of its rims."""
        self._present = cell
        self._rim_arcs: dict[tuple[object, ...], Arc] = {}
        self._rim_curves: dict[tuple[int, int, int], Arc] = {}
        self._patches = [None if face.lens is None else face.lens.patch for face in cell.faces]
        self._zones = self._zone_classes() if cell.island and not self._hollow else []

    @property
    def touches(self) -> list[Touch]:
        """The nodes that lie on the outline."""
        return self._borders.nodes.touches

    @property
    def touching(self) -> dict[int, tuple[Loop, Loop]]:
        """Borders on the outline: identity of the node at which they start → edges of front and back face."""
        return self._borders.touching

    def outside_face(self, face: int) -> CellFace:
        """The flat face around the cells (the plane of a plane face if there is no outline)."""
        outside = self._layer.outside
        return self.cell.faces[face] if outside is None else outside.faces[face]

    def describe(self) -> None:
        """Describe all cells, borders and nodes."""
        cells = self.lattice.cells()
        centres = self._layer.places(self.lattice).centres(cells) * self._scale + self._layer.shift
        writer = self.shells.writer
        if self._layer.lenses and not self._hollow and isinstance(writer, CellWriter):
            rest = ~self._borders.describe_plain(self.lattice, writer)
            cells, centres = cells[rest], centres[rest]
        for (i, j), centre in zip(cells.tolist(), centres):
            if not self._hollow:
                if self._layer.own is not None:
                    self._repeat(self._layer.at((i, j)))
                self._describe_cell((i, j), np.append(centre, 0.0))
            elif self._borders.bare((i, j)):
                for k in range(len(self.cell.tile)):
                    self._borders.at((i, j), k)

    # -- islands: the zone inside a seam -----------------------------------------------------------

    def _zone_classes(self) -> list[tuple[SegmentClass, Levels]]:
        """The sides of an island's zone, and the levels at the corner where each begins."""
        cell, merge = self._present, self.shells.merge
        columns = [zone_columns(cell, k) for k in range(len(cell.tile))]
        levels = []
        for k, pair in enumerate(columns):
            x, y = cell.zone[k][:, None]
            heights = [[float(c.faces[f].height(c.kind(f, 0.0), x, y)[0]) for f in (0, 1)] for c in pair]
            levels.append(linked_levels(np.array(heights), merge))
        classes = []
        for k, pair in enumerate(columns):
            after = (k + 1) % len(cell.tile)
            shape = segment_shape(cell.zone[k], cell.zone[after], pair, merge)
            # Sectors at a corner: 0 inside, 1 outside; the ray along side k lies between 1 and 0 at its
            # start.
            start, end = Post(levels[k], (0, 1), (-1, 1)), Post(levels[after], (0, 1), (0, -1))
            classes.append((segment_class(shape, pair, start, end, merge), levels[k]))
        return classes

    def _zone(self, centre: Floats, owner: int) -> list[Sided]:
        nodes = [
            self.shells.node(centre + np.append(corner, 0.0), levels)
            for corner, (_, levels) in zip(self._present.zone, self._zones)
        ]
        ends = zip(nodes, nodes[1:] + nodes[:1])
        made = [
            self.shells.segment(kind, centre, pair, (owner, owner))
            for (kind, _), pair in zip(self._zones, ends)
        ]
        return [Sided(segment, 0, True) for segment in made]

    # -- faces ------------------------------------------------------------------------------------

    def _describe_cell(self, index: Step, centre: Floats) -> None:
        cell = self._present
        borders = [self._borders.at(index, k) for k in range(len(cell.tile))]
        owner = self._borders.owner(index)
        zone = self._zone(centre, owner) if cell.island else borders
        shared: dict[int, RimEdges] = {}
        for f, face in enumerate(cell.faces):
            if face.pattern is None:
                continue
            rims = shared if cell.one_rim else {}
            self._zone_faces(f, face, centre, owner, zone, rims)
            if cell.island:
                outer = [use for side in borders for use in side.all_runs(f)]
                inner = [use for side in zone for use in Sided(side.segment, 1, True).all_runs(f)]
                self._land_face(f, face, owner, [outer, reverse(inner)])

    def _zone_faces(
        self, f: int, face: CellFace, centre: Floats, owner: int, zone: list[Sided], rims: dict[int, RimEdges]
    ) -> None:
        assert face.pattern is not None
        surface = -1
        for region in face.pattern.regions:
            loops = [self._loop(f, face, loop, region, centre, zone, rims) for loop in region.loops]
            if region.kind == "land":
                self._land_face(f, face, owner, loops)
                continue
            if surface < 0:
                patch = self._patches[f]
                assert patch is not None
                surface = self.shells.writer.surface(patch, centre)
            loops = loops if face.side < 0 else [reverse(loop) for loop in loops]
            self.shells.face(owner, surface, face.side < 0, loops, "lens")

    def _land_face(self, f: int, face: CellFace, owner: int, loops: list[Loop]) -> None:
        assert face.level is not None
        if f not in self._lands:
            plane = Plane(
                np.array([0.0, 0.0, face.level]), np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
            )
            self._lands[f] = self.shells.writer.surface(plane, np.zeros(3))
        bare = [[LoopEdge(use.edge, use.forward) for use in loop] for loop in loops]
        bare = bare if face.side < 0 else [reverse(loop) for loop in bare]
        self.shells.face(owner, self._lands[f], face.side < 0, bare, "plane" if face.optical else "land")

    def _loop(
        self,
        f: int,
        face: CellFace,
        items: tuple[tuple[str, int, int], ...],
        region: Region,
        centre: Floats,
        zone: list[Sided],
        rims: dict[int, RimEdges],
    ) -> Loop:
        """Edges of one loop of a region, counter-clockwise seen from +z."""
        loop: Loop = []
        for what, number, detail in items:
            if what == "run":
                loop += zone[number].run(f, detail)
                continue
            if number not in rims:
                rims[number] = self._rim(f, face, number, centre, zone)
            edges = rims[number][0]
            curves = [
                self._rim_curve(f, face, number, n) if region.kind == "lens" else None
                for n in range(len(edges))
            ]
            uses = [LoopEdge(edge, True, curve) for edge, curve in zip(edges, curves)]
            loop += uses if detail > 0 else reverse(uses)
        return loop

    def _rim(self, f: int, face: CellFace, number: int, centre: Floats, zone: list[Sided]) -> RimEdges:
        """Make the edges of a rim between its vertices on the zone's sides."""
        assert face.pattern is not None
        chain = face.pattern.chains[number]
        arcs = face.rims[number]
        starts = [arc.poles[0] for arc in arcs]
        vertices, heights = [], []
        for n, point in enumerate([*starts, arcs[-1].poles[-1]] if chain.first else starts):
            name = chain.first if n == 0 else chain.last if n == len(arcs) else None
            if name is None:
                vertices.append(self.shells.point(centre + point))
                heights.append(float(point[2]))
            else:
                vertex, z = _rim_end(self, f, face.pattern.ends[name[1]], zone)
                vertices.append(vertex)
                heights.append(z)
        edges = []
        for n, arc in enumerate(arcs):
            after = (n + 1) % len(vertices)
            shift = max(abs(heights[n] - arc.poles[0, 2]), abs(heights[after] - arc.poles[-1, 2]))
            key = (f, number, n, heights[n], heights[after])
            meets = self._rim_arcs.setdefault(key, arc.with_ends(heights[n], heights[after]))
            tolerance = 1.2 * max(shift, self._present.misfit) + TOLERANCE
            edges.append(self.shells.edge(vertices[n], vertices[after], meets, centre, tolerance))
        return edges, vertices

    def _rim_curve(self, f: int, face: CellFace, number: int, n: int) -> Arc:
        key = (f, number, n)
        if key not in self._rim_curves:
            assert face.lens is not None
            self._rim_curves[key] = face.lens.parameters(face.rims[number][n])
        return self._rim_curves[key]


def _rim_end(columns: Columns, f: int, end: tuple[int, float], zone: list[Sided]) -> tuple[int, float]:
    """The vertex on a zone side at which a rim ends, and its height in the cell frame."""
    k, t = end
    segment, column, forward = zone[k]
    station = int(np.argmin(np.abs(segment.kind.shape.stations - (t if forward else 1.0 - t))))
    post = segment.kind.posts[station]
    level = post.levels.place[post.sectors[column]][f]
    assert level is not None
    return columns.shells.vertex(segment.nodes[station], level), post.levels.z[level]
