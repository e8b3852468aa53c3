"""Rims: the curves inside a cell where the lens ends on the other lens, on a plane, on land."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from clacad.base.roots import bisect
from clacad.base.types import Floats
from clacad.sheet.window import Body, Window, lens_height, optical_tile
from clacad.topology.complex_parts import Rim, RimArc, RimKind

_EPS = float(np.finfo(np.float64).eps)
_FAN = 24  # squares a side of the tracing grid


def find_rims(window: Window, body: Body) -> tuple[Rim, ...]:
    """Trace every rim of a columnar body's cell, each point exact to rounding."""
    rims = []
    for kind, function, height in _functions(body):
        # A rim that touches a corner of the cell to rounding is no rim.
        noise = 32.0 * _EPS * max(abs(window.z_range[0]), abs(window.z_range[1]))
        arcs = trace_zero(partial(_lifted, function, noise), optical_tile(window), height)
        if arcs:
            rims.append(Rim(kind, arcs))
    return tuple(rims)


def _lifted(function: Height, by: float, x: Floats, y: Floats) -> Floats:
    return function(x, y) + by


Height = Callable[[Floats, Floats], Floats]


def _functions(body: Body) -> list[tuple[RimKind, Height, Height]]:
    """Give (kind, function > 0 on the lens's side, height on the curve) for each rim a body can have."""

    def front(x: Floats, y: Floats) -> Floats:
        return _height(body, "front", x, y)

    def back(x: Floats, y: Floats) -> Floats:
        return _height(body, "back", x, y)

    found: list[tuple[RimKind, Height, Height]] = [
        ("front-back", lambda x, y: back(x, y) - front(x, y), front)
    ]
    front_land, back_land = body.front.land, body.back.land
    if body.front.array is not None and front_land is not None:
        found.append(("front-land", lambda x, y: front_land - front(x, y), front))
    if body.back.array is not None and back_land is not None:
        found.append(("back-land", lambda x, y: back(x, y) - back_land, back))
    return found


def _height(body: Body, side: str, x: Floats, y: Floats) -> Floats:
    face = body.front if side == "front" else body.back
    return np.full(np.shape(x), face.vertex[2]) if face.array is None else lens_height(face, x, y)


def trace_zero(function: Height, polygon: Floats, height: Height, fan: int = _FAN) -> tuple[RimArc, ...]:
    """Trace the zero curves of a function inside a convex polygon.

    The polygon is triangulated as `fan`² triangles about its centre per side; curves that dip between
    two neighbouring grid points of the inside are not seen (on the polygon's own sides none is missed,
    if the caller passes those roots to the mesh).

    Returns
    -------
    tuple of RimArc
        The region where the function is positive lies on the left hand.
    """
    points, triangles = _fan_grid(polygon, fan)
    value = function(points[:, 0], points[:, 1])
    positive = value > 0.0
    if positive.all() or not positive.any():
        return ()
    edges = np.sort(
        np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1
    )
    edges, inverse = np.unique(edges, axis=0, return_inverse=True)
    number = inverse.reshape(3, -1).T
    cut = positive[edges[:, 0]] != positive[edges[:, 1]]
    a, b = points[edges[:, 0]], points[edges[:, 1]]
    inside = np.where(positive[edges[:, 0]][:, None], a, b)[cut]
    outside = np.where(positive[edges[:, 0]][:, None], b, a)[cut]

    def along(t: Floats) -> Floats:
        p = inside + t[:, None] * (outside - inside)
        return np.where(function(p[:, 0], p[:, 1]) > 0.0, 1.0, -1.0)

    count = int(cut.sum())
    t = bisect(along, np.zeros(count), np.ones(count))
    root = np.full((len(edges), 2), np.nan)
    root[cut] = inside + t[:, None] * (outside - inside)
    follows: dict[int, int] = {}
    for corner, edge in zip(triangles, number):
        sign = positive[corner]
        if sign.all() or not sign.any():
            continue
        lone = int(np.flatnonzero(sign == (sign.sum() == 1))[0])
        leaving, entering = int(edge[lone]), int(edge[(lone + 2) % 3])
        # positive on the left hand: round a lone positive corner the curve runs from the edge after it
        first, second = (leaving, entering) if sign[lone] else (entering, leaving)
        follows[first] = second
    return tuple(_arc(chain, closed, root, polygon, height) for chain, closed in _chains(follows))


def _fan_grid(polygon: Floats, n: int) -> tuple[Floats, Floats]:
    """Triangulate a convex polygon about its centre, n rings, (points, triangles)."""
    m = len(polygon)
    points = [np.zeros((1, 2))]
    start = [0]
    for ring in range(1, n + 1):
        start.append(1 + m * ring * (ring - 1) // 2)
        f = np.arange(ring)[:, None] / ring
        for k in range(m):
            a, b = polygon[k], polygon[(k + 1) % m]
            points.append((ring / n) * (a * (1 - f) + b * f))
    triangles = []
    for ring in range(1, n + 1):
        inner, outer = max(m * (ring - 1), 1), m * ring
        for k in range(m):
            for s in range(ring):
                o0, o1 = start[ring] + k * ring + s, start[ring] + (k * ring + s + 1) % outer
                i0 = start[ring - 1] + (k * (ring - 1) + s) % inner if ring > 1 else 0
                triangles.append((o0, o1, i0))
                if s:
                    before = start[ring - 1] + (k * (ring - 1) + s - 1) % inner
                    triangles.append((o0, i0, before))
    return np.concatenate(points), np.asarray(triangles)


def _chains(follows: dict[int, int]) -> list[tuple[list[int], bool]]:
    """Link directed segments to maximal chains: (edge numbers, closed)."""
    chains: list[tuple[list[int], bool]] = []
    starts = sorted(set(follows) - set(follows.values()))
    left = dict(follows)
    for first in starts + sorted(follows):
        if first not in left:
            continue
        chain = [first]
        while chain[-1] in left:
            chain.append(left.pop(chain[-1]))
            if chain[-1] == first:
                break
        chains.append((chain, chain[-1] == first))
    return chains


def _arc(chain: list[int], closed: bool, root: Floats, polygon: Floats, height: Height) -> RimArc:
    points = root[np.asarray(chain)]
    z = height(points[:, 0], points[:, 1])
    ends = None if closed else (_on_side(points[0], polygon), _on_side(points[-1], polygon))
    return RimArc(points, z, closed, ends[0] if ends else None, ends[1] if ends else None)


def _on_side(point: Floats, polygon: Floats) -> tuple[int, float]:
    """Which side of the polygon a boundary point lies on, and where."""
    a = polygon
    along = np.roll(polygon, -1, axis=0) - a
    length = np.hypot(along[:, 0], along[:, 1])
    across = np.abs(along[:, 0] * (point[1] - a[:, 1]) - along[:, 1] * (point[0] - a[:, 0])) / length
    k = int(np.argmin(across))
    return k, float((along[k] @ (point - a[k])) / length[k] ** 2)
