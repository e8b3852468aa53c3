"""Least-squares search for the faces that follow a law best: residuals of fixed rays, and the minimiser;
and the polynomials by which forms are fitted.

The residual of a ray is the deviation of its direction from the requested one, in two directions across the
middle of the field. The law itself is not fitted, so a search cannot drift to another η. The rays stay the
same throughout, and a lost ray counts as `LOST`: otherwise a search would lose rays to look sharp.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from clacad.base.types import Floats
from clacad.base.vectors import axes_near, unit
from clacad.optics.rays import Fate, Rays
from clacad.optics.sequence import Interface, trace_sequence

LOST = 0.1
"""Residual (radians) of a ray that is not transmitted: far above that of any useful lens, but finite."""

STEP = 1e-6
"""Finite-difference step of an unknown of order 1: the rounding of the trace is 1e-10 of the slopes."""

DAMPING = 1e-3
"""Initial damping of a search, in squares of the slopes' own sizes; a failed step doubles it ever faster."""

TRIES = 16
"""Number of steps from one point that may fail before the point counts as the minimum."""

SETTLED = 1e-6
"""Relative change of the sum of squares at which a search ends."""

ROUNDS = 40
"""Largest number of evaluations of the slopes in one search."""

Residuals = Callable[[Floats], Floats]


@dataclass(frozen=True, eq=False)
class AskedLight:
    """Rays and the directions in which they should leave.

    `asked` : (n, 3) unit. Requested directions.
    across : (2, 3). Unit vectors perpendicular to the mean requested direction.
    """

    rays: Rays
    asked: Floats
    across: Floats

    @staticmethod
    def of(rays: Rays, asked: Floats) -> AskedLight:
        """Build it from rays and requested directions (n, 3), whose mean fixes both vectors across."""
        middle = unit(asked.mean(axis=0))
        return AskedLight(rays, asked, np.stack(axes_near(middle, int(np.argmin(np.abs(middle))))))


def law_residuals(sequence: Sequence[Interface], light: AskedLight) -> Floats:
    """Residuals (2 n,) of n rays, radians over √n: their sum of squares is the mean square error."""
    seen = trace_sequence(sequence, light.rays)
    off = (seen.direction - light.asked) @ light.across.T
    off[seen.fate != Fate.ALIVE] = LOST
    return np.asarray(off.ravel() / np.sqrt(len(light.asked)))


def minimise(residuals: Residuals, start: Floats) -> Floats:
    """Unknowns (k,) of the least sum of squares near `start` (k,), each of order 1.

    Levenberg–Marquardt with Nielsen's damping, scaled by the largest slopes so far. Slopes are forward
    differences in a fixed order, so the result is reproducible.

    residuals : Unknowns (k,) → residuals (m,), always finite. What it raises ends the search.
    start : (k,)

    Notes
    -----
    K. Madsen, H. B. Nielsen, O. Tingleff, Methods for non-linear least squares problems, 2nd ed. (DTU,
    2004), ch. 3.2;
    scaling after J. J. Moré, Lect. Notes Math. 630, 105 (1978).
    """
    here, left = start, residuals(start)
    damping, scale = DAMPING, np.zeros(len(start))
    for _ in range(ROUNDS):
        slopes = np.stack(
            [(residuals(here + STEP * axis) - left) / STEP for axis in np.eye(len(here))], axis=1
        )
        scale = np.maximum(scale, np.linalg.norm(slopes, axis=0))
        found = _step(residuals, (here, left), slopes, scale, damping)
        if found is None:
            break
        gained = 1.0 - float(found[1] @ found[1]) / float(left @ left)
        here, left, damping = found
        if gained <= SETTLED:
            break
    return here


def _step(
    residuals: Residuals, place: tuple[Floats, Floats], slopes: Floats, scale: Floats, damping: float
) -> tuple[Floats, Floats, float] | None:
    """The next point (k,) with a smaller residual, its residuals (m,) and the new damping.

    None where no such point exists.

    place : unknowns (k,) and residuals (m,); slopes : (m, k); scale : (k,)
    """
    here, left = place
    square, growth = float(left @ left), 2.0
    units = np.diag(np.where(scale > 0.0, scale, 1.0))
    for _ in range(TRIES):
        rows = np.concatenate([slopes, np.sqrt(damping) * units])
        step = np.linalg.lstsq(rows, np.concatenate([-left, np.zeros(len(here))]), rcond=None)[0]
        trial = residuals(here + step)
        ahead = left + slopes @ step
        promised, kept = square - float(ahead @ ahead), square - float(trial @ trial)
        if kept > 0.0 and promised > 0.0:
            return here + step, trial, damping * max(1.0 / 3.0, 1.0 - (2.0 * kept / promised - 1.0) ** 3)
        damping, growth = damping * growth, 2.0 * growth
    return None


def legendre(s: Floats, t: Floats, count: int) -> Floats:
    """First `count` products (n, count) of Legendre polynomials of places scaled to [−1, 1], by their
    degree.
    """
    pairs: list[tuple[int, int]] = []
    degree = -1
    while len(pairs) < count:
        degree += 1
        pairs += [(i, degree - i) for i in range(degree + 1)]
    one, two = (np.polynomial.legendre.legvander(at, degree) for at in (s, t))
    return np.stack([one[:, i] * two[:, j] for i, j in pairs[:count]], axis=1)
