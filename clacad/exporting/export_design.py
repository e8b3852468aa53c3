"""Writing files: one format a module, one atomic writer for all of them, nothing published unread."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

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
    "BadRequest", "CannotWrite", "ExportError", "ExportIncomplete", "ExportRefused", "FileDisagrees", "LimitRefused",
    "UnknownFormat", "UnreadableFile", "WorkerDied", "export",
]  # fmt: skip


def export(
    design: Design,
    out: str | os.PathLike[str],
    formats: Sequence[str] = ("step", "stl"),
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
) -> Manifest:
    """Write a design's files into a folder: all at once, each read back and compared with the design first.

    Parameters
    ----------
    design : Design
    out : path
        Folder; made if missing. Nothing is written outside it.
    formats : sequence of str
        step, stl, stl-parts (one file a body), 3mf, ply, glb, sag, tiff, png, xyz, table, mask, gds (needs the extra
        `gds`), pov, brep, baffle, frame, coupon, marked (bodies with their name and an arrow in the border, STEP),
        marked-stl (the same as meshes, one file a body), marked-3mf (in one file).
    slope_error : float or "auto"
        Wanted rms angle between facets and surface, radians; "auto" is the finest of 4, 8, 16, 32, 64 quads a
        cell side whose STL stays within 2 GB and 50 M facets. Files declared previews are left out.
    quads : int, "auto", mapping or None
        Facet grid a cell side, of all mesh files or, as {"3mf": "auto", "stl": 4}, of each format; overrides
        `slope_error`. "auto" is the smallest power of two from 4 to 1024 through which light is forecast to meet the
        design's limits (within 95 %), if such a file stays within the limits of facets and bytes; else the finest
        that does. Formats that repeat one cell (3MF, GLB) are held to the limits by the one they store.
    step : "auto", "fused" or "instanced"
        auto is fused up to 2,500 cells.
    cells : (a, b) or None
        The same design with another count, centred.
    overwrite : bool
        Replace files that no export of ours owns.
    force : bool
        Pass the limits on facets, bytes and memory.
    progress : callable or None
        Called with a stage's name and the share done.
    step_schema : "ap242" or "ap214"
        Application protocol of STEP files.
    pcurves : bool
        Whether fused STEP files hold the exact parameter curves; without them they are smaller and readers
        recompute the curves.
    saddle_bevel : float, length
        Meshes: width of the bevels that give columns which touch at a saddle real contact; 0: none, the columns
        touch and the surface is exact. STEP is exact always.
    gpu_instancing : bool
        GLB: one node for all cells of a body (EXT_mesh_gpu_instancing) instead of one each.
    grey_levels : int
        GDSII: number of layers from the lowest to the highest point of a face.
    role : "master", "preview", mapping or None
        What the files are for, all of them or, as {"stl": "preview"}, of each format. Not declared: a mesh is a
        master where the light through it is forecast within the design's limits, else a preview (4 quads a cell side
        where nothing else is said of one that is declared); everything else with optics is a master.

    Returns
    -------
    Manifest

    Raises
    ------
    BadRequest
        Quads or roles that cannot be understood, or for a format that is not exported.
    DesignError
        The design cannot be built.
    LimitRefused
        The work would pass a limit; nothing was written.
    ExportRefused, CannotWrite
        The folder cannot be written to, or holds a file that is not ours; nothing was changed.
    ExportIncomplete
        Some formats failed; the others were published.
    FileDisagrees, WorkerDied
        The only format asked for failed so; nothing was published.
    """
    from clacad.exporting.request import Request, asked_quads, asked_roles
    from clacad.exporting.run import run_export

    request = Request(
        formats=tuple(formats), slope_error=slope_error, quads=asked_quads(quads, formats), step=step, cells=cells,
        overwrite=overwrite, force=force, step_schema=step_schema, pcurves=pcurves, saddle_bevel=saddle_bevel,
        gpu_instancing=gpu_instancing, grey_levels=grey_levels, role=asked_roles(role, formats),
    )  # fmt: skip
    return run_export(design, os.fspath(out), request, progress)
