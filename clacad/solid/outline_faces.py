"""Faces at the outline of a body: its sides, and the flat faces that extend to it. Lengths in mm.

A cell may touch the outline along a whole border (a slab with displaced arrays, cells that fill a rectangle)
or at a corner (a round outline through a lattice point). There the cell's own border curve bounds the side
face. Between touches there is land, bounded by the outline itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.polygons import polygon_area
from clacad.base.types import Floats
from clacad.solid.edge_classes import Cylinder, Plane
from clacad.solid.face_pattern import encloses
from clacad.solid.rational_conics import line, ruled_wall
from clacad.solid.shells import FlatEdge, Loop, LoopEdge, Shells, reverse

if TYPE_CHECKING:
    from clacad.solid.node_sectors import Touch
    from clacad.solid.outline_path import Path
    from clacad.solid.repeated_cell import CellFace
    from clacad.solid.tilings import Columns


@dataclass(eq=False)
class _Span:
    """A stretch of the outline between two stops, for one face: its edges and its end.

    `solid` is False where neither cell nor land is (the hollow land of an assembly).
    """

    side: int
    u0: float
    u1: float
    uses: Loop
    solid: bool


class _Stop:
    """A point of the outline at which spans meet: a touch of the tiling, or a free corner."""

    def __init__(
        self, shells: Shells, place: tuple[int, float], point: Floats, level: float, touch: Touch | None
    ):
        self.place, self.point, self.touch, self._shells = place, point, touch, shells
        self._free = -1
        self._level = level

    def vertex(self, face: int, leaving: bool) -> int:
        """The vertex at which a span leaves or arrives."""
        if self.touch is None:
            if self._free < 0:
                self._free = self._shells.point(np.append(self.point, self._level))
            return self._free
        return self._shells.vertex(self.touch.node, self._place(face, leaving))

    def _place(self, face: int, leaving: bool) -> int:
        assert self.touch is not None
        sector = self.touch.leaving if leaving else self.touch.arriving
        level = self.touch.node.levels.place[sector][face]
        assert level is not None
        return level

    def climb(self, face: int) -> Loop:
        """Vertical edges from the end of a span to the start of the next."""
        if self.touch is None:
            return []
        start, end = self._place(face, False), self._place(face, True)
        # Between the two heights only one of the two columns is solid: the lower front, the higher back.
        leaving_solid = (end < start) if face == 0 else (end > start)
        return self._steps(start, end, self.touch.out if leaving_solid else self.touch.back)

    def wall_end(self, leaving: bool) -> Loop:
        """Vertical edges from front to back at the end of land on the outline (upwards)."""
        assert self.touch is not None
        levels = self.touch.node.levels
        front, back = levels.place[self.touch.leaving if leaving else self.touch.arriving]
        assert front is not None
        assert back is not None
        u = 1.0 if not leaving and self.place[1] == 0.0 else self.place[1]
        share = (np.array(levels.z[front : back + 1]) - levels.z[front]) / (levels.z[back] - levels.z[front])
        edges = self._steps(front, back, self.touch.out if leaving else self.touch.back)
        return [
            LoopEdge(use.edge, True, line(np.array([u, v]), np.array([u, w])))
            for use, v, w in zip(edges, share[:-1], share[1:], strict=True)
        ]

    def _steps(self, start: int, end: int, ray: int) -> Loop:
        assert self.touch is not None
        if start <= end:
            return [LoopEdge(self._shells.vertical(self.touch.node, n, ray), True) for n in range(start, end)]
        return [
            LoopEdge(self._shells.vertical(self.touch.node, n, ray), False)
            for n in range(start - 1, end - 1, -1)
        ]


class _FaceOutline:
    """The outline of one face: stops and spans in order, starting at corner 0."""

    def __init__(
        self, shells: Shells, path: Path, tiling: Columns, face: int, owner: int, touched: bool
    ) -> None:
        self.face, self._shells, self._path, self._owner = face, shells, path, owner
        flat = tiling.cell.faces[face]
        land = tiling.outside_face(face)
        self.level = land.level
        assert self.level is not None
        self._key = ("plane" if flat.plane else "outside", face)
        touches = {touch.position: touch for touch in tiling.touches} if touched else {}
        places = sorted({(side, 0.0) for side in range(len(path.arcs))} | set(touches))
        self.stops = [
            _Stop(
                shells,
                place,
                path.arcs[place[0]].at(np.array([place[1]]))[0, :2],
                self.level,
                touches.get(place),
            )
            for place in places
        ]
        self.spans = [self._span(tiling, n) for n in range(len(self.stops))]

    def _span(self, tiling: Columns, n: int) -> _Span:
        """The stretch from stop n to the next: the border of a touching cell, or a new edge of the land."""
        stop, after = self.stops[n], self.stops[(n + 1) % len(self.stops)]
        side, u0 = stop.place
        u1 = after.place[1] if after.place[0] == side and after.place[1] > u0 else 1.0
        if stop.touch is not None and id(stop.touch.node) in tiling.touching:
            uses = tiling.touching[id(stop.touch.node)][self.face]
            return _Span(side, u0, u1, uses, bool(uses))
        assert self.level is not None
        arc = self._path.stretch(side, u0, u1)
        first, last = stop.vertex(self.face, True), after.vertex(self.face, False)
        edge = self._shells.edge(first, last, arc, np.array([0.0, 0.0, self.level]))
        curve = None
        if not arc.straight:
            v = float(self.face)
            curve = line(np.array([u0, v]), np.array([u1, v]))
        ways = arc.poles[1] - arc.poles[0], arc.poles[-1] - arc.poles[-2]
        points = arc.at(np.linspace(0.0, 1.0, 2 if arc.straight else 33))[:, :2]
        flat = FlatEdge(LoopEdge(edge, True), first, last, self._owner, ways[0][:2], ways[1][:2], points)
        self._shells.flat[self._key].append(flat)
        return _Span(side, u0, u1, [LoopEdge(edge, True, curve)], True)

    def corner(self, side: int) -> int:
        """Index of the stop at which a side begins."""
        return next(n for n, stop in enumerate(self.stops) if stop.place == (side, 0.0))

    def of_side(self, side: int) -> list[int]:
        """Indices of the spans of a side, in order."""
        return [n for n, span in enumerate(self.spans) if span.side == side]


def outline_faces(
    shells: Shells, paths: tuple[Path, ...], tilings: tuple[Columns, ...], owner: int, hollow: bool
) -> None:
    """Make the side faces of an outline and of the holes in it, and the flat faces between them and the
    cells.

    paths : the outline, then the holes, which run clockwise
    """
    for n, path in enumerate(paths):
        _loop_sides(shells, path, tilings, owner, hollow, n == 0)
    for f in (0, 1):
        tiling = next(t for t in tilings if not t.cell.faces[f].open)
        flat = tiling.cell.faces[f]
        flat_faces(shells, f, tiling.outside_face(f), "plane" if flat.plane else "outside")


def _loop_sides(
    shells: Shells, path: Path, tilings: tuple[Columns, ...], owner: int, hollow: bool, touched: bool
) -> None:
    """Make the side faces along one closed path; `touched`: cells may touch it."""
    rings = []
    for f in (0, 1):
        tiling = next(t for t in tilings if not t.cell.faces[f].open)
        rings.append(_FaceOutline(shells, path, tiling, f, owner, touched))
    sides = range(len(path.arcs))
    posts = {side: _post(shells, rings, side, hollow) for side in sides}
    for side in sides:
        after = (side + 1) % len(path.arcs)
        if not hollow:
            bottom, top = (_chain(ring, side) for ring in rings)
            assert posts[after] is not None
            assert posts[side] is not None
            loop = [*bottom, _at(posts[after], True, 1.0), *reverse(top), _at(posts[side], False, 0.0)]
            _side_face(shells, path, owner, side, rings, loop)
        else:
            _land_sides(shells, path, owner, side, (rings[0], rings[1]), posts)


def _at(post: int | None, upwards: bool, u: float) -> LoopEdge:
    assert post is not None
    return LoopEdge(post, upwards, line(np.array([u, 0.0]), np.array([u, 1.0])))


def _post(shells: Shells, rings: list[_FaceOutline], side: int, hollow: bool) -> int | None:
    """The vertical edge at the start of a side.

    None where hollow land ends, which has its own edges there.
    """
    corners = [ring.corner(side) for ring in rings]
    if hollow and rings[0].stops[corners[0]].touch is not None:
        return None
    ends = [ring.stops[corner].vertex(f, True) for f, (ring, corner) in enumerate(zip(rings, corners))]
    levels = [_height(ring, corner, f) for f, (ring, corner) in enumerate(zip(rings, corners))]
    start = np.append(rings[0].stops[corners[0]].point, levels[0])
    rise = np.array([0.0, 0.0, levels[1] - levels[0]])
    return shells.edge(ends[0], ends[1], line(np.zeros(3), rise), start)


def _height(ring: _FaceOutline, corner: int, face: int) -> float:
    touch = ring.stops[corner].touch
    if touch is None:
        assert ring.level is not None
        return ring.level
    level = touch.node.levels.place[touch.leaving][face]
    assert level is not None
    return touch.node.levels.z[level]


def _chain(ring: _FaceOutline, side: int) -> Loop:
    """The edges of a side for one face, with the vertical edges between spans of different height."""
    numbers = ring.of_side(side)
    loop: Loop = []
    for n in numbers:
        loop += ring.spans[n].uses
        after = (n + 1) % len(ring.stops)
        loop += ring.stops[after].climb(ring.face)
    return loop


def _land_sides(
    shells: Shells,
    path: Path,
    owner: int,
    side: int,
    rings: tuple[_FaceOutline, _FaceOutline],
    posts: dict[int, int | None],
) -> None:
    """The side faces of hollow land: one for every stretch of land between two touches."""
    numbers = rings[0].of_side(side)
    rows: list[list[int]] = []
    for n in numbers:
        if rings[0].spans[n].solid:
            if rows and rows[-1][-1] == n - 1 and rings[0].stops[n].touch is None:
                rows[-1].append(n)
            else:
                rows.append([n])
    for row in rows:
        first, last = row[0], (row[-1] + 1) % len(rings[0].stops)
        bottom, top = ([use for n in row for use in ring.spans[n].uses] for ring in rings)
        up = _end(rings[0], last, False, posts)
        down = _end(rings[0], first, True, posts)
        _side_face(shells, path, owner, side, list(rings), [*bottom, *up, *reverse(top), *reverse(down)])


def _end(ring: _FaceOutline, n: int, leaving: bool, posts: dict[int, int | None]) -> Loop:
    """The vertical edges (upwards) at one end of a stretch of land."""
    stop = ring.stops[n]
    if stop.touch is None:
        return [_at(posts[stop.place[0]], True, 0.0 if leaving else 1.0)]
    return stop.wall_end(leaving)


def _side_face(
    shells: Shells, path: Path, owner: int, side: int, rings: list[_FaceOutline], loop: Loop
) -> None:
    """One side face: a plane, or an exact rational quarter of a cylinder."""
    arc = path.arcs[side]
    levels = [ring.level for ring in rings]
    assert levels[0] is not None
    assert levels[1] is not None
    low, high = (np.array([0.0, 0.0, level]) for level in (levels[0], levels[1]))
    if arc.straight:
        along = arc.poles[1] - arc.poles[0]
        along = along / np.linalg.norm(along)
        right = np.array([along[1], -along[0], 0.0])
        surface = shells.writer.surface(Plane(arc.poles[0] + low, right, along), np.zeros(3))
        loop = [LoopEdge(use.edge, use.forward) for use in loop]
    else:
        wall = ruled_wall(arc.moved(low), arc.moved(high))
        round_side = path.rounds[side] if path.rounds else None
        if round_side is not None:
            centre, radius, sense = round_side
            wall = Cylinder(wall.poles, wall.weights, centre, radius, sense < 0.0)
        surface = shells.writer.surface(wall, np.zeros(3))
    shells.face(owner, surface, True, [loop], "side")


# -- flat faces -------------------------------------------------------------------------------------


def flat_faces(shells: Shells, f: int, face: CellFace, key: str) -> None:
    """Close the flat faces whose edges were recorded: the plane of a body, or the land round its cells."""
    assert face.level is not None
    pieces: dict[int, list[tuple[Loop, Floats, int]]] = {}
    for loop, points, owner in _chained(shells, (key, f)):
        pieces.setdefault(shells.root(owner), []).append((loop, points, owner))
    if not pieces:
        return
    up, across = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    surface = shells.writer.surface(Plane(np.array([0.0, 0.0, face.level]), up, across), np.zeros(3))
    for loops in pieces.values():
        for (loop, _, owner), within in _with_their_holes(loops):
            bounds = [loop, *within] if face.side < 0 else [reverse(bound) for bound in (loop, *within)]
            shells.face(owner, surface, face.side < 0, bounds, "land" if key == "outside" else "plane")


def _with_their_holes(
    loops: list[tuple[Loop, Floats, int]],
) -> list[tuple[tuple[Loop, Floats, int], list[Loop]]]:
    """Outer loops with their holes.

    A hole belongs to the smallest loop around it: land may lie among cells.
    """
    areas = [polygon_area(points) for _, points, _ in loops]
    outer = sorted((n for n, area in enumerate(areas) if area > 0.0), key=lambda n: areas[n])
    within: dict[int, list[Loop]] = {n: [] for n in outer}
    for n, (hole, place, _) in enumerate(loops):
        if areas[n] <= 0.0:
            middle = 0.5 * (place[0] + place[1])  # of an edge: corners may touch
            around = next((k for k in outer if encloses(loops[k][1], middle)), None)
            if around is not None:
                within[around].append(hole)
    return [(loops[n], within[n]) for n in sorted(outer)]


def _chained(shells: Shells, key: tuple[str, int]) -> list[tuple[Loop, Floats, int]]:
    """Closed loops of recorded edges of a flat face on their left, with their points and an owner."""
    leaving: dict[int, list[FlatEdge]] = {}
    for edge in shells.flat[key]:
        edge = edge if edge.use.forward else edge.reversed()
        leaving.setdefault(edge.first, []).append(edge)
    loops = []
    while leaving:
        # A loop that begins where two regions touch might end there too early.
        start = next((vertex for vertex, ways in leaving.items() if len(ways) == 1), next(iter(leaving)))
        edge = leaving[start][0]
        loop: Loop = []
        points: list[Floats] = []
        here = start
        while True:
            ways = leaving[here]
            edge = ways.pop(0) if len(ways) == 1 or not loop else ways.pop(_next_way(edge, ways))
            if not ways:
                del leaving[here]
            loop.append(edge.use)
            points += list(edge.points[:-1])
            here = edge.last
            if here == start:
                break
        loops.append((loop, np.array(points), edge.owner))
    return loops


def _next_way(arrived: FlatEdge, ways: list[FlatEdge]) -> int:
    """The edge bounding the region on the left where several leave a vertex: first clockwise from behind."""
    behind = np.arctan2(-arrived.way_in[1], -arrived.way_in[0])
    turns = [(behind - np.arctan2(way.way_out[1], way.way_out[0])) % (2.0 * np.pi) for way in ways]
    return int(np.argmin([turn if turn > 1e-9 else 2.0 * np.pi for turn in turns]))
