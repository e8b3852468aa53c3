"""Cost of an export with default settings, as `check` reports it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.exporting.forecast import forecast_stl, step_row, timed, welded_row
from clacad.exporting.format_names import refuse_other_cells
from clacad.exporting.limits import QUADS, refuse_cells, refuse_over_limits
from clacad.exporting.price import Forecast
from clacad.exporting.rough_sizes import RoughSheet
from clacad.formats.step.step_mode import chosen_mode
from clacad.sheet.need_window import CellsDiffer
from clacad.storage.errors import LimitRefused

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.sheet.window import Window

ROUGH_GRID = 8
"""Quads per cell side of a 3MF file when there is no design to choose them."""


def outlook(window: Window, design: Design | None = None) -> list[dict[str, Any]]:
    """Forecast the common formats for `check`: what an export with default settings would cost.

    With a design, the facet grids are those that the export chooses, which takes a mesh of one cell. Without
    one, nothing is meshed or generated, and the grids are coarse. Sizes are rough (`rough_sizes`);
    `export --dry-run` reports closer sizes. Each row is `Forecast.to_dict()` with "refused": None, or the
    sentence of the refusal.
    """
    try:
        n1, n2 = window.lattice.count
        refuse_cells(int(n1), int(n2))
    except LimitRefused as refusal:  # reported without counting: counting facets walks along the outline
        return [{"format": name, "refused": str(refusal)} for name in ("step", "stl", "3mf")]
    sheet, mode = RoughSheet.of_window(window), chosen_mode(window, "auto")
    rows = [step_row(window, mode, about(sheet.step_bytes(mode == "fused")))]
    unbuilt = []
    try:
        rows += _outlook_of_meshes(sheet, window, design)
    except ValueError as problem:
        if getattr(problem, "exit_status", None) is None:
            raise
        unbuilt = [{"format": name, "refused": str(problem)} for name in ("stl", "3mf")]
    return [*(row.to_dict() | {"refused": _refusal(window, row)} for row in timed(rows)), *unbuilt]


def _outlook_of_meshes(sheet: RoughSheet, window: Window, design: Design | None) -> list[Forecast]:
    """Rows of STL and 3MF: with the grids that an export of the design chooses, or roughly on a coarse grid."""
    times, places = (sheet.cells, sheet.listed) if sheet.repeats else (1, 0)
    if design is None:
        quads, stl = ROUGH_GRID, sheet.facets(ROUGH_GRID) * sheet.cells
        held = sheet.piece(quads) if sheet.repeats else stl
        found = {
            "stl": (QUADS[-1], sheet.facets(QUADS[-1]) * sheet.cells, 0),
            "3mf": (quads, held, sheet.threemf_bytes(quads)),
        }
    else:
        from clacad.exporting.quads_and_roles import default_meshes

        meshes = default_meshes(design, window, ("stl", "3mf"))
        found = {name: (one.quads, one.facets, one.bytes) for name, one in meshes.items()}
    quads, facets, _ = found["stl"]
    stl_row = forecast_stl("stl", about(facets), 1, quads, exact=False)
    quads, facets, size = found["3mf"]
    return [stl_row, welded_row("3mf", about(size), about(facets), about(facets * times), places, quads)]


def about(number: int) -> int:
    """A number rounded to two digits, its known accuracy."""
    return int(float(f"{number:.1e}"))


def _refusal(window: Window, row: Forecast) -> str | None:
    try:
        refuse_other_cells(window, row.format)
        refuse_over_limits(window, [row], Path())
    except (LimitRefused, CellsDiffer) as refusal:
        return str(refusal)
    return None
