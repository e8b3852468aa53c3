"""Derived numbers of a window as rows of text: tables of names, units and definitions, written by one loop.

Imaging by a sheet with a varying law: foci and nodal point by the law,
and the area where a superlens is one lens.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import degrees, isfinite
from operator import attrgetter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from clacad.base.text import digits, mrad_list, nm_text
from clacad.base.types import Pair2
from clacad.base.units import MONOMIALS, POWER, RAISED
from clacad.optics.law.focusing import Superlens, along_axes
from clacad.sheet.feasibility.derived_numbers import EyeAdvice, FaceShape, Feasibility, LensFacts, two
from clacad.sheet.lattice import Circle, Lattice
from clacad.sheet.plate import Plate, least_land
from clacad.sheet.vignetting import focal_ratio
from clacad.sheet.volume_and_extent import whole_extent

if TYPE_CHECKING:
    from clacad.sheet.window import Window


@dataclass(frozen=True, slots=True)
class Zone:
    """Area where a superlens acts as one lens: normal light stays with its partner over `width`, (2,)
    lengths.

    moire : (2,) lengths. Period of the pattern that both arrays make.
    """

    width: Pair2
    f_number: Pair2
    moire: Pair2


def zone_of(window: Window) -> Zone | None:
    """Zone of a sheet whose law is the pitch of its array 2, along the cells' axes; None for other sheets."""
    second = window.thin.second
    if not second.own or window.cell_laws is None or window.thin.change is not None:
        return None
    own = window.lattice.pitch if second.pitch is None else second.pitch
    (f1x, f1y), (f2x, f2y) = window.thin.focal_length
    x, y = (
        Superlens((a, b), focal, second.turn)
        for a, b, focal in zip(window.lattice.pitch, own, ((f1x, f2x), (f1y, f2y)), strict=True)
    )
    return Zone((x.zone_period, y.zone_period), (x.f_number, y.f_number), (x.moire_period, y.moire_period))


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


def cells_text(lattice: Lattice) -> str:
    """Number of cells of a sheet: "24 x 24", or "392 of 24 x 24" where an outline leaves some out."""
    n1, n2 = lattice.count
    return f"{n1} x {n2}" if lattice.outline is None else f"{lattice.cell_count} of {n1} x {n2}"


LENGTH = "length"
"""Unit of numbers in the window's unit, shown in the nearest one of LENGTHS."""

Entry = tuple[str, Any, str, str]
"""Name, value, unit and definition of a derived number.

A value is a text, a number, a tuple of numbers, None (no row), or a function that reads one of these from the
object that the table describes. Numbers in "mrad" are radians, those in "deg" slopes.
"""


@dataclass(frozen=True, slots=True)
class _Writer:
    """Writes entries as rows; `unit`: the window's in metres; `size`, `name`: the shown unit."""

    unit: float
    size: float
    name: str

    def text(self, value: float | str | tuple[float | None, ...], unit: str = LENGTH) -> str:
        """Significant digits of one or more numbers of a unit."""
        if isinstance(value, str):
            return value
        values = value if isinstance(value, tuple) else (value,)
        shown: Callable[[float], str] = {
            LENGTH: lambda v: digits(v * (self.unit / self.size)),
            "mrad": lambda v: mrad_list([v]),
            "deg": lambda v: digits(degrees(float(np.arctan(v)))),
        }.get(unit, digits)
        return ", ".join("-" if v is None else shown(v) for v in values)

    def rows(self, about: str, table: Iterable[Entry], of: object = None, **words: str) -> list[FactRow]:
        """Rows of a table about the object `of`; `words` fill the definitions."""
        read = ((name, value(of) if callable(value) else value, *rest) for name, value, *rest in table)
        return [
            FactRow(
                about,
                name,
                self.text(value, unit),
                self.name if unit == LENGTH else unit,
                means.format(**words),
            )
            for name, value, unit, means in read
            if value is not None
        ]


