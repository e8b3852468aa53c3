"""Heights of single faces: maps of pixels (TIFF, PNG), the sag grid of a cell, points with normals.

Tables of the surfaces (JSON) and of the poses of all lenslets (CSV).

Masks of structured faces: outlines and places of the lenses (SVG, DXF), and layers of grey levels
(GDSII).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

from clacad.base.units import millimetres
from clacad.exporting.formats.format import (
    BASE,
    CALIBRATION,
    FileKind,
    Forecast,
    Format,
    calibration_record,
    drawn_cost,
    map_kind,
    map_row,
    own_cells_note,
    structured_cost,
    structured_count,
)
from clacad.exporting.roles import ABOVE_FACE, AT_POINTS, LAYERS, OWN_NUMBERS, SIXTEEN_BITS

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
    from clacad.storage.reading import Overheard

    records, calibration = [], {}
    for body, face, label in structured_faces(job.window):
        cell = grey_cell(job.window, body, face, label, job.request.grey_levels, job.scale)
        path = job.stage.path(f"{job.stem}.{label}.gds")
        job.progress(f"write {path.name}", 0.0)
        placed, counts, written = write_gds(cell, path, job.scale)
        calibration[label] = cell.calibration(job.scale, counts)
        heard = Overheard(path)
        check_gds(cell, path, job.scale, written, heard.hexdigest())
        facts = {"mode": "fused" if cell.own else "instanced", "grey_levels": cell.levels, "lenslets": placed}
        records.append(job.record(path, GDS, unit="um", bodies=[body.name], facts=facts, heard=heard))
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

    window = meshes.window
    size = gds_bytes(window, asked.grey_levels, millimetres(window.unit))
    seconds = BASE + GDS_SECONDS * (structured_count(window) * 64 * 64)
    if window.uniform:
        return map_row(GDS, size, seconds)
    return map_row(GDS, size, seconds + OWN_SECONDS * size, note=own_cells_note(window))


SAG, TIFF, PNG, XYZ, TABLE = "sag", "tiff", "png", "xyz", "table"
TIFF32, TIFF16, PNG16, GRID, POINTS = "tiff32", "tiff16", "png16", "grid-sag", "xyz-normals"
SURFACES, POSES = "surface-table", "pose-table"
"""Words of the files in manifests."""

CELL_TABLE = "cell-table"
"""Word of the copy of a design's cell table."""

TIFF_SECONDS, PNG_SECONDS, XYZ_SECONDS = 4.4e-7, 2.2e-7, 1.3e-6
"""Seconds per pixel or point."""

TABLE_SECONDS = 4e-8
"""Seconds per hundredth of a lenslet."""


# -- writing ---------------------------------------------------------------------------------------


def _maps(word: str, kinds: Mapping[str, str], job: Job) -> list[FileRecord]:
    """Write every structured face as each kind of raster, and one calibration file for them all."""
    from clacad.formats.maps.sag import check_map, height_maps, write_map

    records, calibration = [], {}
    for map_ in height_maps(job.window):
        label = map_.label
        calibration[label] = map_.calibration(job.scale)
        for kind, suffix in kinds.items():
            path = job.stage.path(f"{job.stem}.{label}.{suffix}")
            job.progress(f"write {path.name}", 0.0)
            write_map(map_, path, kind, job.scale)
            check_map(map_, path, kind, job.scale)
            facts = {"float": "f32"} if kind == TIFF32 else {}
            records.append(job.record(path, kind, bodies=[map_.body.name], facts=facts))
    return [*records, calibration_record(job, word, calibration)]


def _write_sag(job: Job) -> list[FileRecord]:
    from clacad.formats.maps.sag import check_grid_sag, structured_faces, write_grid_sag

    records = []
    for body, face, label in structured_faces(job.window):
        path = job.stage.path(f"{job.stem}.{label}.cell.dat")
        write_grid_sag(job.window, face, 64, path, job.scale)
        check_grid_sag(face, path, job.scale)
        records.append(job.record(path, GRID, bodies=[body.name], facts={"mode": "cell"}))
    return records


