"""Section [body] and outlines: mounting plates with their edges, corners, holes, pins, baffle and frame.

Lengths in design units.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from math import floor, sqrt
from typing import TYPE_CHECKING, Any, Final, Literal

from clacad.base.text import count_text
from clacad.base.units import Unit
from clacad.config.compound_kinds import REQUIRED, ListOf, OneOf, Record, Several, each, key
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

MOST_VERTICES: Final = 10_000
"""Greatest number of corners of an outline."""

MOST_HOLES: Final = 1000
"""Greatest number of positions of one kind of hole."""

ROUNDING: Final = 1e-9
"""Tolerance of a size in cells: a size within it of a whole number holds that many."""

_ANGLE: Final = Quantity("angle", "an angle from -360 to 360 deg", least=-360.0, most=360.0, degrees=True)
_BULGE: Final = Quantity("ratio", "a bulge from -1000 to 1000", least=-1000.0, most=1000.0)
_SMALL_ANGLE: Final = Quantity("angle", "an angle >= 0 and below 90 deg", least=0.0, most=math.pi / 2)

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
            count = f"has {count_text(len(value), 'point')}"
            shown = value if len(value) < self.least else [*value[:2], "…"]
            raise Refusal("CL108", count, shown, self.allowed(unit))
        return tuple(each(((n, _Point(self.bulges), item) for n, item in enumerate(value)), unit))

    def write(self, value: tuple[tuple[float, ...], ...], unit: Unit) -> list[list[float]]:
        """Return the points as lists, zero bulges left out."""
        return [[*point[:2]] if self.bulges and point[2] == 0.0 else [*point] for point in value]

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
class _Point(WrittenAsRead):
    """One point."""

    bulges: bool

    def read(self, value: object, unit: Unit) -> tuple[float, ...]:
        """Return the point's numbers; a missing bulge is 0."""
        if not isinstance(value, list):
            raise Refusal("CL104", not_this(value, "a list"), value, self.allowed(unit))
        if len(value) != 2 and not (self.bulges and len(value) == 3):
            raise Refusal("CL108", f"has {len(value)} values", value, self.allowed(unit))
        kinds = (LENGTH, LENGTH, _BULGE)
        found = tuple(each(((n, kinds[n], item) for n, item in enumerate(value)), unit))
        return (*found, 0.0) if self.bulges and len(found) == 2 else found

    def allowed(self, unit: Unit) -> str:
        """Return the form of a point."""
        bulge = " or [x, y, bulge]" if self.bulges else ""
        return f"[x, y]{bulge}, lengths (bare = {unit.name}, or text with a unit)"

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of a short array."""
        return {"type": "array", "items": LENGTH.schema(), "minItems": 2, "maxItems": 3 if self.bulges else 2}


VERTICES: Final = Points(2, MOST_VERTICES, bulges=True)
"""Kind of the corners of a polygon; two points are enough where both sides are arcs."""


@dataclass(frozen=True, slots=True)
class Outline:
    """Outer shape of the sheet: a circle of diameter size[0], a rectangle size[0] by size[1], or a polygon.

    For a polygon, `points` are the corners (x, y, bulge of the side that begins there), lengths; `size` is
    that of the box centred on the origin that contains it. The shape "dxf" is a drawing that could not be
    read: no design has it.
    """

    shape: Literal["circle", "rectangle", "polygon", "dxf"]
    size: Pair2
    points: tuple[Vertex, ...] = ()

    @staticmethod
    def made(shape: str, value: Any) -> Outline:
        """Outline from the key and the value of its table."""
        if shape == "circle":
            return Outline("circle", (value, value))
        if shape == "rectangle":
            return Outline("rectangle", value)
        return Outline("dxf", (0.0, 0.0)) if shape == "dxf" else Outline("polygon", (0.0, 0.0), value)

    @property
    def box(self) -> Pair2:
        """Sides of the smallest box centred on the origin that contains the outline (lengths)."""
        return _box(self.points) if self.points else self.size

    @property
    def parts(self) -> tuple[str, Any]:
        """Key and value of the outline's table."""
        sizes = {"circle": self.size[0], "rectangle": self.size}
        return self.shape, sizes.get(self.shape, self.points)


OUTLINE: Final = OneOf(
    (
        ("circle", LENGTH_ABOVE_0),
        ("rectangle", Several(LENGTH_ABOVE_0, ("width", "height"))),
        ("polygon", VERTICES),
        ("dxf", Text("the name of a DXF file in the design's folder", 200)),
    ),
    Outline.made,
    lambda outline: outline.parts,
)
"""Kind of an outline."""


def _box(points: Iterable[Vertex]) -> Pair2:
    """Sides (lengths) of the smallest centred box that contains a polygon of straight and round sides."""
    from clacad.sheet.plate import Plate

    across, along = Plate(tuple(points)).reach
    return 2.0 * across, 2.0 * along


