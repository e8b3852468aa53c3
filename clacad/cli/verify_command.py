"""`clacad verify`: trace what was written, write the report, print the verdict."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from clacad.cli.announce_cost import forecast
from clacad.cli.console import Progress, say, show_json, show_text
from clacad.cli.design_commands import load_counted
from clacad.cli.option_values import parse_angle, parse_cells, per_format
from clacad.storage.atomic import require_folder

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.verification import Report
    from clacad.verification.files.find_files import Delivery


@dataclass(frozen=True, slots=True)
class VerifyRequest:
    """What to judge, by how many rays, and what to write of it."""

    files: Path | None
    out: Path | None
    cells: str | None
    rays: int
    overwrite: bool
    pdf: bool = False
    timings: bool = False
    target: str | None = None
    role: str | None = None


def verify_design(
    path: Path, overrides: list[str], request: VerifyRequest, *, json: bool, quiet: bool
) -> int:
    """Judge a design and its files; the exit status comes from the same object as the page.

    With a target its error chooses the number of rays, and every file is judged by it.
    """
    design = load_counted(path, overrides)
    progress = Progress(quiet=quiet)
    written: list[Path] = []
    try:
        delivery, rays = _asked(design, request)
        if request.out is not None:
            require_folder(request.out)
        with _announced(rays, delivery, request, progress, quiet=quiet):
            report = _judged(design, delivery, rays, request, progress, quiet=quiet)
            if request.out is not None:
                report = report.with_evidence(progress)
                written = _write(report, request.out, request, progress)
    finally:
        progress.done()
    _tell(report, design.name, json=json, quiet=quiet)
    if written and not quiet:
        say("report: " + ", ".join(str(p) for p in written))
    return report.exit_status


def _asked(design: Design, request: VerifyRequest) -> tuple[Delivery | None, int]:
    """What there is to judge, and by how many rays."""
    from clacad.verification.files.find_files import declared_roles, list_files

    roles = declared_roles(per_format("--role", request.role))
    delivery = None if request.files is None else list_files(request.files, roles)
    if request.target is None:
        return delivery, request.rays
    target = parse_angle("--target", request.target)
    return delivery, _rays(design, request.files, target, parse_cells(request.cells))


@contextmanager
def _announced(
    rays: int, delivery: Delivery | None, request: VerifyRequest, progress: Progress, *, quiet: bool
) -> Iterator[None]:
    """Say before the block what it will take, and note afterwards what it took."""
    from clacad.verification.verification_cost import seconds, task

    subjects, page = () if delivery is None else delivery.subjects, request.out is not None
    with forecast(task(subjects, page), seconds(rays, subjects, page), quiet=quiet) as span:
        progress.expect(span.middle)
        yield


def _judged(
    design: Design,
    delivery: Delivery | None,
    rays: int,
    request: VerifyRequest,
    progress: Progress,
    *,
    quiet: bool,
) -> Report:
    """The report: checks and verdicts, by the target where one is given; of the design alone it is said at once."""
    from clacad.verification.error_target import judged_by
    from clacad.verification.run import verified

    steps = verified(design, delivery, parse_cells(request.cells), rays, progress)
    report = next(steps)
    if delivery is not None:
        progress.say(f"the design itself {report.verdict()}; now its files")
    for whole in steps:
        report = whole
    return report if request.target is None else judged_by(report, parse_angle("--target", request.target))


def _write(report: Report, out: Path, request: VerifyRequest, progress: Progress) -> list[Path]:
    """Write page, numbers and maps of returned parts; their paths."""
    from clacad.report import write_report

    written = write_report(
        report, out, overwrite=request.overwrite, progress=progress, pdf=request.pdf, timings=request.timings
    )
    return [*written, *_deviations(report, out, request.overwrite)]


def _tell(report: Report, name: str, *, json: bool, quiet: bool) -> None:
    """Print checks, verdicts and the last word."""
    from clacad.cli.tables import checks_text, verdicts_text
    from clacad.verification.light.viewed_check import headline

    if json:
        show_json(report.to_dict())
    else:
        first = headline(report.checks)
        show_text(
            "\n".join([name, *([f"  {first}"] if first else []), checks_text(report.checks)]), quiet=quiet
        )
        if report.verdicts:
            show_text(verdicts_text(report.verdicts), quiet=quiet)
        show_text(report.verdict(), quiet=quiet)


def _deviations(report: Report, out: Path, overwrite: bool) -> list[Path]:
    """Maps of how far each returned part is off, beside the report."""
    from clacad.verification.returned.deviation_map import write_deviation

    found: list[Path] = []
    for file in report.files:
        mapped = None if file.mesh is None else file.mesh.facts.get("deviation")
        if mapped is not None:
            found += write_deviation(mapped, file.subject.name, out, overwrite=overwrite)
    return found


def _rays(design: Design, files: Path | None, target: float, cells: tuple[int, int] | None) -> int:
    """Rays for a target; refused at once where a file's format cannot hold it.

    Raises
    ------
    TargetOutOfReach
    """
    from clacad.exporting.formats.registry import kind_ending
    from clacad.prescription.prescribe import prescribe
    from clacad.verification.accuracy.choose_setting import floor_of, out_of_reach
    from clacad.verification.error_target import rays_for

    window = prescribe(design if cells is None else design.with_cells(cells))
    if files is not None and files.is_file():
        kind = kind_ending(files.suffix)
        if kind is not None and kind.family == "mesh":
            format = kind.like or kind.word
            floor = floor_of(design, window, format)
            if not floor.floor < target:
                raise out_of_reach(design, window, target, format, floor)
    return rays_for(target, design.check.law_rms)
