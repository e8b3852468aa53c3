"""What accuracy costs in time: the same rays up every rung, each with its error and its seconds.

The truth is rung surfaces in float64, which is itself held to a trace in 50 digits; so every number in the
table has a reference, and the reference has an error of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from clacad.base.types import Progress, silent
from clacad.verification.accuracy.error_and_seconds import AccuracyRow, AccuracyTable, TargetOutOfReach

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.sheet.bundle import Bundle
    from clacad.sheet.window import Window
    from clacad.verification.accuracy.measure_rungs import TracedRays

__all__ = ["AccuracyRow", "AccuracyTable", "TargetOutOfReach", "accuracy"]


def accuracy(
    design: Design, rays: int = 100_000, quads: Sequence[int] | None = None, progress: Progress | None = None
) -> AccuracyTable:
    """Measure error against seconds over the rungs and their settings.

    Of a sheet whose cells differ the rungs that trace it are measured on its worst cell, and beside them everything on a
    sheet of equal cells like that one.

    Parameters
    ----------
    design : Design
    rays : int
        Rays of the bundle the checks use (Sobol, over one cell and the cone of the field), sent up every rung.
    quads : sequence of int or None
        Tessellations, quads per cell side; default 4, 8, 16, 32, 64, 128.
    progress : callable or None
        Called with a stage's name and the part done.

    Raises
    ------
    DesignError
        The design cannot be built.
    LimitRefused
        It has more lenslets than any file would hold.
    """
    from clacad.exporting.limits import refuse_early
    from clacad.prescription.prescribe import prescribe
    from clacad.sheet.bundle import bundle
    from clacad.tracing.worst_cell import worst_cell
    from clacad.verification.accuracy.measure_rungs import QUADS, TracedRays

    report = progress or silent
    refuse_early(design, (), {})
    seen = worst_cell(prescribe(design), design.check.field)
    if seen.tried:
        seen = replace(seen, like=seen.buildable)
    report("tracing the truth", 0.0)

    def light(count: int) -> Bundle:
        return bundle(seen.like, count, design.check.field, design.check.field_centre)

    def traced(count: int) -> TracedRays:
        return TracedRays.raised(seen.like, light(count).rays)

    grids = tuple(quads or QUADS)
    if not seen.tried:
        return _measured(design.name, traced, rays, grids, report)
    i, j = seen.cell.tolist()
    own = TracedRays.raised(seen.window, seen.placed(light(rays)).rays, (i, j))
    rows, coarse = _of_differing_cells(own, grids, report)
    found = _measured(design.name, traced, rays, grids, report)
    said = (
        f'every cell of this sheet differs: rows "cells that differ" are of the sheet itself, its light through cell ({i}, {j}), '
        f"the worst of {seen.tried} tried{coarse}; the others, and the floors, of a sheet of equal cells like that one"
    )
    return replace(found, rows=(*rows, *found.rows), notes=(said, *found.notes))


def _of_differing_cells(
    ladder: TracedRays, grids: Sequence[int], progress: Progress
) -> tuple[list[AccuracyRow], str]:
    """Rows of a sheet whose cells differ, and what is left out of them."""
    from clacad.verification.accuracy.measure_rungs import OWN_FINEST, own_mesh_rows, own_rows

    progress("the sheet itself", 0.01)
    rows = own_rows(ladder)
    asked = [grid for grid in grids if grid <= OWN_FINEST]
    for grid in asked:
        rows += own_mesh_rows(ladder, grid)
    return rows, "" if len(asked) == len(grids) else f", its facets up to {OWN_FINEST} quads a cell side"


def _measured(
    name: str, traced: Callable[[int], TracedRays], rays: int, grids: Sequence[int], progress: Progress
) -> AccuracyTable:
    """The table of a design; `traced` gives so many rays with their truth."""
    from clacad.verification.accuracy.file_floors import floors, probe
    from clacad.verification.accuracy.measure_rungs import exact_rows, mesh_rows, reference
    from clacad.verification.accuracy.step_rung import step_row

    ladder = traced(rays)
    checked = reference(ladder)
    progress("law, thin, surfaces", 0.05)
    rows = exact_rows(ladder, checked)
    for number, grid in enumerate(grids):
        progress(f"mesh of {grid} quads a cell side", 0.1 + 0.7 * number / len(grids))
        rows += mesh_rows(ladder, grid)
    progress("STEP", 0.8)
    step, note = step_row(ladder, traced)
    rows += [] if step is None else [step]
    progress("floors of the file formats", 0.9)
    found = floors(probe(ladder.window, ladder.rays, ladder.truth))
    progress("done", 1.0)
    return AccuracyTable(name, tuple(rows), checked, tuple(found), _notes(rows, note), rays=rays)


OWN_SECONDS, OWN_SECONDS_A_RAY = 10.0, 2.0e-5
"""Of the rows of a sheet whose cells differ: its worst cell found and 50 digits; each ray, mostly on rungs law and thin in numpy."""

OWN_SECONDS_A_FACET, OWN_SECONDS_A_RAY_A_GRID = 4.5e-3, 8.0e-5
"""Of their facets: sorted, by quads squared; each ray through each grid, with facet and vertex normals."""

TASK = "accuracy"
"""Name under which the time it takes is noted."""


def accuracy_seconds(rays: int, window: Window, quads: Sequence[int] | None = None) -> float:
    """Processor seconds of the table, by a model of one reference machine (see `clacad.base.machine_rates`): the 50-digit
    trace and the STEP spot once; rays through every row, facets laid out and the floors of each pattern of cells that is
    meshed. Hexagons have more facets a quad than squares, and cells with land are cut along their rims.
    """
    from clacad.verification.accuracy.measure_rungs import OWN_FINEST, QUADS

    grids = tuple(quads or QUADS)
    patterns = sum(2 if len({f.array for f in (b.front, b.back)} - {None}) == 2 and window.shifts[1] != (0.0, 0.0) else 1
                   for b in window.bodies)  # fmt: skip
    rough = 4.0 if window.lattice.hexagonal else 1.0
    if window.outline is not None and patterns == len(window.bodies) and not window.lattice.hexagonal:
        rough = 2.2
    facets = 1.25e-4 * sum(q * q for q in grids) + 1.1
    fit = [q for q in grids if q <= OWN_FINEST]
    each = OWN_SECONDS_A_RAY + OWN_SECONDS_A_RAY_A_GRID * len(fit)
    faceted = OWN_SECONDS_A_FACET * sum(q * q for q in fit)
    own = 0.0 if window.uniform else OWN_SECONDS + faceted + each * rays
    return own + 2.0 + patterns * (0.6 + 3.3e-6 * rays * len(grids) + rough * facets)


def _notes(rows: Sequence[AccuracyRow], step_note: str) -> tuple[str, ...]:
    surfaces = next(row for row in rows if row.rung == "surfaces")
    notes = [
        "rung law's model error equals rung surfaces' error to the law by definition: "
        f"{1e3 * surfaces.law_rms:.3g} mrad rms; it also leaves out the ray offset and the ghosts",
    ]
    return (*notes, *([step_note] if step_note else []))
