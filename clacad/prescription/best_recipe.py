"""Recipe "best": gives up exact confocality on the axis for the least rms error over the field.

The one unknown of `clacad.optics.fit` is a common scale of all principal radii, at the requested separation,
because spherical aberration moves best focus inward. The residuals are those of traced rays to the law over
the bundle of the checks, restricted to rays that reach the partner's cell through the initial pair. With the
separation as a second unknown there is no minimum. Scaling radii and separation together keeps the pair
confocal while aberration falls with the cube of pitch/separation. A search over both runs away (to 175 times
the requested separation for the paper's sheet).

Residual of a recipe: law error and decollimation of a built window along its axis ray.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import inf

import numpy as np

from clacad.base.types import Bools, Floats
from clacad.optics.fit import AskedLight, law_residuals, minimise
from clacad.optics.law import angle_between
from clacad.optics.rays import Fate, Rays
from clacad.optics.sequence import STEP, parabasal, trace_sequence
from clacad.prescription.cell_heights import window_range
from clacad.prescription.intent import Intent
from clacad.sheet.asked_focus import asked_power
from clacad.sheet.bundle import bundle
from clacad.sheet.telescopelet import interfaces
from clacad.sheet.window import Window

RAYS = 4096


def best_scale(intent: Intent, build: Callable[[float], Window]) -> Window:
    """Find the scale of the radii with the least rms law error, and build with it.

    Parameters
    ----------
    intent : Intent
    build : callable
        Scale of the radii → Window.

    Returns
    -------
    Window
        Its recipe records the scale and the rms error before and after (radians).
    """
    start = build(1.0)
    light = _light(intent, start)

    def residuals(scale: Floats) -> Floats:
        return law_residuals(interfaces(build(float(scale[0]))), light)

    scale = float(minimise(residuals, np.ones(1))[0])
    window = build(scale)
    left = {
        "confocal": "best",
        "scale": scale,
        "law_rms_start": float(np.linalg.norm(law_residuals(interfaces(start), light))),
        "law_rms_end": float(np.linalg.norm(law_residuals(interfaces(window), light))),
    }
    return replace(window, recipe={**window.recipe, **left})


def _light(intent: Intent, window: Window) -> AskedLight:
    """Bundle of the checks over one cell: the same rays, and the same lens, for any number of cells."""
    one = window.with_cells((1, 1))
    one = replace(one, z_range=window_range(one))  # the rays start below it
    check = intent.design.check
    rays = bundle(one, RAYS, check.field, check.field_centre).rays
    kept = _to_partner(window, rays)
    if kept.any():
        rays = Rays(rays.position[kept], rays.direction[kept])
    return AskedLight.of(rays, window.law.refract(rays.direction))


def _to_partner(window: Window, rays: Rays) -> Bools:
    """Which rays (n,) reach the partner's cell."""
    seen = trace_sequence(interfaces(window), rays)
    local = seen.position[:, :2] - np.asarray(window.shifts[1])
    good = seen.fate == Fate.ALIVE
    for step, half in zip(window.lattice.steps, window.lattice.half_widths, strict=True):
        good &= local @ np.asarray(window.lattice.offset(*step)) <= 2.0 * half * half
    return np.asarray(good)


def residual(window: Window, rotation: Floats, origin: Floats, asked: Floats) -> dict[str, float]:
    """Parabasal law error (radians) and decollimation over half a cell (radians) of a window, minus requested
    power.

    Parameters
    ----------
    rotation : (3, 3)
        Lens → sheet of the requested law: its axis is the axis ray before the window.
    origin : (3,)
        A point of the axis ray, sheet frame, lengths.
    `asked` : (3,) unit
        Direction of the axis ray behind the window by the law.

    Returns
    -------
    dict
        Both are infinite where the axis ray is lost.
    """
    found = parabasal(interfaces(window), rotation, origin, STEP * window.lattice.circumradius)
    if not (np.isfinite(found.direction).all() and np.isfinite(found.cosines).all()):
        # the axis ray misses a lens or is totally reflected:
        # the window is built and fails its checks, no error here
        return {"law": inf, "decollimation": inf}
    half = 0.5 * max(window.lattice.pitch)
    return {
        "law": float(angle_between(found.direction, asked)),
        "decollimation": float(np.linalg.norm(found.cosines + np.diag(asked_power(window)), 2)) * half,
    }
