"""The whole verification of a design and of the files made from it; its cost, and a requested error.

The cost is in processor seconds, by a model of one reference machine; see `clacad.base.machine_rates`. A
requested direction error gives the rays that a verification needs, and a check of each file.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import ceil, log2
from pathlib import Path
from typing import TYPE_CHECKING

from clacad.base.interactive import shown_progress
from clacad.base.text import mrad_text
from clacad.base.types import Progress
from clacad.checks.check import Check, accepted
from clacad.checks.file_kinds import FAITHFUL_RMS, FILE_TARGET
from clacad.exporting.roles import Role
from clacad.prescription.prescribe import prescribe
from clacad.sheet.feasibility import Feasibility, feasibility
from clacad.sheet.window import Window
from clacad.tracing.worst_cell import worst_cell
from clacad.verification.design_rules import design_checks
from clacad.verification.light.law_checks import judge_light
from clacad.verification.light.through_window import Optics, meridians
from clacad.verification.light.viewed import name_remedies
from clacad.verification.verification_report import Report

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.judging.delivery import Delivery, Subject
    from clacad.judging.judge_files import FileReport
    from clacad.measuring.measure import Maps
    from clacad.measuring.measured import Measured


def verify(
    design: Design,
    files: str | os.PathLike[str] | None = None,
    cells: tuple[int, int] | None = None,
    rays: int = 65536,
    progress: Progress | None = None,
    role: str | Mapping[str, str] | None = None,
    as_made: bool = False,
) -> Report:
    """Judge a design, and files made from it: does light through them obey the requested law?

    Rays are traced through the exact surfaces and through the surfaces of each file; every check compares a
    measured number with its limit.

    Parameters
    ----------
    design : Design
        Gives the requested law and the limits.
    files : path or None
        A folder with a manifest, or one file: a mesh, a solid, or a map, points, a table, a mask or layers
        with an export's file name; None judges the design alone.
    cells : (a, b) or None
        Cells the files hold, where no manifest gives them.
    rays : int
        Rays of the main bundle.
    progress : callable or None
        Called with a stage's name and the fraction done, 0 … 1.
    role : "master", "preview", "scan", a mapping or None
        Purpose of the files: one word for all, or a mapping from formats ("stl") or file names to words.
        None: as in the manifest; a file without one is judged as a master.
    as_made : bool
        Whether light is also sent through the sheet as its process makes it (section [process]).

    Raises
    ------
    DesignError
        The design cannot be built.
    FileNotFoundError, CannotRegister, UnknownRole
        `files` contains no file to judge; unit or cells cannot be determined; a role is unknown, or of no
        file.

    Examples
    --------
    >>> import clacad
    >>> design = clacad.load("slab", ["lattice.count = [3, 3]"])
    >>> clacad.verify(design, rays=4096)
    slab
      pass  28 checks
    passed: 28 checks
    """
    delivery = None
    if files is not None:
        from clacad.judging.delivery import declared_roles, list_files

        delivery = list_files(Path(files), declared_roles(role))
    *_, found = verified(design, delivery, cells, rays, shown_progress(progress), as_made=as_made)
    return found


def verified(
    design: Design,
    delivery: Delivery | None,
    cells: tuple[int, int] | None,
    rays: int,
    progress: Progress,
    maps: Maps | None = None,
    as_made: bool = False,
) -> Iterator[Report]:
    """Yield the report of the design alone as soon as it is ready; then, if there are files, that with the
    files.

    design, cells, rays, progress, as_made : As in `verify`.
    delivery : From `list_files`.
    maps : Height maps of a measured part.
    Raises DesignError, CannotRegister, NotMeasurable.
    """
    if delivery is not None:
        from clacad.judging.delivery import with_copied_table, written_meanwhile

        design = with_copied_table(design, delivery)
    found = _judge_design(design, rays, progress)
    if as_made:
        from clacad.making.light_as_made import judge_as_made

        made = judge_as_made(design, found.window)
        found = replace(found, checks=(*found.checks, *made.checks), made=made)
    yield replace(found, checks=accepted(found.checks, design))
    if delivery is not None:
        found = _with_files(found, delivery, cells, rays, progress)
        found = replace(found, checks=(*found.checks, *written_meanwhile(delivery)))
        yield replace(found, checks=accepted(found.checks, design))
    if maps is not None:
        part = maps.measured(design, progress)
        found = replace(found, checks=(*found.checks, *part.checks), measured=part, delivered=True)
        yield replace(found, checks=accepted(found.checks, design))
    progress("done", 1.0)


def _judge_design(design: Design, rays: int, progress: Progress) -> Report:
    """Report of a design without files, before its warnings are accepted."""
    progress("building the window", 0.0)
    window = prescribe(design)
    facts = feasibility(window, *design.viewing_places)
    progress("tracing the exact surfaces", 0.0)
    checks, optics = judge_window(design, window, facts, rays)
    progress("tracing the field of view", 0.0)
    seen = worst_cell(window, design.check.field)
    curves = meridians(seen.like, seen.send)
    return Report(design, window, facts, tuple(checks), optics, curves, versions=versions())


def _with_files(
    report: Report, delivery: Delivery, cells: tuple[int, int] | None, rays: int, progress: Progress
) -> Report:
    """Report with the results of the files added; only files need the modules that read and cut them."""
    from clacad.judging.judge_files import THROUGH, judge_files
    from clacad.verification.light.facet_convergence import judge_convergence

    checks, files = judge_files(report.design, report.window, delivery, cells, rays, progress)
    part = _measured_scan(report.design, files)
    convergence = None
    if part is not None:
        checks = [*(check for check in checks if check.kind not in THROUGH), *part.checks]
    elif any(f.subject.is_mesh for f in files):
        convergence, check = judge_convergence(report.design, report.window, progress)
        checks = [*checks, check]
    judged = tuple(f if f.mesh is None else replace(f, mesh=f.mesh.without_part()) for f in files)
    found = replace(report, checks=(*report.checks, *checks), convergence=convergence, files=judged)
    return replace(found, delivered=True, measured=part)


def _measured_scan(design: Design, judged: Sequence[FileReport]) -> Measured | None:
    """The lenslets of a part by the one mesh of a scan, as by its maps; None where they cannot be fitted."""
    if len(judged) != 1 or judged[0].mesh is None or judged[0].judged_as is not Role.SCAN:
        return None
    placed = judged[0].mesh.facts.get("part")
    if placed is None:
        return None
    from clacad.measuring.measure import measure_mesh
    from clacad.storage.errors import NotPossible, UnreadableFile

    try:
        mesh, name = placed.file or placed.mesh, judged[0].subject.name
        return measure_mesh(design, placed.window, name, mesh, placed.pose)
    except (UnreadableFile, NotPossible):
        return None


def judge_window(design: Design, window: Window, facts: Feasibility, rays: int) -> tuple[list[Check], Optics]:
    """Judge a window by the requirements of its design: light through the exact surfaces, and the design
    rules.

    The window need not be built from that design; its law is measured, not assumed.
    """
    found, optics = judge_light(design, window, rays)
    return name_remedies([*found, *design_checks(design, window, facts)], design, window), optics


def versions() -> dict[str, str]:
    """Versions the numbers depend on."""
    import numpy as np

    from clacad import __version__

    return {"clacad": __version__, "numpy": np.__version__}


DESIGN, CONVERGENCE, MESH, SOLID, REPORT = 0.5, 2.0, 0.8, 3.0, 4.0
"""Seconds without what depends on size: a design, the convergence study, a mesh, a solid, a report."""

PER_RAY, PER_FACET, PER_LIT, PER_BYTE = 4.8e-6, 1.1e-6, 8e-6, 1e-6
"""Seconds per ray of the main bundle, facet in a file, facet of the lit cells, and byte of a solid's text."""

