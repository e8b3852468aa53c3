"""Light through a window as built, measured and judged by every check by light.

In a non-uniform sheet one cell represents all: the cell whose light leaves farthest from the law. It is
chosen from
a sample over the sheet and from the cells whose lenses lie farthest out. Light of that cell's own field is
traced
through the whole sheet, neighbours included.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats
from clacad.checks.check import Check, found_by
from clacad.checks.light_kinds import DELTA, ETA, TILT
from clacad.light.measure import FEWEST, Light, Send, measure, measure_each
from clacad.optics.rays import Rays
from clacad.sheet.bundle import RequestedLaw, bundle, field_points
from clacad.sheet.vignetting import share, thin_cells
from clacad.sheet.window import Window
from clacad.tracing.worst_cell import SeenCell, through_all, tried_cells, worst_of

if TYPE_CHECKING:
    from clacad.design import Design

FIT_SCALE = 0.1
"""Aperture and field of the bundle on which η and δ are fitted, over those of the main bundle."""

POINT_RAYS = 4096
"""Rays of each of the nine field points."""


@dataclass(frozen=True, eq=False)
class Optics:
    """Results of all measurements with light on one object (exact surfaces, or a file's triangles).

    main : Light
        Over the cell and the cone of the field.
    points : tuple of Light
        Parallel light over the whole cell, from the middle of the field and eight directions of its rim.
    closed_form : (9,)
        Share of light of each of these directions, in closed form.
    narrow : Light
        Of the bundle on which η and δ are fitted.
    turn : Turn or None
        Turn of the lens meridians about the lens axis; None where no law could be fitted.
    """

    main: Light
    points: tuple[Light, ...]
    closed_form: Floats
    narrow: Light
    turn: Turn | None


@dataclass(frozen=True)
class Turn:
    """Turn of the lens meridians about the lens axis relative to the requested ones, measured with light.

    angle : radians
        In (−π/2, π/2]; positive means φ is larger than requested.
    doubt : radians
        Turn that the light unexplained by the fit could cause; infinite where η is the same in both
        meridians.
    """

    angle: float
    doubt: float


def optics_of(design: Design, window: Window, send: Send, rays: int, point_rays: int = POINT_RAYS) -> Optics:
    """Send the bundles of the checks through one object and measure their light.

    Parameters
    ----------
    design : Design
        Gives the field and its middle.
    window : Window
    send : callable
        Bundle → TraceResult.
    rays : int
        Rays of the main bundle; the fit takes a quarter.
    point_rays : int
        Rays of each of the nine field points.
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
    In the lens frame the law is affine in slopes, t' = J t + b; lenses turned by α about their axis have
    J = ½(1/η_x + 1/η_y) + ½(1/η_x − 1/η_y) [cos 2α, sin 2α; sin 2α, −cos 2α]. A turn α is therefore visible
    in
    first order. A lean of the axis is not: it shifts b alone, as δ does. Only squared slopes separate lean
    and δ,
    and aberration hides those.
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

    design : Design
        Gives the limits.
    window : Window
        The whole sheet.
    like : Window
        Uniform equivalent of the cell whose light was measured.
    optics : Optics
    """

    design: Design
    window: Window
    like: Window
    optics: Optics


def _named(seen: SeenCell, check: Check) -> Check:
    """The check with the cell named in its sentence."""
    if not seen.tried:
        return check
    i, j = seen.cell.tolist()
    words = f"in cell ({i}, {j}), the worst of {seen.tried} tried"
    if check.kind in (ETA, DELTA, TILT):
        words = f"over the light of {seen.tried} cells"
        laws = seen.window.cell_laws
        words += ", each taken by its own eta" if laws is not None and laws.ratios is not None else ""
    words += f": {check.sentence}"
    return replace(check, sentence=words, detail={**check.detail, "cell": [i, j], "tried": seen.tried})


def _fitted_over_all(optics: Optics, tried: list[SeenCell], field: float) -> Optics:
    """Optics with η, δ and turn fitted to light of the field centres of all cells, each lit in its own
    field.
    """
    rays, seen = through_all(tried, FIT_SCALE * field)
    into = Rays(rays.position, _as_in_the_middle(tried, rays.direction))
    narrow = Light(
        replace(optics.narrow.lit, rays=into, aperture=1.0), seen, RequestedLaw(tried[0].window.law), fewest=0
    )
    return replace(optics, narrow=narrow, turn=turn_of(narrow))


def _as_in_the_middle(tried: list[SeenCell], direction: Floats) -> Floats:
    """Directions (n, 3) of light of cells with their own laws, mapped to the equivalent input of the
    middle's law.

    With t' = (t − δ)/η, the effect of a cell on slope t equals that of the middle on (t − δ) η₀/η + δ₀.
    """
    law = tried[0].window.law
    if tried[0].window.cell_laws is None:
        return direction
    over = np.array(
        [[one.like.law.delta_x - law.delta_x, one.like.law.delta_y - law.delta_y] for one in tried]
    )
    lens, each = direction @ law.rotation, len(direction) // len(tried)
    if tried[0].window.cell_laws.ratios is None:
        lens[:, :2] -= np.repeat(over, each, axis=0) * lens[:, 2:]
    else:
        ratio = np.array([[law.eta_x / one.like.law.eta_x, law.eta_y / one.like.law.eta_y] for one in tried])
        shift = ratio * over + (ratio - 1.0) * (law.delta_x, law.delta_y)
        ratio, shift = (np.repeat(rows, each, axis=0) for rows in (ratio, shift))
        lens[:, :2] = ratio * lens[:, :2] - shift * lens[:, 2:]
    return np.asarray(lens @ law.rotation.T)


def judge_light(
    design: Design, window: Window, rays: int, point_rays: int = POINT_RAYS
) -> tuple[list[Check], Optics]:
    """Judge light through a window's exact surfaces by the limits of its design; rays as in `optics_of`."""
    tried = tried_cells(window, design.check.field)
    seen = worst_of(tried, design.check.field)
    optics = optics_of(design, seen.like, seen.send, rays, point_rays)
    if len(tried) > 1:
        optics = _fitted_over_all(optics, tried, design.check.field)
    lit = Lit(design, window, seen.like, optics)
    of_cell = [_named(seen, check) for judge in found_by("light") for check in judge(lit)]
    return [*of_cell, *(check for judge in found_by("sheet") for check in judge(lit))], optics
