"""Derived numbers of a window as rows of text.

Imaging by a sheet with a varying law: foci and nodal point by the law,
and the area where a superlens is one lens.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import degrees, isfinite
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from clacad.base.text import digits, mrad_list
from clacad.base.types import Pair2
from clacad.base.units import MONOMIALS, POWER, RAISED
from clacad.optics.law.focusing import Superlens, along_axes
from clacad.sheet.feasibility.derived_numbers import (
    BodyFacts,
    EyeAdvice,
    FaceShape,
    Feasibility,
    LensFacts,
    two,
)
from clacad.sheet.lattice import Circle, Lattice, Outline
from clacad.sheet.plate import Plate, least_land
from clacad.sheet.vignetting import focal_ratio
from clacad.sheet.volume_and_extent import whole_extent

if TYPE_CHECKING:
    from clacad.sheet.window import Window


@dataclass(frozen=True, slots=True)
class Zone:
    """Area where a superlens acts as one lens: normal light stays with its partner over `width`, (2,)
    lengths.

    moire : (2,) lengths
        Period of the pattern that both arrays make.
    """

    width: Pair2
    f_number: Pair2
    moire: Pair2


def zone_of(window: Window) -> Zone | None:
    """Zone of a sheet whose array 2 has its own pitch, along the cells' axes; None for other sheets."""
    second = window.thin.second
    if not second.own or window.cell_laws is None:
        return None
    own = window.lattice.pitch if second.pitch is None else second.pitch
    (f1x, f1y), (f2x, f2y) = window.thin.focal_length
    x, y = (
        Superlens((a, b), focal, second.turn)
        for a, b, focal in zip(window.lattice.pitch, own, ((f1x, f2x), (f1y, f2y)), strict=True)
    )
    return Zone((x.zone_period, y.zone_period), (x.f_number, y.f_number), (x.moire_period, y.moire_period))


def imaging_rows(
    window: Window, of_length: Callable[[float | Pair2], str], name: str
) -> list[tuple[str, ...]]:
    """Name, value, unit and definition of each number; empty for uniform sheets.

    `of_length` writes lengths in the unit `name`.
    """
    laws = window.cell_laws
    if laws is not None and laws.ratios is not None:
        etas = laws.ratios_of(window.lattice, window.lattice.cells())
        means = "of the cells; focal lengths and what follows from them are those of the middle one"
        return [
            (
                "eta, least and greatest",
                f"{digits(float(etas.min()))}, {digits(float(etas.max()))}",
                "",
                means,
            )
        ]
    if laws is None or laws.smooth is None:
        return []
    x, y = along_axes(laws.smooth, window.thin.separation)
    rows: list[tuple[str, ...]] = [
        (
            "focus of light from before the sheet, lens x, y",
            of_length((x.f_image, y.f_image)),
            name,
            "η/κ, from array 2",
        ),
        (
            "focus of light from behind, lens x, y",
            of_length((x.f_object, y.f_object)),
            name,
            "−1/κ, from array 1",
        ),
        (
            "nodal point, lens x, y",
            of_length((x.nodal_z, y.nodal_z)),
            name,
            "(η − 1)/κ, from array 1: light through it is not turned",
        ),
    ]
    if "focus" in window.recipe:
        ends = ("object", "-inf"), ("image", "inf")
        planes = ", ".join(
            far if (z := window.recipe["focus"][key]) is None else of_length(z) for key, far in ends
        )
        rows.append(
            (
                "planes that pairs image sharply",
                planes,
                name,
                "the object's height before array 1, the image's behind array 2",
            )
        )
    return rows + _zone_rows(window, of_length, name)


def _zone_rows(window: Window, of_length: Callable[[float | Pair2], str], name: str) -> list[tuple[str, ...]]:
    """Rows of the zone of one lens of a superlens; empty where there is none."""
    zone = zone_of(window)
    if zone is None:
        return []
    return [
        (
            "width of one lens, x, y",
            of_length(zone.width),
            name,
            (
                "p1²/|p2 − p1|, with a turn p1²/√((p2 − p1)² + 4 p1 p2 sin²(α/2)): over it light along"
                " the normal stays with its partner; a superlens is a lattice of lenses of that period"
            ),
        ),
        (
            "F-number of one lens, x, y",
            ", ".join(map(digits, zone.f_number)),
            "",
            "|f2|/p1; law.varying makes one large lens",
        ),
        (
            "moire period, x, y",
            of_length(zone.moire),
            name,
            (
                "of the two arrays: no field of a cell survives beyond it; over a pitch it is the"
                " magnification of a moire magnifier"
            ),
        ),
    ]