FOUND, PER_FOUND = 0.2, 1.5e-6
"""Seconds to register a part without a manifest, and per facet; measured with 2,500 and 334,000 facets."""

MOST_LIT = 500_000
"""Facets of one cell up to which the time to light it increases."""


def seconds(rays: int, files: Sequence[Subject], report: bool = False) -> float:
    """Processor seconds of verifying a design with `rays` rays, and some files.

    files : Meshes cost their triangles, and one convergence study together; those without a manifest entry
        also cost registration; solids cost their text.
    report : Whether a report is written.
    """
    meshes = [subject for subject in files if subject.is_mesh]
    solids = [subject for subject in files if subject.is_solid]
    triangles = sum(MESH + PER_FACET * _facets(subject) + PER_LIT * _lit(subject) for subject in meshes)
    triangles += sum(FOUND + PER_FOUND * _facets(subject) for subject in meshes if _returned(subject))
    text = sum(SOLID + PER_BYTE * subject.bytes for subject in solids)
    once = DESIGN + PER_RAY * rays + (CONVERGENCE if meshes else 0.0) + (REPORT if report else 0.0)
    return once + triangles + text


def task(files: Sequence[Subject], report: bool = False) -> str:
    """Name under which the time of such a verification is recorded."""
    kinds = [
        name
        for name, is_one in (("mesh", "is_mesh"), ("step", "is_solid"))
        if any(getattr(s, is_one) for s in files)
    ]
    returned = ["returned"] if any(s.is_mesh and _returned(s) for s in files) else []
    return " ".join(["verify", *kinds, *returned, *(["report"] if report else [])])


