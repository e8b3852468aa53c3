"""Walls: light that hits a bare step, a side wall, or a face from its wrong side.

*Model.* Such rays (fate WALL) are followed face by face: Snell's law at the wall, total reflection there
included, up to `Setting.faces` further faces. Off: they end, black. Light through land, web and holes (fate
LAND) goes on with or without the effect; it is a label of geometry.
*Law.* A followed ray leaves or ends exactly once: shares sum to 1 (`clacad.effects.engine.nonsequential`).
*On when* the share of WALL light exceeds the radiance that matters.

Paths after total internal reflection.

*Model.* Rays that a face reflects totally (fate TIR) go on inside the body, up to `Setting.faces` faces,
until they leave. Off: they end, black.
*Law.* No light is lost at total reflection: shares of a followed ray sum to 1.
*On when* the share of TIR light exceeds the radiance that matters.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from clacad.effects.engine.effect import (
    Bound,
    Declaration,
    Effect,
    FaceCrossing,
    RayBlock,
    Setting,
    Situation,
    When,
)
from clacad.optics.rays import Fate
from clacad.sheet.window import Window

WALLS, TIR_PATHS = "walls", "tir_paths"

SMOOTH = 1e-9
"""Share below which steps count as rounding."""


def followed(name: str, fate: Fate, _: Window, setting: Setting) -> Effect:
    """Follow rays that ended with a fate.

    Rows that leave get their last point, direction and flux, the others flux 0.
    """

    def apply(block: RayBlock, _: FaceCrossing | None) -> None:
        from clacad.effects.engine.camera_light import trace_ended_rays

        trace_ended_rays(block, setting, fate)

    return Effect(name, When.EXIT, apply=apply)


def bound(situation: Situation) -> Bound:
    """Share of WALL light: Σ (mean step / pitch)·slope plus the area not covered by lenses, or as counted."""
    counted = situation.share(Fate.WALL)
    t = float(np.abs(situation.slopes).max(initial=0.0))
    estimate = step_share(situation.window) * t
    # a few probe rays may all miss existing walls; without a step there is none to miss
    radiance = situation.most(counted) if counted > 0.0 or estimate > SMOOTH else 0.0
    land = situation.share(Fate.LAND)
    why = f"{counted:.2%} of the light meets a wall" + (
        f"; {land:.2%} passes land and is shown" if land else ""
    )
    return Bound(0.0, radiance, why, 1.0 + 30.0 * counted)


def step_share(window: Window) -> float:
    """Σ over borders of mean step height over pitch, summed over the faces: WALL share per unit of slope."""
    from clacad.effects.engine.probe_rays import mean_steps

    return mean_steps(window)


def bound_of_total(situation: Situation) -> Bound:
    """Share of light that ends in fate TIR on the probe."""
    counted = situation.share(Fate.TIR)
    radiance = situation.most(counted) if counted > 0.0 else 0.0
    return Bound(0.0, radiance, f"{counted:.2%} of the light is reflected totally", 1.0 + 30.0 * counted)


DECLARED = (
    Declaration(WALLS, partial(followed, WALLS, Fate.WALL), bound, shows=Fate.WALL, follows=True),
    Declaration(
        TIR_PATHS, partial(followed, TIR_PATHS, Fate.TIR), bound_of_total, shows=Fate.TIR, follows=True
    ),
)
