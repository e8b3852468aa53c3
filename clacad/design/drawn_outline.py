"""An outline drawn in a DXF file: read together with the design, and inserted into it as points.

A design's canonical text, its hash and all outputs contain the corners themselves, in its own unit. The file
is needed only while the design is read. Its name is relative, and the file lies in the design's folder or
below it.

Entities of layer OUTLINE are read, or all entities where there is no such layer: one closed LWPOLYLINE or
POLYLINE, or LINEs and ARCs that close. Everything else is refused by name. Coordinates are x and y of model
space; $INSUNITS is the unit. A file that states no unit is refused, because a plate of the wrong size is
scrap.

No library reads the untrusted file: only lines, arcs and polylines are needed, and the file should reach as
little code as possible.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import replace
from errno import EFBIG
from fractions import Fraction
from typing import Any, Final

from clacad.base import units
from clacad.base.text import count_text, whole_number
from clacad.base.untrusted_files import BUDGETS, read_regular
from clacad.config.mistakes import DesignTooLarge, Mistake
from clacad.config.value_kinds import SMALLEST_M, shown
from clacad.design.body import MOST_VERTICES, VERTICES, Vertex

UNITS: Final = {1: "in", 4: "mm", 5: "cm", 6: "m", 12: "nm", 13: "um"}
"""$INSUNITS → unit of length."""

KEY: Final = "lattice.outline.dxf"


class TooMuch(Exception):
    """A drawing exceeds the reader's budget."""

    def __init__(self, message: str, allowed: str) -> None:
        super().__init__(message)
        self.mistake = Mistake("CL100", message, KEY, allowed=allowed)


class Unfit(ValueError):
    """A fault of a drawing: code, message, allowed values, hint."""

    def __init__(self, code: str, message: str, allowed: str = "", hint: str = "") -> None:
        super().__init__(message)
        self.mistake = Mistake(code, message, KEY, allowed=allowed, hint=hint)


def text_lines(folder: str, name: str) -> list[str]:
    """Lines of the file."""
    why = "is not a relative path" if os.path.isabs(name) or "\0" in name or name[1:2] == ":" else ""
    if not why:
        home, real = os.path.realpath(folder), os.path.realpath(os.path.join(folder, name))
        if os.path.commonpath([home, real]) != home:  # links are resolved first, so that none leads out
            why = "lies outside the design's folder"
    if why:
        raise Unfit(
            "CL100", f"the drawing {shown(name)} {why}", "a DXF file in the design's folder or below it"
        )
    budget = BUDGETS["outline"]
    try:
        raw = read_regular(os.path.join(folder, name), budget.bytes)
    except OSError as problem:
        if problem.errno == EFBIG:
            raise TooMuch(f"{name}: too large for an outline", f"up to {budget.bytes:,} bytes") from None
        reason = (problem.strerror or str(problem)).lower()
        raise Unfit("CL100", f"cannot read the drawing {shown(name)}: {reason}") from None
    if raw.startswith(b"AutoCAD Binary DXF"):
        raise Unfit(
            "CL100", f"{name} is a binary DXF file", "DXF as text", "save it as ASCII DXF (R12 or later)"
        )
    lines = raw.decode("utf-8", "replace").splitlines()
    if len(lines) > (budget.items or 0):
        raise TooMuch(f"{name}: {len(lines):,} lines are too many for an outline", f"up to {budget.items:,}")
    return lines


Pair = tuple[int, str, int]
"""Group code, value, line."""

LARGEST_CODE = 10_000
"""Limit above every group code of DXF."""


def group_pairs(lines: list[str], name: str) -> list[Pair]:
    """Group codes and values."""
    found: list[Pair] = []
    for n in range(0, len(lines) - 1, 2):
        code = whole_number(lines[n].strip(), signed=True)
        if code is None or not -5 <= code < LARGEST_CODE:
            said = shown(lines[n].strip()[:20])
            raise Unfit("CL100", f"{name}, line {n + 1}: {said} is not a group code of DXF")
        found.append((code, lines[n + 1].strip(), n + 2))
    if not found or found[-1][:2] != (0, "EOF"):
        raise Unfit("CL100", f"{name}: cut short, or no DXF file: it does not end with EOF")
    return found


