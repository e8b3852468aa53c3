"""Rays traced chunk by chunk, compiled: blocks take the straight path, the remaining rays the walk."""

from __future__ import annotations

from math import exp, isfinite, nan

import numpy as np

from clacad.base.compiled import exact, least, making, owning
from clacad.base.compiled_vectors import EIGHT, eight_apart, eight_together
from clacad.base.types import Cells, Floats, Rows, Singles
from clacad.optics.rays import NO_CELL, Fate
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.array_cells import row_of
from clacad.tracing.compiled.launch import launch_block, launch_ray
from clacad.tracing.compiled.packing import Packed
from clacad.tracing.compiled.records import Outcome, Scratch, new_scratch
from clacad.tracing.compiled.straight_path import centres, copy_row, straight
from clacad.tracing.compiled.straight_path_slots import (
    BLOCK,
    CI,
    CI0,
    CJ,
    CJ0,
    DEPTH,
    DX,
    DY,
    DZ,
    GOOD,
    GX,
    GY,
    OVER,
    PATH,
    SCRATCH,
    SHARE,
    X,
    Y,
    Z,
    lane,
    lanes,
)
from clacad.tracing.compiled.walk import walk_ray
from clacad.tracing.facets.compiled_squares import ROWS, store_sheet_block, suits_squares, through_squares
from clacad.tracing.facets.hierarchy import Hierarchy
from clacad.tracing.facets.squares import Squares
from clacad.tracing.facets.tiles import Tiles

ALIVE, GHOST, MISSED, INVALID = int(Fate.ALIVE), int(Fate.GHOST), int(Fate.MISSED), int(Fate.INVALID)

WAITING = 32
"""Rays queued before a walk: enough to keep its code in the cache, few enough to keep their rows there."""

MOST = 2.0**31 - 1.0

LAUNCHED = (X, Y, Z, DX, DY, DZ, PATH, GOOD, CI, CJ)
ARRIVED = (*LAUNCHED, CI0, CJ0)


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
    centres(sheet.lattices[row_of(sheet.own, array)], s, m, array, px, py, face[slot.VX], face[slot.VY])
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
    """Write a row as launched, MISSED or INVALID; return whether the ray can be launched."""
    finite, zero = True, True
    for c in range(3):
        out.position[row, c], out.direction[row, c] = start[row, c], ray[row, c]
        finite &= isfinite(start[row, c]) and isfinite(ray[row, c])
        zero &= ray[row, c] == 0.0
        for face in range(len(out.hits)):
            out.hits[face, row, c], out.turns[face, row, c] = start[row, c], ray[row, c]
    out.cell[row, 0], out.cell[row, 1], out.order[row, 0], out.order[row, 1] = (
        NO_CELL,
        NO_CELL,
        NO_CELL,
        NO_CELL,
    )
    out.path[row], out.surface[row] = 0.0, NO_CELL
    sound = finite and not zero
    out.fate[row] = MISSED if sound else INVALID
    return sound and ray[row, 2] > 0.0


@owning
def trace_chunk_of_triangles(
    trees: Hierarchy, squares: Squares, sheet: Packed, chosen: Rows, start: Floats, ray: Floats, out: Outcome
) -> int:
    """Trace the rays `chosen` through triangles from any source; arguments as in `trace_chunk`."""
    waiting, rest = np.empty(len(chosen), dtype=np.intp), chosen
    plain = len(trees.corner_normal) == 0 and len(out.hits) == 0
    if plain and suits_squares(squares, sheet.lattice):
        rest = waiting[: _through_squares(squares, sheet, chosen, start, ray, out, waiting)]
    _walk(None, trees, sheet, rest, start, ray, out, new_scratch())
    return len(rest)


@making
def _through_squares(
    squares: Squares, sheet: Packed, chosen: Rows, start: Floats, ray: Floats, out: Outcome, left: Rows
) -> int:
    """Trace rays where facets halve the bins of the grid; undecided rows go to `left`; return their count."""
    s, count = np.zeros((ROWS, BLOCK)), 0
    for first in range(0, len(chosen), BLOCK):
        block = chosen[first : first + BLOCK]
        load_block(block, start, ray, s)
        launch_block(sheet.lattice, sheet.bodies[0], s, len(block))
        through_squares(squares, sheet, s, len(block))
        store_sheet_block(s, block, len(sheet.faces) - 1, out)
        count = queue_undecided(s, block, left, count)
    return count


