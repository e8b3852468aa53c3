"""Least-squares search for the faces that follow a law best: residuals of fixed rays, and the minimiser;
and the polynomials by which forms are fitted.

The residual of a ray is the deviation of its direction from the requested one, in two directions across the
middle of the field. The law itself is not fitted, so a search cannot drift to another η. The rays stay the
same throughout, and a lost ray counts as `LOST`: otherwise a search would lose rays to look sharp.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clacad.base.types import Floats
from clacad.base.vectors import axes_near, unit
from clacad.optics.rays import Fate, Rays
from clacad.optics.sequence import Interface, trace_sequence
from clacad.optics.surface import EvenPolynomial, Surface, conic_constants

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
    pairs = degree_pairs(count)
    one, two = (np.polynomial.legendre.legvander(at, sum(pairs[-1])) for at in (s, t))
    return np.stack([one[:, i] * two[:, j] for i, j in pairs], axis=1)


def degree_pairs(count: int) -> list[tuple[int, int]]:
    """Degrees along both axes of the first `count` products of polynomials, by the degree of the product."""
    return [(i, degree - i) for degree in range(count) for i in range(degree + 1)][:count]


EVEN_ORDERS = {"a4": 4, "a6": 6, "a8": 8}
"""Orders of the terms of an even polynomial."""


def nearest_polynomial(
    surface: Surface, x: Floats, y: Floats, height: Floats
) -> tuple[EvenPolynomial, float, float]:
    """The even polynomial nearest to heights over places of a lens frame, by least squares.

    Parameters
    ----------
    surface : Surface
        Gives the conic constants and the side, and the first values of the rest.
    x, y, height : (n,) arrays, lengths

    Returns
    -------
    surface : EvenPolynomial
    rise, rms : float, length
        What is added to all of its heights, and the rms difference that remains.

    Examples
    --------
    >>> import numpy as np
    >>> from clacad.optics.fit import nearest_polynomial
    >>> from clacad.optics.surface import Quadric
    >>> x, y = (one.ravel() for one in np.meshgrid(*2 * [np.linspace(-0.2, 0.2, 9)]))
    >>> lens = Quadric(0.5, 0.5, 0.5)
    >>> found, rise, rms = nearest_polynomial(lens, x, y, 1.01 * lens.sag(x, y) + 0.1)
    >>> round(found.curvature_x, 6), round(rise, 9), rms < 1e-9
    (0.505, 0.1, True)
    """
    conics = [0.0 if one is None else one for one in conic_constants(surface)]
    terms = {name: getattr(surface, name, (0.0,) * (order // 2 + 1)) for name, order in EVEN_ORDERS.items()}
    numbers = np.array(
        [surface.curvature_x, surface.curvature_y, *(t for one in terms.values() for t in one)]
    )
    powers = [(2, 0), (0, 2), *((n - 2 * k, 2 * k) for n in (4, 6, 8) for k in range(n // 2 + 1))]
    halves = float(np.abs(x).max()), float(np.abs(y).max())
    sizes = np.array([halves[0] ** i * halves[1] ** j * (0.5 if i + j == 2 else 1.0) for i, j in powers])
    basis = np.column_stack([(x / halves[0]) ** i * (y / halves[1]) ** j for i, j in powers])
    best, upper = np.linalg.qr(np.column_stack([surface.side * basis, np.ones(len(x))]))
    rise = 0.0
    for _ in range(POLYNOMIAL_ROUNDS):
        made = _polynomial(surface.side, conics, numbers)
        change = np.linalg.solve(upper, best.T @ (height - rise - made.sag(x, y)))
        numbers, rise = numbers + change[:-1] / sizes, rise + float(change[-1])
    made = _polynomial(surface.side, conics, numbers)
    return made, rise, float(np.sqrt(np.mean((height - rise - made.sag(x, y)) ** 2)))


POLYNOMIAL_ROUNDS = 4
"""Linear steps to the nearest polynomial: curvatures enter the height not quite linearly."""


def _polynomial(side: int, conics: Sequence[float], numbers: Floats) -> EvenPolynomial:
    """Even polynomial of curvatures (2,) and terms of order 4, 6 and 8, (12,)."""
    cx, cy, *rest = numbers.tolist()
    terms: dict[str, Any] = {"a4": tuple(rest[:3]), "a6": tuple(rest[3:7]), "a8": tuple(rest[7:])}
    return EvenPolynomial(cx, cy, conics[0], conics[1], side=side, **terms)
