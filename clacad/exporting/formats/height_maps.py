"""Heights of single faces: maps of pixels (TIFF, PNG), the sag grid of a cell, points with normals.

Tables of the surfaces (JSON) and of the poses of all lenslets (CSV).
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
    structured_cost,
)
from clacad.exporting.roles import ABOVE_FACE, AT_POINTS, OWN_NUMBERS, SIXTEEN_BITS

if TYPE_CHECKING:
    from clacad.exporting.manifest import FileRecord, Job
    from clacad.exporting.request import Request
    from clacad.exporting.tessellations import Meshes
    from clacad.sheet.window import Window

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
    from clacad.formats.maps.sag import check_map, height_map, samples_per_cell, structured_faces, write_map

    records, calibration = [], {}
    per_cell = samples_per_cell(job.window, None)
    for body, face, label in structured_faces(job.window):
        map_ = height_map(job.window, body, face, label, per_cell)
        calibration[label] = map_.calibration(job.scale)
        for kind, suffix in kinds.items():
            path = job.stage.path(f"{job.stem}.{label}.{suffix}")
            job.progress(f"write {path.name}", 0.0)
            write_map(map_, path, kind, job.scale)
            check_map(map_, path, kind, job.scale)
            facts = {"float": "f32"} if kind == TIFF32 else {}
            records.append(job.record(path, kind, bodies=[body.name], facts=facts))
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

    return min(16, samples_per_cell(window, None))


def _points(window: Window, per_cell: int) -> int:
    """Pixels or points of all faces."""
    from clacad.formats.maps.sag import structured_faces

    return per_cell * per_cell * window.lattice.cell_count * len(structured_faces(window))


def _forecast_sag(meshes: Meshes, _quads: int, _asked: Request) -> Forecast:
    """Forecast the sag grids: 65 x 65 lines of 70 bytes a face."""
    from clacad.formats.maps.sag import structured_faces

    faces = len(structured_faces(meshes.window))
    return map_row(SAG, faces * 70 * 65 * 65, structured_cost(faces))


def _forecast_tiff(meshes: Meshes, _quads: int, _asked: Request) -> Forecast:
    """Forecast both TIFF files of each face: six bytes a pixel."""
    from clacad.formats.maps.sag import samples_per_cell

    pixels = _points(meshes.window, samples_per_cell(meshes.window, None))
    return map_row(TIFF, 6 * pixels, BASE + TIFF_SECONDS * pixels)


def _forecast_png(meshes: Meshes, _quads: int, _asked: Request) -> Forecast:
    from clacad.formats.maps.sag import samples_per_cell

    per_cell = samples_per_cell(meshes.window, None)
    pixels = _points(meshes.window, per_cell)
    return map_row(PNG, _png_bytes(meshes.window, per_cell), BASE + PNG_SECONDS * pixels)


def _forecast_xyz(meshes: Meshes, _quads: int, _asked: Request) -> Forecast:
    per_cell = _points_a_cell(meshes.window)
    points = _points(meshes.window, per_cell)
    return map_row(XYZ, _xyz_bytes(meshes.window, per_cell), BASE + XYZ_SECONDS * points)


def _png_bytes(window: Window, per_cell: int) -> int:
    """Size of the PNG files: one row of cells of each map, deflated."""
    import zlib
    from dataclasses import replace

    from clacad.formats.maps.sag import height_map, map_levels, structured_faces

    total = 0.0
    for body, face, label in structured_faces(window):
        map_ = height_map(window, body, face, label, per_cell)
        rows = min(map_.height, 8 * per_cell)  # rows of cells repeat: what deflate learns in a few, it knows
        # in a non-uniform sheet nothing repeats, and the first rows are representative
        strip = replace(map_, height=rows)
        packer = zlib.compressobj(6)
        size = sum(
            len(packer.compress(map_levels(strip, block).astype(">u2").tobytes())) for block in strip.blocks()
        )
        total += (size + len(packer.flush())) * map_.height / rows + 200
    return int(total) + 600 * len(structured_faces(window))


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
    from clacad.formats.maps.sag import structured_faces

    window = meshes.window
    drawn = 100 * window.lattice.cell_count * len(structured_faces(window))
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
)
