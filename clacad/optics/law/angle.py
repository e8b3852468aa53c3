"""Differences of products without cancellation, and the angle between directions built from them.

A sum or product of two doubles equals its rounded value plus an error that is itself a double
(Dekker 1971, Knuth TAOCP 4.2.2). Carrying that error keeps differences such as m − δ m_z accurate to
the last place when the two terms cancel. This module must not be compiled with contracted products.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clacad.base.pairs import two_product, two_sum
from clacad.base.types import Floats


def difference_of_products(a: Floats, b: Floats, c: Floats, d: Floats) -> Floats:
    """a·b − c·d (n,) to about one unit in the last place of the result, also under cancellation.

    Parameters
    ----------
    a, b, c, d : arrays of one shape, within the range of `clacad.base.pairs.two_product`
    """
    first, first_error = two_product(a, b)
    second, second_error = two_product(c, d)
    total, total_error = two_sum(first, -second)
    return total + (total_error + (first_error - second_error))


def power_of_two_scaled(vectors: Floats) -> Floats:
    """Rows scaled by powers of two so that the largest component lies in [1/2, 1): no rounding.

    Parameters
    ----------
    vectors : (n, 3) array

    Returns
    -------
    (n, 3) array
        Rows that are zero or not finite come back as they are.
    """
    largest = np.max(np.abs(vectors), axis=1)
    exponent = np.frexp(np.where(np.isfinite(largest), largest, 1.0))[1]
    return np.ldexp(vectors, -exponent[:, np.newaxis])


def is_direction(vectors: Floats) -> NDArray[np.bool_]:
    """Which rows (n,) of (n, 3) vectors are finite and not zero."""
    largest = np.max(np.abs(vectors), axis=1)  # NaN propagates, and is not greater than 0
    return np.asarray((largest > 0.0) & (largest < np.inf))


def angle_between(a: ArrayLike, b: ArrayLike) -> Floats:
    """Angle between directions, atan2(|a × b|, a · b): relative accuracy down to the tiniest angle.

    All angular errors are computed here. acos(a · b) loses every angle below 1.5e-8 rad, and a cross product
    whose terms are rounded before they cancel loses those below 1e-16; this function loses neither.

    Parameters
    ----------
    a, b : (..., 3) arrays, any length > 0
        Broadcast against each other.

    Returns
    -------
    (...) array, radians, 0 … π
        NaN where either vector is zero or not finite.
    """
    first, second = np.broadcast_arrays(np.asarray(a, np.float64), np.asarray(b, np.float64))
    shape = first.shape[:-1]
    p, q = power_of_two_scaled(first.reshape(-1, 3)), power_of_two_scaled(second.reshape(-1, 3))
    usable = is_direction(p) & is_direction(q)
    p, q = np.where(usable[:, np.newaxis], p, 1.0), np.where(usable[:, np.newaxis], q, 1.0)
    cross = np.stack(
        [difference_of_products(p[:, i], q[:, j], p[:, j], q[:, i]) for i, j in ((1, 2), (2, 0), (0, 1))]
    )
    # The largest component is taken out before squaring: 1e-200 rad must not underflow.
    largest = np.max(np.abs(cross), axis=0)
    unit = np.where(largest > 0, largest, 1.0)
    sine = largest * np.sqrt(np.sum((cross / unit) ** 2, axis=0))
    angle = np.arctan2(sine, np.sum(p * q, axis=1))
    return np.where(usable, angle, np.nan).reshape(shape)
