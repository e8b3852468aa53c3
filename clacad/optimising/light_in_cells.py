"""What a search with a field lens must not do: throw away light of the rim of the field to look sharp.

Rays of the full field that miss their partner's cell are lost to the law, and so to the error that a search makes small: a
weaker field lens would look sharper. So the way by which rays land outside the cell of lens 2 is held to what it was.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan

import numpy as np

from clacad.optics.rays import Fate, Rays
from clacad.optics.sequence import trace_sequence
from clacad.sheet.bundle import bundle
from clacad.sheet.telescopelet import interfaces
from clacad.sheet.vignetting import half_field, thin_cells
from clacad.sheet.window import Window

RAYS = 512

PART = 0.9
"""Of the full field, the cone of the rays."""

ROOM = 1e-5
"""Mean way out of the cell, in parts of half its width, by which a trial may be worse than the start."""

LOST = 1.0
"""Way out of the cell of a ray that does not get through."""


@dataclass(frozen=True, eq=False)
class LightInCells:
    """Rays of the full field, and how far out of their cells they landed as the search began.

    rays : Rays
    before : float
        Mean way beyond the border of lens 2's cell, in parts of half its width.
    """

    rays: Rays
    before: float

    @staticmethod
    def of(window: Window) -> LightInCells | None:
        """Of the window that a search starts from; None without a field lens."""
        if not window.thin.field:
            return None
        one = window.with_cells((1, 1))
        rays = bundle(one, RAYS, atan(PART * min(half_field(thin_cells(window))))).rays
        return LightInCells(rays, _beyond(window, rays))

    def slack(self, window: Window) -> float:
        """How much more light may land outside before the wall is passed, in parts of the room; below 0: passed."""
        return (self.before + ROOM - _beyond(window, self.rays)) / ROOM


def _beyond(window: Window, rays: Rays) -> float:
    """Mean way (half widths of a cell) by which rays land beyond the border of lens 2's cell."""
    seen = trace_sequence(interfaces(window), rays, record=True)
    assert seen.hits is not None  # recorded
    last = max(number for number, face in enumerate(window.faces) if face.array == 1)
    local = seen.hits[last][:, :2] - np.asarray(window.shifts[1])
    out = np.zeros(len(rays))
    for step, half in zip(window.lattice.steps, window.lattice.half_widths, strict=True):
        across = local @ np.asarray(window.lattice.offset(*step)) / (2.0 * half)
        out = np.maximum(out, across / half - 1.0)
    out = np.where(seen.fate == Fate.ALIVE, np.minimum(out, LOST), LOST)
    return float(out.mean())
