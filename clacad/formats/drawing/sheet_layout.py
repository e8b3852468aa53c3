"""Layout of views and tables on sheets of paper: positions, scales, number of sheets."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from clacad.formats.drawing import differing_cells, drawing_tables, views
from clacad.formats.drawing.allowances import Allowances, allowances
from clacad.formats.drawing.canvas import Canvas, scale_text
from clacad.formats.drawing.sheet_frame import PAPERS, Heading, frame_box, sheet_frame, title_block
from clacad.formats.drawing.sheet_packing import Area, Box, largest_empty, pack

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.sheet.feasibility import Feasibility
    from clacad.sheet.window import Window

ROOM = 3.0
"""Distance from the frame or a neighbour to the content of the sheet, mm."""

PIXEL = 25.4 / 96.0
"""Millimetres a pixel of the drawing boards, enlarged by 1."""

ZOOMS = (1.3, 1.1, 1.0, 0.9, 0.8)
"""Enlargements of the type that are tried, largest first; smaller ones (type below 2.3 mm) only where a table is too wide."""

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
        """The fewest sheets are best; of those the fullest, and of equally full ones the largest views and type."""
        used = sum((x1 - x0) * (y1 - y0) for page in self.pages for x0, y0, x1, y1 in page.values())
        return len(self.pages), max(self.empty, ENOUGH), -used


ENOUGH = 0.18
"""Part of the frame that may be empty: below, larger views and type are better than fuller sheets."""


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
    more = differing_cells.differing_notes(design, window)
    return [
        drawing_tables.faces_table(window, allowed), drawing_tables.sag_table(window),
        *([] if window.uniform else [differing_cells.cells_table(window)]),
        *drawing_tables.plate_tables(design, window), drawing_tables.surfaces_table(window, allowed, slope),
        drawing_tables.errors_table(design, window, allowed, study),
        drawing_tables.notes(window, allowed, slope, NOTES, more),
    ]  # fmt: skip


NOTES = 560.0
"""Width of the notes, px."""


def _sets_of_views(
    window: Window, facts: Feasibility, allowed: Allowances, unit: float
) -> list[list[Canvas]]:
    """The views at every share of their scales that differs: those of the sheet, and those of its cells, each together."""
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
    """Boards on the fewest sheets that hold them, the least empty way that was found; None where one fits on none."""
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
    """Boxes on the fewest sheets, each as full as it gets; the last two share what is left in every way that fits."""
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
    """Boxes on one sheet, in the order of reading or the highest first, as leaves the least empty; None: no room."""
    orders = (numbers, sorted(numbers, key=lambda k: -sizes[k][1]))
    (wide, tall), (taken, low) = area.size, area.corner
    title = (wide - taken, tall - low, wide, tall)
    made = [page for order in orders if (page := pack(sizes, order, area)) is not None]
    return min(made, key=lambda page: largest_empty(area.size, [*page.values(), title]), default=None)
