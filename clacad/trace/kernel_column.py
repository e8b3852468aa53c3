"""Compiled twin of `clacad.trace.column`: the first thing one ray meets in a body."""

from __future__ import annotations

from math import copysign, inf, isfinite, isnan, nan, sqrt

import numpy as np
from numpy.typing import NDArray

from clacad.trace import packing as slot
from clacad.trace.column import ABOVE, ASIDE, BACK, BACK_LAND, FRONT, FRONT_LAND, WALL
from clacad.trace.compiled import exact
from clacad.trace.kernel_scalar import height, in_zone, lens_roots, less_steps, relocate
from clacad.trace.layout import Floats

Ints = NDArray[np.int64]

KIND, DISTANCE, PLACE = 0, 1, 2
"""Slots of an event: what, how far, and from PLACE + 4·array on: cell i, j and the start seen from there."""

EVENT_NUMBERS = 13
DIVISIONS = 24
WORK_NUMBERS = 44


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
def box_span(lat: Floats, body: Floats, x: float, y: float, L: float, M: float) -> tuple[float, float]:
    """Distances at which a ray enters and leaves the box round the footprint, a cell wider on every side."""
    pad = 2.0 * lat[slot.REACH]
    enter, leave = -inf, inf
    for axis in range(2):
        at, speed = (x, L) if axis == 0 else (y, M)
        low, high = body[slot.BOX + 2 * axis] - pad, body[slot.BOX + 2 * axis + 1] + pad
        if speed == 0.0:
            if not low <= at <= high:
                return inf, -inf
            continue
        one, two = (low - at) / speed, (high - at) / speed
        if not (isfinite(one) and isfinite(two)):
            return inf, -inf
        enter, leave = max(enter, min(one, two)), min(leave, max(one, two))
    return enter, leave


@exact
def _lens_over(face: Floats, lat: Floats, rows: Ints, start: Floats, i: Floats, x: float, y: float) -> float:
    """Height of a face's lens at a step (x, y) from the start; NaN outside its zone and the kept cells."""
    if face[slot.ARRAY] < 0.0:
        return float(face[slot.VZ])
    at = int(face[slot.ARRAY])
    if not kept(lat, rows, i[2 * at], i[2 * at + 1]):
        return nan
    u, v = start[2 * at] + x, start[2 * at + 1] + y
    if lat[slot.MARGIN] > 0.0 and not in_zone(lat, u, v, lat[slot.MARGIN]):
        return nan
    return height(face, u, v)


@exact
def _proud(lens: float, land: float, front: bool) -> float:
    """The outermost of lens and land; what there is, if only one is."""
    if isnan(lens):
        return land
    if isnan(land):
        return lens
    return min(lens, land) if front else max(lens, land)


@exact
def in_footprint(body: Floats, x: float, y: float, over_cell: bool) -> bool:
    """Whether a sheet point lies over the body."""
    if body[slot.OUTLINE] == 0.0:
        return over_cell
    x, y = x - body[slot.MID_X], y - body[slot.MID_Y]
    if body[slot.OUTLINE] == 1.0:
        return bool(x * x + y * y <= body[slot.OUT_X] * body[slot.OUT_X])
    return bool(abs(x) <= body[slot.OUT_X] and abs(y) <= body[slot.OUT_Y])


@exact
def _solid(
    front: Floats, back: Floats, body: Floats, lat: Floats, rows: Ints, start: Floats, cell: Floats,
    sheet_x: float, sheet_y: float, z: float, x: float, y: float,
) -> bool:  # fmt: skip
    """Whether the point at height z, a step (x, y) from the start, lies in the material."""
    main = int(front[slot.ARRAY]) if front[slot.ARRAY] >= 0.0 else int(back[slot.ARRAY])
    if not in_footprint(body, sheet_x + x, sheet_y + y, kept(lat, rows, cell[2 * main], cell[2 * main + 1])):
        return False
    below, above = (
        _lens_over(front, lat, rows, start, cell, x, y),
        _lens_over(back, lat, rows, start, cell, x, y),
    )
    if body[slot.COLUMNAR] != 0.0 and not below <= above:
        return bool(front[slot.LAND] <= z <= back[slot.LAND])
    return _proud(below, front[slot.LAND], True) <= z <= _proud(above, back[slot.LAND], False)


