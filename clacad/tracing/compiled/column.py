"""Compiled twin of `clacad.tracing.reference.column`: the first thing one ray meets in a body."""

from __future__ import annotations

from math import copysign, inf, isnan, nan, sqrt

from clacad.base.compiled import exact, inlined
from clacad.base.types import Floats, Ints
from clacad.optics.ledger import ABOVE, ASIDE, BACK, BACK_LAND, FRONT, FRONT_LAND, WALL
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.array_cells import (
    in_plate,
    into_array,
    lens_crossings,
    lens_height,
    next_edge,
)
from clacad.tracing.compiled.cells import in_zone, kept, less_steps, sheet_xy
from clacad.tracing.compiled.packing import Packed
from clacad.tracing.compiled.records import (
    BASE,
    CELL,
    DISTANCE,
    HOME,
    KIND,
    MOST_ARRAYS,
    PLACE,
    START,
    STEP,
    CellRay,
    Ray,
)


@exact
def box_span(
    lat: Floats, bodies: Floats, b: int, x: float, y: float, L: float, M: float
) -> tuple[float, float]:
    """Distances at which a ray enters and leaves the box round the footprint, a cell wider on every side."""
    pad = 2.0 * lat[slot.REACH]
    enter, leave = -inf, inf
    for axis in range(2):
        at, speed = (x, L) if axis == 0 else (y, M)
        low, high = bodies[b, slot.BOX + 2 * axis] - pad, bodies[b, slot.BOX + 2 * axis + 1] + pad
        if speed == 0.0:
            if not low <= at <= high:
                return inf, -inf
            continue
        one, two = (low - at) / speed, (high - at) / speed
        if isnan(one) or isnan(two):  # infinite is right: the box of a slope that is nearly 0
            return inf, -inf
        enter, leave = max(enter, min(one, two)), min(leave, max(one, two))
    return enter, leave


@exact
def _lens_over(sheet: Packed, row: int, work: Floats, x: float, y: float) -> float:
    """Height of a face's lens at a step (x, y) from the start; NaN outside its zone and the kept cells."""
    faces, lat = sheet.faces, sheet.lattice
    if faces[row, slot.ARRAY] < 0.0:
        return float(faces[row, slot.VZ])
    at = int(faces[row, slot.ARRAY])
    if not kept(lat, sheet.rows, work[CELL + 2 * at], work[CELL + 2 * at + 1]):
        return nan
    u, v = work[START + 2 * at] + x, work[START + 2 * at + 1] + y
    if lat[slot.MARGIN] > 0.0 and not in_zone(sheet.lattices[at], u, v, lat[slot.MARGIN]):
        return nan
    return lens_height(sheet, sheet.own, row, (work[CELL + 2 * at], work[CELL + 2 * at + 1]), u, v)


@exact
def _proud(lens: float, face: Floats) -> float:
    """The outermost of lens and land; the one that exists, if only one does."""
    land = float(face[slot.LAND])
    if isnan(lens):
        return land
    if isnan(land):
        return lens
    return min(lens, land) if face[slot.LAND_SIDE] > 0.0 else max(lens, land)


@exact
def in_footprint(sheet: Packed, b: int, x: float, y: float, over_cell: bool) -> bool:
    """Whether a sheet point lies over the body."""
    bodies = sheet.bodies
    if bodies[b, slot.OUTLINE] == slot.NO_OUTLINE:
        return over_cell
    if bodies[b, slot.OUTLINE] == slot.PLATE:
        return in_plate(sheet.edges, x, y)
    x, y = x - bodies[b, slot.MID_X], y - bodies[b, slot.MID_Y]
    if bodies[b, slot.OUTLINE] == slot.CIRCLE:
        return bool(x * x + y * y <= bodies[b, slot.OUT_X] * bodies[b, slot.OUT_X])
    return bool(abs(x) <= bodies[b, slot.OUT_X] and abs(y) <= bodies[b, slot.OUT_Y])


@exact
def well_inside(bodies: Floats, b: int, x: float, y: float) -> bool:
    """Whether a sheet point lies in the convex region that is certainly over the body."""
    u, v, radius = x - bodies[b, slot.MID_X], y - bodies[b, slot.MID_Y], bodies[b, slot.INNER_R]
    inside = abs(u) < bodies[b, slot.INNER_X] and abs(v) < bodies[b, slot.INNER_Y] and radius > 0.0
    return bool(inside and u * u + v * v < radius * radius)


