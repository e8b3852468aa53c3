"""The shape of lenses that keeps light on the law where it goes off the axis: offset and tilted pairs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import inf

from clacad.advice.candidate import FORMS, Variant, apertures, built
from clacad.advice.field_centre import centre_errors
from clacad.advice.first_numbers import index_of, undistorted_conic
from clacad.advice.wish import Wish
from clacad.design import DesignError
from clacad.prescription.prescribe import prescribe
from clacad.sheet.vignetting import aperture_slope

ENOUGH = 0.9
"""Part of the limits that the middle of the field may use."""

WITHIN = 0.95
"""Part of them beyond which a shape is not worth tracing."""

SPREAD = (0.0, 0.1, -0.1, 0.2, -0.2, 0.3, -0.3, 0.5, -0.5, 0.7, -0.7)
"""Conic constants that are tried, from that of the closed formula."""

FINE = (0.025, -0.025, 0.05, -0.05, 0.075, -0.075)
"""Then about the best of those."""

RATIO = 20.0
"""Separation in pitches at which shapes are compared."""

FARTHEST = 2.0
"""Pitches by which light may meet lens 2 beside its vertex."""


def variants(
    wish: Wish, pitch: float, overrides: Sequence[str] = (), refused: list[str] | None = None
) -> Iterator[tuple[Variant, float]]:
    """Forms and shapes to try, the best first, each with the separation in pitches that it needs at least.

    Parameters
    ----------
    wish : Wish
    pitch : float, millimetres
        At which they are compared; nearly all the same at any.
    overrides : sequence of str
        "key=value" of the design, as with --set.
    refused : list of str or None
        Gets a sentence for each form that is not worth trying.
    """
    for aperture in apertures(wish):
        for form, curved in FORMS:
            if wish.form in ("any", form):
                yield from _shaped(wish, Variant(form, curved, None, aperture), pitch, overrides, [] if refused is None else refused)


def _shaped(
    wish: Wish, variant: Variant, pitch: float, overrides: Sequence[str], refused: list[str]
) -> Iterator[tuple[Variant, float]]:
    """A variant as it stands; of an offset pair with the conic that keeps the law in the middle of the field, if one does."""
    conic = undistorted_conic(variant.form, variant.curved, index_of(wish))
    if wish.straight:
        yield variant, 0.0
        if conic is not None:
            yield replace(variant, conic=round(conic, 3)), 0.0
        return
    pointed = _pointed(wish, variant, pitch, overrides)
    if isinstance(pointed, str):
        refused.append(f"{variant.form}: {pointed}")
        return
    if (1.0 - variant.aperture) * RATIO * max(map(abs, pointed.slope)) > FARTHEST:
        return
    faults = {None: _faults(wish, pointed, pitch, overrides)}
    if conic is not None and faults[None].cost > (0.0, ENOUGH):
        _try(wish, pointed, pitch, overrides, faults, round(conic, 3), SPREAD)
        best = min((k for k in faults if k is not None), key=lambda k: faults[k].cost)
        _try(wish, pointed, pitch, overrides, faults, best, FINE)
    chosen = min(faults, key=lambda k: faults[k].cost)
    if faults[chosen].lasting <= WITHIN:
        yield replace(pointed, conic=chosen), RATIO * faults[chosen].shrinking / ENOUGH
    else:
        refused.append(
            f"{variant.form}: in the middle of the field and along the axis ray the law is missed by {faults[chosen].lasting:.3g} times "
            "what the design allows, whatever the conic constant and the separation: less offset, less tilt"
        )


@dataclass(frozen=True, slots=True)
class _Faults:
    """Errors in the middle of the field over what the design allows: those that no separation helps, and the others."""

    lasting: float
    shrinking: float

    @property
    def cost(self) -> tuple[float, float]:
        """Less is better: what is beyond enough first, then the separation that is needed."""
        return max(0.0, self.lasting - ENOUGH), self.shrinking


def _try(
    wish: Wish, variant: Variant, pitch: float, overrides: Sequence[str], faults: dict[float | None, _Faults],
    middle: float, steps: Sequence[float],
) -> None:  # fmt: skip
    """Add the faults of conics about another one."""
    for conic in (round(middle + step, 3) for step in steps):
        if conic not in faults:
            faults[conic] = _faults(wish, replace(variant, conic=conic), pitch, overrides)


def _faults(wish: Wish, variant: Variant, pitch: float, overrides: Sequence[str]) -> _Faults:
    try:
        design = built(wish, variant, pitch, RATIO, "trial", overrides)
        found = centre_errors(prescribe(design), wish.field)
    except DesignError:
        return _Faults(inf, inf)
    return _Faults(found.lasting(design), found.shrinking(design))


def _pointed(wish: Wish, variant: Variant, pitch: float, overrides: Sequence[str]) -> Variant | str:
    """The variant with the slope of the line through its lenses; why they cannot be built, where they cannot."""
    try:
        window = prescribe(built(wish, replace(variant, aperture=1.0), pitch, RATIO, "trial", overrides))
    except DesignError as problem:
        return problem.mistakes[0].message
    x, y = aperture_slope(window)
    return replace(variant, slope=(float(x), float(y)))
