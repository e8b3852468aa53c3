"""Which cell holds a point, exactly: rational arithmetic for rectangles, 60 digits and Voronoi for hexagons."""

from __future__ import annotations

from fractions import Fraction
from math import floor

from mpmath import mp, mpf

DIGITS = 60


def locate(kind, pitch, count, x, y):
    """Index (i, j) and place relative to the cell's centre as 60-digit numbers; doubles are taken as they are."""
    if kind != "hexagonal":
        columns = [_axis(Fraction(u), Fraction(p), n) for u, p, n in zip((x, y), pitch, count)]
        with mp.workdps(DIGITS):
            return tuple(c[0] for c in columns), [mpf(c[1].numerator) / c[1].denominator for c in columns]
    with mp.workdps(DIGITS):
        return _hexagonal(mpf(pitch[0]), count, mpf(x), mpf(y))


def _axis(u, p, n):
    k = floor(u / p + Fraction(n, 2))
    return k, u - p * (Fraction(2 * k - (n - 1), 2))


def centre(p, count, i, j):
    """Centre of hexagonal cell (i, j): the mean of all n1 n2 centres is the origin, odd rows are shifted right by half a pitch."""
    n1, n2 = count
    row = p * mp.sqrt(3) / 2
    mean_x = p * (mpf(n1 - 1) / 2 + mpf(n2 // 2) / n2 / 2)
    return p * (i + mpf(j) / 2) - mean_x, row * j - row * mpf(n2 - 1) / 2


def _hexagonal(p, count, x, y):
    x0, y0 = centre(p, count, 0, 0)
    j0 = int(mp.nint((y - y0) / (p * mp.sqrt(3) / 2)))
    i0 = int(mp.nint((x - x0) / p - mpf(j0) / 2))
    near = []
    for j in range(j0 - 2, j0 + 3):
        for i in range(i0 - 3, i0 + 4):
            cx, cy = centre(p, count, i, j)
            near.append(((x - cx) ** 2 + (y - cy) ** 2, -j, -i))
    _, j, i = min(near)  # on a wall: the cell with the greater y, then x
    cx, cy = centre(p, count, -i, -j)
    return (-i, -j), [x - cx, y - cy]
