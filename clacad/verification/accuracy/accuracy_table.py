"""The accuracy table and the ladder of a report: the same rays on every rung, with error and seconds.

The truth is rung surfaces in float64, which is itself checked against a trace in 50 digits. Every number in
the table therefore has a reference, and the error of the reference is known.

Seconds change from run to run and a report must not. The page therefore shows a forecast of the time from
the rates of rungs (`clacad.tracing.which_path`). Times measured in one run go to the run facts, and into the
report only on request. Every rung traces the few rays of a ladder in numpy: compiling its kernels would take
longer than the rest of a report. The time to compile the kernels of a table is forecast here, too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from clacad.base.interactive import shown_progress
from clacad.base.text import mrad_text
from clacad.base.types import Progress
from clacad.sheet.window import Window
from clacad.tracing.which_path import COMPILING, MICROSECONDS, Kernel
from clacad.verification.accuracy.accuracy_row import AccuracyRow, AccuracyTable, TargetOutOfReach

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.sheet.bundle import Bundle
    from clacad.verification.accuracy.measure_rungs import TracedRays


__all__ = ["AccuracyRow", "AccuracyTable", "TargetOutOfReach", "accuracy"]


def accuracy(
    design: Design, rays: int = 100_000, quads: Sequence[int] | None = None, progress: Progress | None = None
) -> AccuracyTable:
    """Measure what accuracy costs: error and seconds of the law, thin lenslets, exact faces, meshes and
    the STEP file.

    For a non-uniform sheet, the rungs that trace it are measured on its worst cell. All rungs are also
    measured on the uniform equivalent of that cell.

    Parameters
    ----------
    design : Design
    rays : int
        Rays of the bundle of the checks (Sobol, over one cell and the cone of the field), traced on every
        rung.
    quads : sequence of int or None
        Tessellations, quads per cell side; default 4, 8, 16, 32, 64, 128.
    progress : callable or None
        Called with a stage's name and the part done.

    Raises
    ------
    DesignError
        The design cannot be built.
    LimitRefused
        The design has more lenslets than a file may hold.

    Examples
    --------
    >>> import clacad
    >>> design = clacad.load("slab", ["lattice.count = [3, 3]"])
    >>> table = clacad.accuracy(design, rays=256, quads=[4])
    >>> sorted({row.rung for row in table.rows})
    ['law', 'mesh', 'step', 'surfaces', 'thin']
    """
    from clacad.exporting.limits import refuse_early
    from clacad.prescription.prescribe import prescribe
    from clacad.sheet.bundle import bundle
    from clacad.tracing.worst_cell import worst_cell
    from clacad.verification.accuracy.measure_rungs import QUADS, TracedRays, made_cost, spectrum_cost

    report = shown_progress(progress)
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
        found = _measured(design.name, traced, rays, grids, report)
        white, made = spectrum_cost(design, seen, light(rays)), made_cost(design, seen, light(rays))
        return replace(found, spectrum=white, made=made)
    i, j = seen.cell.tolist()
    own = TracedRays.raised(seen.window, seen.placed(light(rays)).rays, (i, j))
    rows, coarse = _of_differing_cells(own, grids, report)
    found = _measured(design.name, traced, rays, grids, report)
    said = (
        'this sheet is not uniform: rows "cells that differ" are of the sheet itself, its light'
        f" through {seen.words}{coarse}; the other rows, and the floors, of a"
        " uniform sheet of such cells"
    )
    white, made = spectrum_cost(design, seen, light(rays)), made_cost(design, seen, light(rays))
    return replace(found, rows=(*rows, *found.rows), notes=(said, *found.notes), spectrum=white, made=made)


def _of_differing_cells(
    ladder: TracedRays, grids: Sequence[int], progress: Progress
) -> tuple[list[AccuracyRow], str]:
    """Rows of a non-uniform sheet, and a note on what they omit."""
    from clacad.verification.accuracy.measure_rungs import OWN_FINEST, exact_rows, own_mesh_rows, reference

    progress("the sheet itself", 0.01)
    rows = exact_rows(ladder, reference(ladder))
    asked = [grid for grid in grids if grid <= OWN_FINEST]
    for grid in asked:
        rows += own_mesh_rows(ladder, grid)
    return rows, "" if len(asked) == len(grids) else f", its facets up to {OWN_FINEST} quads a cell side"


def _measured(
    name: str, traced: Callable[[int], TracedRays], rays: int, grids: Sequence[int], progress: Progress
) -> AccuracyTable:
    """The table of a design; `traced` returns the requested number of rays with their truth."""
    from clacad.verification.accuracy.file_floors import floors, probe
    from clacad.verification.accuracy.measure_rungs import exact_rows, mesh_rows, reference, step_row

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


OWN_SECONDS, OWN_SECONDS_A_CELL, OWN_SECONDS_A_RAY = 0.4, 2.0e-5, 1.5e-5
"""Seconds of a non-uniform sheet's rows: 50 digits, each built cell, each ray on rungs without facets."""

