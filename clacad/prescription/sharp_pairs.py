"""Pairs that image one plane sharply to another (`[pair] focus`): not afocal, array 2 of a pitch of its own.

η stays what it is for chief rays, those through the middle of lens 1: so lens 2 is the lens of the afocal pair, t' = (t − δ)/η
holds for them in every cell, and only lens 1 changes. Every pair then images the object plane to the image plane, and
images of all pairs fall on one another where array 2 has the pitch p1 (1 − f2/ζ)/(1 + f1/z): D. Gabor, UK patent 541 753
(1940). Near f1 = −z the image by lens 1 runs away to infinity and the pair is a telescopelet no more: refused, with the
planes that work.
"""

from __future__ import annotations

from dataclasses import replace
from math import inf, isfinite
from typing import TYPE_CHECKING

from clacad.base.types import Pair2
from clacad.design.varying import Conjugates
from clacad.optics.law.focusing import SharpPair
from clacad.prescription.radii import LensPair, NoSuchLens, thin_focal_lengths
from clacad.prescription.superlens import spread_to
from clacad.sheet.window import Window

if TYPE_CHECKING:
    from clacad.design import Design

KEY = "pair.focus"
UNLIKE = 2.0
"""Times by which f1, or array 2's pitch, may differ from that of the afocal pair."""
LADDER = 1.25
"""Factor by which planes are moved away until they work."""


def sharp_pairs(eta: Pair2, separation: float, planes: Conjugates) -> tuple[SharpPair, SharpPair]:
    """Both meridians' lenses.

    Raises
    ------
    NoSuchLens
        The pair would be no telescopelet; the message has planes that work.
    """
    found = _pairs(eta, separation, planes)
    for axis, value, pair in zip("xy", eta, found, strict=True):
        why = _no_telescopelet(value, separation, pair)
        if why:
            raise NoSuchLens(f"focus: {why} in {axis}: the planes lie too near to the foci of the lenses", key=KEY,
                             hint=_farther(eta, separation, planes), code="CL120")  # fmt: skip
    return found


def _pairs(eta: Pair2, separation: float, planes: Conjugates) -> tuple[SharpPair, SharpPair]:
    x, y = (SharpPair.of(value, separation, planes.object, planes.image) for value in eta)
    return x, y


def _no_telescopelet(eta: float, separation: float, pair: SharpPair) -> str:
    """Why a meridian is none, "" if it is."""
    f1, afocal = pair.focal_lengths[0], thin_focal_lengths(eta, separation)[0]
    if not 1.0 / UNLIKE <= f1 / afocal <= UNLIKE:
        return f"lens 1 would need the focal length {f1:.4g}, where the afocal pair has {afocal:.4g},"
    ratio = pair.pitch_ratio
    if not 1.0 / UNLIKE <= ratio <= UNLIKE:
        return f"array 2 would need {ratio:.4g} times the pitch of array 1"
    return ""


def _farther(eta: Pair2, separation: float, planes: Conjugates) -> str:
    """Planes in the same ratio that work: the same two, so many times as far."""
    factor = 1.0
    while factor < 1e9:
        factor *= LADDER
        trial = Conjugates(_shortened(planes.object * factor), _shortened(planes.image * factor))
        pairs = _pairs(eta, separation, trial)
        if not any(_no_telescopelet(value, separation, pair) for value, pair in zip(eta, pairs, strict=True)):
            return f"object = {trial.object:g}, image = {trial.image:g}"
    return "planes farther off"


def _shortened(length: float) -> float:
    return float(f"{length:.3g}") if isfinite(length) else length


def sharp_lenses(
    eta: Pair2, separation: float, planes: Conjugates, thickness: Pair2, index: float
) -> LensPair:
    """Lenses with one curved face each, R = (n − 1) f, exact in paraxial light for any thickness."""
    x, y = sharp_pairs(eta, separation, planes)
    (f1x, f2x), (f1y, f2y) = x.focal_lengths, y.focal_lengths
    focal = (f1x, f1y), (f2x, f2y)
    (a, b), (c, d) = focal
    power = index - 1.0
    return LensPair(focal, ((power * a, power * b), (power * c, power * d)), thickness)


def with_focus(window: Window, design: Design) -> Window:
    """The window of equal cells, array 2 spread so that the images of all pairs fall on one another."""
    planes = design.pair.focus
    assert planes is not None  # who calls this has looked
    separation = window.thin.separation
    pairs = sharp_pairs(design.law_spec.eta, separation, planes)
    turned = abs(window.law.rotation[1, 0]) > 0.5  # the lenses' x lies along the cells' y
    along_cells = pairs[::-1] if turned else pairs
    x, y = (one.pitch_ratio * p for one, p in zip(along_cells, window.lattice.pitch, strict=True))
    afocal = window.thin.focal_length[0]  # δ and κ are those of chief rays
    (f1x, f2x), (f1y, f2y) = (pair.focal_lengths for pair in pairs)
    made = spread_to(window, (x, y), afocal)
    told = {"object": planes.object, "image": planes.image, "pitch_2": [x, y],
            "magnification": [pair.magnification for pair in pairs]}  # fmt: skip
    return replace(
        made,
        thin=replace(made.thin, focal_length=((f1x, f1y), (f2x, f2y))),
        recipe={**window.recipe, "focus": {name: None if value in (inf, -inf) else value for name, value in told.items()}},
    )  # fmt: skip
