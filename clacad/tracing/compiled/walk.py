"""Compiled twin of `clacad.tracing.reference.walk`: one ray through every body, for all events."""

from __future__ import annotations

from math import isfinite

from clacad.base.compiled import exact, inlined
from clacad.base.types import Floats, Ints
from clacad.optics.ledger import ABOVE, ASIDE, BACK, BACK_LAND, FRONT, FRONT_LAND
from clacad.optics.rays import NO_CELL, Fate
from clacad.optics.surface import ULP
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.array_cells import into_array, lens_at, on_line
from clacad.tracing.compiled.cells import ARRIVING, INSIDE, LEAVING, kept, quick_change, reach, sheet_xy
from clacad.tracing.compiled.column import box_span, first_change, in_footprint
from clacad.tracing.compiled.face import meet, snell, to_lens, to_sheet, upward
from clacad.tracing.compiled.packing import Packed
from clacad.tracing.compiled.records import (
    AT_ARRAY,
    CI,
    CJ,
    DISTANCE,
    DX,
    DY,
    DZ,
    FACET_NORMAL,
    FIRST,
    GHOSTLY,
    KIND,
    LANDED,
    LAST,
    ODD,
    PATH,
    PLACE,
    PX,
    PY,
    PZ,
    SECOND,
    SURFACE,
    WALKER_NUMBERS,
    CellRay,
    Launched,
    Outcome,
    Scratch,
    Vector,
    X,
    Y,
    Z,
)
from clacad.tracing.facets.compiled_hierarchy import first_soup_change
from clacad.tracing.facets.compiled_tiles import first_facet_change
from clacad.tracing.facets.hierarchy import Hierarchy
from clacad.tracing.facets.tiles import Tiles

BEHIND = 8 * ULP
"""Share of the travelled distance by which a first face may lie behind the start: rounding error."""

SAME = 1e-6
"""Share of half a cell within which two distances belong to one crossing."""

ALIVE, GHOST, ON_LAND, BACKWARD = int(Fate.ALIVE), int(Fate.GHOST), int(Fate.LAND), int(Fate.BACKWARD)
TIR, WALL, VIGNETTED, MISSED = int(Fate.TIR), int(Fate.WALL), int(Fate.VIGNETTED), int(Fate.MISSED)
GOES_ON = 255
"""No fate yet."""


@inlined
def walk_ray(
    tiles: Tiles | None,
    trees: Hierarchy | None,
    sheet: Packed,
    launched: Launched,
    row: int,
    out: Outcome,
    scratch: Scratch,
) -> None:
    """Trace one ray from the launch plane and write its row, whose position and direction are its start."""
    w, left = scratch.walker, scratch.left
    _begin(launched, out.position, row, w)
    end = GOES_ON
    for b in range(len(sheet.bodies)):
        gap = launched.carried
        if sheet.bodies[b, slot.JOINED] != 0.0:
            _past_joint(sheet, b, w, row, out)
        elif b:
            for c in range(WALKER_NUMBERS):
                left[c] = w[c]
            gap, end = _cross_gap(sheet, b, w)
            if end != GOES_ON:
                _record_end(w, row, out.hits, out.turns)
                break
        end = _through_body(tiles, trees, sheet, b, gap, row, out, scratch)
        if end != GOES_ON:
            break
    if end == GOES_ON:
        end = ON_LAND if w[LANDED] != 0.0 else (GHOST if w[GHOSTLY] != 0.0 else ALIVE)
        _record_end(w, row, out.hits, out.turns)
    _write_row(w, end, row, out)


@inlined
def _begin(launched: Launched, position: Floats, row: int, w: Floats) -> None:
    """Initialise a walker's numbers."""
    i, j, x, y, z, L, M, N, _ = launched
    w[CI], w[CJ], w[X], w[Y], w[Z], w[DX], w[DY], w[DZ], w[PATH] = i, j, x, y, z, L, M, N, 0.0
    w[PX], w[PY], w[PZ] = position[row, 0], position[row, 1], position[row, 2]
    for c in range(FIRST, ODD + 2):
        w[c] = NO_CELL
    for c in range(AT_ARRAY, LANDED + 1):
        w[c] = 0.0
    w[SURFACE] = NO_CELL


