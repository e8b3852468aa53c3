"""Compiled short cut of the walk: the next thing a steep ray meets in a body that is solid between its two
lens faces.

Over every kept cell such a body fills the space between front and back, with no land, seam or hole. A ray
steeper than both faces crosses each at most once in a column. At a border only its height against the next
cell's faces matters. Where a decision is within the rounding error, `column.first_change` decides.
"""

from __future__ import annotations

from math import copysign, inf

from clacad.base.compiled import inlined
from clacad.base.types import Floats
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.cells import kept, less_steps
from clacad.tracing.compiled.face import height, lens_roots, to_lens, to_sheet, upward
from clacad.tracing.compiled.packing import Packed
from clacad.tracing.compiled.records import DISTANCE, KIND, PLACE, CellRay, Ray
from clacad.tracing.reference.column import ABOVE, BACK, FRONT

ARRIVING, INSIDE, LEAVING = 0, 1, 2
"""State of a ray: below the front, between front and back, on or over the back."""

CLEAR = 8.0
"""Distances that differ by less than this multiple of the shortest stretch are not distinguished here."""

COLUMNS = 4
"""Cells examined before a ray is left to the complete search."""


@inlined
def quick_change(sheet: Packed, b: int, ray: CellRay, stage: int, event: Floats) -> bool:
    """Fill in the event that `first_change` would find and return True, or return False where `first_change`
    must decide.
    """
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
