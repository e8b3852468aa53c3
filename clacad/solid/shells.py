"""Walk the lattice and pass a body, face by face, to a writer. Lengths in mm.

Every edge is made once and used by exactly two faces; every vertex of a node is shared by all cells that meet
there. There is no welding by a tolerance and no Boolean. The geometry of each class of cells, borders and
nodes is computed once; an instance is a translation of it. A *writer* turns the description into an OCCT
solid or into text.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np

from clacad.base.arrays import Groups
from clacad.base.types import Floats
from clacad.solid.rational_conics import Arc, RationalPatch, line
from clacad.solid.wall_segments import TOLERANCE

if TYPE_CHECKING:
    from clacad.solid.edge_classes import Levels, SegmentClass, Surface, WallEnd

Role = Literal["lens", "land", "wall", "plane", "side"]

MERGE = 1e-6
"""Merge height h (mm): ten times the length below which CAD programs merge points."""


@dataclass(frozen=True, eq=False, slots=True)
class LoopEdge:
    """A face's use of an edge: number, direction, parameter curve; −1: degenerate, at `vertex`."""

    edge: int
    forward: bool
    parameters: Arc | None = None
    vertex: int = -1


Loop = list[LoopEdge]


@dataclass(frozen=True, eq=False, slots=True)
class FlatEdge:
    """An edge of a flat face: its use, vertices, the column it belongs to.

    `way_out`, `way_in` (2,) are its directions at start and end, `points` (k, 2) points along it, ends
    included (mm).
    """

    use: LoopEdge
    first: int
    last: int
    owner: int
    way_out: Floats
    way_in: Floats
    points: Floats

    def reversed(self) -> FlatEdge:
        """The edge listed from its last vertex (its use runs that way)."""
        return FlatEdge(
            self.use, self.last, self.first, self.owner, -self.way_in, -self.way_out, self.points[::-1]
        )


class Writer(Protocol):
    """Receiver of the description: OCCT or a text file."""

    def vertex(self, point: Floats, tolerance: float) -> int:
        """Make a vertex."""

    def edge(self, first: int, last: int, arc: Arc, offset: Floats, tolerance: float) -> int:
        """Make an edge along `arc` displaced by `offset`."""

    def surface(self, surface: Surface, offset: Floats) -> int:
        """Make a surface displaced by `offset`."""

    def face(self, surface: int, same_sense: bool, loops: list[Loop], role: Role) -> int:
        """Make a face; loops run counter-clockwise seen from outside the material, the first is the outer
        one.
        """


@dataclass
class ShellCounts:
    """Numbers of the elements of a body."""

    faces: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    vertices: int = 0
    edges: int = 0
    saddles: int = 0
    wedges: int = 0
    merged_steps: int = 0
    crossings: int = 0
    largest_shift: float = 0.0


class NodeVertices:
    """An instance of a node or station: vertices and vertical edges, created on first use."""

    __slots__ = ("origin", "levels", "vertices", "verticals")

    def __init__(self, origin: Floats, levels: Levels) -> None:
        self.origin, self.levels = origin, levels
        self.vertices: list[int] = [-1] * len(levels.z)
        self.verticals: dict[tuple[int, int], int] = {}


class Segment:
    """An instance of a segment: its class, its posts' nodes, its edges per piece."""

    __slots__ = ("kind", "nodes", "edges", "owners")

    def __init__(self, kind: SegmentClass, nodes: list[NodeVertices], owners: tuple[int, int]) -> None:
        self.kind, self.nodes, self.owners = kind, nodes, owners
        self.edges: list[list[int]] = []