@inlined
def _write_row(w: Floats, end: int, row: int, out: Outcome) -> None:
    """Write the row of a ray that ended with this fate."""
    position, direction, cell = out.position, out.direction, out.cell
    if end == MISSED:
        for k in range(len(out.hits)):
            for c in range(3):
                out.hits[k, row, c], out.turns[k, row, c] = position[row, c], direction[row, c]
        out.fate[row] = MISSED
        cell[row, 0], cell[row, 1] = int(w[FIRST]), int(w[FIRST + 1])
        return
    out.fate[row], out.path[row], out.surface[row] = end, w[PATH], int(w[SURFACE])
    position[row, 0], position[row, 1], position[row, 2] = w[PX], w[PY], w[PZ]
    direction[row, 0], direction[row, 1], direction[row, 2] = w[DX], w[DY], w[DZ]
    cell[row, 0], cell[row, 1] = int(w[FIRST]), int(w[FIRST + 1])
    out.order[row, 0], out.order[row, 1] = _order(w)


@exact
def _order(w: Floats) -> tuple[int, int]:
    """Cell of lens 2 minus cell 1; if these agree but a face between differs, that difference."""
    if w[SECOND] == 0.0 or w[FIRST] == NO_CELL or w[LAST] == NO_CELL:
        return NO_CELL, NO_CELL
    i, j = w[LAST] - w[FIRST], w[LAST + 1] - w[FIRST + 1]
    if i == 0.0 and j == 0.0 and w[ODD] != NO_CELL:
        i, j = w[ODD] - w[FIRST], w[ODD + 1] - w[FIRST + 1]
    return int(i), int(j)


@exact
def _next_change(
    tiles: Tiles | None, trees: Hierarchy | None, sheet: Packed, b: int, stage: int, scratch: Scratch
) -> None:
    """Find what is met first, on smooth faces or on facets."""
    w, event, work, causes = scratch.walker, scratch.event, scratch.work, scratch.causes
    ray = CellRay(int(w[AT_ARRAY]), w[CI], w[CJ], w[X], w[Y], w[Z], w[DX], w[DY], w[DZ])
    inside = stage == INSIDE
    if trees is not None:
        first_soup_change(trees, sheet, b, ray, inside, event, scratch.stack)
    elif tiles is not None:
        first_facet_change(tiles, sheet, b, ray, inside, event, work, causes)
    elif not quick_change(sheet, b, ray, stage, event):
        first_change(sheet, b, ray, inside, event, work, causes)


@inlined
def _through_body(
    tiles: Tiles | None,
    trees: Hierarchy | None,
    sheet: Packed,
    b: int,
    gap: float,
    row: int,
    out: Outcome,
    scratch: Scratch,
) -> int:
    """Enter, cross and leave one body; the fate of a ray that ends, or GOES_ON."""
    index, w, event, hits, turns = sheet.media[2 * b + 1], scratch.walker, scratch.event, out.hits, out.turns
    # nothing of this body has been met, but for a joint on which the ray is
    event[DISTANCE] = -1.0 if sheet.bodies[b, slot.JOINED] == 0.0 else 0.0
    if sheet.bodies[b, slot.JOINED] == 0.0:
        end, inside = _approach(tiles, trees, sheet, b, gap, row, out, scratch)
        if not inside:
            return end
    _next_change(tiles, trees, sheet, b, INSIDE, scratch)
    kind = int(event[KIND])
    if kind != BACK and kind != BACK_LAND:
        return _end_at(sheet, b, w, event, index, row, hits, turns)
    end = _refract(tiles, trees, sheet, b, 1, w, event)
    _record(w, 2 * b + 1, row, hits, turns)
    if end != GOES_ON:
        return end
    if not w[DZ] > 0.0:
        return BACKWARD
    if b + 1 < len(sheet.bodies) and sheet.bodies[b + 1, slot.JOINED] != 0.0:
        return GOES_ON
    _next_change(tiles, trees, sheet, b, LEAVING, scratch)
    kind = int(event[KIND])
    if kind != ABOVE and kind != ASIDE:
        return _end_at(sheet, b, w, event, 1.0, row, hits, turns)
    return GOES_ON


@exact
def _past_joint(sheet: Packed, b: int, w: Floats, row: int, out: Outcome) -> None:
    """Put a ray on the joint before body b into the body."""
    bodies, entry, of = sheet.bodies, int(sheet.bodies[b, slot.ENTRY]), int(w[AT_ARRAY])
    w[Z] -= bodies[b, slot.LEVEL] - bodies[b - 1, slot.LEVEL]
    w[CI], w[CJ], w[X], w[Y] = into_array(sheet, sheet.own, of, entry, w[CI], w[CJ], w[X], w[Y])
    w[AT_ARRAY] = entry
    _record(w, 2 * b, row, out.hits, out.turns)


