"""Rung "surfaces" compiled: rays handed to the kernels in chunks, one chunk a thread at a time."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from clacad.base.types import Rows
from clacad.optics.rays import Rays
from clacad.tracing.compiled.chunk import trace_chunk, trace_chunk_single
from clacad.tracing.compiled.packing import in_single, pack
from clacad.tracing.compiled.records import Outcome
from clacad.tracing.layout import Layout
from clacad.tracing.ledger import Ledger
from clacad.tracing.triangles.tiles import NO_TILES, Tiles

CHUNK = 1 << 16
"""Rays handed to a thread at a time: many chunks a thread, so that none waits long for the last."""


def trace_compiled(
    layout: Layout,
    rays: Rays,
    ledger: Ledger,
    rows: Rows,
    indices: Sequence[float],
    threads: int,
    tiles: Tiles = NO_TILES,
    single: bool = False,
) -> None:
    """Trace the rays `rows`, whatever they are, and write their rows; the results of `reference.surfaces.trace_surfaces`.

    indices : refractive index of each body; see `Packed.indices`
    tiles : facets in place of the smooth faces
    single : the straight path in single precision; rays that need the walk are walked in double
    """
    sheet = pack(layout)._replace(indices=np.asarray(indices, dtype=np.float64))
    position, direction = np.ascontiguousarray(rays.position), np.ascontiguousarray(rays.direction)
    out = Outcome(
        ledger.position, ledger.direction, ledger.fate, ledger.optical_path, ledger.cell, ledger.order,
        ledger.surface, ledger.hits, ledger.directions,
    )  # fmt: skip
    rounded = in_single(sheet) if single else sheet

    def one(chosen: Rows) -> None:
        if single:
            trace_chunk_single(tiles, sheet, rounded, chosen, position, direction, out)
        else:
            trace_chunk(tiles, sheet, chosen, position, direction, out)

    chunks = [rows[k : k + CHUNK] for k in range(0, len(rows), CHUNK)]
    if threads == 1 or len(chunks) == 1:
        for chunk in chunks:
            one(chunk)
        return
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(one, chunks))


def thread_count(asked: int | None) -> int:
    """Threads to use: as asked, else CLACAD_THREADS, else one for each core this process may run on.

    Raises
    ------
    ValueError
        The number, or the variable, is not a positive whole number.
    """
    text = os.environ.get("CLACAD_THREADS", "") if asked is None else str(asked)
    if text == "":
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not text.isdigit() or int(text) < 1:
        raise ValueError(f"threads (or CLACAD_THREADS) is {text!r}, not a positive whole number")
    return int(text)
