"""Additional steps of the straight path on non-uniform sheets, compiled: blocks into cells of another pitch,
displaced lenses.

Loops as in `straight_path`. Compiled only for non-uniform sheets; see `array_cells`.
"""

from __future__ import annotations

import numpy as np

from clacad.base.compiled import exact, inlined, least, multiply_add, pair_sum, two_sum
from clacad.base.types import Floats
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.array_cells import (
    centre_of,
    gradient_of,
    grid_of,
    lens_height,
    own_size,
    place_in_row,
    steps_to,
    times_gradient,
)
from clacad.tracing.compiled.block import (
    AX,
    AY,
    CI,
    CJ,
    DX,
    DY,
    DZ,
    GOOD,
    PATH,
    SIZE,
    XL,
    YL,
    X,
    Y,
    Z,
    lane,
    lanes,
)
from clacad.tracing.compiled.cells import hexagon_steps
from clacad.tracing.compiled.packing import OwnCells, Packed
from clacad.tracing.compiled.records import Vector

CLEAR = 2.0**-44
"""Share of half a cell: closer to a border no cell is decided here; 100 times the rounding of both paths."""


@exact
def carry_own(
    lattices: Floats, s: Floats, m: int, level: float, index: float, arrays: tuple[int, int], origin: Vector
) -> None:
    """Carry rays to a level and into the cells of the array there; see `straight_path.carry`.

    Cells of equal index in two arrays lie index times the pitch difference apart, exact where the pitches are
    equal. Products and sums are kept in pairs.
    """
    z, dx, dy, dz, path = lanes(s, (Z, DX, DY, DZ, PATH))
    ox, oy, oz = origin
    rise = level - oz
    here, there = lattices[arrays[0]], lattices[arrays[1]]
    x, y, xl, yl, ci, cj = lanes(s, (X, Y, XL, YL, CI, CJ))
    for i in range(m):
        t = (rise - z[i]) / dz[i]
        x[i], y[i] = x[i] + ox + t * dx[i], y[i] + oy + t * dy[i]
        z[i] = level
        path[i] += index * t
    one, two, of, to = grid_of(here), grid_of(there), slot.SHIFT + 2 * arrays[0], slot.SHIFT + 2 * arrays[1]
    for i in range(m):
        xl[i], yl[i] = steps_to(one, ci[i], cj[i])
    _apart(x, xl, m, two_sum(one.pitch, -two.pitch), _beside(one.x0, two.x0, here[of], here[to]))
    _apart(y, yl, m, two_sum(one.row, -two.row), _beside(one.y0, two.y0, here[of + 1], here[to + 1]))
    if here[slot.HEXAGONAL] != 0.0:
        _into_hexagons(there, s, m)
        return
    _into_squares(x, xl, ci, lane(s, GOOD), m, two.pitch)
    _into_squares(y, yl, cj, lane(s, GOOD), m, two.row)


@exact
def _beside(first: float, second: float, shift: float, other: float) -> tuple[float, float]:
    """Displacement between two arrays, as a pair, from the first position and the shift of each."""
    h, e = two_sum(first, -second)
    a, b = two_sum(shift, -other)
    return pair_sum(h, e, a, b)


@exact
def _apart(x: Floats, steps: Floats, m: int, pitch: tuple[float, float], shift: tuple[float, float]) -> None:
    """Add steps · pitch + shift to x; `steps` receives the rounding error."""
    (ph, pl), (ch, cl) = pitch, shift
    for i in range(m):
        k = steps[i]
        h = k * ph
        low = multiply_add(k, ph, -h) + k * pl
        h, e = two_sum(h, ch)
        x[i], f = two_sum(h, x[i])
        steps[i] = (low + cl) + (e + f)


@exact
def _into_squares(x: Floats, low: Floats, cell: Floats, good: Floats, m: int, pitch: float) -> None:
    per_pitch, half = 1.0 / pitch, 0.5 * pitch * (1.0 - CLEAR)
    for i in range(m):
        a = np.floor(x[i] * per_pitch + 0.5)
        u = multiply_add(-a, pitch, x[i]) + low[i]
        x[i] = u
        cell[i] += a
        good[i] = least(good[i], half - abs(u))


@exact
def _into_hexagons(lat: Floats, s: Floats, m: int) -> None:
    x, y, xl, yl, ci, cj, good = lanes(s, (X, Y, XL, YL, CI, CJ, GOOD))
    pitch, row = lat[slot.PITCH], lat[slot.ROW]
    per_pitch, per_row, half, slant = 1.0 / pitch, 1.0 / row, 0.5 * pitch, row / pitch
    clear = half * (1.0 - CLEAR)
    for i in range(m):
        b = np.floor(y[i] * per_row + 0.5)
        a = np.floor(x[i] * per_pitch - 0.5 * b + 0.5)
        u, v = x[i] - (a + 0.5 * b) * pitch, y[i] - b * row
        i_step, j_step = hexagon_steps(u, v, half, slant, 0.5)
        a, b = a + i_step, b + j_step
        u = multiply_add(-(a + 0.5 * b), pitch, x[i]) + xl[i]
        v = multiply_add(-b, row, y[i]) + yl[i]
        x[i], y[i] = u, v
        ci[i] += a
        cj[i] += b
        one, two, three = abs(u), abs(0.5 * u + slant * v), abs(0.5 * u - slant * v)
        good[i] = least(least(good[i], clear - one), least(clear - two, clear - three))


