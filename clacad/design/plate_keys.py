"""Keys of mounting plates: kinds of value of polygon outlines, corners, holes and pins,
and the values they are read into.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal

from clacad.base.units import Unit
from clacad.config.compound_kinds import InlineTable, ListOf, each
from clacad.config.quantities import Quantity
from clacad.config.value_kinds import JsonSchema, Refusal, Whole, not_this

if TYPE_CHECKING:  # a design is read without numpy
    from clacad.base.types import Pair2

MOST_VERTICES: Final = 10_000
"""Greatest number of corners of an outline."""

MOST_HOLES: Final = 1000
"""Greatest number of positions of one kind of hole."""

_ABOVE_0: Final = Quantity("length", "a length > 0", above=0.0)
_FROM_0: Final = Quantity("length", "a length >= 0", least=0.0)
_LATERAL: Final = Quantity("length", "a length")
_ANGLE: Final = Quantity("angle", "an angle from -360 to 360 deg", least=-360.0, most=360.0, degrees=True)
_BULGE: Final = Quantity("ratio", "a bulge from -1000 to 1000", least=-1000.0, most=1000.0)

Vertex = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Points:
    """A list of points [x, y]; with `bulges` also [x, y, bulge]. Read into (x, y) or (x, y, bulge)."""

    least: int
    most: int
    bulges: bool = False

    def read(self, value: object, unit: Unit) -> tuple[tuple[float, ...], ...]:
        """Return the points in design units; refuse too few, too many, and values that are no points."""
        if not isinstance(value, list):
            raise Refusal("CL104", not_this(value, "a list"), value, self.allowed(unit))
        if not self.least <= len(value) <= self.most:
            count = f"has {len(value)} point{'s' * (len(value) != 1)}"
            shown = value if len(value) < self.least else [*value[:2], "…"]
            raise Refusal("CL108", count, shown, self.allowed(unit))
        return tuple(each(((n, _Point(self.bulges), item) for n, item in enumerate(value)), unit))

    def allowed(self, unit: Unit) -> str:
        """Return the form of the list."""
        one = _Point(self.bulges).allowed(unit)
        return f"a list of {self.least} to {self.most} points, each {one}"

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of an array of points."""
        return {
            "type": "array",
            "items": _Point(self.bulges).schema(),
            "minItems": self.least,
            "maxItems": self.most,
        }