LENGTHS = ((1.0, "m"), (1e-3, "mm"), (1e-6, "um"), (1e-9, "nm"))
"""Metres and name of each unit in which lengths are shown, largest first."""


class FactRow(NamedTuple):
    """One row of the table of derived numbers: subject, name, value and unit as text, and definition.

    means : str
        Short definition; "" where the name is sufficient.
    """

    about: str
    name: str
    value: str
    unit: str
    means: str = ""


def length_unit(metres: float) -> tuple[float, str]:
    """Unit (metres, name) in which the design's unit is shown: the largest one not above it."""
    return next((pair for pair in LENGTHS if pair[0] <= metres * (1.0 + 1e-9)), LENGTHS[-1])


def describe(window: Window, facts: Feasibility, sheet: Window | None = None) -> tuple[FactRow, ...]:
    """Rows of all derived numbers, lengths in a common unit near the design's own.

    sheet : the whole sheet, where `window` is the uniform equivalent of one of its cells.
    """
    size, name = length_unit(window.unit)
    scale = window.unit / size

    def of_length(value: float | Pair2) -> str:
        values = value if isinstance(value, tuple) else (value,)
        return ", ".join(digits(v * scale) for v in values)

    rows = _sheet_rows(window if sheet is None else sheet, facts, of_length, name)
    rows += [row for lens in facts.lenses for row in _lens_rows(lens, of_length, name)]
    rows += [row for body in facts.bodies for row in _body_rows(body, of_length, name)]
    if isfinite(facts.clearance):
        means = "lowest point of body 2 less highest of body 1"
        if len(window.bodies) > 2:
            means = "lowest point of a body less highest of the one before it, the least of them"
        rows.append(FactRow("assembly", "clearance", of_length(facts.clearance), name, means))
    means = "between the equivalent thin lenses, f1 + f2"
    rows.append(FactRow("assembly", "separation (in air)", of_length(facts.separation), name, means))
    rows += _field_rows(window, facts, of_length, name)
    rows += [FactRow("imaging", *row) for row in imaging_rows(window, of_length, name)]
    rows += _view_rows(facts, of_length, name)
    return (*rows, *_pitch_rows(facts, of_length, name, window.unit))


def _field_rows(
    window: Window, facts: Feasibility, of_length: Callable[[float | Pair2], str], name: str
) -> list[FactRow]:
    """Rows of the field lens as a whole; `of_length` writes lengths in the unit `name`."""
    if not window.thin.field:
        return []
    told = window.recipe["field"]
    pitch = max(window.lattice.pitch)
    wave = facts.wavelength / window.unit
    spot = two(1.22 * wave * f / pitch for f in window.thin.focal_length[0])
    rows = [
        FactRow(
            "field lens",
            "spot on the field faces, x, y",
            of_length(spot),
            name,
            "1.22 λ f1/p: dirt, scratches and seams of that size on those faces are seen sharply, like things"
            " far away",
        ),
        FactRow(
            "field lens",
            "power density there",
            digits((pitch / max(spot)) ** 2),
            "",
            "(p/spot)² times that on lens 1, for light of one direction: mind lasers",
        ),
    ]
    if "gap" in told:
        rows.insert(
            0,
            FactRow(
                "field lens",
                "air gap between the plates",
                of_length(float(told["gap"])),
                name,
                "vertex to vertex",
            ),
        )
    if told.get("equal_plates"):
        rows.insert(
            0,
            FactRow(
                "field lens",
                "plates",
                "2 of one part",
                "",
                "order the same part twice, put them back to back",
            ),
        )
    return rows


def _sheet_rows(
    window: Window, facts: Feasibility, of_length: Callable[[float | Pair2], str], name: str
) -> list[FactRow]:
    """Rows of the sheet as a whole; `of_length` writes lengths in the unit `name`."""
    row = partial(FactRow, "sheet")
    lattice = window.lattice
    x0, x1, y0, y1 = whole_extent(window)
    wide, high = of_length(x1 - x0), of_length(y1 - y0)
    rim = window.outline
    is_round = x1 - x0 <= _diameter(rim) * (1.0 + 1e-12)  # no array protrudes from the other
    low, top = min(body.low for body in facts.bodies), max(body.high for body in facts.bodies)
    return [
        row(
            "outer size",
            f"{wide} round" if is_round else f"{wide} x {high}",
            name,
            "of all bodies, seen along z",
        ),
        row("height", of_length(top - low), name, "from the lowest point of all bodies to the highest"),
        row(
            "cells",
            cells_text(lattice),
            "",
            (
                "telescopelets"
                if lattice.outline is None
                else "telescopelets that lie wholly inside the outline"
            ),
        ),
        row(
            "index ratio n1/n2, lens x, y",
            ", ".join(digits(1.0 / m) for m in focal_ratio(window.thin)),
            "",
            "−f1/f2 = 1/η: near the lens axis the sheet acts as the interface from a medium of index n1 to"
            " one of n2",
        ),
        *_plate_rows(rim, of_length, name),
    ]


