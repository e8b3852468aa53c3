"""Judge maps, point clouds, grids, tables and masks: every number in them is compared with the design's own faces.

The format of a file is that of its manifest, else that of its suffix. A file without a manifest may hold any of the
design's structured faces: the best-fitting one is named.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import islice
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from clacad.base.types import Floats
from clacad.base.units import millimetres
from clacad.exporting.roles import Role
from clacad.formats.maps.gds import GRID, grey_cell
from clacad.formats.maps.gds_reading import layer_counts
from clacad.formats.maps.mask import mask_misfit
from clacad.formats.maps.pose_table import pose_lines, surface_table
from clacad.formats.maps.raster import Pixels, read_png, read_tiff
from clacad.formats.maps.sag import (
    NO_DATA,
    HeightMap,
    check_grid_sag,
    read_points,
    structured_faces,
)
from clacad.sheet.window import Face, Window, face_height, lens_height_and_normal
from clacad.storage.errors import ExportError, UnreadableFile
from clacad.storage.spending import Spending
from clacad.verification.checks import Check, judge, not_run, unreadable
from clacad.verification.files.find_files import Subject
from clacad.verification.files.inspection import Inspection
from clacad.verification.files.map_light import FaceFile, map_light
from clacad.verification.files.reading_worker import longest_wait, reading_worker
from clacad.verification.limit_sources import other

SUFFIXES: Mapping[str, str] = {
    ".f32.tiff": "tiff32", ".u16.tiff": "tiff16", ".u16.png": "png16", ".xyz": "xyz-normals", ".cell.dat": "grid-sag",
    ".poses.csv": "pose-table", ".surfaces.json": "surface-table", ".mask.svg": "mask-svg", ".mask.dxf": "mask-dxf",
    ".tiff.json": "height-calibration", ".png.json": "height-calibration",
    ".gds": "gds", ".gds.json": "height-calibration",
}  # fmt: skip
"""Endings of exported file names, and their formats; several tables end in .csv, so the whole ending is compared."""

SAME = 1e-9
"""Relative difference up to which two numbers of a table are equal; also that of two heights, in pitches."""

DAMAGED = (
    ExportError,
    OSError,
    ValueError,
    LookupError,
    TypeError,
    ArithmeticError,
    RecursionError,
    MemoryError,
    csv.Error,
)
"""Exceptions that the readers of numbers raise for bytes of another format."""

GDS_MISFIT = "clacad.formats.maps.gds_reading:gds_misfit"

Misfit = tuple[float, float, str]
"""Greatest deviation in millimetres (or relative, for tables), its allowance for writing, and the compared quantity."""


def format_of(subject: Subject) -> str | None:
    """Format under which a file can be judged, or None."""
    if subject.entry:
        return subject.format if subject.format in _READERS or subject.format in _FACES else None
    name = subject.name.lower()
    return next((word for end, word in SUFFIXES.items() if name.endswith(end)), None)


def judge_map(asked: Inspection, window: Window, subject: Subject, format: str) -> list[Check]:
    """Compare a file with the design's faces, number by number, and trace light through its heights.

    Parameters
    ----------
    `asked` : Inspection
    window : Window
        With the cells that were written.
    subject : Subject
    format : str
        From `format_of`.

    Returns
    -------
    list of Check
        readable, shape, and those of light where the file holds heights.
    """
    common = asked.common
    try:
        worst, room, what, label = _compared(window, subject, format)
    except DAMAGED as error:
        return [unreadable(error, **common), not_run("shape", "the file cannot be read", **common)]
    sentence = (
        f"{what}: up to {worst:.3g} off the design's" if worst < inf else f"{what}: other than the design's"
    )
    found = Check("readable", "pass", f"{format}, {what}", **common)
    unit = "" if format in ("surface-table", "height-calibration") else "mm"
    shape = judge(
        "shape", worst, room, sentence, unit=unit, limit_source=other("rounding of the format"), **common
    )
    light = map_light(asked, window, subject.path, format, label) if label else ()
    obeys = bool(light) and all(check.state == "pass" for check in light)
    if subject.role is Role.SCAN and shape.state == "fail" and obeys:  # a measured surface is never exact
        shape = replace(shape, state="warn")
    return [found, shape, *light]


def _compared(window: Window, subject: Subject, format: str) -> tuple[float, float, str, str]:
    """Misfit, and the name of its face ("" for the whole window)."""
    if format in _READERS:
        return *_READERS[format](window, subject.path), ""
    best: tuple[float, float, str, str] | None = None
    refusal: ExportError | None = None
    for body, face, label in structured_faces(window):
        if f".{label}." in subject.name or not _labelled(window, subject.name):
            try:
                one = _FACES[format](FaceFile(window, body, face, label, subject.path))
            except ExportError as error:
                refusal = error
                continue
            if best is None or one[0] < best[0]:
                best = (*one, label)
    if best is None:
        raise refusal or UnreadableFile(f"{subject.name}: no face of the design is of its kind")
    return best


def _labelled(window: Window, name: str) -> bool:
    """Whether a file's name contains the name of a face."""
    return any(f".{label}." in name for _, _, label in structured_faces(window))


