"""The cell a point belongs to, compiled: the scalar twins of `clacad.sheet.lattice` and
`clacad.tracing.layout`.

Every trace that is compared with the numpy path checks them: same cells, also on the list of hard cases.
Blocks of rays have their own loops in `launch` and `straight_path`, which share `hexagon_steps`.

Compiled short cut of the walk: the next thing a steep ray meets in a body that is solid between its two
lens faces.

Over every kept cell such a body fills the space between front and back, with no land, seam or hole. A ray
steeper than both faces crosses each at most once in a column. At a border only its height against the next
cell's faces matters. Where a decision is within the rounding error, `column.first_change` decides.
"""

from __future__ import annotations

from math import copysign, floor, inf, isfinite

from clacad.base.compiled import exact, inlined, less_multiple, two_product, two_sum
from clacad.base.types import Floats, Ints
from clacad.optics.ledger import ABOVE, BACK, FRONT
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.face import height, lens_roots, to_lens, to_sheet, upward
from clacad.tracing.compiled.packing import Packed
from clacad.tracing.compiled.records import DISTANCE, KIND, MOST_ARRAYS, PLACE, CellRay, Ray


@exact
def kept(lat: Floats, rows: Ints, i: float, j: float) -> bool:
    """Whether the lattice has this cell; a plain lattice has no table of rows."""
    if lat[slot.PLAIN] != 0.0:
        return bool(0.0 <= i < lat[slot.N1] and 0.0 <= j < lat[slot.N2])
    if not (0.0 <= j < len(rows)):
        return False
    row = int(j)
    for k in range(0, rows.shape[1], 2):
        if rows[row, k] <= i < rows[row, k + 1]:
            return True
    return False


@exact
def sheet_xy(lat: Floats, array: int, i: float, j: float, x: float, y: float) -> tuple[float, float]:
    """Sheet-frame x, y of a point of a cell."""
    sx, sy = lat[slot.SHIFT + 2 * array], lat[slot.SHIFT + 2 * array + 1]
    if lat[slot.HEXAGONAL] != 0.0:
        return (lat[slot.X0] + (i + 0.5 * j) * lat[slot.PITCH] + sx) + x, (
            lat[slot.Y0] + j * lat[slot.ROW] + sy
        ) + y
    cx = (2.0 * i - (lat[slot.N1] - 1.0)) * (0.5 * lat[slot.PITCH])
    cy = (2.0 * j - (lat[slot.N2] - 1.0)) * (0.5 * lat[slot.ROW])
    return (cx + sx) + x, (cy + sy) + y


@exact
def to_array(
    lat: Floats, of: int, array: int, i: float, j: float, x: float, y: float
) -> tuple[float, float, float, float]:
    """Cell and local coordinates in another array of a point given in the cells of array `of`."""
    if array != of:
        at = slot.BETWEEN + 4 * (MOST_ARRAYS * of + array)
        x, y = x - lat[at], y - lat[at + 1]
        i, j = i - lat[at + 2], j - lat[at + 3]
    di, dj, x, y = relocate(lat, x, y)
    return i + di, j + dj, x, y


@exact
def _cell_of_axis(x: float, low: float, pitch: float, count: float) -> tuple[float, float]:
    """Cell and centred coordinate along one axis; see `Lattice.locate`."""
    half = 0.5 * pitch
    k = float(floor(x / pitch + 0.5 * count))
    local = _less_pair(x, low, 2.0 * k - (count - 1.0), half)
    k = k + (1.0 if local >= half else 0.0) - (1.0 if local < -half else 0.0)
    return k, _less_pair(x, low, 2.0 * k - (count - 1.0), half)


@exact
def _less_pair(x: float, low: float, k: float, step: float) -> float:
    high, rest = two_product(k, step)
    return (x - high) + (low - rest)


@exact
def _less_origin(x: float, low: float, k: float, step: float, origin: float) -> float:
    """Value of x + low − k·step − origin, rounded once."""
    high, rest = two_product(k, step)
    a, e = two_sum(x, -high)
    b, f = two_sum(a, -origin)
    return b + ((e + f) + (low - rest))


@exact
def _hexagon_step(u: float, v: float, half: float, slant: float) -> tuple[float, float]:
    """Step (i, j) over the first border of a hexagon that a point of its frame lies beyond; (0, 0) inside."""
    if u >= half or u < -half:
        return (1.0 if u >= half else -1.0), 0.0
    across = 0.5 * u + slant * v
    if across >= half or across < -half:
        return 0.0, (1.0 if across >= half else -1.0)
    across = -0.5 * u + slant * v
    if across >= half or across < -half:
        step = 1.0 if across >= half else -1.0
        return -step, step
    return 0.0, 0.0


