"""Curves of a report: exit slope against incident slope, along the two lens meridians."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from clacad.base.sobol import sobol
from clacad.base.types import Floats
from clacad.light.measure import measure
from clacad.optics.rays import Fate, TraceResult
from clacad.sheet.asked_focus import RequestedLaw
from clacad.sheet.bundle import Bundle, launched, middle_direction
from clacad.sheet.representative_cells import central_cell
from clacad.sheet.vignetting import half_field, share, thin_cells
from clacad.sheet.window import Window

DIRECTIONS = 49
PLACES = 768
MAP = 61
"""Positions across the cell, and directions, of the residual map."""


@dataclass(frozen=True, eq=False)
class Meridian:
    """Curves of one lens meridian over the whole field of view.

    slope : (k,) incident slopes along the lens axis, the other slope at the middle of the field
    law, mean, spread : (k,) exit slopes: the law's, the mean of the ALIVE rays, and the rms of those about it
    alive, closed_form, ghost : (k,) shares of light
    place : (m,) lengths across the cell, map_slope : (m,) slopes, residual : (m, m) radians
        Error of single rays in the meridian's plane, [direction, position]; NaN where the ray is not ALIVE.
    """

    slope: Floats
    law: Floats
    mean: Floats
    spread: Floats
    alive: Floats
    closed_form: Floats
    ghost: Floats
    place: Floats
    map_slope: Floats
    residual: Floats


def meridians(window: Window, send: Callable[[Bundle], TraceResult]) -> tuple[Meridian, Meridian]:
    """Trace fans of directions along lens x and lens y, each over the whole cell."""
    return _meridian(window, send, 0), _meridian(window, send, 1)


def _directions(window: Window, axis: int, slopes: Floats) -> Floats:
    """Directions (k, 3) whose slope along a lens axis is `slopes` off the middle of the field."""
    turn = window.thin.rotation
    cells = thin_cells(window)
    middle = cells.slopes(middle_direction(window)[None])[0]
    local = np.column_stack([np.tile(middle, (len(slopes), 1)), np.ones(len(slopes))])
    local[:, axis] += slopes
    found = local @ turn.T
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


def _meridian(window: Window, send: Callable[[Bundle], TraceResult], axis: int) -> Meridian:
    """The curves along lens x (axis 0) or lens y (1)."""
    cells, cell = thin_cells(window), central_cell(window)
    reach = min(half_field(cells)[axis], 1.0)
    offsets = np.linspace(-reach, reach, DIRECTIONS)
    direction = _directions(window, axis, offsets)
    places = window.lattice.over_cell(sobol(PLACES, 2))
    every, middle = np.repeat(direction, PLACES, axis=0), direction[DIRECTIONS // 2]
    result = send(launched(window, np.tile(places, (DIRECTIONS, 1)), every, cell, middle))
    fate = result.fate.reshape(DIRECTIONS, PLACES)
    alive = fate == Fate.ALIVE
    out = cells.slopes(np.where(alive.reshape(-1, 1), result.direction, [0.0, 0.0, 1.0]))[:, axis]
    out = np.where(alive, out.reshape(fate.shape), np.nan)
    enough = alive.sum(axis=1) >= 8
    with np.errstate(invalid="ignore", divide="ignore"):
        count = np.where(enough, alive.sum(axis=1), np.nan)
        mean = np.nansum(out, axis=1) / count
        spread = np.sqrt(np.nansum((out - mean[:, None]) ** 2, axis=1) / count)
    asked = window.law.refract(direction)
    law = np.full(DIRECTIONS, np.nan)
    known = np.isfinite(asked).all(axis=1)
    law[known] = cells.slopes(asked[known])[:, axis]
    place, map_slope, residual = _map(window, send, axis, reach)
    return Meridian(
        slope=cells.slopes(direction)[:, axis],
        law=law,
        mean=mean,
        spread=spread,
        alive=alive.mean(axis=1),
        closed_form=share(cells, direction),
        ghost=(fate == Fate.GHOST).mean(axis=1),
        place=place,
        map_slope=map_slope,
        residual=residual,
    )


def _map(
    window: Window, send: Callable[[Bundle], TraceResult], axis: int, reach: float
) -> tuple[Floats, Floats, Floats]:
    """Error of rays along a line across the cell in a lens meridian, for directions in the same plane."""
    along = window.thin.rotation[:2, axis]
    along = along / np.hypot(*along)
    half = min(window.lattice.half_widths) * 0.98  # a ray at the exact border may enter the neighbour
    place = np.linspace(-half, half, MAP)
    slopes = np.linspace(-reach, reach, MAP)
    direction = _directions(window, axis, slopes)
    lit = launched(
        window, np.tile(place[:, None] * along, (MAP, 1)), np.repeat(direction, MAP, axis=0), central_cell(window),
        direction[MAP // 2],
    )  # fmt: skip
    error = measure(send, lit, RequestedLaw.of(window)).error
    return place, thin_cells(window).slopes(direction)[:, axis], error.reshape(MAP, MAP)
