"""Classes of segments with their ends tied to vertices: all data for a writer, once per class.

Lengths in mm.

Tie heights on one vertical line to vertices, and walls to its vertical edges. Lengths in mm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats
from clacad.solid.rational_conics import Arc, RationalPatch, line, ruled_wall
from clacad.solid.wall_segments import TOLERANCE, Column, SegmentShape, WallShape
from clacad.topology.complex_parts import linked, runs_round

if TYPE_CHECKING:
    from clacad.solid.face_pattern import Kind


@dataclass(frozen=True, eq=False, slots=True)
class Levels:
    """Vertices on one vertical line.

    z : mm. Ascending.
    shift : mm. Largest distance of the heights that share a vertex from it.
    place : place[sector][face] = number of the vertex, or None (no height, or open)
    copies : for each gap between consecutive vertices: ray → copy. Ray r lies between sector r and sector r +
        1. Walls on rays with the same copy share one vertical edge; two copies are a saddle: columns that
        touch in a line.
    """

    z: tuple[float, ...]
    shift: tuple[float, ...]
    place: tuple[tuple[int | None, int | None], ...]
    copies: tuple[dict[int, int], ...]

    @property
    def saddles(self) -> int:
        """Number of vertical edges at which four walls meet."""
        double = [len(set(copies.values())) > 1 for copies in self.copies]
        return sum(now and not before for before, now in zip([False, *double], double))


def linked_levels(heights: Floats, merge: float) -> Levels:
    """Tie the heights at a node to vertices.

    heights : (k, 2), mm
        Front and back height of the k sectors around the node, counter-clockwise; NaN: no column; ±inf: open.
    merge : mm
        Single linkage: heights whose gaps are below it share a vertex, in the middle of their cluster.
    """
    known = sorted((float(z), s, f) for (s, f), z in np.ndenumerate(heights) if np.isfinite(z))
    group = linked(np.array([item[0] for item in known]), merge).tolist()
    clusters = [
        [item for item, of in zip(known, group) if of == n] for n in range(max(group, default=-1) + 1)
    ]
    z = tuple(0.5 * (cluster[0][0] + cluster[-1][0]) for cluster in clusters)
    shift = tuple(0.5 * (cluster[-1][0] - cluster[0][0]) for cluster in clusters)
    number = {(s, f): n for n, cluster in enumerate(clusters) for _, s, f in cluster}
    place = tuple((number.get((s, 0)), number.get((s, 1))) for s in range(len(heights)))
    copies = tuple(_copies(heights, place, n, len(z)) for n in range(len(z) - 1))
    return Levels(z, shift, place, copies)


def _copies(
    heights: Floats, place: Sequence[tuple[int | None, int | None]], n: int, count: int
) -> dict[int, int]:
    """Pair the walls around a node in the gap above vertex n; walls of one solid stretch share an edge."""
    solid = []
    for sector, (front, back) in enumerate(place):
        low = -1 if front is None and heights[sector, 0] == -np.inf else front
        high = count if back is None and heights[sector, 1] == np.inf else back
        solid.append(low is not None and high is not None and low <= n < high)
    if all(solid):
        return {}
    runs = runs_round(solid)
    return {
        ray: max(runs[ray], runs[(ray + 1) % len(solid)])
        for ray in range(len(solid))
        if solid[ray] != solid[(ray + 1) % len(solid)]
    }


@dataclass(frozen=True, eq=False, slots=True)
class Plane:
    """A plane through `origin` with unit `normal` and reference direction `across`, (3,) each."""

    origin: Floats
    normal: Floats
    across: Floats


@dataclass(frozen=True, eq=False, slots=True)
class Cylinder(RationalPatch):
    """Part of an upright cylinder about `centre` (2,), mm; `inward`: its normal points to the axis."""

    centre: Floats
    radius: float
    inward: bool


Surface = RationalPatch | Plane


@dataclass(frozen=True, eq=False, slots=True)
class Use:
    """A face's use of an edge class: column, face (0 front, 1 back), kind, parameter curve on a lens."""

    column: int
    face: int
    kind: Kind
    parameters: Arc | None


@dataclass(frozen=True, eq=False, slots=True)
class EdgeClass:
    """An edge between two stations; levels[0], levels[1] are the vertices at its start and end."""

    arc: Arc
    levels: tuple[int, int]
    tolerance: float
    uses: tuple[Use, ...]


@dataclass(frozen=True, eq=False, slots=True)
class WallEnd:
    """One vertical side of a wall: vertices from `low` to `high`, the ray it lies on, its parameter curves.

    `curves[i]` belongs to the edge from vertex low + i to low + i + 1; low == high: the side is a point, and
    `curves[0]` is the parameter line of the degenerate edge.
    """

    low: int
    high: int
    ray: int
    curves: tuple[Arc, ...]


