"""Rung "law" compiled: blocks of rays that cross the sheet well inside a cell; the rest is left to numpy.

The twin of `clacad.tracing.reference.law_rung`. Directions are computed in the order of `Law.refract`, so
they agree to the last bit. Its scaling by powers of two is left out: only directions and laws of insane size
need it.

Sums over traced rays, compiled: the twin of `clacad.tracing.reference.law_rung`.
"""

from __future__ import annotations

from math import atan2, inf, sqrt

import numpy as np

from clacad.base.compiled import exact, least, multiply_add, owning, two_sum
from clacad.base.types import Bytes, Floats, Rows
from clacad.optics.law import law_numbers
from clacad.optics.rays import Fate, Rays
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.chunk import load_block, queue_undecided, store_block
from clacad.tracing.compiled.launch import launch_block
from clacad.tracing.compiled.packing import Packed, pack_array_1
from clacad.tracing.compiled.plain_cases import (
    FAR,
    MISS,
    NEAR,
    arrive_well_inside,
    miss,
    rows_left,
    surely_unmet,
)
from clacad.tracing.compiled.records import Outcome
from clacad.tracing.compiled.straight_path import copy_row
from clacad.tracing.compiled.straight_path_slots import (
    BLOCK,
    CI,
    CI0,
    CJ,
    CJ0,
    DX,
    DY,
    DZ,
    GOOD,
    GZ,
    LEFT_X,
    LEFT_Y,
    PATH,
    ROOT,
    SCRATCH,
    STEEP,
    X,
    Y,
    lane,
    lanes,
)
from clacad.tracing.layout import Layout
from clacad.tracing.ledger import Ledger
from clacad.tracing.reference.law_rung import GRADIENT, KNOWN, NORMAL, NUMBERS, OUT, SQUARE, ordinary

ETA_X, ETA_Y, DELTA_X, DELTA_Y, R0 = range(5)
"""Indices of `law_numbers`."""

SANE = STEEP
"""Row of a block that is positive where a direction is of ordinary size and goes forwards."""


def trace_law_plain(layout: Layout, rays: Rays, ledger: Ledger, threads: int) -> Rows:
    """Write the rows of rays (n) that clearly cross a kept cell in z = 0; return the other rows (k,), not yet
    written.
    """
    law = law_numbers(layout.window.law)
    if not ordinary(law):
        return np.arange(len(rays))
    return rows_left(law_chunk, _sheet_plane(layout), law, rays, ledger, threads)


def _sheet_plane(layout: Layout) -> Packed:
    """The sheet plane z = 0 as a body of no thickness with one face."""
    return pack_array_1(layout)._replace(
        faces=np.zeros((1, slot.FACE_NUMBERS)), bodies=np.zeros((1, slot.BODY_NUMBERS)), indices=np.ones(1)
    )


@owning
def law_chunk(
    sheet: Packed, law: Floats, chosen: Rows, start: Floats, ray: Floats, out: Outcome, left: Rows
) -> int:
    """Trace the rays `chosen` of `start` and `ray` (n, 3) and write their rows.

    law : see `law_numbers`
    left : (len(chosen),)
        Receives the rows that are not decided here; their count is returned.
    """
    s, count = np.zeros((SCRATCH, BLOCK)), 0
    for first in range(0, len(chosen), BLOCK):
        block = chosen[first : first + BLOCK]
        m = len(block)
        load_block(block, start, ray, s)
        _refract(law, s, m)
        launch_block(sheet.lattice, sheet.bodies[0], s, m)
        copy_row(lane(s, GOOD), lane(s, SANE), m)
        arrive_well_inside(sheet, s, m)
        _cross(sheet, s, m)
        store_block(sheet, s, block, 0, out)
        miss(s, block, start, ray, out)
        count = queue_undecided(s, block, left, count)
    return count


@exact
def less_product(x: float, a: float, b: float) -> float:
    """Value of x − a b with the product unrounded."""
    product = a * b
    total, rest = two_sum(x, -product)
    return total + (rest - multiply_add(a, b, -product))


@exact
def _refract(law: Floats, s: Floats, m: int) -> None:
    """Put the directions behind the sheet into LEFT_X, LEFT_Y, ROOT, and the margin by which they exist into
    GZ.
    """
    dx, dy, dz, out_x, out_y, out_z, sure = lanes(s, (DX, DY, DZ, LEFT_X, LEFT_Y, ROOT, GZ))
    eta_x, eta_y, delta_x, delta_y = law[ETA_X], law[ETA_Y], law[DELTA_X], law[DELTA_Y]
    a, b, c = law[R0], law[R0 + 1], law[R0 + 2]
    d, e, f = law[R0 + 3], law[R0 + 4], law[R0 + 5]
    g, h, k = law[R0 + 6], law[R0 + 7], law[R0 + 8]
    for i in range(m):
        u, v, w = dx[i], dy[i], dz[i]
        x, y, z = (a * u + d * v) + g * w, (b * u + e * v) + h * w, (c * u + f * v) + k * w
        sure[i] = z - NEAR * (abs(u) + abs(v) + abs(w))
        x, y = less_product(x, delta_x, z) / eta_x, less_product(y, delta_y, z) / eta_y
        u, v, w = (a * x + b * y) + c * z, (d * x + e * y) + f * z, (g * x + h * y) + k * z
        length = sqrt(u * u + v * v + w * w)
        out_x[i], out_y[i], out_z[i] = u / length, v / length, w / length


@exact
def _cross(sheet: Packed, s: Floats, m: int) -> None:
    """Refract rays that start before the plane; rays that are turned back, or nearly so, are not good."""
    x, y, dx, dy, dz, good, path = lanes(s, (X, Y, DX, DY, DZ, GOOD, PATH))
    out_x, out_y, out_z, sure = lanes(s, (LEFT_X, LEFT_Y, ROOT, GZ))
    copy_row(lane(s, CI), lane(s, CI0), m)
    copy_row(lane(s, CJ), lane(s, CJ0), m)
    far = FAR * sheet.lattice[slot.REACH]
    for i in range(m):
        dx[i], dy[i], dz[i] = out_x[i], out_y[i], out_z[i]
        certain = least(least(good[i], sure[i]), out_z[i] - NEAR)
        met = (path[i] >= 0.0) & (path[i] < far) & (abs(x[i]) + abs(y[i]) < inf)
        good[i] = certain if met else 0.0
    for i in range(m):
        if not good[i] > 0.0:
            s[MISS, i] = 1.0 if surely_unmet(sheet, s, i, s[SANE, i], path[i]) else 0.0


ALIVE = int(Fate.ALIVE)

FEW = 64
"""Rays whose numbers are added plainly; their subtotals are added with compensation of the rounding error."""

SMALL = 1e-2
"""Chord below which four terms of the arc sine are exact to the last digit."""


@owning
def add_rays(law: Floats, fate: Bytes, ray: Floats, out: Floats, sums: Floats) -> float:
    """Add m rays to the sums; return the largest angle to the law.

    law : see `law_numbers`
    ray, out : (m, 3)
        Before the sheet, of any length, and behind it.
    sums : (2, NUMBERS)
        With the rounding error.
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
    """Add one ALIVE ray in the frame of the lenses; return its angle to the law, 0 where the law has no
    answer.
    """
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
    """Add the contribution of a ray that leaves at (x, y) to 1/η and δ/η; (a, b, c): incident ray over exit
    length.
    """
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
