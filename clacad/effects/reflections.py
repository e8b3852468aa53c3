"""Light reflected inside and at the sheet: forward after two reflections, and back to the camera's side
after one.

*Model.* Every path of up to `Setting.order` partial reflections is split off deterministically and followed
exactly (`clacad.effects.engine.nonsequential`), with Fresnel's share at every face; it implies the losses of
`fresnel` on the straight path. In a trace, one row a ray, only those losses appear; the split paths are rows
of `clacad.effects.light_reaching_camera`.
*Law.* Shares of all paths, including those cut off beyond the order, sum to 1 without noise.
*On when* N(N − 1)/2 r0² D (forward, D the scene's contrast) or N r0 times the front world's brightness
exceeds the radiance that matters. *Cost* 1.75 N², compiled.
"""

from __future__ import annotations

from clacad.effects.engine.camera_light import light_with
from clacad.effects.engine.effect import Bound, Declaration, Effect, Setting, Situation
from clacad.effects.fresnel import NAME as FRESNEL
from clacad.effects.fresnel import effect as straight
from clacad.effects.fresnel import mean_loss
from clacad.optics.surface.fresnel_coefficients import normal_loss
from clacad.sheet.window import Window

NAME = "reflections"
COST = 1.75
"""Time of the split paths over the bare trace, per square of the number of faces (compiled, measured)."""


def effect(window: Window, setting: Setting) -> Effect:
    """The losses of the straight path."""
    own = straight(window, setting)
    return Effect(NAME, own.when, own.needs, own.apply, compiled=own.compiled)


def bound(situation: Situation) -> Bound:
    """First order in r0: forward pairs of faces, and every face once backwards; more for steeper rays."""
    n = situation.faces
    r = mean_loss(situation) / n
    if situation.setting.coating == "none":
        r = max(r, max(normal_loss(body.index) for body in situation.window.bodies))
    forward = 0.5 * n * (n - 1) * r * r * situation.contrast
    front = n * r * situation.front
    why = (
        f"two reflections send {0.5 * n * (n - 1) * r * r:.2g} of the light forward "
        f"(contrast {situation.contrast:.2g}), one sends {n * r:.2g} of the camera's side back"
    )
    return Bound(0.0, forward + front, why, COST * n * n)


def measured(situation: Situation) -> tuple[float, float]:
    """Light that split paths add: forward with the scene's contrast, back with that of the camera's side."""
    extra, own = light_with(situation, NAME), light_with(situation, FRESNEL)
    n = max(len(situation.met), 1)
    back = extra.direction[:, 2] < 0.0
    front = float(extra.flux[back].sum()) / n
    forward = (float(extra.flux[~back].sum()) - float(own.flux.sum())) / n
    return 0.0, forward * situation.contrast + front * situation.front


DECLARED = Declaration(NAME, effect, bound, measured, splits=True, loses=True, includes=(FRESNEL,))