class Entity:
    """One entity: its kind, its line in the file, its values in order."""

    def __init__(self, kind: str, line: int) -> None:
        self.kind, self.line = kind, line
        self.values: list[Pair] = []
        self.corners: list[Entity] = []

    @property
    def layer(self) -> str:
        """Its layer, "0" if it names none."""
        return next((value for code, value, _ in self.values if code == 8), "0")

    def number(self, code: int, name: str, default: float | None = None) -> float:
        """The number under a code. Raises Unfit: There is no such code, or its value is no finite number."""
        for at, value, line in self.values:
            if at == code:
                return finite_number(value, line, name)
        if default is None:
            raise Unfit("CL100", f"{name}, line {self.line}: {self.kind} without group {code}")
        return default

    def flags(self, name: str) -> int:
        """Group 70."""
        return int(self.number(70, name, 0.0))


def finite_number(value: str, line: int, name: str) -> float:
    """Read a number of at most 1e30 in size; refuse anything else with the file's name and the line."""
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not abs(number) <= 1e30:
        raise Unfit("CL100", f"{name}, line {line}: {shown(value[:20])} is not a number from -1e30 to 1e30")
    return number


def sections(pairs: list[Pair], name: str) -> tuple[dict[str, str], list[Entity]]:
    """Variables of the header, and the entities of model space."""
    header: dict[str, str] = {}
    entities: list[Entity] = []
    section, variable, latest = "", "", ""
    current: Entity | None = None
    for code, value, line in pairs:
        if code == 0:
            if value in ("SECTION", "ENDSEC", "EOF"):
                section = ""
            elif section == "ENTITIES":
                entity = Entity(value, line)
                if value == "VERTEX" and entities and entities[-1].kind == "POLYLINE":
                    entities[-1].corners.append(entity)
                elif value != "SEQEND":
                    entities.append(entity)
                current = entity
            latest = value
        elif code == 2 and latest == "SECTION" and not section:
            section = value
        elif section == "HEADER":
            if code == 9:
                variable = value
            else:
                header.setdefault(variable, value)
        elif section == "ENTITIES" and current is not None:
            current.values.append((code, value, line))
    if not entities:
        raise Unfit("CL100", f"{name}: no entities are drawn in it")
    paper = [one for one in entities if (67, "1") in {(code, value) for code, value, _ in one.values}]
    return header, [one for one in entities if one not in paper] if paper else entities


def unit_factor(header: dict[str, str], unit: Fraction, name: str) -> Fraction:
    """Design units per unit of the drawing."""
    said = header.get("$INSUNITS", "0")
    words = " | ".join(f"{code} ({word})" for code, word in UNITS.items())
    code = whole_number(said)
    if code not in UNITS:
        why = (
            "states no unit"
            if said in ("0", "")
            else f"has $INSUNITS = {shown(said[:20])}, which is not read"
        )
        raise Unfit(
            "CL105",
            f"{name} {why}",
            f"$INSUNITS = {words}",
            "set the unit of the drawing to millimetres, say",
        )
    return units.LENGTHS[UNITS[code]] / unit


LAYER: Final = "OUTLINE"
_ANY_UNIT: Final = units.Unit("m", units.LENGTHS["m"])
JOINED: Final = 1e-6
"""Tolerance within which two ends coincide, as part of the drawing's size."""


def with_points(data: dict[str, Any], path: str) -> tuple[dict[str, Any], list[Mistake]]:
    """Replace the file name of a drawn outline by its corners.

    data : The design as written; returned itself where it names no drawing.
    path : The design's file; "" without one: then names are relative to the current folder.

    Returns
    -------
    data : dict
    mistakes : list of Mistake

    Raises DesignTooLarge: The drawing is beyond its reader's budget.
    """
    mistakes: list[Mistake] = []
    for section in ("lattice", "body"):
        given = data.get(section)
        outline = given.get("outline") if isinstance(given, dict) else None
        if not isinstance(outline, dict) or set(outline) != {"dxf"} or not isinstance(outline["dxf"], str):
            continue
        try:
            points = _drawn(data.get("unit"), path, outline["dxf"])
        except TooMuch as problem:
            raise DesignTooLarge([_of_section(problem.mistake, section)]) from None
        except Unfit as problem:
            mistakes.append(_of_section(problem.mistake, section))
            continue
        data = {**data, section: {**data[section], "outline": {"polygon": VERTICES.write(points, _ANY_UNIT)}}}
    return data, mistakes


