"""Export of a design's files: forecast, write, read back, publish.

One atomic writer serves all formats, and every file is read back before publication. A copy of a design's
cell table lies next to the files that were exported from it.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from inspect import Parameter, Signature, signature
from math import sqrt
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, Literal, Unpack

from clacad.base import log
from clacad.base.interactive import shown_progress
from clacad.base.machine_rates import Rates, Span, seconds_of, total
from clacad.base.types import Progress
from clacad.base.untrusted_files import BUDGETS, read_regular
from clacad.design.cell_table import digest, table_path
from clacad.exporting import limits
from clacad.exporting.compensation import compensation_of, nose_of
from clacad.exporting.forecast import PREPARE, forecast, prepare_seconds
from clacad.exporting.formats.format import Forecast, cell_words
from clacad.exporting.formats.height_maps import CELL_TABLE
from clacad.exporting.formats.registry import format_of, known
from clacad.exporting.light_forecast import Grader
from clacad.exporting.limits import Refusals, refuse_idle, require_possible
from clacad.exporting.manifest import FileRecord, Job, Manifest, carried_over, document
from clacad.exporting.quads_and_roles import Sizes, asked_quads, asked_roles, chosen_quads, with_prospects
from clacad.exporting.request import DEFAULTS, OPTIONS, MoreOptions, Request
from clacad.exporting.roles import Role
from clacad.exporting.tessellations import Meshes
from clacad.storage.atomic import MANIFEST, Stage, read_manifest, require_folder, safe_name, translated
from clacad.storage.errors import (
    BadRequest,
    CannotWrite,
    ExportError,
    ExportIncomplete,
    ExportRefused,
    FileDisagrees,
    LimitRefused,
    NotPossible,
    UnknownFormat,
    UnreadableFile,
    WorkerDied,
)
from clacad.storage.worker import Worker, ended_by_signals, worker_memory

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.exporting.request import AskedQuads, AskedRole
    from clacad.sheet.window import Window


def copied_table(design: Design, stage: Stage) -> list[FileRecord]:
    """Copy the table into the stage; return its manifest entry, or none for a design without a table.

    Raises FileDisagrees: The table has changed since the design was read.
    """
    spec = design.law_spec.varying
    if spec is None or spec.table is None:
        return []
    source = table_path(design.path, spec.table.file)
    name = PurePosixPath(spec.table.file.replace("\\", "/")).name
    copy = stage.path(name)
    copy.write_bytes(read_regular(source, BUDGETS["cell-table"].bytes))
    found = digest(str(copy))
    if found != spec.table.sha256:
        raise FileDisagrees(f"{name}: the table has changed since the design was read")
    role = {"role": str(Role.OTHER)}
    return [
        FileRecord(name, found, copy.stat().st_size, CELL_TABLE, "slopes", (), checks=("sha256",), role=role)
    ]


CAD_MODULES = ("OCP.STEPCAFControl", "OCP.BRepGProp", "OCP.BRepCheck")
"""Modules that the worker loads while the parent prepares the work."""


def run_export(
    design: Design, out: str, request: Request, progress: Progress | None, window: Window | None = None
) -> Manifest:
    """Do what `clacad.exporting.run.export` promises; window: the sheet as built, where it is known."""
    report = shown_progress(progress)
    asked, (made, formats, request) = request, _begun(design, request)
    began, used = time.monotonic(), time.process_time()
    with ended_by_signals(), Worker(memory=worker_memory(), preload=CAD_MODULES) as worker:
        if any(format_of(name).kernel for name in formats):
            worker.start()  # OCC loads while the design is prescribed and forecast
        report("forecast", 0.0)
        window = _prescribed(made, request, window)
        meshes = Meshes(window, request.saddle_bevel, request.fused)
        rows = _forecast(made, meshes, formats, request, (Path(out), worker))
        quads = {row.quads for row in rows if row.quads is not None}
        with Stage(out, overwrite=request.overwrite) as stage:
            stage.path(MANIFEST)  # a foreign manifest is refused before any work
            job = Job(
                window,
                safe_name(design.name),
                stage,
                meshes.at(limits.QUADS[-1]),
                worker,
                request,
                report,
                design,
            )
            Rates.here().note(PREPARE, prepare_seconds(quads), time.process_time() - used)
            records, failures, seconds = _produced(job, meshes, rows)
            if not records:
                raise next(iter(failures.values()))
            content = _content(design, window, [*records, *copied_table(made, stage)], asked)
            content["files"] += carried_over(stage.folder, content)
            content["files"].sort(key=lambda entry: str(entry["name"]))
            facts = {
                "seconds": seconds | {"all": time.monotonic() - began},
                "forecast": [r.to_dict() for r in rows],
            }
            report("publish", 1.0)
            stage.publish(content, facts)
            folder = stage.folder
    manifest = Manifest(folder, read_manifest(folder) or content, facts)
    if failures:
        raise ExportIncomplete(failures, manifest)
    return manifest


def forecast_rows(
    design: Design, request: Request, out: Path | None = None, window: Window | None = None
) -> list[Forecast]:
    """Cost of an export, format by format; writes nothing.

    window : The sheet as built, with the cells of the request; None: it is prescribed here.
    out : The target folder: the refusals of `export` apply here too, those of size unless forced. None: rows
        of any size, and of files that the design cannot have, are returned.
    Raises DesignError, NotPossible, LimitRefused, CannotBuild: The refusals of all formats together.
    Raises CannotWrite: The folder cannot be made or written to.
    """
    made, formats, request = _begun(design, request)
    meshes = Meshes(_prescribed(made, request, window), request.saddle_bevel, request.fused)
    if out is None:
        return _forecast(made, meshes, formats, request, None)
    with ended_by_signals(), Worker(memory=worker_memory()) as worker:
        return _forecast(made, meshes, formats, request, (out, worker))


def refuse_impossible(design: Design, request: Request) -> None:
    """Refuse impossible formats, and a cell count beyond the limits, before any other work.

    Raises DesignError, NotPossible, LimitRefused, CannotBuild: The refusals of all formats together.
    """
    made, formats, request = _begun(design, request)
    with ended_by_signals(), Worker(memory=worker_memory()) as worker:
        _impossible(made, _prescribed(made, request), formats, request, worker).complete()


def _begun(design: Design, request: Request) -> tuple[Design, tuple[str, ...], Request]:
    """The design with the cells to be written, the requested formats, all known and none with an option that
    it lacks, and the request with the nose and the compensation of the design's process.

    Formats are refused by the number of lenslets alone, before the design is prescribed.
    """
    formats, refused = known(request.formats), Refusals()
    refuse_idle(request)
    nose = nose_of(design) if request.nose is None else request.nose
    asked = replace(request, nose=nose, compensation=compensation_of(design))
    made = design if request.cells is None else design.with_cells(request.cells)
    if request.force:
        return made, formats, asked
    limits.refuse_uncountable(made)
    for name in formats:
        with refused.of(name):
            limits.refuse_early(made, (name,), request.quads)
    if all(name in refused for name in formats):
        refused.complete()
    return made, formats, asked


def _impossible(
    design: Design, window: Window, formats: tuple[str, ...], request: Request, worker: Worker
) -> Refusals:
    """Formats that the design, or its number of lenslets, makes impossible."""
    refused = Refusals()
    for name in formats:
        with refused.of(name):
            require_possible(window, name, request, worker)
            if not request.force:
                limits.refuse_early(design, (name,), request.quads)
    return refused


def _forecast(
    design: Design,
    meshes: Meshes,
    formats: tuple[str, ...],
    request: Request,
    where: tuple[Path, Worker] | None,
) -> list[Forecast]:
    """Rows of all formats; all refusals are raised together, before the light through the meshes is forecast.

    where : target folder, and the worker that draws letters with little room; None: nothing is refused
    """
    if where is not None:
        require_folder(where[0])
    grader, sizes = Grader.of(meshes, design), Sizes(meshes)
    refused = Refusals() if where is None else _impossible(design, meshes.window, formats, request, where[1])
    for name in () if where is None else formats:
        with refused.of(name):
            one = format_of(name)
            if one.refuse_places is not None and one.repeats_cells(meshes):
                one.refuse_places(meshes.window, request)
    rows = _priced(grader, sizes, [name for name in formats if name not in refused], request, refused)
    if where is not None and not request.force:
        for row in rows:
            with refused.of(row.format):
                limits.refuse_over_limits(meshes.window, [row], where[0])
        if not refused:
            limits.refuse_over_limits(meshes.window, rows, where[0])  # the disk holds all of them
    refused.complete()
    return with_prospects(grader, sizes, rows, request)


def _priced(
    grader: Grader, sizes: Sizes, formats: Sequence[str], request: Request, refused: Refusals
) -> list[Forecast]:
    """Rows of the formats whose bodies can be made; the others are refused."""
    quads: dict[str, int] = {}
    cut = [name for name in formats if format_of(name).is_mesh]
    with refused.of(*cut):
        quads = chosen_quads(grader, sizes, request, cut)
    rows: list[Forecast] = []
    for name in formats:
        if name not in refused:
            with refused.of(name):
                kind, whole = format_of(name), grader.meshes.window
                sheet, note = kind.sheet_of(whole, request), cell_words(kind.cell_facts(whole, request))
                meshes = (
                    grader.meshes if sheet is whole else Meshes(sheet, request.saddle_bevel, request.fused)
                )
                found = forecast(meshes, [name], quads, request)
                rows += [replace(row, note=note or row.note) for row in found]
    return rows


def in_all(rows: Sequence[Forecast]) -> Span:
    """Seconds of a whole export on this machine, from the forecasts of its formats."""
    rates = Rates.here()
    quads = {row.quads for row in rows if row.quads is not None}
    return total(
        [rates.span(PREPARE, prepare_seconds(quads)), *(rates.span(r.task, r.modelled) for r in rows)]
    )


def _prescribed(design: Design, request: Request, window: Window | None = None) -> Window:
    """The sheet as built, which has the requested cell; `window`: where it is known."""
    from clacad.prescription.prescribe import prescribe

    window = prescribe(design) if window is None else window
    if request.cell is not None:
        limits.refuse_no_cell(window, request.cell)
    return window


def _produced(
    job: Job, meshes: Meshes, rows: Sequence[Forecast]
) -> tuple[list[FileRecord], dict[str, ExportError], dict[str, float]]:
    """Make every format; one that fails leaves nothing behind and does not stop the others.

    The time of each is recorded with its forecast, for later forecasts.
    """
    rates = Rates.here()
    records: list[FileRecord] = []
    failures: dict[str, ExportError] = {}
    seconds: dict[str, float] = {}
    for row in rows:
        name = row.format
        began, used = time.monotonic(), _used(job.worker)
        before, done = set(job.stage.written()), len(records)
        try:
            with translated(job.stage.folder):
                one = job if row.quads is None else replace(job, tessellation=meshes.at(row.quads))
                kind = format_of(name)
                sheet = kind.sheet_of(job.window, job.request)
                if row.quads is not None and sheet is not job.window:
                    own = Meshes(sheet, job.request.saddle_bevel, job.request.fused)
                    one = replace(one, tessellation=own.at(row.quads))
                one = replace(one, window=sheet)
                cell = kind.cell_facts(job.window, job.request)
                cell |= _as_made(row, job.request)
                records += [_with_facts(record, row, cell) for record in kind.write(one)]
        except (ExportError, MemoryError, ValueError) as error:
            failures[name] = _failure(name, error)
            log.note("failure", format=name, sentence=str(error), details=getattr(error, "details", ""))
            for path in set(job.stage.written()) - before:
                path.unlink(missing_ok=True)
        else:
            rates.note(row.task, row.modelled, _used(job.worker) - used)
        seconds[name] = time.monotonic() - began
        for made in records[done:]:
            log.note("file", seconds=round(seconds[name], 4), **made.to_dict())
    return records, failures, seconds


def _as_made(row: Forecast, request: Request) -> dict[str, float]:
    """Forecast of all light through the part made from a file: errors of facets and process in squares."""
    found, made = row.prospect, request.as_made
    if found is None or made is None or found.law_rms is None or made["everything"] is None:
        return {}
    facets = max(0.0, found.law_rms**2 - made["designed"] ** 2)
    return {"forecast_law_rms_as_made": sqrt(facets + made["everything"] ** 2)}


def _with_facts(record: FileRecord, row: Forecast, facts: Mapping[str, Any]) -> FileRecord:
    role = record.role if row.prospect is None else row.prospect.entry()
    return replace(record, role=role, facts={**record.facts, **facts})


def _used(worker: Worker) -> float:
    """Processor seconds so far, the worker's included; elapsed seconds on systems that do not report them."""
    pid = worker.pid
    return time.process_time() + (0.0 if pid is None else seconds_of(pid, time.monotonic()))


