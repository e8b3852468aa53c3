"""A drawing board: shapes, dimension lines with numbers, leaders; recorded, and returned as SVG.

Notes of a drawing: allowed deviations, and how the sheet is oriented.

Allowed deviations of a part, in millimetres, as drawings state them: from the [tolerances] of its design.

How the part must be held, derived from its geometry alone: light, lenses, outline and holes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats
from clacad.base.units import millimetres
from clacad.optics.surface import sag
from clacad.sheet.edge_columns import CX, CY, RADIUS, X0, X1, Y0, Y1
from clacad.sheet.plate import Plate
from clacad.sheet.window import Face, Window

if TYPE_CHECKING:
    from clacad.design import Design


Point = tuple[float, float]

CHARACTER = 6.3
"""Width of a character of the 11 px type, on average, px."""

STYLE = (
    "text{font:11px system-ui,'Segoe"
    " UI',Helvetica,Arial,sans-serif;fill:#1c2733}"
    ".note{fill:#5c6b78}.title{font-weight:bold}.body{fill:#cfe3f1;stroke:#1b6ca8;stroke-width:1}"
    ".cut{fill:#e3eff7;stroke:#1b6ca8;stroke-width:1}.dim{stroke:#1c2733;stroke-width:.8;fill:none}"
    ".ext{stroke:#8b98a5;stroke-width:.6;fill:none}"
    ".axis{stroke:#8b98a5;stroke-width:.8;stroke-dasharray:9"
    " 3 2 3;fill:none}.ray{stroke:#c2571a;stroke-width:.9;fill:none}"
    ".focus{stroke:#2b7a4b;stroke-width:1;stroke-dasharray:4"
    " 3;fill:none}.head{fill:#1c2733}.mark{fill:#c2571a}.frame{stroke:#1c2733;stroke-width:2.4;fill:none}"
)


@dataclass(frozen=True, eq=False)
class LineMark:
    """A line through points (k, 2), px, or the closed outline that they form."""

    points: Floats
    kind: str
    closed: bool = False


@dataclass(frozen=True, slots=True)
class CircleMark:
    """A circle, px."""

    at: Point
    radius: float
    kind: str


@dataclass(frozen=True, slots=True)
class Words:
    """Text at a position, px; `anchor`: start, middle or end; `room`: width of its background, px, or 0."""

    at: Point
    words: str
    anchor: str = "middle"
    kind: str = ""
    room: float = 0.0


@dataclass(frozen=True, slots=True)
class ScaleNote:
    """Position at which a view prints its scale, which depends on the paper."""

    at: Point


@dataclass(frozen=True, eq=False)
class DimensionMark:
    """A dimension: its two end points, a point of its line, its words, and the marks it is drawn with."""

    ends: tuple[Point, Point]
    base: Point
    upright: bool
    words: str
    drawn: tuple[LineMark | Words, ...]


Mark = LineMark | CircleMark | Words | ScaleNote | DimensionMark


class Canvas:
    """Drawing board in pixels, y downwards; it records what is drawn, for a page or for paper.

    scale : Pixels a millimetre of the part, where the view is to scale.
    """

    def __init__(self, width: float, height: float, label: str, scale: float | None = None) -> None:
        self.width, self.height, self.label, self.scale = width, height, label, scale
        self.marks: list[Mark] = []

    def polygon(self, points: Floats, kind: str) -> None:
        """Draw a closed outline (k, 2)."""
        self.marks.append(LineMark(np.asarray(points, dtype=np.float64), kind, closed=True))

    def line(self, points: Floats | Sequence[Point], kind: str) -> None:
        """Draw a line through points (k, 2)."""
        self.marks.append(LineMark(np.asarray(points, dtype=np.float64), kind))

    def circle(self, at: Point, radius: float, kind: str) -> None:
        """Draw a circle."""
        self.marks.append(CircleMark(at, radius, kind))

    def text(self, at: Point, words: str, anchor: str = "middle", kind: str = "") -> None:
        """Write words; `anchor` is start, middle or end."""
        self.marks.append(Words(at, words, anchor, kind))

    def scale_note(self, at: Point) -> None:
        """Print the scale from here on."""
        self.marks.append(ScaleNote(at))

    def across(self, x0: float, x1: float, y: float, words: str, start: tuple[float, float]) -> None:
        """Dimension between two x at height y; extension lines come from `start` (y at x0, y at x1)."""
        drawn: list[LineMark | Words] = [
            _line([(x, from_y), (x, y + (4 if y > from_y else -4))], "ext")
            for x, from_y in zip((x0, x1), start, strict=True)
        ]
        room = abs(x1 - x0)
        wide = CHARACTER * len(words)
        drawn += _measure((x0, y), (x1, y), inside=room > 26)
        if room > wide + 18:
            drawn.append(_backed((0.5 * (x0 + x1), y - 4), words, "middle"))
        elif max(x0, x1) + wide + 22 < self.width:
            drawn.append(_backed((max(x0, x1) + (4 if room > 26 else 16), y + 4), words, "start"))
        else:
            drawn.append(_backed((min(x0, x1) - (4 if room > 26 else 16), y + 4), words, "end"))
        ends = ((x0, start[0]), (x1, start[1]))
        self.marks.append(DimensionMark(ends, (x0, y), False, words, tuple(drawn)))

    def upright(self, y0: float, y1: float, x: float, words: str, start: tuple[float, float]) -> None:
        """Dimension between two y at place x, its words outside; extension lines come from `start` (x at y0,
        x at y1).
        """
        drawn: list[LineMark | Words] = [
            _line([(from_x, y), (x + (4 if x > from_x else -4), y)], "ext")
            for y, from_x in zip((y0, y1), start, strict=True)
        ]
        room = abs(y1 - y0)
        drawn += _measure((x, y0), (x, y1), inside=room > 26)
        right = x >= max(start)
        middle = 0.5 * (y0 + y1) if room > 14 else min(y0, y1) - 16
        drawn.append(_backed((x + (5 if right else -5), middle + 4), words, "start" if right else "end"))
        ends = ((start[0], y0), (start[1], y1))
        self.marks.append(DimensionMark(ends, (x, y0), True, words, tuple(drawn)))

    def leader(self, tip: Point, elbow: Point) -> None:
        """A line that points at something."""
        self.line([elbow, tip], "dim")
        self.marks.append(_head(tip, np.subtract(tip, elbow)))

    def datum(self, tip: Point, way: Point, letter: str) -> None:
        """A boxed letter at the offset `way` from the edge it names."""
        middle = (tip[0] + way[0], tip[1] + way[1])
        half = 6.0
        near = tuple(np.asarray(middle) - half * np.sign(way))
        self.line([near, tip], "dim")
        self.marks.append(_head(tip, np.subtract(tip, near)))
        corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
        self.polygon(np.asarray(corners) + middle, "dim")
        self.text((middle[0], middle[1] + 4.0), letter)

    def finish(self, tip: Point, letter: str) -> None:
        """Draw the symbol of surface texture (ISO 21920-1) on a face, with its letter in the table."""
        legs = [(-4.6, -8.0), (0.0, 0.0), (9.2, -16.0), (9.2 + 4.0 + CHARACTER * len(letter), -16.0)]
        self.line(np.asarray(legs) + tip, "dim")
        self.text((tip[0] + 10.0, tip[1] - 5.0), letter, "start")

    def body(self, zoom: float = 1.0) -> str:
        """The marks as SVG; `zoom`: enlargement of what is drawn at 96 px an inch."""
        return "\n".join(_svg(mark, self.scale, zoom) for mark in self.marks)

    def svg(self) -> str:
        """The drawing as one SVG element with a label of its content."""
        rules = "".join(f".drawing {rule}}}" for rule in STYLE.split("}") if rule)
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" class="drawing" viewBox="0 0 {self.width:.0f}'
            f' {self.height:.0f}" width="{self.width:.0f}" height="{self.height:.0f}" role="img"'
            f' aria-label="{escape(self.label, quote=True)}"><style>{rules}</style>\n{self.body()}\n</svg>'
        )


def scale_text(pixels_per_mm: float) -> str:
    """Scale of a drawing on the page, taken at 96 px an inch."""
    ratio = pixels_per_mm * 25.4 / 96.0
    return f"{ratio:.3g} : 1" if ratio >= 1 else f"1 : {1 / ratio:.3g}"


def _line(points: Sequence[Point], kind: str) -> LineMark:
    return LineMark(np.asarray(points, dtype=np.float64), kind)


def _backed(at: Point, words: str, anchor: str) -> Words:
    return Words(at, words, anchor, room=CHARACTER * len(words))


def _measure(a: Point, b: Point, inside: bool) -> list[LineMark]:
    """Dimension line with its heads, from inside or, where there is no room, from outside."""
    way = np.subtract(b, a)
    length = float(np.hypot(*way))
    if length == 0.0:
        return []
    unit = way / length
    if inside:
        return [_line([a, b], "dim"), _head(a, -unit), _head(b, unit)]
    return [
        LineMark(np.array([np.asarray(a) - 14 * unit, a]), "dim"),
        LineMark(np.array([b, np.asarray(b) + 14 * unit]), "dim"),
        _head(a, unit),
        _head(b, -unit),
    ]


def _head(tip: Point, way: Floats) -> LineMark:
    unit = np.asarray(way, dtype=np.float64)
    unit = unit / max(float(np.hypot(*unit)), 1e-9)
    aside = np.array([-unit[1], unit[0]])
    corners = np.array([tip, tip - 7 * unit + 2.2 * aside, tip - 7 * unit - 2.2 * aside])
    return LineMark(corners, "head", closed=True)


def _svg(mark: Mark, scale: float | None, zoom: float) -> str:
    """One mark as SVG."""
    if isinstance(mark, LineMark):
        element = "polygon" if mark.closed else "polyline"
        return f'<{element} class="{mark.kind}" points="{_points(mark.points)}"/>'
    if isinstance(mark, CircleMark):
        return (
            f'<circle class="{mark.kind}" cx="{mark.at[0]:.1f}" cy="{mark.at[1]:.1f}" r="{mark.radius:.1f}"/>'
        )
    if isinstance(mark, DimensionMark):
        return "\n".join(_svg(one, scale, zoom) for one in mark.drawn)
    if isinstance(mark, ScaleNote):
        mark = said_scale(mark, scale, zoom)
    ground = ""
    if mark.room:
        left = mark.at[0] - {"start": 0.0, "middle": 0.5 * mark.room, "end": mark.room}[mark.anchor]
        ground = (
            f'<rect x="{left - 1:.1f}" y="{mark.at[1] - 10:.1f}" width="{mark.room + 2:.1f}" height="13"'
            ' fill="#fff" fill-opacity=".85"/>\n'
        )
    named = f' class="{mark.kind}"' if mark.kind else ""
    return (
        f'{ground}<text{named} x="{mark.at[0]:.1f}" y="{mark.at[1]:.1f}"'
        f' text-anchor="{mark.anchor}">{escape(mark.words)}</text>'
    )


def said_scale(note: ScaleNote, scale: float | None, zoom: float) -> Words:
    """Text of a scale note on a page that is enlarged by `zoom`."""
    words = "not to scale" if scale is None else f"{scale_text(scale * zoom)}, mm"
    return Words(note.at, words, "start", "note")


def _points(points: Floats) -> str:
    return " ".join(f"{x:.2f},{y:.2f}" for x, y in np.asarray(points, dtype=np.float64))


@dataclass(frozen=True, slots=True)
class Allowances:
    """Half widths of the ± tolerances; 0 where the design states none.

    thickness : (body 1, body 2), mm. Of the centre thickness.
    separation : mm. Lens to lens.
    radius : (array 1, array 2). Of every radius, relative.
    decentre : (array 1, array 2), mm
    rotation, tilt : radians. Of array 2 against array 1, about the normal and about x and y.
    roughness : mm. Largest rms height of the lens faces.
    """

    thickness: tuple[float, float] = (0.0, 0.0)
    separation: float = 0.0
    radius: tuple[float, float] = (0.0, 0.0)
    decentre: tuple[float, float] = (0.0, 0.0)
    rotation: float = 0.0
    tilt: float = 0.0
    roughness: float = 0.0

    def of_body(self, number: int, bodies: int) -> float:
        """Of the centre thickness (mm) of body 0, 1 …; of a plate between two, the larger of theirs."""
        middle = bodies == 3 and number == 1
        return max(self.thickness) if middle else self.thickness[min(number, 1)]


NO_ALLOWANCES = Allowances()
"""Allowances of a design that states none."""


def allowances(design: Design) -> Allowances:
    """Tolerances of a design; roughness of its lens faces: the larger of [tolerances] and [body]."""
    spec, mm = design.tolerances, millimetres(design.unit_m)
    return Allowances(
        (spec.thickness[0] * mm, spec.thickness[1] * mm),
        spec.separation * mm,
        spec.radius,
        (spec.decentre[0] * mm, spec.decentre[1] * mm),
        spec.rotation,
        spec.tilt,
        max(spec.roughness, design.body.roughness) * mm,
    )


SAME = 1e-9
"""Relative difference within which two lengths are equal."""

HALF: tuple[Floats, ...] = (np.diag([-1.0, -1.0]),)
QUARTER: tuple[Floats, ...] = (np.array([[0.0, -1.0], [1.0, 0.0]]),)
OVER: tuple[Floats, ...] = (np.diag([1.0, -1.0]), np.diag([-1.0, 1.0]))
"""Ways to rotate a plate in its plane by a half or a quarter turn, and to turn it over; any one suffices."""


def orientation(window: Window) -> list[str]:
    """Sentences on how the part must be held, derived from the geometry alone."""
    first, last = window.bodies[0].name, window.bodies[-1].name
    found = [
        "The light of the checks travels towards +z and meets lens 1 first"
        + (
            f", on {first}; {last} carries lens 2."
            if first != last
            else "; lens 2 is the back of the same body."
        ),
        (
            "The axes are right-handed: with the light at your back and +y up, +x points to the left. No file"
            " is mirrored."
        ),
        *_turning(window),
    ]
    if window.recipe.get("field", {}).get("equal_plates"):
        found.append(
            f"{first} and {last} are the same part: order it twice and put the two back to back, field lenses"
            " inside."
        )
    return found


def _turning(window: Window) -> tuple[str, str]:
    """Whether the part may be turned about z, and whether it may be turned over."""
    faces = [face for face in window.faces if face.array is not None]
    centred = all(face.untilted and face.vertex[:2] == (0.0, 0.0) for face in faces)
    if not (window.uniform and centred and all(shift == (0.0, 0.0) for shift in window.shifts)):
        why = "lens axes or offsets point one way" if window.uniform else "it is not uniform"
        turned = f"It may not be turned about z: {why}. Mark the corner +x, +y."
        return turned, "It may not be turned over: the two sides differ. Mark the side of lens 1."
    square = not window.lattice.hexagonal and window.lattice.pitch[0] == window.lattice.pitch[1]
    reach = window.lattice.circumradius
    round_ones = all(_same(_heights(face, reach), _heights(face, reach).T) for face in faces)
    if not _fits(window, HALF):
        turned = (
            "It may not be turned about z: outline or holes fit one way round. The optics would stay the same"
            " by half a turn."
        )
    elif square and round_ones and _fits(window, QUARTER):
        turned = "It may be turned by quarter turns about z: the optics stay the same."
    else:
        turned = "It may be turned by half a turn about z, not by a quarter: the optics stay the same."
    if not _both_sides_alike(window, faces, reach):
        return turned, "It may not be turned over: the two sides differ. Mark the side of lens 1."
    if not _fits(window, OVER):
        return (
            turned,
            "It may not be turned over: outline or holes fit one way round. Mark the side of lens 1.",
        )
    return turned, "It may be turned over, too: both sides are alike."


def _both_sides_alike(window: Window, faces: list[Face], reach: float) -> bool:
    """Whether light from either side meets the same lenses at the same distances."""
    heights = [face.vertex[2] for face in window.faces]
    thick = np.diff(heights)
    media = [body.index for body in window.bodies]
    return (
        media == media[::-1]
        and _same(thick, thick[::-1])
        and all(
            _same(_heights(one, reach), _heights(other, reach))
            for one, other in zip(faces, faces[::-1], strict=True)
        )
    )


def _heights(face: Face, reach: float) -> Floats:
    """Heights of a face over a quarter of its cell (8, 8), length; all surfaces are even in x and in y."""
    x = reach * np.arange(1, 9) / 8.0
    return face.surface.side * sag(face.surface, x[:, None], x[None, :])


def _same(one: Floats, other: Floats) -> bool:
    size = float(np.nanmax(np.abs(one), initial=0.0))
    return np.allclose(one, other, rtol=0.0, atol=SAME * size, equal_nan=True)


def _fits(window: Window, ways: tuple[Floats, ...]) -> bool:
    """Whether a plate coincides with itself after one of these rotations; other outlines always do."""
    plate = window.outline
    return not isinstance(plate, Plate) or any(
        np.array_equal(_marks(plate, np.eye(2)), _marks(plate, way)) for way in ways
    )


def _marks(plate: Plate, way: Floats) -> Floats:
    """Ends, centre and radius of every edge of a rotated plate, sorted, in steps of the rounding error."""
    step = 1e-6 * max(plate.reach)
    ends = [np.rint(plate.edges[:, pair] @ way.T / step) for pair in ([X0, Y0], [X1, Y1], [CX, CY])]
    later = (ends[0][:, 0] > ends[1][:, 0]) | (
        (ends[0][:, 0] == ends[1][:, 0]) & (ends[0][:, 1] > ends[1][:, 1])
    )
    first, last = np.where(later[:, None], ends[1], ends[0]), np.where(later[:, None], ends[0], ends[1])
    rows = np.column_stack([first, last, ends[2], np.rint(plate.edges[:, RADIUS] / step)]) + 0.0
    return rows[np.lexsort(rows.T)]
