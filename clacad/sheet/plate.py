"""A plate: the side outline of a body as straight and round edges, with holes through it.

Mesh, solid, tracer, masks and drawings all use this class. The outer boundary is a closed polygon whose sides
may be arcs, as in a DXF polyline. The *bulge* of a side is the tangent of a quarter of its arc's angle. It is
positive where the arc bends to the right of the way from its first point to its second: outwards on a
counter-clockwise boundary. Holes are circles. Coordinates are in design units and absolute: the plate lies
where it is drawn, independent of its cells.

A cell is kept if it lies wholly inside the plate, outside its holes, and at least `CLEARANCE` of a pitch from
every edge: a narrower sliver of land would not survive the rounding of a mesh file. No cell ever touches the
edge of a plate.

A boundary is valid if no side has zero length and no two sides intersect.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import atan, ceil, pi, sqrt
from typing import Any, Literal

import numpy as np

from clacad.base.polygons import within
from clacad.base.types import Bools, Floats, Ints
from clacad.sheet.edge_columns import CX, CY, SENSE, X0, Y0
from clacad.sheet.plate_edges import (
    Vertex,
    arc_angle,
    as_sides,
    closed_loop,
    crossings,
    edge_box,
    extremes,
    inside,
    keeps_off,
    loop_area,
    nearest_edges,
)

CLEARANCE = 1e-3
"""Least distance between a cell and the edges and holes of its plate, as part of the pitch."""

SLIVER = 4e-6
"""Least distance between a cell and the edges, as part of the plate's size:
four times the resolution of float32.
"""

QUARTER = sqrt(2.0) - 1.0
"""Bulge of a quarter circle: tan(90°/4)."""


@dataclass(frozen=True, slots=True)
class Hole:
    """A round hole through a plate: centre, diameter (lengths), purpose, play of its pin."""

    x: float
    y: float
    diameter: float
    purpose: Literal["mount", "pin"] = "mount"
    play: float = 0.0


@dataclass(frozen=True)
class Plate:
    """An outline of straight and round sides, counter-clockwise, and the holes in it.

    vertices : tuple of (x, y, bulge). Lengths; bulge of the side from this vertex to the next.
    moved : (x, y), lengths
        Displacement of array 2's cells, at which every kept cell must lie inside as well.
    pitch : (p_x, p_y) or None, lengths. Pitch of array 2's cells; None: that of array 1's.
    turn : radians. Rotation of array 2's cells about their common centre.
    """

    vertices: tuple[Vertex, ...]
    holes: tuple[Hole, ...] = ()
    moved: tuple[float, float] = (0.0, 0.0)
    pitch: tuple[float, float] | None = None
    turn: float = 0.0

    def __repr__(self) -> str:
        return f"Plate({len(self.vertices)} corners, {len(self.holes)} holes)"

    def __getstate__(self) -> dict[str, Any]:
        """Return the constructor's values, without cached results."""
        return {name: self.__dict__[name] for name in ("vertices", "holes", "moved", "pitch", "turn")}

    @cached_property
    def loops(self) -> tuple[Floats, ...]:
        """Edges (k, EDGE_NUMBERS) of boundary and holes, the material on the left; arcs of at most 90°."""
        return closed_loop(self.vertices), *(
            closed_loop(tuple((*p, -QUARTER) for p in _quarters(hole))) for hole in self.holes
        )

    @cached_property
    def edges(self) -> Floats:
        """All edges, (e, EDGE_NUMBERS)."""
        return np.concatenate(self.loops)

    @property
    def area(self) -> float:
        """Area of the plate without its holes, length²."""
        return loop_area(self.loops[0]) - sum(0.25 * pi * hole.diameter**2 for hole in self.holes)

    @cached_property
    def box(self) -> tuple[float, float, float, float]:
        """Bounding box (x_min, x_max, y_min, y_max), lengths."""
        points = extremes(self.loops[0])
        (x0, y0), (x1, y1) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
        return x0, x1, y0, y1

    @property
    def diameter(self) -> float:
        """Diameter (length) of a round plate about the origin, drilled or not; 0 for any other boundary."""
        across = -2.0 * self.vertices[0][1]
        return across if self.vertices == plate_of_circle(across) else 0.0

    @property
    def reach(self) -> tuple[float, float]:
        """Greatest |x| and |y| of the plate (lengths)."""
        x0, x1, y0, y1 = self.box
        return max(abs(x0), abs(x1)), max(abs(y0), abs(y1))

    @cached_property
    def free_box(self) -> tuple[float, float]:
        """Half sides of a rectangle about the box's centre that no edge enters; (0, 0): none."""
        x0, x1, y0, y1 = self.box
        centre = np.array([0.5 * (x0 + x1), 0.5 * (y0 + y1)])
        if not self.inside(centre[None])[0]:
            return 0.0, 0.0
        low, high = 0.0, 1.0
        for _ in range(40):
            share = 0.5 * (low + high)
            half = share * 0.5 * np.array([x1 - x0, y1 - y0])
            sides = centre + half * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
            low, high = (share, high) if _clear(self, sides) else (low, share)
        share = low * (1.0 - 1e-9)
        return 0.5 * share * (x1 - x0), 0.5 * share * (y1 - y0)

    def scaled(self, factor: float) -> Plate:
        """Plate of arrays of one pitch, `factor` times as wide, with its holes."""
        holes = tuple(
            replace(hole, x=hole.x * factor, y=hole.y * factor, diameter=hole.diameter * factor)
            for hole in self.holes
        )
        return Plate(tuple((x * factor, y * factor, bulge) for x, y, bulge in self.vertices), holes)

    def inside(self, points: Floats) -> Bools:
        """Which points (..., 2), lengths, lie in the material; see `clacad.sheet.plate_edges.inside`."""
        flat = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        return inside(self.edges, flat).reshape(np.shape(points)[:-1])

    @cached_property
    def kept(self) -> dict[Any, Any]:
        """Results that other modules compute from this plate; not compared, copied or pickled with it."""
        return {}

    def room(self, pitch: tuple[float, float]) -> float:
        """Distance kept between a cell and every edge (length)."""
        x0, x1, y0, y1 = self.box
        return max(CLEARANCE * min(pitch), SLIVER * max(x1 - x0, y1 - y0, *self.reach))

    def polygons(self, steps: int) -> tuple[Floats, ...]:
        """The loops as polygons (n, 2) of equal areas; an arc of angle φ becomes ⌈φ·steps/2π⌉ sides, at least
        two.

        The inner corners of an arc lie off it by such a distance that the fan has the sector's area; its ends
        are exact.
        """
        return tuple(
            np.concatenate(
                [as_sides(edge, max(2, ceil(steps * arc_angle(edge) / (2.0 * pi)))) for edge in loop]
            )
            for loop in self.loops
        )


