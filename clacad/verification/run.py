"""The whole verification of a design and of the files made from it."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from clacad.base.types import Progress, silent
from clacad.checks.allowances import accepted
from clacad.checks.check import Check
from clacad.judging.delivery import Delivery, declared_roles, list_files, with_copied_table, written_meanwhile
from clacad.judging.judge_files import judge_files
from clacad.prescription.prescribe import prescribe
from clacad.sheet.feasibility import Feasibility, feasibility
from clacad.sheet.window import Window
from clacad.tracing.worst_cell import worst_cell
from clacad.verification.design.design_rules import design_checks
from clacad.verification.light.facet_convergence import Convergence, converge, convergence_check, meridians
from clacad.verification.light.law_checks import Optics
from clacad.verification.light.through_window import judge_light
from clacad.verification.verification_report import Report
from clacad.verification.viewed_remedies import name_remedies

if TYPE_CHECKING:
    from clacad.design import Design


def verify(
    design: Design,
    files: str | os.PathLike[str] | None = None,
    cells: tuple[int, int] | None = None,
    rays: int = 65536,
    progress: Progress | None = None,
    role: str | Mapping[str, str] | None = None,
) -> Report:
    """Verify a design, and the files that were made from it.

    Parameters
    ----------
    design : Design
        Gives the requested law and the limits.
    files : path or None
        A folder with a manifest, or one file: a mesh, a solid, or a map, points, a table, a mask or layers
        with an
        export's file name; None judges the design alone.
    cells : (a, b) or None
        Cells the files hold, where no manifest gives them.
    rays : int
        Rays of the main bundle.
    progress : callable or None
        Called with a stage's name and the fraction done, 0 … 1.
    role : "master", "preview", "scan", a mapping or None
        Purpose of the files: one word for all, or a mapping from formats ("stl") or file names to words.
        None: as in
        the manifest; a file without one is judged as a master.

    Raises
    ------
    DesignError
        The design cannot be built.
    FileNotFoundError, CannotRegister, UnknownRole
        `files` contains no file to judge; unit or cells cannot be determined; a role is unknown, or of no
        file.
    """
    delivery = None if files is None else list_files(Path(files), declared_roles(role))
    *_, found = verified(design, delivery, cells, rays, progress or silent)
    return found


def verified(
    design: Design, delivery: Delivery | None, cells: tuple[int, int] | None, rays: int, progress: Progress
) -> Iterator[Report]:
    """Yield the report of the design alone as soon as it is ready; then, if there are files, that with the
    files.

    Parameters
    ----------
    design, cells, rays, progress
        As in `verify`.
    delivery : Delivery or None
        From `list_files`.

    Raises
    ------
    DesignError, CannotRegister
    """
    design = with_copied_table(design, delivery)
    found = _judge_design(design, rays, progress)
    yield replace(found, checks=accepted(found.checks, design))
    if delivery is not None:
        found = _with_files(found, delivery, cells, rays, progress)
        found = replace(found, checks=(*found.checks, *written_meanwhile(delivery)))
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
    """Report with the results of the files added."""
    checks, judged = judge_files(report.design, delivery, cells, rays, progress)
    convergence = None
    if any(f.subject.is_mesh for f in judged):
        convergence, check = _convergence(report.design, report.window, progress)
        checks = [*checks, check]
    return replace(
        report, checks=(*report.checks, *checks), convergence=convergence, files=tuple(judged), delivered=True
    )


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


def _convergence(design: Design, window: Window, progress: Progress) -> tuple[Convergence | None, Check]:
    try:
        found = converge(design, window, progress)
    except ValueError as error:  # too little light passes one telescopelet to fit a law
        return None, convergence_check(None, str(error))
    return found, convergence_check(found)
