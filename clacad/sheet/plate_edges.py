"""Edges of plates, straight and round: areas, inside tests, distances, crossings. Lengths in design units.

An edge is a row with the columns of `clacad.sheet.edge_columns`. An arc spans at most 90°, so a point of its
circle is on the arc if it lies on the arc's side of the chord.
"""

from __future__ import annotations

from math import atan, ceil, cos, hypot, pi, sin, sqrt, tan

import numpy as np

from clacad.base.polygons import within
from clacad.base.types import Bools, Floats
from clacad.sheet.edge_columns import CX, CY, RADIUS, SENSE, X0, X1, Y0, Y1

Vertex = tuple[float, float, float]
"""x, y, and the bulge of the side that begins there."""


STRAIGHT = 1e-12
"""Bulge below which a side is straight: the arc's rise is half the bulge times the chord,
less than rounding error.
"""


def loop_area(edges: Floats) -> float:
    """Signed area of a closed loop of edges, length²: polygon of the chords, and arcs' segments."""
    x, y = edges[:, X0] - edges[0, X0], edges[:, Y0] - edges[0, Y0]
    u, v = np.roll(x, -1), np.roll(y, -1)
    total = 0.5 * float(np.sum(x * v - u * y))
    for edge in edges[edges[:, SENSE] != 0.0]:
        angle = arc_angle(edge)
        total += 0.5 * edge[SENSE] * edge[RADIUS] ** 2 * (angle - sin(angle))
    return float(total)


def bulges(edges: Floats) -> Floats:
    """Bulge (e,) of each edge."""
    return np.array([edge[SENSE] * tan(0.25 * arc_angle(edge)) for edge in edges])


