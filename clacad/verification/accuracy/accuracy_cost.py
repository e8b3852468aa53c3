"""What the accuracy table costs in processor seconds, by a model of one reference machine; see `clacad.base.machine_rates`."""

from __future__ import annotations

from collections.abc import Sequence

from clacad.verification.accuracy.measure_rungs import QUADS

TASK = "accuracy"


def seconds(rays: int, bodies: int, quads: Sequence[int] | None = None) -> float:
    """Processor seconds: the 50-digit trace, the STEP spot and the floors; rays through every row; facets laid out."""
    grids = tuple(quads or QUADS)
    each = 1.55 + 8.4e-6 * rays * len(grids) + 1.35e-4 * sum(q * q for q in grids)
    return 0.4 + bodies * each