@owning
def trace_chunk(
    tiles: Tiles | None, sheet: Packed, chosen: Rows, start: Floats, ray: Floats, out: Outcome
) -> int:
    """Trace the rays `chosen` of `start` and `ray` (n, 3), write their rows, return how many were walked."""
    s, carried = np.zeros((SCRATCH, BLOCK)), np.empty(BLOCK)
    waiting, scratch = np.empty(WAITING + BLOCK, dtype=np.intp), new_scratch()
    count, walked = 0, 0
    for first in range(0, len(chosen), BLOCK):
        block = chosen[first : first + BLOCK]
        m = len(block)
        load_block(block, start, ray, s)
        launch_block(sheet.lattice, sheet.bodies[0], s, m)
        copy_row(lane(s, PATH), carried, m)
        array = straight(tiles, sheet, s, block, out.hits, out.turns, carried)
        store_block(sheet, s, block, array, out)
        _share(sheet, s, block, out.turns)
        count = queue_undecided(s, block, waiting, count)
        if count >= WAITING or first + BLOCK >= len(chosen):
            _walk(tiles, None, sheet, waiting[:count], start, ray, out, scratch)
            walked, count = walked + count, 0
    return walked


@owning
def straight_chunk_single(
    sheet: Packed, rounded: Packed, chosen: Rows, start: Floats, ray: Floats, out: Outcome, left: Rows
) -> int:
    """Trace the rays `chosen` straight through in single precision, starting from the launch plane.

    rounded : the sheet's numbers as float32
    left : (n,)
        Receives the rows whose straight trace does not hold; their count is returned.
    """
    wide, count = np.zeros((SCRATCH, BLOCK)), 0
    carried: Singles = np.empty(BLOCK, dtype=np.float32)
    s: Singles = np.zeros((SCRATCH, BLOCK), dtype=np.float32)
    none: Singles = np.empty((0, 0, 3), dtype=np.float32)
    for first in range(0, len(chosen), BLOCK):
        block = chosen[first : first + BLOCK]
        m = len(block)
        load_block(block, start, ray, wide)
        launch_block(sheet.lattice, sheet.bodies[0], wide, m)
        for row in LAUNCHED:
            copy_row(wide[row], s[row], m)
        copy_row(lane(s, PATH), carried, m)
        array = straight(None, rounded, s, block, none, none, carried)
        for row in ARRIVED:
            copy_row(s[row], wide[row], m)
        store_block(sheet, wide, block, array, out)
        count = queue_undecided(wide, block, left, count)
    return count


@exact
def _share(sheet: Packed, s: Floats, block: Rows, turns: Floats) -> None:
    """Write the share of light that the straight path transmits, if counted, to the last layer of `turns`."""
    indices, bodies, share = sheet.indices, len(sheet.bodies), len(sheet.faces)
    if len(indices) == bodies:
        return
    absorbs = False
    for b in range(bodies):
        absorbs |= indices[bodies + 1 + b] != 0.0
    for k in range(len(block)):
        s[SHARE, k] /= s[OVER, k]
    for k in range(len(block) if absorbs else 0):
        s[SHARE, k] *= exp(-s[DEPTH, k])
    for k in range(len(block)):
        turns[share, block[k] // 3, block[k] % 3] = s[SHARE, k]


@exact
def queue_undecided(s: Floats, block: Rows, waiting: Rows, count: int) -> int:
    """Append the rays of a block whose straight trace does not hold to the list of rays to walk."""
    good = lane(s, GOOD)
    for k in range(len(block)):
        if good[k] == 0.0:
            waiting[count] = block[k]
            count += 1
    return count


@exact
def _walk(
    tiles: Tiles | None,
    trees: Hierarchy | None,
    sheet: Packed,
    waiting: Rows,
    start: Floats,
    ray: Floats,
    out: Outcome,
    scratch: Scratch,
) -> None:
    """Walk rays one by one, many in a row, so that the code and tables of the walk stay in the cache."""
    counted, share = len(sheet.indices) > len(sheet.bodies), len(sheet.faces)
    for row in waiting:
        sound = blank_row(row, start, ray, out)
        if counted:
            out.turns[share, row // 3, row % 3] = 1.0
        if not sound:
            continue
        reaches, launched = launch_ray(sheet, start, ray, row)
        if reaches:
            walk_ray(tiles, trees, sheet, launched, row, out, scratch)
            if counted:  # not known here: computed later from the ray's hits
                out.turns[share, row // 3, row % 3] = 1.0 if out.fate[row] >= MISSED else nan
