"""The point nearest to a bundle of rays, and the distances at which they pass it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from clacad.base.types import Floats, Pair2
from clacad.base.vectors import axes_near, unit

PARALLEL = 1e-24
"""Mean square of slopes about their mean below which rays count as parallel: 1e-12 rad squared."""


@dataclass(frozen=True, eq=False)
class BestPoint:
    """Point at which rays are closest to one another.

    point : (3,) lengths. X* = argmin Σ |(1 − d dᵀ)(X − P)|²; NaN where the rays are parallel.
    spot : (2,) lengths. Rms distance of the rays from it along x and y, in its plane.
    """

    point: Floats
    spot: Pair2
    rays: int

    @property
    def missing(self) -> Literal["no light", "parallel"] | None:
        """Reason why no such point exists, if so: fewer than two rays, or parallel rays."""
        if np.isfinite(self.point).all():
            return None
        return "parallel" if self.rays >= 2 else "no light"


def best_point(position: Floats, direction: Floats) -> BestPoint:
    """Find the point nearest to rays that pass `position` (n, 3), lengths, along unit `direction` (n, 3).

    One 3 × 3 solve, taken about the mean of the positions: their common part would cause cancellation.
    """
    lost = BestPoint(np.full(3, np.nan), (np.nan, np.nan), len(position))
    if len(position) < 2:
        return lost
    middle = position.mean(axis=0)
    axis = direction.mean(axis=0)
    if np.mean(np.sum((direction - axis) ** 2, axis=1)) < PARALLEL:
        return lost
    place = position - middle
    along = np.einsum("ni,ni->n", place, direction)
    across = place - along[:, None] * direction
    # Σ(1 − d dᵀ) as a sum of squares about the mean direction loses nothing where rays are nearly parallel
    mean = unit(axis)
    basis = np.stack([*axes_near(mean), mean], axis=1)
    d = direction @ basis
    matrix = np.empty((3, 3))
    matrix[:2, :2] = len(d) * np.eye(2) - d[:, :2].T @ d[:, :2]
    matrix[:2, 2] = matrix[2, :2] = -(d[:, :2] * d[:, 2:]).sum(axis=0)
    matrix[2, 2] = np.sum(d[:, :2] ** 2)
    point = middle + basis @ np.linalg.solve(matrix, (across @ basis).sum(axis=0))
    x, y = spot_at(position, direction, point)
    return BestPoint(point, (x, y), len(position))


def spot_at(position: Floats, direction: Floats, point: Floats) -> Pair2:
    """Rms distances along x and y (lengths) at which rays pass a point (3,) in its plane of height z."""
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = (point[2] - position[:, 2]) / direction[:, 2]
        off = position[:, :2] + reach[:, None] * direction[:, :2] - point[:2]
    x, y = np.sqrt(np.mean(off**2, axis=0)).tolist()
    return x, y
