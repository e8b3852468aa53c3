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

from clacad.base.types import Floats
from clacad.optics.law import angle_between
from clacad.optics.rays import Fate, Rays
from clacad.optics.sequence import trace_sequence
from clacad.prescription.cell_heights import window_range
from clacad.prescription.radii import Pair2
from clacad.sheet.bundle import bundle
from clacad.sheet.telescopelet import interfaces
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
    light = _light(intent, build(thickness, 1.0))

    def objective(point: Floats) -> float:
        return _law_rms(build(thickness, 1.0 + float(point[0])), light)

    start = np.zeros(1)
    found, value = nelder_mead(objective, start, np.array([0.01]), 1e-4)
    scale = 1.0 + float(found[0])
    window = build(thickness, scale)
    left = {"scale": scale, "law_rms_start": objective(start), "law_rms_end": value}
    return replace(window, recipe={**window.recipe, **left})


def _light(intent: Intent, window: Window) -> Rays:
    """The bundle of the checks over one cell: the same rays, so the same lens, for any number of cells."""
    one = window.with_cells((1, 1))
    one = replace(one, z_range=window_range(one))  # the rays start below it
    check = intent.design.check
    return bundle(one, RAYS, check.field, check.field_centre).rays


def _law_rms(window: Window, light: Rays) -> float:
    """Rms angle to the law over rays that reach the partner's cell (radians)."""
    seen = trace_sequence(interfaces(window), light)
    local = seen.position[:, :2] - np.asarray(window.shifts[1])
    good = seen.fate == Fate.ALIVE
    for step, half in zip(window.lattice.steps, window.lattice.half_widths, strict=True):
        good &= local @ np.asarray(window.lattice.offset(*step)) <= 2.0 * half * half
    error = angle_between(seen.direction, window.law.refract(light.direction))[good]
    error = error[np.isfinite(error)]
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
