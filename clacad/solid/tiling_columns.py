"""The cells of one tiling, described to `Shells`: nodes, borders and faces by index arithmetic. Lengths in mm."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clacad.base.types import Floats
from clacad.sheet.lattice import Lattice
from clacad.solid.edge_classes import Plane, Post, SegmentClass, segment_class
from clacad.solid.face_pattern import Region
from clacad.solid.node_sectors import Index, Nodes, State, Touch
from clacad.solid.outline_path import Path
from clacad.solid.rational_conics import Arc
from clacad.solid.repeated_cell import Cell, CellFace
from clacad.solid.shells import Loop, LoopEdge, Segment, Shells, reverse
from clacad.solid.vertical_lines import Levels, linked_levels
from clacad.solid.wall_segments import (
    TOLERANCE,
    Column,
    column_of_side,
    segment_shape,
    zone_columns,
)

Rim = tuple[list[int], list[int]]  # edges of a chain, vertices of a chain


class Sided(NamedTuple):
    """A segment seen from one of its columns; `forward`: the segment runs counter-clockwise round the cell."""

    segment: Segment
    column: int
    forward: bool


class Columns:
    """One tiling of a body, described to `Shells`.

    Parameters
    ----------
    shells : Shells
    cell : Cell
    lattice : Lattice
        In design units; `scale` mm per unit.
    shift : (2,), mm
        Displacement of the tiling's cells against the lattice.
    outside : Column or None
        The land round the cells.
    outside_owner : int
        Whose faces the walls of that land are.
    hollow : bool
        Describe only the land round the cells, the cells themselves left out.
    breaks : tuple of (n,) parameters, or None
        Per class of borders between two cells: where anything changes, from the cell complex.
    path : Path or None
        The outline.

    Attributes
    ----------
    touching : dict
        Borders that lie on the outline: identity of the node they start at → edges of front and back face.
    """

    def __init__(self, shells: Shells, cell: Cell, lattice: Lattice, scale: float, shift: Floats,
                 outside: Column | None = None, outside_owner: int = -1, hollow: bool = False,
                 breaks: tuple[Floats, ...] | None = None, path: Path | None = None) -> None:  # fmt: skip
        self.shells, self.cell, self.lattice = shells, cell, lattice
        self.touching: dict[int, tuple[Loop, Loop]] = {}
        self._scale, self._shift = scale, shift
        self._outside, self._outside_owner, self._hollow = outside, outside_owner, hollow
        self._breaks = breaks
        self._sides = len(cell.tile)
        self._nodes = Nodes(shells, cell, lattice, self._centre, self._state, outside, path)
        self._classes: dict[tuple[object, ...], SegmentClass] = {}
        self._segments: dict[tuple[int, int, int], Segment] = {}
        self._owners: dict[Index, int] = {}
        self._rim_arcs: dict[tuple[object, ...], Arc] = {}
        self._rim_curves: dict[tuple[int, int, int], Arc] = {}
        self._lands: dict[int, int] = {}
        self._patches = [None if face.lens is None else face.lens.patch for face in cell.faces]
        self._zones = self._zone_classes() if cell.island and not hollow else []
        self._kept: set[Index] = set()

    @property
    def touches(self) -> list[Touch]:
        """The nodes that lie on the outline."""
        return self._nodes.touches

    def outside_face(self, face: int) -> CellFace:
        """The flat face round the cells (the plane of a plane face where there is no outline)."""
        return self.cell.faces[face] if self._outside is None else self._outside.faces[face]

    def describe(self) -> None:
        """Describe all cells, borders and nodes."""
        cells = self.lattice.cells()
        self._kept = {(int(i), int(j)) for i, j in cells}
        centres = self.lattice.centres(cells) * self._scale + self._shift
        for (i, j), centre in zip(cells.tolist(), centres):
            if not self._hollow:
                self._describe_cell((i, j), np.append(centre, 0.0))
            elif not all((i + di, j + dj) in self._kept for di, dj in self.lattice.steps):
                for k in range(self._sides):
                    self._border((i, j), k)

    # -- states -----------------------------------------------------------------------------------

    def _state(self, index: Index) -> State:
        if index in self._kept:
            return "empty" if self._hollow else "cell"
        return "outside" if self._outside is not None else "empty"

    def _owner(self, index: Index) -> int:
        state = self._state(index)
        if state != "cell":
            return self._outside_owner if state == "outside" else -1
        if index not in self._owners:
            self._owners[index] = self.shells.owner()
        return self._owners[index]

    def _column(self, state: State, k: int, offset: Floats, against: bool) -> Column | None:
        if state in ("empty", "beyond"):
            return None
        return self._outside if state == "outside" else column_of_side(self.cell, k, offset, against)

    def _centre(self, index: Index) -> Floats:
        return np.asarray(self.lattice.centres(np.array(index)) * self._scale + self._shift)

    # -- borders ----------------------------------------------------------------------------------

    def _border(self, index: Index, k: int) -> Sided:
        """The segment along side k of a cell, seen from that cell."""
        half = self._sides // 2
        step = self.lattice.steps[k]
        column = 0 if k < half else 1
        left = index if column == 0 else (index[0] + step[0], index[1] + step[1])
        key = (*left, k % half)
        if key not in self._segments:
            self._segments[key] = self._make_border(left, k % half)
        return Sided(self._segments[key], column, column == 0)

    def _make_border(self, left: Index, k: int) -> Segment:
        step = self.lattice.steps[k]
        right = (left[0] + step[0], left[1] + step[1])
        a, b = self._nodes.at(left, k), self._nodes.at(left, (k + 1) % self._sides)
        # Counter-clockwise round node a the right cell comes just before the left one, round b just after.
        states = (a.sectors.states[a.first], a.sectors.states[a.before])
        key = (k, states, a.sectors, b.sectors)
        if key not in self._classes:
            start = Post(a.node.levels, (a.first, a.before), (-1, a.before))
            end = Post(b.node.levels, (b.last, b.after), (b.last, -1))
            self._classes[key] = self._border_class(k, states, start, end)
        owners = (
            -1 if states[0] == "beyond" else self._owner(left),
            -1 if states[1] == "beyond" else self._owner(right),
        )
        offset = np.append(self._centre(left), 0.0)
        bare = "beyond" in states
        made = self.shells.segment(self._classes[key], offset, (a.node, b.node), owners, bare)
        if bare:  # the cell touches the outline along this border
            column = states.index("beyond") ^ 1
            if not self._hollow:
                self.shells.join(owners[column], self._outside_owner)
            side = Sided(made, column, column == 0)
            start_node = a.node if column == 0 else b.node
            self.touching[id(start_node)] = (
                ([], []) if self._hollow else (self._all_runs(side, 0), self._all_runs(side, 1))
            )
        return made

    def _border_class(self, k: int, states: tuple[State, State], start: Post, end: Post) -> SegmentClass:
        offset = np.array(self.lattice.offset(*self.lattice.steps[k])) * self._scale
        opposite = k + self._sides // 2
        columns = (
            self._column(states[0], k, np.zeros(2), False),
            self._column(states[1], opposite, offset, True),
        )
        a, b = self.cell.tile[k], self.cell.tile[(k + 1) % self._sides]
        shared = states == ("cell", "cell") and self._breaks is not None
        breaks = self._breaks[k] if shared and self._breaks is not None else None
        shape = segment_shape(a, b, columns, self.shells.merge, breaks)
        return segment_class(shape, columns, start, end, self.shells.merge)

    # -- islands: the zone inside a seam -----------------------------------------------------------

    def _zone_classes(self) -> list[tuple[SegmentClass, Levels]]:
        """The sides of an island's zone, and the levels at the corner where each begins."""
        cell, merge = self.cell, self.shells.merge
        columns = [zone_columns(cell, k) for k in range(self._sides)]
        levels = []
        for k, pair in enumerate(columns):
            x, y = cell.zone[k][:, None]
            heights = [[float(c.faces[f].height(c.kind(f, 0.0), x, y)[0]) for f in (0, 1)] for c in pair]
            levels.append(linked_levels(np.array(heights), merge))
        classes = []
        for k, pair in enumerate(columns):
            after = (k + 1) % self._sides
            shape = segment_shape(cell.zone[k], cell.zone[after], pair, merge)
            # Sectors at a corner: 0 inside, 1 outside; the ray along side k lies between 1 and 0 at its start.
            start, end = Post(levels[k], (0, 1), (-1, 1)), Post(levels[after], (0, 1), (0, -1))
            classes.append((segment_class(shape, pair, start, end, merge), levels[k]))
        return classes

    def _zone(self, centre: Floats, owner: int) -> list[Sided]:
        nodes = [
            self.shells.node(centre + np.append(corner, 0.0), levels)
            for corner, (_, levels) in zip(self.cell.zone, self._zones)
        ]
        ends = zip(nodes, nodes[1:] + nodes[:1])
        made = [
            self.shells.segment(kind, centre, pair, (owner, owner))
            for (kind, _), pair in zip(self._zones, ends)
        ]
        return [Sided(segment, 0, True) for segment in made]

    # -- faces ------------------------------------------------------------------------------------

    def _describe_cell(self, index: Index, centre: Floats) -> None:
        borders = [self._border(index, k) for k in range(self._sides)]
        owner = self._owner(index)
        zone = self._zone(centre, owner) if self.cell.island else borders
        shared: dict[int, Rim] = {}
        for f, face in enumerate(self.cell.faces):
            if face.pattern is None:
                continue
            rims = shared if self.cell.one_rim else {}
            self._zone_faces(f, face, centre, owner, zone, rims)
            if self.cell.island:
                outer = [use for side in borders for use in self._all_runs(side, f)]
                inner = [use for side in zone for use in self._all_runs(Sided(side.segment, 1, True), f)]
                self._land_face(f, face, owner, [outer, reverse(inner)])

    def _zone_faces(self, f: int, face: CellFace, centre: Floats, owner: int, zone: list[Sided],
                    rims: dict[int, Rim]) -> None:  # fmt: skip
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

    def _loop(self, f: int, face: CellFace, items: tuple[tuple[str, int, int], ...], region: Region,
              centre: Floats, zone: list[Sided], rims: dict[int, Rim]) -> Loop:  # fmt: skip
        """Edges of one loop of a region, counter-clockwise seen from +z."""
        loop: Loop = []
        for what, number, detail in items:
            if what == "run":
                loop += self._run(zone[number], f, detail)
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

    def _all_runs(self, side: Sided, f: int) -> Loop:
        runs = side.segment.kind.shape.runs[side.column][f]
        return [use for r in range(len(runs)) for use in self._run(side, f, r)]

    def _run(self, side: Sided, f: int, r: int) -> Loop:
        """The edges of stretch r (counted counter-clockwise) of a column's face along a segment."""
        kind = side.segment.kind
        runs = kind.shape.runs[side.column][f]
        pieces = runs[r] if side.forward else runs[len(runs) - 1 - r][::-1]
        loop = []
        for i in pieces:
            for n, edge in enumerate(kind.pieces[i].edges):
                for use in edge.uses:
                    if use.column == side.column and use.face == f:
                        loop.append(LoopEdge(side.segment.edges[i][n], side.forward, use.parameters))
        return loop

    def _rim(self, f: int, face: CellFace, number: int, centre: Floats, zone: list[Sided]) -> Rim:
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
                vertex, z = self._rim_end(f, face.pattern.ends[name[1]], zone)
                vertices.append(vertex)
                heights.append(z)
        edges = []
        for n, arc in enumerate(arcs):
            after = (n + 1) % len(vertices)
            shift = max(abs(heights[n] - arc.poles[0, 2]), abs(heights[after] - arc.poles[-1, 2]))
            key = (f, number, n, heights[n], heights[after])
            meets = self._rim_arcs.setdefault(key, arc.with_ends(heights[n], heights[after]))
            tolerance = 1.2 * max(shift, self.cell.misfit) + TOLERANCE
            edges.append(self.shells.edge(vertices[n], vertices[after], meets, centre, tolerance))
        return edges, vertices

    def _rim_end(self, f: int, end: tuple[int, float], zone: list[Sided]) -> tuple[int, float]:
        """The vertex on a zone side at which a rim ends, and its height in the cell frame."""
        k, t = end
        segment, column, forward = zone[k]
        station = int(np.argmin(np.abs(segment.kind.shape.stations - (t if forward else 1.0 - t))))
        post = segment.kind.posts[station]
        level = post.levels.place[post.sectors[column]][f]
        assert level is not None
        return self.shells.vertex(segment.nodes[station], level), post.levels.z[level]

    def _rim_curve(self, f: int, face: CellFace, number: int, n: int) -> Arc:
        key = (f, number, n)
        if key not in self._rim_curves:
            assert face.lens is not None
            self._rim_curves[key] = face.lens.parameters(face.rims[number][n])
        return self._rim_curves[key]