def describe(window: Window, facts: Feasibility, sheet: Window | None = None) -> tuple[FactRow, ...]:
    """Rows of all derived numbers, lengths in a common unit near the design's own.

    sheet : the whole sheet, where `window` is the uniform equivalent of one of its cells.
    """
    write = _Writer(window.unit, *length_unit(window.unit))
    rows = write.rows("sheet", _sheet(window if sheet is None else sheet, facts, write))
    for lens in facts.lenses:
        rows += write.rows(lens.name, [*LENS[:2], *_shapes(lens, write.name), *LENS[2:]], lens)
    for body in facts.bodies:
        rows += write.rows(body.name, BODY, body)
    gap = "lowest point of body 2 less highest of body 1"
    if len(window.bodies) > 2:
        gap = "lowest point of a body less highest of the one before it, the least of them"
    rows += write.rows("assembly", ASSEMBLY, facts, gap=gap)
    if window.thin.field:
        rows += write.rows("field lens", _field(window, facts))
    rows += write.rows("imaging", _imaging(window, write))
    eye = facts.viewing
    words = {
        "wave": f"λ = {nm_text(facts.wavelength, 6)}",
        "place": f"{digits(eye.object)} m behind, seen from {digits(eye.viewer)} m",
        "viewer": digits(eye.viewer),
        "conflict": _conflict(eye),
    }
    return (*rows, *write.rows("view", [*VIEW, *_pitches(eye, window.unit)], facts, **words))


def _finite(name: str) -> Callable[[object], float | None]:
    """Reader of an attribute; None where it is infinite."""
    read = attrgetter(name)
    return lambda facts: value if isfinite(value := read(facts)) else None


def _sheet(window: Window, facts: Feasibility, write: _Writer) -> list[Entry]:
    """Numbers of the sheet as a whole, and of the holes through its plate."""
    x0, x1, y0, y1 = whole_extent(window)
    wide, high = write.text(x1 - x0), write.text(y1 - y0)
    rim = window.outline
    diameter = rim.diameter if isinstance(rim, Circle | Plate) else 0.0
    is_round = x1 - x0 <= diameter * (1.0 + 1e-12)  # no array protrudes from the other
    low, top = min(body.low for body in facts.bodies), max(body.high for body in facts.bodies)
    cells = "telescopelets" + (
        "" if window.lattice.outline is None else " that lie wholly inside the outline"
    )
    ratio = tuple(1.0 / m for m in focal_ratio(window.thin))
    entries: list[Entry] = [
        (
            "outer size",
            f"{wide} round" if is_round else f"{wide} x {high}",
            LENGTH,
            "of all bodies, seen along z",
        ),
        ("height", top - low, LENGTH, "from the lowest point of all bodies to the highest"),
        ("cells", cells_text(window.lattice), "", cells),
        ("index ratio n1/n2, lens x, y", ratio, "", INDEX_RATIO),
    ]
    if isinstance(rim, Plate) and rim.holes:
        land = "to the plate's edge or to another hole"
        entries += [
            ("holes through the plate", str(len(rim.holes)), "", "for mounting and for pins"),
            ("least land next to a hole", least_land(rim), LENGTH, land),
        ]
    return entries


INDEX_RATIO = (
    "−f1/f2 = 1/η: near the lens axis the sheet acts as the interface from a medium of index n1 to one of n2"
)

LENS: tuple[Entry, ...] = (
    ("focal length x, y", attrgetter("focal_length"), LENGTH, "of the equivalent thin lens"),
    (
        "focal length as built x, y",
        attrgetter("built_focal_length"),
        LENGTH,
        "of the lens as made, in air, about its own axis",
    ),
    ("centre thickness", attrgetter("thickness"), LENGTH, "from apex to apex, or to the plane face"),
    ("sag", attrgetter("sag"), LENGTH, "height range of the face over the optical zone of its cell"),
    (
        "rim half width x, y",
        attrgetter("rim"),
        LENGTH,
        "where the lens would end were it not cut to its cell",
    ),
    ("cover", attrgetter("cover"), "", "share of the optical zone where the lens exists"),
    ("least normal z", attrgetter("least_normal_z"), "", "cosine of the steepest slope against the sheet"),
    (
        "F-number x, y",
        attrgetter("f_number"),
        "",
        "focal length over the full width of the optical zone along that lens axis",
    ),
    ("least thickness over the cell", _finite("corner"), LENGTH, "negative: the lens ends before"),
    (
        "centre thickness that covers the cell",
        lambda lens: lens.least_thickness if lens.least_thickness > 0.0 else None,
        LENGTH,
        "at these radii",
    ),
)
"""Numbers of a lens; those of its shapes follow the second."""


