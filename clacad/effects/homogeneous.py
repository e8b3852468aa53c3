"""Light through the homogeneous sheet: the law's direction, with the share that lenslets would let through.

Where a picture point covers many lenslets, a ray stands for the light of all of them: a share V goes where the law
says, and shares V_m into ghost orders m, whose slopes differ from the law's by a constant. Both are closed forms of
the thin pair (`clacad.vignetting`).
"""

from __future__ import annotations

from math import ceil

import numpy as np
from numpy.typing import NDArray

from clacad.effects.shine import Light, joined
from clacad.rays import Fate, Rays, TraceResult
from clacad.sheet import Window
from clacad.vignetting import ThinCells, clip, ghost_step, thin_cells

Floats = NDArray[np.float64]

FAINT = 1e-6
"""Shares below this are not listed."""

KNOTS = 65
"""Slopes a side at which shares of cells that are no rectangles along the lens axes are tabulated."""


def law_light(window: Window, rays: Rays, result: TraceResult, ghosts: bool) -> Light:
    """Light of the rays that cross the sheet on rung law."""
    rows = np.flatnonzero(result.fate == Fate.ALIVE)
    cells = thin_cells(window)
    slopes = cells.slopes(rays.direction[rows])
    parts = [_order(window, cells, result, rows, slopes, (0, 0))]
    if ghosts and window.baffle is None:
        parts += [_order(window, cells, result, rows, slopes, order) for order in orders(cells, slopes)]
    return joined(*parts)


def _order(
    window: Window, cells: ThinCells, result: TraceResult, rows: NDArray[np.intp], slopes: Floats,
    order: tuple[int, int],
) -> Light:  # fmt: skip
    flux = result.flux[rows] * shares(cells, slopes, order)
    direction = result.direction[rows]
    if order != (0, 0):
        rotation = window.thin.rotation
        turned = direction @ rotation
        with np.errstate(divide="ignore", invalid="ignore"):
            out = np.column_stack([turned[:, :2] / turned[:, 2:] - ghost_step(cells, order), np.ones(len(rows))])
        direction = (out / np.sqrt((out * out).sum(axis=1))[:, None]) @ rotation.T
        flux = np.where(direction[:, 2] > 0.0, flux, 0.0)
    kept = flux > FAINT
    return Light(rows[kept], result.position[rows[kept]], direction[kept], flux[kept])


def orders(cells: ThinCells, slopes: Floats) -> list[tuple[int, int]]:
    """Ghost orders that light of these slopes can reach."""
    if not len(slopes):
        return []
    reach = cells.separation * slopes
    low = reach.min(axis=0) + cells.image.min(axis=0) + cells.zone.min(axis=0) - cells.centre
    high = reach.max(axis=0) + cells.image.max(axis=0) + cells.zone.max(axis=0) - cells.centre
    steps = np.array([cells.neighbour((1, 0)), cells.neighbour((0, 1))]) - cells.centre
    corners = np.array([[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])])
    indices = corners @ np.linalg.inv(steps)
    bounds = [(int(np.floor(indices[:, k].min())), ceil(indices[:, k].max())) for k in (0, 1)]
    listed = [(i, j) for i in range(bounds[0][0], bounds[0][1] + 1) for j in range(bounds[1][0], bounds[1][1] + 1)]
    return [order for order in listed if order != (0, 0)]


def shares(cells: ThinCells, slopes: Floats, order: tuple[int, int]) -> Floats:
    """Share (m,) of the light of lens-frame slopes (m, 2) that goes into an order.

    A product of two overlaps where cells are rectangles along the lens axes; else interpolated in a table of
    overlaps of polygons.
    """
    shift = cells.separation * slopes - cells.neighbour(order)
    if _is_box(cells.zone) and _is_box(cells.image):
        near = np.maximum(cells.zone.min(axis=0), cells.image.min(axis=0) + shift)
        far = np.minimum(cells.zone.max(axis=0), cells.image.max(axis=0) + shift)
        part = np.clip(far - near, 0.0, None) / np.ptp(cells.image, axis=0)
        return np.asarray(cells.part * part[:, 0] * part[:, 1])
    return _interpolated(cells, shift)


def _is_box(polygon: Floats) -> bool:
    if len(polygon) != 4:
        return False
    sides = np.abs(np.roll(polygon, -1, axis=0) - polygon)
    return bool((sides.min(axis=1) <= 1e-9 * sides.max()).all())


def _interpolated(cells: ThinCells, shift: Floats) -> Floats:
    """Overlap of image and zone against their relative shift, bilinear in a table over all that overlaps."""
    reach = np.maximum(np.abs(cells.zone).max(axis=0) + np.abs(cells.image).max(axis=0), 1e-300)
    knots = np.linspace(-1.0, 1.0, KNOTS)
    table = np.array([[_overlap(cells, (a * reach[0], b * reach[1])) for b in knots] for a in knots])
    place = (np.clip(shift / reach, -1.0, 1.0) + 1.0) * 0.5 * (KNOTS - 1)
    low = np.minimum(place.astype(np.intp), KNOTS - 2)
    u, v = (place - low).T
    i, j = low.T
    return np.asarray(
        (1 - u) * ((1 - v) * table[i, j] + v * table[i, j + 1])
        + u * ((1 - v) * table[i + 1, j] + v * table[i + 1, j + 1])
    )


def _overlap(cells: ThinCells, shift: tuple[float, float]) -> float:
    return cells.part * _area(clip(cells.image + np.array(shift), cells.zone)) / _area(cells.image)


def _area(polygon: Floats) -> float:
    if len(polygon) < 3:
        return 0.0
    x, y = (polygon - polygon[0]).T
    return 0.5 * abs(float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)))
