"""Faces that stand as given (`[[pair.face]]`): their kinds of value, and the value they are read into."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

from clacad.base.units import SHOWN, Unit
from clacad.config.compound_kinds import InlineTable, ListOf, Several
from clacad.config.quantities import Quantity
from clacad.config.value_kinds import JsonSchema, Refusal

Pair2 = tuple[float, float]
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
    """

    radius: Pair2
    conic: Pair2 = (0.0, 0.0)

    @property
    def curvature(self) -> Pair2:
        """Apex curvatures (c_x, c_y), 1/length."""
        return 1.0 / self.radius[0], 1.0 / self.radius[1]

    @property
    def plane(self) -> bool:
        """Whether the face is flat everywhere."""
        return self.curvature == (0.0, 0.0)


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


_LENGTH: Final = Quantity("length", "a length")
_CONIC: Final = Quantity("ratio", "a number from -1e6 to 1e6", least=-1e6, most=1e6)

FACES: Final = ListOf(
    InlineTable(
        (
            ("radius", Several(Radius(), _XY, single=True)),
            ("conic", Several(_CONIC, _XY, single=True)),
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
    return made
