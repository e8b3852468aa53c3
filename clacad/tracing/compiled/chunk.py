"""Rays traced chunk by chunk, compiled: blocks take the straight path, the remaining rays the walk.

Rung "surfaces" compiled, and whether the kernels of a rung are on disk, ready to be loaded.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, nan
from typing import Any

import numpy as np

from clacad.base.compiled import exact, making, owning
from clacad.base.kernel_cache import is_kept
from clacad.base.types import Floats, Rows, Rung, Singles
from clacad.optics.law import law_numbers
from clacad.optics.ledger import Ledger
from clacad.optics.rays import Fate, Rays
from clacad.tracing.compiled.block import (
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
    OVER,
    PATH,
    SCRATCH,
    SHARE,
    X,
    Y,
    Z,
    blank_row,
    copy_row,
    lane,
    load_block,
    queue_undecided,
    store_block,
)
from clacad.tracing.compiled.launch import launch_block, launch_ray
from clacad.tracing.compiled.packing import Packed, in_single, pack, pack_own
from clacad.tracing.compiled.records import Outcome, Scratch, new_scratch
from clacad.tracing.compiled.straight_path import straight
from clacad.tracing.compiled.threads import CHUNK, in_arrays, over_threads
from clacad.tracing.compiled.walk import walk_ray
from clacad.tracing.facets.compiled_squares import ROWS, store_sheet_block, suits_squares, through_squares
from clacad.tracing.facets.hierarchy import Hierarchy
from clacad.tracing.facets.squares import Squares, Triangles
from clacad.tracing.facets.tiles import Tiles
from clacad.tracing.layout import Layout

ALIVE, GHOST, MISSED, INVALID = int(Fate.ALIVE), int(Fate.GHOST), int(Fate.MISSED), int(Fate.INVALID)

WAITING = 32
"""Rays queued before a walk: enough to keep its code in the cache, few enough to keep their rows there."""

LAUNCHED = (X, Y, Z, DX, DY, DZ, PATH, GOOD, CI, CJ)
ARRIVED = (*LAUNCHED, CI0, CJ0)


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
    """Trace the rays `chosen` of `start` and `ray` (n, 3), write their rows, return how many were walked.

    Media of several lines of light follow one another, and so do the rows of the lines in `out`, n of each.
    The launch, and the hits on the first face, are computed once for all lines.
    """
    s, carried, scratch = np.zeros((SCRATCH, BLOCK)), np.empty(BLOCK), new_scratch()
    lines, media = len(sheet.media) // (len(sheet.faces) + 1), np.empty(len(sheet.faces) + 1)
    lat, lit = sheet.lattice, _for_one_thread(sheet, media)
    waiting, counts = np.empty((lines, WAITING + BLOCK), dtype=np.intp), np.zeros(lines, dtype=np.intp)
    rows, walked = np.empty(BLOCK, dtype=np.intp), 0
    shared = lines > 1 and tiles is None
    for first in range(0, len(chosen), BLOCK):
        block = chosen[first : first + BLOCK]
        m = len(block)
        for line in range(lines):
            media[:] = sheet.media[line * len(media) : (line + 1) * len(media)]
            for k in range(m):
                rows[k] = block[k] + line * len(start)
            if line == 0 or not shared:
                load_block(block, start, ray, s)
                launch_block(lat, sheet.bodies[0], s, m)
                copy_row(lane(s, PATH), carried, m)
            array = straight(tiles, lit, s, rows[:m], out.hits, out.turns, carried, line if shared else -1)
            store_block(lit, s, rows[:m], array, out)
            _share(lit, s, rows[:m], out.turns)
            counts[line] = queue_undecided(s, rows[:m], waiting[line], counts[line])
            if counts[line] >= WAITING or first + BLOCK >= len(chosen):
                _walk(tiles, None, lit, waiting[line, : counts[line]], start, ray, out, scratch)
                walked, counts[line] = walked + counts[line], 0
    return walked


@making
def _for_one_thread(sheet: Packed, media: Floats) -> Packed:
    """The sheet with other media, and faces into which the lens of the cell in hand is written."""
    bodies, lat, edges = sheet.bodies, sheet.lattice, sheet.edges
    faces = sheet.faces.copy()
    return Packed(faces, bodies, lat, sheet.rows, media, sheet.losses, edges, sheet.lattices, sheet.own)


@owning
def straight_chunk_single(
    sheet: Packed, rounded: Packed, chosen: Rows, start: Floats, ray: Floats, out: Outcome, left: Rows
) -> int:
    """Trace the rays `chosen` straight through in single precision, starting from the launch plane.

    rounded : the sheet's numbers as float32
    left : (n,). Receives the rows whose straight trace does not hold; their count is returned.
    """
    wide, count = np.zeros((SCRATCH, BLOCK)), 0
    carried: Singles = np.empty(BLOCK, dtype=np.float32)
    s: Singles = np.zeros((SCRATCH, BLOCK), dtype=np.float32)
    none: Singles = np.empty((0, 0, 3), dtype=np.float32)
    lit = _for_one_thread(rounded, rounded.media)
    for first in range(0, len(chosen), BLOCK):
        block = chosen[first : first + BLOCK]
        m = len(block)
        load_block(block, start, ray, wide)
        launch_block(sheet.lattice, sheet.bodies[0], wide, m)
        for row in LAUNCHED:
            copy_row(wide[row], s[row], m)
        copy_row(lane(s, PATH), carried, m)
        array = straight(None, lit, s, block, none, none, carried, -1)
        for row in ARRIVED:
            copy_row(s[row], wide[row], m)
        store_block(sheet, wide, block, array, out)
        count = queue_undecided(wide, block, left, count)
    return count


@exact
def _share(sheet: Packed, s: Floats, block: Rows, turns: Floats) -> None:
    """Write the share of light that the straight path transmits, if counted, to the last layer of `turns`."""
    losses, share = sheet.losses, len(sheet.faces)
    if len(losses) == 0:
        return
    absorbs = False
    for rate in losses[1:]:
        absorbs |= rate != 0.0
    for k in range(len(block)):
        s[SHARE, k] /= s[OVER, k]
    for k in range(len(block) if absorbs else 0):
        s[SHARE, k] *= exp(-s[DEPTH, k])
    for k in range(len(block)):
        turns[share, block[k] // 3, block[k] % 3] = s[SHARE, k]


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
    counted, share = len(sheet.losses) > 0, len(sheet.faces)
    for row in waiting:
        sound = blank_row(row, start, ray, out)
        if counted:
            out.turns[share, row // 3, row % 3] = 1.0
        if not sound:
            continue
        reaches, launched = launch_ray(sheet, start, ray, row % len(start))
        if reaches:
            walk_ray(tiles, trees, sheet, launched, row, out, scratch)
            if counted:  # not known here: computed later from the ray's hits
                out.turns[share, row // 3, row % 3] = 1.0 if out.fate[row] >= MISSED else nan


FIRST = np.arange(CHUNK)
"""Row numbers of a chunk that has its own columns."""


def packed(layout: Layout) -> Packed:
    """Pack the layout of any sheet."""
    return pack(layout) if layout.window.uniform else pack_own(layout)


def trace_compiled(
    layout: Layout,
    rays: Rays,
    ledger: Ledger,
    rows: Rows | range,
    media: Sequence[float] | Floats,
    threads: int,
    facets: Tiles | Triangles | None = None,
    single: bool = False,
    losses: Sequence[float] = (),
) -> None:
    """Trace the rays `rows` of any kind and write their rows; the results of
    `reference.surfaces.trace_surfaces`.

    rows : a range costs less than the equivalent array; of a ledger without hits
    media, losses : see `Packed`; media of several lines of light end to end, and the ledger's rows likewise
    facets : a mesh's own tiles, or triangles from any source, in place of the smooth faces
    single : the straight path in single precision; rays for which it does not hold are traced in double
    """
    sheet = packed(layout)._replace(media=np.asarray(media), losses=np.asarray(losses, dtype=np.float64))
    whole = in_arrays(rays, ledger)
    rounded = in_single(sheet) if single else sheet

    def one(rows: Rows | range) -> None:
        chosen, (position, direction, out) = piece(rows, *whole) if isinstance(rows, range) else (rows, whole)
        if isinstance(facets, Triangles):
            trace_chunk_of_triangles(facets.trees, facets.squares, sheet, chosen, position, direction, out)
            return
        if single:
            left = np.empty_like(chosen)
            count = straight_chunk_single(sheet, rounded, chosen, position, direction, out, left)
            chosen = left[:count]
        if len(chosen):
            trace_chunk(facets, sheet, chosen, position, direction, out)

    over_threads(one, rows, threads)


def piece(
    rows: range, position: Floats, direction: Floats, out: Outcome
) -> tuple[Rows, tuple[Floats, Floats, Outcome]]:
    """Consecutive rows as a separate job: row numbers in its own columns, and these columns."""
    part = slice(rows.start, rows.stop)
    columns = Outcome._make(column if column.ndim == 3 else column[part] for column in out)
    return FIRST[: len(rows)], (position[part], direction[part], columns)


def rung_is_kept(rung: Rung, layout: Layout) -> bool:
    """Whether the kernel that traces this rung without a record is on disk; argument types alone decide."""
    one = Rays(np.zeros((1, 3)), np.ones((1, 3)))
    sheet, rows, left = packed(layout), np.arange(1), np.empty(1, dtype=np.intp)
    traced = (rows, *in_arrays(one, Ledger.blank(1, 0)))
    if rung in ("surfaces", "mesh"):
        return is_kept(trace_chunk, (None, sheet, *traced))
    kernel, *optics = _ideal(rung, layout)
    return is_kept(kernel, (*optics, *traced, left))


def _ideal(rung: Rung, layout: Layout) -> tuple[Any, Packed, Floats]:
    """Kernel of rung law or thin, the sheet, and the numbers of its optics."""
    if rung == "law":
        from clacad.tracing.compiled.law_rung import law_chunk, sheet_plane

        return law_chunk, sheet_plane(layout), law_numbers(layout.window.law)
    from clacad.tracing.compiled.thin import thin_chunk, thin_pair

    return thin_chunk, *thin_pair(layout)
