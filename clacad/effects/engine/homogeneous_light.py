"""Light through the homogeneous sheet: the law's direction, with the share that lenslets would transmit.

Where a picture point covers many lenslets, one ray represents the light of all of them. A share V follows the
law. Shares V_m go into ghost orders m, whose slopes differ from the law's by a constant. Both are closed
forms of the thin pair (`clacad.sheet.vignetting`).

Rays that carry radiance to the camera, as one flat list: the common result of all kinds of light.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import NDArray

from clacad.base.polygons import polygon_area
from clacad.base.types import Floats, Ints, Rows
from clacad.optics.ledger import RayColumns
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.sheet.need_window import need_one_eta
from clacad.sheet.vignetting import (
    ThinCells,
    arrivals,
    ghost_step,
    off_partner,
    partner_step,
    partner_zone,
    scale_of_image,
    share_of_zone,
    thin_cells,
)
from clacad.sheet.window import Window


@dataclass(frozen=True, eq=False)
class LightRays(RayColumns):
    """Rays that carry radiance from the scene to the camera.

    Attributes
    ----------
    parent : (m,) ints
        The launched ray whose picture point receives the light.
    position, direction : (m, 3), sheet frame
        Point where the ray leaves the sheet and its unit direction; d_z < 0 goes back to the camera's side.
    flux : (m,)
        Factor on the radiance at which the ray ends.
    """

    parent: Rows
    position: Floats
    direction: Floats
    flux: Floats

    def __len__(self) -> int:
        return len(self.flux)


FAINT = 1e-6
"""Shares below this are not listed."""


def law_light(window: Window, rays: Rays, result: TraceResult, ghosts: bool) -> LightRays:
    """Light of the rays that pass the sheet on rung law.

    Raises CellsDiffer: Ghosts of cells with an eta of their own.
    """
    if ghosts:
        other = "rungs thin and surfaces trace those of cells with an eta of their own"
        need_one_eta(window, "ghosts on rung law", other)
    rows = np.flatnonzero(result.fate == Fate.ALIVE)
    cells = thin_cells(window)
    slopes = cells.slopes(rays.direction[rows])
    index = None if window.uniform else result.cell[rows].astype(np.int64)
    parts = [_order(window, cells, result, (rows, index), slopes, (0, 0))]
    if ghosts and window.baffle is None:
        met = orders(cells, slopes, index)
        parts += [_order(window, cells, result, (rows, index), slopes, order) for order in met]
    return LightRays.joined(parts)


def _order(
    window: Window,
    cells: ThinCells,
    result: TraceResult,
    chosen: tuple[NDArray[np.intp], Ints | None],
    slopes: Floats,
    order: tuple[int, int],
) -> LightRays:
    """Light of one order, from rays, rows (k,), cells of a non-uniform sheet, lens-frame slopes (k, 2)."""
    rows, index = chosen
    flux = result.flux[rows] * shares(cells, slopes, order, index)
    kept = np.flatnonzero(flux > FAINT)  # most rays reach but a few of the orders that some ray reaches
    rows, flux = rows[kept], flux[kept]
    index = None if index is None else index[kept]
    direction = result.direction[rows]
    if order != (0, 0):
        rotation = window.thin.rotation
        turned = direction @ rotation
        with np.errstate(divide="ignore", invalid="ignore"):
            out = np.column_stack(
                [turned[:, :2] / turned[:, 2:] + ghost_step(cells, order, index), np.ones(len(rows))]
            )
        direction = (out / np.sqrt((out * out).sum(axis=1))[:, None]) @ rotation.T
        ahead = direction[:, 2] > 0.0
        rows, flux, direction = rows[ahead], flux[ahead], direction[ahead]
    return LightRays(rows, result.position[rows], direction, flux)


def orders(cells: ThinCells, slopes: Floats, index: Ints | None = None) -> list[tuple[int, int]]:
    """Ghost orders that light of lens-frame slopes (m, 2) can reach.

    `index` (m, 2): cells of a non-uniform sheet.
    """
    if not len(slopes):
        return []
    reach = arrivals(cells, slopes) - cells.centre if index is None else off_partner(cells, index, slopes)
    zone = partner_zone(cells)
    low = reach.min(axis=0) + cells.image.min(axis=0) + zone.min(axis=0)
    high = reach.max(axis=0) + cells.image.max(axis=0) + zone.max(axis=0)
    steps = np.array([partner_step(cells, (1, 0)), partner_step(cells, (0, 1))])
    corners = np.array([[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])])
    indices = corners @ np.linalg.inv(steps)
    bounds = [(int(np.floor(indices[:, k].min())), ceil(indices[:, k].max())) for k in (0, 1)]
    listed = [
        (i, j) for i in range(bounds[0][0], bounds[0][1] + 1) for j in range(bounds[1][0], bounds[1][1] + 1)
    ]
    return [order for order in listed if order != (0, 0)]


def shares(cells: ThinCells, slopes: Floats, order: tuple[int, int], index: Ints | None = None) -> Floats:
    """Share (m,) of the light of lens-frame slopes (m, 2) that goes into an order; `index` as in `orders`."""
    if index is None:
        shift = arrivals(cells, slopes) - cells.neighbour(order)
    else:
        shift = off_partner(cells, index, slopes) - partner_step(cells, order)
    ratio = None if index is None else scale_of_image(cells, index)
    if ratio is None:
        found = cells.part / polygon_area(cells.image) * overlap(cells.image, partner_zone(cells), shift)
    else:
        found = share_of_zone(cells, shift, ratio)
    if index is None or order == (0, 0):
        return np.asarray(found)
    return np.where(cells.window.lattice.contains(index + np.array(order)), found, 0.0)


def overlap(moved: Floats, fixed: Floats, shift: Floats) -> Floats:
    """Area (n,) that two convex polygons share when the first is moved by each shift (n, 2).

    moved, fixed : (k, 2), (m, 2). Corners, counter-clockwise.

    Notes
    -----
    The border of the common area consists of the parts of each polygon's sides inside the other. Its area is
    half the sum of x dy − y dx along them: no corner is ever constructed. Coincident sides are counted once.
    For two rectangles along the axes it is the product of the overlaps on each axis.
    """
    low, high = fixed.min(axis=0) - moved.max(axis=0), fixed.max(axis=0) - moved.min(axis=0)
    meet = np.flatnonzero(((shift > low) & (shift < high)).all(axis=1))
    near, area = shift[meet], np.zeros(len(shift))
    if _upright(moved) and _upright(fixed):
        right = np.minimum(moved.max(axis=0) + near, fixed.max(axis=0))
        area[meet] = (right - np.maximum(moved.min(axis=0) + near, fixed.min(axis=0))).prod(axis=1)
    else:
        first = _along_sides(moved, fixed, near, closed=True)
        area[meet] = first + _along_sides(fixed, moved, -near, closed=False, origin=near)
    return area


def _upright(polygon: Floats) -> bool:
    """Whether a convex polygon (m, 2) is a rectangle along the axes."""
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    off = np.minimum(polygon - low, high - polygon)
    return len(polygon) == 4 and bool((np.abs(off) <= 1e-14 * (high - low)).all())


def _along_sides(
    polygon: Floats, other: Floats, shift: Floats, closed: bool, origin: Floats | None = None
) -> Floats:
    """½ ∮ (x dy − y dx), (n,), along the sides of a polygon moved by `shift`, as far as inside the other.

    `origin` is the reference point of the area: both polygons must use the same.
    """
    area = np.zeros(len(shift))
    normals = np.roll(other, -1, axis=0) - other
    inward = np.column_stack([-normals[:, 1], normals[:, 0]])
    for start, end in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        low, high = np.zeros(len(shift)), np.ones(len(shift))
        for corner, normal in zip(other, inward, strict=True):
            here = (start - corner + shift) @ normal
            speed = float((end - start) @ normal)
            if abs(speed) <= 1e-12 * float(np.hypot(*(end - start)) * np.hypot(*normal)):
                outside = here < 0.0 if closed else here <= 0.0
                high = np.where(outside, low, high)
            elif speed > 0.0:
                low = np.maximum(low, -here / speed)
            else:
                high = np.minimum(high, -here / speed)
        place = start + shift if origin is None else start + shift + origin
        along = end - start
        swept = place[:, 0] * along[1] - place[:, 1] * along[0]
        area += 0.5 * swept * np.maximum(high - low, 0.0)
    return area
