"""Compiled launch: rays carried to the first body's reference plane without rounding, and their cells."""

from __future__ import annotations

from math import frexp, isfinite, ldexp, nan, sqrt

import numpy as np

from clacad.base.compiled import exact, least, multiply_add, pair_product, pair_sum, two_product, two_sum
from clacad.base.types import Floats
from clacad.optics.sequence import UNIT
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.block import CI, CJ, DX, DY, DZ, GOOD, GX, GY, PATH, X, Y, Z, lane, lanes
from clacad.tracing.compiled.cells import hexagon_steps, locate
from clacad.tracing.compiled.column import box_span
from clacad.tracing.compiled.packing import Packed
from clacad.tracing.compiled.records import Launched

SANE = 1e100
"""Directions with components above this, or all below its inverse, are scaled before use."""


@exact
def carried_to(
    lat: Floats, plane: float, x: float, y: float, z: float, L: float, M: float, N: float
) -> tuple[float, float, float, float, float]:
    """Carry a start along an unrounded direction to a plane: step, cell and local coordinates there."""
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
def launch_ray(sheet: Packed, position: Floats, direction: Floats, row: int) -> tuple[bool, Launched]:
    """Whether a ray from any start reaches the first body, and where; see `reference.launch.launch`."""
    lat, bodies = sheet.lattice, sheet.bodies
    nowhere = Launched(nan, nan, nan, nan, nan, nan, nan, nan, nan)
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
    plane = bodies[0, slot.LEVEL] + bodies[0, slot.BODY_LOW]
    run, span = (plane - z) / N, (bodies[0, slot.BODY_HIGH] - bodies[0, slot.BODY_LOW]) / N
    enter, leave = box_span(lat, bodies, 0, x + run * L, y + run * M, L, M)
    if not (enter <= leave and leave >= 0.0 and enter <= span):
        return False, nowhere
    if enter > 0.0:
        plane = plane + enter * N
    if not isfinite(plane):
        return False, nowhere
    step, i, j, u, v = carried_to(lat, plane, x, y, z, l, m, n)
    return True, Launched(i, j, u, v, plane - bodies[0, slot.LEVEL], L, M, N, step * length)


@exact
def launch_block(lat: Floats, body: Floats, s: Floats, m: int) -> None:
    """Launch a block of rays whose starts and directions are in the scratch rows; see `launch_ray`.

    Rays of insane scale, and rays that are over no cell on the reference plane, lose their mark GOOD. Lengths
    are computed only in a block with a direction whose length is not 1: a root and a division a ray.
    """
    x, y, z, dx, dy, dz = lanes(s, (X, Y, Z, DX, DY, DZ))
    path, good, xl, yl = lanes(s, (PATH, GOOD, GX, GY))
    plane, low = body[slot.LEVEL] + body[slot.BODY_LOW], body[slot.BODY_LOW]
    loose = 0
    for k in range(m):
        a, b, c = dx[k], dy[k], dz[k]
        square = a * a + b * b + c * c
        good[k] = least(least(square - 1.0 / SANE, SANE - square), c)
        loose |= not abs(square - 1.0) <= UNIT
    for k in range(m):
        a, b, c = dx[k], dy[k], dz[k]
        per_c = 1.0 / c
        top, bottom = two_sum(plane, -z[k])
        step = top * per_c
        rest = (multiply_add(-step, c, top) + bottom) * per_c
        h = step * a
        x[k], e = two_sum(h, x[k])
        xl[k] = e + (multiply_add(step, a, -h) + rest * a)
        h = step * b
        y[k], e = two_sum(h, y[k])
        yl[k] = e + (multiply_add(step, b, -h) + rest * b)
        z[k], path[k] = low, step
    if loose:
        _normalise(s, m)
    if lat[slot.HEXAGONAL] == 0.0:
        _cells_of_axis(x, xl, lane(s, CI), lat[slot.PITCH], lat[slot.N1], m)
        _cells_of_axis(y, yl, lane(s, CJ), lat[slot.ROW], lat[slot.N2], m)
    else:
        _hexagons(lat, x, xl, y, yl, lane(s, CI), lane(s, CJ), m)


@exact
def _normalise(s: Floats, m: int) -> None:
    """Scale directions whose length is not 1 to unit length, and the paths counted in their lengths."""
    dx, dy, dz, path = lanes(s, (DX, DY, DZ, PATH))
    for k in range(m):
        a, b, c = dx[k], dy[k], dz[k]
        square = a * a + b * b + c * c
        length = 1.0 if abs(square - 1.0) <= UNIT else sqrt(square)
        per_length = 1.0 / length
        path[k] *= length
        dx[k], dy[k], dz[k] = a * per_length, b * per_length, c * per_length


@exact
def _cells_of_axis(x: Floats, xl: Floats, cell: Floats, pitch: float, count: float, m: int) -> None:
    per_pitch, middle, half, last = 1.0 / pitch, 0.5 * count, 0.5 * pitch, count - 1.0
    for k in range(m):
        cell[k] = np.floor(x[k] * per_pitch + middle)
        x[k] = multiply_add(last - 2.0 * cell[k], half, x[k]) + xl[k]


@exact
def _hexagons(
    lat: Floats, x: Floats, xl: Floats, y: Floats, yl: Floats, ci: Floats, cj: Floats, m: int
) -> None:
    p, row, x0, y0 = lat[slot.PITCH], lat[slot.ROW], lat[slot.X0], lat[slot.Y0]
    per_p, per_row, half, slant = 1.0 / p, 1.0 / row, 0.5 * p, row / p
    for k in range(m):
        j = np.floor((y[k] - y0) * per_row + 0.5)
        i = np.floor((x[k] - x0) * per_p - 0.5 * j + 0.5)
        u, v = x[k] - x0 - (i + 0.5 * j) * p, y[k] - y0 - j * row
        di, dj = hexagon_steps(u, v, half, slant, 0.5)
        ci[k], cj[k] = i + di, j + dj
    for k in range(m):
        x[k] = _less_origin_fast(x[k], xl[k], ci[k] + 0.5 * cj[k], p, x0)
        y[k] = _less_origin_fast(y[k], yl[k], cj[k], row, y0)


@exact
def _less_origin_fast(x: float, low: float, k: float, step: float, origin: float) -> float:
    """Value of x + low − k·step − origin, rounded once, by multiply-adds."""
    high = k * step
    a, e = two_sum(x, -high)
    b, f = two_sum(a, -origin)
    return b + ((e + f) + (low - multiply_add(k, step, -high)))
