"""Fresnel losses of unpolarised light.

*Model.* Flux × (T_s + T_p)/2 at every face; bare, or under a quarter-wave layer of index √n made for the
design wavelength (`Setting.coating`). The polarisation by the faces themselves is left out here and included
in `polarisation`. On rungs law and thin a lens is represented by a plane plate across its axis.
*Law.* R + T = 1; the same both ways; 1 − r0 at normal incidence; nothing of p at Brewster's angle.
*On when* the light lost on the probe exceeds the radiance that matters. *Cost* about 1.2.
"""

from __future__ import annotations

import numpy as np

from clacad.base.types import Floats
from clacad.effects.engine.effect import (
    Bound,
    Declaration,
    Effect,
    FaceCrossing,
    RayBlock,
    Setting,
    Situation,
    When,
    traced_of,
)
from clacad.effects.engine.passes import trace_with
from clacad.optics.rays import Fate
from clacad.optics.surface.fresnel_coefficients import deviation, normal_loss, reflected, transmission
from clacad.sheet.window import Window

NAME = "fresnel"


def effect(window: Window, setting: Setting) -> Effect:
    """One multiplication of the flux per face."""

    def apply(block: RayBlock, crossing: FaceCrossing | None) -> None:
        if crossing is None or crossing.n1 == crossing.n2:
            return
        turn = deviation(crossing.before, crossing.after)
        if setting.coating == "none":
            passed = transmission(turn, crossing.n1, crossing.n2)
        else:
            ratio = 1.0
            if window.wavelength is not None:
                ratio = window.wavelength / block.air_wavelength
            s, p = reflected(turn, crossing.n1, crossing.n2, setting.coating, ratio)
            passed = 1.0 - 0.5 * (s + p)
        flux = block.result.flux
        if crossing.through is None:
            flux *= passed
        else:
            np.multiply(flux, passed, out=flux, where=crossing.through)

    return Effect(
        NAME,
        When.HIT,
        needs=("hits",),
        apply=apply,
        compiled=_compiled if setting.coating == "none" else None,
        losses=(lambda _: (True, ())) if setting.coating == "none" else None,
    )


def _compiled(block: RayBlock) -> None:
    from clacad.effects.engine.compiled_passes import fresnel_pass

    fresnel_pass(traced_of(block), block.result.flux)


def losses(situation: Situation) -> Floats:
    """Share (k,) lost by each probe ray that passes the sheet."""
    own = effect(situation.window, situation.setting)
    result = trace_with(situation.window, situation.rays, "surfaces", (own,), path="size")
    return np.asarray(1.0 - result.flux[result.fate <= Fate.LAND])


def mean_loss(situation: Situation) -> float:
    """Mean share that the probe rays lose by reflection at all faces; kept with the situation."""
    if NAME not in situation.kept:
        lost = losses(situation)
        situation.kept[NAME] = float(lost.mean()) if len(lost) else 0.0
    return situation.kept[NAME]


def bound(situation: Situation) -> Bound:
    """Light lost at the faces: 1 − (1 − r0)^N, or the mean measured on the probe if it is greater."""
    whole = 1.0
    for body in situation.window.bodies:
        whole *= (1.0 - normal_loss(body.index)) ** 2
    measured = mean_loss(situation)
    coated = situation.setting.coating != "none"
    radiance = measured if coated else max(1.0 - whole, measured)
    kind = "coated" if coated else "bare"
    why = f"{situation.faces} {kind} faces lose {measured:.1%} of the light"
    return Bound(0.0, radiance * 1.01, why, 1.2)


DECLARED = Declaration(NAME, effect, bound, loses=True)
