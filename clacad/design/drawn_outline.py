"""An outline drawn in a DXF file: read together with the design, and inserted into it as points.

A design's canonical text, its hash and all outputs contain the corners themselves, in its own unit. The file
is needed only while the design is read. Its name is relative, and the file lies in the design's folder or
below it.

Entities of layer OUTLINE are read, or all entities where there is no such layer: one closed LWPOLYLINE or
POLYLINE, or LINEs and ARCs that close. Everything else is refused by name. Coordinates are x and y of model
space; $INSUNITS is the unit. A file that states no unit is refused, because a plate of the wrong size is
scrap.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from typing import Any, Final

from clacad.base import units
from clacad.config.design_error import DesignTooLarge
from clacad.config.mistakes import Mistake
from clacad.config.quantities import SMALLEST_M
from clacad.config.value_kinds import shown
from clacad.design.body import MOST_VERTICES, VERTICES, Vertex
from clacad.design.dxf_entities import (
    Entity,
    TooMuch,
    Unfit,
    finite_number,
    group_pairs,
    sections,
    text_lines,
    unit_factor,
)

LAYER: Final = "OUTLINE"
_ANY_UNIT: Final = units.Unit("m", units.LENGTHS["m"])
JOINED: Final = 1e-6
"""Tolerance within which two ends coincide, as part of the drawing's size."""


def with_points(data: dict[str, Any], path: str) -> tuple[dict[str, Any], list[Mistake]]:
    """Replace the file name of a drawn outline by its corners.

    Parameters
    ----------
    data : dict
        The design as written; returned itself where it names no drawing.
    path : str
        The design's file; "" without one: then names are relative to the current folder.

    Returns
    -------
    data : dict
    mistakes : list of Mistake

    Raises
    ------
    DesignTooLarge
        The drawing is beyond its reader's budget.
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

    Parameters
    ----------
    folder : str
        Folder of the design.
    name : str
        Path relative to `folder`.
    unit : Fraction
        Metres per design unit.

    Raises
    ------
    ValueError
        The drawing has a fault; the exception carries the mistake.
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
            f"{name}: {len(circles)} circle{'s' * (len(circles) > 1)} next to the outline",
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
