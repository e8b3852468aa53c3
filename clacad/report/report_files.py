"""Write report.json, report.html, run.json and, on request, report.pdf: each whole or not at all."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.base.regular_file import read_regular
from clacad.storage.atomic import RUN_FACTS, write_set

if TYPE_CHECKING:
    from clacad.base.types import Progress
    from clacad.report.content import Content
    from clacad.report.page import Section
    from clacad.verification import Report

MARK = "<!-- clacad report -->"
"""In every page, so that a later run may replace its own report and nothing else."""

RUN_MARK = "run facts of a clacad report"
PDF_MARK = b"%PDF"

LARGEST = 64 << 20
"""Bytes beyond which no file is a report of ours."""


def write_report(
    report: Report | Content, folder: str | os.PathLike[str], overwrite: bool = False, *, progress: Progress | None = None,
    more: Sequence[Section] = (), pdf: bool = False, timings: bool = False,
) -> tuple[Path, ...]:  # fmt: skip
    """Write the page and its numbers.

    Parameters
    ----------
    report : Report, or Content made from one
        What is measured and pictured for the page alone is done here unless it was done before.
    folder : path
        Made if missing.
    overwrite : bool
        Replace files of these names that are no reports, too.
    progress : callable or None
        Called with a stage's name and the part done, 0 … 1.
    more : sequence of Section
        Further sections of the page, after its own.
    pdf : bool
        Write report.pdf as well.
    timings : bool
        Show seconds of this run in page and numbers; they go to run.json anyway. A Content has its own setting.

    Returns
    -------
    (report.html, report.json[, report.pdf]) : paths

    Raises
    ------
    CannotWrite, ExportRefused
    PdfMissing
        The extra package that sets the PDF is not installed.
    """
    from clacad.base.types import silent

    if pdf:
        from clacad.report.pdf import typesetter

        typesetter()  # reported before the work, not after it
    return _write_all(report, Path(folder), overwrite, progress or silent, more, pdf=pdf, timings=timings)


def _write_all(
    report: Report | Content, folder: Path, overwrite: bool, tell: Progress, more: Sequence[Section], *, pdf: bool,
    timings: bool,
) -> tuple[Path, ...]:  # fmt: skip
    """Gather what is shown, write page, numbers, PDF and run facts; paths of all but the last."""
    from clacad.report import content as contents
    from clacad.report.page import page

    began = time.monotonic()
    made = report if isinstance(report, contents.Content) else contents.content(report, tell, timings)
    html, numbers = folder / "report.html", folder / "report.json"
    written = [html, numbers]
    files: dict[str, str | bytes] = {
        numbers.name: _json(contents.numbers(made)), html.name: page(made, MARK, more, tell),
    }  # fmt: skip
    if pdf:
        from clacad.report.pdf import pdf_bytes

        tell("setting the PDF", 0.0)
        written.append(folder / "report.pdf")
        files["report.pdf"] = pdf_bytes(made)
    if not (folder / RUN_FACTS).exists() or is_report(
        folder / RUN_FACTS
    ):  # run facts of an export there are left alone
        facts = {"what": RUN_MARK, "seconds": round(time.monotonic() - began, 3)}
        files[RUN_FACTS] = _json(facts | {"accuracy": made.evidence.ladder.measured()})
    write_set(folder, files, overwrite=overwrite, replace=is_report)
    return tuple(written)


def _json(numbers: dict[str, Any]) -> str:
    return json.dumps(numbers, indent=1, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n"


def is_report(path: Path) -> bool:
    """Whether a file is one that was written here."""
    if path.suffix == ".pdf":
        try:
            data = read_regular(path, LARGEST)
        except OSError:
            return False
        return data.startswith(PDF_MARK) and b"clacad report" in data
    try:
        text = read_regular(path, LARGEST).decode()
    except (OSError, UnicodeDecodeError):
        return False
    if path.name == RUN_FACTS:
        return RUN_MARK in text
    if path.suffix == ".html":
        return MARK in text[:4096]
    return text.startswith("{\n") and all(f'"{key}"' in text for key in ("checks", "verdict", "sha256"))