@exact
def _solid(sheet: Packed, b: int, ray: Ray, t: float, work: Floats) -> bool:
    """Whether the point a distance t along a ray of the sheet's frame lies in the material."""
    faces, bodies = sheet.faces, sheet.bodies
    z, x, y = ray.z + t * ray.N, t * ray.L, t * ray.M
    main = int(bodies[b, slot.ENTRY])
    over = kept(sheet.lattice, sheet.rows, work[CELL + 2 * main], work[CELL + 2 * main + 1])
    if not in_footprint(sheet, b, ray.x + x, ray.y + y, over):
        return False
    below, above = _lens_over(sheet, 2 * b, work, x, y), _lens_over(sheet, 2 * b + 1, work, x, y)
    if bodies[b, slot.COLUMNAR] != 0.0 and not below <= above:
        return bool(faces[2 * b, slot.LAND] <= z <= faces[2 * b + 1, slot.LAND])
    return bool(_proud(below, faces[2 * b]) <= z <= _proud(above, faces[2 * b + 1]))


@exact
def _divide(sheet: Packed, b: int, ray: Ray, work: Floats, causes: Ints) -> int:
    """Distances that divide the ray (sheet frame) into stretches, with their causes; return their number."""
    faces, lat = sheet.faces, sheet.lattice
    sheet_x, sheet_y, z, L, M, N = ray
    count = 0
    for side in range(2):
        row = 2 * b + side
        lens = FRONT if side == 0 else BACK
        if faces[row, slot.ARRAY] < 0.0:
            work[count], causes[count] = (faces[row, slot.VZ] - z) / N, lens
            count += 1
        else:
            at = int(faces[row, slot.ARRAY])
            own = Ray(work[START + 2 * at], work[START + 2 * at + 1], z, L, M, N)
            one, two = lens_crossings(
                sheet, sheet.own, row, (work[CELL + 2 * at], work[CELL + 2 * at + 1]), own
            )
            work[count], causes[count] = one, lens
            work[count + 1], causes[count + 1] = two, lens
            count += 2
        if not isnan(faces[row, slot.LAND]):
            land = FRONT_LAND if side == 0 else BACK_LAND
            work[count], causes[count] = (faces[row, slot.LAND] - z) / N, land
            count += 1
    for k in range(2):
        at = int(sheet.bodies[b, slot.CELLS + k])
        if lat[slot.MARGIN] == 0.0 or at < 0:
            continue
        for n in range(int(lat[slot.BORDERS])):
            ux, uy = lat[slot.NORMAL + 2 * n], lat[slot.NORMAL + 2 * n + 1]
            here, speed = ux * work[START + 2 * at] + uy * work[START + 2 * at + 1], ux * L + uy * M
            edge = sheet.lattices[at][slot.HALF + n] - lat[slot.MARGIN]
            work[count], causes[count] = (edge - here) / speed, WALL
            work[count + 1], causes[count + 1] = (-edge - here) / speed, WALL
            count += 2
    return divide_outline(sheet.bodies, b, ray, work, causes, count)


@exact
def divide_outline(bodies: Floats, b: int, ray: Ray, times: Floats, causes: Ints, count: int) -> int:
    """Add the distances at which a ray of the sheet's frame crosses the outline; return the total number."""
    if bodies[b, slot.OUTLINE] == slot.NO_OUTLINE or bodies[b, slot.OUTLINE] == slot.PLATE:
        return count
    x, y, _, L, M, _ = ray
    x, y = x - bodies[b, slot.MID_X], y - bodies[b, slot.MID_Y]
    if bodies[b, slot.OUTLINE] == slot.RECTANGLE:
        times[count], times[count + 1] = (bodies[b, slot.OUT_X] - x) / L, (-bodies[b, slot.OUT_X] - x) / L
        times[count + 2], times[count + 3] = (bodies[b, slot.OUT_Y] - y) / M, (-bodies[b, slot.OUT_Y] - y) / M
        for k in range(4):
            causes[count + k] = WALL
        return count + 4
    outer = bodies[b, slot.OUT_X]
    square, half, rest = L * L + M * M, x * L + y * M, x * x + y * y - outer * outer
    disc = half * half - square * rest
    if not disc >= 0.0:
        return count
    q = -(half + copysign(sqrt(disc), half))
    times[count], times[count + 1] = rest / q, q / square
    causes[count], causes[count + 1] = WALL, WALL
    return count + 2


