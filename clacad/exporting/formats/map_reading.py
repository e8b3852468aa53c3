"""Comparison of maps, point clouds, grids, tables and masks with the design's own faces, number by number."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping
from itertools import islice
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats
from clacad.base.units import millimetres
from clacad.exporting.formats.format import CALIBRATION, FaceFile, Misfit, Reading, Samples
from clacad.exporting.formats.height_maps import (
    GDS,
    GRID,
    MASK_DXF,
    MASK_SVG,
    PNG16,
    POINTS,
    POSES,
    SURFACES,
    TIFF16,
    TIFF32,
)
from clacad.exporting.formats.registry import longest_wait, reading_worker
from clacad.exporting.formats.sequential import ZMX
from clacad.formats.maps.gds import GRID as LAYOUT_GRID
from clacad.formats.maps.gds import grey_cell, layer_counts
from clacad.formats.maps.mask import mask_misfit
from clacad.formats.maps.pose_table import pose_lines, surface_table
from clacad.formats.maps.sag import (
    HeightMap,
    check_grid_sag,
    read_grid_sag,
    read_points,
    structured_faces,
)
from clacad.formats.sequential.zmx import check_zmx
from clacad.sheet.window import Face, Window, face_height, heights_and_normals_of_lenses, in_optical_tile
from clacad.storage.errors import ExportError, UnreadableFile
from clacad.storage.reading import Spending

SAME = 1e-9
"""Relative difference up to which two numbers of a table are equal; also that of two heights, in pitches."""

GDS_MISFIT = "clacad.formats.maps.gds:gds_misfit"

SampleReader = Callable[[FaceFile, tuple[int, int]], Samples]
"""Returns the heights over one cell that a file holds."""


# -- of one face -------------------------------------------------------------------------------------


def _map(kind: str) -> Callable[[FaceFile], Misfit]:
    """Comparison of a map whose pixels are "tiff32", "tiff16" or "png16"."""

    def compare(of: FaceFile) -> Misfit:
        map_ = of.map()
        worst, count = map_misfit(map_, of.path, kind, of.scale)
        return worst, of.scale * map_.room(kind), f"{count:,} heights of {of.label}"

    return compare


def _points(of: FaceFile) -> Misfit:
    worst, count = points_misfit(of.window, of.face, of.path, of.scale)
    room = 2e-9 + 1e-8 * min(of.window.lattice.pitch) * of.scale
    return worst, room, f"{count:,} points of {of.label}"


def _grid(of: FaceFile) -> Misfit:
    if not of.window.uniform:
        raise UnreadableFile(f"{of.path.name}: heights of one cell, and no manifest says of which")
    check_grid_sag(of.face, of.path, of.scale)
    return 0.0, 0.0, f"the sag of {of.label} at every node"


def _mask(of: FaceFile) -> Misfit:
    worst, count = mask_misfit(of.window, of.body, of.face, of.path, of.scale)
    return (
        worst,
        SAME * min(of.window.lattice.pitch) * of.scale,
        f"outline and {count:,} places of {of.label}",
    )


def _layers(of: FaceFile) -> Misfit:
    """Compare layers: the level count must agree, except for top levels that no pixel may reach."""
    refusal = None
    most = max(layer_counts(of.path), default=0)
    for levels in range(max(2, most + 1), most + 4):
        try:
            laid = grey_cell(of.window, of.body, of.face, of.label, levels, of.scale)
            with reading_worker(
                of.path
            ) as worker:  # the library crashes on a file that is damaged within a record
                worst, count = worker.run(GDS_MISFIT, laid, of.path, of.scale, timeout=longest_wait(of.path))
        except ExportError as error:
            refusal = refusal or error
            continue
        return worst, 2.0 * LAYOUT_GRID * 1e-3, f"{levels} levels and {count:,} places of {of.label}"
    raise refusal or UnreadableFile(f"{of.path.name}: no layers")


def map_misfit(map_: HeightMap, path: Path, kind: str, scale: float) -> tuple[float, int]:
    """Greatest distance of a pixel from the face, millimetres, and the number of pixels; inf for a false
    hole.

    Raises UnreadableFile: The file is damaged, or its pixel format is not that of the map.
    """
    pixels, worst, row = map_.read(path, kind), 0.0, 0
    for want in map_.blocks():
        got = np.asarray(pixels[row : row + len(want)], dtype=np.float64)
        row += len(want)
        hole, (heights, empty) = ~np.isfinite(want), map_.heights_of(got, kind, scale)
        if (empty != hole).any():
            return inf, pixels.size
        apart = np.abs(heights - want)[~hole]
        worst = max(worst, float(apart.max(initial=0.0))) if np.isfinite(apart).all() else inf
    return worst * scale, pixels.size


def points_misfit(window: Window, face: Face, path: Path, scale: float) -> tuple[float, int]:
    """Greatest distance of a point from the face, millimetres, and the number of points; inf for a false
    normal.

    A plain cloud has no normals.

    Raises UnreadableFile.
    """
    assert face.array is not None
    worst, count = 0.0, 0
    for table in read_points(path):
        index, u, v = window.locate(face.array, table[:, 0] / scale, table[:, 1] / scale)
        z = face_height(window, face, u, v, index)
        places = window.lenses(face, index)
        lens, normal = heights_and_normals_of_lenses(face, places, u, v)
        flat = ~(z == lens)
        normal = np.where(flat[:, None], np.array([0.0, 0.0, 1.0]), normal) * -face.side
        apart = np.abs(table[:, 2] - z * scale)
        normals = normal[:, : table.shape[1] - 3]  # none in a plain cloud
        turned = np.abs(table[:, 3:] - normals).max(axis=1, initial=0.0)
        if not (np.isfinite(apart).all() and window.lattice.contains(index).all() and (turned < 1e-6).all()):
            return inf, count
        worst, count = max(worst, float(apart.max(initial=0.0))), count + len(table)
    if not count:
        raise UnreadableFile(f"{path.name}: no points")
    return worst, count


# -- of the whole window -----------------------------------------------------------------------------


def _surfaces(window: Window, path: Path) -> Misfit:
    found = _json(path)
    worst = _apart(surface_table(window, millimetres(window.unit)), found)
    return worst, SAME, "every number of the surface table, relative"


def _calibration(window: Window, path: Path) -> Misfit:
    found, scale = _json(path), millimetres(window.unit)
    faces = {}
    for body, face, label in structured_faces(window):
        levels = found["faces"][label].get("levels")  # layers of a GDSII file, or pixels of a map
        of = FaceFile(window, body, face, label, path)
        laid = of.map() if levels is None else grey_cell(window, body, face, label, int(levels), scale)
        faces[label] = laid.calibration(scale)
    worst = _apart({"format": 1, "unit": "mm", "faces": faces}, found)
    return worst, SAME, "every number of the calibration, relative"


def _prescription(window: Window, path: Path) -> Misfit:
    check_zmx(window, path)
    return 0.0, 0.0, f"light through it leaves as through the faces of {window.name}"


def _json(path: Path) -> Any:
    Spending(SURFACES, path)
    return json.loads(path.read_text(encoding="utf-8"))


def _apart(wanted: Any, found: Any) -> float:
    """Greatest relative difference of numbers at the same position; inf where anything else differs."""
    if isinstance(wanted, Mapping):
        if not isinstance(found, Mapping) or set(found) != set(wanted):
            return inf
        return max((_apart(value, found[key]) for key, value in wanted.items()), default=0.0)
    if isinstance(wanted, (list, tuple)):
        if not isinstance(found, list) or len(found) != len(wanted):
            return inf
        return max((_apart(a, b) for a, b in zip(wanted, found, strict=True)), default=0.0)
    if isinstance(wanted, float) and isinstance(found, (int, float)) and not isinstance(found, bool):
        apart = abs(found - wanted) / max(abs(wanted), abs(found), 1e-9) if found != wanted else 0.0
        return apart if apart == apart else inf
    return 0.0 if type(wanted) is type(found) and wanted == found else inf


def _poses(window: Window, path: Path) -> Misfit:
    """Compare every line of a pose table: cell, apex and angles."""
    scale, count, worst = millimetres(window.unit), 0, 0.0
    rows = (window.lattice.row(j) for j in range(window.lattice.count[1]))
    wanted = pose_lines(window, scale, rows)
    spent = Spending(POSES, path)
    with path.open("rb") as stream:
        lines = csv.reader(line.decode("ascii") for line in spent.lines(stream))
        next(lines, None)
        while block := list(islice(lines, 4096)):
            expected = list(islice(wanted, len(block)))
            if len(expected) != len(block):
                raise UnreadableFile(f"{path.name}: more lenslets than the design has")
            worst = max(worst, _lines_apart(expected, block))
            count += len(block)
            spent.count(len(block))
    if next(wanted, None) is not None:
        raise UnreadableFile(f"{path.name}: fewer lenslets than the design has")
    return worst, SAME * min(window.lattice.pitch) * scale, f"places and angles of {count:,} lenslets"


def _lines_apart(expected: list[list[str | int]], found: list[list[str]]) -> float:
    if any([str(a) for a in want[:3]] != got[:3] for want, got in zip(expected, found, strict=True)):
        return inf
    want, got = (_numbers(rows) for rows in (expected, found))
    apart = np.abs(want - got)
    return float(apart.max()) if np.isfinite(apart).all() else inf


def _numbers(rows: list[Any]) -> Floats:
    return np.array([[float(word) for word in row[3:]] for row in rows])


# -- heights of one cell ------------------------------------------------------------------------------


def _centre(window: Window, face: Face, cell: tuple[int, int]) -> Floats:
    """Middle (2,) of a cell, in the grid of the face's own array."""
    return window.centres(face.array or 0, np.array(cell, dtype=np.int64))


