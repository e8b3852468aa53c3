"""Layout of views and tables on sheets of paper: positions, enlargement, number of sheets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from clacad.formats.drawing import differing_cells, drawing_tables, views
from clacad.formats.drawing.allowances import allowances
from clacad.formats.drawing.canvas import Canvas

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.sheet.feasibility import Feasibility
    from clacad.sheet.window import Window

PAPERS: Mapping[str, tuple[float, float]] = {"a4": (297.0, 210.0), "a3": (420.0, 297.0), "a2": (594.0, 420.0)}
"""Width and height of a sheet in landscape, mm (ISO 216)."""

MARGIN = 10.0
"""Distance from the edge of the paper to the frame, mm."""

ROOM = 3.0
"""Distance from the frame or a neighbour to the content of the sheet, mm."""

PIXEL = 25.4 / 96.0
"""Millimetres a pixel of the drawing boards, enlarged by 1."""

ZOOMS = (1.6, 1.4, 1.2, 1.1, 1.0, 0.9, 0.8)
"""Enlargements that are tried, largest first; below 0.8 the type (2.3 mm high) is too small."""


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


def sheets(design: Design, window: Window, facts: Feasibility, paper: str, study: Mapping[str, Any] | None
           ) -> tuple[Sheet, ...]:  # fmt: skip
    """Lay out the drawing of a part.

    Parameters
    ----------
    design : Design
    window : Window
        As written.
    facts : Feasibility
        Of that window.
    paper : "a4", "a3" or "a2"
    study : mapping or None
        Content of `tolerances.json` of a study of this design.
    """
    from clacad import __version__

    allowed = allowances(design)
    boards: list[Canvas] = [
        views.assembly(window), views.plan(window), views.telescopelet(window, facts, None, allowed),
        *(views.lens_detail(window, facts, array, allowed) for array in range(len(facts.lenses))),
        drawing_tables.faces_table(window, allowed), drawing_tables.sag_table(window),
        *([] if window.uniform else [differing_cells.cells_table(window)]),
        *drawing_tables.plate_tables(design, window), drawing_tables.errors_table(design, window, allowed, study),
        drawing_tables.notes(
            window, allowed, design.body.slope_rms, views.WIDTH, differing_cells.differing_notes(design, window)
        ),
    ]  # fmt: skip
    heading = drawing_tables.Heading(design.sha256[:12], __version__, paper)
    title = drawing_tables.title_block(window, heading, 9, 9)
    tried = [(zoom, _packed(boards, title, PAPERS[paper], zoom)) for zoom in ZOOMS]
    zoom, pages = min(
        tried, key=lambda one: len(one[1])
    )  # the fewest sheets, and of those the largest enlargement
    made = []
    for number, page in enumerate(pages, 1):
        block = drawing_tables.title_block(window, heading, number, len(pages))
        made.append(Sheet(PAPERS[paper], zoom, (*page, _in_corner(block, PAPERS[paper], zoom))))
    return tuple(made)


def _in_corner(block: Canvas, paper: tuple[float, float], zoom: float) -> PlacedBlock:
    """The title block in the lower right corner of the frame."""
    unit = PIXEL * zoom
    return PlacedBlock(block, paper[0] - MARGIN - block.width * unit, paper[1] - MARGIN - block.height * unit)


def _packed(
    boards: Sequence[Canvas], title: Canvas, paper: tuple[float, float], zoom: float
) -> list[list[PlacedBlock]]:
    """Boards in rows from the top, each row as tall as its first board; pages as they fill up."""
    unit = PIXEL * zoom
    wide, tall = paper[0] - 2 * (MARGIN + ROOM), paper[1] - 2 * (MARGIN + ROOM)
    corner = title.height * unit + ROOM
    pages: list[list[PlacedBlock]] = [[]]
    left = list(boards)
    y = 0.0
    while left:
        row = [left.pop(0)]
        x = row[0].width * unit + ROOM
        height = row[0].height * unit
        for board in [b for b in left if b.height * unit <= height + ROOM]:
            if x + board.width * unit <= wide:
                row.append(board)
                left.remove(board)
                x += board.width * unit + ROOM
        low = y + height
        beside_title = x - ROOM <= wide - title.width * unit - ROOM
        if low > tall - (0.0 if beside_title else corner) and pages[-1]:
            pages.append([])
            y = 0.0
        at = MARGIN + ROOM
        for board in row:
            pages[-1].append(PlacedBlock(board, at, MARGIN + ROOM + y))
            at += board.width * unit + ROOM
        y += height + ROOM
    return pages
