"""Distinct numbers, and distinct rows of integers, compared as single numbers where a row fits into one."""

from __future__ import annotations

from math import prod
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Ints

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
