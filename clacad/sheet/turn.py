"""Rotation of points in the plane of the sheet: in float64, and in double-double for points far from the
centre.

Sine and cosine of an angle are stored as pairs, so that a rotation and its inverse cancel to 2⁻¹⁰⁰. A cell
ten thousand pitches from the centre is located to the last bits of a cell.
"""

from __future__ import annotations

from fractions import Fraction as Exact
from functools import lru_cache
from typing import Final

import numpy as np

from clacad.base.pairs import Pair, negated, pair_product, pair_sum
from clacad.base.types import Floats, Pair2

MOST_TURN: Final = 0.7853981633974483
"""Largest rotation, radians: a square pattern repeats after twice this angle."""

_ENOUGH: Final = Exact(1, 2**130)


def turned(points: Floats, angle: float) -> Floats:
    """Points (..., 2) rotated by an angle (radians) from +x to +y about the origin."""
    (c, _), (s, _) = cosine_and_sine(angle)
    x, y = points[..., 0], points[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def turned_pairs(x: Pair, y: Pair, angle: float) -> tuple[Pair, Pair]:
    """Points (n,), lengths in double-double pairs, rotated by an angle (radians) from +x to +y about the
    origin.
    """
    c, s = (tuple(np.asarray(part) for part in parts) for parts in cosine_and_sine(angle))
    return (
        pair_sum(pair_product(x, c), negated(pair_product(y, s))),  # type: ignore[arg-type]
        pair_sum(pair_product(x, s), pair_product(y, c)),  # type: ignore[arg-type]
    )


@lru_cache(maxsize=64)
def cosine_and_sine(angle: float) -> tuple[Pair2, Pair2]:
    """Cosine and sine of an angle (radians, |angle| ≤ `MOST_TURN`), each as a number and its remainder."""
    exact, term, k = Exact(angle), Exact(1), 0
    sums = [Exact(0), Exact(0)]
    while abs(term) > _ENOUGH:
        sums[k % 2] += term if k % 4 < 2 else -term
        k += 1
        term = term * exact / k
    return _split(sums[0]), _split(sums[1])


def held_when_turned(sides: Pair2, angle: float) -> float:
    """Largest scale at which a rectangle (side lengths) rotated about its centre still fits inside the
    original.
    """
    (c, _), (s, _) = cosine_and_sine(abs(angle))
    width, height = sides
    return min(width / (c * width + s * height), height / (s * width + c * height))


def _split(value: Exact) -> Pair2:
    high = float(value)
    return high, float(value - Exact(high))
