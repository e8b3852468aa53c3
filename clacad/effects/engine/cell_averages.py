"""Averages over a cell for some effects: thickness of a body, height of its steps."""

from __future__ import annotations

import numpy as np

from clacad.base.types import Floats
from clacad.sheet.like_cell import like_cell
from clacad.sheet.representative_cells import representative_cells
from clacad.sheet.vignetting import focal_ratio
from clacad.sheet.window import Body, Face, Window, column, face_height, optical_tile

GRID = 33


def cell_points(window: Window) -> Floats:
    """Points (m, 2) spread evenly over the optical zone of a cell, cell frame."""
    tile = optical_tile(window)
    low, high = tile.min(axis=0), tile.max(axis=0)
    steps = (np.arange(GRID) + 0.5) / GRID
    grid = np.stack(np.meshgrid(*(a + (b - a) * steps for a, b in zip(low, high, strict=True))), -1)
    points = grid.reshape(-1, 2)
    following = np.roll(tile, -1, axis=0)
    inside = np.ones(len(points), dtype=bool)
    for (ax, ay), (bx, by) in zip(tile, following, strict=True):
        inside &= (bx - ax) * (points[:, 1] - ay) - (by - ay) * (points[:, 0] - ax) >= 0.0
    return points[inside]


def mean_thickness(window: Window, body: Body) -> float:
    """Mean extent of a body along z for light near the axis, length.

    In a non-uniform sheet of a sample of cells.

    Lens 1's light arrives at lens 2 as a copy scaled by m = −f2/f1 per meridian. Only |m| of lens 2 is lit
    where |m| < 1; only 1/|m| of lens 1 is transmitted where |m| > 1.
    """
    if not window.uniform:
        return _over_cells(window, window.bodies.index(body))
    m = np.abs(focal_ratio(window.thin))
    scale = np.ones(2)
    arrays = {face.array for face in (body.front, body.back)}
    if 0 in arrays and 1 not in arrays:
        scale = np.minimum(1.0, 1.0 / m)
    elif 1 in arrays and 0 not in arrays:
        scale = np.minimum(1.0, m)
    elif 2 in arrays:  # light of one direction is a point there
        scale = np.zeros(2)
    turn = window.thin.rotation[:2, :2]
    points = (cell_points(window) @ turn * scale) @ np.linalg.inv(turn)
    front, back = _heights(window, body, *points.T)
    return float(np.nanmean(np.maximum(back - front, 0.0)))


def _over_cells(window: Window, number: int) -> float:
    """Mean thickness of a body over cells spread over the sheet; kept with the window."""
    kept: dict[int, float] = window.kept.setdefault("mean_thickness", {})
    if number not in kept:
        likes = [like_cell(window, cell, widest=False) for cell in representative_cells(window, "sample")]
        kept[number] = float(np.mean([mean_thickness(like, like.bodies[number]) for like in likes]))
    return kept[number]


def _heights(window: Window, body: Body, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    if body.columnar:
        return column(window, body, x, y)
    return face_height(window, body.front, x, y), face_height(window, body.back, x, y)


def mean_steps(window: Window) -> float:
    """Σ over faces and cell directions of mean step height over the cell's width.

    Where two cells meet, both have their own height of the face along the common border. Light of slope t
    loses at most about t times the mean step over the pitch there.
    """
    lattice = window.lattice
    total = 0.0
    for face in window.faces:
        if face.array is None:
            continue
        for step, half in zip(lattice.steps[: len(lattice.steps) // 2], lattice.half_widths):
            total += _mean_step(window, face, np.array(lattice.offset(*step))) / (2.0 * half)
    return total


def _mean_step(window: Window, face: Face, offset: Floats) -> float:
    """Mean |height here − height there| along the border towards the neighbour at `offset`."""
    length = float(np.hypot(*offset))
    normal = offset / length
    along = np.array([-normal[1], normal[0]])
    width = float(np.ptp(window.lattice.tile() @ along))
    if window.lattice.hexagonal:
        width = length / np.sqrt(3.0)
    places = (np.arange(GRID) + 0.5) / GRID - 0.5
    here = 0.5 * offset * (1.0 - 1e-9) + np.outer(places * width, along)
    there = here - offset * (1.0 - 1e-9)
    step = face_height(window, face, *here.T) - face_height(window, face, *there.T)
    return float(np.nanmean(np.abs(step))) if np.isfinite(step).any() else 0.0
