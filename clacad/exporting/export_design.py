"""Export of a design's files: one atomic writer for all formats; every file is read back before
publication.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from clacad.exporting.request import DEFAULTS
from clacad.storage.errors import (
    BadRequest,
    CannotWrite,
    ExportError,
    ExportIncomplete,
    ExportRefused,
    FileDisagrees,
    LimitRefused,
    UnknownFormat,
    UnreadableFile,
    WorkerDied,
)

if TYPE_CHECKING:
    from clacad.base.types import Progress
    from clacad.design import Design
    from clacad.exporting.manifest import Manifest
    from clacad.exporting.request import AskedQuads, AskedRole

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
    slope_error: float | Literal["auto"] = "auto",
    quads: AskedQuads = None,
    step: Literal["auto", "fused", "instanced"] = "auto",
    cells: tuple[int, int] | None = None,
    overwrite: bool = False,
    force: bool = False,
    progress: Progress | None = None,
    step_schema: Literal["ap242", "ap214"] = "ap242",
    pcurves: bool = True,
    saddle_bevel: float = 0.0,
    gpu_instancing: bool = False,
    grey_levels: int = 64,
    role: AskedRole = None,
    paper: Literal["a4", "a3", "a2"] = "a3",
    fused: bool = False,
) -> Manifest:
    """Write a design's files into a folder. Each is read back and compared before all are published together.

    Parameters
    ----------
    design : Design
    out : path
        Folder; made if missing. Nothing is written outside it.
    formats, slope_error, quads, step, …, paper, fused
        The options of `clacad.exporting.request.Request`, one by one.
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
    """
    from clacad.exporting.quads_and_roles import asked_quads, asked_roles
    from clacad.exporting.request import Request
    from clacad.exporting.run import run_export

    request = Request(
        formats=tuple(formats),
        slope_error=slope_error,
        quads=asked_quads(quads, formats),
        step=step,
        cells=cells,
        overwrite=overwrite,
        force=force,
        step_schema=step_schema,
        pcurves=pcurves,
        saddle_bevel=saddle_bevel,
        gpu_instancing=gpu_instancing,
        grey_levels=grey_levels,
        role=asked_roles(role, formats),
        paper=paper,
        fused=fused,
    )
    return run_export(design, os.fspath(out), request, progress)
