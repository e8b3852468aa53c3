"""Rows of a block's scratch array, each one quantity of every ray; what loads, stores and tests them."""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite
from typing import Any

import numpy as np

from clacad.base.compiled import exact, least
from clacad.base.compiled_vectors import EIGHT, eight_apart, eight_together
from clacad.base.kernel_cache import numba
from clacad.base.types import Cells, Floats, Ints, Rows
from clacad.optics.rays import NO_CELL, Fate
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.packing import Packed
from clacad.tracing.compiled.records import Outcome

ALIVE, GHOST, MISSED, INVALID = int(Fate.ALIVE), int(Fate.GHOST), int(Fate.MISSED), int(Fate.INVALID)

X, Y, Z, DX, DY, DZ, ROOT, PATH, GOOD, CI, CJ, CI0, CJ0, LEFT_X, LEFT_Y, GX, GY, GZ = range(18)
SHARE, OVER, DEPTH, STEEP, HALF, AX, AY, SIZE, MET = range(18, 27)
"""Transmitted light is SHARE/OVER; DEPTH sums attenuation times length, STEEP is attenuation/N; HALF numbers
half bins.
(AX, AY), SIZE: offset of the lens of a ray's cell from the face's vertex, and its scale factor, on
non-uniform sheets.
MET: first of the rows that keep the hits on the first face, which are those of every line of light.
"""

KEPT = (X, Y, Z, DX, DY, DZ, ROOT, PATH, GOOD, CI, CJ, GX, GY, GZ, AX, AY, SIZE)
QUADRIC_ROWS = 11
"""Count of kept rows that the quadrics of a uniform sheet need: their normals follow from the hits."""

SCRATCH = MET + len(KEPT)

RANGE = ROOT
"""Distances, where facets replace a smooth face."""

XL, YL = GX, GY
"""Rounding errors of positions, on the way to another cell."""

MOST = 2.0**31 - 1.0

BEHIND_START = -8 * 2.0**-52
"""Share of the travelled distance by which the first face may lie behind the start: rounding error."""

BLOCK = 256
"""Rays in a block: the rows that one face works on take 24 KB, which the first-level cache holds."""


