"""Light through a window as built, measured: bundles of the checks, and curves along the lens meridians.

In a non-uniform sheet one cell represents all: the cell whose light leaves farthest from the law. It is
chosen from a sample over the sheet and from the cells whose lenses lie farthest out. Light of that cell's own
field is traced through the whole sheet, neighbours included. The law is fitted to light of all these cells.

Curves: exit slope against incident slope, along the two lens meridians.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.sobol import sobol
from clacad.base.types import Floats, Ints
from clacad.light.measure import FEWEST, FIT_SCALE, Light, Send, measure, measure_each
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.sheet.bundle import Bundle, RequestedLaw, bundle, field_points, launched, middle_direction
from clacad.sheet.representative_cells import central_cell
from clacad.sheet.vignetting import half_field, share, thin_cells
from clacad.sheet.window import Window
from clacad.tracing.worst_cell import SeenCell, through_all

if TYPE_CHECKING:
    from clacad.design import Design

POINT_RAYS = 4096
"""Rays of each of the nine field points."""


@dataclass(frozen=True, eq=False)
class Optics:
    """Results of all measurements with light on one object (exact surfaces, or a file's triangles).

    main : Over the cell and the cone of the field.
    points : Parallel light over the whole cell, from the middle of the field and eight directions of its rim.
    closed_form : (9,). Share of light of each of these directions, in closed form.
    narrow : Of the bundle on which η and δ are fitted.
    turn : Turn of the lens meridians about the lens axis; None where no law could be fitted.
    """

    main: Light
    points: tuple[Light, ...]
    closed_form: Floats
    narrow: Light
    turn: Turn | None


@dataclass(frozen=True)
class Turn:
    """Turn of the lens meridians about the lens axis relative to the requested ones, measured with light.

    angle : radians. In (−π/2, π/2]; positive means φ is larger than requested.
    doubt : radians. Turn that the light unexplained by the fit could cause; infinite where η is the same in
        both meridians.
    """

    angle: float
    doubt: float


def optics_of(design: Design, window: Window, send: Send, rays: int, point_rays: int = POINT_RAYS) -> Optics:
    """Send the bundles of the checks through one object and measure their light.

    design : Gives the field and its middle.
    send : Bundle → TraceResult.
    rays : Rays of the main bundle; the fit takes a quarter.
    point_rays : Rays of each of the nine field points.
    """
    spec, law = design.check, RequestedLaw.of(window)
    main = measure(send, bundle(window, rays, spec.field, spec.field_centre), law)
    directions = field_points(window, spec.field, spec.field_centre)
    beams = [bundle(window, point_rays, 0.0, middle=direction) for direction in directions]
    # the fewest rays that count scale with those traced, so the same field points are too dark
    points = measure_each(send, beams, law, max(8, FEWEST * point_rays // POINT_RAYS))
    narrow = bundle(window, max(1024, rays // 4), FIT_SCALE * spec.field, spec.field_centre, FIT_SCALE)
    light = measure(send, narrow, law)
    return Optics(main, points, share(thin_cells(window), directions), light, turn_of(light))


def turn_of(light: Light) -> Turn | None:
    """Measure the turn of the lens meridians about the lens axis; None where no law can be fitted.

    The requested law gives the axis and the meridians, and which η belongs to which meridian.

    Notes
    -----
    In the lens frame the law is affine in slopes, t' = J t + b; lenses turned by α about their axis have J =
    ½(1/η_x + 1/η_y) + ½(1/η_x − 1/η_y) [cos 2α, sin 2α; sin 2α, −cos 2α]. A turn α is therefore visible in
    first order. A lean of the axis is not: it shifts b alone, as δ does. Only squared slopes separate lean
    and δ, and aberration hides those.
    """
    if light.fit is None:
        return None
    law, good = light.law.law, light.alive
    lens = (d[good] @ law.rotation for d in (light.lit.rays.direction, light.direction))
    slope, exit_slope = (d[:, :2] / d[:, 2:] for d in lens)
    slope = slope - slope.mean(axis=0)
    system = np.column_stack([slope, np.ones(len(slope))])
    found = np.linalg.lstsq(system, exit_slope, rcond=None)[0]
    rest = exit_slope - system @ found
    unlike = 1.0 / law.eta_x - 1.0 / law.eta_y
    sense = -1.0 if unlike < 0.0 else 1.0
    angle = 0.5 * np.arctan2(sense * (found[0, 1] + found[1, 0]), sense * (found[0, 0] - found[1, 1]))
    seen = abs(unlike) * float(np.sqrt(np.mean(slope**2, axis=0)).min())
    return Turn(float(angle), float(np.sqrt(np.mean(rest**2))) / seen if seen > 0.0 else inf)


@dataclass(frozen=True, eq=False)
class Lit:
    """Light through a window, to be judged: what every function of these checks takes.

    design : Gives the limits.
    window : The whole sheet.
    like : Uniform equivalent of the cell whose light was measured.
    cell : The cell whose light was measured.
    judged_only : Whether white light and temperature are measured only where the design limits them.
    """

    design: Design
    window: Window
    like: Window
    optics: Optics
    cell: SeenCell
    judged_only: bool = False


def fitted_over_all(optics: Optics, tried: list[SeenCell], field: float) -> Optics:
    """Optics with η, δ and turn fitted to light of all cells' field centres, each lit in its own field."""
    window, cells = tried[0].window, np.array([one.cell for one in tried])
    rays, seen = through_all(window, cells, FIT_SCALE * field)
    into = Rays(rays.position, _as_in_the_middle(window, cells, rays.direction))
    lit = replace(optics.narrow.lit, rays=into, aperture=1.0)
    narrow = Light(lit, seen, RequestedLaw(window.law), fewest=0)
    return replace(optics, narrow=narrow, turn=turn_of(narrow))


def _as_in_the_middle(window: Window, cells: Ints, direction: Floats) -> Floats:
    """Directions (n, 3) of light of cells with their own laws, mapped to the equivalent input of the middle's
    law: that which leaves by it as the light does by its cell's law.
    """
    if window.cell_laws is None:
        return direction
    own = np.repeat(cells, len(direction) // len(cells), axis=0)
    return window.law.inverse().refract(window.cell_laws.refract(window.lattice, own, direction))


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
        window,
        np.tile(place[:, None] * along, (MAP, 1)),
        np.repeat(direction, MAP, axis=0),
        central_cell(window),
        direction[MAP // 2],
    )
    error = measure(send, lit, RequestedLaw.of(window)).error
    return place, thin_cells(window).slopes(direction)[:, axis], error.reshape(MAP, MAP)
