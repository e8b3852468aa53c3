"""Where light through a cloak meets a wall behind it, against straight light."""

from __future__ import annotations

import numpy as np

from clacad.base.sobol import sobol
from clacad.optics.rays import Fate
from clacad.sheet.stack import Stack
from clacad.tracing.through_stack import StackTracer, started

REACH, BEHIND = 24.9, 1000.0
"""Half side of the light over the first sheet; distance of the wall behind the last, mm."""


def shift_and_blur(stack: Stack) -> tuple[float, np.ndarray, float]:
    """Share of rays within 1 degree that pass the exact faces, shifts (144,) of bins, and the rms about them (mm).

    Places over the first sheet and slopes are both in bins: the mean of a bin is its shift.
    """
    field = np.tan(np.radians(1.0))
    points = 2.0 * sobol(1 << 16, 4) - 1.0
    place, slope = REACH * points[:, :2], field * points[:, 2:]
    found = StackTracer(stack, "surfaces", path="size")(started(stack, place, slope))
    alive = found.fate == Fate.ALIVE
    first, wall = stack.sheets[0].lens_planes[0], stack.sheets[-1].lens_planes[1] + BEHIND
    way = found.direction[alive, :2] / found.direction[alive, 2:]
    meets = found.position[alive, :2] + way * (wall - found.position[alive, 2:])
    off = (meets - place[alive] - slope[alive] * (wall - first)).T.ravel()
    columns = [
        np.clip((6 * (1.0 + part[alive].T.ravel())).astype(int), 0, 11)
        for part in (points[:, :2], points[:, 2:])
    ]
    bins = 12 * columns[0] + columns[1]
    count = np.bincount(bins, minlength=144)
    assert count.min() > 200
    shift = np.bincount(bins, off, 144) / count
    return float(alive.mean()), shift, float(np.sqrt(np.mean((off - shift[bins]) ** 2)))