def _shapes(lens: LensFacts, unit: str) -> list[Entry]:
    """Radii and conic constants, face by face where the faces differ; `unit` is that of shown lengths."""
    entries: list[Entry] = []
    for shape in lens.shapes or (FaceShape("", lens.radius, lens.conic, None),):
        of = f"{shape.side}, " if shape.side else ""
        entries += [
            (f"{of}apex radius x, y", shape.radius, LENGTH, "negative: concave"),
            (f"{of}conic constant x, y", shape.conic, "", "0: circle, -1: parabola"),
        ]
        for order, of_terms in MONOMIALS.items():
            name, power = f"{of}{order}: {', '.join(of_terms)}", f"1/{unit}{RAISED[POWER[order]]}"
            entries.append((name, getattr(shape, order), power, "outwards, on top of the conic"))
    return entries


BODY: tuple[Entry, ...] = (
    ("edge thickness", attrgetter("edge"), LENGTH, "least along the outer side"),
    ("neck", _finite("neck"), LENGTH, "least thickness that joins neighbours"),
    ("greatest step", attrgetter("step"), LENGTH, "of a face across a border of cells"),
    ("height range", attrgetter("low", "high"), LENGTH, "lowest and highest z"),
    ("pieces, holes", lambda body: f"{body.pieces}, {body.holes}", "", ""),
)

ASSEMBLY: tuple[Entry, ...] = (
    ("clearance", _finite("clearance"), LENGTH, "{gap}"),
    ("separation (in air)", attrgetter("separation"), LENGTH, "between the equivalent thin lenses, f1 + f2"),
)


def _field(window: Window, facts: Feasibility) -> list[Entry]:
    """Numbers of the field lens as a whole."""
    told = window.recipe["field"]
    pitch = max(window.lattice.pitch)
    wave = facts.wavelength / window.unit
    spot = two(1.22 * wave * f / pitch for f in window.thin.focal_length[0])
    plates = "2 of one part" if told.get("equal_plates") else None
    gap = float(told["gap"]) if "gap" in told else None
    return [
        ("plates", plates, "", "order the same part twice, put them back to back"),
        ("air gap between the plates", gap, LENGTH, "vertex to vertex"),
        (
            "spot on the field faces, x, y",
            spot,
            LENGTH,
            "1.22 λ f1/p: dirt, scratches and seams of that size on those faces are seen sharply, like things"
            " far away",
        ),
        (
            "power density there",
            (pitch / max(spot)) ** 2,
            "",
            "(p/spot)² times that on lens 1, for light of one direction: mind lasers",
        ),
    ]


def _imaging(window: Window, write: _Writer) -> list[Entry]:
    """Foci and nodal point of a sheet with a varying law, zone of a superlens; none of a uniform sheet."""
    laws = window.cell_laws
    if laws is not None and laws.own_lenses and laws.smooth is None:
        cells = window.lattice.cells()
        means = "of the cells; focal lengths and what follows from them are those of the middle one"
        turns = np.degrees(laws.angles_of(window.lattice, cells)[:, ::2].sum(axis=1))
        each = {"eta": laws.ratios_of(window.lattice, cells), "phi + psi (deg)": turns}
        told = [laws.ratios is not None, laws.angles is not None]
        return [
            (f"{name}, least and greatest", (float(numbers.min()), float(numbers.max())), "", means)
            for (name, numbers), differ in zip(each.items(), told, strict=True)
            if differ
        ]
    if laws is None or laws.smooth is None:
        return []
    x, y = along_axes(laws.smooth, window.thin.separation)
    planes = None
    if "focus" in window.recipe:
        ends = ("object", "-inf"), ("image", "inf")
        focus = window.recipe["focus"]
        planes = ", ".join(far if (z := focus[key]) is None else write.text(z) for key, far in ends)
    before, behind = (x.f_image, y.f_image), (x.f_object, y.f_object)
    nodal = "(η − 1)/κ, from array 1: light through it is not turned"
    sharp = "the object's height before array 1, the image's behind array 2"
    zone = zone_of(window)
    return [
        ("focus of light from before the sheet, lens x, y", before, LENGTH, "η/κ, from array 2"),
        ("focus of light from behind, lens x, y", behind, LENGTH, "−1/κ, from array 1"),
        ("nodal point, lens x, y", (x.nodal_z, y.nodal_z), LENGTH, nodal),
        ("planes that pairs image sharply", planes, LENGTH, sharp),
        *(() if zone is None else ((name, read(zone), unit, means) for name, read, unit, means in ZONE)),
    ]