def filling_count(kind: str, pitch: tuple[float, float], size: tuple[float, float]) -> tuple[int, int]:
    """Cells along the two lattice vectors that fill an outline; cells beyond it are left out later.

    A cell wholly inside a width w lies within ±w/2, so floor(w/p) columns centred on the origin miss none.
    Rows of a hexagonal lattice are √3/2 of the pitch apart, and their cells are 2/√3 of the pitch high. Every
    other row is displaced by half a pitch, a quarter to either side of the centre: one more column than
    floor(w/p) misses none.

    kind : {"square", "rectangular", "hexagonal"}
    pitch : (p_x, p_y), lengths. Hexagonal: centre to centre, given twice.
    size : (width, height), lengths. Size of the outline; a circle's diameter twice.
    Returns (n1, n2): At least 1 each.
    """
    if kind == "hexagonal":
        rows = _whole((size[1] - pitch[0] * 2.0 / sqrt(3.0)) / (pitch[0] * 0.5 * sqrt(3.0))) + 1
        return max(1, _whole(size[0] / pitch[0]) + 1), max(1, rows)
    return max(1, _whole(size[0] / pitch[0])), max(1, _whole(size[1] / pitch[1]))


def _whole(ratio: float) -> int:
    return floor(ratio + ROUNDING)


@dataclass(frozen=True, slots=True)
class CornersSpec:
    """Corners of a rectangular plate: rounded with a radius, or cut off by a leg along each side (length)."""

    shape: Literal["round", "chamfer"]
    size: float


@dataclass(frozen=True, slots=True)
class HoleSpec:
    """Through holes of one diameter. Exactly one of `at`, `circle` and `corners` gives their positions.

    diameter : length
    at : tuple of (x, y), lengths
    circle : float or None, length. Diameter of a bolt circle about the centre of the sheet, with `count`
        holes, the first at the angle `start` (degrees from +x).
    corners : float or None, length
        One hole in each corner of a rectangular plate, at this distance from both sides.
    """

    diameter: float = key(LENGTH_ABOVE_0, "diameter of the holes", REQUIRED)
    at: tuple[Pair2, ...] = key(Points(1, MOST_HOLES), "centres of the holes", ())
    circle: float | None = key(LENGTH_ABOVE_0, "diameter of a bolt circle")
    count: int | None = key(Whole("a whole number from 1 to 360", most=360), "holes on the circle")
    start: float = key(_ANGLE, "direction of the first hole on the circle, from +x", 0.0, later=True)
    corners: float | None = key(LENGTH_ABOVE_0, "distance from both sides of a hole in each corner")

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
    """Dowel pins that align the plates: holes through all.

    diameter : length. Diameter of the pin.
    at : tuple of (x, y), lengths
    play : length. Excess of the hole's diameter over the pin's.
    """

    diameter: float = key(LENGTH_ABOVE_0, "diameter of the pins", REQUIRED)
    at: tuple[Pair2, ...] = key(Points(2, 16), "centres of the pins", REQUIRED)
    play: float = key(LENGTH_FROM_0, "diameter of the hole less that of the pin", REQUIRED)


@dataclass(frozen=True, slots=True)
class Frame:
    """Opaque frame around the sheet: width beyond the border, height along z (None: as high as the sheet)."""

    width: float = key(LENGTH_ABOVE_0, "width of the frame", REQUIRED)
    height: float | None = key(LENGTH_ABOVE_0, "height of the frame; that of the sheet by default")


CORNERS: Final = OneOf(
    (("round", LENGTH_ABOVE_0), ("chamfer", LENGTH_ABOVE_0)),
    lambda shape, size: CornersSpec(shape, size),  # type: ignore[arg-type]
    lambda corners: (corners.shape, corners.size),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class BodySpec:
    """Section [body]: parts in addition to the lenses. Lengths in design units.

    None of `neck` means max(process minimum, pitch/50), of `corners` sharp ones; `baffle_wall` is given with
    `baffle`, and `outline` replaces `border`.
    """

    border: float = key(
        LENGTH_FROM_0, "width of the land round the sheet, beyond lattice.outline where there is one", 0.0
    )
    outline: Outline | None = key(
        OUTLINE,
        "edge of the plate where it is not that of the cells, which lie wholly inside; instead of border",
    )
    corners: CornersSpec | None = key(CORNERS, "rounded or chamfered corners of a rectangular plate")
    holes: tuple[HoleSpec, ...] = key(
        ListOf(Record(HoleSpec), "tables"), "round holes through every plate, in its border", ()
    )
    pins: PinsSpec | None = key(
        Record(PinsSpec), "dowel pins that align the plates: holes through all, and their play"
    )
    neck: float | None = key(LENGTH_ABOVE_0, "least thickness left at a border between cells")
    baffle: bool = key(Flag(), "opaque honeycomb between the arrays", False)
    baffle_wall: float | None = key(LENGTH_ABOVE_0, "wall thickness of the baffle")
    frame: Frame | None = key(Record(Frame), "opaque frame round the sheet")
    roughness: float = key(LENGTH_FROM_0, "rms roughness of the optical faces", 0.0)
    slope_rms: float = key(_SMALL_ANGLE, "rms slope error of the optical faces", 0.0)

    @property
    def apart(self) -> bool:
        """Whether the plate has its own edge, separate from `lattice.outline`."""
        return self.border > 0.0 or self.outline is not None

    @property
    def shaped(self) -> bool:
        """Whether corners, holes or pins are requested."""
        return self.corners is not None or bool(self.holes) or self.pins is not None