def _drawn(word: object, path: str, name: str) -> tuple[Vertex, ...]:
    """Corners of the outline in a drawing named in the design, in the design's unit."""
    unit = units.design_unit(word) if isinstance(word, str) else None
    return read_outline(os.path.dirname(path) or ".", name, unit.metres if unit else Fraction(1))


def _of_section(mistake: Mistake, section: str) -> Mistake:
    """Return the mistake with the key of the section whose outline names the drawing."""
    return replace(mistake, key=f"{section}.outline.dxf")


def read_outline(folder: str, name: str, unit: Fraction) -> tuple[Vertex, ...]:
    """Corners of the outline drawn in a DXF file.

    folder : Folder of the design.
    name : Path relative to `folder`.
    unit : Metres per design unit.
    Raises ValueError: The drawing has a fault; the exception carries the mistake.
    """
    pairs = group_pairs(text_lines(folder, name), name)
    header, entities = sections(pairs, name)
    factor = unit_factor(header, unit, name)
    chosen = [one for one in entities if one.layer.upper() == LAYER] or entities
    loop = _one_loop(chosen, name)
    points = tuple((_length(x, factor, unit), _length(y, factor, unit), bulge) for x, y, bulge in loop)
    if len(points) > MOST_VERTICES:
        raise Unfit("CL108", f"{name}: its outline has {len(points)} corners", f"at most {MOST_VERTICES}")
    return points


def _length(drawn: float, factor: Fraction, unit: Fraction) -> float:
    """Length of the drawing in design units; a rounding error of 0 by the drawing program becomes 0."""
    value = Fraction(drawn) * factor
    return 0.0 if abs(value) * unit < SMALLEST_M else float(value)


# -- from entities to one loop -----------------------------------------------------------------------
def _one_loop(entities: list[Entity], name: str) -> list[Vertex]:
    """Corners of the only closed outline in the drawing."""
    loops: list[list[Vertex]] = []
    pieces: list[tuple[Vertex, Vertex]] = []
    circles: list[tuple[float, float, float]] = []
    for one in entities:
        if one.number(230, name, 1.0) < 0.999999:
            raise Unfit("CL141", f"{name}, line {one.line}: {one.kind} is drawn in another plane than x, y")
        if one.kind in ("LWPOLYLINE", "POLYLINE"):
            loops.append(_polyline(one, name))
        elif one.kind in ("LINE", "ARC"):
            pieces.append(_line(one, name) if one.kind == "LINE" else _arc(one, name))
        elif one.kind == "CIRCLE":
            circles.append((one.number(10, name), one.number(20, name), one.number(40, name)))
        else:
            raise Unfit(
                "CL141",
                f"{name}, line {one.line}: a {shown(one.kind[:20])} is no outline",
                "one closed polyline, or LINEs and ARCs that close",
                f"draw the outline alone on a layer {LAYER}: other layers are then left out",
            )
    if circles:
        x, y, r = circles[0]
        raise Unfit(
            "CL141",
            f"{name}: {count_text(len(circles), 'circle')} next to the outline",
            "one closed outline; holes are stated in the design",
            f"body.holes = [{{diameter = {2 * r:g}, at = [[{x:g}, {y:g}]]}}], and the outline alone on a"
            f" layer {LAYER}",
        )
    loops += _linked(pieces, name)
    if len(loops) != 1:
        raise Unfit(
            "CL141",
            f"{name}: {len(loops)} closed outlines are drawn in it",
            "exactly one",
            f"draw it alone on a layer {LAYER}; holes go into body.holes",
        )
    return loops[0]


