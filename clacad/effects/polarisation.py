"""Polarisation: Fresnel's s and p shares of a 3-vector, a polariser over the scene and an analyser at the
camera.

*Model.* The camera's analyser direction is carried along the ray as a field vector E ⊥ D. At a face

    E' = τ_p Rot E + K (E·S) S,     S = D × D',   τ = sqrt(1 − r²),   Rot the least rotation that takes D to
    D',
    K = (τ_s − τ_p)/S² = −2 n1 n2 (r_p − r_s) / ((n2² − n1²) (D·D') (τ_s + τ_p)),

which has no 0/0 at normal incidence. What arrives is E'² of the polariser's direction; by reciprocity this
is the
share of the scene's light that the camera gets (polarisation ray tracing: Yun, Crabtree and Chipman, Appl.
Opt. 50,
2855 (2011)). Without polariser and analyser: both polarisations averaged, as `fresnel` has them, but with
what the
faces themselves polarise. An ideal analyser or polariser halves unpolarised light. Retardance at total
reflection
and of coatings is left out; the straight path alone is polarised.
*Law.* Malus: cos² of the angle between polariser and analyser; reciprocity; Fresnel's shares for one face.
*On when* there is a polariser or analyser, or the faces polarise the light so much that the product of mean
shares
is off by more than the radiance that matters. Implies `fresnel`.
"""

from __future__ import annotations

from math import cos, sin

import numpy as np

from clacad.base.types import Floats
from clacad.effects.engine.camera_light import MOST, traced_with
from clacad.effects.engine.effect import (
    Bound,
    Declaration,
    Effect,
    FaceCrossing,
    RayBlock,
    Setting,
    Situation,
    When,
    crossings,
    traced_of,
    unit_rows,
)
from clacad.effects.fresnel import NAME as FRESNEL
from clacad.effects.reflections import NAME as REFLECTIONS
from clacad.optics.rays import Fate
from clacad.optics.surface.fresnel_coefficients import amplitudes, deviation, reflected
from clacad.sheet.window import Window

NAME = "polarisation"

STEEPER = 1.5
"""Factor for rays of the picture that are steeper than all of the probe."""


def effect(window: Window, setting: Setting) -> Effect:
    """Carry field vectors from face to face; the flux is set after the last one."""

    def apply(block: RayBlock, crossing: FaceCrossing | None) -> None:
        if crossing is None:
            return
        if NAME not in block.state:
            block.state[NAME] = analysed(setting, unit_rows(block.rays.direction))
        fields = block.state[NAME]
        ratio = 1.0
        if setting.coating != "none" and window.wavelength is not None:
            ratio = window.wavelength / block.air_wavelength
        block.state[NAME] = [_crossed(field, crossing, setting.coating, ratio) for field in fields]

    def finish(block: RayBlock) -> None:
        if NAME not in block.state:  # compiled code has computed all of it
            return
        block.result.flux[:] *= passed(setting, block.state.pop(NAME), block.result.direction)

    def compiled(block: RayBlock) -> None:
        from clacad.effects.engine.compiled_passes import polarisation_pass

        ends = _pointing(setting.analyser), _pointing(setting.polariser)
        polarisation_pass(traced_of(block), *ends, block.result.flux)

    bare = setting.coating == "none"
    return Effect(
        NAME, When.HIT, needs=("hits",), apply=apply, finish=finish, compiled=compiled if bare else None
    )


def _pointing(angle: float | None) -> Floats:
    """Unit vector (2,) of an angle, NaN where there is none."""
    return np.array([np.nan, np.nan] if angle is None else [cos(angle), sin(angle)])


def analysed(setting: Setting, direction: Floats) -> list[Floats]:
    """Field vectors (n, 3) across the rays that the camera accepts: one with an analyser, else two."""
    if setting.analyser is not None:
        return [across(direction, setting.analyser)]
    first = across(direction, 0.0)
    return [first, np.cross(direction, first)]


def across(direction: Floats, angle: float) -> Floats:
    """Unit vectors (m, 3) across the rays, in the direction (cos, sin) of the sheet's x and y."""
    wanted = np.array([cos(angle), sin(angle), 0.0])
    field = wanted - (direction @ wanted)[:, None] * direction
    return np.asarray(field / np.sqrt((field * field).sum(axis=1))[:, None])


