"""Cells of a face that bound all others: lenses displaced farthest, smallest, largest, lowest or highest."""

from __future__ import annotations

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.sheet.cell_places import extreme_cells
from clacad.sheet.window import Face, Window, lens_height, lens_height_and_normal, optical_tile

ALONG = 9
"""Number of points on a side of a cell at which lenses are compared."""
BLOCK = 1 << 14
"""Number of cells compared at a time."""


def outermost_cells(window: Window, face: Face) -> Ints:
    """List kept cells (m, 2) whose lenses bound those of all cells of a non-uniform face."""
    assert face.change is not None
    cells = extreme_cells(face.change, window.lattice)
    if face.change.size is None:
        return cells
    kept = window.lattice.cells()
    ends = np.concatenate(
        [_range_in(window, face, kept[first : first + BLOCK]) for first in range(0, len(kept), BLOCK)]
    )
    low, high = np.nan_to_num(ends[:, 0], nan=np.inf), np.nan_to_num(ends[:, 1], nan=-np.inf)
    outer = [int(np.argmin(low)), int(np.argmax(high))]
    return np.unique(np.concatenate([cells, kept[outer]]), axis=0)


def _range_in(window: Window, face: Face, cells: Ints) -> Floats:
    """Lowest and highest height (n, 2) of a lens in each cell (n, 2):
    on the cell's borders, or at the level point.
    """
    assert face.array is not None
    tile = optical_tile(window, face.array)
    t = np.linspace(0.0, 1.0, ALONG)[:-1, None, None]
    sides = ((1.0 - t) * tile + t * np.roll(tile, -1, axis=0)).reshape(-1, 2)
    places = window.lenses(face, cells[:, None])
    x, y = places.seen(*sides.T[:, None])
    heights = places.raised(lens_height(face, x.ravel(), y.ravel()).reshape(x.shape))
    level = level_point(window, face)
    if level is not None and places.size is not None:
        x, y, z = (
            apex + places.size * (at - vertex)
            for apex, at, vertex in zip(places.apex, level, face.vertex, strict=True)
        )
        low, high = tile.min(axis=0), tile.max(axis=0)
        inside = (low[0] <= x) & (x <= high[0]) & (low[1] <= y) & (y <= high[1])
        heights = np.concatenate([heights, np.where(inside, z, np.nan)], axis=1)
    return np.column_stack([np.fmin.reduce(heights, axis=1), np.fmax.reduce(heights, axis=1)])


def level_point(window: Window, face: Face) -> tuple[float, float, float] | None:
    """Point where a lens is level, its highest or lowest point, cell frame; None where it has none.

    Newton iteration on the height's gradient, which is small and smooth on a lenslet.
    """
    if face.untilted:
        return face.vertex
    x, y = face.vertex[0], face.vertex[1]
    step = 1e-5 * window.lattice.circumradius
    for _ in range(8):
        px = x + np.array([0.0, step, -step, 0.0, 0.0])
        py = y + np.array([0.0, 0.0, 0.0, step, -step])
        _, normal = lens_height_and_normal(face, px, py)
        slope = -normal[:, :2] / normal[:, 2:]
        jacobian = np.stack([slope[1] - slope[2], slope[3] - slope[4]], axis=1) / (2.0 * step)
        if not np.isfinite(jacobian).all() or abs(np.linalg.det(jacobian)) < 1e-300:
            return None
        dx, dy = np.linalg.solve(jacobian, -slope[0])
        x, y = x + float(dx), y + float(dy)
    z = float(lens_height(face, np.array([x]), np.array([y]))[0])
    return (x, y, z) if np.isfinite([x, y, z]).all() else None
