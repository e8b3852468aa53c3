"""All real roots of a smooth function on [0, 1], by monotone pieces: no root between samples is missed.

Chebyshev interpolants replace the function and agree with it to rounding error. The real roots of their
derivative cut [0, 1] into pieces on which the function is monotone. A piece contains one root if the values
at its ends differ in sign, otherwise none. Each root is bisected on the function itself, never on the
interpolant. (Trefethen, Approximation Theory and Approximation Practice, chapter 18.)
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.polynomial import chebyshev

from clacad.base.arrays import distinct
from clacad.base.types import Bools, Floats

Function = Callable[[Floats], Floats]

_DEGREES = (16, 32, 64)
_MAX_DEPTH = 30  # intervals halve towards a square-root end (equator); 2^-30 of a border is negligible
_PLATEAU = 1e-8  # a coefficient tail this small that no longer falls is rounding error


HALVINGS = 64
"""Halvings of a bracket at most."""


def sign_changes(function: Function, noise: float) -> Floats:
    """Find where a function changes sign on the open interval (0, 1).

    function : (n,) → (n,). Smooth where it is not NaN.
    noise : Rounding level of the function: values within ±noise count as zero.
    Returns (n,) array, ascending: Roots of odd order. A root where the function only touches zero is omitted.
        A stretch of zeros between opposite signs counts once, at its middle. Zeros at 0 and 1 themselves are
        omitted.
    """
    if _keeps_away(function, noise):
        return np.empty(0)
    knots, values = _monotone_knots(function, noise)
    sign = np.where(np.abs(values) <= noise, 0.0, np.sign(values))
    known = np.flatnonzero(np.isfinite(values) & (sign != 0.0))
    low, high, roots = [], [], []
    for first, second in zip(known[:-1], known[1:]):
        between = values[first + 1 : second]
        if sign[first] * sign[second] > 0.0 or np.isnan(between).any():
            continue
        if second == first + 1:
            low.append(knots[first])
            high.append(knots[second])
        else:
            roots.append(0.5 * (knots[first + 1] + knots[second - 1]))
    found = np.concatenate([np.asarray(roots), bisect(function, np.asarray(low), np.asarray(high), 8)])
    return np.sort(found[(found > 0.0) & (found < 1.0)])


def bisect(function: Function, low: Floats, high: Floats, at_once: int = 1) -> Floats:
    """Halve brackets (n,) with ends of opposite sign down to the resolution of float64.

    at_once : Halvings in a row of which one call of the function gives the values at all middles that may be
        reached, 2^at_once − 1 of each bracket; 1: those of all brackets, in their order.
    """
    low, high = np.array(low, dtype=np.float64), np.array(high, dtype=np.float64)
    if low.size == 0:
        return low
    rising, rows = function(low) < 0.0, np.arange(len(low))
    for _ in range(HALVINGS // at_once):
        ends = np.stack([low, *[low] * (2**at_once - 1), high], axis=1)
        for step in 2 ** np.arange(at_once, 0, -1):
            ends[:, step // 2 :: step] = 0.5 * (ends[:, :-1:step] + ends[:, step::step])
        below = (function(ends[:, 1:-1].ravel()) < 0.0).reshape(len(low), -1) == rising[:, None]
        at = np.zeros(len(low), dtype=np.intp)
        for step in 2 ** np.arange(at_once - 1, -1, -1):
            at += np.where(below[rows, at + step - 1], step, 0)
        low, high = ends[rows, at], ends[rows, at + 1]
        if np.all(high - low <= np.spacing(np.maximum(np.abs(low), np.abs(high)))):
            break
    return np.asarray(0.5 * (low + high))


def _monotone_knots(function: Function, noise: float) -> tuple[Floats, Floats]:
    """Parameters between which the function is monotone, and its values there (NaN: undefined)."""
    knots: list[Floats] = [np.array([0.0])]
    stack = [(0.0, 1.0, 0)]
    while stack:
        low, high, depth = stack.pop()
        critical = _critical_points(function, low, high, noise, depth == _MAX_DEPTH)
        if critical is None:
            middle = 0.5 * (low + high)
            stack += [(middle, high, depth + 1), (low, middle, depth + 1)]
        else:
            knots += [critical, np.array([high])]
    t = distinct(np.concatenate(knots))
    return t, function(t)


def _critical_points(function: Function, low: float, high: float, noise: float, last: bool) -> Floats | None:
    """Roots of the derivative inside (low, high); None where the interval must be split for resolution."""
    before = np.inf
    for degree in _DEGREES:
        nodes = _nodes(degree)
        values = function(low + (high - low) * 0.5 * (nodes + 1.0))
        if np.isnan(values).all():
            return np.empty(0)
        if np.isnan(values).any():
            return np.empty(0) if last else None
        coefficients = _interpolant(nodes, values)
        # The lens heights have rounding errors of `noise`; coefficients at that level cannot be resolved.
        tail = np.abs(coefficients[-4:]).max()
        largest = np.abs(coefficients).max()
        plateau = tail <= _PLATEAU * largest and tail > 0.1 * before
        before = tail
        if tail <= max(2.0 * noise, 1e-15 * largest) or plateau or last:
            trimmed = chebyshev.chebtrim(coefficients, max(noise, tail if plateau else 0.0))
            slope = chebyshev.chebder(trimmed)
            if len(slope) < 2 or not np.any(slope[1:]):
                return np.empty(0)
            roots = chebyshev.chebroots(chebyshev.chebtrim(slope))
            real = roots.real[(np.abs(roots.imag) < 1e-6) & (np.abs(roots.real) < 1.0)]
            return np.asarray(low + (high - low) * 0.5 * (np.sort(real) + 1.0))
    return None


def _keeps_away(function: Function, noise: float) -> bool:
    """Whether a function has no sign change that its first interpolant could hide."""
    return bool(keeps_away(function(resolving_nodes())[None], noise)[0])


def resolving_nodes() -> Floats:
    """Parameters (k,) at which `keeps_away` needs the values of a function."""
    return np.asarray(0.5 * (_nodes(_DEGREES[0]) + 1.0))


def keeps_away(values: Floats, noise: float) -> Bools:
    """Whether functions surely change no sign on (0, 1), (n,), from their values (n, k) at `resolving_nodes`.

    Either all values are rounding error, or the mean of a resolved interpolant exceeds the sum of all its
    variation.
    """
    known = np.asarray(np.isfinite(values).all(axis=1))
    transform = _transform(values.shape[1])
    sums = np.where(known[:, None], values, 0.0) @ transform.T
    coefficients = np.asarray(np.abs(sums) * (2.0 / values.shape[1]))
    coefficients[:, 0] *= 0.5
    varies, tail = coefficients[:, 1:].sum(axis=1), coefficients[:, -4:].max(axis=1)
    resolved = tail <= np.maximum(2.0 * noise, 1e-15 * coefficients.max(axis=1))
    away = resolved & (coefficients[:, 0] > varies + 4.0 * (tail + noise))
    return np.asarray(known & (away | (np.abs(values) <= noise).all(axis=1)))


@lru_cache(maxsize=len(_DEGREES))
def _nodes(degree: int) -> Floats:
    """First-kind points of a Chebyshev interpolant, (degree + 1,)."""
    return np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))


@lru_cache(maxsize=len(_DEGREES))
def _transform(count: int) -> Floats:
    """Matrix (count, count) that sums values at first-kind points over each Chebyshev polynomial."""
    return np.asarray(chebyshev.chebvander(_nodes(count - 1), count - 1).T)


def _interpolant(nodes: Floats, values: Floats) -> Floats:
    """Chebyshev coefficients of the interpolant through first-kind points (discrete orthogonality)."""
    n = len(nodes)
    transform = _transform(n) @ values * (2.0 / n)
    transform[0] *= 0.5
    return np.asarray(transform)
