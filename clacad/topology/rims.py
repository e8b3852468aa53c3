"""Rims: the curves inside a cell where a lens ends at the other lens, at a plane or at land."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from clacad.base.roots import bisect
from clacad.base.types import Bools, Floats, Ints
from clacad.base.unique_rows import unique_rows

FAN = 24
"""Default number of rings of the grid on which a rim is searched."""

Gap = Callable[[Floats, Floats], Floats]
"""Height of one surface over another at x, y (n,): positive on the side of the lens, zero on the rim."""


@dataclass(frozen=True, slots=True, eq=False)
class TracedCurve:
    """A connected stretch of a rim inside one cell.

    points : (n, 2) lengths
        Points on the curve in the cell frame, in order, the lens on the left hand; exact to rounding.
    closed : bool
        A loop inside the cell (its last point is its first); otherwise it runs from side to side.
    """

    points: Floats
    closed: bool


def trace_zero(function: Gap, polygon: Floats, fan: int = FAN) -> tuple[TracedCurve, ...]:
    """Trace the zero curves of a function inside a convex polygon.

    The polygon is triangulated as `fan`² triangles about its centre per side. Curves that dip between two
    neighbouring inner grid points are missed. On the polygon's own sides none is missed if the caller
    passes their roots to the mesh.

    Parameters
    ----------
    function : callable
    polygon : (m, 2) lengths
        Corners, counter-clockwise.
    fan : int

    Returns
    -------
    tuple of TracedCurve
        The region where the function is positive lies on the left hand.
    """
    points, triangles = _fan_grid(polygon, fan)
    positive = function(points[:, 0], points[:, 1]) > 0.0
    if positive.all() or not positive.any():
        return ()
    edges = np.sort(
        np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1
    )
    edges, inverse = unique_rows(edges)
    roots = _edge_roots(function, points, edges, positive)
    follows = _following_edges(triangles, inverse.reshape(3, -1).T, positive)
    return tuple(TracedCurve(roots[np.asarray(chain)], closed) for chain, closed in _chains(follows))


def _edge_roots(function: Gap, points: Floats, edges: Ints, positive: Bools) -> Floats:
    """Root of the function on every edge whose ends differ in sign, (edges, 2); NaN on the others."""
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
    return root


def _following_edges(triangles: Ints, number: Ints, positive: Bools) -> dict[int, int]:
    """Edge by which the curve enters a triangle → edge by which it leaves; `number` (t, 3): edge numbers."""
    follows: dict[int, int] = {}
    for corner, edge in zip(triangles, number):
        sign = positive[corner]
        if sign.all() or not sign.any():
            continue
        lone = int(np.flatnonzero(sign == (sign.sum() == 1))[0])
        leaving, entering = int(edge[lone]), int(edge[(lone + 2) % 3])
        # positive on the left hand: around a single positive corner the curve runs from the edge after it
        first, second = (leaving, entering) if sign[lone] else (entering, leaving)
        follows[first] = second
    return follows


def _fan_grid(polygon: Floats, n: int) -> tuple[Floats, Ints]:
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
