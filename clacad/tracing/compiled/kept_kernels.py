"""Whether the kernels of a rung are on disk, so that its first trace loads them instead of compiling."""

from __future__ import annotations

from typing import Any

import numpy as np

from clacad.base.kernel_cache import is_kept
from clacad.base.types import Rung
from clacad.optics.law import law_numbers
from clacad.optics.rays import Rays
from clacad.tracing.compiled.surfaces import packed
from clacad.tracing.compiled.threads import in_arrays
from clacad.tracing.layout import Layout
from clacad.tracing.ledger import Ledger


def rung_is_kept(rung: Rung, layout: Layout) -> bool:
    """Whether the kernel that traces this rung without a record is on disk; argument types alone decide."""
    one = Rays(np.zeros((1, 3)), np.ones((1, 3)))
    sheet, rows, left = packed(layout), np.arange(1), np.empty(1, dtype=np.intp)
    traced = (rows, *in_arrays(one, Ledger.blank(1, 0)))
    if rung in ("surfaces", "mesh"):
        from clacad.tracing.compiled.chunk import trace_chunk

        return is_kept(trace_chunk, (None, sheet, *traced))
    kernel, optics = _ideal(rung, layout)
    return is_kept(kernel, (sheet, optics, *traced, left))


def _ideal(rung: Rung, layout: Layout) -> tuple[Any, Any]:
    """Kernel of rung law or thin, and the numbers of its optics."""
    if rung == "law":
        from clacad.tracing.compiled.law_rung import law_chunk

        return law_chunk, law_numbers(layout.window.law)
    from clacad.tracing.compiled.thin import thin_chunk, thin_pair

    return thin_chunk, thin_pair(layout)[1]
