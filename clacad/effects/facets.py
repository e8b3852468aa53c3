"""Facets: the triangles of a mesh in place of the exact surfaces.

*Model.* Rung mesh instead of surfaces, `Setting.quads` per cell side. The rung decides; the effect is listed
so that facets always appear in a plan.
*Law.* Forecast of the rms direction error, per meridian then in quadrature: (n − 1) sqrt(F (σ_2² +
(σ_1/m)²)/2), F faces, σ_k = L/(√6 R_k) the slope error of lens k's facets of side L (derived in
`clacad.mesh`), m = −f2/f1.
*On when* the scene's rung is mesh.
"""

from __future__ import annotations

from math import hypot, sqrt

import numpy as np

from clacad.effects.engine.camera_light import turned_angles
from clacad.effects.engine.effect import Bound, Declaration, Effect, Setting, Situation, When
from clacad.optics.rays import Fate
from clacad.optics.surface import principal_radii
from clacad.sheet.vignetting import focal_ratio, thin_cells
from clacad.sheet.window import Window

NAME = "facets"


def effect(window: Window, setting: Setting) -> Effect:
    """Trace the mesh instead."""
    from clacad.mesh import tessellate

    return Effect(NAME, When.LAUNCH, rung="mesh", options={"mesh": tessellate(window, quads=setting.quads)})


def forecast(window: Window, quads: int) -> float:
    """Rms direction error, radians, added by facets of `quads` per cell side."""
    cells = thin_cells(window)
    error = 0.0
    for axis, m in enumerate(focal_ratio(window.thin)):
        side = float(np.ptp(cells.zone[:, axis])) / quads
        for face, body in ((f, b) for b in window.bodies for f in (b.front, b.back)):
            if face.array is None or face.array == 2:
                continue  # light is focused on a field lens: its facets leave the exit direction unchanged
            slope = side / (sqrt(6.0) * abs(principal_radii(face.surface)[axis]))
            error = hypot(error, (body.index - 1.0) * slope / (abs(m) if face.array == 0 else 1.0))
    return error


def bound(situation: Situation) -> Bound:
    """Error that facets would add on rung mesh."""
    quads = situation.setting.quads
    angle = forecast(situation.window, quads)
    return Bound(angle, 0.0, f"{quads} quads a cell side turn light by {angle:.2g} rad rms", 5.0)


def measured(situation: Situation) -> tuple[float, float]:
    """Rms angle of the light that obeys the law."""
    turned = turned_angles(situation, NAME, Fate.ALIVE)
    return float(np.sqrt(np.mean(turned**2))), 0.0


DECLARED = Declaration(NAME, effect, bound, measured, rung="mesh")
