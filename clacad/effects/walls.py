"""Walls: light that hits a bare step, a side wall, or a face from its wrong side.

*Model.* Such rays (fate WALL) are followed face by face: Snell's law at the wall, total reflection there
included, up to `Setting.faces` further faces. Off: they end, black. Light through land, web and holes (fate
LAND) goes on with or without the effect; it is a label of geometry.
*Law.* A followed ray leaves or ends exactly once: shares sum to 1 (`clacad.effects.engine.nonsequential`).
*On when* the share of WALL light exceeds the radiance that matters.
"""

from __future__ import annotations

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

NAME = "walls"

SMOOTH = 1e-9
"""Share below which steps count as rounding."""


def effect(window: Window, setting: Setting) -> Effect:
    """Follow rays that ended at walls.

    Rows that leave get their last point, direction and flux, the others flux 0.
    """

    def apply(block: RayBlock, _: FaceCrossing | None) -> None:
        from clacad.effects.engine.camera_light import trace_ended_rays

        trace_ended_rays(block, setting, Fate.WALL)

    return Effect(NAME, When.EXIT, apply=apply)


def bound(situation: Situation) -> Bound:
    """Share of WALL light: Σ (mean step / pitch)·slope plus the area not covered by lenses, or as counted."""
    from clacad.effects.engine.probe_rays import mean_steps

    counted = situation.share(Fate.WALL)
    t = float(np.abs(situation.slopes).max(initial=0.0))
    estimate = mean_steps(situation.window) * t
    # a few probe rays may all miss existing walls; without a step there is none to miss
    radiance = situation.most(counted) if counted > 0.0 or estimate > SMOOTH else 0.0
    land = situation.share(Fate.LAND)
    why = f"{counted:.2%} of the light meets a wall" + (
        f"; {land:.2%} passes land and is shown" if land else ""
    )
    return Bound(0.0, radiance, why, 1.0 + 30.0 * counted)


DECLARED = Declaration(NAME, effect, bound, shows=Fate.WALL, follows=True)