@exact
def _divide(
    front: Floats, back: Floats, body: Floats, lat: Floats, start: Floats,
    sheet_x: float, sheet_y: float, z: float, L: float, M: float, N: float, times: Floats, causes: Ints,
) -> int:  # fmt: skip
    """Fill in the distances that divide the ray into stretches, and what each is; return their number."""
    count = 0
    for side in range(2):
        face = front if side == 0 else back
        lens = FRONT if side == 0 else BACK
        if face[slot.ARRAY] < 0.0:
            times[count], causes[count] = (face[slot.VZ] - z) / N, lens
            count += 1
        else:
            at = int(face[slot.ARRAY])
            one, two = lens_roots(face, start[2 * at], start[2 * at + 1], z, L, M, N)
            times[count], causes[count] = one, lens
            times[count + 1], causes[count + 1] = two, lens
            count += 2
        if not isnan(face[slot.LAND]):
            times[count], causes[count] = (face[slot.LAND] - z) / N, FRONT_LAND if side == 0 else BACK_LAND
            count += 1
    last = -1
    for side in range(2):
        at = int(front[slot.ARRAY]) if side == 0 else int(back[slot.ARRAY])
        if lat[slot.MARGIN] == 0.0 or at < 0 or at == last:
            continue
        last = at
        for n in range(int(lat[slot.BORDERS])):
            ux, uy = lat[slot.NORMAL + 2 * n], lat[slot.NORMAL + 2 * n + 1]
            here, speed = ux * start[2 * at] + uy * start[2 * at + 1], ux * L + uy * M
            edge = lat[slot.HALF + n] - lat[slot.MARGIN]
            times[count], causes[count] = (edge - here) / speed, WALL
            times[count + 1], causes[count + 1] = (-edge - here) / speed, WALL
            count += 2
    return divide_outline(body, sheet_x, sheet_y, L, M, times, causes, count)


@exact
def divide_outline(
    body: Floats, x: float, y: float, L: float, M: float, times: Floats, causes: Ints, count: int
) -> int:
    if body[slot.OUTLINE] == 0.0:
        return count
    x, y = x - body[slot.MID_X], y - body[slot.MID_Y]
    if body[slot.OUTLINE] == 2.0:
        times[count], times[count + 1] = (body[slot.OUT_X] - x) / L, (-body[slot.OUT_X] - x) / L
        times[count + 2], times[count + 3] = (body[slot.OUT_Y] - y) / M, (-body[slot.OUT_Y] - y) / M
        causes[count : count + 4] = WALL
        return count + 4
    a, b, c = L * L + M * M, x * L + y * M, x * x + y * y - body[slot.OUT_X] * body[slot.OUT_X]
    disc = b * b - a * c
    if not disc >= 0.0:
        return count
    q = -(b + copysign(sqrt(disc), b))
    times[count], times[count + 1] = c / q, q / a
    causes[count : count + 2] = WALL
    return count + 2


@exact
def jump(
    bodies: Floats, lat: Floats, b: int, array: int, i: float, j: float, x: float, y: float, z: float, L: float,
    M: float, N: float, now: float, home: Floats, step: Floats,
) -> float:  # fmt: skip
    """Skip the solid middle of a thick body; returns the distance to go on from, `now` if nothing is skipped.

    Between the front's highest and the back's lowest point there is nothing to meet but the side walls, and
    none between two points of the convex region inside the footprint. `step` is set to the cells over there.
    """
    body = bodies[b]
    low, high = (body[slot.JUMP_FROM] - z) / N, (body[slot.JUMP_TO] - z) / N
    if not (low <= now < high):
        return now
    sx, sy = sheet_xy(lat, array, i, j, x, y)
    for t in (now, high):
        u, v = sx + t * L - body[slot.MID_X], sy + t * M - body[slot.MID_Y]
        inside = abs(u) < body[slot.INNER_X] and abs(v) < body[slot.INNER_Y] and body[slot.INNER_R] > 0.0
        if not (inside and u * u + v * v < body[slot.INNER_R] * body[slot.INNER_R]):
            return now
    for at in range(2):
        p, q, _, _ = to_array(lat, array, at, i, j, x + high * L, y + high * M)
        step[2 * at], step[2 * at + 1] = p - home[2 * at], q - home[2 * at + 1]
    return float(high)


