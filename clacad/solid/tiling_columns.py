"""The cells of one tiling, described to `Shells`: the faces over them, and the zones inside a seam. Lengths
in mm.
"""

from __future__ import annotations

import numpy as np

from clacad.base.types import Floats
from clacad.sheet.lattice import Lattice
from clacad.sheet.pattern import Step
from clacad.solid.edge_classes import Levels, Plane, Post, SegmentClass, linked_levels, segment_class
from clacad.solid.face_pattern import Region
from clacad.solid.node_sectors import Touch
from clacad.solid.rational_conics import Arc
from clacad.solid.repeated_cell import Cell, CellFace
from clacad.solid.shells import Loop, LoopEdge, Shells, reverse
from clacad.solid.tiling_borders import Borders, Layer, Sided, Surround
from clacad.solid.wall_segments import TOLERANCE, segment_shape, zone_columns

RimEdges = tuple[list[int], list[int]]  # edges of a chain, vertices of a chain


class Columns:
    """One tiling of a body, described to `Shells`.

    Parameters
    ----------
    shells, layer, lattice, scale, around
        As for `Borders`.
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
                vertex, z = self._rim_end(f, face.pattern.ends[name[1]], zone)
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