def _polyline(one: Entity, name: str) -> list[Vertex]:
    """Corners of a closed polyline of either kind."""
    flags = one.flags(name)
    if one.kind == "POLYLINE" and flags & (8 | 16 | 64):
        raise Unfit("CL141", f"{name}, line {one.line}: a POLYLINE of space or a mesh is no outline")
    found: list[list[float]] = []
    if one.kind == "POLYLINE":
        corners = [corner for corner in one.corners if not corner.flags(name) & 16]
        found = [
            [corner.number(10, name), corner.number(20, name), corner.number(42, name, 0.0)]
            for corner in corners
        ]
    else:
        for code, value, line in one.values:
            if code == 10:
                found.append([finite_number(value, line, name), math.nan, 0.0])
            elif code in (20, 42) and found:
                found[-1][1 if code == 20 else 2] = finite_number(value, line, name)
    if any(math.isnan(y) for _, y, _ in found):
        raise Unfit("CL100", f"{name}, line {one.line}: a corner of {one.kind} without y")
    points = [(x, y, bulge) for x, y, bulge in found]
    size = max((abs(v) for x, y, _ in points for v in (x, y)), default=0.0)
    closes = len(points) > 1 and math.dist(points[0][:2], points[-1][:2]) <= JOINED * size
    if closes:
        points.pop()
    elif not flags & 1:
        gap = math.dist(points[0][:2], points[-1][:2]) if points else 0.0
        raise Unfit(
            "CL141",
            f"{name}, line {one.line}: the {one.kind} is open: its ends are {gap:.6g} apart",
            "a closed one",
            "close it in the drawing program",
        )
    return points


def _line(one: Entity, name: str) -> tuple[Vertex, Vertex]:
    return (one.number(10, name), one.number(20, name), 0.0), (
        one.number(11, name),
        one.number(21, name),
        0.0,
    )


def _arc(one: Entity, name: str) -> tuple[Vertex, Vertex]:
    """Ends of an arc, which runs counter-clockwise; the first end carries the bulge."""
    x, y, r = (one.number(code, name) for code in (10, 20, 40))
    start, end = (math.radians(one.number(code, name)) for code in (50, 51))
    swept = (end - start) % math.tau
    if not r > 0.0 or swept == 0.0:
        raise Unfit("CL141", f"{name}, line {one.line}: an ARC without extent")
    first, last = ((x + r * math.cos(turn), y + r * math.sin(turn)) for turn in (start, end))
    return (*first, math.tan(0.25 * swept)), (*last, 0.0)


def _linked(pieces: list[tuple[Vertex, Vertex]], name: str) -> list[list[Vertex]]:
    """Closed loops of lines and arcs, end to end in any order and direction."""
    size = max((abs(v) for piece in pieces for end in piece for v in end[:2]), default=0.0)
    ends = _Ends(pieces, JOINED * size)
    loops, left = [], dict.fromkeys(range(len(pieces)))
    while left:
        number, backwards = next(iter(left)), False
        loop: list[Vertex] = []
        while number in left:
            del left[number]
            first, last = pieces[number][::-1] if backwards else pieces[number]
            bulge = -pieces[number][0][2] if backwards else pieces[number][0][2]
            loop.append((first[0], first[1], bulge))
            others = [other for other in ends.at(last) if other[0] != number]
            if len(others) != 1:
                why = "it is open" if not others else "more than two pieces meet"
                raise Unfit(
                    "CL141",
                    f"{name}: the outline does not close: at ({last[0]:.6g}, {last[1]:.6g}) {why}",
                    "pieces that meet end to end",
                )
            number, backwards = others[0]
        loops.append(loop)
    return loops


class _Ends:
    """Ends of pieces, indexed by position."""

    def __init__(self, pieces: list[tuple[Vertex, Vertex]], near: float) -> None:
        self._near = near or 1.0
        self._at: dict[tuple[int, int], list[tuple[int, bool, Vertex]]] = {}
        for number, piece in enumerate(pieces):
            for backwards, end in enumerate(piece):
                self._at.setdefault(self._box(end), []).append((number, bool(backwards), end))

    def _box(self, point: Vertex) -> tuple[int, int]:
        return math.floor(point[0] / self._near), math.floor(point[1] / self._near)

    def at(self, point: Vertex) -> list[tuple[int, bool]]:
        """Pieces that end at a point: index, and whether the end is the piece's last."""
        return [
            (number, backwards)
            for number, backwards, end in self._around(point)
            if math.dist(end[:2], point[:2]) <= self._near
        ]

    def _around(self, point: Vertex) -> Iterator[tuple[int, bool, Vertex]]:
        i, j = self._box(point)
        for a in (i - 1, i, i + 1):
            for b in (j - 1, j, j + 1):
                yield from self._at.get((a, b), ())
