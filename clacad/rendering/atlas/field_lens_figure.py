"""A window off its axis, with and without a field lens: the light that obeys the law, and the ghosts.

window-100mm (η = −1) is seen from 20 m, so all its rays have nearly one slope t. With ideal lenses a share
1 − |t| s/p of them finds its partner; the others leave with slopes that differ by p/f2. With a field lens at
the common focus all do, up to t = p/s.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from clacad.base.types import Floats
from clacad.optics.rays import Fate
from clacad.prescription.prescribe import prescribe
from clacad.rendering.atlas.finding import AtlasFinding
from clacad.rendering.atlas.paper_figures import RAYS, Figure, Loader
from clacad.rendering.picture import Picture, view_through
from clacad.rendering.screen_measure import WIDE, coordinate_scene, sheet_points
from clacad.rendering.sheet_passage import geometry_alone
from clacad.scene import Scene

ANGLES = (0.0, 1.5, 2.5)
"""Degrees off the sheet's normal at which the window is viewed."""

SIDE, PITCH, SEPARATION, BEHIND = 100.0, 0.5, 10.0, 300.0
"""Sizes of window-100mm, and the distance of the piece in its pictures, mm."""

MARK = np.array([1.0, 0.05, 0.5])
"""Colour of ghosts, linear sRGB."""

BRIGHTNESS = np.array([0.2126, 0.7152, 0.0722])
"""Luminance of linear sRGB primaries (IEC 61966-2-1)."""


def ghosts_marked(scene: Scene) -> Picture:
    """The picture of a still with ghosts in one colour, at their own brightness."""
    whole = view_through(scene, compiled=True)
    direct = view_through(replace(scene, effects=replace(scene.effects, mode="none", list=())), compiled=True)
    ghosts = (whole.light - direct.light) @ BRIGHTNESS
    return replace(whole, light=direct.light + ghosts[:, :, None] * MARK)


def _seen(scene: Scene, fate: Fate) -> tuple[float, Floats]:
    """Share of the rays on the sheet with a fate, and their displacements (n, 2), mm.

    A displacement leads from the point on the sheet to the crossing of the plane of the piece.
    """
    plain = coordinate_scene(scene, BEHIND, RAYS)
    passage = replace(geometry_alone(plain, direct=True), shining=(int(fate),))
    picture = view_through(plain, passage=passage, compiled=True)
    x0, inside = sheet_points(plain, prescribe(plain.design()), picture.light.shape[:2])
    light = picture.light.reshape(-1, 3)
    met = inside & (light[:, 2] > 0.5)
    return float(met.sum() / inside.sum()), (light[met, :2] - 0.5) * WIDE - x0[met]


def _share(slope: float, scene: Scene) -> float:
    """Share of the light by the law without a field lens: mean of the closed form over rays of the camera to the sheet."""
    aside = np.linspace(-0.5, 0.5, 201) * SIDE / -scene.camera.position[2]
    x, y = (
        float(np.clip(1.0 - np.abs(t + aside) * SEPARATION / PITCH, 0.0, 1.0).mean()) for t in (slope, 0.0)
    )
    return x * y


def _field(load: Loader) -> Iterator[AtlasFinding]:
    for angle in ANGLES:
        slope = float(np.tan(np.radians(angle)))
        for field_lens in (False, True):
            label = f"{angle:g} degrees, {'with' if field_lens else 'without'} a field lens"
            scene = load(_stem(angle, field_lens))
            share, there = _seen(scene, Fate.ALIVE)
            ghosts, aside = _seen(scene, Fate.GHOST)
            want = 1.0 if field_lens else _share(slope, scene)
            slack = (
                0.005 if field_lens else 0.04
            )  # spheres: a fiftieth of a cell's light errs over its border
            yield AtlasFinding(f"{label}: share of light by the law", share, want, slack)
            yield AtlasFinding(f"{label}: share of ghosts", ghosts, 1.0 - want, slack)
            if share > 0.1:
                middle = float(np.median(there[:, 0]))
                yield AtlasFinding(
                    f"{label}: light by the law leaves with the slope", middle / BEHIND, -slope, 0.003
                )
            if angle and not field_lens:
                beside = float(np.median(aside[:, 0])) / BEHIND + slope
                yield AtlasFinding(
                    f"{label}: slope of ghosts beside it", abs(beside), 2.0 * PITCH / SEPARATION, 0.004
                )


def _stem(angle: float, field_lens: bool) -> str:
    return f"{'field-lens' if field_lens else 'no-field-lens'}-{angle:g}"


def _label(angle: float, field_lens: bool) -> str:
    return f"{angle:g} degrees off the normal, {'with' if field_lens else 'without'} a field lens"


FIELD_LENS = Figure(
    "W1", "A field lens: window-100mm over its field",
    "Without it ghosts (drawn in pink) take the place of the light that obeys the law; with it all light obeys, up to 2.8 degrees.",
    tuple((_stem(angle, with_one), _label(angle, with_one)) for with_one in (False, True) for angle in ANGLES), _field,
    ghosts_marked=True,
)  # fmt: skip
"""window-100mm at three angles, without and with a field lens."""