def _returned(subject: Subject) -> bool:
    """Whether no manifest lists a file, so that its pose is unknown."""
    return not subject.entry


def _lit(subject: Subject) -> float:
    """Approximate facets of one cell, where its manifest gives the quads per side."""
    quads = subject.entry.get("quads")
    return min(8.0 * quads * quads, MOST_LIT) if isinstance(quads, int) else 0.0


def _facets(subject: Subject) -> float:
    """Facets that are examined: those stored in the file, each once regardless of its instances."""
    for key in ("triangles_stored", "triangles"):
        stated = subject.entry.get(key)
        if isinstance(stated, (int, float)) and stated > 0:
            return float(stated)
    return subject.bytes / (50.0 if subject.kind is None else subject.kind.bytes_a_facet)


FEWEST, MOST = 1 << 14, 1 << 20
"""Fewest and most rays; with fewer, too few rays pass a file's triangles for the fits."""
SURE = 10.0
"""Least ratio of the target to the standard error of the mean."""


def rays_for(target: float, spread: float) -> int:
    """Fewest rays, a power of two, whose mean has a standard error of a tenth of a target.

    target : radians. Rms direction error that matters.
    spread : radians
        Rms error of a single ray; the mean of n has a standard error of spread/√n (less with Sobol points).
    """
    needed = (SURE * spread / target) ** 2
    if needed >= MOST:
        return MOST
    return max(FEWEST, 1 << ceil(log2(max(1.0, needed))))


def judged_by(report: Report, target: float) -> Report:
    """Add checks whether light through each file is within a target (radians) of the exact surfaces."""
    return replace(report, checks=(*report.checks, *target_checks(report.checks, target)))


def target_checks(checks: Sequence[Check], target: float) -> list[Check]:
    """One check for each file whose light was measured."""
    found = []
    for check in checks:
        if check.kind is not FAITHFUL_RMS:
            continue
        if not isinstance(check.value, float):
            found.append(replace(check, id=FILE_TARGET.id, limit=target, detail={}))
            continue
        within = "within" if check.value <= target else "not within"
        text = (
            f"light through it is {mrad_text(check.value)} rms off the exact surfaces, {within} the "
            f"{mrad_text(target)} requested"
        )
        found.append(
            FILE_TARGET.judge(
                check.value, target, text, bundle=check.bundle, where=check.where, subject=check.subject
            )
        )
    return found
