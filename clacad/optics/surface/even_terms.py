"""Terms of fourth, sixth and eighth order that an even polynomial adds to its conic, and their slopes.

    a4: a x⁴ + b x² y² + c y⁴
    a6: a x⁶ + b x⁴ y² + c x² y⁴ + d y⁶
    a8: a x⁸ + b x⁶ y² + c x⁴ y⁴ + d x² y⁶ + e y⁸

Nested in x² and y², the coefficient innermost: a zero term stays 0 for any x and y. The rounding error of the
height is at most 6 ulp of the sum of the sizes of all terms.
"""

from __future__ import annotations

import numpy as np

from clacad.base.even_orders import A4, A6, A8
from clacad.base.types import Floats


def even_terms(a4: A4, a6: A6, a8: A8, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
    """Height of the terms and its slopes in x and y, (n,) each, over x, y (n,), lengths."""
    xx, yy = x * x, y * y
    height, px, py = _fourth(a4, xx, yy)
    if any(a6) or any(a8):
        six, eight = _sixth(a6, xx, yy), _eighth(a8, xx, yy)
        height, px, py = (
            one + (two + three) for one, two, three in zip((height, px, py), six, eight, strict=True)
        )
    return np.asarray(height), np.asarray(x * px), np.asarray(y * py)


def sharpest_of_terms(a4: A4, a6: A6, a8: A8, reach: float) -> float:
    """Bound (1/length) of the second derivatives of the terms within `reach` (length) of the apex."""
    square = reach * reach
    of = [factor * sum(map(abs, terms)) for factor, terms in ((12.0, a4), (30.0, a6), (56.0, a8))]
    return square * (of[0] + square * (of[1] + square * of[2]))


Three = tuple[Floats, Floats, Floats]
"""A height, and its slopes over x and y."""


def _fourth(terms: A4, xx: Floats, yy: Floats) -> Three:
    a, b, c = terms
    in_x, in_y = a * xx + b * yy, c * yy
    return xx * in_x + yy * in_y, 4.0 * a * xx + 2.0 * b * yy, 2.0 * b * xx + 4.0 * c * yy


def _sixth(terms: A6, xx: Floats, yy: Floats) -> Three:
    a, b, c, d = terms
    height = xx * (xx * (a * xx + b * yy) + yy * (c * yy)) + yy * (yy * (d * yy))
    px = xx * (6.0 * a * xx + 4.0 * b * yy) + yy * (2.0 * c * yy)
    py = xx * (2.0 * b * xx + 4.0 * c * yy) + yy * (6.0 * d * yy)
    return height, px, py


def _eighth(terms: A8, xx: Floats, yy: Floats) -> Three:
    a, b, c, d, e = terms
    height = xx * (xx * (xx * (a * xx + b * yy) + yy * (c * yy)) + yy * (yy * (d * yy))) + yy * (
        yy * (yy * (e * yy))
    )
    px = xx * (xx * (8.0 * a * xx + 6.0 * b * yy) + yy * (4.0 * c * yy)) + yy * (yy * (2.0 * d * yy))
    py = xx * (xx * (2.0 * b * xx + 4.0 * c * yy) + yy * (6.0 * d * yy)) + yy * (yy * (8.0 * e * yy))
    return height, px, py
