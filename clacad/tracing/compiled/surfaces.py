"""Rung "surfaces" compiled, and whether the kernels of a rung are on disk, ready to be loaded."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from clacad.base.kernel_cache import is_kept
from clacad.base.types import Floats, Rows, Rung
from clacad.optics.law import law_numbers
from clacad.optics.rays import Rays
from clacad.tracing.compiled.chunk import straight_chunk_single, trace_chunk, trace_chunk_of_triangles
from clacad.tracing.compiled.packing import Packed, in_single, pack, pack_own
from clacad.tracing.compiled.records import Outcome
from clacad.tracing.compiled.threads import CHUNK, in_arrays, over_threads
from clacad.tracing.facets.squares import Triangles
from clacad.tracing.facets.tiles import Tiles
from clacad.tracing.layout import Layout
from clacad.tracing.ledger import Ledger

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
    media: Sequence[float],
    threads: int,
    facets: Tiles | Triangles | None = None,
    single: bool = False,
    losses: Sequence[float] = (),
) -> None:
    """Trace the rays `rows` of any kind and write their rows; the results of
    `reference.surfaces.trace_surfaces`.

    rows : a range costs less than the equivalent array; of a ledger without hits
    media, losses : see `Packed`
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
