"""Compiled tracing of facets: the lookup and the walk from facet to facet."""

from __future__ import annotations

from math import inf, nan

from clacad.base.compiled import exact, inlined
from clacad.base.types import Floats, Ints
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.cells import kept
from clacad.tracing.compiled.column import (
    border_ahead,
    divide_outline,
    edge_ahead,
    ends_of_body,
    enter_cell,
    in_footprint,
    jump,
    sort_divisions,
    start_search,
    step_on,
    write_event,
)
from clacad.tracing.compiled.packing import Packed
from clacad.tracing.compiled.records import (
    CELL,
    FACET,
    FACET_NORMAL,
    MOST_ARRAYS,
    START,
    STEP,
    CellRay,
    Ray,
    Vector,
)
from clacad.tracing.facets.tiles import (
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
from clacad.tracing.ledger import ABOVE, ASIDE, BACK, BACK_LAND, FRONT, FRONT_LAND, WALL

NOT_LOOKED_UP, NONE = -2, -1
"""State of the facet that an array is in: not yet looked up; none exists."""

NO_STEP = -2
"""In place of a crossed border: an edge of the plate, which leads to no other cell."""


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
) -> tuple[float, float]:
    """Height of a face at the start and its rise along the ray, in the ray's present column; NaN for none."""
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
def _kind(tiles: Tiles, faces: Floats, row: int, facet: int) -> int:
    """Kind of crossing of a face's plane over a facet: of a lens or plane face, or of land."""
    side = row % 2
    if faces[row, slot.ARRAY] < 0.0:
        return FRONT if side == 0 else BACK
    land = facet < 0 or tiles.part[facet, side] == LAND
    if side == 0:
        return FRONT_LAND if land else FRONT
    return BACK_LAND if land else BACK


@inlined
def _look_up_again(causes: Ints) -> None:
    """Discard the present facets of the arrays."""
    for at in range(MOST_ARRAYS):
        causes[FACET + at] = NOT_LOOKED_UP


@exact
def first_facet_change(
    tiles: Tiles, sheet: Packed, b: int, ray: CellRay, inside: bool, event: Floats, work: Floats, causes: Ints
) -> None:
    """Find where a ray first enters or leaves the facets of body b: `reference.column.first_change` for
    facets.

    A piece lies over one facet of each of the body's tilings; in it both faces are planes.
    """
    start_search(sheet, b, ray, work)
    _look_up_again(causes)
    along, above, aside = ends_of_body(sheet, b, ray, inside)
    limit = min(aside, above)
    since, cause, kind = 0.0, WALL, ASIDE
    normal = (0.0, 0.0, 1.0)
    walking = not above <= 0.0
    if not walking:
        kind = ABOVE
    entered = 0.0  # start of the piece
    while walking:
        end, across, edge, at, sense = _next_edge(tiles, sheet, b, along, (entered, limit), work, causes)
        ahead = edge_ahead(sheet, b, along, entered)
        if ahead < end:
            end, across, edge = ahead, NO_STEP, -1
        end = max(end, entered)
        changed, since, cause = _first_stretch(
            tiles, sheet, b, along, inside, (entered, end, since, cause), work, causes
        )
        if changed:
            kind = cause
            normal = _normal_met(tiles, sheet, b, along, (kind, since), work, causes)
            break
        if limit <= end:
            kind, since = (ABOVE, above) if above <= end else (ASIDE, aside)
            break
        entered = end
        if inside:
            t = jump(sheet, b, ray, entered, work)
            if t > entered:
                entered, since, cause = t, t, WALL
                _look_up_again(causes)
                continue
        if across >= 0:
            step_on(across, sense, work, STEP + 2 * at)
            causes[FACET + at] = NOT_LOOKED_UP
        elif edge >= 0:
            causes[FACET + at] = tiles.beside[causes[FACET + at], edge]
        elif across != NO_STEP:
            break
    write_event(sheet, kind, since, work, event)
    event[FACET_NORMAL], event[FACET_NORMAL + 1], event[FACET_NORMAL + 2] = normal


