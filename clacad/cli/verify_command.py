"""`clacad verify`: trace what was written, write the report, print the verdict."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from clacad.cli.announce_cost import forecast
from clacad.cli.console import Progress, say, show_json, show_text
from clacad.cli.design_commands import load_counted
from clacad.cli.export_command import parse_angle, parse_cells

if TYPE_CHECKING:
    from clacad.design import Design

if TYPE_CHECKING:
    from clacad.verification import Report


def verify_design(
    path: Path, overrides: list[str], files: Path | None, out: Path | None, cells: str | None, rays: int, *,
    overwrite: bool, json: bool, quiet: bool, pdf: bool = False, timings: bool = False, target: str | None = None,
    role: str | None = None,
) -> int:  # fmt: skip
    """Judge a design and its files; the exit status comes from the same object as the page.

    With a target its error chooses the number of rays, and every file is judged by it.
    """
    design = load_counted(path, overrides)
    from clacad.cli.tables import checks_text, verdicts_text
    from clacad.verification import verify
    from clacad.verification.files.find_files import declared_roles, find_files
    from clacad.verification.verification_cost import seconds, task

    roles = parse_roles(role)
    limit = None if target is None else parse_angle("--target", target)
    if limit is not None:
        rays = _rays(design, files, limit, parse_cells(cells))
    progress = Progress(quiet=quiet)
    try:
        judged = () if files is None else find_files(files, declared_roles(roles)).subjects
        with forecast(task(judged), seconds(rays, judged), quiet=quiet):
            report = verify(
                design, files=files, cells=parse_cells(cells), rays=rays, progress=progress, role=roles
            )
        if limit is not None:
            from clacad.verification.error_target import judged_by

            report = judged_by(report, limit)
        if out is not None:
            from clacad.report import write_report

            report = report.with_evidence(progress)
            written = write_report(
                report, out, overwrite=overwrite, progress=progress, pdf=pdf, timings=timings
            )
            written = (*written, *_deviations(report, out, overwrite))
    finally:
        progress.done()
    if json:
        show_json(report.to_dict())
    else:
        show_text(f"{design.name}\n{checks_text(report.checks)}", quiet=quiet)
        if report.verdicts:
            show_text(verdicts_text(report.verdicts), quiet=quiet)
        show_text(report.verdict(), quiet=quiet)
    if out is not None and not quiet:
        say("report: " + ", ".join(str(p) for p in written))
    return report.exit_status


def parse_roles(text: str | None) -> str | dict[str, str] | None:
    """Read one word for all files, or FORMAT=WORD,… (a file's name stands for a format, too).

    Raises
    ------
    UnknownRole
    """
    from clacad.exporting.request import assignments
    from clacad.verification.files.find_files import UnknownRole

    if text is None or "=" not in text:
        return text
    named = assignments(text)
    if named is None:
        raise UnknownRole(
            f"--role {text}: it is one word, or FORMAT=WORD,FORMAT=WORD with master, preview or scan"
        )
    return dict(named)


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
    from clacad.prescription.prescribe import prescribe
    from clacad.verification.accuracy.choose_setting import FACETED, floor_of, out_of_reach
    from clacad.verification.error_target import rays_for

    window = prescribe(design if cells is None else design.with_cells(cells))
    suffixes = {"stl": "stl", "3mf": "3mf", "ply": "ply", "glb": "glb", "obj": "ply"}
    if files is not None and files.is_file():
        format = suffixes.get(files.suffix.lower().lstrip("."), "")
        if format in FACETED:
            floor = floor_of(design, window, format)
            if not floor.floor < target:
                raise out_of_reach(design, window, target, format, floor)
    return rays_for(target, design.check.law_rms)