@dataclass(frozen=True, eq=False, slots=True)
class WallClass:
    """A wall between edges `low` and `high` of its piece; `along`: the normal right of the segment."""

    low: int
    high: int
    solid: int
    surface: Surface
    ends: tuple[WallEnd, WallEnd]


@dataclass(frozen=True, eq=False, slots=True)
class PieceClass:
    """Edges and walls between two stations."""

    edges: tuple[EdgeClass, ...]
    walls: tuple[WallClass, ...]
    joined: bool
    merged: int


@dataclass(frozen=True, eq=False, slots=True)
class Post:
    """A station as seen from a segment: its levels, and the sector of each column there."""

    levels: Levels
    sectors: tuple[int, int]
    rays: tuple[int, int]
    """Ray of the piece that ends here, ray of the piece that begins here."""


@dataclass(frozen=True, eq=False, slots=True)
class SegmentClass:
    """A class of congruent segments: posts at its stations, pieces between them."""

    shape: SegmentShape
    posts: tuple[Post, ...]
    pieces: tuple[PieceClass, ...]
    outside: tuple[bool, bool]


def segment_class(
    shape: SegmentShape, columns: Sequence[Column | None], start: Post, end: Post, merge: float
) -> SegmentClass:
    """Tie the curves of a segment's shape to the vertices at its stations.

    columns : (left, right)
    start, end : The nodes at the segment's ends.
    merge : mm
    """
    inner = [Post(linked_levels(heights, merge), (0, 1), (0, 1)) for heights in shape.heights[1:-1]]
    posts = (start, *inner, end)
    pieces = []
    for i, piece in enumerate(shape.pieces):
        edges = tuple(
            _edge(shape, i, curve_index, posts[i], posts[i + 1], columns)
            for curve_index in range(len(piece.curves))
        )
        walls = tuple(_wall(shape, i, wall, edges, posts[i], posts[i + 1]) for wall in piece.walls)
        merged = sum(curve.apart > 1e-12 and len(curve.strands) > 1 for curve in piece.curves)
        pieces.append(PieceClass(edges, walls, piece.joined, merged))
    outside = tuple(column is not None and column.outside for column in columns)
    return SegmentClass(shape, posts, tuple(pieces), (outside[0], outside[1]))


def _edge(
    shape: SegmentShape, i: int, n: int, first: Post, last: Post, columns: Sequence[Column | None]
) -> EdgeClass:
    """Curve n of piece i of a segment as an edge between vertices of its two posts."""
    curve = shape.pieces[i].curves[n]
    lead = curve.strands[0]
    levels = tuple(_place(post, lead.column, lead.face) for post in (first, last))
    arc = curve.arcs[0]
    meets = arc.with_ends(first.levels.z[levels[0]], last.levels.z[levels[1]])
    deviation = max(curve.apart, float(np.max(np.abs(meets.poles - arc.poles))))
    uses = []
    for strand, own in zip(curve.strands, curve.arcs):
        column = columns[strand.column]
        assert column is not None
        parameters = None
        if strand.kind == "lens":
            lens = column.faces[strand.face].lens
            assert lens is not None
            parameters = lens.parameters(own.moved(-np.append(column.offset, 0.0)))
        uses.append(Use(strand.column, strand.face, strand.kind, parameters))
    return EdgeClass(meets, (levels[0], levels[1]), 1.2 * deviation + TOLERANCE, tuple(uses))


def _place(post: Post, column: int, face: int) -> int:
    level = post.levels.place[post.sectors[column]][face]
    assert level is not None
    return level


def _wall(
    shape: SegmentShape, i: int, wall: WallShape, edges: Sequence[EdgeClass], first: Post, last: Post
) -> WallClass:
    low, high = edges[wall.low], edges[wall.high]
    a, b = shape.points[i], shape.points[i + 1]
    along = np.append((b - a) / np.hypot(*(b - a)), 0.0)
    right = np.array([along[1], -along[0], 0.0])
    surface: Surface = Plane(low.arc.poles[0].copy(), right, along)
    if wall.ruled:
        surface = ruled_wall(low.arc, high.arc)
    ends = tuple(
        _wall_end(post, low.levels[e], high.levels[e], post.rays[1 - e], float(e), wall.ruled)
        for e, post in enumerate((first, last))
    )
    return WallClass(wall.low, wall.high, wall.solid, surface, (ends[0], ends[1]))


def _wall_end(post: Post, low: int, high: int, ray: int, u: float, ruled: bool) -> WallEnd:
    if not ruled:
        return WallEnd(low, high, ray, ())
    if low == high:
        return WallEnd(low, high, ray, (line(np.array([u, 0.0]), np.array([u, 1.0])),))
    z = post.levels.z
    share = [(z[n] - z[low]) / (z[high] - z[low]) for n in range(low, high + 1)]
    curves = tuple(line(np.array([u, v]), np.array([u, w])) for v, w in zip(share[:-1], share[1:]))
    return WallEnd(low, high, ray, curves)
