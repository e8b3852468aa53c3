"""Faces that stand as given (`[[pair.face]]`): their kinds of value, and the value they are read into."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from clacad.base.units import LENGTHS, SHOWN, Unit, split
from clacad.config.compound_kinds import InlineTable, ListOf, Several
from clacad.config.quantities import Quantity
from clacad.config.value_kinds import JsonSchema, Refusal, not_this

if TYPE_CHECKING:  # a design is read without numpy
    from clacad.base.types import Pair2

_XY: Final = ("x", "y")


@dataclass(frozen=True, slots=True)
class FaceSpec:
    """One face as given, in its own lens frame.

    Parameters
    ----------
    radius : (R_x, R_y), lengths
        Apex radii, positive where convex, infinite where flat.
    conic : (K_x, K_y)
        Conic constants.
    a4 : (3,) tuple of float, 1/length³
        Coefficients of x⁴, x² y² and y⁴, positive outwards.
    """

    radius: Pair2
    conic: Pair2 = (0.0, 0.0)
    a4: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def curvature(self) -> Pair2:
        """Apex curvatures (c_x, c_y), 1/length."""
        return 1.0 / self.radius[0], 1.0 / self.radius[1]

    @property
    def plane(self) -> bool:
        """Whether the face is flat everywhere."""
        return self.curvature == (0.0, 0.0) and not any(self.a4)


@dataclass(frozen=True, slots=True)
class Radius:
    """An apex radius: any length but 0, or inf (also as text) for a flat meridian."""

    def read(self, value: object, unit: Unit) -> float:
        """Return the radius in design units; refuse 0."""
        if value == "inf" or (isinstance(value, float) and value == math.inf):
            return math.inf
        try:
            radius = _LENGTH.read(value, unit)
        except Refusal as refusal:
            refusal.allowed = self.allowed(unit)
            raise
        if radius == 0.0:
            raise Refusal("CL106", "is no radius", value, self.allowed(unit), "a flat face has radius = inf")
        return radius

    def allowed(self, unit: Unit) -> str:
        """Return the words of the message."""
        return f"a length other than 0, > 0 where convex (bare = {unit.name}, or text with a unit: {SHOWN['length']}), or inf"

    def schema(self) -> JsonSchema:
        """Give the JSON Schema of a number or text."""
        return {"anyOf": [_LENGTH.schema(), {"const": "inf"}]}


@dataclass(frozen=True, slots=True)
class PerVolume:
    """A coefficient of fourth order: a bare number in 1/unit³, or a text such as "3.8e3 1/m^3"."""

    def read(self, value: object, unit: Unit) -> float:
        """Return the coefficient in 1/design unit³; refuse a text without a unit, or with another one."""
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
            hint = f'write {value.strip()} without quotes, or "{value.strip()} {_cube(unit)}"'
            raise Refusal("CL105", "has no unit", value, self.allowed(unit), hint)
        word = word.strip().removesuffix("³").removesuffix("^3").removesuffix("3")
        if word not in LENGTHS:
            raise Refusal("CL105", f"has an unknown unit '1/{word}^3'", value, self.allowed(unit))
        return float(parts[0] * (unit.metres / LENGTHS[word]) ** 3)

    def allowed(self, unit: Unit) -> str:
        """Return the words of the message."""
        return f'a number (bare = {_cube(unit)}, or text with a unit such as "1e-3 1/mm^3")'

    def schema(self) -> JsonSchema:
        """Give the JSON Schema of a number or text."""
        text: JsonSchema = {"type": "string", "pattern": r"^\s*[-+0-9.eE]+\s+1/[a-z]+\^?(3|³)\s*$"}
        return {"description": "a number, in 1/unit³ where bare", "anyOf": [{"type": "number"}, text]}


def _cube(unit: Unit) -> str:
    """The design's 1/unit³ in words."""
    return "1/unit^3" if unit.name[:1].isdigit() else f"1/{unit.name}^3"


LARGEST_TERM: Final = 1e30
"""Largest coefficient of fourth order, 1/unit³: beyond it nothing could be computed."""

_LENGTH: Final = Quantity("length", "a length")
_CONIC: Final = Quantity("ratio", "a number from -1e6 to 1e6", least=-1e6, most=1e6)

FACES: Final = ListOf(
    InlineTable(
        (
            ("radius", Several(Radius(), _XY, single=True)),
            ("conic", Several(_CONIC, _XY, single=True)),
            ("a4", Several(PerVolume(), ("x⁴", "x² y²", "y⁴"))),
        ),
        required=("radius",),
    ),
    "tables",
)
"""Kind of the value of `pair.face`."""


def faces_read(tables: Iterable[tuple[tuple[str, Any], ...]]) -> tuple[FaceSpec, ...]:
    """Faces from the tables that `FACES` read."""
    return tuple(FaceSpec(**dict(table)) for table in tables)


def face_table(face: FaceSpec) -> dict[str, Any]:
    """The face as a table of a design file, what is 0 left out; `FACES` reads it back."""
    made: dict[str, Any] = {"radius": ["inf" if math.isinf(r) else r for r in face.radius]}
    if face.conic != (0.0, 0.0):
        made["conic"] = list(face.conic)
    if any(face.a4):
        made["a4"] = list(face.a4)
    return made