@exact
def edge_ahead(sheet: Packed, b: int, ray: Ray, since: float) -> float:
    """Distance at which a ray (sheet frame) next crosses an edge of body b's plate; inf without a plate."""
    if sheet.bodies[b, slot.OUTLINE] != slot.PLATE:
        return inf
    return next_edge(sheet.edges, ray.x, ray.y, ray.L, ray.M, since + sheet.lattice[slot.TINY])


@exact
def jump(sheet: Packed, b: int, ray: CellRay, now: float, work: Floats) -> float:
    """Skip the solid middle of a thick body; returns the distance to go on from, `now` if nothing is skipped.

    Between the front's highest and the back's lowest point only the side walls can be met. Between two points
    of the convex region inside the footprint there are none. The steps are set to the cells at the new
    position.
    """
    bodies = sheet.bodies
    array, i, j, x, y, z, L, M, N = ray
    low, high = (bodies[b, slot.JUMP_FROM] - z) / N, (bodies[b, slot.JUMP_TO] - z) / N
    if not (low <= now < high):
        return now
    sx, sy = sheet_xy(sheet.lattices[array], array, i, j, x, y)
    for t in (now, high):
        if not well_inside(bodies, b, sx + t * L, sy + t * M):
            return now
    for k in range(2):
        at = int(bodies[b, slot.CELLS + k])
        if at < 0:
            continue
        p, q, _, _ = into_array(sheet, sheet.own, array, at, i, j, x + high * L, y + high * M)
        work[STEP + 2 * at], work[STEP + 2 * at + 1] = p - work[HOME + 2 * at], q - work[HOME + 2 * at + 1]
    return float(high)


@inlined
def start_search(sheet: Packed, b: int, ray: CellRay, work: Floats) -> None:
    """Record the cell and the start of a ray in each of the arrays of body b."""
    array, i, j, x, y, _, _, _, _ = ray
    for k in range(2 * MOST_ARRAYS):
        work[STEP + k] = 0.0
    for k in range(2):
        at = int(sheet.bodies[b, slot.CELLS + k])
        if at < 0:
            continue
        u, v, p, q = i, j, x, y
        if at != array:
            u, v, p, q = into_array(sheet, sheet.own, array, at, i, j, x, y)
        work[HOME + 2 * at], work[HOME + 2 * at + 1] = u, v
        work[BASE + 2 * at], work[BASE + 2 * at + 1] = p, q


@inlined
def enter_cell(lat: Floats, at: int, work: Floats) -> tuple[float, float]:
    """Record the present cell of array `at`, and return the start seen from there."""
    work[CELL + 2 * at] = work[HOME + 2 * at] + work[STEP + 2 * at]
    work[CELL + 2 * at + 1] = work[HOME + 2 * at + 1] + work[STEP + 2 * at + 1]
    u, v = less_steps(
        lat, work[BASE + 2 * at], work[BASE + 2 * at + 1], work[STEP + 2 * at], work[STEP + 2 * at + 1]
    )
    work[START + 2 * at], work[START + 2 * at + 1] = u, v
    return u, v


@inlined
def _next_border(sheet: Packed, b: int, ray: Ray, work: Floats) -> tuple[float, int, int, float]:
    """Enter the present cells; distance to their first border, which border, of which array, and sense."""
    border, across, across_array, sense = inf, 0, 0, 1.0
    for k in range(2):
        at = int(sheet.bodies[b, slot.CELLS + k])
        if at < 0:
            continue
        u, v = enter_cell(sheet.lattices[at], at, work)
        t, n, towards = border_ahead(sheet.lattices[at], ray, u, v, border)
        if n >= 0:
            border, across, across_array, sense = t, n, at, towards
    return border, across, across_array, sense


@inlined
def border_ahead(lat: Floats, ray: Ray, u: float, v: float, before: float) -> tuple[float, int, float]:
    """First border of a cell that a ray at (u, v) crosses before a distance: distance, which border, sense.

    The border is −1 where there is none.
    """
    across, sense = -1, 1.0
    for n in range(int(lat[slot.BORDERS])):
        ux, uy = lat[slot.NORMAL + 2 * n], lat[slot.NORMAL + 2 * n + 1]
        speed = ux * ray.L + uy * ray.M
        if speed == 0.0:
            continue
        t = (copysign(lat[slot.HALF + n], speed) - (ux * u + uy * v)) / speed
        if t < before:
            before, across, sense = t, n, copysign(1.0, speed)
    return before, across, sense


