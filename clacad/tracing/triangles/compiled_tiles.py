"""Compiled tracing of facets: the lookup and the walk from facet to facet."""

from __future__ import annotations

from math import copysign, inf, nan

from clacad.base.compiled import exact
from clacad.base.types import Floats, Ints
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.column import (
    BASE,
    CELL,
    DISTANCE,
    HOME,
    KIND,
    PLACE,
    START,
    STEP,
    box_span,
    divide_outline,
    in_footprint,
    jump,
    kept,
    sheet_xy,
    sort_divisions,
    step_on,
    to_array,
)
from clacad.tracing.compiled.face import less_steps
from clacad.tracing.reference.column import ABOVE, ASIDE, BACK, BACK_LAND, FRONT, FRONT_LAND, WALL
from clacad.tracing.triangles.tiles import (
    BIN,
    BINS_X,
    BINS_Y,
    LAND,
    LENS,
    LOW_X,
    LOW_Y,
    PER_X,
    PER_Y,
    VOID,
    Tiles,
)

NORMAL = PLACE + 8
"""Slot of an event where a facet's normal is kept."""

FACET = 20
"""Place in the integer scratch where the present facets of arrays 0 and 1 are kept."""


@exact
def locate_facet(tiles: Tiles, tile: int, x: float, y: float) -> int:
    """Facet over a point of the cell frame: the one the point lies deepest in; −1 far outside the tile."""
    row = tiles.table[tile]
    i = min(max(int((x - row[LOW_X]) * row[PER_X]), 0), int(row[BINS_X]) - 1)
    j = min(max(int((y - row[LOW_Y]) * row[PER_Y]), 0), int(row[BINS_Y]) - 1)
    b = int(row[BIN]) + j * int(row[BINS_X]) + i
    best, deepest = -1, -inf
    for k in range(tiles.start[b], tiles.start[b + 1]):
        f = tiles.member[k]
        w = tiles.weight[f]
        inside = min(
            w[0, 0] * x + w[0, 1] * y + w[0, 2],
            min(w[1, 0] * x + w[1, 1] * y + w[1, 2], w[2, 0] * x + w[2, 1] * y + w[2, 2]),
        )
        if inside > deepest:
            best, deepest = f, inside
            if inside > 0.0:
                break
    return best


@exact
def facet_normal(tiles: Tiles, facet: int, side: int, x: float, y: float) -> tuple[float, float, float]:
    """Normal towards +z: the facet's, or that of its corners interpolated at a point."""
    if len(tiles.normal) == 0 or tiles.part[facet, side] != LENS:
        return -tiles.plane[facet, side, 0], -tiles.plane[facet, side, 1], 1.0
    gx, gy, gz = 0.0, 0.0, 0.0
    for k in range(3):
        w = tiles.weight[facet, k]
        share = w[0] * x + w[1] * y + w[2]
        n = tiles.normal[facet, side, k]
        gx, gy, gz = gx + share * n[0], gy + share * n[1], gz + share * n[2]
    return gx, gy, gz


# -- the walk ----------------------------------------------------------------------------------


@exact
def _levels(
    tiles: Tiles, faces: Floats, row: int, at: int, causes: Ints, work: Floats, dx: float, dy: float
) -> tuple[float, float]:  # fmt: skip
    """Height of a face at the start and its rise along the ray, over the column the ray is in; NaN for none."""
    if faces[row, slot.ARRAY] < 0.0:
        return faces[row, slot.LOW], 0.0
    f = causes[FACET + at]
    if f < 0:
        return faces[row, slot.LAND], 0.0
    side = row % 2
    if tiles.part[f, side] == VOID:
        return nan, 0.0
    a, b, c = tiles.plane[f, side, 0], tiles.plane[f, side, 1], tiles.plane[f, side, 2]
    return a * work[START + 2 * at] + b * work[START + 2 * at + 1] + c, a * dx + b * dy


