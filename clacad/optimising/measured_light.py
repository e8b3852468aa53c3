"""Fresh rays through a sheet, none of them a search's: the errors that before and after are compared by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clacad.base.sobol import sobol
from clacad.design import Design
from clacad.optics.law import angle_between
from clacad.optics.rays import Fate
from clacad.sheet.bundle import central_cell, cone, launched, middle_direction
from clacad.sheet.window import Window

FRESH = 16384
FIELDS = (0.5, 1.0, 2.0)
"""Parts of the field at which start and end are compared: what is best at one is not at another."""


@dataclass(frozen=True)
class Seen:
    """Fresh rays through a sheet: field (radians), rms error to the law (radians), share that gets to its partner cell."""

    field: float
    law_rms: float
    throughput: float


def measured(window: Window, field: float, design: Design) -> Seen:
    """Fresh rays through the sheet as it is traced everywhere else; field in radians."""
    from clacad.tracing.trace import trace

    small = window.with_cells((3, 3))
    points = sobol(FRESH, 4, skip=FRESH)
    middle = middle_direction(small, design.check.field_centre)
    light = launched(small, small.lattice.over_cell(points[:, :2]), cone(middle, field, points[:, 2:]),
                     central_cell(small), middle, field)  # fmt: skip
    seen = trace(small, light.rays, path="numpy")
    good = (seen.fate == Fate.ALIVE) & (seen.order == 0).all(axis=1)
    error = angle_between(seen.direction[good], window.law.refract(light.rays.direction[good]))
    rms = float(np.sqrt(np.mean(error**2))) if good.any() else float("nan")
    return Seen(field, rms, float(good.mean()))
