"""Arithmetic over many triangles and rows at once is that of numpy's own general functions, to the last bit."""

from __future__ import annotations

import numpy as np
import pytest

from clacad.base.arrays import unique_rows
from clacad.base.vectors import doubled_normals, lengths, middles


def corners(count: int) -> np.ndarray:
    return np.random.default_rng(count).normal(size=(count, 3, 3)) * 1e3


@pytest.mark.parametrize("count", [0, 1, 5, 4097])
def test_normals_lengths_and_middles_are_those_of_numpy_bit_by_bit(count):
    facets = corners(count)
    normal = np.cross(facets[:, 1] - facets[:, 0], facets[:, 2] - facets[:, 0])
    np.testing.assert_array_equal(doubled_normals(facets), normal)
    np.testing.assert_array_equal(lengths(doubled_normals(facets)), np.linalg.norm(normal, axis=1))
    np.testing.assert_array_equal(middles(facets), facets.mean(axis=1))


@pytest.mark.parametrize("reach", [1, 3, 1 << 20, 1 << 40])
@pytest.mark.parametrize("columns", [1, 2, 4])
def test_distinct_rows_come_as_numpy_gives_them(reach, columns):
    rows = np.random.default_rng(columns).integers(-reach, reach + 1, size=(500, columns))
    found, number = unique_rows(rows)
    wanted, which = np.unique(rows, axis=0, return_inverse=True)
    np.testing.assert_array_equal(found, wanted)
    np.testing.assert_array_equal(number, which.reshape(-1))


def test_no_rows_have_no_distinct_ones():
    found, number = unique_rows(np.empty((0, 2), dtype=np.int64))
    assert found.shape == (0, 2)
    assert number.shape == (0,)


def test_rows_of_unsigned_bytes_are_told_apart():
    rows = np.array([[255, 0], [0, 255], [255, 0]], dtype=np.uint8)
    found, number = unique_rows(rows)
    assert found.tolist() == [[0, 255], [255, 0]]
    assert number.tolist() == [1, 0, 1]