@inlined
def _next_edge(
    tiles: Tiles, sheet: Packed, b: int, ray: Ray, span: tuple[float, float], work: Floats, causes: Ints
) -> tuple[float, int, int, int, float]:
    """Enter the present facets, and find where the ray leaves the first of them.

    span : start of the piece, and the end of the search
    Returns the distance; the crossed border of the cell, or the facet's edge, −1 for neither; its array; and
    the sense in which the border is crossed.
    """
    lat = sheet.lattice
    entered, end = span
    across, edge, of, sense = -1, -1, -1, 1.0
    for k in range(2):
        at = int(sheet.bodies[b, slot.CELLS + k])
        if at < 0:
            continue
        u, v = enter_cell(lat, at, work)
        if causes[FACET + at] == NOT_LOOKED_UP:
            causes[FACET + at] = NONE
            if kept(lat, sheet.rows, work[CELL + 2 * at], work[CELL + 2 * at + 1]):
                # slightly into the piece, so that a ray along an edge is in the facet it goes to
                t = entered + 2.0 * lat[slot.TINY]
                causes[FACET + at] = locate_facet(
                    tiles,
                    tiles.of[b, k if at == int(sheet.faces[2 * b + k, slot.ARRAY]) else 1 - k],
                    u + t * ray.L,
                    v + t * ray.M,
                )
        t, n, towards = border_ahead(lat, ray, u, v, end)
        if n >= 0:
            end, across, edge, of, sense = t, n, -1, at, towards
        f = causes[FACET + at]
        if f < 0:
            continue
        for n in range(3):
            wx, wy = tiles.weight[f, n, 0], tiles.weight[f, n, 1]
            speed = wx * ray.L + wy * ray.M
            if speed >= 0.0 or tiles.beside[f, n] < 0:
                continue
            t = -(wx * u + wy * v + tiles.weight[f, n, 2]) / speed
            if t < end:
                end, across, edge, of = t, -1, n, at
    return end, across, edge, of, sense


@exact
def _array_of(sheet: Packed, b: int, side: int) -> int:
    """The array in whose cells a face of body b is looked up: its own, or the body's."""
    array = sheet.faces[2 * b + side, slot.ARRAY]
    return int(array) if array >= 0.0 else int(sheet.bodies[b, slot.ENTRY])


@inlined
def _first_stretch(
    tiles: Tiles,
    sheet: Packed,
    b: int,
    ray: Ray,
    inside: bool,
    span: tuple[float, float, float, int],
    work: Floats,
    causes: Ints,
) -> tuple[bool, float, int]:
    """Find the first stretch of a piece whose state differs from the ray's; see `column`.

    span : start and end of the piece, since when the state is known, and its cause
    Returns whether there is one, its start (else that of the last), and what is crossed there.
    """
    faces, bodies, tiny = sheet.faces, sheet.bodies, sheet.lattice[slot.TINY]
    entered, end, since, cause = span
    sx, sy, z, L, M, N = ray
    main, front_at, back_at = int(bodies[b, slot.ENTRY]), _array_of(sheet, b, 0), _array_of(sheet, b, 1)
    low, low_rise = _levels(tiles, faces, 2 * b, front_at, causes, work, L, M)
    high, high_rise = _levels(tiles, faces, 2 * b + 1, back_at, causes, work, L, M)
    work[0], causes[0] = (low - z) / (N - low_rise), _kind(tiles, faces, 2 * b, causes[FACET + front_at])
    work[1], causes[1] = (high - z) / (N - high_rise), _kind(tiles, faces, 2 * b + 1, causes[FACET + back_at])
    count = 2
    if causes[FACET + main] < 0:
        count = divide_outline(bodies, b, ray, work, causes, count)
    count = sort_divisions(work, causes, count, max(entered, since - tiny), since, end)
    over_cell = kept(sheet.lattice, sheet.rows, work[CELL + 2 * main], work[CELL + 2 * main + 1])
    for c in range(count + 1):
        to, why = (work[c], causes[c]) if c < count else (end, WALL)
        if not to - since > tiny:
            cause = cause if c == count or why == WALL else why
            continue
        t = 0.5 * (since + to)
        level = z + t * N
        over = in_footprint(sheet, b, sx + t * L, sy + t * M, over_cell)
        now = over and low + t * low_rise <= level <= high + t * high_rise
        if now != inside:
            return True, since, cause
        since, cause = to, why
    return False, since, cause


@inlined
def _normal_met(
    tiles: Tiles, sheet: Packed, b: int, ray: Ray, met: tuple[int, float], work: Floats, causes: Ints
) -> Vector:
    """Normal towards +z of the facet where the state changed; (0, 0, 1) without such a facet."""
    kind, t = met
    if kind != FRONT and kind != BACK:
        return 0.0, 0.0, 1.0
    side = 0 if kind == FRONT else 1
    at = _array_of(sheet, b, side)
    f = causes[FACET + at]
    if f < 0:
        return 0.0, 0.0, 1.0
    return facet_normal(
        tiles, f, side, work[START + 2 * at] + t * ray.L, work[START + 2 * at + 1] + t * ray.M
    )