def _pixels(kind: str) -> SampleReader:
    """Reader of a map whose pixels are "tiff32", "tiff16" or "png16"."""

    def read(of: FaceFile, cell: tuple[int, int]) -> Samples:
        map_ = of.map()
        pixels = map_.read(of.path, kind)
        centre = _centre(of.window, of.face, cell)
        columns, rows = _span(map_, of.window.lattice_of(of.face.array or 0).tile(), centre)
        got = np.asarray(pixels[rows[:, None], columns], dtype=np.float64)
        height, hole = map_.heights_of(got, kind, of.scale)
        z = np.where(hole, np.nan, map_.reference - of.face.side * height)
        x, y = map_.places(columns, rows)
        gx, gy = np.meshgrid(x - centre[0], y - centre[1])
        mine = in_optical_tile(
            of.window, gx, gy, of.face.array or 0
        )  # the substitute cell may be larger, or may not be tilted
        return Samples(
            np.column_stack([gx.ravel(), gy.ravel(), np.where(mine, z, np.nan).ravel()]),
            np.full(2, map_.pixel),
        )

    return read


def _span(map_: HeightMap, tile: Floats, centre: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Columns and rows of the pixels over the bounding box of a cell."""
    low, high = tile.min(axis=0) + centre, tile.max(axis=0) + centre
    first = np.floor((low - np.asarray(map_.origin)) / map_.pixel).astype(np.int64)
    last = np.ceil((high - np.asarray(map_.origin)) / map_.pixel).astype(np.int64)
    columns = np.arange(max(0, first[0]), min(map_.width, last[0]))
    rows = map_.height - 1 - np.arange(max(0, first[1]), min(map_.height, last[1]))
    return columns, rows[::-1]


def _point_samples(of: FaceFile, cell: tuple[int, int]) -> Samples:
    assert of.face.array is not None
    kept = []
    for table in read_points(of.path):
        index, x, y = of.window.locate(of.face.array, table[:, 0] / of.scale, table[:, 1] / of.scale)
        mine = (index == cell).all(axis=1)
        if mine.any():
            kept.append(np.column_stack([x, y, table[:, 2] / of.scale])[mine])
    points = np.concatenate(kept) if kept else np.empty((0, 3))
    return Samples(points, _spacing(points))


def _spacing(points: Floats) -> Floats:
    """Distance (2,) of the samples of a grid along x and y."""
    found = []
    for k in (0, 1):
        at = np.unique(points[:, k])
        apart = np.diff(at)
        apart = apart[apart > 1e-6 * (np.ptp(at) if len(at) else 1.0)]
        if not len(apart):
            raise ValueError("its points over a cell are no grid")
        found.append(float(np.median(apart)))
    return np.array(found)


def _grid_samples(of: FaceFile, _cell: tuple[int, int]) -> Samples:
    points, step = read_grid_sag(of.face, of.path, of.scale)
    return Samples(points, step)


READINGS: Mapping[str, Reading] = {
    **{kind: Reading(_map(kind), samples=_pixels(kind)) for kind in (TIFF32, TIFF16, PNG16)},
    POINTS: Reading(_points, samples=_point_samples),
    GRID: Reading(_grid, samples=_grid_samples),
    GDS: Reading(_layers),
    MASK_SVG: Reading(_mask),
    MASK_DXF: Reading(_mask),
    SURFACES: Reading(sheet=_surfaces, unit=""),
    POSES: Reading(sheet=_poses),
    CALIBRATION: Reading(sheet=_calibration, unit=""),
    ZMX: Reading(sheet=_prescription, unit=""),
}
"""Kind of file → its comparison with the design."""
