"""Candidate designs for a wish: one form, one pitch, one separation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import floor, inf, log10
from typing import Any, Final, Literal

from clacad.advice.first_numbers import MILLIMETRES
from clacad.advice.wish import KEYS, Wish, angle_text, wavelength_text
from clacad.checks.check import NEAR
from clacad.design import Design
from clacad.design.process_profiles import profile

Form = Literal["slab", "plano", "biconvex"]
Curved = Literal["outside", "inside"]

FORMS: Final[tuple[tuple[Form, Curved], ...]] = (
    ("slab", "outside"),
    ("plano", "inside"),
    ("plano", "outside"),
    ("biconvex", "outside"),
)
"""Forms in the order of trial: one piece; plates with protected lenses, then exposed lenses; two-sided
lenses.
"""


@dataclass(frozen=True, slots=True)
class Variant:
    """Construction of a pair, apart from its sizes.

    Parameters
    ----------
    form, curved : str
        `curved` counts for plano only.
    conic : float or None
        Of both meridians of both lenses; None: ellipsoids.
    aperture : float
        Slope of the centre of the field over that of the line through both lenses: 1 is along the lenses, 0
        along the sheet's normal.
    slope : (2,) tuple of float
        That of the line through both lenses, sheet frame.
    eye : {"", "field lens", "aimed"}
        Means that directs the oblique light of a stated eye to its partner cell: none, a field lens, or cells
        aimed at the eye.
    """

    form: Form
    curved: Curved = "outside"
    conic: float | None = None
    aperture: float = 1.0
    slope: tuple[float, float] = (0.0, 0.0)
    eye: Literal["", "field lens", "aimed"] = ""

    def __str__(self) -> str:
        """Return its name: "slab with field lenses"."""
        return (
            self.form
            + {"": "", "field lens": " with field lenses", "aimed": " with cells aimed at the eye"}[self.eye]
        )


def apertures(wish: Wish) -> tuple[float, ...]:
    """Candidate values of `Variant.aperture`, the best first.

    Light along the normal hits lens 2 away from its vertex. Neighbouring lenses then have steps between them,
    which only some processes make.
    """
    if wish.straight:
        return (1.0,)
    return (0.0, 0.25, 0.5, 0.75, 1.0) if profile(wish.process).wall == inf else (1.0, 0.75, 0.5, 0.0)


def built(
    wish: Wish, variant: Variant, pitch: float, ratio: float, name: str, overrides: Sequence[str] = ()
) -> Design:
    """Design of a variant at a pitch (millimetres) and a separation of `ratio` pitches, rounded to three
    digits.

    Raises
    ------
    DesignError
        There is no such lens, or an override does not fit.
    """
    return Design.from_dict(_keys(wish, variant, pitch, ratio, name), overrides)


def _keys(wish: Wish, variant: Variant, pitch: float, ratio: float, name: str) -> dict[str, Any]:
    law: dict[str, Any] = {"eta": list(wish.eta), "delta": list(wish.delta), "euler": list(wish.euler)}
    body = _body(wish, variant)
    lattice = _lattice(wish, variant, pitch)
    sections = {
        "law": law,
        "pair": _pair(wish, variant, round_to(pitch * ratio, 3), body.get("neck", round_to(pitch / 20.0, 2))),
        "lattice": lattice,
        "body": body,
        "check": _check(wish),
    }
    return {
        "format": 1,
        "name": name,
        "unit": "mm",
        **{key: value for key, value in sections.items() if value},
    }


def _pair(wish: Wish, variant: Variant, separation: float, web: float) -> dict[str, Any]:
    pair: dict[str, Any] = {"form": variant.form, "separation": separation}
    if variant.form == "plano":
        pair["curved"] = variant.curved
    land = wish.size.shape == "circle" or wish.kind == "hexagonal" or wish.flange is not None
    if variant.form == "biconvex" and land:  # land needs a plate to lie in
        pair["web"] = web
    if variant.conic is not None:
        pair |= {"surface": "biconic", "conic": [variant.conic, variant.conic]}
    if variant.eye:
        pair |= {"field_lens": True} if variant.eye == "field lens" else {"offset": "traced"}
    pair |= {"material": wish.material} if wish.index is None else {"index": wish.index}
    if wish.wavelength != KEYS["wavelength"].default:
        pair["wavelength"] = wavelength_text(wish.wavelength)
    return pair


def _check(wish: Wish) -> dict[str, Any]:
    check: dict[str, Any] = {"process": wish.process}
    if wish.field != KEYS["field"].default:
        check["field"] = angle_text(wish.field)
    places = {"viewer": wish.viewing, "object": wish.object}
    return check | {name: value for name, value in places.items() if value is not None}


def _body(wish: Wish, variant: Variant) -> dict[str, Any]:
    """Body keys: plates and lenses are as thick as their edges require; a slab needs no extra thickness."""
    rules = profile(wish.process)
    neck = 1.02 * MILLIMETRES * max(rules.edge, rules.neck) / NEAR
    body: dict[str, Any] = {}
    if variant.form != "slab" and neck > 0.0:
        body["neck"] = round_to(neck, 3, up=True)
    if wish.flange is not None:
        body["border"] = wish.flange
    if wish.holes is not None and wish.flange is not None:
        body["holes"] = [_holes(wish, wish.holes, wish.flange)]
    return body


def _holes(wish: Wish, count: int, flange: float) -> dict[str, Any]:
    """Holes in the centre of the flange, half as wide: one in each corner of a rectangle, or on the circle of
    a disc.
    """
    holes: dict[str, Any] = {"diameter": 0.5 * flange}
    if wish.size.shape == "circle":
        return holes | {"circle": wish.size.size[0] + flange, "count": count}
    return holes | {"corners": 0.5 * flange}


def _lattice(wish: Wish, variant: Variant, pitch: float) -> dict[str, Any]:
    found: dict[str, Any] = {"kind": wish.kind, "pitch": pitch}
    if wish.size.shape == "circle":
        found["outline"] = {"circle": wish.size.size[0]}
    elif wish.kind == "hexagonal":
        found["outline"] = {"rectangle": list(wish.size.size)}
    else:
        found["count"] = [max(1, floor(side / pitch + 1e-9)) for side in wish.size.size]
    if variant.eye == "aimed":
        found["aperture"] = {"point": [0.0, 0.0, -wish.distance]}
    elif variant.aperture == 0.0:
        found["aperture"] = "aligned"
    elif variant.aperture != 1.0:
        found["aperture"] = [round(variant.aperture * slope, 4) for slope in variant.slope]
    return found


def round_to(value: float, digits: int, up: bool = False) -> float:
    """A number rounded to `digits` significant digits; `up`: rounded up."""
    if value == 0.0:
        return 0.0
    places = digits - 1 - floor(log10(abs(value)))
    rounded = round(value, places)
    return rounded if not up or rounded >= value else round(rounded + 10.0**-places, places)
