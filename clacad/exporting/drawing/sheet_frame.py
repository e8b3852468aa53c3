"""The frame of a sheet of paper and its title block, in the style of ISO 5457 and ISO 7200."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clacad.exporting.drawing.canvas import CHARACTER, Canvas
from clacad.sheet.window import Window

PAPERS: Mapping[str, tuple[float, float]] = {"a4": (297.0, 210.0), "a3": (420.0, 297.0), "a2": (594.0, 420.0)}
"""Width and height of a sheet on its side, mm (ISO 216)."""

MARGIN, FILING = 10.0, 20.0
"""From the edge of the paper to the frame, mm; on the left, where sheets are filed."""

STRIP = 5.0
"""Width of the strip of zones outside the frame, mm."""

ZONE = 50.0
"""Length of a zone, mm; those at the corners take what is left over."""

LETTERS = "ABCDEFGHJKLM"
"""Names of zones down the sides: neither I nor O."""


def frame_box(paper: tuple[float, float]) -> tuple[float, float, float, float]:
    """Left, top, right and bottom of the frame, mm from the upper left corner of the paper."""
    return FILING, MARGIN, paper[0] - MARGIN, paper[1] - MARGIN


def zone_edges(low: float, high: float, middle: float) -> list[float]:
    """Ends of the zones along a side of the frame (mm): an even number, steps of 50 from the middle."""
    half = max(1, round((high - low) / (2.0 * ZONE)))
    return [low, *(middle + ZONE * k for k in range(1 - half, half)), high]


def sheet_frame(paper: tuple[float, float], unit: float) -> Canvas:
    """Frame, strip of zones and centring marks; `unit`: millimetres on paper a pixel."""
    canvas = Canvas(paper[0] / unit, paper[1] / unit, "frame")
    left, top, right, bottom = frame_box(paper)
    outer = (left - STRIP, top - STRIP, right + STRIP, bottom + STRIP)
    for (x0, y0, x1, y1), kind in (((left, top, right, bottom), "frame"), (outer, "dim")):
        canvas.polygon(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]) / unit, kind)
    for axis, names in ((0, [str(k) for k in range(1, 20)]), (1, LETTERS)):
        sides = ((top, outer[1]), (bottom, outer[3])) if axis == 0 else ((left, outer[0]), (right, outer[2]))
        low, high = (left, right) if axis == 0 else (top, bottom)
        _zones(canvas, zone_edges(low, high, 0.5 * paper[axis]), names, sides, axis, unit)
    return canvas


def _zones(
    canvas: Canvas,
    edges: list[float],
    names: Sequence[str],
    sides: tuple[tuple[float, float], ...],
    axis: int,
    unit: float,
) -> None:
    """Lines between zones and their names on two opposite sides; a centring mark in the middle."""
    for inner, outer in sides:
        for k, edge in enumerate(edges[1:-1], 1):
            centre = 2 * k == len(edges) - 1
            beyond = inner + (0.4 * (inner - outer) if centre else 0.0)
            ends = np.array([[edge, outer], [edge, beyond]])
            canvas.line((ends if axis == 0 else ends[:, ::-1]) / unit, "frame" if centre else "dim")
        for name, low, high in zip(names, edges[:-1], edges[1:], strict=False):
            at = (0.5 * (low + high) / unit, 0.5 * (inner + outer) / unit)
            x, y = at if axis == 0 else at[::-1]
            canvas.text((x, y + 4.0), name)


@dataclass(frozen=True, slots=True)
class Heading:
    """What a title block contains in addition to the part's own data.

    number : Of the drawing: the beginning of the SHA-256 of the design.
    version : Of the program that drew it.
    scale : Of the assembly.
    """

    number: str
    version: str
    paper: str
    scale: str


FIELD = 30.0
"""Height of a row of the title block, px: the name of each field over its value."""


def title_block(window: Window, heading: Heading, sheet: int, sheets: int) -> Canvas:
    """Title, part, material, scale, unit, projection, number and sheet; no date: the same design gives the
    same bytes.
    """
    rows = _title_rows(window, heading, sheet, sheets)
    wide = max(sum(_field_width(*field) for field in row) for row in rows)
    canvas = Canvas(wide, FIELD * len(rows), "title block")
    canvas.polygon(np.array([[0.0, 0.0], [wide, 0.0], [wide, canvas.height], [0.0, canvas.height]]), "frame")
    for number, row in enumerate(rows):
        y, spare = FIELD * number, (wide - sum(_field_width(*field) for field in row)) / len(row)
        if number:
            canvas.line([(0.0, y), (wide, y)], "dim")
        x = 0.0
        for name, value in row:
            if x:
                canvas.line([(x, y), (x, y + FIELD)], "dim")
            canvas.text((x + 4.0, y + 11.0), name, "start", "note")
            canvas.text((x + 4.0, y + 25.0), value, "start", "title" if name == "part" else "")
            x += _field_width(name, value) + spare
            if not value:
                _first_angle(canvas, (x - 32.0, y + 21.0))
    return canvas


def _title_rows(
    window: Window, heading: Heading, sheet: int, sheets: int
) -> tuple[tuple[tuple[str, str], ...], ...]:
    """Rows of fields (name, value) of the title block."""
    n1, n2 = window.lattice.count
    materials = ", ".join(dict.fromkeys(_material(body.material, body.index) for body in window.bodies))
    kept = f"{n1} x {n2} cells ({window.lattice.cell_count:,} kept)"
    return (
        (("title", f"confocal lenslet array pair, {window.form}, {kept}"),),
        (
            ("part", window.name),
            ("bodies", ", ".join(body.name for body in window.bodies)),
            ("material", materials),
        ),
        (
            ("scale (each view has its own)", f"assembly {heading.scale}"),
            ("unit", "mm"),
            ("views named; first angle", ""),
        ),
        (
            ("drawing (SHA-256 of the design)", heading.number),
            ("made by", f"clacad {heading.version}"),
            ("paper", heading.paper.upper()),
            ("sheet", f"{sheet} of {sheets}"),
        ),
    )


def _field_width(name: str, value: str) -> float:
    return 10.0 + CHARACTER * max(len(name), 1.1 * len(value))


def _first_angle(canvas: Canvas, at: tuple[float, float]) -> None:
    """The symbol of first-angle projection (ISO 5456-2): a cone from its side and from its narrow end."""
    x, y = at
    canvas.polygon(
        np.array([[x - 20.0, y - 3.5], [x - 4.0, y - 7.0], [x - 4.0, y + 7.0], [x - 20.0, y + 3.5]]), "dim"
    )
    for radius in (3.5, 7.0):
        canvas.circle((x + 12.0, y), radius, "dim")
    canvas.line([(x - 23.0, y), (x + 22.0, y)], "axis")


def _material(material: Any, index: float) -> str:
    return f"n = {index:.6g}" if material is None else f"{material.name}, n = {index:.6g}"
