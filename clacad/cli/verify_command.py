"""`clacad verify`: trace what was written, write the report, print the verdict."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from clacad.cli.console import Progress, say, show_json, show_text
from clacad.cli.design_commands import load_design
from clacad.cli.export_command import parse_cells

if TYPE_CHECKING:
    from clacad.verify import Report


def verify_design(
    path: Path, overrides: list[str], files: Path | None, out: Path | None, cells: str | None, rays: int, *,
    overwrite: bool, json: bool, quiet: bool, pdf: bool = False, timings: bool = False,
) -> int:  # fmt: skip
    """Judge a design and its files; the exit status comes from the same object as the page."""
    from clacad.cli.tables import checks_text
    from clacad.verify import verify

    design = load_design(path, overrides)
    progress = Progress(quiet=quiet)
    try:
        report = verify(design, files=files, cells=parse_cells(cells), rays=rays, progress=progress)
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
        show_text(report.verdict(), quiet=quiet)
    if out is not None and not quiet:
        say("report: " + ", ".join(str(p) for p in written))
    return report.exit_status


def _deviations(report: Report, out: Path, overwrite: bool) -> list[Path]:
    """Maps of how far each returned part is off, beside the report."""
    from clacad.verify.deviationmap import write_deviation

    found: list[Path] = []
    for file in report.files:
        mapped = None if file.mesh is None else file.mesh.facts.get("deviation")
        if mapped is not None:
            found += write_deviation(mapped, file.subject.name, out, overwrite=overwrite)
    return found
