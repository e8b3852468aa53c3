"""Candidate designs for a wish: one form, one pitch, one separation, from closed formulas.

The formulas give the ranges of pitch and separation in which a wish can be fulfilled. They are start values
for the search (`clacad.advice.wish_search`), which builds and judges; they guarantee nothing. Sources:
thin-lens relations and third-order sums as in Welford, *Aberrations of Optical Systems*; the pitch of least
blur from the quarter-wave rule (wave-traced within 10 %).
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import floor, inf, isfinite, log10, sqrt
from typing import Any, Final, Literal

from clacad.advice.wish import KEYS, Wish, angle_text, mrad_value, wavelength_text
from clacad.checks.check import NEAR
from clacad.checks.light_kinds import LAW_RMS
from clacad.design import Design
from clacad.design.process_profiles import profile
from clacad.design.starter_designs import template
from clacad.optics.material.catalogue import find
from clacad.sheet.feasibility import derived_numbers

MILLIMETRES = 1e3
"""Millimetres per metre."""

FRESNEL = 10.5
"""Target Fresnel number; below 10 verify warns."""

FEWEST_CELLS = 5
"""Least number of cells across a sheet."""

SPHERICAL = 1.5
"""Rms error of a slab of spheres with eta = -1, over (pitch/separation)³."""


CURVED: Final = {
    ("PMMA", "PC"): ("achromat-polycarbonate", 10.0),
    ("PMMA", "PS"): ("achromat-plastic", 10.0),
}
"""Outer and inner material of slabs with curved joints: starter, and its separation (mm) at eta = -1."""


@dataclass(frozen=True, slots=True)
class PitchBound:
    """Bound (millimetres) of a pitch, and its reason."""

    value: float
    why: str


@dataclass(frozen=True, slots=True)
class FormNumbers:
    """Numbers of a form: its radii over (n - 1) f, and the thickness of the part over its separation."""

    radius: float
    thickness: float


def shape_of(form: str, index: float) -> FormNumbers:
    """Numbers of a form: faces of biconvex lenses share the power; a slab is n times its separation thick."""
    return FormNumbers(2.0 if form == "biconvex" else 1.0, index if form == "slab" else 0.0)


def index_of(wish: Wish) -> float:
    """Refractive index at the design wavelength."""
    return float(find(wish.material).index(wish.wavelength)) if wish.index is None else wish.index


def powers(wish: Wish) -> list[float]:
    """η of the meridians that have power."""
    return [eta for eta in wish.eta if eta != 1.0]


def returning(wish: Wish) -> float:
    """Width of the light one cell returns to the viewer, over the pitch: min(1, 1/|η|), the smaller axis."""
    return min(1.0, *(1.0 / abs(eta) for eta in wish.eta))


def balanced_pitch(wish: Wish) -> float:
    """√(λD/min(1, 1/|η|)), mm: a pixel appears as large as the diffraction of its returned light."""
    return sqrt(wish.wavelength * MILLIMETRES * wish.distance / returning(wish))


def sharpest_pitch(wish: Wish, behind: float) -> float:
    """Pitch (mm) at which a point `behind` the sheet is least blurred, in the more blurred meridian."""
    distance, viewer, etas = behind / MILLIMETRES, wish.distance / MILLIMETRES, powers(wish)
    pitches = [derived_numbers.sharpest_pitch(eta, distance, wish.wavelength) for eta in etas]
    blurs = [derived_numbers.sharpest_blur(eta, distance, viewer, wish.wavelength) for eta in etas]
    return MILLIMETRES * derived_numbers.pitch_of_more_blurred(pitches, blurs)


def wanted_pitch(wish: Wish) -> PitchBound:
    """The wished pitch, or the one that looks best, before limits of manufacture."""
    if wish.pitch is not None:
        return PitchBound(wish.pitch, "as wished")
    if wish.object is not None:
        return PitchBound(
            sharpest_pitch(wish, wish.object), f"least blur of what is {wish.object:g} mm behind the sheet"
        )
    return PitchBound(balanced_pitch(wish), f"pixel and diffraction alike, seen from {wish.distance:g} mm")


def least_ratio(wish: Wish, error: float) -> float:
    """Separation over pitch at which spherical aberration alone makes this rms error (radians).

    The error of lens i grows as the cube of its aperture over f_i, pitch x (1 - eta)/separation; that of lens
    1 is seen through lens 2, by a factor 1/|eta|.
    """
    sphere = max(SPHERICAL * abs(1.0 - eta) ** 3 * (1.0 + 1.0 / abs(eta)) / 16.0 for eta in powers(wish))
    return float((sphere / error) ** (1.0 / 3.0))


def _radii(wish: Wish, ratio: float, shape: FormNumbers, index: float) -> list[list[float]]:
    """|R| of lens 1 and lens 2 in each meridian, over the pitch."""
    first = [inf if eta == 1.0 else ratio / abs(1.0 - eta) for eta in wish.eta]
    second = [f * abs(eta) for f, eta in zip(first, wish.eta, strict=True)]
    return [[shape.radius * (index - 1.0) * f for f in lens] for lens in (first, second)]


def _sags(wish: Wish, radii: list[list[float]]) -> list[float]:
    """Height of each lens over its cell, over the pitch."""
    corner = (
        1.0 / 6.0 if wish.kind == "hexagonal" else 1.0 / 4.0
    )  # square of the half width, averaged over all directions
    return [sum(corner / (2.0 * r) for r in lens if isfinite(r)) for lens in radii]


def lower_pitches(wish: Wish, ratio: float, shape: FormNumbers) -> Iterator[PitchBound]:
    """Pitches that the wish must not fall below at a separation of `ratio` pitches, each with its reason."""
    rules, index = profile(wish.process), index_of(wish)
    radii = _radii(wish, ratio, shape, index)
    least, flattest = min(min(lens) for lens in radii), min(_sags(wish, radii))
    made = wish.process
    yield PitchBound(
        _fresnel_pitch(wish, ratio), f"Fresnel number {FRESNEL:g} at {ratio:g} pitches of separation"
    )
    yield PitchBound(MILLIMETRES * rules.pitch / NEAR, f"least pitch of {made}")
    yield PitchBound(MILLIMETRES * 20.0 * rules.voxel, f"20 voxels of {made} across a cell")
    yield PitchBound(MILLIMETRES * rules.radius / NEAR / least, f"least radius of {made}")
    yield PitchBound(
        MILLIMETRES * 10.5 * rules.tool / least, f"the tool of {made} leaves a tenth of a cell rounded"
    )
    if rules.layer > 0.0:
        yield PitchBound(
            MILLIMETRES * 21.0 * rules.layer / flattest, f"20 layers of {made} in the height of a lens"
        )
    if shape.thickness > 0.0:
        yield PitchBound(MILLIMETRES * rules.edge / NEAR / (shape.thickness * ratio), f"least edge of {made}")


def upper_pitches(wish: Wish, ratio: float, shape: FormNumbers) -> Iterator[PitchBound]:
    """Pitches that the wish must not exceed at a separation of `ratio` pitches, each with its reason."""
    rules = profile(wish.process)
    steepest = max(_sags(wish, _radii(wish, ratio, shape, index_of(wish))))
    yield PitchBound(min(wish.size.size) / FEWEST_CELLS, f"{FEWEST_CELLS} cells across the sheet")
    yield PitchBound(
        0.95 * MILLIMETRES * NEAR * rules.sag / steepest, f"greatest height of a lens of {wish.process}"
    )


def _fresnel_pitch(wish: Wish, ratio: float) -> float:
    """Pitch (mm) of Fresnel number `FRESNEL`: (w/2)²/(λ f2), w = p min(1, |η|), f2 = |η| s/|1 − η|."""
    worst = max(abs(eta) / (abs(1.0 - eta) * min(1.0, abs(eta)) ** 2) for eta in powers(wish))
    turned = 1.2 if wish.kind == "hexagonal" else 1.0  # a hexagon's equivalent width is its breadth over √1.2
    return FRESNEL * turned * 4.0 * wish.wavelength * MILLIMETRES * ratio * worst


def undistorted_conic(form: str, curved: str, index: float) -> float | None:
    """Conic of lens 2 at which light along an offset pair's axis obeys the law, to third order.

    It meets lens 2 at the height d = δ f1 and leaves at δ/|η| = d/f2, if the slope of the face grows with the
    height as Snell's law requires of a collimating face: tan τ = u + (1 + K) u³/2 at u = d/R2, and its exit
    slope (n − 1) u + c u³. None for biconvex lenses, where the form of both faces shares the work.
    """
    n = index
    if form == "biconvex":
        return None
    if (
        form == "slab" or curved == "outside"
    ):  # glass to air at the curved face, the axis ray normal to the sheet
        cubic = -n / 2.0 + n**3 / 6.0 + 1.0 / 3.0 + (n - 1.0) ** 3 / 3.0
    else:  # air to glass at the curved face, then the plane one
        cubic = -n / 3.0 + 0.5 - 1.0 / (6.0 * n**2) - (n - 1.0) ** 3 / (6.0 * n**2) + (n - 1.0) ** 3 / 2.0
    return -1.0 - 2.0 * cubic / (n - 1.0)


Form = Literal["slab", "plano", "biconvex"]
Curved = Literal["outside", "inside"]

FORMS: Final[tuple[tuple[Form, Curved], ...]] = (
    ("slab", "outside"),
    ("plano", "inside"),
    ("plano", "outside"),
    ("biconvex", "outside"),
)
"""Forms in the order of trial: one piece; plates with protected, then exposed lenses; two-sided lenses."""


@dataclass(frozen=True, slots=True)
class Variant:
    """Construction of a pair, apart from its sizes.

    form, curved : str. `curved` counts for plano only.
    conic : Of both meridians of both lenses; None: ellipsoids.
    aperture : Slope of the centre of the field over that of the line through both lenses: 1 is along the
        lenses, 0 along the sheet's normal.
    slope : (2,) tuple of float. That of the line through both lenses, sheet frame.
    eye : {"", "field lens", "aimed"}. Means that directs the oblique light of a stated eye to its partner
        cell: none, a field lens, or cells aimed at the eye.
    layers : Materials of a slab of layers, in the order of the light; empty: the wish's one material.
    starter : Name of the starter whose listed faces are scaled to the wish; empty: a pair by recipe.
    """

    form: Form
    curved: Curved = "outside"
    conic: float | None = None
    aperture: float = 1.0
    slope: tuple[float, float] = (0.0, 0.0)
    eye: Literal["", "field lens", "aimed"] = ""
    layers: tuple[str, ...] = ()
    starter: str = ""

    def __str__(self) -> str:
        """Return its name: "slab with field lenses"."""
        return self.starter or (
            "|".join(self.layers or (self.form,))
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
    """Design of a variant at a pitch (mm) and a separation of `ratio` pitches, rounded to three digits.

    Raises DesignError: There is no such lens, or an override does not fit.
    """
    return Design.from_dict(_keys(wish, variant, pitch, ratio, name), overrides)


def _keys(wish: Wish, variant: Variant, pitch: float, ratio: float, name: str) -> dict[str, Any]:
    law: dict[str, Any] = {"eta": list(wish.eta), "delta": list(wish.delta), "euler": list(wish.euler)}
    body = _body(wish, variant)
    lattice = lattice_keys(wish, variant, pitch)
    sections = {
        "law": law,
        "pair": _pair(wish, variant, round_to(pitch * ratio, 3), body.get("neck", round_to(pitch / 20.0, 2))),
        "lattice": lattice,
        "body": body,
        "check": check_keys(wish),
    }
    return {
        "format": 1,
        "name": name,
        "unit": "mm",
        **{key: value for key, value in sections.items() if value},
    }


def _pair(wish: Wish, variant: Variant, separation: float, web: float) -> dict[str, Any]:
    if variant.layers:
        return _of_layers(wish, variant, separation)
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


def _of_layers(wish: Wish, variant: Variant, separation: float) -> dict[str, Any]:
    """Section [pair] of a slab of layers with a separation in millimetres."""
    starter, size = CURVED.get((variant.layers[0], variant.layers[1]), ("", 1.0))
    if not starter:
        return {
            "form": "slab",
            "separation": separation,
            "layers": list(variant.layers),
            "wavelength": wavelength_text(wish.wavelength),
        }
    pair: dict[str, Any] = tomllib.loads(template("starter", starter))["pair"]
    scale = separation / size
    faces = [
        {key: value * scale if key in ("radius", "z") else value for key, value in face.items()}
        for face in pair["face"]
    ]
    return {**pair, "face": faces}


def check_keys(wish: Wish) -> dict[str, Any]:
    check: dict[str, Any] = {"process": wish.process}
    if wish.field != KEYS["field"].default:
        check["field"] = angle_text(wish.field)
    if wish.white is not None:
        check["law_white"] = mrad_value(wish.white)
    if wish.error is not None:
        check[LAW_RMS.id] = mrad_value(wish.error)
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
    """Holes in the centre of the flange, half as wide: in each corner, or on the circle of a disc."""
    holes: dict[str, Any] = {"diameter": 0.5 * flange}
    if wish.size.shape == "circle":
        return holes | {"circle": wish.size.size[0] + flange, "count": count}
    return holes | {"corners": 0.5 * flange}


def lattice_keys(wish: Wish, variant: Variant, pitch: float) -> dict[str, Any]:
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