def _write_xyz(job: Job) -> list[FileRecord]:
    """Write points with normals of each face."""
    from clacad.formats.maps.sag import check_points, structured_faces, write_points

    records = []
    per_cell = _points_a_cell(job.window)
    for body, face, label in structured_faces(job.window):
        path = job.stage.path(f"{job.stem}.{label}.xyz")
        job.progress(f"write {path.name}", 0.0)
        count = write_points(job.window, body, face, per_cell, path, job.scale)
        check_points(job.window, face, path, job.scale, count)
        records.append(job.record(path, POINTS, bodies=[body.name], facts={"points": count}))
    return records


def _write_table(job: Job) -> list[FileRecord]:
    from clacad.formats.maps.pose_table import check_table, write_table_csv, write_table_json

    surfaces, poses = job.stage.path(f"{job.stem}.surfaces.json"), job.stage.path(f"{job.stem}.poses.csv")
    write_table_json(job.window, surfaces, job.scale)
    count = write_table_csv(job.window, poses, job.scale)
    check_table(job.window, surfaces, poses, job.scale, count)
    return [job.record(surfaces, SURFACES), job.record(poses, POSES, facts={"lenslets": count})]


# -- cost ------------------------------------------------------------------------------------------


def _points_a_cell(window: Window) -> int:
    from clacad.formats.maps.sag import samples_per_cell

    return min(16, samples_per_cell(window))


def _points(window: Window, per_cell: int) -> int:
    """Pixels or points of all faces."""
    return per_cell * per_cell * window.lattice.cell_count * structured_count(window)


def _forecast_sag(meshes: Meshes, _quads: int, _asked: Request) -> Forecast:
    """Forecast the sag grids: 65 x 65 lines of 70 bytes a face."""
    faces = structured_count(meshes.window)
    return map_row(SAG, faces * 70 * 65 * 65, structured_cost(faces))


def _forecast_tiff(meshes: Meshes, _quads: int, _asked: Request) -> Forecast:
    """Forecast both TIFF files of each face: six bytes a pixel."""
    from clacad.formats.maps.sag import samples_per_cell

    pixels = _points(meshes.window, samples_per_cell(meshes.window))
    return map_row(TIFF, 6 * pixels, BASE + TIFF_SECONDS * pixels)


def _forecast_png(meshes: Meshes, _quads: int, _asked: Request) -> Forecast:
    from clacad.formats.maps.sag import samples_per_cell

    pixels = _points(meshes.window, samples_per_cell(meshes.window))
    return map_row(PNG, _png_bytes(meshes.window), BASE + PNG_SECONDS * pixels)


def _forecast_xyz(meshes: Meshes, _quads: int, _asked: Request) -> Forecast:
    per_cell = _points_a_cell(meshes.window)
    points = _points(meshes.window, per_cell)
    return map_row(XYZ, _xyz_bytes(meshes.window, per_cell), BASE + XYZ_SECONDS * points)


def _png_bytes(window: Window) -> int:
    """Size of the PNG files: one row of cells of each map, deflated."""
    import zlib
    from dataclasses import replace

    from clacad.formats.maps.sag import height_maps, map_levels, samples_per_cell

    total = 0.0
    for map_ in height_maps(window):
        rows = min(
            map_.height, 8 * samples_per_cell(window)
        )  # rows of cells repeat: what deflate learns in a few, it knows
        # in a non-uniform sheet nothing repeats, and the first rows are representative
        strip = replace(map_, height=rows)
        packer = zlib.compressobj(6)
        size = sum(
            len(packer.compress(map_levels(strip, block).astype(">u2").tobytes())) for block in strip.blocks()
        )
        total += (size + len(packer.flush())) * map_.height / rows + 200
    return int(total) + 600 * structured_count(window)


