"""Walls: strips where exactly one of two columns is solid, and those that share a vertical edge at a node.

Mesh and B-Rep both use this module, with different heights: integer multiples of a step for triangles,
millimetres for faces.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from clacad.base.types import Floats, Ints


class BorderCurve(NamedTuple):
    """A column's face over a border. `column`: 0 left, 1 right.

    `opens`: material begins above it (a front).
    """

    column: int
    opens: bool


def solid_strips(
    curves: Iterable[Sequence[BorderCurve]], below: tuple[bool, bool] = (False, False)
) -> list[tuple[bool, bool]]:
    """Whether the left and the right column are solid in each strip between consecutive curves over a border.

    Parameters
    ----------
    curves : iterable
        Ascending; coincident curves of both columns are passed together.
    below : (left, right)
        Whether a column is solid below all curves.

    Returns
    -------
    list of (left, right)
        One fewer than there are curves. A wall fills a strip where the two differ.
    """
    depth = [int(solid) for solid in below]
    strips = []
    for together in curves:
        for curve in together:
            depth[curve.column] += 1 if curve.opens else -1
        strips.append((depth[0] > 0, depth[1] > 0))
    return strips[:-1]


def runs_round(solid: Sequence[bool]) -> list[int]:
    """Number the runs of adjacent solid sectors around a vertical line; −1 where a sector is not solid.

    Counter-clockwise; run 0 is the first that begins after sector −1. The two walls of a run share one
    vertical edge. Two runs are a saddle: columns that touch in a line.
    """
    starts = [s for s in range(len(solid)) if solid[s] and not solid[s - 1]]
    runs = [0 if one else -1 for one in solid]
    for number, s in enumerate(starts):
        while solid[s % len(solid)]:
            runs[s % len(solid)] = number
            s += 1
    return runs


def linked(heights: Floats | Ints, gap: float) -> Ints:
    """Single linkage: number the clusters of heights (..., n), ascending, whose neighbours differ by at most `gap`."""
    number = np.zeros(heights.shape, dtype=np.int64)
    number[..., 1:] = np.cumsum(np.diff(heights, axis=-1) > gap, axis=-1)
    return number