ZONE: tuple[Entry, ...] = (
    (
        "width of one lens, x, y",
        attrgetter("width"),
        LENGTH,
        "p1²/|p2 − p1|, with a turn p1²/√((p2 − p1)² + 4 p1 p2 sin²(α/2)): over it light along"
        " the normal stays with its partner; a superlens is a lattice of lenses of that period",
    ),
    ("F-number of one lens, x, y", attrgetter("f_number"), "", "|f2|/p1; law.varying makes one large lens"),
    (
        "moire period, x, y",
        attrgetter("moire"),
        LENGTH,
        "of the two arrays: no field of a cell survives beyond it; over a pitch it is the"
        " magnification of a moire magnifier",
    ),
)

VIEW: tuple[Entry, ...] = (
    (
        "middle of the field, x, y",
        attrgetter("aperture"),
        "deg",
        "from the sheet's normal to the line from a cell's middle to its partner's",
    ),
    (
        "half field, lens x, y",
        attrgetter("half_field"),
        "deg",
        "off the middle of the field; beyond it no light meets the partner",
    ),
    (
        "first ghosts off the middle, lens x, y",
        attrgetter("ghost_onset"),
        "deg",
        "from there on some light meets a wrong lenslet",
    ),
    ("undeviated direction, x, y", attrgetter("undeviated"), "deg", "through both lens centres"),
    (
        "ray offset on the sheet, lens x, y",
        attrgetter("offset_blur"),
        LENGTH,
        "range over a cell of where light leaves less where it came",
    ),
    (
        "diffraction, lens x, y",
        attrgetter("diffraction_blur"),
        "mrad",
        "λ/w for the light that leaves lens 2, {wave}; w = √12 × rms distance, along that axis, of what"
        " is lit of a cell from its middle: the slit whose pattern has the same core (a square's own"
        " side, however it is turned)",
    ),
    (
        "diffraction, first zero, lens x, y",
        attrgetter("first_zero"),
        "mrad",
        "first dark line of that pattern; more than λ/w where a corner of the zone points along the axis",
    ),
    (
        "Fresnel number",
        attrgetter("fresnel_number"),
        "",
        "(w/2)²/(λ f2), the smaller of x and y, {wave}, the same w",
    ),
    (
        "lost to diffraction at most, lens x, y",
        attrgetter("viewing.lost"),
        "",
        ".164/√N, N along that axis: light that reaches neighbours of the partner, where the beam fills"
        " its cell",
    ),
)


def _pitches(eye: EyeAdvice, unit: float) -> list[Entry]:
    """Pitches recommended for an eye; `unit` is the window's, metres."""
    sharpest, fine = (two(p / unit for p in pitches) for pitches in (eye.sharpest, eye.fine))
    return [
        (
            "sharpest pitch, lens x, y",
            sharpest,
            LENGTH,
            "√(2λz/|η(1 − η)|)·max(1, |η|) for what lies z = {place}: larger cells are out of focus, smaller"
            " ones diffract",
        ),
        ("least blur, lens x, y", eye.blur, "mrad", "half of the light of a point {place}, at those pitches"),
        ("sharpest pitch", eye.advised / unit, LENGTH, "of the axis that is blurred more"),
        (
            "invisible pitch",
            eye.invisible / unit,
            LENGTH,
            "one minute of arc from {viewer} m: cells of this pitch are not seen; {conflict}",
        ),
        (
            "pitch with diffraction below 1′, lens x, y",
            fine,
            LENGTH,
            "λ/w ≤ 1′ for light that returns to the eye: what distant things need",
        ),
    ]


def _conflict(eye: EyeAdvice) -> str:
    """Describe the trade-off between invisible cells and sharp cells."""
    if eye.invisible >= eye.advised:
        return "the sharpest pitch is among them"
    return f"they blur more than the sharpest pitch, {digits(eye.advised / eye.invisible)} times as large"
