"""Vectors of many triangles at once: their normals, the lengths of those, their middles."""

from __future__ import annotations

import numpy as np

from clacad.base.types import Floats


def doubled_normals(corners: Floats) -> Floats:
    """Normals (k, 3) of triangles (k, 3, 3) by the right hand, as long as twice their areas (length²).

    A column at a time: what ``numpy.cross`` gives of two edges, in a third of its time.
    """
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = np.ascontiguousarray(np.moveaxis(corners, 0, -1))
    ux, uy, uz = bx - ax, by - ay, bz - az
    vx, vy, vz = cx - ax, cy - ay, cz - az
    return np.stack([uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx]).T


def lengths(vectors: Floats) -> Floats:
    """Lengths (k,) of vectors (k, 3)."""
    x, y, z = vectors.T
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def middles(corners: Floats) -> Floats:
    """Middles (k, 3) of triangles (k, 3, 3)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    return np.asarray((a + b + c) / 3.0)