@inlined
def _approach(
    tiles: Tiles | None,
    trees: Hierarchy | None,
    sheet: Packed,
    b: int,
    gap: float,
    row: int,
    out: Outcome,
    scratch: Scratch,
) -> tuple[int, bool]:
    """Enter a body from air; the fate of a ray that ends, or GOES_ON, and whether it is inside."""
    lat, w, left = sheet.lattice, scratch.walker, scratch.left
    event, hits, turns = scratch.event, out.hits, out.turns
    _next_change(tiles, trees, sheet, b, ARRIVING, scratch)
    kind, distance = int(event[KIND]), event[DISTANCE]
    if b == 0 and gap + distance < -BEHIND * (abs(gap) + abs(distance)):
        return MISSED, False
    hole = kind == ABOVE and _over(sheet, b, w, distance)
    missed = kind == ASIDE or (kind == ABOVE and not hole)
    if b and lat[slot.BAFFLE] != slot.NO_BAFFLE:
        if _stopped_by_baffle(sheet, b, w, left, event, gap):
            _record_end(left, row, hits, turns)
            for c in range(WALKER_NUMBERS):
                w[c] = left[c]
            return VIGNETTED, False
    if missed:
        return MISSED, False
    w[PATH] += gap
    if hole:
        _pass_hole(sheet, b, w, distance)
        return GOES_ON, False
    if kind != FRONT and kind != FRONT_LAND:
        return _end_at(sheet, b, w, event, 1.0, row, hits, turns), False
    end = _refract(tiles, trees, sheet, b, 0, w, event)
    _record(w, 2 * b, row, hits, turns)
    return end, end == GOES_ON


@exact
def _over(sheet: Packed, b: int, w: Floats, distance: float) -> bool:
    """Whether a ray that has risen past the body did so over its footprint."""
    array = int(w[AT_ARRAY])
    sx, sy = sheet_xy(sheet.lattices[array], array, w[CI], w[CJ], w[X], w[Y])
    main = int(sheet.bodies[b, slot.ENTRY])
    i, j, _, _ = into_array(
        sheet, sheet.own, array, main, w[CI], w[CJ], w[X] + distance * w[DX], w[Y] + distance * w[DY]
    )
    over = kept(sheet.lattice, sheet.rows, i, j)
    return in_footprint(sheet, b, sx + distance * w[DX], sy + distance * w[DY], over)


@exact
def _refract(
    tiles: Tiles | None, trees: Hierarchy | None, sheet: Packed, b: int, side: int, w: Floats, event: Floats
) -> int:
    """Refract at the front or back that was met; the fate of a ray that ends there, or GOES_ON."""
    faces, bodies, lat, f = sheet.faces, sheet.bodies, sheet.lattice, 2 * b + side
    n1, n2 = sheet.media[f], sheet.media[f + 1]
    kind, distance = int(event[KIND]), event[DISTANCE]
    on_lens = kind == FRONT or kind == BACK
    main = int(bodies[b, slot.ENTRY])
    array = int(faces[f, slot.ARRAY]) if faces[f, slot.ARRAY] >= 0.0 else main
    place = PLACE + 4 * array
    L, M, N = w[DX], w[DY], w[DZ]
    x, y, z = event[place + 2], event[place + 3], w[Z]
    ox, oy, oz = snell((L, M, N), (0.0, 0.0, 1.0), N, n1, n2)
    met, levelled = False, not on_lens
    if trees is not None:
        levelled = False
        ox, oy, oz = _through_facet(event, (L, M, N), n1, n2)
    elif tiles is not None:
        if on_lens:
            ox, oy, oz = _through_facet(event, (L, M, N), n1, n2)
    elif on_lens:
        vx, vy, vz, size = lens_at(sheet, sheet.own, f, event[place], event[place + 1])
        sx, sy, sz = to_lens(faces, f, (x - vx) / size, (y - vy) / size, (z - vz) / size)
        u, v, k = to_lens(faces, f, L, M, N)
        distance = distance / size
        t, px, py, pz, gx, gy, gz, root = meet(faces, f, sx, sy, sz, u, v, k)
        if not abs(t - distance) <= SAME * lat[slot.HALF]:
            # `meet` gives the other crossing where a ray falls in the lens's frame while it rises in the
            # sheet's
            t = distance
            for _ in range(2):
                gx, gy, gz, over = upward(faces, f, sx + t * u, sy + t * v, sz + t * k)
                t -= over / (gx * u + gy * v + gz * k)
            px, py, pz = sx + t * u, sy + t * v, sz + t * k
            gx, gy, gz, over = upward(faces, f, px, py, pz)
            root = gx * u + gy * v + gz * k
        ox, oy, oz = snell((u, v, k), (gx, gy, gz), root, n1, n2)
        ox, oy, oz = to_sheet(faces, f, ox, oy, oz)
        met, distance = True, size * t
        px, py, pz = to_sheet(faces, f, px, py, pz)
        x, y, z = size * px + vx, size * py + vy, size * pz + vz
    if not met:
        x, y = x + distance * L, y + distance * M
        z = faces[f, slot.LAND] if levelled else z + distance * N
    w[CI], w[CJ], w[X], w[Y], w[Z], w[AT_ARRAY] = event[place], event[place + 1], x, y, z, array
    w[PATH] += n1 * distance
    w[PX], w[PY] = sheet_xy(sheet.lattices[array], array, w[CI], w[CJ], x, y)
    w[PZ] = z + bodies[b, slot.LEVEL]
    w[SURFACE] = 2 * b + side
    if faces[f, slot.ARRAY] >= 0.0 or not on_lens:
        _note_cell(lat, sheet.rows, w, faces[f], on_lens)
    opaque = not on_lens and lat[slot.OPAQUE] != 0.0 or on_line(sheet, f, array, w[CI], w[CJ], x, y)
    total = not opaque and not isfinite(ox)
    if not (opaque or total):
        w[DX], w[DY], w[DZ] = ox, oy, oz
    return VIGNETTED if opaque else (TIR if total else GOES_ON)


