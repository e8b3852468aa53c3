"""Ghosts: light that left through another lenslet than its partner's.

*Model.* Geometry finds it (fate GHOST, order); the effect makes it visible as light. Off: black.
*Law.* Orders partition the rays: the partner's share and all ghosts' add up to the light that passes
(`clacad.sheet.vignetting.share`), and order m leaves with the slope that `clacad.sheet.vignetting.ghost_step`
gives.
*On when* the share of ghost light exceeds the radiance that matters. *Cost* none: they are traced anyway.
"""

from __future__ import annotations

from math import degrees

import numpy as np

from clacad.effects.engine.effect import Bound, Declaration, Effect, Setting, Situation, When
from clacad.effects.engine.homogeneous_light import shares
from clacad.optics.rays import Fate
from clacad.sheet.vignetting import aperture_slope, ghost_onset, thin_cells
from clacad.sheet.window import Window

NAME = "ghosts"


def effect(window: Window, setting: Setting) -> Effect:
    """No pass: the rays carry their label, and `light_reaching_camera` includes their light."""
    return Effect(NAME, When.EXIT)


def bound(situation: Situation) -> Bound:
    """1 − V of the light that passes, closed form over the camera's rays, or as counted on the probe."""
    if situation.window.baffle is not None:
        return Bound(0.0, 0.0, "a baffle stops every ghost", 1.0)
    counted = situation.share(Fate.GHOST)
    closed = closed_share(situation)
    cells = thin_cells(situation.window)
    centre = np.array([*aperture_slope(situation.window), 1.0])
    away = np.abs(situation.slopes - cells.slopes(centre[None, :])).max(axis=0, initial=0.0)
    onset = ghost_onset(cells)
    axis = int(np.argmax(away - np.array(onset)))
    why = (
        f"{degrees(away[axis]):.2g}° of the view lies off the middle of the field, ghosts begin at "
        f"{degrees(onset[axis]):.2g}°; {counted:.2%} of the light meets a wrong lenslet"
    )
    return Bound(0.0, max(closed, situation.most(counted) if counted > 0.0 else 0.0), why, 1.0)


def closed_share(situation: Situation) -> float:
    """Mean of (zone share − V) over the camera's rays, thin lenses."""
    if len(situation.met) == 0:
        return 0.0
    cells = thin_cells(situation.window)
    return float(max(0.0, cells.part - shares(cells, situation.slopes, (0, 0)).mean()))


DECLARED = Declaration(NAME, effect, bound, shows=Fate.GHOST)
