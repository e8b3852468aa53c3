"""Triangles in a tree of boxes, compiled: the twin of `tracing.triangles.median_tree.nearest_triangle`, one ray at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clacad.base.compiled import exact
from clacad.base.types import Floats
from clacad.rendering.compiled.scene_tables import FACET, NODE
from clacad.tracing.compiled.records import Ray, Vector

DEPTH = 64
"""Largest number of waiting nodes: median splits make the tree no deeper than the bits of the number of
triangles.
"""


@exact
def in_tree(
    store: Floats, root: int, ray: Ray, limit: float, waiting: NDArray[np.int64]
) -> tuple[float, int]:
    """Distance and number of the first triangle below `limit`; −1 where there is none. `waiting` is scratch."""
    waiting[0] = root
    height, distance, facet = 1, limit, -1
    inverse = (1.0 / ray.L, 1.0 / ray.M, 1.0 / ray.N)
    while height > 0:
        height -= 1
        node = waiting[height]
        if not meets_box(store, node, (ray.x, ray.y, ray.z), inverse, distance):
            continue
        child, count = int(store[node + 6]), int(store[node + 7])
        if count == 0:
            waiting[height] = child + NODE
            waiting[height + 1] = child
            height += 2
            continue
        for k in range(child, child + FACET * count, FACET):
            s = to_triangle(store, k, ray)
            if s > 0.0 and s < distance:
                distance, facet = s, k
    return distance, facet


@exact
def meets_box(store: Floats, node: int, start: Vector, inverse: Vector, limit: float) -> bool:
    """Whether a ray meets a box before `limit`; 0 times ∞ on a side's plane counts as inside."""
    near, far = -np.inf, np.inf
    for k in range(3):
        p, d = start[k], inverse[k]
        a, b = (store[node + k] - p) * d, (store[node + 3 + k] - p) * d
        if a == a and b == b:
            near, far = max(near, min(a, b)), min(far, max(a, b))
    return near <= far * (1.0 + 1e-14) and far >= 0.0 and near <= limit


@exact
def to_triangle(store: Floats, k: int, ray: Ray) -> float:
    """Distance to the plane of a triangle where it is hit, else NaN."""
    x, y, z, u, v, w = ray
    cx, cy, cz = store[k], store[k + 1], store[k + 2]
    ax, ay, az = store[k + 3] - cx, store[k + 4] - cy, store[k + 5] - cz
    bx, by, bz = store[k + 6] - cx, store[k + 7] - cy, store[k + 8] - cz
    px, py, pz = v * bz - w * by, w * bx - u * bz, u * by - v * bx
    det = px * ax + py * ay + pz * az
    sx, sy, sz = x - cx, y - cy, z - cz
    f = (sx * px + sy * py + sz * pz) / det
    qx, qy, qz = sy * az - sz * ay, sz * ax - sx * az, sx * ay - sy * ax
    g = (u * qx + v * qy + w * qz) / det
    if f >= 0.0 and g >= 0.0 and f + g <= 1.0:
        return float((qx * bx + qy * by + qz * bz) / det)
    return np.nan