def passed(setting: Setting, fields: list[Floats], direction: Floats) -> Floats:
    """Share (n,) of the scene's unpolarised light that reaches the camera with these field vectors."""
    total = np.zeros(len(direction))
    for field in fields:
        if setting.polariser is None:
            total += (field * field).sum(axis=1)
        else:
            total += (field * across(direction, setting.polariser)).sum(axis=1) ** 2
    return 0.5 * total


def _crossed(field: Floats, crossing: FaceCrossing, coating: str, ratio: float) -> Floats:
    out = cross_face(field, crossing.before, crossing.after, crossing.n1, crossing.n2, coating, ratio)
    if crossing.through is None:
        return out
    return np.where(crossing.through[:, None], out, field)


def cross_face(
    field: Floats,
    before: Floats,
    after: Floats,
    n1: float,
    n2: float,
    coating: str = "none",
    ratio: float = 1.0,
) -> Floats:
    """Field vectors (m, 3) behind an interface, scaled so that their square is the flux."""
    turn = deviation(before, after)
    c = 1.0 - turn
    turned = field - ((field * after).sum(axis=1) / (1.0 + c))[:, None] * (before + after)
    if n1 == n2:
        return np.asarray(turned)
    share_s, share_p = reflected(turn, n1, n2, coating, ratio)
    with np.errstate(invalid="ignore"):  # rows that did not cross, which the caller leaves as they were
        tau_s, tau_p = np.sqrt(1.0 - share_s), np.sqrt(1.0 - share_p)
    s = np.cross(before, after)
    if coating == "none":
        r_s, r_p = amplitudes(turn, n1, n2)
        k = -2.0 * n1 * n2 * (r_p - r_s) / ((n2 - n1) * (n2 + n1) * c * (tau_s + tau_p))
    else:
        # a layer's shares have no such closed form; below this sine they agree to rounding
        size = (s * s).sum(axis=1)
        k = np.where(size > 1e-14, (tau_s - tau_p) / np.maximum(size, 1e-14), 0.0)
    return np.asarray(tau_p[:, None] * turned + (k * (field * s).sum(axis=1))[:, None] * s)


def bound(situation: Situation) -> Bound:
    """Product of mean shares against mean of products: Σ over pairs of faces of their degrees of
    polarisation.

    A face passes T̄ (1 ± D) of its own s and p light, D = (T_p − T_s)/(T_p + T_s). For any planes of
    incidence, two faces together change unpolarised light's share by D_i D_j at most.
    """
    setting = situation.setting
    if setting.polariser is not None or setting.analyser is not None:
        which = " and ".join(name for name in ("polariser", "analyser") if getattr(setting, name) is not None)
        return Bound(0.0, 1.0, f"the scene has a {which}", 2.0)
    block = RayBlock(situation.window, situation.rays, situation.probe, "surfaces", None)
    n = len(situation.probe)
    plain, once, twice = np.ones(n), np.zeros(n), np.zeros(n)
    for crossing in crossings(block):
        s, p = reflected(
            deviation(crossing.before, crossing.after), crossing.n1, crossing.n2, setting.coating
        )
        plain *= 1.0 - 0.5 * (s + p)
        degree = np.abs(s - p) / (2.0 - s - p)
        once += degree
        twice += degree * degree
    passing = situation.probe.fate <= Fate.LAND
    pairs = 0.5 * (once * once - twice) * plain
    radiance = STEEPER * float(pairs[passing].max(initial=0.0))
    return Bound(
        0.0, radiance, f"no polariser or analyser; what the faces polarise counts {radiance:.2g}", 2.0
    )


def measured(situation: Situation) -> tuple[float, float]:
    """Change of light against losses of unpolarised light, over 99 % of the transmitted rays."""
    plain, own = traced_with(situation, FRESNEL), traced_with(situation, NAME)
    passing = plain.fate <= Fate.LAND
    if not passing.any():
        return 0.0, 0.0
    return 0.0, float(np.quantile(np.abs(own.flux[passing] - plain.flux[passing]), MOST))


DECLARED = Declaration(NAME, effect, bound, measured, loses=True, includes=(FRESNEL, REFLECTIONS))