@exact
def hexagon_steps(u: float, v: float, half: float, slant: float, middle: float) -> tuple[float, float]:
    """Step (i, j) over a slanted border of a hexagon, branchless, in the precision of `middle` = 0.5."""
    one, zero = middle + middle, middle - middle
    two, three = middle * u + slant * v, -middle * u + slant * v
    second = (one if two >= half else zero) - (one if two < -half else zero)
    third = ((one if three >= half else zero) - (one if three < -half else zero)) * (one - abs(second))
    return -third, second + third


@exact
def locate(lat: Floats, x: float, xl: float, y: float, yl: float) -> tuple[float, float, float, float]:
    """Cell of array 0 that holds a sheet point given in pairs, and the point relative to its centre."""
    if lat[slot.HEXAGONAL] == 0.0:
        i, u = _cell_of_axis(x, xl, lat[slot.PITCH], lat[slot.N1])
        j, v = _cell_of_axis(y, yl, lat[slot.ROW], lat[slot.N2])
        return i, j, u, v
    p, row, x0, y0 = lat[slot.PITCH], lat[slot.ROW], lat[slot.X0], lat[slot.Y0]
    half, slant = 0.5 * p, row / p
    j = float(floor((y - y0) / row + 0.5))
    i = float(floor((x - x0) / p - 0.5 * j + 0.5))
    for _ in range(4):
        u, v = _less_origin(x, xl, i + 0.5 * j, p, x0), _less_origin(y, yl, j, row, y0)
        di, dj = _hexagon_step(u, v, half, slant)
        if di == 0.0 and dj == 0.0:
            break
        i, j = i + di, j + dj
    return i, j, _less_origin(x, xl, i + 0.5 * j, p, x0), _less_origin(y, yl, j, row, y0)


@exact
def relocate(lat: Floats, x: float, y: float) -> tuple[float, float, float, float]:
    """Whole lattice steps and remaining local coordinates; see `layout.relocate`."""
    if lat[slot.HEXAGONAL] == 0.0:
        i, x = _relocate_axis(x, lat[slot.PITCH])
        j, y = _relocate_axis(y, lat[slot.ROW])
        return i, j, x, y
    pitch, row = lat[slot.PITCH], lat[slot.ROW]
    half = 0.5 * pitch
    slant = row / pitch
    j = _nearest(y / row)
    i = _nearest(x / pitch - 0.5 * j)
    for _ in range(4):
        u, v = less_multiple(x, i + 0.5 * j, pitch), less_multiple(y, j, row)
        di, dj = _hexagon_step(u, v, half, slant)
        if di == 0.0 and dj == 0.0:
            break
        i, j = i + di, j + dj
    return i, j, less_multiple(x, i + 0.5 * j, pitch), less_multiple(y, j, row)


@exact
def _nearest(x: float) -> float:
    """Nearest integer, ties to even."""
    r = float(floor(x + 0.5))
    if r - x == 0.5 and r % 2.0 != 0.0:
        r -= 1.0
    return r


@exact
def _relocate_axis(x: float, pitch: float) -> tuple[float, float]:
    half = 0.5 * pitch
    k = float(floor(x / pitch + 0.5))
    local = less_multiple(x, k, pitch)
    if local >= half:
        k += 1.0
    elif local < -half:
        k -= 1.0
    return k, less_multiple(x, k, pitch)


@exact
def less_steps(lat: Floats, x: float, y: float, i: float, j: float) -> tuple[float, float]:
    """Local coordinates seen from the cell (i, j) steps away."""
    if i == 0.0 and j == 0.0:
        return x, y
    if lat[slot.HEXAGONAL] != 0.0:
        return less_multiple(x, i + 0.5 * j, lat[slot.PITCH]), less_multiple(y, j, lat[slot.ROW])
    return less_multiple(x, i, lat[slot.PITCH]), less_multiple(y, j, lat[slot.ROW])


@exact
def in_zone(lat: Floats, x: float, y: float, margin: float) -> bool:
    """Whether a point of the cell frame lies at least `margin` inside its cell's borders."""
    for n in range(int(lat[slot.BORDERS])):
        across = lat[slot.NORMAL + 2 * n] * x + lat[slot.NORMAL + 2 * n + 1] * y
        if not abs(across) <= lat[slot.HALF + n] - margin:
            return False
    return True


ARRIVING, INSIDE, LEAVING = 0, 1, 2
"""State of a ray: below the front, between front and back, on or over the back."""

CLEAR = 8.0
"""Distances that differ by less than this multiple of the shortest stretch are not distinguished here."""

COLUMNS = 4
"""Cells examined before a ray is left to the complete search."""


