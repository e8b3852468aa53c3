"""Recipe "best": trade exact confocality on the axis for the least rms error over the field.

One variable, a common scale of all principal radii, at the separation that was asked for, because spherical
aberration moves best focus inward. The objective is the rms angle between traced rays and the law over the
bundle the checks use. Freeing the separation as well has no minimum: scaling radii and separation together
keeps the pair confocal while aberration falls with the cube of pitch/separation, so a search over both runs
away (to 175 times the asked separation for the paper's sheet).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.sobol import sobol
from clacad.base.types import Floats
from clacad.optics.law import angle_between
from clacad.prescription.parabasal import trace_pair
from clacad.prescription.radii import Pair2
from clacad.sheet.window import Window

if TYPE_CHECKING:
    from clacad.prescription.assemble import Intent

RAYS = 4096


def best_pair(intent: Intent, build: Callable[[Pair2, float], Window], thickness: Pair2) -> Window:
    """Find the scale of the radii that leaves the least rms law error, and build with it.

    Parameters
    ----------
    intent : Intent
    build : callable
        (thickness, scale of the radii) → Window.
    thickness : (T1, T2), lengths

    Returns
    -------
    Window
        Its recipe keeps the scale and the objective before and after.
    """
    bundle = _bundle(intent)

    def objective(point: Floats) -> float:
        return _law_rms(intent, build(thickness, 1.0 + float(point[0])), bundle)

    start = np.zeros(1)
    found, value = nelder_mead(objective, start, np.array([0.01]), 1e-4)
    scale = 1.0 + float(found[0])
    window = build(thickness, scale)
    left = {"scale": scale, "law_rms_start": objective(start), "law_rms_end": value}
    return replace(window, recipe={**window.recipe, **left})


def _bundle(intent: Intent) -> tuple[Floats, Floats]:
    """4096 Sobol rays over lens 1's cell and the cone of the field about its centre."""
    points = sobol(RAYS, 4)
    start = np.zeros((RAYS, 3))
    one = intent.lattice.with_count((1, 1))  # the same rays, so the same lens, for any number of cells
    start[:, :2] = one.over_cell(points[:, :2])
    slope = np.tan(intent.design.check.field) * np.sqrt(points[:, 2])
    azimuth = 2.0 * np.pi * points[:, 3]
    middle = np.array(_field_centre(intent))
    direction = np.stack(
        [middle[0] + slope * np.cos(azimuth), middle[1] + slope * np.sin(azimuth), np.ones(RAYS)], axis=1
    )
    return start, direction / np.linalg.norm(direction, axis=1, keepdims=True)


def _field_centre(intent: Intent) -> tuple[float, float]:
    """Slope at the middle of the field: the aperture slope, or the sheet's normal."""
    aperture = intent.design.lattice.aperture
    if intent.design.check.field_centre == "normal":
        return 0.0, 0.0
    if aperture == "aligned":
        return 0.0, 0.0
    if isinstance(aperture, tuple):
        return aperture
    separation = intent.design.pair.separation
    assert separation is not None
    focal = [separation / (1.0 - e) if e != 1.0 else 0.0 for e in intent.eta]
    offset = intent.turn @ np.array([intent.delta[0] * focal[0], intent.delta[1] * focal[1], separation])
    return float(offset[0] / offset[2]), float(offset[1] / offset[2])


def _law_rms(intent: Intent, window: Window, bundle: tuple[Floats, Floats]) -> float:
    """Rms angle to the law over rays that reach the partner's cell (radians)."""
    start, direction = bundle
    back = start - direction * (window.thin.separation / direction[:, 2:])
    place, out = trace_pair(window.bodies, window.shifts, back, direction)
    local = place[:, :2] - np.asarray(window.shifts[1])
    inside = np.ones(len(place), dtype=bool)
    for step, half in zip(window.lattice.steps, window.lattice.half_widths, strict=True):
        inside &= local @ np.asarray(window.lattice.offset(*step)) <= 2.0 * half * half
    error = angle_between(out, intent.law.refract(direction))
    error = error[inside & np.isfinite(error)]
    return float(np.sqrt(np.mean(error**2))) if len(error) else 1.0


def nelder_mead(
    function: Callable[[Floats], float], start: Floats, step: Floats, tolerance: float
) -> tuple[Floats, float]:
    """Minimise a function of few variables, deterministically.

    Stops when the simplex's values agree to `tolerance` relative and its size is below tolerance · step,
    or after 400 evaluations. After Nelder & Mead, Comput. J. 7, 308 (1965), standard coefficients.
    """
    points = [start, *(start + step * unit for unit in np.eye(len(start)))]
    simplex = sorted(((function(p), i, p) for i, p in enumerate(points)), key=lambda item: item[:2])
    used = len(simplex)
    while used < 400:
        best, worst = simplex[0], simplex[-1]
        size = max(float(np.max(np.abs((p - best[2]) / step))) for _, _, p in simplex[1:])
        if worst[0] - best[0] <= tolerance * abs(best[0]) and size <= 10.0 * tolerance:
            break
        centre = np.mean([p for _, _, p in simplex[:-1]], axis=0)
        trial = 2.0 * centre - worst[2]
        value, used = function(trial), used + 1
        if value < best[0]:
            far = 3.0 * centre - 2.0 * worst[2]
            far_value, used = function(far), used + 1
            value, trial = min((far_value, 0, far), (value, 1, trial), key=lambda item: item[:2])[::2]
        elif value >= simplex[-2][0]:
            trial = 0.5 * (centre + (trial if value < worst[0] else worst[2]))
            value, used = function(trial), used + 1
            if value >= worst[0]:
                shrunk = [best[2] + 0.5 * (p - best[2]) for _, _, p in simplex[1:]]
                simplex = [best, *((function(p), used + i, p) for i, p in enumerate(shrunk))]
                used += len(shrunk)
                simplex.sort(key=lambda item: item[:2])
                continue
        simplex[-1] = (value, used, trial)
        simplex.sort(key=lambda item: item[:2])
    return simplex[0][2], simplex[0][0]
