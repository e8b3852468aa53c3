"""Compiled twin of `clacad.tracing.reference.column`: the first thing one ray meets in a body."""

from __future__ import annotations

from math import copysign, inf, isnan, nan, sqrt

from clacad.base.compiled import exact
from clacad.base.types import Floats, Ints
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.face import height, in_zone, lens_roots, less_steps, relocate
from clacad.tracing.reference.column import ABOVE, ASIDE, BACK, BACK_LAND, FRONT, FRONT_LAND, WALL

KIND, DISTANCE, PLACE = 0, 1, 2
"""Slots of an event: what, how far, and from PLACE + 4·array on: cell i, j and the start seen from there."""

EVENT_NUMBERS = 13
DIVISIONS = 24

# Places in a walk's scratch array; its first DIVISIONS numbers are distances.
BASE, START, HOME, CELL, STEP, WORK_NUMBERS = 24, 28, 32, 36, 40, 44


@exact
def kept(lat: Floats, rows: Ints, i: float, j: float) -> bool:
    """Whether the lattice has this cell; a plain one has no table of rows."""
    if lat[slot.PLAIN] != 0.0:
        return bool(0.0 <= i < lat[slot.N1] and 0.0 <= j < lat[slot.N2])
    if not (0.0 <= j < len(rows)):
        return False
    row = int(j)
    return bool(rows[row, 0] <= i < rows[row, 1])


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
        sign = 1.0 if array > of else -1.0
        x, y = x - sign * lat[slot.RESIDUAL], y - sign * lat[slot.RESIDUAL + 1]
        i, j = i - sign * lat[slot.WHOLE_STEPS], j - sign * lat[slot.WHOLE_STEPS + 1]
    di, dj, x, y = relocate(lat, x, y)
    return i + di, j + dj, x, y


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
        if isnan(one) or isnan(two):  # infinite is right: the box of a slope that is all but 0
            return inf, -inf
        enter, leave = max(enter, min(one, two)), min(leave, max(one, two))
    return enter, leave


@exact
def _lens_over(faces: Floats, row: int, lat: Floats, rows: Ints, work: Floats, x: float, y: float) -> float:
    """Height of a face's lens at a step (x, y) from the start; NaN outside its zone and the kept cells."""
    if faces[row, slot.ARRAY] < 0.0:
        return float(faces[row, slot.VZ])
    at = int(faces[row, slot.ARRAY])
    if not kept(lat, rows, work[CELL + 2 * at], work[CELL + 2 * at + 1]):
        return nan
    u, v = work[START + 2 * at] + x, work[START + 2 * at + 1] + y
    if lat[slot.MARGIN] > 0.0 and not in_zone(lat, u, v, lat[slot.MARGIN]):
        return nan
    return height(faces, row, u, v)


@exact
def _proud(lens: float, land: float, front: bool) -> float:
    """The outermost of lens and land; what there is, if only one is."""
    if isnan(lens):
        return land
    if isnan(land):
        return lens
    return min(lens, land) if front else max(lens, land)


@exact
def in_footprint(bodies: Floats, b: int, x: float, y: float, over_cell: bool) -> bool:
    """Whether a sheet point lies over the body."""
    if bodies[b, slot.OUTLINE] == 0.0:
        return over_cell
    x, y = x - bodies[b, slot.MID_X], y - bodies[b, slot.MID_Y]
    if bodies[b, slot.OUTLINE] == 1.0:
        return bool(x * x + y * y <= bodies[b, slot.OUT_X] * bodies[b, slot.OUT_X])
    return bool(abs(x) <= bodies[b, slot.OUT_X] and abs(y) <= bodies[b, slot.OUT_Y])


@exact
def _solid(
    faces: Floats, bodies: Floats, b: int, lat: Floats, rows: Ints, work: Floats, sheet_x: float, sheet_y: float,
    z: float, x: float, y: float,
) -> bool:  # fmt: skip
    """Whether the point at height z, a step (x, y) from the start, lies in the material."""
    main = int(bodies[b, slot.ENTRY])
    if not in_footprint(
        bodies, b, sheet_x + x, sheet_y + y, kept(lat, rows, work[CELL + 2 * main], work[CELL + 2 * main + 1])
    ):
        return False
    below, above = (
        _lens_over(faces, 2 * b, lat, rows, work, x, y),
        _lens_over(faces, 2 * b + 1, lat, rows, work, x, y),
    )
    if bodies[b, slot.COLUMNAR] != 0.0 and not below <= above:
        return bool(faces[2 * b, slot.LAND] <= z <= faces[2 * b + 1, slot.LAND])
    return (
        _proud(below, faces[2 * b, slot.LAND], True) <= z <= _proud(above, faces[2 * b + 1, slot.LAND], False)
    )


