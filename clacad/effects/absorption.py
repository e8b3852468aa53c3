"""Absorption in the material.

*Model.* Beer and Lambert: flux × exp(−Σ α L), α = 4πk/λ, one exponential a ray. k comes from the material's
data at the ray's wavelength, or from `Setting.extinction`; a wavelength outside the data is an error. On
rungs law and thin L is the body's mean thickness along the axis over the cosine inside.
*Law.* Flux falls exponentially with thickness; two sheets multiply; nothing is lost at k = 0.
*On when* 1 − exp(−α L) at the largest L exceeds the radiance that matters. Where k is not known the loss is
not bounded: the plan reports that and the effect stays off.
"""

from __future__ import annotations

from math import exp, pi

import numpy as np

from clacad.base.types import Floats
from clacad.effects.engine.effect import (
    Bound,
    Declaration,
    Effect,
    FaceCrossing,
    Losses,
    RayBlock,
    Setting,
    Situation,
    When,
    inside_plate,
    unit_rows,
)
from clacad.optics.rays import Fate
from clacad.sheet.window import Body, Window

NAME = "absorption"


def effect(window: Window, setting: Setting) -> Effect:
    """One exponential per ray."""

    def apply(block: RayBlock, _: FaceCrossing | None) -> None:
        rates = attenuations(window, setting, block.wavelength)
        if not any(rates):
            return
        if block.compiled:
            from clacad.effects.engine.compiled_passes import absorption_pass

            assert block.result.hits is not None
            absorption_pass(block.result.hits, np.array(rates), block.result.flux)
            return
        depth = optical_depth(block, rates)
        np.exp(-depth, out=depth)
        block.result.flux[:] *= depth

    def losses(wavelength: float | None) -> Losses:
        return False, attenuations(window, setting, wavelength)

    return Effect(NAME, When.EXIT, needs=("hits",), apply=apply, losses=losses)


def attenuations(window: Window, setting: Setting, wavelength: float | None) -> tuple[float, ...]:
    """Attenuation α of each body, 1/length; 0 where it is not known."""
    return tuple(attenuation(window, body, setting, wavelength) or 0.0 for body in window.bodies)


def attenuation(window: Window, body: Body, setting: Setting, wavelength: float | None) -> float | None:
    """Attenuation α of a body, 1/length; None where it is not known.

    Raises ValueError: The material was measured, but not at this wavelength.
    """
    wave = wavelength if wavelength is not None else window.wavelength
    if wave is None:
        return None
    if setting.extinction is not None:
        return 4.0 * pi * setting.extinction / wave * window.unit
    alpha = None if body.material is None else body.material.attenuation(wave)
    return None if alpha is None else alpha * window.unit


def optical_depth(block: RayBlock, rates: tuple[float, ...]) -> Floats:
    """Σ α L of each ray (m,)."""
    depth = np.zeros(len(block.result))
    for number, (body, rate) in enumerate(zip(block.window.bodies, rates, strict=True)):
        if rate:
            depth += rate * path_in(block, number, body)
    return depth


def path_in(block: RayBlock, number: int, body: Body) -> Floats:
    """Path length of each ray inside a body (m,)."""
    result = block.result
    if block.rung in ("law", "thin"):
        from clacad.effects.engine.probe_rays import mean_thickness

        ray = unit_rows(block.rays.direction) if number == 0 else result.direction
        axis = block.window.thin.rotation[:, 2]
        cos = inside_plate(ray, axis, block.index(body)) @ axis
        return np.where(block.emerging(), mean_thickness(block.window, body) / cos, 0.0)
    assert result.hits is not None
    step = result.hits[2 * number + 1] - result.hits[2 * number]
    x, y, z = step[:, 0], step[:, 1], step[:, 2]
    return np.asarray(np.sqrt(x * x + y * y + z * z))  # 0 where the body was not entered: points repeat


def bound(situation: Situation) -> Bound:
    """1 − exp(−α L) at the longest path of the probe in each body, at the worst wavelength."""
    window, setting = situation.window, situation.setting
    lines = situation.wavelengths
    known = [[attenuation(window, body, setting, w) for body in window.bodies] for w in lines]
    if not lines or any(rate is None for rates in known for rate in rates):
        why = "nothing is known of the material's absorption: not bounded"
        return Bound(0.0, 0.0, why, 1.1, known=False)
    block = RayBlock(window, situation.rays, situation.probe, "surfaces", None)
    passing = situation.probe.fate <= Fate.LAND
    lengths = [
        float(path_in(block, k, body)[passing].max(initial=0.0)) for k, body in enumerate(window.bodies)
    ]
    depth = max(
        sum((rate or 0.0) * length for rate, length in zip(rates, lengths, strict=True)) for rates in known
    )
    total = sum(lengths) * window.unit
    lost = 1.0 - exp(-depth)
    return Bound(0.0, lost, f"at most {lost:.2g} of the light is absorbed over {total * 1e3:.3g} mm", 1.15)


DECLARED = Declaration(NAME, effect, bound, attenuations=attenuations)
