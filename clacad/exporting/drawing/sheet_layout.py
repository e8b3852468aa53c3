"""Layout of views and tables on sheets of paper: positions, scales, number of sheets.

Boxes on sheets of paper: rows of columns, spread over the sheet, around a title block in the lower right
corner.

Notes of a drawing on a non-uniform sheet: the key that makes it non-uniform, and three of its cells, the
worst included.

The views show the cell in the middle; the STEP file and the table of faces contain every cell.

The frame of a sheet of paper and its title block, in the style of ISO 5457 and ISO 7200.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.units import millimetres
from clacad.design.sections import LATTICE, LAW, PAIR, AimedAt
from clacad.exporting.drawing import drawing_tables, views
from clacad.exporting.drawing.canvas import CHARACTER, Allowances, Canvas, allowances, scale_text
from clacad.exporting.drawing.drawing_tables import table
from clacad.exporting.drawing.views import mm_text
from clacad.formats.maps.pose_table import euler_degrees
from clacad.optics.surface import principal_radii
from clacad.sheet.cell_heights import greatest_steps
from clacad.sheet.representative_cells import representative_cells
from clacad.sheet.window import Face, Window

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.sheet.feasibility import Feasibility


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


Size = tuple[float, float]
Box = tuple[float, float, float, float]
"""Left, top, right, bottom."""


@dataclass(frozen=True, slots=True)
class Area:
    """Room for boxes, mm: its size, that of the taken corner at its lower right, and the least gap."""

    size: Size
    corner: Size
    gap: float


@dataclass(slots=True)
class _Column:
    """Boxes under one another: their numbers, the greatest width, the heights with a gap between each two."""

    numbers: list[int]
    width: float
    height: float


@dataclass(slots=True)
class _Row:
    """Columns next to one another, none higher than the first."""

    columns: list[_Column]
    height: float

    def width(self, gap: float) -> float:
        """Of all columns with the gaps between them."""
        return sum(column.width for column in self.columns) + gap * (len(self.columns) - 1)


def pack(sizes: Sequence[Size], order: Sequence[int], area: Area) -> dict[int, Box] | None:
    """Boxes of one sheet by their numbers, taken in an order; None where they do not fit."""
    rows: list[_Row] = []
    for number in order:
        if not any(_join(row, number, sizes, area) for row in rows):
            width, height = sizes[number]
            rows.append(_Row([_Column([number], width, height)], height))
    return _spread(rows, sizes, area)


def _join(row: _Row, number: int, sizes: Sequence[Size], area: Area) -> bool:
    """Put a box under others of a row, or next to them, where it fits."""
    width, height = sizes[number]
    spare = area.size[0] - row.width(area.gap)
    for column in row.columns:
        if column.height + area.gap + height <= row.height and width - column.width <= spare:
            column.numbers.append(number)
            column.height += area.gap + height
            column.width = max(column.width, width)
            return True
    if height <= row.height and width + area.gap <= spare:
        row.columns.append(_Column([number], width, height))
        return True
    return False


def _spread(rows: Sequence[_Row], sizes: Sequence[Size], area: Area) -> dict[int, Box] | None:
    """Share the free room among rows, columns and boxes; the last rows end next to or above the corner."""
    (wide, tall), (taken, low) = area.size, area.corner
    used = sum(row.height for row in rows) + area.gap * (len(rows) - 1)
    for bottom in (tall, tall - low - area.gap):
        if used > bottom + 1e-9:
            return None
        between = area.gap + (bottom - used) / max(1, len(rows) - 1)
        y, placed, fits = 0.0, dict[int, Box](), True
        for row in rows:
            room = wide if y + row.height <= tall - low - area.gap + 1e-9 else wide - taken - area.gap
            fits = fits and row.width(area.gap) <= room + 1e-9
            placed.update(_row_boxes(row, y, room, sizes))
            y += row.height + between
        if fits:
            return placed
    return None


def _row_boxes(row: _Row, y: float, room: float, sizes: Sequence[Size]) -> dict[int, Box]:
    """Columns spread over the width from the left; boxes of a column spread over the height of the row."""
    count = len(row.columns)
    spare = room - sum(column.width for column in row.columns)
    step, x = (spare / (count - 1), 0.0) if count > 1 else (0.0, 0.5 * spare)
    placed = {}
    for column in row.columns:
        heights = [sizes[number][1] for number in column.numbers]
        apart = (row.height - sum(heights)) / (len(heights) - 1) if len(heights) > 1 else 0.0
        top = y
        for number, height in zip(column.numbers, heights, strict=True):
            placed[number] = (x, top, x + sizes[number][0], top + height)
            top += height + apart
        x += column.width + step
    return placed


def largest_empty(size: Size, boxes: Sequence[Box]) -> float:
    """Area of the largest upright rectangle that no box enters, in a rectangle of a given size."""
    wide, tall = size
    edges = sorted({0.0, wide, *(box[0] for box in boxes), *(box[2] for box in boxes)})
    largest = 0.0
    for left, right in combinations([edge for edge in edges if 0.0 <= edge <= wide], 2):
        if (right - left) * tall <= largest:
            continue
        low = highest = 0.0
        for top, bottom in sorted((box[1], box[3]) for box in boxes if box[0] < right and box[2] > left):
            highest = max(highest, top - low)
            low = max(low, bottom)
        largest = max(largest, (right - left) * max(highest, tall - low))
    return largest


def differing_key(design: Design) -> str:
    """The key of a design that makes its sheet non-uniform; "" for a uniform sheet."""
    asked = {
        "lattice.aperture.point": isinstance(design.lattice.aperture, AimedAt),
        LAW.varying: design.law_spec.varying is not None,
        LATTICE.pitch_2: design.lattice.pitch_2 is not None,
        PAIR.focus: design.pair.focus is not None,
    }
    return next((key for key, present in asked.items() if present), "")


def differing_notes(design: Design, window: Window) -> tuple[str, ...]:
    """Notes that a sheet is non-uniform, by which key, and where all cells are listed."""
    if window.uniform:
        return ()
    return (
        (
            f"The sheet is not uniform ({differing_key(design)}): the views show the cell nearest the middle,"
            f" the table the first, that one and the worst of {window.lattice.cell_count:,}. No cell"
            " represents another: cut by the STEP file, or by the table of faces (--format table), which"
            " hold every cell."
        ),
    )


def cells_table(window: Window) -> Canvas:
    """The first, the middle and the worst cell: positions of cells and lenses, heights of steps; mm."""
    mm = millimetres(window.unit)
    faces = _one_face_an_array(window)
    head = ["cell", "i, j"]
    for face in faces:
        head += [f"centre {_lens(face)} x, y", f"apex {_lens(face)} from it x, y", f"step {_lens(face)}"]
        both, own_axes = window.many_aspects or face.own_axes, face.own_axes
        head += [f"radius {_lens(face)}{' x, y' * both}"] if window.many_sizes else []
        head += [f"turn {_lens(face)}"] * own_axes
    rows = []
    for name, index in zip(
        ("first", "middle", "worst"), representative_cells(window, "drawing"), strict=True
    ):
        row = [name, f"{index[0]}, {index[1]}"]
        for face in faces:
            assert face.array is not None
            step = float(greatest_steps(window, face, index[None])[0])
            apex = window.vertices(face, index)[:2]
            row += [
                ", ".join(mm_text(v * mm + 0.0) for v in at)
                for at in (window.centres(face.array, index), apex)
            ]
            row.append(mm_text(step * mm))
            if window.many_sizes:
                own = window.in_cell(face, index)
                radii = principal_radii(own.surface)[: 2 if window.many_aspects or face.own_axes else 1]
                row.append(", ".join(mm_text(own.side * radius * mm) for radius in radii))
                row += [f"{euler_degrees(own.rotation)[0]:.6g}°"] * face.own_axes
        rows.append(row)
    title = (
        "cells that differ (mm; step: the highest to a neighbour; worst: the lens farthest from the middle of"
        " its cell)"
    )
    return table(title, head, rows)


def _one_face_an_array(window: Window) -> list[Face]:
    """A face of each array, one whose lenses move where any does."""
    found: dict[int, Face] = {}
    for face in window.faces:
        if face.array is not None and (face.array not in found or found[face.array].change is None):
            found[face.array] = face
    return [found[array] for array in sorted(found)]


def _lens(face: Face) -> str:
    return f"lens {(face.array or 0) + 1}"


ROOM = 3.0
"""Distance from the frame or a neighbour to the content of the sheet, mm."""

PIXEL = 25.4 / 96.0
"""Millimetres a pixel of the drawing boards, enlarged by 1."""

ZOOMS = (1.3, 1.1, 1.0, 0.9, 0.8)
"""Enlargements of the type that are tried, largest first; smaller ones (type below 2.3 mm) only where a
table is too wide."""

SHARES = (1.0, 2.0, 4.0)
"""Largest scales of the views that are tried, as parts of those in a report."""


@dataclass(frozen=True, eq=False)
class PlacedBlock:
    """A drawing board with its upper left corner at x, y (mm from the upper left of the paper)."""

    canvas: Canvas
    x: float
    y: float


@dataclass(frozen=True, eq=False)
class Sheet:
    """One sheet of paper, mm: its size, its content, and the enlargement of that."""

    paper: tuple[float, float]
    zoom: float
    placed: tuple[PlacedBlock, ...]

    @property
    def unit(self) -> float:
        """Millimetres on paper for each pixel of its boards."""
        return PIXEL * self.zoom

    @property
    def drawn(self) -> tuple[PlacedBlock, ...]:
        """The frame and its content."""
        return PlacedBlock(sheet_frame(self.paper, self.unit), 0.0, 0.0), *self.placed


@dataclass(frozen=True, eq=False)
class _Trial:
    """Boards on sheets at one enlargement, and the largest part of a frame that is left empty."""

    zoom: float
    boards: Sequence[Canvas]
    pages: Sequence[Mapping[int, Box]]
    empty: float

    @property
    def cost(self) -> tuple[int, float, float]:
        """The fewest sheets are best; then the fullest, then the largest views and type."""
        used = sum((x1 - x0) * (y1 - y0) for page in self.pages for x0, y0, x1, y1 in page.values())
        return len(self.pages), max(self.empty, ENOUGH), -used


ENOUGH = 0.18
"""Part of the frame that may be empty: below, larger views and type are better than fuller sheets."""


def sheets(
    design: Design, window: Window, facts: Feasibility, paper: str, study: Mapping[str, Any] | None
) -> tuple[Sheet, ...]:
    """Lay out the drawing of a part.

    window : As written.
    facts : Of that window.
    paper : "a4", "a3" or "a2"
    study : Content of `tolerances.json` of a study of this design.
    """
    from clacad import __version__

    tables = _tables(design, window, study)
    heading = Heading(design.sha256[:12], __version__, paper, "not to scale")
    corner = title_block(window, heading, 9, 9)
    trials: list[_Trial] = []
    zooms = [*ZOOMS, *(ZOOMS[-1] * 0.9**k for k in range(1, 40))]
    while zooms and (zooms[0] >= ZOOMS[-1] or not trials):
        zoom = zooms.pop(0)
        made = _sets_of_views(window, facts, allowances(design), PIXEL * zoom)
        laid = (_laid_out([*boards, *tables], corner, PAPERS[paper], zoom) for boards in made)
        trials += [trial for trial in laid if trial is not None]
    best = min(trials, key=lambda trial: trial.cost)
    return _sheets(best, window, heading)


def _sheets(trial: _Trial, window: Window, heading: Heading) -> tuple[Sheet, ...]:
    """The sheets of a trial, each with its title block."""
    paper, unit = PAPERS[heading.paper], PIXEL * trial.zoom
    left, top, right, bottom = frame_box(paper)
    scale = trial.boards[0].scale
    heading = replace(heading, scale="not to scale" if scale is None else scale_text(scale * trial.zoom))
    made = []
    for number, page in enumerate(trial.pages, 1):
        block = title_block(window, heading, number, len(trial.pages))
        boards = [
            PlacedBlock(trial.boards[k], left + ROOM + x, top + ROOM + y)
            for k, (x, y, _, _) in sorted(page.items())
        ]
        corner = PlacedBlock(block, right - block.width * unit, bottom - block.height * unit)
        made.append(Sheet(paper, trial.zoom, (*boards, corner)))
    return tuple(made)


def _tables(design: Design, window: Window, study: Mapping[str, Any] | None) -> list[Canvas]:
    """The tables and the notes."""
    allowed, slope = allowances(design), design.body.slope_rms
    more = differing_notes(design, window)
    return [
        drawing_tables.faces_table(window, allowed),
        *([drawing_tables.layers_table(window)] if window.form == "plates" else []),
        drawing_tables.sag_table(window),
        *([] if window.uniform else [cells_table(window)]),
        *drawing_tables.plate_tables(design, window),
        drawing_tables.surfaces_table(window, allowed, slope),
        drawing_tables.errors_table(design, window, allowed, study),
        drawing_tables.notes(window, allowed, slope, NOTES, more),
    ]


NOTES = 560.0
"""Width of the notes, px."""


def _sets_of_views(
    window: Window, facts: Feasibility, allowed: Allowances, unit: float
) -> list[list[Canvas]]:
    """The views at every share of their scales that differs: those of the sheet, and those of its cells."""
    ranges = [(body.low, body.high) for body in facts.bodies]

    def of_sheet(share: float) -> list[Canvas]:
        paper = views.OnPaper(unit, share)
        return [views.assembly(window, paper, ranges), views.plan(window, paper)]

    def of_cells(share: float) -> list[Canvas]:
        paper = views.OnPaper(unit, share)
        lenses = range(len(facts.lenses))
        return [
            views.telescopelet(window, facts, None, allowed, paper),
            *(views.lens_detail(window, facts, array, allowed, paper) for array in lenses),
        ]

    return [[*one, *two] for one in _different(of_sheet) for two in _different(of_cells)]


def _different(draw: Callable[[float], list[Canvas]]) -> list[list[Canvas]]:
    """What is drawn at every share, each scale once."""
    return list({tuple(view.scale for view in made): made for made in map(draw, SHARES)}.values())


def _laid_out(
    boards: Sequence[Canvas], corner: Canvas, paper: tuple[float, float], zoom: float
) -> _Trial | None:
    """Boards on the fewest sheets that hold them, least empty; None where one fits on no sheet."""
    unit = PIXEL * zoom
    left, top, right, bottom = frame_box(paper)
    size = (right - left - 2.0 * ROOM, bottom - top - 2.0 * ROOM)
    taken = (corner.width * unit - ROOM, corner.height * unit - ROOM)
    area = Area(size, taken, ROOM)
    sizes = [(board.width * unit, board.height * unit) for board in boards]
    if any(width > size[0] or height > size[1] for width, height in sizes):
        return None
    title = (size[0] - taken[0], size[1] - taken[1], *size)
    found = []
    for pages in _splits(sizes, area):
        empty = max(largest_empty(size, [*page.values(), title]) for page in pages)
        found.append(_Trial(zoom, boards, pages, empty / (size[0] * size[1])))
    return min(found, key=lambda trial: trial.cost, default=None)


def _splits(sizes: Sequence[tuple[float, float]], area: Area) -> Iterator[list[dict[int, Box]]]:
    """Boxes on the fewest sheets, each as full as it gets; the last two share the rest in every way."""
    left, full = list(range(len(sizes))), list[dict[int, Box]]()
    while (last := _page(sizes, left, area)) is None:
        parts = [(_page(sizes, left[:n], area), _page(sizes, left[n:], area)) for n in range(1, len(left))]
        for one, other in parts:
            if one is not None and other is not None:
                yield [*full, one, other]
        fitting = [(one, n) for n, (one, _) in enumerate(parts, 1) if one is not None]
        if not fitting:
            return
        page, count = fitting[-1]
        full.append(page)
        left = left[count:]
    yield [*full, last]


def _page(sizes: Sequence[tuple[float, float]], numbers: Sequence[int], area: Area) -> dict[int, Box] | None:
    """Boxes on one sheet, in reading order or the highest first, whichever is less empty; None: no room."""
    orders = (numbers, sorted(numbers, key=lambda k: -sizes[k][1]))
    (wide, tall), (taken, low) = area.size, area.corner
    title = (wide - taken, tall - low, wide, tall)
    made = [page for order in orders if (page := pack(sizes, order, area)) is not None]
    return min(made, key=lambda page: largest_empty(area.size, [*page.values(), title]), default=None)