OWN_SECONDS_A_FACET = 2e-4
"""Seconds to sort its facets, per square of the quads."""

THROUGH_FACETS, A_QUAD_OF_ONE_LATTICE, A_QUAD_OF_TWO = 2.5e-6, 0.36e-6, 1.2e-6
"""Seconds of a ray through such facets, and the additional seconds per quad of a cell side.

The first additional time is for two arrays on one lattice. The second is for an array 2 with its own lattice:
cells then meet in steps everywhere, and a ray is followed from facet to facet.
"""

RIM_OF_TWO_SIDES, RIM_OF_ONE_SIDE = 4.2e-9, 1.4e-9
"""Seconds of the land about a body with arrays displaced along both axes or one, per square of points."""

RIMS_OF_FLOORS = 21_000
"""Sum of the squared grids that are built for the floors of formats."""

TASK = "accuracy"
"""Name under which the required time is recorded."""


def accuracy_seconds(rays: int, window: Window, quads: Sequence[int] | None = None) -> float:
    """Processor seconds of the table, by a model of one reference machine (see `clacad.base.machine_rates`).

    The 50-digit trace and the STEP spot count once. To them add the rays of every row, the layout of facets,
    and the floors of each pattern of cells that is meshed. Hexagons have more facets per quad than squares,
    cells with land are cut along their rims, and turned lenses have no plane of symmetry. A non-uniform sheet
    is measured itself in addition.
    """
    from clacad.verification.accuracy.measure_rungs import QUADS

    grids = tuple(quads or QUADS)
    own_lattice = any(place.own for place in window.placements)
    apart = own_lattice or window.shifts[1] != (0.0, 0.0)
    split = sum(apart and len({f.array for f in (b.front, b.back)} - {None}) == 2 for b in window.bodies)
    patterns = len(window.bodies) + split
    turned = not all(face.untilted for face in window.faces)
    rough, spot = 1.0, 1.1
    if window.lattice.hexagonal:
        rough = 5.0
    elif window.outline is not None and not split:
        rough = 3.0
    elif turned:
        rough, spot = 2.0, 2.8
    facets = 3.0e-5 * sum(q * q for q in grids) + 1.15
    traced = (1.7e-6 + 1.0e-6 * patterns) * rays * len(grids)
    own = 0.0 if window.uniform else _own_seconds(rays, window, grids)
    if split:
        rim = RIM_OF_TWO_SIDES if own_lattice or 0.0 not in window.shifts[1] else RIM_OF_ONE_SIDE
        points = 2.0 * sum(window.lattice.count)
        own += rim * points**2 * (sum(q * q for q in grids) + RIMS_OF_FLOORS)
    return own + spot + traced + patterns * (0.2 + rough * facets)


def _own_seconds(rays: int, window: Window, grids: Sequence[int]) -> float:
    """Processor seconds of the rows of a non-uniform sheet itself."""
    from clacad.verification.accuracy.measure_rungs import OWN_FINEST, REPEATS, SLOW

    fit = [q for q in grids if q <= OWN_FINEST]
    quad = A_QUAD_OF_TWO if any(place.own for place in window.placements) else A_QUAD_OF_ONE_LATTICE
    found = OWN_SECONDS + OWN_SECONDS_A_CELL * window.lattice.cell_count + OWN_SECONDS_A_RAY * rays
    for q in fit:
        once = rays * (THROUGH_FACETS + quad * q)
        runs = 2 + (REPEATS if once < SLOW else 1)  # the first, the repeats, and one for memory
        found += OWN_SECONDS_A_FACET * q * q + 2.0 * runs * once  # facet and vertex normals
    return found


def _notes(rows: Sequence[AccuracyRow], step_note: str) -> tuple[str, ...]:
    surfaces = next(row for row in rows if row.rung == "surfaces")
    notes = [
        (
            "rung law's model error equals rung surfaces' error to the law by definition: "
            f"{mrad_text(surfaces.law_rms, 3)} rms; it also leaves out the ray offset and the ghosts"
        )
    ]
    return (*notes, *([step_note] if step_note else []))


RAYS = 8192
ORACLE_RAYS = 128
QUADS = (4, 8, 16, 32)


