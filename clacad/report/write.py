"""Write report.json and report.html, whole or not at all."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from clacad.export.atomic import write_file

if TYPE_CHECKING:
    from clacad.verify import Report

MARK = "<!-- clacad report -->"
"""In every page, so that a later run may replace its own report and nothing else."""


def write_report(
    report: Report, folder: str | os.PathLike[str], overwrite: bool = False
) -> tuple[Path, Path]:
    """Write the page and its numbers.

    Parameters
    ----------
    report : Report
    folder : path
        Made if missing.
    overwrite : bool
        Replace files of these names that are no reports, too.

    Returns
    -------
    (report.html, report.json) : paths

    Raises
    ------
    CannotWrite, ExportRefused
    """
    from clacad.report.page import page

    place = Path(folder)
    html, numbers = place / "report.html", place / "report.json"
    texts = ((numbers, report.to_json()), (html, page(report, MARK)))
    for path, text in texts:
        write_file(path, partial(_put, text=text), overwrite=overwrite or is_report(path))
    return html, numbers


def _put(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8", newline="\n")


def is_report(path: Path) -> bool:
    """Tell whether a file is a report written here."""
    try:
        with path.open(encoding="utf-8") as stream:
            head = stream.read(4096)
    except (OSError, UnicodeDecodeError):
        return False
    return MARK in head if path.suffix == ".html" else head.startswith("{\n") and '"checks"' in head