@exact
def _divide(
    faces: Floats, bodies: Floats, b: int, lat: Floats, sheet_x: float, sheet_y: float, z: float, L: float, M: float,
    N: float, work: Floats, causes: Ints,
) -> int:  # fmt: skip
    """Fill in the distances that divide the ray into stretches, and what each is; return their number."""
    count = 0
    for side in range(2):
        row = 2 * b + side
        lens = FRONT if side == 0 else BACK
        if faces[row, slot.ARRAY] < 0.0:
            work[count], causes[count] = (faces[row, slot.VZ] - z) / N, lens
            count += 1
        else:
            at = int(faces[row, slot.ARRAY])
            one, two = lens_roots(faces, row, work[START + 2 * at], work[START + 2 * at + 1], z, L, M, N)
            work[count], causes[count] = one, lens
            work[count + 1], causes[count + 1] = two, lens
            count += 2
        if not isnan(faces[row, slot.LAND]):
            work[count], causes[count] = (
                (faces[row, slot.LAND] - z) / N,
                FRONT_LAND if side == 0 else BACK_LAND,
            )
            count += 1
    last = -1
    for side in range(2):
        at = int(faces[2 * b + side, slot.ARRAY])
        if lat[slot.MARGIN] == 0.0 or at < 0 or at == last:
            continue
        last = at
        for n in range(int(lat[slot.BORDERS])):
            ux, uy = lat[slot.NORMAL + 2 * n], lat[slot.NORMAL + 2 * n + 1]
            here, speed = ux * work[START + 2 * at] + uy * work[START + 2 * at + 1], ux * L + uy * M
            edge = lat[slot.HALF + n] - lat[slot.MARGIN]
            work[count], causes[count] = (edge - here) / speed, WALL
            work[count + 1], causes[count + 1] = (-edge - here) / speed, WALL
            count += 2
    return divide_outline(bodies, b, sheet_x, sheet_y, L, M, work, causes, count)


@exact
def divide_outline(
    bodies: Floats, b: int, x: float, y: float, L: float, M: float, times: Floats, causes: Ints, count: int
) -> int:
    if bodies[b, slot.OUTLINE] == 0.0:
        return count
    x, y = x - bodies[b, slot.MID_X], y - bodies[b, slot.MID_Y]
    if bodies[b, slot.OUTLINE] == 2.0:
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
def jump(
    bodies: Floats, lat: Floats, b: int, array: int, i: float, j: float, x: float, y: float, z: float, L: float,
    M: float, N: float, now: float, work: Floats,
) -> float:  # fmt: skip
    """Skip the solid middle of a thick body; returns the distance to go on from, `now` if nothing is skipped.

    Between the front's highest and the back's lowest point there is nothing to meet but the side walls, and
    none between two points of the convex region inside the footprint. The steps are set to the cells over there.
    """
    low, high = (bodies[b, slot.JUMP_FROM] - z) / N, (bodies[b, slot.JUMP_TO] - z) / N
    if not (low <= now < high):
        return now
    sx, sy = sheet_xy(lat, array, i, j, x, y)
    for t in (now, high):
        u, v = sx + t * L - bodies[b, slot.MID_X], sy + t * M - bodies[b, slot.MID_Y]
        inside = (
            abs(u) < bodies[b, slot.INNER_X]
            and abs(v) < bodies[b, slot.INNER_Y]
            and bodies[b, slot.INNER_R] > 0.0
        )
        if not (inside and u * u + v * v < bodies[b, slot.INNER_R] * bodies[b, slot.INNER_R]):
            return now
    for at in range(2):
        p, q, _, _ = to_array(lat, array, at, i, j, x + high * L, y + high * M)
        work[STEP + 2 * at], work[STEP + 2 * at + 1] = p - work[HOME + 2 * at], q - work[HOME + 2 * at + 1]
    return float(high)