@dataclass(frozen=True, eq=False)
class Ladder:
    """Rows of the ladder, their forecast microseconds per ray, and the error of the truth itself.

    rows : tuple of clacad.verification.accuracy.accuracy_row.AccuracyRow
    forecast : microseconds
    reference : radians. Rms of the truth against a trace in 50 digits.
    """

    rows: tuple[AccuracyRow, ...]
    forecast: tuple[float, ...]
    reference: float

    @property
    def conclusion(self) -> str:
        """Conclusion from the errors and the forecast of the time, in words."""
        from clacad.verification.accuracy.accuracy_row import conclusion

        rows = [
            replace(row, seconds=1e-6 * us * row.rays)
            for row, us in zip(self.rows, self.forecast, strict=True)
        ]
        return f"{conclusion(rows)} Times are forecasts."

    def measured(self) -> list[dict[str, Any]]:
        """Run facts: seconds of this run, rung by rung."""
        names = ("rung", "setting", "seconds", "prepare_s", "rays")
        return [{name: getattr(row, name) for name in names} for row in self.rows]

    def to_dict(self) -> list[dict[str, Any]]:
        """Numbers for the report, without measured times."""
        names = (
            "rung",
            "setting",
            "model_rms",
            "model_max",
            "law_rms",
            "law_max",
            "disagree",
            "rays",
            "quads",
        )
        return [
            {name: getattr(row, name) for name in (*names, "normals", "triangles")} | {"forecast_us": us}
            for row, us in zip(self.rows, self.forecast, strict=True)
        ]


def climb(design: Design, window: Window, progress: Progress) -> Ladder:
    """Trace one bundle on the rungs law, thin, surfaces, and mesh at some refinements."""
    from functools import partial

    from clacad.mesh import tessellate
    from clacad.sheet.bundle import RequestedLaw, bundle
    from clacad.tracing.trace import trace
    from clacad.verification.accuracy import measure_rungs

    lit = bundle(window, RAYS, design.check.field, design.check.field_centre)
    ladder = measure_rungs.TracedRays(
        window, lit.rays, trace(window, lit.rays, path="size"), RequestedLaw.of(window).expected(lit)
    )
    known = measure_rungs.reference(ladder, ORACLE_RAYS)["rms"]
    rows, forecast = [], []
    exact: tuple[Literal["law", "thin", "surfaces"], ...] = ("law", "thin", "surfaces")
    for number, rung in enumerate(exact):
        progress("accuracy against time", 0.1 * number)
        found = measure_rungs.row(
            ladder, rung, "exact", partial(trace, window, lit.rays, rung=rung, path="size"), repeats=0
        )
        rows.append(replace(found, model_rms=known) if rung == "surfaces" else found)
        forecast.append(MICROSECONDS[rung])
    for number, quads in enumerate(QUADS):
        progress("accuracy against time", 0.3 + 0.7 * number / len(QUADS))
        mesh = tessellate(window, quads=quads)
        for normals in ("facet", "vertex"):
            run = partial(trace, window, lit.rays, rung="mesh", mesh=mesh, normals=normals, path="size")
            facts: dict[str, Any] = {"quads": quads, "normals": normals, "triangles": mesh.facet_count}
            setting = f"{quads} quads, {normals} normals"
            rows.append(measure_rungs.row(ladder, "mesh", setting, run, repeats=0, **facts))
            forecast.append(MICROSECONDS["mesh"] + MICROSECONDS["mesh, a quad of the side"] * quads)
    return Ladder(tuple(rows), tuple(forecast), known)


OF_TABLE: tuple[Kernel, ...] = ("surfaces", "mesh", "float32", "law", "thin")
"""Kernels of an accuracy table."""

COMPILING_TASK = "compiling what traces"
"""Name under which a machine's rate is looked up."""


def compiling_seconds(window: Window, kernels: Sequence[Kernel]) -> float:
    """Processor seconds to compile those of some kernels that are not cached on this machine; 0 where all
    are.

    window : the kind of its layout determines the code; 0 for a non-uniform sheet
    """
    if not window.uniform:
        return 0.0
    return sum(COMPILING[name] for name in kernels if not _kept(window, name))


def _kept(window: Window, kernel: Kernel) -> bool:
    """Whether the code of one kernel is on disk; it depends on the argument types alone."""
    from clacad.base.kernel_cache import is_kept
    from clacad.optics.ledger import Ledger
    from clacad.optics.rays import Rays
    from clacad.tracing.compiled.chunk import rung_is_kept, straight_chunk_single, trace_chunk
    from clacad.tracing.compiled.packing import in_single, pack
    from clacad.tracing.compiled.threads import in_arrays
    from clacad.tracing.facets.triangle_soup import facets_of
    from clacad.tracing.layout import lay_out

    layout = lay_out(window)
    if kernel == "thin" and window.thin.field:  # computed by numpy
        return True
    if kernel == "surfaces" or kernel == "law" or kernel == "thin":
        return rung_is_kept(kernel, layout)
    rows, one = np.arange(1), Rays(np.zeros((1, 3)), np.ones((1, 3)))
    traced = (rows, *in_arrays(one, Ledger.blank(1, 0)))
    if kernel == "mesh":
        facets = facets_of(window.with_cells((1, 1)), 2, "facet")
        return is_kept(trace_chunk, (facets.found_in, pack(facets.layout), *traced))
    sheet = pack(layout)
    return is_kept(straight_chunk_single, (sheet, in_single(sheet), *traced, np.empty_like(rows)))
