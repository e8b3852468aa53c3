"""Rung "surfaces" compiled."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clacad.base.types import Floats, Rows
from clacad.optics.rays import Rays
from clacad.tracing.compiled.chunk import straight_chunk_single, trace_chunk, trace_chunk_of_triangles
from clacad.tracing.compiled.packing import Packed, in_single, pack
from clacad.tracing.compiled.records import Outcome
from clacad.tracing.compiled.threads import CHUNK, in_arrays, over_threads
from clacad.tracing.layout import Layout
from clacad.tracing.ledger import Ledger
from clacad.tracing.triangles.squares import Triangles
from clacad.tracing.triangles.tiles import Tiles

FIRST = np.arange(CHUNK)
"""Row numbers of a chunk that has its own columns."""


def packed(layout: Layout) -> Packed:
    """Pack the layout of any sheet; code for non-uniform sheets is loaded only where needed."""
    if layout.window.uniform:
        return pack(layout)
    from clacad.tracing.compiled.own_cells import pack_own

    return pack_own(layout)


def trace_compiled(
    layout: Layout,
    rays: Rays,
    ledger: Ledger,
    rows: Rows | range,
    indices: Sequence[float],
    threads: int,
    facets: Tiles | Triangles | None = None,
    single: bool = False,
) -> None:
    """Trace the rays `rows` of any kind and write their rows; the results of
    `reference.surfaces.trace_surfaces`.

    rows : a range costs less than the equivalent array; of a ledger without hits
    indices : refractive index of each body; see `Packed.indices`
    facets : a mesh's own tiles, or triangles from any source, in place of the smooth faces
    single : the straight path in single precision; rays for which it does not hold are traced in double
    """
    sheet = packed(layout)._replace(indices=np.asarray(indices, dtype=np.float64))
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