@exact
def first_facet_change(
    tiles: Tiles, faces: Floats, bodies: Floats, lat: Floats, rows: Ints, b: int, array: int, i: float, j: float,
    x: float, y: float, z: float, L: float, M: float, N: float, inside: bool, event: Floats, work: Floats,
    causes: Ints,
) -> None:  # fmt: skip
    """Find where a ray first enters the facets of body b, or leaves them: `reference.column.first_change` for facets.

    A piece is what lies over one facet of each of the body's tilings; in it both faces are planes.
    """
    for k in range(4):
        work[STEP + k] = 0.0
    main = int(bodies[b, slot.ENTRY])
    for side in range(2):
        at = int(faces[2 * b + side, slot.ARRAY])
        if at < 0 or (side == 1 and at == int(faces[2 * b, slot.ARRAY])):
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
        causes[FACET + at] = -2  # not looked up
    sx, sy = sheet_xy(lat, array, i, j, x, y)
    aside = max(box_span(lat, bodies, b, sx, sy, L, M)[1], 0.0)
    above = inf if inside else (bodies[b, slot.BODY_HIGH] - z) / N
    limit = min(aside, above)
    since, cause, kind = 0.0, WALL, ASIDE
    gx, gy, gz = 0.0, 0.0, 1.0
    walking = not above <= 0.0
    if not walking:
        kind = ABOVE
    entered = 0.0  # where the piece begins
    while walking:
        end, across, across_array, sense, edge, edge_array = limit, -1, -1, 1.0, -1, -1
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
            tile = tiles.of[b, side]
            if causes[FACET + at] == -2:
                causes[FACET + at] = -1
                if kept(lat, rows, work[CELL + 2 * at], work[CELL + 2 * at + 1]):
                    # a hair into the piece, so that a ray along an edge is in the facet it goes to
                    t = entered + 2.0 * lat[slot.TINY]
                    causes[FACET + at] = locate_facet(tiles, tile, u + t * L, v + t * M)
            for n in range(int(lat[slot.BORDERS])):
                ux, uy = lat[slot.NORMAL + 2 * n], lat[slot.NORMAL + 2 * n + 1]
                speed = ux * L + uy * M
                if speed == 0.0:
                    continue
                t = (copysign(lat[slot.HALF + n], speed) - (ux * u + uy * v)) / speed
                if t < end:
                    end, across, across_array, sense, edge = t, n, at, copysign(1.0, speed), -1
            f = causes[FACET + at]
            if f < 0:
                continue
            for n in range(3):
                wx, wy = tiles.weight[f, n, 0], tiles.weight[f, n, 1]
                speed = wx * L + wy * M
                if speed >= 0.0 or tiles.beside[f, n] < 0:
                    continue
                t = -(wx * u + wy * v + tiles.weight[f, n, 2]) / speed
                if t < end:
                    end, across, edge, edge_array = t, -1, n, at
        front_at = int(faces[2 * b, slot.ARRAY]) if faces[2 * b, slot.ARRAY] >= 0.0 else main
        back_at = int(faces[2 * b + 1, slot.ARRAY]) if faces[2 * b + 1, slot.ARRAY] >= 0.0 else main
        low, low_rise = _levels(tiles, faces, 2 * b, front_at, causes, work, L, M)
        high, high_rise = _levels(tiles, faces, 2 * b + 1, back_at, causes, work, L, M)
        work[0], causes[0] = (low - z) / (N - low_rise), _kind(tiles, faces, 2 * b, causes[FACET + front_at])
        work[1], causes[1] = (
            (high - z) / (N - high_rise),
            _kind(tiles, faces, 2 * b + 1, causes[FACET + back_at]),
        )
        count = 2
        if causes[FACET + main] < 0:
            count = divide_outline(bodies, b, sx, sy, L, M, work, causes, count)
        end = max(end, entered)
        count = sort_divisions(work, causes, count, max(entered, since - lat[slot.TINY]), since, end)
        changed = False
        for c in range(count + 1):
            to, why = (work[c], causes[c]) if c < count else (end, WALL)
            if to - since > lat[slot.TINY]:
                t = 0.5 * (since + to)
                level = z + t * N
                over = in_footprint(
                    bodies, b, sx + t * L, sy + t * M, kept(lat, rows, work[CELL + 2 * main], work[CELL + 2 * main + 1])
                )  # fmt: skip
                now = over and low + t * low_rise <= level <= high + t * high_rise
                if now != inside:
                    changed = True
                    break
                since, cause = to, why
            elif c < count and why != WALL:
                cause = why
        if changed:
            kind = cause
            f = causes[FACET + front_at] if kind == FRONT else causes[FACET + back_at]
            if (kind == FRONT or kind == BACK) and f >= 0:
                at = front_at if kind == FRONT else back_at
                gx, gy, gz = facet_normal(
                    tiles, f, 0 if kind == FRONT else 1, work[START + 2 * at] + since * L, work[START + 2 * at + 1] + since * M
                )  # fmt: skip
            break
        if above <= end:
            kind, since = ABOVE, above
            break
        if aside <= end:
            kind, since = ASIDE, aside
            break
        entered = end
        if inside:
            t = jump(bodies, lat, b, array, i, j, x, y, z, L, M, N, entered, work)
            if t > entered:
                entered, since, cause = t, t, WALL
                causes[FACET + 0], causes[FACET + 1] = -2, -2
                continue
        if across >= 0:
            step_on(across, sense, work, STEP + 2 * across_array)
            causes[FACET + across_array] = -2
        elif edge >= 0:
            causes[FACET + edge_array] = tiles.beside[causes[FACET + edge_array], edge]
        else:
            break
    event[KIND], event[DISTANCE] = kind, since
    event[NORMAL], event[NORMAL + 1], event[NORMAL + 2] = gx, gy, gz
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
def _kind(tiles: Tiles, faces: Floats, row: int, facet: int) -> int:
    """Which crossing a face's plane is over a facet: of a lens or plane face, or of land."""
    side = row % 2
    if faces[row, slot.ARRAY] < 0.0:
        return FRONT if side == 0 else BACK
    land = facet < 0 or tiles.part[facet, side] == LAND
    if side == 0:
        return FRONT_LAND if land else FRONT
    return BACK_LAND if land else BACK