@inlined
def _first_stretch(
    sheet: Packed,
    b: int,
    ray: Ray,
    inside: bool,
    span: tuple[float, float, int],
    count: int,
    work: Floats,
    causes: Ints,
) -> tuple[bool, float, int]:
    """Find the first stretch of a column whose state differs from the ray's.

    span : since when the state is known, where the column ends, and why the state began
    Returns whether there is one, its start (else that of the last), and what is crossed there.
    """
    since, end, cause = span
    for c in range(count + 1):
        to, why = (work[c], causes[c]) if c < count else (end, WALL)
        if to - since > sheet.lattice[slot.TINY]:
            if _solid(sheet, b, ray, 0.5 * (since + to), work) != inside:
                return True, since, cause
            since, cause = to, why
        elif c < count and why != WALL:
            cause = why
    return False, since, cause


@inlined
def write_event(sheet: Packed, kind: int, distance: float, work: Floats, event: Floats) -> None:
    """Write what was met, how far, and cell and start for each array."""
    event[KIND], event[DISTANCE] = kind, distance
    for at in range(MOST_ARRAYS):
        place = PLACE + 4 * at
        event[place] = work[HOME + 2 * at] + work[STEP + 2 * at]
        event[place + 1] = work[HOME + 2 * at + 1] + work[STEP + 2 * at + 1]
        event[place + 2], event[place + 3] = less_steps(
            sheet.lattices[at],
            work[BASE + 2 * at],
            work[BASE + 2 * at + 1],
            work[STEP + 2 * at],
            work[STEP + 2 * at + 1],
        )


@inlined
def ends_of_body(sheet: Packed, b: int, ray: CellRay, inside: bool) -> tuple[Ray, float, float]:
    """Ray in the sheet's frame; distances to above body b (inf inside the material) and out of its box."""
    array, i, j, x, y, z, L, M, N = ray
    sx, sy = sheet_xy(sheet.lattices[array], array, i, j, x, y)
    aside = max(box_span(sheet.lattice, sheet.bodies, b, sx, sy, L, M)[1], 0.0)
    above = inf if inside else (sheet.bodies[b, slot.BODY_HIGH] - z) / N
    return Ray(sx, sy, z, L, M, N), above, aside


@exact
def first_change(
    sheet: Packed, b: int, ray: CellRay, inside: bool, event: Floats, work: Floats, causes: Ints
) -> None:
    """Find where a ray first enters the material of body b, or leaves it; see
    `reference.column.first_change`.

    `work` (WORK_NUMBERS,) and `causes` (DIVISIONS,) are scratch. Writes `event` (EVENT_NUMBERS,): what, the
    distance, and the cell and start for each of the body's arrays.
    """
    lat = sheet.lattice
    start_search(sheet, b, ray, work)
    along, above, aside = ends_of_body(sheet, b, ray, inside)
    limit = min(aside, above)
    since, cause, kind = 0.0, WALL, ASIDE
    walking = not above <= 0.0
    if not walking:
        kind = ABOVE
    while walking:
        border, across, across_array, sense = _next_border(sheet, b, along, work)
        edge = edge_ahead(sheet, b, along, since)
        if edge < border:  # it ends a piece too, but leads to no other column
            border, across = edge, -1
        end = min(border, limit)
        count = _divide(sheet, b, along, work, causes)
        count = sort_divisions(work, causes, count, max(since - lat[slot.TINY], 0.0), since, end)
        changed, since, cause = _first_stretch(
            sheet, b, along, inside, (since, end, cause), count, work, causes
        )
        if changed:
            kind = cause
            break
        if limit <= end:
            kind, since = (ABOVE, above) if above <= end else (ASIDE, aside)
            break
        if inside:
            t = jump(sheet, b, ray, end, work)
            if t > end:
                since, cause = t, WALL
                continue
        if across >= 0:
            step_on(across, sense, work, STEP + 2 * across_array)
    write_event(sheet, kind, since, work, event)


@exact
def sort_divisions(times: Floats, causes: Ints, count: int, earliest: float, since: float, end: float) -> int:
    """Keep the divisions of this column, in order; return their number."""
    number = 0
    for c in range(count):
        t, why = times[c], causes[c]
        if not (t >= earliest and t < end):
            continue
        t = max(t, since)
        k = number
        while k > 0 and times[k - 1] > t:
            times[k], causes[k] = times[k - 1], causes[k - 1]
            k -= 1
        times[k], causes[k] = t, why
        number += 1
    return number


@exact
def step_on(across: int, sense: float, work: Floats, at: int) -> None:
    """Move one column on: the steps are kept in work[at], work[at + 1]."""
    if across == 0:
        work[at] += sense
    elif across == 1:
        work[at + 1] += sense
    else:
        work[at] -= sense
        work[at + 1] += sense
