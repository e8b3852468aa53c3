"""Cost of an export before any work: of each format closely, of all roughly, and of the common ones for
`check`.

In the close forecast, facets and the bytes of STL and TIFF are exact, other bytes are within 20 %, seconds
and memory are ranges.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from math import sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.base.machine_rates import Rates, Span, total
from clacad.exporting.formats.format import ChosenMesh, Forecast, RoughSheet
from clacad.exporting.formats.registry import format_of, formats
from clacad.exporting.limits import MOST_FACETS, QUADS, refuse_cells, refuse_other_cells, refuse_over_limits
from clacad.exporting.request import DEFAULTS, Request
from clacad.exporting.roles import Role
from clacad.sheet.need_window import CellsDiffer
from clacad.storage.errors import LimitRefused

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.exporting.tessellations import Meshes
    from clacad.sheet.window import Window

PREPARE = "export prepare"
"""Name under which the time of an export before its first file is recorded."""

AUTOMATIC = 128
"""Facet grid that "auto" is assumed to choose; it and the coarser grids are traced."""

ROUGH = 2.0
"""Error factor of the rough forecast on a machine whose rates are known."""


# -- closely ---------------------------------------------------------------------------------------


def forecast(
    meshes: Meshes, words: Sequence[str], quads: int | Mapping[str, int], asked: Request = DEFAULTS
) -> list[Forecast]:
    """Forecast each format.

    words : Formats.
    quads : Facet grid per cell side for the mesh formats: one for all, or one per format.
    `asked` : Options of STEP, GLB and GDSII.
    """
    grids = dict.fromkeys(words, quads) if isinstance(quads, int) else quads
    return timed([format_of(word).forecast(meshes, grids.get(word, QUADS[-1]), asked) for word in words])


def timed(rows: Sequence[Forecast]) -> list[Forecast]:
    """Rows with their seconds on this machine, from its recorded times."""
    rates = Rates.here()
    spans = [rates.span(row.task, row.modelled) for row in rows]
    return [replace(row, seconds=(span.low, span.high)) for row, span in zip(rows, spans, strict=True)]


def prepare_seconds(quads: Iterable[int]) -> float:
    """Seconds of an export outside the files themselves, on the reference machine.

    Prescription, forecast, meshing and tracing one cell at every facet grid of `quads`, and publishing.
    """
    grids = sorted(quads)
    return 0.11 + 0.9e-4 * sum(grid * grid for grid in grids) + (1.6 if grids else 0.0)


# -- roughly, from the design's numbers --------------------------------------------------------------


def rough_span(design: Design, request: Request) -> Span:
    """Processor seconds of an export on this machine, as a wide range.

    design : With the cells that will be written.
    """
    rates, sheet = Rates.here(), RoughSheet.of_design(design)
    grids = {name: _grid(design, request, name) for name in request.formats if format_of(name).is_mesh}
    before = prepare_seconds(set(grids.values()))
    if "auto" in request.quads.values():
        before += prepare_seconds([AUTOMATIC // 2, AUTOMATIC])
    spans = [rates.span(PREPARE, before)]
    spans += [
        rates.span(f"export {name}", format_of(name).rough_seconds(sheet, grids.get(name, 0), request))
        for name in request.formats
    ]
    found = total(spans)
    wide = max(ROUGH, sqrt(found.high / found.low))
    return Span(found.middle / wide, found.middle * wide, found.seen)


def _grid(design: Design, request: Request, name: str) -> int:
    """Facet grid of a format: as requested, or approximately the one that will be chosen."""
    asked = request.quads.get(name)
    if asked == "auto":
        return AUTOMATIC
    if asked is not None:
        return asked
    if request.role.get(name) is Role.PREVIEW:
        return QUADS[-1]
    sheet = RoughSheet.of_design(design)
    return next((q for q in QUADS if sheet.facets(q) * sheet.cells <= MOST_FACETS), QUADS[-1])


# -- of the common formats, for `check` --------------------------------------------------------------


def outlook(window: Window, design: Design | None = None) -> list[dict[str, Any]]:
    """Forecast the common formats for `check`: what an export with default settings would cost.

    With a design, the facet grids are those that the export chooses, which takes a mesh of one cell. Without
    one, nothing is meshed or generated, and the grids are coarse. Sizes are rough (`RoughSheet`);
    `export --dry-run` reports closer sizes. Each row is `Forecast.to_dict()` with "refused": None, or the
    sentence of the refusal.
    """
    common = [one for one in formats() if one.at_a_glance is not None]
    try:
        n1, n2 = window.lattice.count
        refuse_cells(int(n1), int(n2))
    except LimitRefused as refusal:  # reported without counting: counting facets walks along the outline
        return [{"format": one.word, "refused": str(refusal)} for one in common]
    meshes = [one.word for one in common if one.is_mesh]
    chosen: dict[str, ChosenMesh] = {}
    unbuilt = []
    try:
        if design is not None:
            from clacad.exporting.quads_and_roles import default_meshes

            chosen = default_meshes(design, window, meshes)
    except ValueError as problem:
        if getattr(problem, "exit_status", None) is None:
            raise
        unbuilt = [{"format": word, "refused": str(problem)} for word in meshes]
        common = [one for one in common if not one.is_mesh]
    sheet = RoughSheet.of_window(window)
    rows = [one.at_a_glance(window, sheet, chosen.get(one.word)) for one in common if one.at_a_glance]
    return [*(row.to_dict() | {"refused": _refusal(window, row)} for row in timed(rows)), *unbuilt]


def _refusal(window: Window, row: Forecast) -> str | None:
    try:
        refuse_other_cells(window, row.format)
        refuse_over_limits(window, [row], Path())
    except (LimitRefused, CellsDiffer) as refusal:
        return str(refusal)
    return None
