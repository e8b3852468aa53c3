"""Errors over independent rays, not those of the search, for the comparison of start and end."""

from __future__ import annotations

from dataclasses import dataclass

from clacad.base.sobol import sobol
from clacad.design import Design
from clacad.light.measure import measure
from clacad.sheet.asked_focus import RequestedLaw
from clacad.sheet.bundle import cone, launched, middle_direction
from clacad.sheet.representative_cells import central_cell
from clacad.sheet.window import Window

FRESH = 16384
FIELDS = (0.5, 1.0, 2.0)
"""Shares of the field at which start and end are compared; the best faces depend on the field."""


@dataclass(frozen=True)
class Seen:
    """Result of independent rays: field (radians), rms error to the law (radians), share in the partner cell."""

    field: float
    law_rms: float
    throughput: float


def measured(window: Window, field: float, design: Design) -> Seen:
    """Trace independent rays through the sheet, with the tracer of the checks; field in radians."""
    from clacad.tracing.trace import trace

    small = window.with_cells((3, 3))
    points = sobol(FRESH, 4, skip=FRESH)
    middle = middle_direction(small, design.check.field_centre)
    light = launched(small, small.lattice.over_cell(points[:, :2]), cone(middle, field, points[:, 2:]),
                     central_cell(small), middle, field)  # fmt: skip
    found = measure(
        lambda lit: trace(small, lit.rays, path="numpy"), light, RequestedLaw(window.law), fewest=1
    )
    return Seen(field, found.rms, found.share)