@inlined
def quick_change(sheet: Packed, b: int, ray: CellRay, stage: int, event: Floats) -> bool:
    """Fill in the event of `first_change` and return True; False where `first_change` must decide."""
    faces, bodies, lat, rows = sheet.faces, sheet.bodies, sheet.lattice, sheet.rows
    array, i, j, x, y, z, L, M, N = ray
    if bodies[b, slot.QUICK] == 0.0 or array != int(bodies[b, slot.ENTRY]):
        return False
    if not N > max(faces[2 * b, slot.CLIMB], faces[2 * b + 1, slot.CLIMB]):
        return False
    if stage == ARRIVING and not z <= faces[2 * b, slot.LOW]:
        return False
    if not kept(lat, rows, i, j):
        return False
    clear = CLEAR * lat[slot.TINY]
    above = (bodies[b, slot.BODY_HIGH] - z) / N
    since, si, sj = 0.0, 0.0, 0.0
    for _ in range(COLUMNS):
        u, v = less_steps(lat, x, y, si, sj)
        border, ti, tj = _border(lat, u, v, L, M)
        if not border > since + clear:
            return False
        distance, sure = above, abs(above - border) > clear
        if stage != LEAVING:
            own = Ray(u, v, z, L, M, N)
            distance, sure = _crossing(faces, 2 * b + (stage == INSIDE), own, since, border, clear)
        if not sure:
            return False
        if distance < border:
            event[KIND] = FRONT if stage == ARRIVING else (BACK if stage == INSIDE else ABOVE)
            event[DISTANCE] = max(distance, 0.0) if stage == LEAVING else distance
            place = PLACE + 4 * array
            event[place], event[place + 1], event[place + 2], event[place + 3] = i + si, j + sj, u, v
            return True
        si, sj, since = si + ti, sj + tj, border
        if not kept(lat, rows, i + si, j + sj):
            return False
        u, v = less_steps(lat, x, y, si, sj)
        u, v, level = u + border * L, v + border * M, z + border * N
        front, back = height(faces, 2 * b, u, v), height(faces, 2 * b + 1, u, v)
        beyond = level - front if stage == INSIDE else front - level
        if stage == INSIDE:
            beyond = min(beyond, back - level)
        elif stage == LEAVING:
            beyond = level - back
        if not beyond > clear:
            return False
    return False


@inlined
def _border(lat: Floats, u: float, v: float, L: float, M: float) -> tuple[float, float, float]:
    """Distance to the first border that a ray in a cell meets, and the step (i, j) to the cell beyond."""
    border, ti, tj = inf, 0.0, 0.0
    for n in range(int(lat[slot.BORDERS])):
        ux, uy = lat[slot.NORMAL + 2 * n], lat[slot.NORMAL + 2 * n + 1]
        speed = ux * L + uy * M
        if speed == 0.0:
            continue
        t = (copysign(lat[slot.HALF + n], speed) - (ux * u + uy * v)) / speed
        if t < border:
            sense = copysign(1.0, speed)
            border, ti, tj = t, (sense, 0.0, -sense)[n], (0.0, sense, sense)[n]
    return border, ti, tj


@inlined
def _crossing(
    faces: Floats, row: int, ray: Ray, since: float, border: float, clear: float
) -> tuple[float, bool]:
    """Distance to a face between `since` and `border`, inf for none; and whether the answer is certain."""
    u, v, z, L, M, N = ray
    x, y, h = to_lens(faces, row, u - faces[row, slot.VX], v - faces[row, slot.VY], z - faces[row, slot.VZ])
    p, q, w = to_lens(faces, row, L, M, N)
    found = inf
    for t in lens_roots(faces, row, u, v, z, L, M, N):
        if t < since - clear or t > border + clear:
            continue
        gx, gy, gz, _ = upward(faces, row, x + t * p, y + t * q, h + t * w)
        if not to_sheet(faces, row, gx, gy, gz)[2] > 0.0 or not gz > 0.0:
            continue
        if t < since + clear or t > border - clear or found < inf:
            return inf, False
        found = t
    return found, True


@exact
def reach(lat: Floats, behind: Floats, x: float, y: float, u: float, v: float, i: float, j: float) -> float:
    """How far along the gap between the cells of two rows a ray gets before the honeycomb; see
    `clacad.tracing.reference.launch`.
    """
    u, v = less_steps(behind, u, v, -i, -j)
    first = inf
    for n in range(int(lat[slot.BORDERS])):
        ux, uy = lat[slot.NORMAL + 2 * n], lat[slot.NORMAL + 2 * n + 1]
        here, there = ux * x + uy * y, ux * u + uy * v
        free = lat[slot.HALF + n] - 0.5 * lat[slot.BAFFLE]
        last = behind[slot.HALF + n] - 0.5 * lat[slot.BAFFLE]
        if abs(here) > free:
            first = 0.0
        elif abs(there) > last:
            grows = (last - free) * copysign(1.0, there)
            first = min(first, (copysign(free, there) - here) / (there - here - grows))
    return 1.0 if (i != 0.0 or j != 0.0) and not isfinite(first) else first