def least_land(plate: Plate) -> float:
    """Least distance of a hole from the boundary or another hole (length); infinite without holes."""
    middles = np.array([(hole.x, hole.y) for hole in plate.holes]).reshape(-1, 2)
    radii = np.array([0.5 * hole.diameter for hole in plate.holes])
    gaps = [nearest_edges(plate.loops[0], middles)[0] - radii] if plate.holes else []
    for n in range(1, len(radii)):
        gaps.append(np.hypot(*(middles[n:] - middles[n - 1]).T) - radii[n:] - radii[n - 1])
    return float(np.min(np.concatenate(gaps))) if gaps else np.inf


def free_width(plate: Plate, low: float, high: float) -> float:
    """Width of the widest rectangle about x = 0 between two y that no edge enters; 0: none."""
    narrow, wide = 0.0, 2.0 * plate.reach[0]
    for _ in range(40):
        x = 0.25 * (narrow + wide)
        sides = np.array([(-x, low), (x, low), (x, high), (-x, high)])
        free = bool(plate.inside(sides).all()) and _clear(plate, sides)
        narrow, wide = (2.0 * x, wide) if free else (narrow, 2.0 * x)
    return narrow


def _clear(plate: Plate, polygon: Floats) -> bool:
    """Whether no edge has a point in a convex polygon (m, 2)."""
    with np.errstate(invalid="ignore"):
        met = crossings(plate.edges, *polygon.T, *(np.roll(polygon, -1, axis=0) - polygon).T)
        crossed = ((met >= 0.0) & (met <= 1.0)).any()
    return not bool(crossed or within(polygon, *plate.edges[:, :2].T).any())


