"""Sums over traced rays, compiled: the twin of `clacad.light.sums.sums_of`."""

from __future__ import annotations

from math import atan2, sqrt

import numpy as np

from clacad.base.compiled import exact, less_product, owning, two_sum
from clacad.base.types import Bytes, Floats
from clacad.light.sums import GRADIENT, KNOWN, NORMAL, NUMBERS, OUT, SQUARE
from clacad.optics.rays import Fate

ETA_X, ETA_Y, DELTA_X, DELTA_Y, R0 = range(5)
"""Indices of `law_numbers`."""

ALIVE = int(Fate.ALIVE)

FEW = 64
"""Rays whose numbers are added plainly; their subtotals are added with compensation of the rounding error."""

SMALL = 1e-2
"""Chord below which four terms of the arc sine are exact to the last digit."""


@owning
def add_rays(law: Floats, fate: Bytes, ray: Floats, out: Floats, sums: Floats) -> float:
    """Add m rays to the sums; return the largest angle to the law.

    law : see `law_numbers`
    ray, out : (m, 3). Before the sheet, of any length, and behind it.
    sums : (2, NUMBERS). With the rounding error.
    """
    part, worst = np.zeros(NUMBERS), 0.0
    for first in range(0, len(fate), FEW):
        for k in range(first, min(first + FEW, len(fate))):
            part[fate[k]] += 1.0
            if fate[k] == ALIVE:
                for c in range(3):
                    part[OUT + c] += out[k, c]
                worst = max(worst, _add_ray(law, ray[k], out[k], part))
        for n in range(NUMBERS):
            sums[0, n], lost = two_sum(sums[0, n], part[n])
            sums[1, n] += lost
            part[n] = 0.0
    return worst


@exact
def _add_ray(law: Floats, ray: Floats, out: Floats, part: Floats) -> float:
    """Add one ALIVE ray in the frame of the lenses; return its angle to the law, 0 without an answer."""
    u, v, w = ray[0], ray[1], ray[2]
    size = 1.0 / sqrt(u * u + v * v + w * w)
    mx = (law[R0] * u + law[R0 + 3] * v + law[R0 + 6] * w) * size
    my = (law[R0 + 1] * u + law[R0 + 4] * v + law[R0 + 7] * w) * size
    mz = (law[R0 + 2] * u + law[R0 + 5] * v + law[R0 + 8] * w) * size
    x = less_product(mx, law[DELTA_X], mz) / law[ETA_X]
    y = less_product(my, law[DELTA_Y], mz) / law[ETA_Y]
    onwards = law[R0 + 6] * x + law[R0 + 7] * y + law[R0 + 8] * mz
    if not (w > 0.0 and mz > 0.0 and onwards > 0.0):
        return 0.0
    each = 1.0 / sqrt(x * x + y * y + mz * mz)
    x, y, z = x * each, y * each, mz * each
    u, v, w = out[0], out[1], out[2]
    p = law[R0] * u + law[R0 + 3] * v + law[R0 + 6] * w
    q = law[R0 + 1] * u + law[R0 + 4] * v + law[R0 + 7] * w
    r = law[R0 + 2] * u + law[R0 + 5] * v + law[R0 + 8] * w
    dx, dy, dz = p - x, q - y, r - z
    angle = _angle(dx * dx + dy * dy + dz * dz, p * x + q * y + r * z)
    part[KNOWN] += 1.0
    part[SQUARE] += angle * angle
    _add_step(mx * each, my * each, z, x, y, dx, dy, dx * x + dy * y + dz * z, part)
    return angle


@exact
def _angle(square: float, product: float) -> float:
    """Angle between unit directions from the square of their difference and their product."""
    chord = sqrt(square)
    if chord < SMALL:
        return chord * (1.0 + square * (1.0 / 24.0 + square * (3.0 / 640.0 + square * (5.0 / 7168.0))))
    return 2.0 * atan2(chord, sqrt(max(0.0, 2.0 + 2.0 * product)))


@exact
def _add_step(
    a: float, b: float, c: float, x: float, y: float, dx: float, dy: float, along: float, part: Floats
) -> None:
    """Add the part of a ray that leaves at (x, y) to 1/η and δ/η; (a, b, c): ray over exit length."""
    xx, yy, xy = 1.0 - x * x, 1.0 - y * y, -x * y
    ac, bc, cc = a * c, b * c, c * c
    part[NORMAL] += xx * (a * a)
    part[NORMAL + 1] += xx * ac
    part[NORMAL + 2] += xx * cc
    part[NORMAL + 3] += yy * (b * b)
    part[NORMAL + 4] += yy * bc
    part[NORMAL + 5] += yy * cc
    part[NORMAL + 6] += xy * (a * b)
    part[NORMAL + 7] += xy * ac
    part[NORMAL + 8] += xy * bc
    part[NORMAL + 9] += xy * cc
    gx, gy = dx - along * x, dy - along * y
    part[GRADIENT] += a * gx
    part[GRADIENT + 1] += b * gy
    part[GRADIENT + 2] += c * gx
    part[GRADIENT + 3] += c * gy
