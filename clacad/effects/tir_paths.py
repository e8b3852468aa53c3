"""Paths after total internal reflection.

*Model.* Rays that a face reflects totally (fate TIR) go on inside the body, up to `Setting.faces` faces,
until they leave. Off: they end, black.
*Law.* No light is lost at total reflection: shares of a followed ray sum to 1.
*On when* the share of TIR light exceeds the radiance that matters.
"""

from __future__ import annotations

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

NAME = "tir_paths"


def effect(window: Window, setting: Setting) -> Effect:
    """Follow totally reflected rays; see `clacad.effects.walls.effect`."""

    def apply(block: RayBlock, _: FaceCrossing | None) -> None:
        from clacad.effects.engine.camera_light import trace_ended_rays

        trace_ended_rays(block, setting, Fate.TIR)

    return Effect(NAME, When.EXIT, apply=apply)


def bound(situation: Situation) -> Bound:
    """Share of light that ends in fate TIR on the probe."""
    counted = situation.share(Fate.TIR)
    radiance = situation.most(counted) if counted > 0.0 else 0.0
    return Bound(0.0, radiance, f"{counted:.2%} of the light is reflected totally", 1.0 + 30.0 * counted)


DECLARED = Declaration(NAME, effect, bound, shows=Fate.TIR, follows=True)
