"""Rays that are sent into a stack: over a cell of the first sheet and a square of slopes, or from a point before it."""

from __future__ import annotations

from math import tan

import numpy as np

from clacad.base.sobol import sobol
from clacad.base.types import Floats
from clacad.optics.rays import Rays
from clacad.sheet.bundle import central_cell, middle_direction
from clacad.sheet.stack import Stack


def launch(stack: Stack, points: Floats, field: float) -> tuple[Floats, Floats]:
    """Places (n, 2) on the first lens plane and slopes (n, 2), from points (n, 4) of the unit cube; lengths of the stack."""
    first = stack.sheets[0]
    window = first.window
    centre = window.lattice.centres(np.array([central_cell(window)]))[0] + np.asarray(window.shifts[0])
    middle = middle_direction(window)
    slope = middle[:2] / middle[2] + (2.0 * points[:, 2:] - 1.0) * tan(field)
    return first.scale * (window.lattice.over_cell(points[:, :2]) + centre), slope


def launched(stack: Stack, rays: int, field: float) -> Rays:
    """Rays over one cell of the first sheet and a square of slopes, begun before it; lengths of the stack."""
    return started(stack, *launch(stack, sobol(rays, 4), field))


def started(stack: Stack, place: Floats, slope: Floats) -> Rays:
    """Rays that cross the first lens plane at places (n, 2) with slopes (n, 2), begun before the material."""
    first = stack.sheets[0]
    level = first.lens_planes[0]
    back = level - first.span[0] + first.scale * max(first.window.lattice.pitch)
    start = np.column_stack([place - back * slope, np.full(len(place), level - back)])
    return Rays(start, np.column_stack([slope, np.ones(len(place))]))


def cone(stack: Stack, points: Floats, field: float, distance: float) -> tuple[Floats, Floats]:
    """Places and slopes (n, 2) on the first lens plane of light from a point over its middle, within field and lattice."""
    window = stack.sheets[0].window
    where = launch(stack, np.full((1, 4), 0.5), 0.0)[0][0]
    x0, x1, y0, y1 = window.lattice.extent()
    room = np.array([min(x1 - where[0], where[0] - x0), min(y1 - where[1], where[1] - y0)])
    reach = np.minimum(distance * tan(field), np.maximum(room, 0.0))
    place = (2.0 * points - 1.0) * reach
    return place + where, place / distance
