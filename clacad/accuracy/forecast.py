"""What the accuracy table costs in processor seconds, by a model of one reference machine; see `clacad.rates`."""

from __future__ import annotations

from collections.abc import Sequence

from clacad.accuracy.measure import QUADS

TASK = "accuracy"


def seconds(rays: int, quads: Sequence[int] | None = None) -> float:
    """Processor seconds: the 50-digit trace and the STEP spot, the floors, rays through every row, facets laid out."""
    grids = tuple(quads or QUADS)
    return FIXED + PER_RAY_AND_GRID * rays * len(grids) + PER_QUAD * sum(q * q for q in grids)


FIXED = 16.0
PER_RAY_AND_GRID = 9e-6
PER_QUAD = 5e-4
