"""Rays for a stack: over cells of the first sheet and a square of slopes, or from a point before it."""

from __future__ import annotations

from math import tan

import numpy as np

from clacad.base.sobol import sobol
from clacad.base.types import Floats, Ints, Pair2
from clacad.optics.rays import Rays
from clacad.sheet.representative_cells import central_cell
from clacad.sheet.stack import BadStack, Stack
from clacad.sheet.vignetting import aperture_slopes


def lit_cells(stack: Stack, zone: Pair2 | None = None) -> Ints:
    """Cells (n, 2) of the first sheet that are lit.

    zone : (width, height) or None, lengths of the stack
        Cells whose centres lie in it, about the centre of the sheet. None: every cell, or only the central
        one where all sheets are uniform and have one lattice, since it then represents every cell away from
        the edges.

    Raises
    ------
    BadStack
        No cell lies in the zone.
    """
    first = stack.sheets[0]
    if zone is None and _alike(stack):
        return np.array([central_cell(first.window)])
    cells = first.window.lattice.cells()
    if zone is None:
        return cells
    away = np.abs(first.scale * first.window.centres(0, cells))
    kept = cells[(away <= 0.5 * np.asarray(zone)).all(axis=1)]
    if not len(kept):
        low, high = first.scale * np.asarray(first.window.lattice.pitch)
        raise BadStack(
            f"zone {zone[0]:g} x {zone[1]:g}: no cell of the first sheet has its centre in it; "
            f"a zone of {2.0 * low:g} x {2.0 * high:g} holds some"
        )
    return kept


def _alike(stack: Stack) -> bool:
    """Whether one cell of the first sheet represents all: all sheets are uniform and have one lattice."""
    first = stack.sheets[0].window.lattice
    return all(
        one.window.uniform
        and one.window.lattice.kind == first.kind
        and np.allclose(one.scale * np.asarray(one.window.lattice.pitch), first.pitch, rtol=1e-9, atol=0.0)
        for one in stack.sheets
    )


def launch(stack: Stack, points: Floats, field: float, cells: Ints) -> tuple[Floats, Floats]:
    """Places (n, 2) on the first lens plane and slopes (n, 2), from points (n, 5) of the unit cube; lengths of the stack.

    Light fills each of the cells (m, 2), and a square of slopes about the centre of the field of each.
    """
    first = stack.sheets[0]
    window = first.window
    chosen = cells[(points[:, 4] * len(cells)).astype(np.int64)]
    slope = aperture_slopes(window, chosen) + (2.0 * points[:, 2:4] - 1.0) * tan(field)
    return first.scale * (window.lattice.over_cell(points[:, :2]) + window.centres(0, chosen)), slope


def launched(stack: Stack, rays: int, field: float) -> Rays:
    """Rays over the central cell of the first sheet and a square of slopes, starting before it; lengths of
    the stack.
    """
    middle = np.array([central_cell(stack.sheets[0].window)])
    return started(stack, *launch(stack, sobol(rays, 5), field, middle))


def started(stack: Stack, place: Floats, slope: Floats) -> Rays:
    """Rays that cross the first lens plane at places (n, 2) with slopes (n, 2), starting before the material."""
    first = stack.sheets[0]
    level = first.lens_planes[0]
    back = level - first.span[0] + first.scale * max(first.window.lattice.pitch)
    start = np.column_stack([place - back * slope, np.full(len(place), level - back)])
    return Rays(start, np.column_stack([slope, np.ones(len(place))]))


def middle_of_light(stack: Stack) -> Floats:
    """Centre (2,) of the central cell of the first sheet, lengths of the stack."""
    first = stack.sheets[0]
    return np.asarray(first.scale * first.window.centres(0, np.array(central_cell(first.window))))


def cone(stack: Stack, points: Floats, field: float, distance: float) -> tuple[Floats, Floats]:
    """Places and slopes (n, 2) on the first lens plane of light from a point on its axis, within field and
    lattice.
    """
    window = stack.sheets[0].window
    where = middle_of_light(stack)
    x0, x1, y0, y1 = window.lattice.extent()
    room = np.array([min(x1 - where[0], where[0] - x0), min(y1 - where[1], where[1] - y0)])
    reach = np.minimum(distance * tan(field), np.maximum(room, 0.0))
    place = (2.0 * points - 1.0) * reach
    return place + where, place / distance
