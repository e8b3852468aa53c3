"""Arrays: distinct numbers and rows, and vectors of many triangles at once.

Distinct numbers, and distinct rows of integers, compared as single numbers where a row fits into one.

Vectors of many triangles at once: normals, lengths of vectors, centroids.
"""

from __future__ import annotations

from math import prod
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Ints

Number = TypeVar("Number", bound=np.number[Any])


def distinct(numbers: NDArray[Number]) -> NDArray[Number]:
    """Distinct values (k,) of numbers (n,), in ascending order; none may be NaN.

    Same result as ``numpy.unique``, without its 0.03 s for loading masked arrays.
    """
    ordered = np.sort(numbers)
    first = np.ones(len(ordered), dtype=np.bool_)
    first[1:] = ordered[1:] != ordered[:-1]
    return np.asarray(ordered[first])


def unique_rows(rows: Ints) -> tuple[Ints, Ints]:
    """Distinct rows in ascending order (k, c), and for each row the index of its distinct row (n,).

    Same result as ``numpy.unique(rows, axis=0, return_inverse=True)``, which compares rows as bytes and takes
    twenty times as long.

    Parameters
    ----------
    rows : (n, c) ints
    """
    if len(rows):
        low, high = rows.min(axis=0), rows.max(axis=0)
        sizes = [int(b) - int(a) + 1 for a, b in zip(low, high, strict=True)]
        if prod(sizes) < 1 << 62:
            key = np.zeros(len(rows), dtype=np.int64)
            for column, least, size in zip(rows.T, low, sizes, strict=True):
                key = key * size + (column.astype(np.int64) - int(least))
            _, first, number = np.unique(key, return_index=True, return_inverse=True)
            return rows[first], number.reshape(-1)
    found, number = np.unique(rows, axis=0, return_inverse=True)
    return found, number.reshape(-1)


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
