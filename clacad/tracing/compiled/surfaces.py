"""Rung "surfaces" compiled: rays handed to the kernels in chunks, one chunk a thread at a time."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from clacad.base.types import Rows
from clacad.optics.rays import Rays
from clacad.tracing.compiled.chunk import trace_chunk, trace_chunk_single
from clacad.tracing.compiled.packing import pack
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

    tiles : facets in place of the smooth faces
    single : the straight path in single precision; rays that need the walk are walked in double
    """
    packed = pack(layout)
    position, direction = np.ascontiguousarray(rays.position), np.ascontiguousarray(rays.direction)
    each = np.asarray(indices, dtype=np.float64)
    scene: tuple[Any, ...] = (tiles, packed.faces, packed.bodies, packed.lattice, packed.rows, each)
    kernel: Callable[..., int] = trace_chunk
    if single:
        kernel = trace_chunk_single
        rounded = (packed.faces, packed.bodies, packed.lattice, each, np.empty((0, 0, 3)))
        scene += tuple(array.astype(np.float32) for array in rounded)

    def one(chosen: Rows) -> int:
        return int(kernel(
            *scene, chosen, position, direction, ledger.position, ledger.direction, ledger.fate,
            ledger.optical_path, ledger.cell, ledger.order, ledger.surface, ledger.hits, ledger.directions,
        ))  # fmt: skip

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