class Shells:
    """Describe bodies to a writer; collect connected faces.

    merge : mm. Merge height.
    split : Whether pieces are separated by shared edges too, not only by columns that share material.
    """

    def __init__(self, writer: Writer, merge: float = MERGE, split: bool = False) -> None:
        self._edges: dict[int, list[int]] | None = {} if split else None
        self.writer = writer
        self.merge = merge
        self.counts = ShellCounts()
        self.faces: dict[int, list[int]] = defaultdict(list)
        self.flat: dict[tuple[str, int], list[FlatEdge]] = defaultdict(list)
        self._owners = 0
        self._joined: Groups[int] = Groups()
        self._verticals: dict[float, Arc] = {}

    # -- connected columns ------------------------------------------------------------------------

    def owner(self) -> int:
        """Register a column; its number identifies its faces."""
        self._owners += 1
        return self._owners - 1

    def join(self, a: int, b: int) -> None:
        """Record that two columns share material."""
        self._joined.join(a, b)

    def root(self, a: int) -> int:
        """The representative of everything connected with column a."""
        return self._joined.of(a)

    def pieces(self) -> list[list[int]]:
        """Face numbers of every connected piece, in the order of their first column."""
        pieces: dict[int, list[int]] = {}
        for owner in range(self._owners):
            if owner in self.faces:
                pieces.setdefault(self.root(owner), []).extend(self.faces[owner])
        if self._edges is None:
            return list(pieces.values())
        return [part for faces in pieces.values() for part in _parts_by_edges(faces, self._edges)]

    # -- vertices, edges, faces ---------------------------------------------------------------------

    def node(self, origin: Floats, levels: Levels) -> NodeVertices:
        """Make an instance of a node."""
        self.counts.saddles += levels.saddles
        return NodeVertices(origin, levels)

    def vertex(self, node: NodeVertices, level: int) -> int:
        """The vertex of a node at a level, created on first use."""
        if node.vertices[level] < 0:
            shift = node.levels.shift[level]
            self.counts.largest_shift = max(self.counts.largest_shift, shift)
            point = node.origin + np.array([0.0, 0.0, node.levels.z[level]])
            node.vertices[level] = self.point(point, 1.2 * shift + TOLERANCE)
        return node.vertices[level]

    def point(self, point: Floats, tolerance: float = TOLERANCE) -> int:
        """Make a free vertex."""
        self.counts.vertices += 1
        return self.writer.vertex(point, tolerance)

    def vertical(self, node: NodeVertices, level: int, ray: int) -> int:
        """The vertical edge of a node between a level and the next one, on a ray."""
        key = (level, node.levels.copies[level][ray])
        if key not in node.verticals:
            low, high = node.levels.z[level], node.levels.z[level + 1]
            arc = self._verticals.setdefault(high - low, line(np.zeros(3), np.array([0.0, 0.0, high - low])))
            at = node.origin + np.array([0.0, 0.0, low])
            node.verticals[key] = self.edge(self.vertex(node, level), self.vertex(node, level + 1), arc, at)
        return node.verticals[key]

    def edge(self, first: int, last: int, arc: Arc, offset: Floats, tolerance: float = TOLERANCE) -> int:
        """Make an edge."""
        self.counts.edges += 1
        return self.writer.edge(first, last, arc, offset, tolerance)

    def face(self, owner: int, surface: int, same_sense: bool, loops: list[Loop], role: Role) -> None:
        """Make a face that belongs to a column."""
        self.counts.faces[role] += 1
        number = self.writer.face(surface, same_sense, loops, role)
        self.faces[owner].append(number)
        if self._edges is not None:
            self._edges[number] = [use.edge for loop in loops for use in loop if use.edge >= 0]

    # -- segments ---------------------------------------------------------------------------------

    def segment(
        self,
        kind: SegmentClass,
        offset: Floats,
        ends: tuple[NodeVertices, NodeVertices],
        owners: tuple[int, int],
        bare: bool = False,
    ) -> Segment:
        """Make the edges and walls of one segment; `bare`: a side face of the outline replaces the walls."""
        inner = [
            self.node(offset + np.append(kind.shape.points[i], 0.0), kind.posts[i].levels)
            for i in range(1, len(kind.posts) - 1)
        ]
        made = Segment(kind, [ends[0], *inner, ends[1]], owners)
        self.counts.crossings += kind.shape.crossings
        for i, piece in enumerate(kind.pieces):
            first, last = made.nodes[i], made.nodes[i + 1]
            numbers = []
            for edge in piece.edges:
                a, b = self.vertex(first, edge.levels[0]), self.vertex(last, edge.levels[1])
                number = self.edge(a, b, edge.arc, offset, edge.tolerance)
                self.counts.largest_shift = max(self.counts.largest_shift, (edge.tolerance - TOLERANCE) / 1.2)
                numbers.append(number)
                for use in edge.uses:
                    flat = "plane" if use.kind == "plane" else "outside" if kind.outside[use.column] else ""
                    if flat:
                        item = LoopEdge(number, use.column == 0)
                        way = (edge.arc.poles[-1] - edge.arc.poles[0])[:2]
                        points = np.array([first.origin[:2], last.origin[:2]])
                        record = FlatEdge(item, a, b, owners[use.column], way, way, points)
                        self.flat[flat, use.face].append(record)
            made.edges.append(numbers)
            self.counts.merged_steps += piece.merged
            if piece.joined:
                self.join(*owners)
            for number in range(0 if bare else len(piece.walls)):
                self._wall(made, i, number, offset)
        return made

    def _wall(self, made: Segment, i: int, number: int, offset: Floats) -> None:
        """Make the face of a wall of piece i: low edge, far side up, high edge back, near side down."""
        piece = made.kind.pieces[i]
        wall = piece.walls[number]
        ruled = isinstance(wall.surface, RationalPatch)
        near, far = wall.ends
        self.counts.wedges += (near.low == near.high) or (far.low == far.high)
        loop = [
            LoopEdge(made.edges[i][wall.low], True, V_LOW if ruled else None),
            *self._wall_side(made.nodes[i + 1], far, True, ruled),
            LoopEdge(made.edges[i][wall.high], False, V_HIGH if ruled else None),
            *self._wall_side(made.nodes[i], near, False, ruled),
        ]
        left = wall.solid == 0
        outer = -1 in made.owners
        surface = self.writer.surface(wall.surface, offset)
        self.face(
            made.owners[wall.solid],
            surface,
            left,
            [loop if left else reverse(loop)],
            "side" if outer else "wall",
        )

    def _wall_side(self, node: NodeVertices, end: WallEnd, upwards: bool, ruled: bool) -> Loop:
        if end.low == end.high:
            vertex = self.vertex(node, end.low)
            return [LoopEdge(-1, upwards, end.curves[0], vertex)] if ruled else []
        side = [
            LoopEdge(self.vertical(node, end.low + n, end.ray), upwards, end.curves[n] if ruled else None)
            for n in range(end.high - end.low)
        ]
        return side if upwards else side[::-1]


def _parts_by_edges(faces: list[int], edges: dict[int, list[int]]) -> list[list[int]]:
    """Split faces into those connected by edges (land in several strips has one owner); `edges` of each."""
    joined: Groups[int] = Groups()
    first: dict[int, int] = {}
    for face in faces:
        for edge in edges[face]:
            joined.join(first.setdefault(edge, face), face)
    parts: dict[int, list[int]] = {}
    for face in faces:
        parts.setdefault(joined.of(face), []).append(face)
    return list(parts.values())


V_LOW = line(np.array([0.0, 0.0]), np.array([1.0, 0.0]))
V_HIGH = line(np.array([0.0, 1.0]), np.array([1.0, 1.0]))
"""Parameter curves of a ruled wall's lower and upper edge."""


def reverse(loop: Loop) -> Loop:
    """Reverse the direction of a loop."""
    return [LoopEdge(use.edge, not use.forward, use.parameters, use.vertex) for use in reversed(loop)]
