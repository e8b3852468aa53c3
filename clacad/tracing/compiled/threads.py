"""Distribution of rays to kernels: columns as plain arrays, in chunks, one chunk a thread at a time."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np

from clacad.base.text import whole_number
from clacad.base.types import Floats, Rows
from clacad.optics.ledger import Ledger
from clacad.optics.rays import Rays
from clacad.tracing.compiled.records import Outcome

CHUNK = 1 << 16
"""Rays of one chunk: many chunks for each thread, so that no thread waits long for the last."""

Found = TypeVar("Found")
Several = TypeVar("Several", Rows, range, Rows | range)


def in_arrays(rays: Rays, ledger: Ledger) -> tuple[Floats, Floats, Outcome]:
    """Starts and directions (n, 3) as kernels read them, and the ledger's columns as kernels write them."""
    return (
        np.ascontiguousarray(rays.position),
        np.ascontiguousarray(rays.direction),
        Outcome(
            ledger.position,
            ledger.direction,
            ledger.fate,
            ledger.optical_path,
            ledger.cell,
            ledger.order,
            ledger.surface,
            ledger.hits,
            ledger.directions,
        ),
    )


def over_threads(one: Callable[[Several], Found], rows: Several, threads: int) -> list[Found]:
    """Results of a function for each chunk of rows (k,), or of a range of rows, in order."""
    chunks = [rows[k : k + CHUNK] for k in range(0, len(rows), CHUNK)]
    if threads == 1 or len(chunks) == 1:
        return [one(chunk) for chunk in chunks]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(one, chunks))


def thread_count(asked: int | None) -> int:
    """Threads to use: as requested, else CLACAD_THREADS, else one for each core this process may use.

    Raises ValueError: The number, or the variable, is not a positive whole number.
    """
    text = os.environ.get("CLACAD_THREADS", "") if asked is None else str(asked)
    if text == "":
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    number = whole_number(text) or 0
    if number < 1:
        raise ValueError(f"threads (or CLACAD_THREADS) is {text!r}, not a positive whole number")
    return number
