"""Rough time of an export from the design's numbers, available before the meshing for the full forecast."""

from __future__ import annotations

from math import sqrt
from typing import TYPE_CHECKING

from clacad.base.machine_rates import Rates, Span, total
from clacad.exporting import costs
from clacad.exporting.format_names import MESHES, PRESCRIPTIONS, REPEATING, SOLIDS, STL_FORMATS
from clacad.exporting.limits import MOST_FACETS, QUADS
from clacad.exporting.roles import Role
from clacad.exporting.rough_sizes import RoughSheet
from clacad.formats.step.step_mode import FUSED_CELLS

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.exporting.request import Request

AUTOMATIC = 128
"""Facet grid that "auto" is assumed to choose; it and the coarser grids are traced."""

ROUGH = 2.0
"""Error factor of the rough forecast on a machine whose rates are known."""


def rough_span(design: Design, request: Request) -> Span:
    """Processor seconds of an export on this machine, as a wide range.

    Parameters
    ----------
    design : Design
        With the cells that will be written.
    request : Request
    """
    rates = Rates.here()
    grids = {name: _grid(design, request, name) for name in request.formats if name in MESHES}
    before = costs.prepare_seconds(sorted(set(grids.values())))
    if "auto" in request.quads.values():
        before += costs.prepare_seconds([AUTOMATIC // 2, AUTOMATIC])
    spans = [rates.span(costs.PREPARE, before)]
    spans += [
        rates.span(f"export {name}", _seconds(design, request, name, grids)) for name in request.formats
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


def _seconds(design: Design, request: Request, name: str, grids: dict[str, int]) -> float:
    """Modelled seconds of one format."""
    sheet = RoughSheet.of_design(design)
    cells, bodies = sheet.cells, sheet.bodies
    if name == "step":
        fused = request.step == "fused" or (request.step == "auto" and cells <= FUSED_CELLS)
        return costs.step_seconds(sheet.step_bytes(fused), "fused" if fused else "instanced")
    if name in SOLIDS:
        return costs.solid_seconds(8000 * cells * bodies)
    if name == "drawing":
        return costs.drawing_seconds()
    if name in PRESCRIPTIONS:
        return costs.prescription_seconds(name)
    if name not in MESHES:
        return costs.map_seconds(name, 100 * cells * bodies, 2 * bodies)
    facets = sheet.facets(grids[name])
    if name in STL_FORMATS:
        return costs.stl_seconds(facets * cells)
    if name in REPEATING and not request.fused:
        return costs.welded_seconds(name, facets, sheet.listed if name == "3mf" else cells * bodies)
    return costs.welded_seconds("ply" if name == "ply" else "glb", facets * cells, 0)