@exact
def _through_facet(event: Floats, ray: Vector, n1: float, n2: float) -> Vector:
    """Refract at the facet that was met."""
    gx, gy, gz = event[FACET_NORMAL], event[FACET_NORMAL + 1], event[FACET_NORMAL + 2]
    return snell(ray, (gx, gy, gz), ray[0] * gx + ray[1] * gy + ray[2] * gz, n1, n2)


@exact
def _note_cell(lat: Floats, rows: Ints, w: Floats, face: Floats, on_lens: bool) -> None:
    """Enter the cell of a structured face, or of land or a hole, in the ray's record."""
    i, j = float(NO_CELL), float(NO_CELL)
    if kept(lat, rows, w[CI], w[CJ]):
        i, j = w[CI], w[CJ]
    if w[FIRST] == NO_CELL and w[FIRST + 1] == NO_CELL:
        w[FIRST], w[FIRST + 1], w[ODD], w[ODD + 1] = i, j, i, j
    if face[slot.BLIND] == 1.0 and i != NO_CELL:
        i = w[FIRST]
    elif face[slot.BLIND] == 2.0 and i != NO_CELL:
        j = w[FIRST + 1]
    differs = i != w[FIRST] or j != w[FIRST + 1]
    if differs and w[ODD] == w[FIRST] and w[ODD + 1] == w[FIRST + 1]:
        w[ODD], w[ODD + 1] = i, j
    w[LAST], w[LAST + 1] = i, j
    if face[slot.ARRAY] == 1.0:
        w[SECOND] = 1.0
    if differs and on_lens:
        w[GHOSTLY] = 1.0
    if not on_lens:
        w[LANDED] = 1.0


@exact
def _pass_hole(sheet: Packed, b: int, w: Floats, distance: float) -> None:
    """Put a ray that rose past the body over its footprint on its highest level."""
    faces = sheet.faces
    for side in range(2):
        if faces[2 * b + side, slot.ARRAY] < 0.0:
            continue
        array = int(faces[2 * b + side, slot.ARRAY])
        i, j, x, y = into_array(
            sheet,
            sheet.own,
            int(w[AT_ARRAY]),
            array,
            w[CI],
            w[CJ],
            w[X] + distance * w[DX],
            w[Y] + distance * w[DY],
        )
        w[CI], w[CJ], w[X], w[Y], w[Z], w[AT_ARRAY] = i, j, x, y, w[Z] + distance * w[DZ], array
        w[PATH] += distance
        _note_cell(sheet.lattice, sheet.rows, w, faces[2 * b + side], False)
        distance = 0.0
    array = int(w[AT_ARRAY])
    w[PX], w[PY] = sheet_xy(sheet.lattices[array], array, w[CI], w[CJ], w[X], w[Y])
    w[PZ] = w[Z] + sheet.bodies[b, slot.LEVEL]


