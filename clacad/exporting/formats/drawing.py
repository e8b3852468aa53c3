"""Drawing for the workshop: sheets with views, dimensions and tables, as one DXF and one PDF."""

from __future__ import annotations

from typing import TYPE_CHECKING

from clacad.exporting.formats.format import BASE, FileKind, Forecast, Format

if TYPE_CHECKING:
    from clacad.exporting.manifest import FileRecord, Job
    from clacad.exporting.request import Request
    from clacad.exporting.tessellations import Meshes
    from clacad.sheet.window import Window
    from clacad.storage.worker import Worker

WORD = "drawing"
DRAWING_DXF, DRAWING_PDF = "drawing-dxf", "drawing-pdf"
"""Words of the files in manifests."""

SIZE = 400_000
"""Approximate bytes of DXF and PDF together; views are drawn with a fixed number of points."""

SECONDS = BASE + 2.5
"""Seconds for the views, dimensions and tables of any sheet, library loading included."""


def _write(job: Job) -> list[FileRecord]:
    """One DXF with all sheets, and one PDF."""
    from clacad.exporting.drawing.sheet_files import (
        check_drawing_dxf,
        check_drawing_pdf,
        write_drawing_dxf,
        write_drawing_pdf,
    )
    from clacad.exporting.drawing.sheet_layout import sheets
    from clacad.formats.study_file import study_of
    from clacad.sheet.feasibility import feasibility

    study = study_of(job.stage.folder, job.design.sha256)
    made = sheets(job.design, job.window, feasibility(job.window), job.request.paper, study)
    dxf, pdf = (job.stage.path(f"{job.stem}.drawing.{kind}") for kind in ("dxf", "pdf"))
    job.progress(f"write {dxf.name}", 0.0)
    written = write_drawing_dxf(made, dxf)
    check_drawing_dxf(dxf, written)
    job.progress(f"write {pdf.name}", 0.5)
    write_drawing_pdf(made, pdf)
    check_drawing_pdf(pdf, len(made))
    facts = {"paper": job.request.paper, "sheets": len(made), "tolerance_study": study is not None}
    return [
        job.record(dxf, DRAWING_DXF, facts=facts | {"dimensions": written}, checks=("dimensions",)),
        job.record(pdf, DRAWING_PDF, facts=facts, checks=("pages",)),
    ]


def _require(_window: Window, _asked: Request, _worker: Worker) -> None:
    """Require the packages that write DXF and PDF."""
    from clacad.exporting.drawing.sheet_files import require_drawing

    require_drawing()


def _forecast(_meshes: Meshes, _quads: int, _asked: Request) -> Forecast:
    return Forecast(WORD, SIZE, False, None, None, SECONDS, (150_000_000, 500_000_000))


FORMATS = (
    Format(
        WORD,
        "drawing",
        "views, dimensions, tables and tolerances, DXF and PDF; needs the extras dxf and pdf",
        _write,
        _forecast,
        lambda _sheet, _quads, _asked: SECONDS,
        _require,
        optical=False,
    ),
)

FILES = (FileKind(DRAWING_DXF, "other"), FileKind(DRAWING_PDF, "other"))
