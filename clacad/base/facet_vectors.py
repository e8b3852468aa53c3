"""Vectors of many triangles at once: normals, lengths of vectors, centroids."""

from __future__ import annotations

import numpy as np

from clacad.base.types import Floats


def doubled_normals(corners: Floats) -> Floats:
    """Right-hand normals (k, 3) of triangles (k, 3, 3), with twice the triangle's area as length (length²).

    Computed column by column: the result of ``numpy.cross`` of two edges in a third of its time.
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
    """Centroids (k, 3) of triangles (k, 3, 3)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    return np.asarray((a + b + c) / 3.0)