def inside(edges: Floats, points: Floats) -> Bools:
    """Which points (n, 2) lie in the region bounded by edges (e, EDGE_NUMBERS).

    Crossings of the chords to the right of a point are counted, and each arc's segment inverts the result.
    Both use the same side test of the same chord, so that a point on a chord is decided once.
    """
    found = np.zeros(len(points), dtype=bool)
    step = max(1, 4_000_000 // max(1, len(edges)))
    for first in range(0, len(points), step):
        x, y = points[first : first + step, :1], points[first : first + step, 1:]
        left = (edges[:, X1] - edges[:, X0]) * (y - edges[:, Y0]) > (edges[:, Y1] - edges[:, Y0]) * (
            x - edges[:, X0]
        )
        up, down = edges[:, Y0] <= y, edges[:, Y1] <= y
        crossed = (up & ~down & left) | (~up & down & ~left)
        square = (x - edges[:, CX]) ** 2 + (y - edges[:, CY]) ** 2
        beside = np.where(edges[:, SENSE] > 0.0, ~left, left)
        segment = (edges[:, SENSE] != 0.0) & beside & (square < edges[:, RADIUS] ** 2)
        found[first : first + step] = (crossed ^ segment).sum(axis=1) % 2 == 1
    return found


def edge_gaps(edge: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Distance (n,) of points (n, 2) from one edge, and its unit normal (n, 2) there, to its right."""
    a, b = edge[:2], edge[2:4]
    if edge[SENSE] == 0.0:
        along = b - a
        length = float(np.hypot(*along))
        share = np.clip((points - a) @ along / length**2, 0.0, 1.0)
        gap = np.hypot(*(points - a - share[:, None] * along).T)
        return gap, np.broadcast_to(np.array([along[1], -along[0]]) / length, points.shape)
    way = points - edge[CX : CY + 1]
    radius = np.maximum(np.hypot(*way.T), 1e-300)
    outward = way / radius[:, None]
    (ax, ay), (bx, by) = a - edge[CX : CY + 1], b - edge[CX : CY + 1]
    turns = (ax * outward[:, 1] - ay * outward[:, 0]) * edge[SENSE] >= 0.0
    turns &= (outward[:, 0] * by - outward[:, 1] * bx) * edge[SENSE] >= 0.0
    ends = np.minimum(np.hypot(*(points - a).T), np.hypot(*(points - b).T))
    gap = np.where(turns, np.abs(radius - edge[RADIUS]), ends)
    return gap, edge[SENSE] * outward


def crossings(edges: Floats, x: Floats, y: Floats, dx: Floats, dy: Floats) -> Floats:
    """Parameters t (2 e, n) at which lines (x, y) + t (dx, dy), (n,) each, cross edges; else NaN."""
    x0, y0, x1, y1, cx, cy, r, sense = (column[:, None] for column in edges.T)
    with np.errstate(all="ignore"):
        u, v = x1 - x0, y1 - y0
        first, last = u * (y - y0) - v * (x - x0), dy * u - dx * v
        t = -first / last
        along = (x + t * dx - x0) * u + (y + t * dy - y0) * v
        straight = np.where((along >= 0.0) & (along <= u * u + v * v), t, np.nan)
        px, py = x - cx, y - cy
        a, b, c = dx * dx + dy * dy, px * dx + py * dy, px * px + py * py - r * r
        q = -(b + np.copysign(np.sqrt(b * b - a * c), b))
        found = []
        for t in (c / q, q / a):
            left = u * (y + t * dy - y0) > v * (x + t * dx - x0)
            found.append(np.where(np.where(sense > 0.0, ~left, left), t, np.nan))
    return np.concatenate(
        [np.where(sense == 0.0, straight, found[0]), np.where(sense == 0.0, np.nan, found[1])]
    )


# -- one edge ---------------------------------------------------------------------------------------


def closed_loop(vertices: tuple[Vertex, ...]) -> Floats:
    """Edges of a closed polygon of straight and round sides; arcs above 90° are cut equally."""
    made: list[Floats] = []
    for (x0, y0, bulge), (x1, y1, _) in zip(vertices, (*vertices[1:], vertices[0]), strict=True):
        if abs(bulge) < STRAIGHT:
            made.append(np.array([x0, y0, x1, y1, 0.0, 0.0, 0.0, 0.0]))
            continue
        angle = 4.0 * atan(abs(bulge))
        sense, chord = (1.0 if bulge > 0.0 else -1.0), hypot(x1 - x0, y1 - y0)
        radius = 0.25 * chord * (1.0 + bulge * bulge) / abs(bulge)
        # the centre lies to the left of the chord of a short arc that bends to its right
        over = 0.25 * chord * (1.0 / bulge - bulge) / chord
        centre = 0.5 * (x0 + x1) - over * (y1 - y0), 0.5 * (y0 + y1) + over * (x1 - x0)
        parts = ceil(angle / (0.5 * pi) - 1e-9)
        points = [(x0, y0)]
        for n in range(1, parts):
            turn = sense * angle * n / parts
            u, v = x0 - centre[0], y0 - centre[1]
            points.append(
                (centre[0] + u * cos(turn) - v * sin(turn), centre[1] + u * sin(turn) + v * cos(turn))
            )
        points.append((x1, y1))
        made += [np.array([*p, *q, *centre, radius, sense]) for p, q in zip(points[:-1], points[1:])]
    return np.array(made)


def arc_angle(edge: Floats) -> float:
    """Angle (radians) of an arc of at most 90°; 0 for a straight edge."""
    if edge[SENSE] == 0.0:
        return 0.0
    chord = hypot(edge[X1] - edge[X0], edge[Y1] - edge[Y0])
    return 2.0 * float(np.arcsin(min(1.0, 0.5 * chord / edge[RADIUS])))


def as_sides(edge: Floats, sides: int) -> Floats:
    """Points (sides, 2) of an edge without its end; only the start of a straight edge."""
    if edge[SENSE] == 0.0:
        return edge[None, :2]
    angle, r = arc_angle(edge) / sides, float(edge[RADIUS])
    # sides · area of a fan triangle = the sector: (n − 2) s² + 2 r s = n r² (φ/n)/sin(φ/n), s for the inner
    # corners
    whole = sides * r * r * angle / sin(angle)
    n = sides - 2
    outer = whole / (2.0 * r) if n == 0 else (sqrt(r * r + n * whole) - r) / n
    turn = edge[SENSE] * angle * np.arange(sides)
    u, v = edge[X0] - edge[CX], edge[Y0] - edge[CY]
    share = np.where(np.arange(sides) == 0, 1.0, outer / r)
    points = np.stack([u * np.cos(turn) - v * np.sin(turn), u * np.sin(turn) + v * np.cos(turn)], axis=1)
    made = edge[CX : CY + 1] + share[:, None] * points
    made[0] = edge[:2]
    return np.asarray(made)


def edge_box(edge: Floats) -> tuple[Floats, Floats]:
    """Corners of an axis-aligned box that contains an edge."""
    if edge[SENSE] != 0.0 and arc_angle(edge) > 0.0:
        points = extremes(edge[None])
        return points.min(axis=0), points.max(axis=0)
    return np.minimum(edge[:2], edge[2:4]), np.maximum(edge[:2], edge[2:4])


def extremes(edges: Floats) -> Floats:
    """Candidates for the extremes of edges: starts, ends, and arcs' points parallel to an axis."""
    points = [edges[:, :2], edges[:, 2:4]]
    for edge in edges[edges[:, SENSE] != 0.0]:
        around = edge[CX : CY + 1] + edge[RADIUS] * np.array(
            [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)]
        )
        a, b = edge[:2], edge[2:4]
        left = (b[0] - a[0]) * (around[:, 1] - a[1]) > (b[1] - a[1]) * (around[:, 0] - a[0])
        # a point that differs from the chord's end only by rounding error is that end
        deep = np.minimum(np.hypot(*(around - a).T), np.hypot(*(around - b).T)) > 1e-9 * edge[RADIUS]
        points.append(around[(~left if edge[SENSE] > 0.0 else left) & deep])
    return np.concatenate(points)


def keeps_off(edge: Floats, tile: Floats, centres: Floats, room: float) -> Bools:
    """Which cells (n,) keep the distance `room` from an edge."""
    gaps = polygon_gaps(edge, tile, centres)
    held = gaps >= room
    ends = edge[:2] - centres
    return np.asarray(held & ~within(tile, ends[:, 0], ends[:, 1]))


def polygon_gaps(edge: Floats, polygon: Floats, centres: Floats) -> Floats:
    """Least distance (n,) of an edge from a polygon (m, 2) about centres (n, 2); 0 where they cross."""
    least = np.full(len(centres), np.inf)
    for p, q in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        start = centres + p
        least = np.minimum(least, edge_gaps(edge, start)[0])
        way = q - p
        met = crossings(
            edge[None], start[:, 0], start[:, 1], np.full(len(start), way[0]), np.full(len(start), way[1])
        )
        with np.errstate(invalid="ignore"):
            least = np.where(((met >= 0.0) & (met <= 1.0)).any(axis=0), 0.0, least)
        for point in _near_points(edge, way):
            share = np.clip((point - start) @ way / (way @ way), 0.0, 1.0)
            least = np.minimum(least, np.hypot(*(start + share[:, None] * way - point).T))
    return least


def _near_points(edge: Floats, way: Floats) -> Floats:
    """Candidate points of an edge nearest to a side along `way`: ends, and where an arc is parallel."""
    ends = np.stack([edge[:2], edge[2:4]])
    if edge[SENSE] == 0.0:
        return ends
    across = np.array([way[1], -way[0]]) / np.hypot(*way)
    both = edge[CX : CY + 1] + edge[RADIUS] * np.stack([across, -across])
    a, b = ends
    left = (b[0] - a[0]) * (both[:, 1] - a[1]) > (b[1] - a[1]) * (both[:, 0] - a[0])
    return np.concatenate([ends, both[~left if edge[SENSE] > 0.0 else left]])


# -- many edges -------------------------------------------------------------------------------------


def nearest_edges(edges: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Distance (n,) of points (n, 2) from the nearest edge, and its outward unit normal there (n, 2)."""
    least, normals = np.full(len(points), np.inf), np.zeros((len(points), 2))
    for edge in edges:
        gap, normal = edge_gaps(edge, points)
        closer = gap < least
        least, normals = np.where(closer, gap, least), np.where(closer[:, None], normal, normals)
    return least, normals


def next_crossing(edges: Floats, points: Floats, ways: Floats, after: Floats) -> Floats:
    """Least parameter (n,) beyond `after` at which rays along ways (n, 2) cross an edge; else infinite."""
    least = np.full(len(points), np.inf)
    step = max(1, 1_000_000 // max(1, len(points)))
    for first in range(0, len(edges), step):
        t = crossings(edges[first : first + step], *points.T, *ways.T)
        with np.errstate(invalid="ignore"):
            least = np.minimum(least, np.where(t > after, t, np.inf).min(axis=0, initial=np.inf))
    return least