def _row(context: Any, builder: Any, scratch: Any, value: Any, number: Any) -> Any:
    """Row of a scratch array (any, BLOCK) as an address at a fixed offset from its start."""
    whole = context.make_array(scratch)(context, builder, value)
    row = context.make_array(scratch.copy(ndim=1))(context, builder)
    width, size = (context.get_constant(numba.types.intp, n) for n in (BLOCK, scratch.dtype.bitwidth // 8))
    start = builder.gep(whole.data, [builder.mul(number, width)])
    numba.np.arrayobj.populate_array(row, start, (width,), (size,), size, None)
    return row._getvalue()


def _lane(typing_context: Any, scratch: Any, number: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _row(context, builder, scratch, *arguments)

    return scratch.copy(ndim=1)(scratch, numba.types.intp), generate


def _lanes(typing_context: Any, scratch: Any, numbers: Any) -> Any:
    count = len(numbers)
    asked = numba.types.UniTuple(numba.types.intp, count)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        rows = [
            _row(context, builder, scratch, arguments[0], number)
            for number in numba.core.cgutils.unpack_tuple(builder, arguments[1], count)
        ]
        return context.make_tuple(builder, signature.return_type, rows)

    return numba.types.UniTuple(scratch.copy(ndim=1), count)(scratch, asked), generate


lane: Callable[[Floats, int], Floats] = numba.extending.intrinsic(_lane)
"""Row `number` of the scratch array, at an address known when the kernel is compiled.

Loops over rows that cannot overlap need no overlap test, which takes longer than a short loop.
"""

lanes: Callable[[Floats, tuple[int, ...]], tuple[Floats, ...]] = numba.extending.intrinsic(_lanes)
"""Several rows at once."""


@exact
def copy_row(one: Floats, other: Floats, m: int) -> None:
    """Copy a row of any precision to another: a plain loop becomes vector moves, a slice does not."""
    for k in range(m):
        other[k] = one[k]


@exact
def keep_hits(s: Floats, m: int, back: bool, count: int) -> None:
    """Keep the first `count` rows of KEPT as the rays of a block meet the first face, or fetch them back."""
    for k in range(count):
        if back:
            copy_row(lane(s, MET + k), lane(s, KEPT[k]), m)
        else:
            copy_row(lane(s, KEPT[k]), lane(s, MET + k), m)


@exact
def hold_in_zone(lat: Floats, s: Floats, m: int, margin: float, ox: float, oy: float) -> None:
    """Require that points plus (ox, oy) lie inside their cell, `margin` from its borders."""
    x, y, good, real = lane(s, X), lane(s, Y), lane(s, GOOD), s.dtype.type
    margin, ox, oy, middle = real(margin), real(ox), real(oy), real(0.5)
    if lat[slot.HEXAGONAL] == 0.0:
        hx, hy = lat[slot.HALF] - margin, lat[slot.HALF + 1] - margin
        for i in range(m):
            good[i] = least(good[i], least(hx - abs(x[i] + ox), hy - abs(y[i] + oy)))
        return
    half, slant = lat[slot.HALF] - margin, lat[slot.NORMAL + 3]
    for i in range(m):
        u, v = x[i] + ox, y[i] + oy
        one, two, three = abs(u), abs(middle * u + slant * v), abs(middle * u - slant * v)
        good[i] = least(least(good[i], half - one), least(half - two, half - three))


@exact
def arrive(lat: Floats, rows: Ints, s: Floats, m: int, climb: float) -> None:
    """Require that rays on a reference plane lie inside a kept cell and are steeper than its lens."""
    x, y, dz, ci, cj, good = lanes(s, (X, Y, DZ, CI, CJ, GOOD))
    climb, middle = s.dtype.type(climb), s.dtype.type(0.5)
    if lat[slot.PLAIN] != 0.0:
        n1, n2, hx, hy = lat[slot.N1] - middle, lat[slot.N2] - middle, lat[slot.HALF], lat[slot.HALF + 1]
        for i in range(m):
            inside = least(least(ci[i] + middle, n1 - ci[i]), least(cj[i] + middle, n2 - cj[i]))
            local = least(hx - abs(x[i]), hy - abs(y[i]))
            good[i] = least(least(good[i], dz[i] - climb), least(inside, local))
        return
    hold_in_zone(lat, s, m, 0.0, 0.0, 0.0)
    last = float(len(rows) - 1)
    for i in range(m):
        j = min(max(cj[i], 0.0), last)
        row = int(j) if j == j else 0
        inside = (cj[i] == j) & (ci[i] >= rows[row, 0]) & (ci[i] < rows[row, 1]) & (dz[i] >= climb)
        good[i] = good[i] if inside else 0.0


@exact
def centres(lat: Floats, s: Floats, m: int, array: int, px: Floats, py: Floats, ox: float, oy: float) -> None:
    """Sheet-frame x and y of points plus (ox, oy)."""
    x, y, ci, cj = lanes(s, (X, Y, CI, CJ))
    sx, sy = lat[slot.SHIFT + 2 * array], lat[slot.SHIFT + 2 * array + 1]
    pitch, row = lat[slot.PITCH], lat[slot.ROW]
    real = s.dtype.type
    ox, oy, middle, one, two = real(ox), real(oy), real(0.5), real(1.0), real(2.0)
    if lat[slot.HEXAGONAL] != 0.0:
        x0, y0 = lat[slot.X0], lat[slot.Y0]
        for i in range(m):
            px[i] = (x0 + (ci[i] + middle * cj[i]) * pitch + sx) + (x[i] + ox)
            py[i] = (y0 + cj[i] * row + sy) + (y[i] + oy)
        return
    across, along = lat[slot.N1] - one, lat[slot.N2] - one
    for i in range(m):
        px[i] = ((two * ci[i] - across) * (middle * pitch) + sx) + (x[i] + ox)
        py[i] = ((two * cj[i] - along) * (middle * row) + sy) + (y[i] + oy)


@exact
def load_block(chosen: Rows, position: Floats, direction: Floats, s: Floats) -> None:
    """Copy a block of starts and directions into the scratch rows."""
    x, y, z, dx, dy, dz = lanes(s, (X, Y, Z, DX, DY, DZ))
    if _together(chosen):
        _load_vectors(position, chosen[0], len(chosen), x, y, z)
        _load_vectors(direction, chosen[0], len(chosen), dx, dy, dz)
        return
    for k in range(len(chosen)):
        row = chosen[k]
        x[k], y[k], z[k] = position[row, 0], position[row, 1], position[row, 2]
        dx[k], dy[k], dz[k] = direction[row, 0], direction[row, 1], direction[row, 2]


@exact
def _load_vectors(column: Floats, first: int, m: int, x: Floats, y: Floats, z: Floats) -> None:
    """Read m vectors of a column (n, 3) from a row on."""
    whole = m - m % EIGHT
    for k in range(0, whole, EIGHT):
        eight_apart(column, first + k, x, y, z, k)
    for k in range(whole, m):
        x[k], y[k], z[k] = column[first + k, 0], column[first + k, 1], column[first + k, 2]


@exact
def _together(chosen: Rows) -> bool:
    """Whether rows are consecutive, so that a block can be moved as one piece."""
    apart = 0
    for k in range(len(chosen)):
        apart |= chosen[k] - chosen[0] - k
    return apart == 0


@exact
def store_block(sheet: Packed, s: Floats, chosen: Rows, array: int, out: Outcome) -> None:
    """Write the rows of a block; rows of rays whose straight trace does not hold are meaningless."""
    faces, bodies = sheet.faces, sheet.bodies
    m = len(chosen)
    px, py, z, dz, good = lanes(s, (GX, GY, Z, DZ, GOOD))
    ci, cj, ci0, cj0 = lanes(s, (CI, CJ, CI0, CJ0))
    last = len(faces) - 1
    face, top = faces[last], bodies[len(bodies) - 1, slot.LEVEL] + faces[last, slot.VZ]
    centres(sheet.lattices[array], s, m, array, px, py, face[slot.VX], face[slot.VY])
    for k in range(m):
        good[k] = 1.0 if (good[k] > 0.0) & (dz[k] > 0.0) else 0.0
        z[k] += top
    for k in range(m):
        ci[k], cj[k] = _in_range(ci[k] - ci0[k]), _in_range(cj[k] - cj0[k])
        ci0[k], cj0[k] = _in_range(ci0[k]), _in_range(cj0[k])
    if _together(chosen):
        _store_together(s, chosen[0], m, last, out)
        return
    for k in range(m):
        row = chosen[k]
        out.position[row, 0], out.position[row, 1], out.position[row, 2] = px[k], py[k], z[k]
        out.direction[row, 0], out.direction[row, 1], out.direction[row, 2] = s[DX, k], s[DY, k], dz[k]
        out.path[row], out.surface[row] = s[PATH, k], last
        out.cell[row, 0], out.cell[row, 1] = np.int32(ci0[k]), np.int32(cj0[k])
        out.order[row, 0], out.order[row, 1] = np.int32(ci[k]), np.int32(cj[k])
        out.fate[row] = ALIVE if ci[k] == 0.0 and cj[k] == 0.0 else GHOST


@exact
def _in_range(number: float) -> float:
    """Limit a number to the range of int32; only numbers of rays without a valid result are changed."""
    number = least(MOST, number)
    return -MOST if number < -MOST else number


@exact
def _store_together(s: Floats, first: int, m: int, last: int, out: Outcome) -> None:
    """Write m consecutive rows from the first."""
    fate, path, surface = (
        out.fate[first : first + m],
        out.path[first : first + m],
        out.surface[first : first + m],
    )
    ci, cj, length = lanes(s, (CI, CJ, PATH))
    _store_vectors(lane(s, GX), lane(s, GY), lane(s, Z), out.position, first, m)
    _store_vectors(lane(s, DX), lane(s, DY), lane(s, DZ), out.direction, first, m)
    for k in range(m):
        path[k] = length[k]
    _store_cells(lane(s, CI0), lane(s, CJ0), out.cell, first, m)
    _store_cells(ci, cj, out.order, first, m)
    for k in range(m):
        surface[k] = last
    for k in range(m):
        fate[k] = ALIVE if (ci[k] == 0.0) & (cj[k] == 0.0) else GHOST


@exact
def _store_vectors(x: Floats, y: Floats, z: Floats, column: Floats, first: int, m: int) -> None:
    """Write m vectors of a column (n, 3) from a row on."""
    whole = m - m % EIGHT
    for k in range(0, whole, EIGHT):
        eight_together(column, first + k, x, y, z, k)
    for k in range(whole, m):
        column[first + k, 0], column[first + k, 1], column[first + k, 2] = x[k], y[k], z[k]


@exact
def _store_cells(i: Floats, j: Floats, column: Cells, first: int, m: int) -> None:
    """Write m cells of a column (n, 2) from a row on; the stride of two numbers is plain to the compiler."""
    flat = column.reshape(column.size)[2 * first : 2 * (first + m)]
    for k in range(m):
        flat[2 * k], flat[2 * k + 1] = np.int32(i[k]), np.int32(j[k])


@exact
def blank_row(row: int, start: Floats, ray: Floats, out: Outcome) -> bool:
    """Write a row as launched, MISSED or INVALID; return whether the ray can be launched.

    Of several lines of light, the rows of each line follow those of the one before.
    """
    finite, zero, at = True, True, row % len(start)
    for c in range(3):
        out.position[row, c], out.direction[row, c] = start[at, c], ray[at, c]
        finite &= isfinite(start[at, c]) and isfinite(ray[at, c])
        zero &= ray[at, c] == 0.0
        for face in range(len(out.hits)):
            out.hits[face, row, c], out.turns[face, row, c] = start[at, c], ray[at, c]
    out.cell[row, 0], out.cell[row, 1], out.order[row, 0], out.order[row, 1] = (
        NO_CELL,
        NO_CELL,
        NO_CELL,
        NO_CELL,
    )
    out.path[row], out.surface[row] = 0.0, NO_CELL
    sound = finite and not zero
    out.fate[row] = MISSED if sound else INVALID
    return sound and ray[at, 2] > 0.0


@exact
def queue_undecided(s: Floats, block: Rows, waiting: Rows, count: int) -> int:
    """Append the rays of a block whose straight trace does not hold to the list of rays to walk."""
    good = lane(s, GOOD)
    for k in range(len(block)):
        if good[k] == 0.0:
            waiting[count] = block[k]
            count += 1
    return count