def _failure(name: str, error: Exception) -> ExportError:
    """Failure of one format, as an error with a sentence and an exit status; program errors propagate."""
    if isinstance(error, ExportError):
        return error
    if isinstance(error, MemoryError):
        return WorkerDied(f"{name}: ran out of memory; use fewer quads or fewer cells")
    if getattr(error, "exit_status", None) is None:
        raise error
    return NotPossible(str(error))


def _content(design: Design, window: Window, records: list[FileRecord], request: Request) -> dict[str, Any]:
    from clacad import __version__
    from clacad.sheet.feasibility import feasibility

    bodies = feasibility(window).bodies
    counts = {"pieces": [body.pieces for body in bodies], "holes": [body.holes for body in bodies]}
    versions: Mapping[str, str] = {"clacad": __version__}
    return document(design, window, records, request.to_dict(), versions, counts)


__all__ = [
    "BadRequest",
    "CannotWrite",
    "ExportError",
    "ExportIncomplete",
    "ExportRefused",
    "FileDisagrees",
    "LimitRefused",
    "UnknownFormat",
    "UnreadableFile",
    "WorkerDied",
    "export",
]


def export(
    design: Design,
    out: str | os.PathLike[str],
    formats: Sequence[str] = DEFAULTS.formats,
    slope_error: float | Literal["auto"] = DEFAULTS.slope_error,
    quads: AskedQuads = None,
    step: Literal["auto", "fused", "instanced"] = DEFAULTS.step,
    *,
    role: AskedRole = None,
    progress: Progress | None = None,
    **options: Unpack[MoreOptions],
) -> Manifest:
    """Make the part: write a design as STEP solids, meshes, maps or tables, with a manifest of their hashes.

    Each file is read back and compared with the design before all are published together.

    Parameters
    ----------
    design : Design
    out : path
        Folder; made if missing. Nothing is written outside it.
    formats, slope_error, quads, step, role, and by keyword cells, overwrite, force, step_schema, pcurves,
    saddle_bevel, gpu_instancing, grey_levels, paper, nose, tool_step, tool_order, calibration,
    compensate, fused
        As in `clacad.exporting.request.Request`, which gives units and defaults.
    progress : callable or None
        Called with a stage's name and the share done.

    Returns
    -------
    Manifest

    Raises
    ------
    DesignError, BadRequest, UnknownFormat, LimitRefused, ExportRefused, CannotWrite, NotPossible,
    FileDisagrees, WorkerDied
        Nothing was published; the message gives the reason and a remedy.
    ExportIncomplete
        Some formats failed; the others were published.

    Examples
    --------
    >>> import clacad
    >>> design = clacad.load("slab", ["lattice.count = [3, 3]"])
    >>> from tempfile import mkdtemp
    >>> made = clacad.export(design, mkdtemp(), ["stl"], quads=4)
    >>> [(file["name"], file["role"]) for file in made.files]
    [('slab.stl', 'shape-preview')]
    """
    grids, roles = asked_quads(quads, formats), asked_roles(role, formats)
    request = Request(tuple(formats), slope_error, grids, step, role=roles, **options)
    return run_export(design, os.fspath(out), request, progress)


def _signature_of_export() -> Signature:
    """Parameters of `export` with every option and its default, for help and completion."""
    plain = signature(export)
    known = {name: one for name, one in plain.parameters.items() if name != "options"}
    known |= {
        name: Parameter(name, Parameter.KEYWORD_ONLY, default=getattr(DEFAULTS, name), annotation=kind)
        for name, kind in Request.__annotations__.items()
        if name not in known and name in OPTIONS
    }
    return plain.replace(parameters=[known[name] for name in ("design", "out", *OPTIONS, "progress")])


export.__dict__["__signature__"] = _signature_of_export()
