"""Measured change by an effect: the scene's probe rays traced with it and without."""

from __future__ import annotations

import numpy as np

from clacad.base.types import Floats
from clacad.effects.engine.bounds import Situation
from clacad.effects.engine.camera_light import light_reaching_camera
from clacad.effects.engine.effect import Declaration
from clacad.effects.engine.homogeneous_light import LightRays
from clacad.effects.engine.passes import trace_with
from clacad.light.compare import angles
from clacad.optics.rays import Fate, TraceResult

MOST = 0.99
"""Share of the light over which the largest change of direction is taken."""


def measure(situation: Situation, kind: Declaration) -> tuple[float, float]:
    """Change of direction (radians) and of radiance (relative) that an effect makes.

    Returns
    -------
    angle : float
        As defined by the effect's `measured`: the largest of 99 % of the light (a few rays at borders change
        lenslets without changing order), the largest, the rms, or the angle that contains half of the light.
    radiance : float
        Mean over the rays on the sheet of the light added or removed; light redirected by reflection
        counts with the contrast and brightness of the scene that it then comes from.
    """
    if kind.measured is not None:
        return kind.measured(situation)
    return 0.0, radiance_change(situation, kind.name)


def radiance_change(situation: Situation, name: str) -> float:
    """Mean change (relative) of the light that reaches the camera from the rays on the sheet."""
    n = len(situation.rays)
    before, after = (
        np.bincount(light.parent, weights=light.flux, minlength=n)
        for light in (light_with(situation), light_with(situation, name))
    )
    return float(np.abs(after - before)[situation.met].mean())


def traced_with(situation: Situation, *names: str) -> TraceResult:
    """The probe rays with these effects, by exact surfaces; reproducible to the bit."""
    window, rays = situation.window, situation.rays
    return trace_with(window, rays, "surfaces", names, setting=situation.setting, path="size")


def light_with(situation: Situation, *names: str) -> LightRays:
    """The light that reaches the camera with these effects, by exact surfaces."""
    window, rays = situation.window, situation.rays
    return light_reaching_camera(window, rays, "surfaces", names, situation.setting, path="size")[0]


def turned_angles(situation: Situation, name: str, last: Fate = Fate.GHOST) -> Floats:
    """Angles (k,), radians, by which an effect deflects rays that pass with fates up to `last`.

    Without such rays the result is (1,) zero.
    """
    turned = angles(traced_with(situation), traced_with(situation, name), last)
    return turned if len(turned) else np.zeros(1)
