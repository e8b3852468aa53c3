"""Light reflected inside and at the sheet: forward after two reflections, and back to the camera's side after one.

*Model.* Every path of up to `Setting.order` partial reflections is split off deterministically and followed
exactly (`clacad.effects.follow`), with Fresnel's share at every face; it implies the losses of `fresnel` on the
straight path. In a trace, one row a ray, only those losses appear; the split paths are rows of `clacad.effects.lit`.
*Law.* Shares of all paths, what was cut off beyond the order included, sum to 1 without noise.
*On when* N(N − 1)/2 r0² D (forward, D the scene's contrast) or N r0 times the front world's brightness exceeds the
radiance that matters. *Cost* 6 and up.
"""

from __future__ import annotations

import numpy as np

from clacad.effects.fresnel import effect as straight
from clacad.effects.interface import normal_loss
from clacad.effects.passes import Effect
from clacad.effects.setting import Setting
from clacad.effects.situation import Bound, Situation
from clacad.rays import Fate
from clacad.sheet import Window

NAME = "reflections"
COST = 12.0


def effect(window: Window, setting: Setting) -> Effect:
    """The losses of the straight path."""
    own = straight(window, setting)
    return Effect(NAME, own.stage, own.needs, own.apply, compiled=own.compiled)


def bound(situation: Situation) -> Bound:
    """First order in r0: forward pairs of faces, and every face once backwards; steeper rays reflect more."""
    n = situation.faces
    r0 = max(normal_loss(body.index) for body in situation.window.bodies)
    r = max(r0, steepest_loss(situation) / n)
    forward = 0.5 * n * (n - 1) * r * r * situation.contrast
    front = n * r * situation.front
    why = (
        f"two reflections send {0.5 * n * (n - 1) * r * r:.2g} of the light forward "
        f"(contrast {situation.contrast:.2g}), one sends {n * r:.2g} of the camera's side back"
    )
    return Bound(0.0, forward + front, why, COST)


def steepest_loss(situation: Situation) -> float:
    """Largest share lost by reflection by a probe ray that passes: 0 for a perfect coating."""
    from clacad.effects.fresnel import losses

    lost = losses(situation)
    lost = lost[np.isfinite(lost)]
    passing = int((situation.probe.fate <= Fate.LAND).sum())
    return float(lost.mean()) if passing else 0.0
