"""Facts and cost that mesh files of all formats have in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from clacad.exporting.formats.format import Forecast, own_cells_note

if TYPE_CHECKING:
    from clacad.exporting.job import Job
    from clacad.sheet.window import Window

SCALES = {"mm": 1.0, "m": 1e-3}
"""Units of mesh files, per millimetre."""


def mesh_facts(
    job: Job, facets: int, volume: float, exact: float | None, names: Sequence[str], unit: str = "mm",
    repeated: bool = False,
) -> dict[str, Any]:  # fmt: skip
    """Facts of a mesh file; `repeated`: it holds one cell, and the whole sheet is not meshed."""
    mesh = job.tessellation.cell if repeated else job.tessellation.mesh
    scale = job.scale * SCALES[unit]
    cube = scale**3
    parts = [part for part, body in zip(mesh.bodies, job.window.bodies, strict=True) if body.name in names]
    return {
        "triangles": facets, "quads": job.tessellation.quads, "slope_error_rms": float(mesh.slope_error),
        "sag_error_max": float(mesh.sag_error) * scale, "volume": volume * cube,
        "volume_exact": None if exact is None else exact * cube,
        **_saddle_facts(job, sum(part.saddles for part in parts), scale),
    }  # fmt: skip


def _saddle_facts(job: Job, saddles: int, scale: float) -> dict[str, Any]:
    """Number of saddles of a mesh and their treatment; `scale`: file units per design unit."""
    bevel = job.request.saddle_bevel * scale
    if not saddles:
        return {"saddles": 0}
    if bevel:
        return {"saddles": saddles, "saddle_policy": "bevel", "saddle_bevel": bevel}
    return {"saddles": saddles, "saddle_policy": "touch"}


def of_own_cells(window: Window, row: Forecast, quads: int) -> Forecast:
    """Row of a mesh with the cost of a non-uniform sheet: each cell is cut and joined to its neighbours separately."""
    if window.uniform:
        return row
    bodies = sum(any(f.change is not None for f in (body.front, body.back)) for body in window.bodies)
    cells = window.lattice.cell_count * bodies
    more = cells * (1.5e-3 + 2.5e-4 * quads + 2e-6 * quads * quads)
    return replace(row, modelled=row.modelled + more, note=own_cells_note(window))
