"""Compiled search for the facet a ray meets first; imported only when rays are sent through triangles."""

from __future__ import annotations

import numpy as np

from clacad.base.compiled import exact
from clacad.base.types import Floats, Ints


@exact
def first_facet(
    corners: Floats, normals: Floats, low: Floats, size: Floats, count: int, start: Ints, member: Ints,
    z_low: float, z_high: float, position: Floats, direction: Floats, facing: float, slack: float,
    distance: Floats, facet: Ints,
) -> None:  # fmt: skip
    """Fill `distance` (n,) and `facet` (n,) for rays with d_z > 0; NaN and −1 where none is met.

    Every facet of every bin that the ray passes between the lowest and the highest point of the face is asked;
    of those that face the right way (facing × normal · direction > 0) and hold the point, the nearest ahead.
    """
    for r in range(len(position)):
        x, y, z = position[r, 0], position[r, 1], position[r, 2]
        u, v, w = direction[r, 0], direction[r, 1], direction[r, 2]
        x0, x1 = x + u / w * (z_low - z), x + u / w * (z_high - z)
        y0, y1 = y + v / w * (z_low - z), y + v / w * (z_high - z)
        margin_x, margin_y = 1e-9 * size[0], 1e-9 * size[1]
        i0 = int(np.floor((min(x0, x1) - margin_x - low[0]) / size[0]))
        i1 = int(np.floor((max(x0, x1) + margin_x - low[0]) / size[0]))
        j0 = int(np.floor((min(y0, y1) - margin_y - low[1]) / size[1]))
        j1 = int(np.floor((max(y0, y1) + margin_y - low[1]) / size[1]))
        best, which = np.inf, -1
        # a point on the far rim of the grid belongs to the last bin
        for i in range(max(i0, 0), min(i1, count) + 1):
            for j in range(max(j0, 0), min(j1, count) + 1):
                b = min(i, count - 1) * count + min(j, count - 1)
                for m in range(start[b], start[b + 1]):
                    k = member[m]
                    nx, ny, nz = normals[k, 0], normals[k, 1], normals[k, 2]
                    along = nx * u + ny * v + nz * w
                    if along * facing <= 0.0:
                        continue
                    t = (
                        nx * (corners[k, 0, 0] - x)
                        + ny * (corners[k, 0, 1] - y)
                        + nz * (corners[k, 0, 2] - z)
                    ) / along
                    if t < 0.0 or t >= best:
                        continue
                    hx, hy = x + t * u, y + t * v
                    sign = 1.0 if nz > 0.0 else -1.0
                    room = -slack * abs(nz)
                    inside = True
                    for c in range(3):
                        e = (c + 1) % 3
                        ax, ay = corners[k, c, 0], corners[k, c, 1]
                        cross = (corners[k, e, 0] - ax) * (hy - ay) - (corners[k, e, 1] - ay) * (hx - ax)
                        if sign * cross < room:
                            inside = False
                            break
                    if inside:
                        best, which = t, k
        facet[r] = which
        distance[r] = best if which >= 0 else np.nan
