"""Given faces (`[[pair.face]]`), and the record of the search that found them (`[pair.search]`)."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal

from clacad.base.units import (
    A4,
    A6,
    A8,
    LENGTHS,
    MONOMIALS,
    NO_A4,
    NO_A6,
    NO_A8,
    POWER,
    RAISED,
    SHOWN,
    Unit,
    split,
)
from clacad.config.compound_kinds import REQUIRED, ListOf, Several, WordOr, key, written
from clacad.config.value_kinds import (
    LENGTH,
    LENGTH_ABOVE_0,
    LENGTH_FROM_0,
    Flag,
    JsonSchema,
    Quantity,
    Refusal,
    Text,
    Whole,
    WrittenAsRead,
    not_this,
)

if TYPE_CHECKING:  # a design is read without numpy
    from clacad.base.types import Pair2

_XY: Final = ("x", "y")


@dataclass(frozen=True, slots=True)
class Radius:
    """An apex radius: any length but 0, or inf (also as text) for a flat meridian."""

    def read(self, value: object, unit: Unit) -> float:
        """Return the radius in design units; refuse 0."""
        if value == "inf" or (isinstance(value, float) and value == math.inf):
            return math.inf
        try:
            radius = LENGTH.read(value, unit)
        except Refusal as refusal:
            refusal.allowed = self.allowed(unit)
            raise
        if radius == 0.0:
            raise Refusal("CL106", "is no radius", value, self.allowed(unit), "a flat face has radius = inf")
        return radius

    def write(self, value: float, unit: Unit) -> float | str:
        """Return the radius, or "inf"."""
        return "inf" if math.isinf(value) else value

    def allowed(self, unit: Unit) -> str:
        """Return the words of the message."""
        return (
            f"a length other than 0, > 0 where convex (bare = {unit.name}, or text with a unit:"
            f" {SHOWN['length']}), or inf"
        )

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of a number or text."""
        return {"anyOf": [LENGTH.schema(), {"const": "inf"}]}


@dataclass(frozen=True, slots=True)
class PerPower(WrittenAsRead):
    """A coefficient of an even term: a bare number in 1/unit^power, or a text such as "3.8e3 1/m^3"."""

    power: int

    def read(self, value: object, unit: Unit) -> float:
        """Return the coefficient in 1/unit^power, design units; refuse a text without its unit."""
        if isinstance(value, bool) or not isinstance(value, int | float | str):
            raise Refusal("CL104", not_this(value, "a number"), value, self.allowed(unit))
        try:
            number = self._with_unit(value, unit) if isinstance(value, str) else float(value)
        except OverflowError:
            number = math.inf
        if not abs(number) <= LARGEST_TERM:
            raise Refusal("CL106", "is out of range", value, self.allowed(unit))
        return number + 0.0  # -0.0 becomes 0.0

    def _with_unit(self, value: str, unit: Unit) -> float:
        number, slash, word = value.partition("1/")
        parts = split(number)
        if parts is None or parts[1]:
            raise Refusal("CL104", "is not a number with a unit", value, self.allowed(unit))
        if not slash:
            hint = f'write {value.strip()} without quotes, or "{value.strip()} {self._unit(unit)}"'
            raise Refusal("CL105", "has no unit", value, self.allowed(unit), hint)
        word = word.strip().removesuffix(RAISED[self.power]).removesuffix(str(self.power)).removesuffix("^")
        if word not in LENGTHS:
            raise Refusal("CL105", f"has an unknown unit '1/{word}^{self.power}'", value, self.allowed(unit))
        return float(parts[0] * (unit.metres / LENGTHS[word]) ** self.power)

    def allowed(self, unit: Unit) -> str:
        """Return the words of the message."""
        return f'a number (bare = {self._unit(unit)}, or text with a unit such as "1e-3 1/mm^{self.power}")'

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of a number or text."""
        raised = RAISED[self.power]
        pattern = rf"^\s*[-+0-9.eE]+\s+1/[a-z]+\^?({self.power}|{raised})\s*$"
        text: JsonSchema = {"type": "string", "pattern": pattern}
        return {"description": f"a number, in 1/unit{raised} where bare", "anyOf": [{"type": "number"}, text]}

    def _unit(self, unit: Unit) -> str:
        """The design's 1/unit^power in words."""
        return f"1/unit^{self.power}" if unit.name[:1].isdigit() else f"1/{unit.name}^{self.power}"


LARGEST_TERM: Final = 1e30
"""Largest coefficient of an even term, 1/unit^power: larger ones cannot be computed with."""

CONIC: Final = Quantity("ratio", "a number from -1e6 to 1e6", least=-1e6, most=1e6)


def _term(order: str, none: tuple[float, ...]) -> Any:
    """Key of the coefficients of one even order."""
    names = MONOMIALS[order]
    about = f"coefficients of {', '.join(names)}, > 0 outwards"
    return key(Several(PerPower(POWER[order]), names), about, none, later=True)


