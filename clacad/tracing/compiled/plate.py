"""Compiled twins of `clacad.sheet.plate_edges`: whether a point lies in a plate, and the next edge that a ray
crosses.
"""

from __future__ import annotations

from math import copysign, inf, sqrt

from clacad.base.compiled import exact
from clacad.base.types import Floats
from clacad.sheet.edge_columns import CX, CY, RADIUS, SENSE, X0, X1, Y0, Y1


@exact
def in_plate(edges: Floats, x: float, y: float) -> bool:
    """Whether a point lies in the material that edges (e, EDGE_NUMBERS) bound; see `clacad.sheet.plate_edges.inside`."""
    found = False
    for n in range(len(edges)):
        low, high = edges[n, Y0] <= y, edges[n, Y1] <= y
        sense = edges[n, SENSE]
        if low == high and sense == 0.0:
            continue
        left = _left(edges, n, x, y)
        if low != high and (left == low):
            found = not found
        if sense != 0.0 and left == (sense < 0.0):
            u, v = x - edges[n, CX], y - edges[n, CY]
            if u * u + v * v < edges[n, RADIUS] * edges[n, RADIUS]:
                found = not found
    return found


@exact
def next_edge(edges: Floats, x: float, y: float, L: float, M: float, after: float) -> float:
    """Least distance beyond `after` at which a ray's projection on the sheet crosses an edge; infinite
    without one.
    """
    nearest = inf
    for n in range(len(edges)):
        u, v = edges[n, X1] - edges[n, X0], edges[n, Y1] - edges[n, Y0]
        px, py = x - edges[n, X0], y - edges[n, Y0]
        if edges[n, SENSE] == 0.0:
            speed = u * M - v * L
            if speed == 0.0:
                continue
            t = -(u * py - v * px) / speed
            along = (px + t * L) * u + (py + t * M) * v
            if after < t < nearest and 0.0 <= along <= u * u + v * v:
                nearest = t
            continue
        px, py = x - edges[n, CX], y - edges[n, CY]
        square, half = L * L + M * M, px * L + py * M
        rest = px * px + py * py - edges[n, RADIUS] * edges[n, RADIUS]
        disc = half * half - square * rest
        if square == 0.0 or not disc >= 0.0:
            continue
        q = -(half + copysign(sqrt(disc), half))
        for k in range(2):
            if k == 0 and q == 0.0:
                continue
            t = rest / q if k == 0 else q / square
            if after < t < nearest and _left(edges, n, x + t * L, y + t * M) == (edges[n, SENSE] < 0.0):
                nearest = t
    return nearest


@exact
def _left(edges: Floats, n: int, x: float, y: float) -> bool:
    """Whether a point lies to the left of the chord of an edge."""
    return bool(
        (edges[n, X1] - edges[n, X0]) * (y - edges[n, Y0])
        > (edges[n, Y1] - edges[n, Y0]) * (x - edges[n, X0])
    )