@exact
def to_own_lens(sheet: Packed, own: OwnCells, f: int, s: Floats, m: int, offset: Vector) -> None:
    """Transform rays to the lens of each ray's own cell, where lenses vary from cell to cell.

    Positions plus the offset are relative to the face's vertex; lengths are in units of the lens's size.
    """
    if own.change[f, slot.CHANGES] == 0.0:
        return
    x, y, ax, ay, ci, cj = lanes(s, (X, Y, AX, AY, CI, CJ))
    grid, gradient = grid_of(sheet.lattice), gradient_of(own, f)
    for i in range(m):
        ax[i], ay[i] = times_gradient(gradient, centre_of(grid, ci[i], cj[i]))
    which = int(own.change[f, slot.TABLE])
    if which >= 0:
        _add_tabled(sheet, own.table[which], s, m)
    if _level(own, f):
        for i in range(m):
            x[i], y[i] = x[i] - ax[i], y[i] - ay[i]
        return
    _look_up_sizes(sheet, own, f, s, m)
    z, path, size = lanes(s, (Z, PATH, SIZE))
    rise_x, rise_y = own.change[f, slot.RISE_X], own.change[f, slot.RISE_Y]
    ox, oy, oz = offset
    for i in range(m):
        rise = ax[i] * rise_x + ay[i] * rise_y
        x[i] = (x[i] + ox - ax[i]) / size[i] - ox
        y[i] = (y[i] + oy - ay[i]) / size[i] - oy
        z[i] = (z[i] + oz - rise) / size[i] - oz
        path[i] /= size[i]


@inlined
def _level(own: OwnCells, f: int) -> bool:
    """Whether the lenses of a face have one height and one size."""
    change = own.change
    level = change[f, slot.RISE_X] == 0.0 and change[f, slot.RISE_Y] == 0.0
    return bool(level and change[f, slot.SIZES] < 0.0)


@exact
def _look_up_sizes(sheet: Packed, own: OwnCells, f: int, s: Floats, m: int) -> None:
    """Size of the lens of each ray's cell."""
    for i in range(m):
        s[SIZE, i] = own_size(sheet, own, f, s[CI, i], s[CJ, i]) if s[GOOD, i] > 0.0 else 1.0


@exact
def _add_tabled(sheet: Packed, table: Floats, s: Floats, m: int) -> None:
    """Add the tabulated part of the lens offsets; GOOD rays are in kept cells."""
    ax, ay, ci, cj, good = lanes(s, (AX, AY, CI, CJ, GOOD))
    for i in range(m):
        kept = good[i] > 0.0
        a, b = ci[i] if kept else 0.0, cj[i] if kept else 0.0
        place = place_in_row(sheet.lattice, a, b)
        ax[i] += table[place, int(b), 0]
        ay[i] += table[place, int(b), 1]


@exact
def from_own_lens(own: OwnCells, f: int, s: Floats, m: int, offset: Vector) -> None:
    """Undo `to_own_lens`."""
    if own.change[f, slot.CHANGES] == 0.0:
        return
    x, y, ax, ay = lanes(s, (X, Y, AX, AY))
    if _level(own, f):
        for i in range(m):
            x[i], y[i] = x[i] + ax[i], y[i] + ay[i]
        return
    z, path, size = lanes(s, (Z, PATH, SIZE))
    rise_x, rise_y = own.change[f, slot.RISE_X], own.change[f, slot.RISE_Y]
    ox, oy, oz = offset
    for i in range(m):
        x[i] = (x[i] + ox) * size[i] + ax[i] - ox
        y[i] = (y[i] + oy) * size[i] + ay[i] - oy
        z[i] = (z[i] + oz) * size[i] + (ax[i] * rise_x + ay[i] * rise_y) - oz
        path[i] *= size[i]


@exact
def own_thick(sheet: Packed, f: int, s: Floats, m: int) -> None:
    """Require that hits on one face lie on the right side of the body's other face; see `straight_path`."""
    faces = sheet.faces
    vx, vy, vz = faces[f, slot.VX], faces[f, slot.VY], faces[f, slot.VZ]
    other, sign = f + 1 - 2 * (f % 2), 1.0 - 2.0 * (f % 2)
    for i in range(m):
        if s[GOOD, i] > 0.0:
            over = lens_height(sheet, other, (s[CI, i], s[CJ, i]), s[X, i] + vx, s[Y, i] + vy)
            if not sign * (over - (s[Z, i] + vz)) >= 0.0:
                s[GOOD, i] = 0.0
