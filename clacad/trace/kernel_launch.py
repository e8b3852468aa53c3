"""Compiled launch: rays carried to the first body's reference plane without rounding, and their cells."""

from __future__ import annotations

from math import floor, frexp, isfinite, ldexp, nan, sqrt

import numpy as np
from numpy.typing import NDArray

from clacad.trace import packing as slot
from clacad.trace.compiled import exact
from clacad.trace.kernel_column import box_span
from clacad.trace.kernel_scalar import pair_product, pair_sum, two_product, two_sum
from clacad.trace.layout import Floats
from clacad.trace.sequence import UNIT

Rows = NDArray[np.intp]

SANE = 1e100
"""Directions with components beyond this, or all below its inverse, are scaled before use."""


@exact
def _axis(x: float, low: float, pitch: float, count: float) -> tuple[float, float]:
    """Cell and centred coordinate along one axis; see `Lattice.locate`."""
    half = 0.5 * pitch
    k = floor(x / pitch + 0.5 * count)
    local = _less(x, low, 2.0 * k - (count - 1.0), half)
    k = k + (1.0 if local >= half else 0.0) - (1.0 if local < -half else 0.0)
    return k, _less(x, low, 2.0 * k - (count - 1.0), half)


@exact
def _less(x: float, low: float, k: float, step: float) -> float:
    high, rest = two_product(k, step)
    return (x - high) + (low - rest)


@exact
def _less_origin(x: float, low: float, k: float, step: float, origin: float) -> float:
    """Give x + low − k·step − origin, rounded once."""
    high, rest = two_product(k, step)
    a, e = two_sum(x, -high)
    b, f = two_sum(a, -origin)
    return b + ((e + f) + (low - rest))


@exact
def locate(lat: Floats, x: float, xl: float, y: float, yl: float) -> tuple[float, float, float, float]:
    """Cell of array 0 that holds a sheet point given in pairs, and the point relative to its centre."""
    if lat[slot.HEXAGONAL] == 0.0:
        i, u = _axis(x, xl, lat[slot.PITCH], lat[slot.N1])
        j, v = _axis(y, yl, lat[slot.ROW], lat[slot.N2])
        return i, j, u, v
    p, row, x0, y0 = lat[slot.PITCH], lat[slot.ROW], lat[slot.X0], lat[slot.Y0]
    half, slant = 0.5 * p, row / p
    j = floor((y - y0) / row + 0.5)
    i = floor((x - x0) / p - 0.5 * j + 0.5)
    for _ in range(4):
        u, v = _less_origin(x, xl, i + 0.5 * j, p, x0), _less_origin(y, yl, j, row, y0)
        if u >= half or u < -half:
            i += 1.0 if u >= half else -1.0
            continue
        across = 0.5 * u + slant * v
        if across >= half or across < -half:
            j += 1.0 if across >= half else -1.0
            continue
        across = -0.5 * u + slant * v
        if across >= half or across < -half:
            step = 1.0 if across >= half else -1.0
            i, j = i - step, j + step
            continue
        break
    return i, j, _less_origin(x, xl, i + 0.5 * j, p, x0), _less_origin(y, yl, j, row, y0)


@exact
def carried_to(
    lat: Floats, plane: float, x: float, y: float, z: float, L: float, M: float, N: float
) -> tuple[float, float, float, float, float]:
    """Carry a start along an unrounded direction to a plane: the step, and cell and local coordinates there."""
    rise, rest = two_sum(plane, -z)
    step = rise / N
    product, over = two_product(step, N)
    low = pair_sum(rise, rest, -product, -over)[0] / N
    h, e = pair_product(step, low, L, 0.0)
    xh, xl = pair_sum(h, e, x, 0.0)
    h, e = pair_product(step, low, M, 0.0)
    yh, yl = pair_sum(h, e, y, 0.0)
    i, j, u, v = locate(lat, xh, xl, yh, yl)
    return step, i, j, u, v


@exact
def launch_ray(
    lat: Floats, body: Floats, position: Floats, direction: Floats, row: int
) -> tuple[bool, float, float, float, float, float, float, float, float, float]:
    """Launch one ray wherever it comes from; see `launch.launch`.

    Returns
    -------
    reaches, i, j, x, y, z, L, M, N, carried
    """
    L, M, N = direction[row, 0], direction[row, 1], direction[row, 2]
    _, exponent = frexp(max(abs(L), abs(M), abs(N)))
    l, m, n = ldexp(L, -exponent), ldexp(M, -exponent), ldexp(N, -exponent)  # noqa: E741
    length = 1.0
    if not abs(L * L + M * M + N * N - 1.0) <= UNIT:
        length = sqrt(l * l + m * m + n * n)
        L, M, N = l / length, m / length, n / length
    else:
        length = ldexp(1.0, -exponent)
    x, y, z = position[row, 0], position[row, 1], position[row, 2]
    plane = body[slot.LEVEL] + body[slot.BODY_LOW]
    run, span = (plane - z) / N, (body[slot.BODY_HIGH] - body[slot.BODY_LOW]) / N
    enter, leave = box_span(lat, body, x + run * L, y + run * M, L, M)
    if not (enter <= leave and leave >= 0.0 and enter <= span):
        return False, nan, nan, nan, nan, nan, nan, nan, nan, nan
    if enter > 0.0:
        plane = plane + enter * N
    if not isfinite(plane):
        return False, nan, nan, nan, nan, nan, nan, nan, nan, nan
    step, i, j, u, v = carried_to(lat, plane, x, y, z, l, m, n)
    return True, i, j, u, v, plane - body[slot.LEVEL], L, M, N, step * length


@exact
def launch_block(
    lat: Floats, body: Floats, position: Floats, direction: Floats, chosen: Rows,
    x: Floats, y: Floats, z: Floats, L: Floats, M: Floats, N: Floats, i: Floats, j: Floats, path: Floats,
    good: Floats,
) -> None:  # fmt: skip
    """Launch a block of rays that cross the reference plane over the sheet; tell which are of sane scale."""
    plane = body[slot.LEVEL] + body[slot.BODY_LOW]
    low = body[slot.BODY_LOW]
    for k in range(len(chosen)):
        row = chosen[k]
        a, b, c = direction[row, 0], direction[row, 1], direction[row, 2]
        square = a * a + b * b + c * c
        length = 1.0 if abs(square - 1.0) <= UNIT else sqrt(square)
        L[k], M[k], N[k] = a / length, b / length, c / length
        step, i[k], j[k], x[k], y[k] = carried_to(
            lat, plane, position[row, 0], position[row, 1], position[row, 2], a, b, c
        )  # fmt: skip
        z[k], path[k] = low, step * length
        good[k] = 1.0 if 1.0 / SANE < square < SANE else 0.0