def cells_text(lattice: Lattice) -> str:
    """Number of cells of a sheet: "24 x 24", or "392 of 24 x 24" where an outline leaves some out."""
    n1, n2 = lattice.count
    return f"{n1} x {n2}" if lattice.outline is None else f"{lattice.cell_count} of {n1} x {n2}"


def _diameter(rim: Outline | None) -> float:
    """Diameter (length) of a round outline, drilled or not; 0 for any other."""
    return rim.diameter if isinstance(rim, Circle | Plate) else 0.0


def _plate_rows(rim: Outline | None, of_length: Callable[[float | Pair2], str], name: str) -> list[FactRow]:
    """Rows of the holes of a plate; empty without holes."""
    row = partial(FactRow, "sheet")
    if not isinstance(rim, Plate) or not rim.holes:
        return []
    return [
        row("holes through the plate", str(len(rim.holes)), "", "for mounting and for pins"),
        row(
            "least land next to a hole",
            of_length(least_land(rim)),
            name,
            "to the plate's edge or to another hole",
        ),
    ]


def _view_rows(facts: Feasibility, of_length: Callable[[float | Pair2], str], name: str) -> list[FactRow]:
    """Rows of the view through the sheet; `of_length` writes lengths in the unit `name`."""
    row = partial(FactRow, "view")
    wave = f"λ = {digits(1e9 * facts.wavelength)} nm"
    return [
        row(
            "middle of the field, x, y",
            _angles(facts.aperture),
            "deg",
            "from the sheet's normal to the line from a cell's middle to its partner's",
        ),
        row(
            "half field, lens x, y",
            _angles(facts.half_field),
            "deg",
            "off the middle of the field; beyond it no light meets the partner",
        ),
        row(
            "first ghosts off the middle, lens x, y",
            _angles(facts.ghost_onset),
            "deg",
            "from there on some light meets a wrong lenslet",
        ),
        row("undeviated direction, x, y", _angles(facts.undeviated), "deg", "through both lens centres"),
        row(
            "ray offset on the sheet, lens x, y",
            of_length(facts.offset_blur),
            name,
            "range over a cell of where light leaves less where it came",
        ),
        row(
            "diffraction, lens x, y",
            mrad_list(facts.diffraction_blur),
            "mrad",
            f"λ/w for the light that leaves lens 2, {wave}; w = √12 × rms distance, along that axis, of what"
            " is lit of a cell from its middle: the slit whose pattern has the same core (a square's own"
            " side, however it is turned)",
        ),
        row(
            "diffraction, first zero, lens x, y",
            mrad_list(facts.first_zero),
            "mrad",
            "first dark line of that pattern; more than λ/w where a corner of the zone points along the axis",
        ),
        row(
            "Fresnel number",
            digits(facts.fresnel_number),
            "",
            f"(w/2)²/(λ f2), the smaller of x and y, {wave}, the same w",
        ),
        row(
            "lost to diffraction at most, lens x, y",
            ", ".join(digits(v) for v in facts.viewing.lost),
            "",
            ".164/√N, N along that axis: light that reaches neighbours of the partner, where the beam fills"
            " its cell",
        ),
    ]


def _pitch_rows(
    facts: Feasibility, of_length: Callable[[float | Pair2], str], name: str, unit: float
) -> list[FactRow]:
    """Rows of the pitches recommended for an eye; `unit` is the window's, metres."""
    row = partial(FactRow, "view")
    eye = facts.viewing
    place = f"{digits(eye.object)} m behind, seen from {digits(eye.viewer)} m"
    return [
        row(
            "sharpest pitch, lens x, y",
            of_length(two(p / unit for p in eye.sharpest)),
            name,
            f"√(2λz/|η(1 − η)|)·max(1, |η|) for what lies z = {place}: larger cells are out of focus, smaller"
            " ones diffract",
        ),
        row(
            "least blur, lens x, y",
            mrad_list(eye.blur),
            "mrad",
            f"half of the light of a point {place}, at those pitches",
        ),
        row("sharpest pitch", of_length(eye.advised / unit), name, "of the axis that is blurred more"),
        row(
            "invisible pitch",
            of_length(eye.invisible / unit),
            name,
            f"one minute of arc from {digits(eye.viewer)} m: cells of this pitch are not seen;"
            f" {_conflict(eye)}",
        ),
        row(
            "pitch with diffraction below 1′, lens x, y",
            of_length(two(p / unit for p in eye.fine)),
            name,
            "λ/w ≤ 1′ for light that returns to the eye: what distant things need",
        ),
    ]


