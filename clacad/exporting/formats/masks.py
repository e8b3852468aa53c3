"""Masks of structured faces: outlines and places of the lenses (SVG, DXF), and layers of grey levels
(GDSII).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from clacad.base.units import millimetres
from clacad.exporting.formats.format import (
    BASE,
    Forecast,
    Format,
    calibration_record,
    drawn_cost,
    map_kind,
    map_row,
    own_cells_note,
)
from clacad.exporting.roles import LAYERS

if TYPE_CHECKING:
    from clacad.exporting.manifest import FileRecord, Job
    from clacad.exporting.request import Request
    from clacad.exporting.tessellations import Meshes
    from clacad.sheet.window import Window
    from clacad.storage.worker import Worker

MASK, GDS = "mask", "gds"
MASK_SVG, MASK_DXF = "mask-svg", "mask-dxf"
"""Words of the files in manifests."""

MASK_SECONDS, GDS_SECONDS = 8.5e-8, 4e-7
"""Seconds per hundredth of a lenslet, and per box of one cell."""

OWN_SECONDS = 7e-9
"""Seconds per byte of GDSII for a non-uniform sheet: every box made twice, written and compared."""


# -- writing ---------------------------------------------------------------------------------------


def _write_mask(job: Job) -> list[FileRecord]:
    """Two masks a structured face, SVG and DXF."""
    from clacad.formats.maps.mask import check_mask, masked_faces, write_dxf, write_svg

    records = []
    for body, face, label in masked_faces(job.window):
        svg, dxf = (job.stage.path(f"{job.stem}.{label}.mask.{end}") for end in ("svg", "dxf"))
        write_svg(job.window, body, face, label, svg, job.scale)
        write_dxf(job.window, body, face, label, dxf, job.scale)
        check_mask(job.window, face, svg, dxf, job.scale)
        records += [
            job.record(path, kind, bodies=[body.name]) for path, kind in ((svg, MASK_SVG), (dxf, MASK_DXF))
        ]
    return records


def _write_gds(job: Job) -> list[FileRecord]:
    """One GDSII file a structured face, and one calibration file for them all."""
    from clacad.formats.maps.gds import check_gds, grey_cell, write_gds
    from clacad.formats.maps.sag import structured_faces

    records, calibration = [], {}
    for body, face, label in structured_faces(job.window):
        cell = grey_cell(job.window, body, face, label, job.request.grey_levels, job.scale)
        path = job.stage.path(f"{job.stem}.{label}.gds")
        job.progress(f"write {path.name}", 0.0)
        placed, counts = write_gds(cell, path, job.scale)
        calibration[label] = cell.calibration(job.scale, counts)
        check_gds(cell, path, job.scale)
        facts = {"mode": "fused" if cell.own else "instanced", "grey_levels": cell.levels, "lenslets": placed}
        records.append(job.record(path, GDS, unit="um", bodies=[body.name], facts=facts))
    return [*records, calibration_record(job, GDS, calibration)]


# -- requirements ----------------------------------------------------------------------------------


def _require_mask(window: Window, _asked: Request, _worker: Worker) -> None:
    """Require one outline for the lenses of a face."""
    from clacad.formats.maps.mask import aperture, masked_faces

    if not window.uniform:
        for body, face, _ in masked_faces(window):
            aperture(window, body, face)


def _require_gds(window: Window, asked: Request, _worker: Worker) -> None:
    """Require the package that writes GDSII, and levels that its layers distinguish."""
    from clacad.formats.maps.gds import grey_cell, require_gdstk
    from clacad.formats.maps.sag import structured_faces

    require_gdstk()
    for body, face, label in structured_faces(window):
        grey_cell(window, body, face, label, asked.grey_levels, millimetres(window.unit))


# -- cost ------------------------------------------------------------------------------------------


def _forecast_mask(meshes: Meshes, _quads: int, _asked: Request) -> Forecast:
    from clacad.formats.maps.mask import masked_faces

    window = meshes.window
    drawn = 100 * window.lattice.cell_count * len(masked_faces(window))
    return map_row(MASK, _mask_bytes(window), BASE + MASK_SECONDS * drawn)


def _mask_bytes(window: Window) -> int:
    """Size of the SVG and DXF masks: outlines as they are, cells by their first row."""
    from clacad.formats.maps.mask import aperture, masked_faces
    from clacad.sheet.face_order import array_at

    total = 0.0
    scale = millimetres(window.unit)
    for body, face, _ in masked_faces(window):
        outline = (aperture(window, body, face) * scale + 0.0).tolist()
        total += sum(len(f"{x!r}{y!r}") for x, y in outline) * 2 + 40 * len(outline) + 1400
        row = window.lattice.row(window.lattice.count[1] // 2)
        centres = (window.centres(array_at(window, face), row) * scale).tolist()
        digits = sum(len(f"{x!r}{y!r}") for x, y in centres) / max(1, len(centres))
        total += window.lattice.cell_count * (2 * digits + 34 + 36)
    return int(total)


def _forecast_gds(meshes: Meshes, _quads: int, asked: Request) -> Forecast:
    """Forecast the layers; those of a non-uniform sheet are written, and compared, as a stream."""
    from clacad.formats.maps.gds import gds_bytes
    from clacad.formats.maps.sag import structured_faces

    window = meshes.window
    size = gds_bytes(window, asked.grey_levels, millimetres(window.unit))
    seconds = BASE + GDS_SECONDS * (len(structured_faces(window)) * 64 * 64)
    if window.uniform:
        return map_row(GDS, size, seconds)
    return map_row(GDS, size, seconds + OWN_SECONDS * size, note=own_cells_note(window))


FORMATS = (
    Format(
        MASK,
        "map",
        "outline of the lenses and their places, SVG and DXF",
        _write_mask,
        _forecast_mask,
        drawn_cost(MASK_SECONDS),
        _require_mask,
    ),
    Format(
        GDS,
        "map",
        "grey-level lithography: layers of each face; needs the extra gds",
        _write_gds,
        _forecast_gds,
        drawn_cost(GDS_SECONDS),
        _require_gds,
        turned_arrays=False,
        stored=(LAYERS,),
    ),
)

FILES = (map_kind(MASK_SVG, ".mask.svg"), map_kind(MASK_DXF, ".mask.dxf"), map_kind(GDS, ".gds", native=True))
