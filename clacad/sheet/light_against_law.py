"""Comparison of traced light with the law and with the exact surfaces, for any representation of the sheet.

The caller traces the rays, through facets in memory or a file's facets. Only ALIVE rays count; a result from
fewer than FEWEST of them is NaN. Aberration alone changes fits over a field of a degree (2 % for the paper's
sheet). Fitted laws and the shift of array 2 are therefore differences: the traced result minus that of the
exact surfaces, over the same rays.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Bools, Floats
from clacad.optics.law import Law, angle_between
from clacad.optics.law.law import law_in_axes
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.optics.sequence import trace_sequence
from clacad.sheet.telescopelet import interfaces, lens_distance
from clacad.sheet.window import Window

FEWEST = 64
"""Least number of ALIVE rays for a result other than NaN."""

SLIDE = 1e-3
"""Trial shift of array 2, relative to the distance between the lenses, for the derivative of directions."""


def law_errors(seen: TraceResult, asked: Floats) -> Floats:
    """Angles (k,), radians, between the ALIVE rays and the law's directions (n, 3), where the law has one."""
    alive = seen.fate == Fate.ALIVE
    error = angle_between(seen.direction[alive], asked[alive])
    return error[np.isfinite(error)]


def rms_error(error: Floats) -> float:
    """Root mean square (radians) of angles (k,)."""
    return float(np.sqrt(np.mean(error**2))) if len(error) >= FEWEST else np.nan


def mean_error(direction: Floats, fate: NDArray[np.uint8], expected: Floats) -> float:
    """Angle (radians) between the mean exit direction (n, 3) of parallel light
    and the expected direction (3,).
    """
    alive = fate == Fate.ALIVE
    if alive.sum() < FEWEST or not np.isfinite(expected).all():
        return np.nan
    return float(angle_between(direction[alive].mean(axis=0), expected))


def fitted_laws(
    axes: Law, rays: Rays, one: TraceResult, other: TraceResult, good: Bools, fewest: int = FEWEST
) -> tuple[Law, Law] | None:
    """Laws fitted to the same rays traced in two ways; None where the rays determine none.

    Parameters
    ----------
    axes : Law
        Its axes are used by both fits.
    rays : Rays
    one, other : TraceResult
    good : (n,) bool
        Rays that count.
    fewest : int
        Least number of rays for a fit.
    """
    if good.sum() < fewest:
        return None
    into = rays.direction[good]
    try:
        first, second = (law_in_axes(into, found.direction[good], axes) for found in (one, other))
    except ValueError:  # exit directions that do not depend on the incident ones
        return None
    return first, second


def change_with_shift(window: Window, cell: tuple[int, int], rays: Rays) -> Floats:
    """Derivative of exit directions with respect to a shift of array 2 along the sheet's normal, through the
    exact surfaces.

    Parameters
    ----------
    window : Window
    cell : (i, j)
        Cell of array 1 that the rays go through.
    rays : Rays
        Sheet frame.

    Returns
    -------
    (n, 2) array
        Components along the lens axes, per shift by the distance between the lenses; NaN where a ray is lost.
    """
    distance = lens_distance(window)
    centre = window.lattice.centres(np.array([cell], dtype=np.int64))[0]
    local = Rays(rays.position - [*centre, 0.0], rays.direction)
    through = [
        trace_sequence(interfaces(window, np.array([0.0, 0.0, slide * distance])), local)
        for slide in (-SLIDE, SLIDE)
    ]
    good = np.all([one.fate == Fate.ALIVE for one in through], axis=0)
    low, high = (one.direction[good] @ window.thin.rotation[:, :2] for one in through)
    change = np.full((len(rays), 2), np.nan)
    change[good] = (high - low) / (2.0 * SLIDE)
    return change


def shift_of_array_2(window: Window, seen: Floats, truth: Floats, change: Floats) -> Floats:
    """Shift of array 2 along the normal that minimises the rms error to the law, minus that of the exact
    surfaces.

    One Gauss–Newton step with the derivative of the exact surfaces. A small shift does not change the slopes
    of facets, but their mean over a lens is the lens's slope.

    Parameters
    ----------
    window : Window
    seen, truth : (n, 3) directions
        Directions of the same rays, as traced and through the exact surfaces, ALIVE in both.
    change : (n, 2) array
        Result of `change_with_shift`.

    Returns
    -------
    (2,) array
        Shift along each lens axis, relative to the distance between the lenses; NaN along an axis without
        power.
    """
    known = np.isfinite(change[:, 0])
    if known.sum() < FEWEST:
        return np.full(2, np.nan)
    less = (seen - truth)[known] @ window.thin.rotation[:, :2]
    change = change[known]
    weight = (change**2).sum(axis=0)
    powered = weight > 1e-12 * max(float(weight.max()), 1e-300)
    return np.asarray(
        np.where(powered, -(less * change).sum(axis=0) / np.where(powered, weight, 1.0), np.nan)
    )