def _conflict(eye: EyeAdvice) -> str:
    """Describe the trade-off between invisible cells and sharp cells."""
    if eye.invisible >= eye.advised:
        return "the sharpest pitch is among them"
    return f"they blur more than the sharpest pitch, {digits(eye.advised / eye.invisible)} times as large"


def _lens_rows(lens: LensFacts, of_length: Callable[[float | Pair2], str], name: str) -> list[FactRow]:
    """Rows of one lens; `of_length` writes lengths in the unit `name`."""
    row = partial(FactRow, lens.name)
    rows = [
        row("focal length x, y", of_length(lens.focal_length), name, "of the equivalent thin lens"),
        row(
            "focal length as built x, y",
            of_length(lens.built_focal_length),
            name,
            "of the lens as made, in air, about its own axis",
        ),
        *_shape_rows(lens, of_length, name),
        row("centre thickness", of_length(lens.thickness), name, "from apex to apex, or to the plane face"),
        row("sag", of_length(lens.sag), name, "height range of the face over the optical zone of its cell"),
        row(
            "rim half width x, y",
            of_length(lens.rim),
            name,
            "where the lens would end were it not cut to its cell",
        ),
        row("cover", digits(lens.cover), "", "share of the optical zone where the lens exists"),
        row(
            "least normal z",
            digits(lens.least_normal_z),
            "",
            "cosine of the steepest slope against the sheet",
        ),
        row(
            "F-number x, y",
            ", ".join(digits(v) for v in lens.f_number),
            "",
            "focal length over the full width of the optical zone along that lens axis",
        ),
    ]
    if isfinite(lens.corner):
        rows.append(
            row(
                "least thickness over the cell",
                of_length(lens.corner),
                name,
                "negative: the lens ends before",
            )
        )
    if lens.least_thickness > 0.0:
        rows.append(
            row(
                "centre thickness that covers the cell",
                of_length(lens.least_thickness),
                name,
                "at these radii",
            )
        )
    return rows


def _shape_rows(lens: LensFacts, of_length: Callable[[float | Pair2], str], name: str) -> list[FactRow]:
    """Rows of radii and conic constants, face by face where the faces differ."""
    row, rows = partial(FactRow, lens.name), []
    one = FaceShape("", lens.radius, lens.conic, None)
    for shape in lens.shapes or (one,):
        of = f"{shape.side}, " if shape.side else ""
        conic = ", ".join("-" if k is None else digits(k) for k in shape.conic)
        rows += [
            row(f"{of}apex radius x, y", of_length(shape.radius), name, "negative: concave"),
            row(f"{of}conic constant x, y", conic, "", "0: circle, -1: parabola"),
        ]
        for order, of_terms in MONOMIALS.items():
            terms, unit = getattr(shape, order), f"1/{name}{RAISED[POWER[order]]}"
            if terms is not None:
                text = ", ".join(digits(a) for a in terms)
                said = f"{of}{order}: {', '.join(of_terms)}"
                rows.append(row(said, text, unit, "outwards, on top of the conic"))
    return rows


def _body_rows(body: BodyFacts, of_length: Callable[[float | Pair2], str], name: str) -> list[FactRow]:
    row = partial(FactRow, body.name)
    rows = [
        row("edge thickness", of_length(body.edge), name, "least along the outer side"),
        row("greatest step", of_length(body.step), name, "of a face across a border of cells"),
        row("height range", of_length((body.low, body.high)), name, "lowest and highest z"),
        row("pieces, holes", f"{body.pieces}, {body.holes}", ""),
    ]
    if isfinite(body.neck):
        rows.insert(1, row("neck", of_length(body.neck), name, "least thickness that joins neighbours"))
    return rows


def _angles(slopes: Pair2) -> str:
    return ", ".join(digits(degrees(float(np.arctan(s)))) for s in slopes)