@exact
def _cross_gap(sheet: Packed, b: int, w: Floats) -> tuple[float, int]:
    """Carry a ray to body b's reference plane, or to where it comes alongside above that plane."""
    bodies, lat = sheet.bodies, sheet.lattice
    entry = int(bodies[b, slot.ENTRY])
    z = w[Z] - (bodies[b, slot.LEVEL] - bodies[b - 1, slot.LEVEL])
    gap = (bodies[b, slot.BODY_LOW] - z) / w[DZ]
    of = int(w[AT_ARRAY])
    i, j, x, y = into_array(sheet, sheet.own, of, entry, w[CI], w[CJ], w[X] + gap * w[DX], w[Y] + gap * w[DY])
    sx, sy = sheet_xy(sheet.lattices[entry], entry, i, j, x, y)
    enter, leave = box_span(lat, bodies, b, sx, sy, w[DX], w[DY])
    span = (bodies[b, slot.BODY_HIGH] - bodies[b, slot.BODY_LOW]) / w[DZ]
    if not (enter <= leave and leave >= 0.0 and enter <= span and isfinite(gap)):
        return gap, (MISSED if lat[slot.BAFFLE] == slot.NO_BAFFLE else VIGNETTED)
    late = enter if enter > 0.0 else 0.0
    i, j, x, y = into_array(sheet, sheet.own, entry, entry, i, j, x + late * w[DX], y + late * w[DY])
    w[CI], w[CJ], w[X], w[Y], w[Z], w[AT_ARRAY] = i, j, x, y, bodies[b, slot.BODY_LOW] + late * w[DZ], entry
    return gap + late, GOES_ON


@exact
def _stopped_by_baffle(sheet: Packed, b: int, w: Floats, left: Floats, event: Floats, gap: float) -> bool:
    """Whether the honeycomb between the arrays stops the ray; `left` is then put there."""
    main = int(sheet.bodies[b, slot.ENTRY])
    place = PLACE + 4 * main
    distance = event[DISTANCE]
    before = sheet.lattices[int(left[AT_ARRAY])]
    behind = sheet.lattices[main]
    u, v = event[place + 2] + distance * w[DX], event[place + 3] + distance * w[DY]
    i, j = event[place] - left[CI], event[place + 1] - left[CJ]
    share = reach(before, behind, left[X], left[Y], u, v, i, j)
    if not isfinite(share):
        return False
    run = share * (gap + distance)
    if not isfinite(run):
        run = 0.0
    left[PX], left[PY], left[PZ] = (
        left[PX] + run * left[DX],
        left[PY] + run * left[DY],
        left[PZ] + run * left[DZ],
    )
    left[PATH] += run
    return True


@exact
def _end_at(
    sheet: Packed, b: int, w: Floats, event: Floats, index: float, row: int, hits: Floats, turns: Floats
) -> int:
    """End a ray at a wall, or at a face met from its wrong side."""
    bodies = sheet.bodies
    main = int(bodies[b, slot.ENTRY])
    place = PLACE + 4 * main
    kind, distance = int(event[KIND]), event[DISTANCE]
    x, y = event[place + 2] + distance * w[DX], event[place + 3] + distance * w[DY]
    w[PX], w[PY] = sheet_xy(sheet.lattices[main], main, event[place], event[place + 1], x, y)
    w[PZ] = w[Z] + distance * w[DZ] + bodies[b, slot.LEVEL]
    w[PATH] += index * distance
    _record_end(w, row, hits, turns)
    if kind == FRONT or kind == FRONT_LAND:
        w[SURFACE] = 2 * b
    elif kind == BACK or kind == BACK_LAND:
        w[SURFACE] = 2 * b + 1
    else:
        return WALL
    opaque = on_line(sheet, int(w[SURFACE]), main, event[place], event[place + 1], x, y)
    return VIGNETTED if opaque else WALL


@exact
def _record(w: Floats, face: int, row: int, hits: Floats, turns: Floats) -> None:
    """Note where a face was met; later faces repeat it until they are met."""
    for k in range(max(face, 0), len(hits)):
        for c in range(3):
            hits[k, row, c] = w[PX + c]
            turns[k, row, c] = w[DX + c]


@exact
def _record_end(w: Floats, row: int, hits: Floats, turns: Floats) -> None:
    """Repeat the last point at every face that was not met."""
    _record(w, int(w[SURFACE]) + 1 if w[SURFACE] >= 0.0 else 0, row, hits, turns)
