"""Forecast of kernel compilation before a task: without cached kernels it takes longer than the task
itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from clacad.sheet.window import Window

Kernel = Literal["surfaces", "mesh", "float32", "law", "thin"]

SECONDS: dict[Kernel, float] = {"surfaces": 40.0, "mesh": 41.0, "float32": 20.0, "law": 7.0, "thin": 9.0}
"""Processor seconds to compile each kernel (`tests/benchmarks/kernel_compile.py`)."""

OF_TABLE: tuple[Kernel, ...] = ("surfaces", "mesh", "float32", "law", "thin")
"""Kernels of an accuracy table."""

TASK = "compiling what traces"
"""Name under which a machine's rate is looked up."""


def compiling_seconds(window: Window, kernels: Sequence[Kernel]) -> float:
    """Processor seconds to compile those of some kernels that are not cached on this machine; 0 where all
    are.

    window : the kind of its layout determines the code; 0 for a non-uniform sheet
    """
    if not window.uniform:
        return 0.0
    return sum(SECONDS[name] for name in kernels if not _kept(window, name))


def _kept(window: Window, kernel: Kernel) -> bool:
    """Whether the code of one kernel is on disk; it depends on the argument types alone."""
    from clacad.base.kernel_cache import is_kept
    from clacad.optics.rays import Rays
    from clacad.tracing.compiled.chunk import straight_chunk_single, trace_chunk
    from clacad.tracing.compiled.packing import in_single, pack
    from clacad.tracing.compiled.surfaces import rung_is_kept
    from clacad.tracing.compiled.threads import in_arrays
    from clacad.tracing.facets.triangle_soup import facets_of
    from clacad.tracing.layout import lay_out
    from clacad.tracing.ledger import Ledger

    layout = lay_out(window)
    if kernel == "thin" and window.thin.field:  # computed by numpy
        return True
    if kernel == "surfaces" or kernel == "law" or kernel == "thin":
        return rung_is_kept(kernel, layout)
    rows, one = np.arange(1), Rays(np.zeros((1, 3)), np.ones((1, 3)))
    traced = (rows, *in_arrays(one, Ledger.blank(1, 0)))
    if kernel == "mesh":
        facets = facets_of(window.with_cells((1, 1)), 2, "facet")
        return is_kept(trace_chunk, (facets.found_in, pack(facets.layout), *traced))
    sheet = pack(layout)
    return is_kept(straight_chunk_single, (sheet, in_single(sheet), *traced, np.empty_like(rows)))