@exact
def first_change(
    faces: Floats, bodies: Floats, lat: Floats, rows: Ints, b: int, array: int, i: float, j: float,
    x: float, y: float, z: float, L: float, M: float, N: float, inside: bool, event: Floats, work: Floats, causes: Ints,
) -> None:  # fmt: skip
    """Find where a ray first enters the material of body b, or leaves it; see `reference.column.first_change`.

    `work` (WORK_NUMBERS,) and `causes` (DIVISIONS,) are scratch. Writes `event` (EVENT_NUMBERS,): KIND, DISTANCE, and cell and start for each of the body's arrays.
    """
    for k in range(4):
        work[STEP + k] = 0.0
    for side in range(2):
        at = int(faces[2 * b + side, slot.ARRAY])
        if at < 0:
            continue
        if at == array:
            work[HOME + 2 * at], work[HOME + 2 * at + 1], work[BASE + 2 * at], work[BASE + 2 * at + 1] = (
                i,
                j,
                x,
                y,
            )
        else:
            u, v, p, q = to_array(lat, array, at, i, j, x, y)
            work[HOME + 2 * at], work[HOME + 2 * at + 1], work[BASE + 2 * at], work[BASE + 2 * at + 1] = (
                u,
                v,
                p,
                q,
            )
    sx, sy = sheet_xy(lat, array, i, j, x, y)
    aside = max(box_span(lat, bodies, b, sx, sy, L, M)[1], 0.0)
    above = inf if inside else (bodies[b, slot.BODY_HIGH] - z) / N
    limit = min(aside, above)
    since, cause, kind = 0.0, WALL, ASIDE
    walking = not above <= 0.0
    if not walking:
        kind = ABOVE
    while walking:
        border, across, across_array, sense = inf, 0, 0, 1.0
        for side in range(2):
            at = int(faces[2 * b + side, slot.ARRAY])
            if at < 0 or (side == 1 and at == int(faces[2 * b, slot.ARRAY])):
                continue
            work[CELL + 2 * at], work[CELL + 2 * at + 1] = (
                work[HOME + 2 * at] + work[STEP + 2 * at],
                work[HOME + 2 * at + 1] + work[STEP + 2 * at + 1],
            )
            u, v = less_steps(
                lat,
                work[BASE + 2 * at],
                work[BASE + 2 * at + 1],
                work[STEP + 2 * at],
                work[STEP + 2 * at + 1],
            )
            work[START + 2 * at], work[START + 2 * at + 1] = u, v
            for n in range(int(lat[slot.BORDERS])):
                ux, uy = lat[slot.NORMAL + 2 * n], lat[slot.NORMAL + 2 * n + 1]
                speed = ux * L + uy * M
                if speed == 0.0:
                    continue
                t = (copysign(lat[slot.HALF + n], speed) - (ux * u + uy * v)) / speed
                if t < border:
                    border, across, across_array, sense = t, n, at, copysign(1.0, speed)
        end = min(border, limit)
        count = _divide(faces, bodies, b, lat, sx, sy, z, L, M, N, work, causes)
        count = sort_divisions(work, causes, count, max(since - lat[slot.TINY], 0.0), since, end)
        changed = False
        for c in range(count + 1):
            to, why = (work[c], causes[c]) if c < count else (end, WALL)
            if to - since > lat[slot.TINY]:
                t = 0.5 * (since + to)
                now = _solid(faces, bodies, b, lat, rows, work, sx, sy, z + t * N, t * L, t * M)  # fmt: skip
                if now != inside:
                    changed = True
                    break
                since, cause = to, why
            elif c < count and why != WALL:
                cause = why
        if changed:
            kind = cause
            break
        if above <= end:
            kind, since = ABOVE, above
            break
        if aside <= end:
            kind, since = ASIDE, aside
            break
        if inside:
            t = jump(bodies, lat, b, array, i, j, x, y, z, L, M, N, end, work)
            if t > end:
                since, cause = t, WALL
                continue
        step_on(across, sense, work, STEP + 2 * across_array)
    event[KIND], event[DISTANCE] = kind, since
    for at in range(2):
        place = PLACE + 4 * at
        event[place], event[place + 1] = (
            work[HOME + 2 * at] + work[STEP + 2 * at],
            work[HOME + 2 * at + 1] + work[STEP + 2 * at + 1],
        )
        u, v = less_steps(
            lat, work[BASE + 2 * at], work[BASE + 2 * at + 1], work[STEP + 2 * at], work[STEP + 2 * at + 1]
        )
        event[place + 2], event[place + 3] = u, v


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
