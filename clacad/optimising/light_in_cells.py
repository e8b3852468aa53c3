"""Light that a search must keep in the cells of lens 2.

Rays that miss their partner's cell are lost to the law, and so to the error that a search reduces: a search that could
lose them would throw light away to look sharp. `ShareOfLight` holds the share of the cones that before and after are
compared over. `LightInCells` holds the full field of a sheet with a field lens, where a weaker field lens looks sharper.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import atan

import numpy as np

from clacad.base.types import Floats
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

MOST_LOST = 0.02
"""Share of the light of a cone that a design which is written may lose, compared with the start."""

SHARE_ROOM = 0.5 * MOST_LOST
"""Share that a trial may lose: less than `MOST_LOST`, because the rays of a search are few."""

BORDER = 0.02
"""Width of the border, in parts of half a cell, over which a ray counts in part: a share of whole rays has no slope."""


@dataclass(frozen=True, eq=False)
class ShareOfLight:
    """Cones of rays over one cell, and the share of each that landed in the cell of lens 2 as the search began.

    cones : tuple of Rays
    before : (c,)
        Share of each cone.
    """

    cones: tuple[Rays, ...]
    before: Floats

    @staticmethod
    def of(window: Window, fields: Sequence[float], centre: str) -> ShareOfLight:
        """Of the window that a search starts from; half angles of the cones in radians, about the `centre` of checks."""
        one = window.with_cells((1, 1))
        cones = tuple(bundle(one, RAYS, field, centre).rays for field in fields)
        return ShareOfLight(cones, _shares(window, cones))

    def slack(self, window: Window) -> float:
        """Least share that a cone may still lose, in parts of the room; below 0: it lost more than the room."""
        return 1.0 - float((self.before - _shares(window, self.cones)).max()) / SHARE_ROOM


def _shares(window: Window, cones: Sequence[Rays]) -> Floats:
    """Share (c,) of the rays of each cone that land in the cell of lens 2."""
    rays = Rays(np.concatenate([c.position for c in cones]), np.concatenate([c.direction for c in cones]))
    inside = np.clip(0.5 - _way_out(window, rays) / BORDER, 0.0, 1.0)
    return np.asarray(inside.reshape(len(cones), -1).mean(axis=1))


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
    return float(np.clip(_way_out(window, rays), 0.0, LOST).mean())


def _way_out(window: Window, rays: Rays) -> Floats:
    """Way (n,) from the border of lens 2's cell to where rays land, in half widths; negative inside, `LOST` of lost rays."""
    seen = trace_sequence(interfaces(window), rays, record=True)
    assert seen.hits is not None  # recorded
    last = max(number for number, face in enumerate(window.faces) if face.array == 1)
    local = seen.hits[last][:, :2] - np.asarray(window.shifts[1])
    out = np.full(len(rays), -LOST)
    for step, half in zip(window.lattice.steps, window.lattice.half_widths, strict=True):
        across = local @ np.asarray(window.lattice.offset(*step)) / (2.0 * half)
        out = np.maximum(out, across / half - 1.0)
    return np.where(seen.fate == Fate.ALIVE, out, LOST)
