"""Table of the surfaces (JSON) and of the poses of all lenslets (CSV)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from clacad.base.units import millimetres
from clacad.exporting.formats.file_kind import FileKind, drawn_cost, map_kind, map_row
from clacad.exporting.formats.format import BASE, Forecast, Format
from clacad.exporting.roles import OWN_NUMBERS

if TYPE_CHECKING:
    from clacad.exporting.manifest import FileRecord, Job
    from clacad.exporting.request import Request
    from clacad.exporting.tessellations import Meshes
    from clacad.sheet.window import Window

WORD = "table"
SURFACES, POSES = "surface-table", "pose-table"
"""Words of the files in manifests."""

CELL_TABLE = "cell-table"
"""Word of the copy of a design's cell table."""

SECONDS = 4e-8
"""Seconds per hundredth of a lenslet."""


def _write(job: Job) -> list[FileRecord]:
    from clacad.formats.maps.pose_table import check_table, write_table_csv, write_table_json

    surfaces, poses = job.stage.path(f"{job.stem}.surfaces.json"), job.stage.path(f"{job.stem}.poses.csv")
    write_table_json(job.window, surfaces, job.scale)
    count = write_table_csv(job.window, poses, job.scale)
    check_table(job.window, surfaces, poses, job.scale, count)
    return [job.record(surfaces, SURFACES), job.record(poses, POSES, facts={"lenslets": count})]


def _forecast(meshes: Meshes, _quads: int, _asked: Request) -> Forecast:
    from clacad.formats.maps.sag import structured_faces

    window = meshes.window
    drawn = 100 * window.lattice.cell_count * len(structured_faces(window))
    return map_row(WORD, _bytes(window), BASE + SECONDS * drawn)


def _bytes(window: Window) -> int:
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
        WORD,
        "map",
        "parameters of the surfaces, and the pose of every lenslet",
        _write,
        _forecast,
        drawn_cost(SECONDS),
        stored=(OWN_NUMBERS,),
    ),
)

FILES = (map_kind(POSES, ".poses.csv"), map_kind(SURFACES, ".surfaces.json"), FileKind(CELL_TABLE, "other"))
