"""Scatter at rough faces: a small Gaussian blur of directions, and light lost to wide angles.

*Model.* Facet normals with independent Gaussian slopes of rms σ_s turn the light by (n − 1)σ_s a face and
meridian; lens 1's turns arrive magnified by 1/|m|, m = −f2/f1. Roughness of rms height σ takes exp(−(2π(n −
1)σ/λ)²) a face from the direct light (total integrated scatter, transmission: Bennett and Porteus, J. Opt.
Soc. Am. 51, 123 (1961), with the wavefront step (n − 1)σ for 2σ); what it takes goes into a haze that no
picture point keeps.
*Law.* Direct light and haze sum to 1; no roughness, no change.
*On when* the haze exceeds the radiance, or (n − 1) σ_s sqrt(2(1 + 1/m²)) the angle, that matters.
"""

from __future__ import annotations

from math import expm1, hypot, pi, sqrt

import numpy as np

from clacad.base.text import nm_text
from clacad.base.types import Floats, Ints
from clacad.effects.engine.camera_light import radiance_change, turned_angles
from clacad.effects.engine.effect import (
    Bound,
    Declaration,
    Effect,
    FaceCrossing,
    RayBlock,
    Setting,
    Situation,
    When,
    bend,
    lens_slopes,
    normal,
)
from clacad.sheet.vignetting import focal_ratio, scale_of_image, thin_cells
from clacad.sheet.window import Window

NAME = "scatter"
SALT = 3


COST = 4.0
"""Time of the compiled trace with scatter over without: each face deflects every ray, outside the kernel."""


def effect(window: Window, setting: Setting) -> Effect:
    """Deflect emerging rays and subtract the haze from their flux."""
    width = np.array(blur(window, setting.slope_rms))

    def apply(block: RayBlock, _: FaceCrossing | None) -> None:
        rows = block.emerging()
        if setting.roughness > 0.0:
            block.result.flux[rows] *= 1.0 - haze(window, setting.roughness, block.air_wavelength)
        if setting.slope_rms > 0.0:
            turns = (
                width
                if not window.many_sizes
                else _by_cell(window, block.result.cell.astype(np.int64), setting.slope_rms)
            )
            slopes = lens_slopes(block)[0] + normal(block.rays, 1, setting.seed, SALT) * turns
            bend(block, slopes, rows)

    return Effect(NAME, When.EXIT, apply=apply)


def blur(window: Window, slope_rms: float) -> tuple[float, float]:
    """Rms slope change of light along lens x and y; for cells with an own η, that of the sheet's law."""
    index = max(body.index for body in window.bodies)
    one, two = (faces_of_lens(window, array) for array in (0, 1))
    x, y = ((index - 1.0) * slope_rms * sqrt(two + one / (m * m)) for m in focal_ratio(window.thin))
    return x, y


def _by_cell(window: Window, cell: Ints, slope_rms: float) -> Floats:
    """`blur` (n, 2) of light through the cells (n, 2) of a sheet with an own η for each cell."""
    cells, index = thin_cells(window), max(body.index for body in window.bodies)
    scale = scale_of_image(cells, cell)
    assert scale is not None  # the caller has checked it
    one, two = (faces_of_lens(window, array) for array in (0, 1))
    shrunk = np.linalg.inv(
        scale * np.array(focal_ratio(window.thin))
    )  # slope behind lens 2 per slope at lens 1
    return np.asarray((index - 1.0) * slope_rms * np.sqrt(two + one * (shrunk**2).sum(axis=2)))


def faces_of_lens(window: Window, array: int) -> int:
    """Number of faces of lens 1 or 2, plane ones included.

    Two in air; one on a slab or on a plate shared with a field lens.
    """
    body = next(b for b in window.bodies if array in (b.front.array, b.back.array))
    return sum(face.array in (array, None) for face in (body.front, body.back))


def haze(window: Window, roughness: float, wavelength: float) -> float:
    """Share of the light removed from the direct beam by rough faces (roughness and wavelength in metres)."""
    depth = sum(2.0 * (2.0 * pi * (body.index - 1.0) * roughness / wavelength) ** 2 for body in window.bodies)
    return -expm1(-depth)


def bound(situation: Situation) -> Bound:
    """Haze at the shortest wavelength, blur of both meridians in quadrature."""
    setting, window = situation.setting, situation.window
    if setting.roughness == 0.0 and setting.slope_rms == 0.0:
        return Bound(0.0, 0.0, "the design states neither roughness nor slope error", COST)
    lines = situation.wavelengths
    if setting.roughness > 0.0 and not lines:
        return Bound(0.0, 0.0, "no wavelength to judge the roughness by: not bounded", COST, known=False)
    lost = haze(window, setting.roughness, min(lines)) if lines else 0.0
    angle = hypot(*blur(window, setting.slope_rms))
    why = (
        f"{nm_text(setting.roughness, 3)} of roughness take {lost:.2g} of the light, "
        f"{setting.slope_rms:.2g} rad of slope error blur by {angle:.2g} rad"
    )
    return Bound(angle, lost, why, COST)


def measured(situation: Situation) -> tuple[float, float]:
    """Rms angle, and the mean change of the light."""
    turned = turned_angles(situation, NAME)
    return float(np.sqrt(np.mean(turned**2))), radiance_change(situation, NAME)


DECLARED = Declaration(NAME, effect, bound, measured)
