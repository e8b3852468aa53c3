"""The light a picture needs: for every camera ray, the rays that carry radiance to it.

A trace gives one row per ray. A picture may need more than one (a ghost on the homogeneous sheet, a split
path) or none (a ghost that is not shown). `light_reaching_camera` returns them as one flat list.

Rung law has no cells: every ray carries the closed-form share of the light that stays with its partner, and
with `ghosts` one further ray per ghost order (`clacad.effects.engine.homogeneous_light`).

The change that an effect makes is measured on the scene's probe rays, traced with it and without.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from clacad.base.types import Bools, Floats, Rung
from clacad.effects.engine.effect import Declaration, Effect, Setting, Situation
from clacad.effects.engine.homogeneous_light import LightRays, join_light, law_light
from clacad.effects.engine.passes import trace_with
from clacad.effects.engine.split_paths import reflected_paths
from clacad.effects.registry import declared_all
from clacad.light.compare import angles
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.sheet.need_window import need_one_eta
from clacad.sheet.window import Window

MANY = 50_000
"""Number of rays above which split paths are compiled: loading the code costs as much as some thousand
rays.
"""


def light_reaching_camera(
    window: Window,
    rays: Rays,
    rung: Rung,
    effects: Sequence[str | Effect] = (),
    setting: Setting | None = None,
    **options: Any,
) -> tuple[LightRays, TraceResult]:
    """Trace camera rays and return the light that they collect.

    Parameters
    ----------
    effects : names of the effects that are on, or `Effect`
    setting : Setting
        Their parameters.
    options
        Passed on to `clacad.tracing.trace.trace`.

    Returns
    -------
    light : LightRays
        ALIVE and LAND rays; GHOST with `ghosts`; WALL and TIR with `walls` and `tir_paths`; split paths with
        `reflections`. Rays that miss the sheet are not listed: the caller knows what surrounds it.
    result : TraceResult
        One row a ray.
    """
    setting = setting or Setting()
    names = tuple(effect if isinstance(effect, str) else effect.name for effect in effects)
    kinds = declared_all(names)
    ghosts = any(kind.shows is Fate.GHOST for kind in kinds)
    result = trace_with(window, rays, rung, effects, setting=setting, **options)
    if rung == "law":
        if ghosts:
            need_one_eta(
                window,
                "ghosts on rung law",
                "rungs thin and surfaces trace those of cells with an eta of their own",
            )
        return law_light(window, rays, result, ghosts), result
    rows = np.flatnonzero(shining(result, names))
    light = LightRays(rows, result.position[rows], result.direction[rows], result.flux[rows])
    if any(kind.splits for kind in kinds) and rung in ("surfaces", "mesh"):
        compiled = options.get("path") == "numba" or (options.get("path") != "numpy" and len(rays) > MANY)
        light = join_light(
            light, reflected_paths(window, rays, result, replace(setting, active=names), compiled)
        )
    return light, result


def shining(result: TraceResult, names: Sequence[str]) -> Bools:
    """Which rows of a trace carry light, given the effects that are on, (n,)."""
    fates = {Fate.ALIVE, Fate.LAND, *(kind.shows for kind in declared_all(names) if kind.shows is not None)}
    return np.isin(result.fate, list(fates)) & (result.flux > 0.0)


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