@exact
def first_change(
    faces: Floats, bodies: Floats, lat: Floats, rows: Ints, b: int, array: int, i: float, j: float,
    x: float, y: float, z: float, L: float, M: float, N: float, inside: bool, event: Floats, work: Floats, causes: Ints,
) -> None:  # fmt: skip
    """Find where a ray first enters the material of body b, or leaves it; see `column.first_change`.

    `work` (WORK_NUMBERS,) and `causes` (DIVISIONS,) are scratch. Writes `event` (EVENT_NUMBERS,): KIND, DISTANCE, and cell and start for each of the body's arrays.
    """
    front, back, body = faces[2 * b], faces[2 * b + 1], bodies[b]
    times, base, start = work[:DIVISIONS], work[24:28], work[28:32]
    home, cell, step = work[32:36], work[36:40], work[40:44]
    step[:] = 0.0
    for side in range(2):
        at = int(faces[2 * b + side, slot.ARRAY])
        if at < 0:
            continue
        if at == array:
            home[2 * at], home[2 * at + 1], base[2 * at], base[2 * at + 1] = i, j, x, y
        else:
            u, v, p, q = to_array(lat, array, at, i, j, x, y)
            home[2 * at], home[2 * at + 1], base[2 * at], base[2 * at + 1] = u, v, p, q
    sx, sy = sheet_xy(lat, array, i, j, x, y)
    aside = max(box_span(lat, body, sx, sy, L, M)[1], 0.0)
    above = inf if inside else (body[slot.BODY_HIGH] - z) / N
    limit = min(aside, above)
    since, cause, kind = 0.0, WALL, ASIDE
    walking = not above <= 0.0
    if not walking:
        kind = ABOVE
    while walking:
        border, across, across_array, sense = inf, 0, 0, 1.0
        for side in range(2):
            at = int(faces[2 * b + side, slot.ARRAY])
            if at < 0 or (side == 1 and at == int(front[slot.ARRAY])):
                continue
            cell[2 * at], cell[2 * at + 1] = home[2 * at] + step[2 * at], home[2 * at + 1] + step[2 * at + 1]
            u, v = less_steps(lat, base[2 * at], base[2 * at + 1], step[2 * at], step[2 * at + 1])
            start[2 * at], start[2 * at + 1] = u, v
            for n in range(int(lat[slot.BORDERS])):
                ux, uy = lat[slot.NORMAL + 2 * n], lat[slot.NORMAL + 2 * n + 1]
                speed = ux * L + uy * M
                if speed == 0.0:
                    continue
                t = (copysign(lat[slot.HALF + n], speed) - (ux * u + uy * v)) / speed
                if t < border:
                    border, across, across_array, sense = t, n, at, copysign(1.0, speed)
        end = min(border, limit)
        count = _divide(front, back, body, lat, start, sx, sy, z, L, M, N, times, causes)
        count = sort_divisions(times, causes, count, max(since - lat[slot.TINY], 0.0), since, end)
        changed = False
        for c in range(count + 1):
            to, why = (times[c], causes[c]) if c < count else (end, WALL)
            if to - since > lat[slot.TINY]:
                t = 0.5 * (since + to)
                now = _solid(
                    front, back, body, lat, rows, start, cell, sx, sy, z + t * N, t * L, t * M
                )  # fmt: skip
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
            t = jump(bodies, lat, b, array, i, j, x, y, z, L, M, N, end, home, step)
            if t > end:
                since, cause = t, WALL
                continue
        step_on(lat, across, sense, step[2 * across_array : 2 * across_array + 2])
    event[KIND], event[DISTANCE] = kind, since
    for at in range(2):
        place = PLACE + 4 * at
        event[place], event[place + 1] = home[2 * at] + step[2 * at], home[2 * at + 1] + step[2 * at + 1]
        u, v = less_steps(lat, base[2 * at], base[2 * at + 1], step[2 * at], step[2 * at + 1])
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
def step_on(lat: Floats, across: int, sense: float, step: Floats) -> None:
    """Move one column on."""
    if across == 0:
        step[0] += sense
    elif across == 1:
        step[1] += sense
    else:
        step[0] -= sense
        step[1] += sense
