"""Constraint that a search must keep light in the cells of lens 2.

Rays that miss their partner's cell do not count in the error. An unconstrained search would therefore lose
light to reduce the error. `ShareOfLight` constrains the cones over which start and end are compared.
`LightInCells` constrains the full field of a sheet with a field lens, where a weaker field lens looks
sharper.
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
"""Cone of the rays as a share of the full field."""

ROOM = 1e-5
"""Allowed increase of the mean distance outside the cell over that of the start, in half widths."""

LOST = 1.0
"""Distance outside the cell (half widths) that is assigned to a lost ray."""

MOST_LOST = 0.02
"""Largest share of the light of a cone that a written design may lose, compared with the start."""

SHARE_ROOM = 0.5 * MOST_LOST
"""Share that a trial may lose: less than `MOST_LOST`, because a search has few rays."""

BORDER = 0.02
"""Width of the border (half cells) in which a ray counts partly; a share of whole rays has no derivative."""


@dataclass(frozen=True, eq=False)
class ShareOfLight:
    """Cones of rays over one cell, and the share of each in the cell of lens 2 at the start of the search.

    cones : tuple of Rays
    before : (c,)
        Share of each cone.
    """

    cones: tuple[Rays, ...]
    before: Floats

    @staticmethod
    def of(window: Window, fields: Sequence[float], centre: str) -> ShareOfLight:
        """Constraint from the start window; half angles of the cones in radians, about the `centre` of
        checks.
        """
        one = window.with_cells((1, 1))
        cones = tuple(bundle(one, RAYS, field, centre).rays for field in fields)
        return ShareOfLight(cones, _shares(window, cones))

    def slack(self, window: Window) -> float:
        """Least share that a cone may still lose, over `SHARE_ROOM`; below 0: violated."""
        return 1.0 - float((self.before - _shares(window, self.cones)).max()) / SHARE_ROOM


def _shares(window: Window, cones: Sequence[Rays]) -> Floats:
    """Share (c,) of the rays of each cone that land in the cell of lens 2."""
    rays = Rays(np.concatenate([c.position for c in cones]), np.concatenate([c.direction for c in cones]))
    inside = np.clip(0.5 - _way_out(window, rays) / BORDER, 0.0, 1.0)
    return np.asarray(inside.reshape(len(cones), -1).mean(axis=1))


@dataclass(frozen=True, eq=False)
class LightInCells:
    """Rays of the full field, and their distance outside their cells at the start of the search.

    rays : Rays
    before : float
        Mean distance outside the border of lens 2's cell, in half widths.
    """

    rays: Rays
    before: float

    @staticmethod
    def of(window: Window) -> LightInCells | None:
        """Constraint from the start window; None without a field lens."""
        if not window.thin.field:
            return None
        one = window.with_cells((1, 1))
        rays = bundle(one, RAYS, atan(PART * min(half_field(thin_cells(window))))).rays
        return LightInCells(rays, _beyond(window, rays))

    def slack(self, window: Window) -> float:
        """Remaining increase of the mean distance outside the cell, over `ROOM`; below 0: violated."""
        return (self.before + ROOM - _beyond(window, self.rays)) / ROOM


def _beyond(window: Window, rays: Rays) -> float:
    """Mean distance (half widths of a cell) of rays outside the border of lens 2's cell."""
    return float(np.clip(_way_out(window, rays), 0.0, LOST).mean())


def _way_out(window: Window, rays: Rays) -> Floats:
    """Distance (n,) of rays from the border of lens 2's cell, in half widths; negative inside, `LOST` if
    lost.
    """
    seen = trace_sequence(interfaces(window), rays, record=True)
    assert seen.hits is not None  # recorded
    last = max(number for number, face in enumerate(window.faces) if face.array == 1)
    local = seen.hits[last][:, :2] - np.asarray(window.shifts[1])
    out = np.full(len(rays), -LOST)
    for step, half in zip(window.lattice.steps, window.lattice.half_widths, strict=True):
        across = local @ np.asarray(window.lattice.offset(*step)) / (2.0 * half)
        out = np.maximum(out, across / half - 1.0)
    return np.where(seen.fate == Fate.ALIVE, out, LOST)
