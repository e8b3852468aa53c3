"""Error-free sums and products of float64 arrays, and arithmetic on the pairs they return.

A pair ``(high, low)`` represents the unrounded number high + low with about 106 significant bits.
Of the mathematics layer it is the only module that neighbours may import: arithmetic, no optics.
After T. J. Dekker, Numer. Math. 18, 224 (1971) and D. E. Knuth, The Art of Computer Programming, vol. 2,
4.2.2. A compiler that fuses multiply and add breaks these identities: compile no copy of them with
``fastmath={"contract"}``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from clacad.base.types import Floats

Pair = tuple[Floats, Floats]

_SPLITTER = 134217729.0  # 2**27 + 1 halves a 53-bit significand


def two_sum(a: ArrayLike, b: ArrayLike) -> Pair:
    """Rounded sum of a and b (arrays that broadcast), and its exact rounding error."""
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    total = np.asarray(a + b)
    part_b = total - a
    return total, np.asarray((a - (total - part_b)) + (b - part_b))


def two_product(a: ArrayLike, b: ArrayLike) -> Pair:
    """Rounded product of a and b, and its exact rounding error.

    Exact while both are below 2**996 and the product is above 2**-969, where its tail would underflow.
    """
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    product = np.asarray(a * b)
    a_high, a_low = _halve(a)
    b_high, b_low = _halve(b)
    low = ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low
    return product, np.asarray(low)


def pair(a: ArrayLike) -> Pair:
    """Exact float64 array as a pair of its shape."""
    high = np.asarray(a, dtype=np.float64)
    return high, np.zeros_like(high)


def pair_sum(*terms: Pair) -> Pair:
    """Sum of pairs, with an error of at most 2**-104 of the sum of their magnitudes."""
    high, low = terms[0]
    for other_high, other_low in terms[1:]:
        high, rest = two_sum(high, other_high)
        high, low = two_sum(high, rest + (low + other_low))
    return high, low


def pair_product(*factors: Pair) -> Pair:
    """Product of pairs, with a relative error of about 2**-102."""
    high, low = factors[0]
    for other_high, other_low in factors[1:]:
        product, rest = two_product(high, other_high)
        high, low = two_sum(product, rest + (high * other_low + low * other_high))
    return high, low


def negated(a: Pair) -> Pair:
    """The pair with its sign changed."""
    return -a[0], -a[1]


def _halve(a: Floats) -> Pair:
    """Upper and lower half of the significand (Veltkamp)."""
    shifted = _SPLITTER * a
    high = np.asarray(shifted - (shifted - a))
    return high, np.asarray(a - high)
