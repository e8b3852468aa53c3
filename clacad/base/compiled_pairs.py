"""Error-free sums and products of single numbers, compiled: counterparts of `clacad.base.pairs`."""

from __future__ import annotations

from clacad.base.compiled import exact, multiply_add

_SPLITTER = 134217729.0  # 2**27 + 1 halves a 53-bit significand


@exact
def two_sum(a: float, b: float) -> tuple[float, float]:
    """Rounded sum and its exact rounding error."""
    s = a + b
    v = s - a
    return s, (a - (s - v)) + (b - v)


@exact
def two_product(a: float, b: float) -> tuple[float, float]:
    """Rounded product and its exact rounding error."""
    p = a * b
    t = _SPLITTER * a
    ah = t - (t - a)
    al = a - ah
    t = _SPLITTER * b
    bh = t - (t - b)
    bl = b - bh
    return p, ((ah * bh - p) + ah * bl + al * bh) + al * bl


@exact
def pair_product(ah: float, al: float, bh: float, bl: float) -> tuple[float, float]:
    """Product of two pairs."""
    p, e = two_product(ah, bh)
    return two_sum(p, e + (ah * bl + al * bh))


@exact
def pair_sum(ah: float, al: float, bh: float, bl: float) -> tuple[float, float]:
    """Sum of two pairs."""
    s, e = two_sum(ah, bh)
    return two_sum(s, e + (al + bl))


@exact
def less_multiple(x: float, k: float, step: float) -> float:
    """Return x − k·step without rounding the product."""
    high, low = two_product(k, step)
    return (x - high) - low


@exact
def less_product(x: float, a: float, b: float) -> float:
    """Value of x − a b with the product unrounded."""
    product = a * b
    total, rest = two_sum(x, -product)
    return total + (rest - multiply_add(a, b, -product))
