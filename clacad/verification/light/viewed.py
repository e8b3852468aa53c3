"""Share of the light an eye sees from the whole sheet that obeys the law, over the sheet and as a mean.

The field of one cell is narrow. An eye near a wide sheet sees its border obliquely, where light enters
lenslets
other than the partner. The share is traced through the exact surfaces and computed in closed form of thin
lenses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.sobol import sobol
from clacad.base.types import Floats, Ints
from clacad.design.sections import AimedAt
from clacad.optics.rays import Fate, Rays
from clacad.sheet.feasibility.pitch_for_eye import VIEWING_DISTANCE
from clacad.sheet.vignetting import partner_share
from clacad.sheet.window import Window
from clacad.tracing.trace import trace

if TYPE_CHECKING:
    from clacad.design import Design

RAYS = 8192
"""Sobol rays over the whole sheet: the mean is within .004 (random rays: rms .5/√8192)."""

PLACES = 48
"""Cells along each side of the map over the sheet."""


FARTHEST = 1000.0
"""Pitches between a lens and the landing point of undeviated light; beyond, no lens reaches its partner: not
traced."""


@dataclass(frozen=True, eq=False)
class Viewed:
    """The share of one viewer's light that obeys the law.

    Attributes
    ----------
    viewer : (x, y, z), lengths
        Sheet frame.
    traced, thin : float
        Mean over the sheet: ALIVE rays over all rays that enter a cell, and the closed form of thin lenses.
    position : (n, 2) lengths
        Where each ray crosses z = 0.
    alive : (n,) bool
    """

    viewer: tuple[float, float, float]
    traced: float
    thin: float
    position: Floats
    alive: Floats


def viewer_of(design: Design) -> tuple[float, float, float]:
    """Position of the eye: on the axis as in [check] viewer; else the aim point of the cells; else 1 m
    before the sheet.
    """
    distance, _ = design.viewing_places
    aperture = design.lattice.aperture
    if distance is None and isinstance(aperture, AimedAt):
        return aperture.point
    return 0.0, 0.0, -(VIEWING_DISTANCE if distance is None else distance) / design.unit_m


def viewed(window: Window, viewer: tuple[float, float, float], rays: int = RAYS) -> Viewed:
    """Trace light of a viewer through a whole sheet.

    Parameters
    ----------
    window : Window
    viewer : (x, y, z), lengths
        Sheet frame; light starts there if z < 0 (before the sheet), and goes towards it if z > 0.
    rays : int
        Sobol points over all cells; fewer where an outline omits cells, but at least a quarter.
    """
    points = sobol(rays, 4)
    cells, kept = _kept_cells(window, points[:, :2])
    inside = window.lattice.over_cell(points[kept, 2:])
    place = window.centres(0, cells) + inside
    slope = _slopes(place, viewer)
    ray = np.column_stack([slope, np.ones(len(slope))])
    before = window.z_range[0] - max(window.lattice.pitch)
    start = np.column_stack([place + before * slope, np.full(len(slope), before)])
    near = np.hypot(*slope.T) * window.thin.separation <= FARTHEST * min(window.lattice.pitch)
    alive = np.zeros(len(slope), dtype=bool)
    alive[near] = trace(window, Rays(start[near], ray[near]), path="size").fate == Fate.ALIVE
    return Viewed(viewer, float(alive.mean()), _thin_share(window, cells, viewer), place, alive)


def thin_share(window: Window, viewer: tuple[float, float, float], cells: int = 2048) -> float:
    """Mean share of the viewer's light that obeys the law, thin lenses, over `cells` cells."""
    drawn, _ = _kept_cells(window, sobol(cells, 2))
    return _thin_share(window, drawn, viewer)


def _thin_share(window: Window, cells: Ints, viewer: tuple[float, float, float]) -> float:
    slope = _slopes(window.centres(0, cells), viewer)
    return float(partner_share(window, cells, np.column_stack([slope, np.ones(len(slope))])).mean())


def share_map(
    window: Window, viewer: tuple[float, float, float]
) -> tuple[Floats, tuple[float, float, float, float]]:
    """Thin share (PLACES, PLACES), [y, x], NaN outside the sheet, and its (x_min, x_max, y_min, y_max),
    lengths.
    """
    x0, x1, y0, y1 = window.lattice.extent()
    y, x = np.meshgrid(
        *(np.linspace(a, b, 2 * PLACES + 1)[1::2] for a, b in ((y0, y1), (x0, x1))), indexing="ij"
    )
    cells, _, _ = window.lattice.locate(x.ravel(), y.ravel())
    slope = _slopes(window.centres(0, cells), viewer)
    found = partner_share(window, cells, np.column_stack([slope, np.ones(len(slope))]))
    return np.where(window.lattice.contains(cells), found, np.nan).reshape(x.shape), (x0, x1, y0, y1)


def _slopes(place: Floats, viewer: tuple[float, float, float]) -> Floats:
    x, y, z = viewer
    return np.asarray((place - (x, y)) / -z)


def _kept_cells(window: Window, unit_square: Floats) -> tuple[Ints, Ints]:
    """Kept cells (k, 2), spread evenly over the sheet by points (n, 2), and the indices (k,) of their
    points.
    """
    lattice = window.lattice
    n1, n2 = lattice.count
    i, j = (np.floor(unit_square * (n1, n2)).astype(np.int64)).T
    drawn = np.stack([i - j // 2 if lattice.hexagonal else i, j], axis=-1)
    found = np.flatnonzero(lattice.contains(drawn))
    if 4 * len(found) >= len(drawn):
        return drawn[found], found
    cells = lattice.cells()  # the outline keeps few of the lattice's cells
    return cells[np.floor(unit_square[:, 0] * len(cells)).astype(np.int64)], np.arange(len(drawn))