@dataclass(frozen=True, slots=True)
class _Point:
    """One point."""

    bulges: bool

    def read(self, value: object, unit: Unit) -> tuple[float, ...]:
        """Return the point's numbers; a missing bulge is 0."""
        if not isinstance(value, list):
            raise Refusal("CL104", not_this(value, "a list"), value, self.allowed(unit))
        if len(value) != 2 and not (self.bulges and len(value) == 3):
            raise Refusal("CL108", f"has {len(value)} values", value, self.allowed(unit))
        kinds = (_LATERAL, _LATERAL, _BULGE)
        found = tuple(each(((n, kinds[n], item) for n, item in enumerate(value)), unit))
        return (*found, 0.0) if self.bulges and len(found) == 2 else found

    def allowed(self, unit: Unit) -> str:
        """Return the form of a point."""
        bulge = " or [x, y, bulge]" if self.bulges else ""
        return f"[x, y]{bulge}, lengths (bare = {unit.name}, or text with a unit)"

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of a short array."""
        return {
            "type": "array",
            "items": _LATERAL.schema(),
            "minItems": 2,
            "maxItems": 3 if self.bulges else 2,
        }


@dataclass(frozen=True, slots=True)
class CornersSpec:
    """Corners of a rectangular plate: rounded with a radius, or cut off by a leg along each side (length)."""

    shape: Literal["round", "chamfer"]
    size: float


@dataclass(frozen=True, slots=True)
class HoleSpec:
    """Through holes of one diameter. Exactly one of `at`, `circle` and `corners` gives their positions.

    Parameters
    ----------
    diameter : float, length
    at : tuple of (x, y), lengths
    circle : float or None, length
        Diameter of a bolt circle about the centre of the sheet, with `count` holes, the first at the angle
        `start` (degrees from +x).
    corners : float or None, length
        One hole in each corner of a rectangular plate, at this distance from both sides.
    """

    diameter: float
    at: tuple[Pair2, ...] = ()
    circle: float | None = None
    count: int | None = None
    start: float = 0.0
    corners: float | None = None

    def places(self, size: Pair2) -> tuple[Pair2, ...]:
        """Centres of the holes on a plate with a bounding rectangle of these sides (lengths)."""
        if self.corners is not None:
            x, y = 0.5 * size[0] - self.corners, 0.5 * size[1] - self.corners
            return (x, -y), (x, y), (-x, y), (-x, -y)
        if self.circle is None or self.count is None:
            return self.at
        turns = (math.radians(self.start + 360.0 * n / self.count) for n in range(self.count))
        radius = 0.5 * self.circle
        return tuple((radius * math.cos(turn), radius * math.sin(turn)) for turn in turns)


@dataclass(frozen=True, slots=True)
class PinsSpec:
    """Dowel pins that align the two bodies: holes through both.

    Parameters
    ----------
    diameter : float, length
        Diameter of the pin.
    at : tuple of (x, y), lengths
    play : float, length
        Excess of the hole's diameter over the pin's.
    """

    diameter: float
    at: tuple[Pair2, ...]
    play: float


CORNERS: Final = InlineTable((("round", _ABOVE_0), ("chamfer", _ABOVE_0)), exactly_one=True)
"""Kind of `body.corners`."""

HOLES: Final = ListOf(
    InlineTable(
        (
            ("diameter", _ABOVE_0),
            ("at", Points(1, MOST_HOLES)),
            ("circle", _ABOVE_0),
            ("count", Whole("a whole number from 1 to 360", most=360)),
            ("start", _ANGLE),
            ("corners", _ABOVE_0),
        ),
        required=("diameter",),
    ),
    "tables",
)
"""Kind of `body.holes`."""

PINS: Final = InlineTable(
    (("diameter", _ABOVE_0), ("at", Points(2, 16)), ("play", _FROM_0)), required=("diameter", "at", "play")
)
"""Kind of `body.pins`."""

POLYGON: Final = Points(2, MOST_VERTICES, bulges=True)
"""Kind of `lattice.outline.polygon`; two points are enough where both sides are arcs."""

Table = tuple[tuple[Any, Any], ...]


def corners_read(table: Table | None) -> CornersSpec | None:
    """Corners from the table that `CORNERS` read."""
    return None if table is None else CornersSpec(table[0][0], table[0][1])


def holes_read(tables: Iterable[Table]) -> tuple[HoleSpec, ...]:
    """Holes from the tables that `HOLES` read."""
    return tuple(HoleSpec(**dict(table)) for table in tables)


def pins_read(table: Table | None) -> PinsSpec | None:
    """Pins from the table that `PINS` read."""
    return None if table is None else PinsSpec(**dict(table))


def hole_table(hole: HoleSpec) -> dict[str, Any]:
    """A hole specification as a table of a design file; `HOLES` reads it back."""
    made: dict[str, Any] = {"diameter": hole.diameter}
    if hole.at:
        made["at"] = [list(point) for point in hole.at]
    if hole.circle is not None:
        made |= {"circle": hole.circle, "count": hole.count}
        made |= {"start": hole.start} if hole.start else {}
    if hole.corners is not None:
        made["corners"] = hole.corners
    return made


def vertex_lists(points: Iterable[Vertex]) -> list[list[float]]:
    """Corners as lists of a design file, zero bulges left out."""
    return [[x, y] if bulge == 0.0 else [x, y, bulge] for x, y, bulge in points]


def box_about_origin(points: Iterable[Vertex]) -> Pair2:
    """Sides of the smallest box centred on the origin that contains a polygon of straight and round sides
    (lengths).
    """
    from clacad.sheet.plate import Plate

    across, along = Plate(tuple(points)).reach
    return 2.0 * across, 2.0 * along
