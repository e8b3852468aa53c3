"""What accuracy costs in time: the same rays up every rung, each with its error and its seconds.

The truth is rung surfaces in float64, which is itself held to a trace in 50 digits; so every number in the
table has a reference, and the reference has an error of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from clacad.base.types import Progress, silent
from clacad.verification.accuracy.rows import Row, Table, TargetOutOfReach

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.optics.rays import Rays

__all__ = ["Row", "Table", "TargetOutOfReach", "accuracy"]


def accuracy(
    design: Design, rays: int = 100_000, quads: Sequence[int] | None = None, progress: Progress | None = None
) -> Table:
    """Measure error against seconds over the rungs and their settings.

    Parameters
    ----------
    design : Design
    rays : int
        Rays of the bundle the checks use (Sobol, over one cell and the cone of the field), sent up every rung.
    quads : sequence of int or None
        Tessellations, quads per cell side; default 4, 8, 16, 32, 64, 128.
    progress : callable or None
        Called with a stage's name and the part done.

    Returns
    -------
    Table

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
    from clacad.verification.accuracy.file_floors import floors, probe
    from clacad.verification.accuracy.measure_rungs import QUADS, Ladder, exact_rows, mesh_rows, reference
    from clacad.verification.accuracy.step_rung import step_row

    report = progress or silent
    refuse_early(design, (), {})
    window = prescribe(design)
    report("tracing the truth", 0.0)

    def lit(count: int) -> Rays:
        return bundle(window, count, design.check.field, design.check.field_centre).rays

    ladder = Ladder.raised(window, lit(rays))
    checked = reference(ladder)
    report("law, thin, surfaces", 0.05)
    rows = exact_rows(ladder, checked)
    grids = tuple(quads or QUADS)
    for number, grid in enumerate(grids):
        report(f"mesh of {grid} quads a cell side", 0.1 + 0.7 * number / len(grids))
        rows += mesh_rows(ladder, grid)
    report("STEP", 0.8)
    step, note = step_row(ladder, lambda count: Ladder.raised(window, lit(count)))
    rows += [] if step is None else [step]
    report("floors of the file formats", 0.9)
    found = floors(probe(window, ladder.rays, ladder.truth))
    report("done", 1.0)
    return Table(design.name, tuple(rows), checked, tuple(found), _notes(rows, note), rays=rays)


def _notes(rows: Sequence[Row], step_note: str) -> tuple[str, ...]:
    surfaces = next(row for row in rows if row.rung == "surfaces")
    notes = [
        "rung law's model error equals rung surfaces' error to the law by definition: "
        f"{1e3 * surfaces.law_rms:.3g} mrad rms; it also leaves out the ray offset and the ghosts",
    ]
    return (*notes, *([step_note] if step_note else []))