@dataclass(frozen=True, slots=True)
class FaceSpec:
    """One face as given, in its own lens frame.

    radius : (R_x, R_y), lengths. Apex radii, positive where convex, infinite where flat.
    conic : (K_x, K_y). Conic constants.
    a4 : (3,) tuple of float, 1/length³. Coefficients of x⁴, x² y² and y⁴, positive outwards.
    a6, a8 : (4,) and (5,) tuple of float, 1/length⁵ and 1/length⁷
        Coefficients of the next orders, from the highest power of x to the highest of y.
    after, z : float or None, lengths
        Of `form = "plates"`: vertex behind the previous face's, or from the first face's.
    array : 1, 2, "field" or None
        Of `form = "plates"`: on whose cells the face repeats; None: a plane under the whole sheet.
    behind : Of `form = "plates"`: material behind the face, or "air".

    In `form = "plates"` a radius is > 0 where the centre of curvature lies towards +z, and even terms count
    towards +z.
    """

    radius: Pair2 = key(
        Several(Radius(), _XY, single=True), "apex radii R_x, R_y, > 0 where convex", REQUIRED
    )
    conic: Pair2 = key(Several(CONIC, _XY, single=True), "conic constants K_x, K_y", (0.0, 0.0), later=True)
    a4: A4 = _term("a4", NO_A4)
    a6: A6 = _term("a6", NO_A6)
    a8: A8 = _term("a8", NO_A8)
    after: float | None = key(LENGTH_ABOVE_0, "plates: distance of the vertex behind the previous face's")
    z: float | None = key(LENGTH_FROM_0, "plates: place of the vertex, from the first face's")
    array: Literal[1, 2, "field"] | None = key(
        WordOr(("field",), Whole("1 | 2", most=2)),
        "plates: on whose cells the face repeats; without it a plane under the whole sheet",
    )
    behind: str | None = key(
        Text('"air", or the name of a material', 60), "plates: what lies behind the face"
    )

    @property
    def curvature(self) -> Pair2:
        """Apex curvatures (c_x, c_y), 1/length."""
        return 1.0 / self.radius[0], 1.0 / self.radius[1]

    @property
    def plane(self) -> bool:
        """Whether the face is flat everywhere."""
        return self.curvature == (0.0, 0.0) and not self.polynomial

    @property
    def polynomial(self) -> bool:
        """Whether the face has terms in addition to its conic."""
        return any(self.a4) or any(self.a6) or any(self.a8)


AIR: Final = "air"
"""Word for the medium behind a face that ends a plate."""


def listed_lenses(faces: tuple[FaceSpec, ...]) -> tuple[int, int]:
    """Number of faces of bodies with lenses, and of bodies; both bodies of a joint have its face."""
    solid = [before.behind != AIR for before in faces[:-1]]
    sides = [
        int(before) + int(behind) for before, behind in zip([False, *solid], [*solid, False], strict=True)
    ]
    lenses = sum(count for face, count in zip(faces, sides, strict=True) if face.array is not None)
    return lenses, sum(solid)


def vertices_of(faces: tuple[FaceSpec, ...]) -> list[float]:
    """Places of the vertices of listed faces from the first (lengths); no place counts as no distance."""
    found = [0.0]
    for face in faces[1:]:
        found.append(face.z if face.z is not None else found[-1] + (face.after or 0.0))
    return found


def face_table(face: FaceSpec) -> dict[str, Any]:
    """The face as a table of a design file, zeros left out."""
    return written(face, _ANY_UNIT)


_ANY_UNIT: Final = Unit("m", LENGTHS["m"])
"""Faces are written as bare numbers, in the unit of their design."""

_NUMBER: Final = Quantity("ratio", "a number", least=0.0)
_COUNT: Final = Whole("a whole number from 1")
_SHA: Final = Text("a SHA-256", 64, pattern="[0-9a-f]{64}")
_PAIRS: Final = (
    ListOf(Several(_NUMBER, ("part of the field", "weight")), "pairs"),
    ListOf(Several(_NUMBER, ("evaluations", "mrad")), "pairs"),
    ListOf(Several(_NUMBER, ("nm", "weight")), "pairs"),
)


@dataclass(frozen=True, slots=True)
class SearchRecord:
    """Start, settings and result of a search; nothing is built from it.

    start_sha256 : SHA-256 of the initial design.
    faces_sha256 : SHA-256 of the resulting faces (`faces_digest`).
    field_deg : Half angle of the cone of rays.
    weights : tuple of (part of the field, weight)
    tolerances : Whether the search optimised parts with fabrication errors instead of the perfect part.
    history : tuple of (evaluations, rms error in mrad)
        One entry for each improvement of the best by a tenth, and the first and the last.
    spectrum : tuple of (wavelength in nm, weight); empty: the design's wavelength alone.
    scan : Travel, axis and plates of a scan; None: the plates rest.
    """

    start_sha256: str = key(_SHA, "SHA-256 of the design that the search began with", REQUIRED)
    faces_sha256: str = key(_SHA, "SHA-256 of the faces that it found", REQUIRED)
    free: tuple[str, ...] = key(ListOf(Text("a word", 20), "texts"), "what was free", REQUIRED)
    field_deg: float = key(_NUMBER, "half angle of the cone of rays, degrees", REQUIRED)
    weights: tuple[tuple[float, float], ...] = key(_PAIRS[0], "weights of parts of the field", REQUIRED)
    tolerances: bool = key(Flag(), "whether parts with errors were searched", REQUIRED)
    unknowns: int = key(_COUNT, "number of unknowns", REQUIRED)
    rays: int = key(_COUNT, "number of rays", REQUIRED)
    history: tuple[tuple[float, float], ...] = key(_PAIRS[1], "rms error after evaluations", REQUIRED)
    spectrum: tuple[tuple[float, float], ...] = key(_PAIRS[2], "lines of white light and their weights", ())
    scan: str | None = key(Text("a scan", 200), "travel and plates of the scan that was searched")

    def to_dict(self) -> dict[str, Any]:
        """The table of a design file."""
        return written(self, _ANY_UNIT)


def faces_digest(faces: Iterable[FaceSpec]) -> str:
    """SHA-256 of faces; it reveals changes after the search."""
    return hashlib.sha256(repr([face_table(face) for face in faces]).encode()).hexdigest()