# -- of one face -------------------------------------------------------------------------------------


def _map(kind: str) -> Callable[[FaceFile], Misfit]:
    """Comparison of a map whose pixels are "tiff32", "tiff16" or "png16"."""

    def compare(of: FaceFile) -> Misfit:
        map_ = of.map()
        worst, count = map_misfit(map_, of.path, kind, of.scale)
        if kind == "tiff32":
            room = of.scale * (2.0**-23 * max(abs(map_.low), abs(map_.high)) + 1e-15)
        else:
            room = 0.51 * of.scale * map_.step
        return worst, room, f"{count:,} heights of {of.label}"

    return compare


def _points(of: FaceFile) -> Misfit:
    worst, count = points_misfit(of.window, of.face, of.path, of.scale)
    room = 2e-9 + 1e-8 * min(of.window.lattice.pitch) * of.scale
    return worst, room, f"{count:,} points of {of.label}"


def _grid(of: FaceFile) -> Misfit:
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
        return worst, 2.0 * GRID * 1e-3, f"{levels} levels and {count:,} places of {of.label}"
    raise refusal or UnreadableFile(f"{of.path.name}: no layers")


_FACES: Mapping[str, Callable[[FaceFile], Misfit]] = {
    "tiff32": _map("tiff32"), "tiff16": _map("tiff16"), "png16": _map("png16"), "xyz-normals": _points,
    "grid-sag": _grid, "gds": _layers, "mask-svg": _mask, "mask-dxf": _mask,
}  # fmt: skip


def map_misfit(map_: HeightMap, path: Path, kind: str, scale: float) -> tuple[float, int]:
    """Greatest distance of a pixel from the face, millimetres, and the number of pixels; inf for a false hole.

    Raises
    ------
    UnreadableFile
        The file is damaged, or its pixel format is not that of the map.
    """
    pixels: Pixels = read_png(path) if kind == "png16" else read_tiff(path)
    if pixels.shape != (map_.height, map_.width):
        raise UnreadableFile(
            f"{path.name}: {pixels.shape[1]} × {pixels.shape[0]} pixels, a map of {map_.label} has {map_.width} × {map_.height}"
        )
    worst, row = 0.0, 0
    for want in map_.blocks():
        got = np.asarray(pixels[row : row + len(want)], dtype=np.float64)
        row += len(want)
        heights = got / scale if kind == "tiff32" else map_.low + (got - 1.0) * map_.step
        hole = ~np.isfinite(want)
        if ((got == (NO_DATA if kind == "tiff32" else 0)) != hole).any():
            return inf, pixels.size
        apart = np.abs(heights - want)[~hole]
        worst = max(worst, float(apart.max(initial=0.0))) if np.isfinite(apart).all() else inf
    return worst * scale, pixels.size


def points_misfit(window: Window, face: Face, path: Path, scale: float) -> tuple[float, int]:
    """Greatest distance of a point from the face, millimetres, and the number of points; inf for a false normal.

    A plain cloud has no normals.

    Raises
    ------
    UnreadableFile
    """
    assert face.array is not None
    worst, count = 0.0, 0
    for table in read_points(path):
        index, u, v = window.locate(face.array, table[:, 0] / scale, table[:, 1] / scale)
        z = face_height(window, face, u, v, index)
        places = window.lenses(face, index)
        lens, normal = lens_height_and_normal(face, *places.seen(u, v))
        lens = places.raised(lens)
        flat = ~(z == lens)
        normal = np.where(flat[:, None], np.array([0.0, 0.0, 1.0]), normal) * -face.side
        apart = np.abs(table[:, 2] - z * scale)
        turned = np.abs(table[:, 3:] - normal[:, : table.shape[1] - 3]).max(
            axis=1, initial=0.0
        )  # 0 for a plain cloud
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


def _json(path: Path) -> Any:
    Spending("surface-table", path)
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
    spent = Spending("pose-table", path)
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


_READERS: Mapping[str, Callable[[Window, Path], Misfit]] = {
    "surface-table": _surfaces, "pose-table": _poses, "height-calibration": _calibration,
}  # fmt: skip