def whole_cells(plate: Plate, tile: Floats, centres: Floats, room: float) -> Bools:
    """Which cells lie wholly inside a plate, at least `room` from every edge.

    tile : (m, 2), lengths. Corners of a cell relative to its centre, counter-clockwise.
    centres : (n, 2), lengths
    room : length
    """
    held = np.ones(len(centres), dtype=bool)
    reach = float(np.hypot(*tile.T).max()) + room
    for edge in plate.edges:
        low, high = edge_box(edge)
        near = np.flatnonzero(
            held & (centres > low - reach).all(axis=1) & (centres < high + reach).all(axis=1)
        )
        for start in range(0, len(near), 4096):
            some = near[start : start + 4096]
            held[some] = keeps_off(edge, tile, centres[some], room)
    rest = np.flatnonzero(held)  # no edge is near: a cell is inside if its centre is
    held[rest] = inside(plate.edges, centres[rest])
    return held


def plate_of_circle(diameter: float) -> tuple[Vertex, ...]:
    """Boundary of a round plate about the origin, as four quarter circles."""
    r = 0.5 * diameter
    return (0.0, -r, QUARTER), (r, 0.0, QUARTER), (0.0, r, QUARTER), (-r, 0.0, QUARTER)


def plate_of_rectangle(
    width: float, height: float, corners: tuple[str, float] | None = None
) -> tuple[Vertex, ...]:
    """Boundary of a rectangle about the origin; `corners`: ("round", radius) or ("chamfer", leg), lengths."""
    x, y = 0.5 * width, 0.5 * height
    if corners is None:
        return (-x, -y, 0.0), (x, -y, 0.0), (x, y, 0.0), (-x, y, 0.0)
    c, bulge = corners[1], QUARTER if corners[0] == "round" else 0.0
    return (
        (-x + c, -y, 0.0),
        (x - c, -y, bulge),
        (x, -y + c, 0.0),
        (x, y - c, bulge),
        (x - c, y, 0.0),
        (-x + c, y, bulge),
        (-x, y - c, 0.0),
        (-x, -y + c, bulge),
    )


def counter_clockwise(vertices: tuple[Vertex, ...]) -> tuple[Vertex, ...]:
    """Return a closed polygon in counter-clockwise order."""
    if loop_area(closed_loop(vertices)) > 0.0:
        return vertices
    back = vertices[::-1]
    return tuple((x, y, 0.0 - back[(n + 1) % len(back)][2]) for n, (x, y, _) in enumerate(back))


def _quarters(hole: Hole) -> tuple[tuple[float, float], ...]:
    """Four points of a hole's circle, clockwise."""
    x, y, r = hole.x, hole.y, 0.5 * hole.diameter
    return (x + r, y), (x, y - r), (x - r, y), (x, y + r)


CHORDS = 8
"""Number of chords that replace an arc of 90° in intersection tests.

They deviate from it by 1/50 of its radius, a thousandth of what a mill needs.
"""


def fault(vertices: tuple[Vertex, ...]) -> str:
    """Describe the fault of a closed polygon, "" for a valid one; sides count from 0."""
    if len(vertices) < 3 and not any(bulge for _, _, bulge in vertices):
        return f"{len(vertices)} corners with straight sides enclose nothing"
    points = np.array(vertices)[:, :2]
    size = float(np.ptp(points, axis=0).max())
    short = np.flatnonzero(np.hypot(*(np.roll(points, -1, axis=0) - points).T) <= 1e-9 * size)
    if len(short):
        return f"side {short[0]} has no length: {_shown(points[short[0]])} occurs twice in a row"
    chords, side = _chords(vertices)
    met = _first_meeting(chords, 1e-9 * size)
    if met is None:
        return ""
    one, two = sorted((int(side[met[0]]), int(side[met[1]])))
    from_one, from_two = (_shown(points[n]) for n in (one, two))
    return (
        f"the sides from {from_one} and from {from_two}, {one} and {two}, meet or run back over one another"
    )


def _shown(point: Floats) -> str:
    return f"({point[0]:.6g}, {point[1]:.6g})"


