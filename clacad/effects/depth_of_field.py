"""Depth of field of the camera.

*Model.* Rays start from points of a disc of diameter `Setting.aperture` across the camera's axis. They pass
through the point where the pinhole's ray crosses the sharp plane, `Setting.focus` away along the axis.
*Law.* Points of the sharp plane stay sharp; étendue is kept (the disc is filled evenly).
*On* if and only if the aperture is not 0; a pinhole leaves out A |1/z − 1/z_f|.
"""

from __future__ import annotations

import numpy as np

from clacad.base.vectors import axes_across, unit
from clacad.effects.engine.effect import Bound, Declaration, Effect, Setting, Situation, When, disc
from clacad.optics.rays import Rays
from clacad.sheet.window import Window

NAME = "depth_of_field"
SALT = 4


def effect(window: Window, setting: Setting) -> Effect:
    """Distribute the starts of camera rays over the entrance and aim them at the sharp plane."""

    def launch(_: Window, rays: Rays) -> Rays:
        if setting.aperture == 0.0:
            return rays
        axis = unit(np.array(setting.axis))
        one, two = axes_across(axis, 1 if abs(axis[1]) < 0.9 else 0).T
        points = 0.5 * setting.aperture * disc(rays, setting.seed, SALT)
        offset = -(points[:, :1] * one + points[:, 1:] * two)
        reach = setting.focus / (rays.direction @ axis)
        sharp = rays.position + reach[:, None] * rays.direction
        start = rays.position + offset
        aim = (sharp - start) * np.sign(setting.focus)
        return Rays(start, aim / np.linalg.norm(aim, axis=1)[:, None], rays.wavelength)

    return Effect(NAME, When.LAUNCH, launch=launch)


def bound(situation: Situation) -> Bound:
    """A |1/z − 1/z_f| for the nearest and the farthest visible object."""
    setting = situation.setting
    if setting.aperture == 0.0:
        return Bound(0.0, 0.0, "the camera is a pinhole", 1.0)
    angle = setting.aperture * max(
        abs(1.0 / z - 1.0 / setting.focus) for z in (situation.near, situation.far)
    )
    why = (
        f"an entrance of {setting.aperture:g} blurs what is not at {setting.focus:g} by up to {angle:.2g} rad"
    )
    return Bound(angle, 0.0, why, 1.0)


def measured(situation: Situation) -> tuple[float, float]:
    """Largest blur angle (radians) by the camera's opening of the nearest and farthest objects.

    No radiance change.
    """
    setting, rays = situation.setting, situation.rays
    launch = effect(situation.window, setting).launch
    assert launch is not None
    moved = launch(situation.window, rays)
    axis = np.array(setting.axis)
    worst = 0.0
    for depth in (situation.near, min(situation.far, 1e9 * setting.focus)):
        places = []
        for bundle in (rays, moved):
            reach = (depth - (bundle.position - rays.position) @ axis) / (bundle.direction @ axis)
            places.append(bundle.position + reach[:, None] * bundle.direction)
        worst = max(
            worst, 2.0 * float(np.linalg.norm(places[1] - places[0], axis=1).max(initial=0.0)) / depth
        )
    return worst, 0.0


def stated(situation: Situation) -> bool:
    """Whether the camera has an opening."""
    return situation.setting.aperture > 0.0


DECLARED = Declaration(NAME, effect, bound, measured, stated=stated, camera=True)