def _xyz_bytes(window: Window, per_cell: int) -> int:
    """Size of the point files: the text of one cell of each face, times the number of cells."""
    from clacad.formats.maps.sag import point_lines, structured_faces

    row = window.lattice.row(window.lattice.count[1] // 2)
    middle = row[len(row) // 2 : len(row) // 2 + 1]
    total = 0.0
    for _, face, _ in structured_faces(window):
        lines = point_lines(window, face, per_cell, middle, millimetres(window.unit))
        total += sum(len(line) + 1 for line in lines) * window.lattice.cell_count + 80
    return int(total)


def _forecast_table(meshes: Meshes, _quads: int, _asked: Request) -> Forecast:
    window = meshes.window
    drawn = 100 * window.lattice.cell_count * structured_count(window)
    return map_row(TABLE, _table_bytes(window), BASE + TABLE_SECONDS * drawn)


def _table_bytes(window: Window) -> int:
    """Size of both files of the surface table: JSON generated in full, CSV from its first row of cells."""
    import io

    from clacad.formats.maps.pose_table import pose_lines, surface_table
    from clacad.storage.atomic import canonical_json

    total = float(len(canonical_json(surface_table(window, millimetres(window.unit)))))
    row = window.lattice.row(window.lattice.count[1] // 2)
    text = io.StringIO()
    lines = 0
    for line in pose_lines(window, millimetres(window.unit), [row]):
        text.write(",".join(str(word) for word in line) + "\n")
        lines += 1
    faces = max(1, lines // max(1, len(row)))
    return int(total + len(text.getvalue()) / max(1, lines) * window.lattice.cell_count * faces)


FORMATS = (
    Format(
        SAG,
        "map",
        "grid of heights and slopes of one cell of each face, for ray tracers",
        _write_sag,
        _forecast_sag,
        lambda sheet, _quads, _asked: structured_cost(2 * sheet.bodies),
        of_cell=True,
        stored=(AT_POINTS,),
    ),
    Format(
        TIFF,
        "map",
        "height map of each face, in single precision and in 16 bits",
        partial(_maps, TIFF, {TIFF32: "f32.tiff", TIFF16: "u16.tiff"}),
        _forecast_tiff,
        drawn_cost(TIFF_SECONDS),
        commands=True,
        stored=(ABOVE_FACE, SIXTEEN_BITS),
    ),
    Format(
        PNG,
        "map",
        "height map of each face, in 16 bits",
        partial(_maps, PNG, {PNG16: "u16.png"}),
        _forecast_png,
        drawn_cost(PNG_SECONDS),
        commands=True,
        stored=(SIXTEEN_BITS,),
    ),
    Format(
        XYZ,
        "map",
        "points of each face with their normals",
        _write_xyz,
        _forecast_xyz,
        drawn_cost(XYZ_SECONDS),
        stored=(AT_POINTS,),
    ),
    Format(
        TABLE,
        "map",
        "parameters of the surfaces, and the pose of every lenslet",
        _write_table,
        _forecast_table,
        drawn_cost(TABLE_SECONDS),
        stored=(OWN_NUMBERS,),
    ),
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

FILES = (
    map_kind(TIFF32, ".f32.tiff"),
    map_kind(TIFF16, ".u16.tiff"),
    map_kind(PNG16, ".u16.png"),
    map_kind(POINTS, ".xyz"),
    map_kind(GRID, ".cell.dat"),
    map_kind(CALIBRATION, ".tiff.json", ".png.json", ".gds.json"),
    map_kind(POSES, ".poses.csv"),
    map_kind(SURFACES, ".surfaces.json"),
    FileKind(CELL_TABLE, "other"),
    map_kind(MASK_SVG, ".mask.svg"),
    map_kind(MASK_DXF, ".mask.dxf"),
    map_kind(GDS, ".gds", native=True),
)