def _chords(vertices: tuple[Vertex, ...]) -> tuple[Floats, Ints]:
    """Straight pieces (m, 4) of all sides, in order, and the index of the side of each piece."""
    points, side = [], []
    for n in range(len(vertices)):
        for edge in _edges_of(vertices, n):
            pieces = CHORDS if edge[SENSE] != 0.0 else 1
            turn = np.arange(pieces) * (_swept(edge) / pieces)
            u, v = edge[X0] - edge[CX], edge[Y0] - edge[CY]
            if edge[SENSE] == 0.0:
                points.append(edge[None, :2])
            else:
                turned = np.stack(
                    [u * np.cos(turn) - v * np.sin(turn), u * np.sin(turn) + v * np.cos(turn)], axis=1
                )
                points.append(edge[CX : CY + 1] + turned)
            side += [n] * pieces
    start = np.concatenate(points)
    return np.concatenate([start, np.roll(start, -1, axis=0)], axis=1), np.array(side)


def _edges_of(vertices: tuple[Vertex, ...], n: int) -> Floats:
    """Edges of one side: one edge, or the parts of an arc of more than 90°."""
    bulge = vertices[n][2]
    parts = 1 if bulge == 0.0 else ceil(4.0 * atan(abs(bulge)) / (0.5 * pi) - 1e-9)
    (x, y, _), (u, v, _) = vertices[n], vertices[(n + 1) % len(vertices)]
    return Plate(((x, y, bulge), (u, v, 0.0))).edges[:parts]


def _swept(edge: Floats) -> float:
    """Signed angle (radians) of an arc."""
    a, b = edge[:2] - edge[CX : CY + 1], edge[2:4] - edge[CX : CY + 1]
    return float(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b))


def _first_meeting(chords: Floats, near: float) -> tuple[int, int] | None:
    """First two pieces (4,) of a closed chain that intersect, not as neighbours, or fold back; else None."""
    low, high = (
        np.minimum(chords[:, :2], chords[:, 2:]) - near,
        np.maximum(chords[:, :2], chords[:, 2:]) + near,
    )
    order = np.argsort(low[:, 0], kind="stable")
    starts = low[order, 0]
    m = len(chords)
    for place, k in enumerate(order):
        last = int(np.searchsorted(starts, high[k, 0], side="right"))
        rest = order[place + 1 : last]
        rest = rest[(low[rest, 1] <= high[k, 1]) & (high[rest, 1] >= low[k, 1])]
        if not len(rest):
            continue
        apart = (rest - k) % m
        beside = (apart == 1) | (apart == m - 1)
        if m > 2 and beside.any():
            folded = [int(j) for j in rest[beside] if _folds(chords, int(k), int(j), near)]
            if folded:
                return int(k), folded[0]
        met = rest[~beside][_meets(chords[k], chords[rest[~beside]], near)]
        if len(met):
            return int(k), int(met[0])
    return None


def _folds(chords: Floats, k: int, j: int, near: float) -> bool:
    """Whether two neighbouring pieces fold back over one another."""
    first, second = (k, j) if (j - k) % len(chords) == 1 else (j, k)
    u, v = chords[first, 2:] - chords[first, :2], chords[second, 2:] - chords[second, :2]
    return bool(u @ v < 0.0 and abs(u[0] * v[1] - u[1] * v[0]) <= near * max(np.hypot(*u), np.hypot(*v)))


def _meets(one: Floats, others: Floats, near: float) -> Bools:
    """Which of the pieces `others` (k, 4) intersect the piece `one`, within `near` (length)."""
    a, b, c, d = one[:2], one[2:], others[:, :2], others[:, 2:]

    def beside(p: Floats, q: Floats, r: Floats) -> Floats:
        way = q - p
        length = np.hypot(way[..., 0], way[..., 1])
        return np.asarray(
            (way[..., 0] * (r - p)[..., 1] - way[..., 1] * (r - p)[..., 0]) / np.maximum(length, 1e-300)
        )

    def within(x: Floats, y: Floats) -> Bools:
        """Whether two signed distances do not lie on the same side beyond `near`."""
        return np.asarray(~(((x > near) & (y > near)) | ((x < -near) & (y < -near))))

    return np.asarray(within(beside(a, b, c), beside(a, b, d)) & within(beside(c, d, a), beside(c, d, b)))
