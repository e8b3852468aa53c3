"""Light through a map: the heights of one cell of a face as a bicubic surface, the other faces as designed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats
from clacad.base.units import millimetres
from clacad.formats.maps.raster import read_png, read_tiff
from clacad.formats.maps.sag import (
    NO_DATA,
    HeightMap,
    height_map,
    read_grid_sag,
    read_points,
    samples_per_cell,
    structured_faces,
)
from clacad.sheet.representative_cells import central_cell
from clacad.sheet.window import Body, Face, Window, in_optical_tile
from clacad.storage.errors import ExportError
from clacad.tracing.sampled_face import sampled_face
from clacad.tracing.triangles.telescopelet_facets import AnyFace, ExactFace, FacetBody, trace_facets
from clacad.verification.check_kinds.file_light import THROUGH_FILE
from clacad.verification.checks import Check
from clacad.verification.files.inspection import Inspection
from clacad.verification.files.law_through_file import light_checks, measure_light
from clacad.verification.files.mesh_light import lit_cells, seen_cell

RAYS, POINT_RAYS = 8192, 1024
"""Most rays of the main bundle, and of each field point."""


@dataclass(frozen=True, eq=False)
class FaceFile:
    """A file of one face: the face, its body, its name in files ("array1.front"), and the path."""

    window: Window
    body: Body
    face: Face
    label: str
    path: Path

    @property
    def scale(self) -> float:
        """Millimetres per design unit."""
        return millimetres(self.window.unit)

    def map(self) -> HeightMap:
        """Map of the face as an export writes it."""
        per_cell = samples_per_cell(self.window, None)
        return height_map(self.window, self.body, self.face, self.label, per_cell)


@dataclass(frozen=True, eq=False)
class Samples:
    """Heights of one cell.

    points : (m, 3) lengths
        x and y in the cell frame, z in the sheet frame.
    step : (2,) lengths
    """

    points: Floats
    step: Floats


def map_light(asked: Inspection, window: Window, path: Path, format: str, label: str) -> list[Check]:
    """Trace the rays of the checks through the heights of a map, grid or point file.

    Parameters
    ----------
    `asked` : Inspection
    window : Window
    path : Path
    format : str
        From `clacad.verification.files.map_file.format_of`; a format without heights gives no check.
    label : str
        Name of the face.
    """
    if format not in _READ:
        return []
    body, face = next((b, f) for b, f, name in structured_faces(window) if name == label)
    cell = central_cell(window) if window.uniform else lit_cells(window, asked.design.check.field)[0]
    one = seen_cell(window, cell)
    like = next(f for _, f, name in structured_faces(one.like) if name == label)
    try:
        held = _READ[format](FaceFile(window, body, face, label, path), cell)
        through = _bodies(one.like, like, cell, held)
    except (ExportError, OSError, ValueError) as error:
        why = f"no light can be sent through it: {error}"
        return [kind.not_run(why, **asked.common) for kind in THROUGH_FILE]
    seen = measure_light(
        asked.design,
        one.like,
        lambda lit: trace_facets(through, one.placed(lit).rays),
        min(asked.rays, RAYS),
        POINT_RAYS,
        cell if window.uniform else None,
        one.send,
    )
    what = f"bicubic surface ({format}, {label}; the other faces as designed)"
    return light_checks(asked, seen, what)


def _bodies(window: Window, sampled: Face, cell: tuple[int, int], held: Samples) -> tuple[FacetBody, ...]:
    """Telescopelet of a cell: one face as sampled, the others as designed."""
    bodies = []
    for body in window.bodies:
        faces: list[AnyFace] = []
        for face in (body.front, body.back):
            place = np.array([*_centre(window, face, cell), 0.0])
            if face is sampled:
                faces.append(sampled_face(window, face, place, held.points, held.step))
            else:
                faces.append(ExactFace(face, place, window))
        bodies.append(FacetBody(faces[0], faces[1], body.index))
    return tuple(bodies)


def _centre(window: Window, face: Face, cell: tuple[int, int]) -> Floats:
    """Middle (2,) of a cell, in the grid of the face's own array."""
    return window.centres(face.array or 0, np.array(cell, dtype=np.int64))


Reader = Callable[[FaceFile, tuple[int, int]], Samples]
"""Returns the heights over one cell that a file holds."""

# -- heights of one cell, by format -----------------------------------------------------------------


def _pixels(kind: str) -> Reader:
    """Reader of a map whose pixels are "tiff32", "tiff16" or "png16"."""

    def read(of: FaceFile, cell: tuple[int, int]) -> Samples:
        map_ = of.map()
        pixels = read_png(of.path) if kind == "png16" else read_tiff(of.path)
        centre = _centre(of.window, of.face, cell)
        columns, rows = _span(map_, of.window.lattice_of(of.face.array or 0).tile(), centre)
        got = np.asarray(pixels[rows[:, None], columns], dtype=np.float64)
        hole = got == (NO_DATA if kind == "tiff32" else 0)
        height = got / of.scale if kind == "tiff32" else map_.low + (got - 1.0) * map_.step
        z = np.where(hole, np.nan, map_.reference - of.face.side * height)
        x = map_.origin[0] + map_.pixel * (columns + 0.5) - centre[0]
        y = map_.origin[1] + map_.pixel * (map_.height - 0.5 - rows) - centre[1]
        gx, gy = np.meshgrid(x, y)
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


def _points(of: FaceFile, cell: tuple[int, int]) -> Samples:
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


def _grid(of: FaceFile, _cell: tuple[int, int]) -> Samples:
    points, step = read_grid_sag(of.face, of.path, of.scale)
    return Samples(points, step)


_READ: Mapping[str, Reader] = {
    "tiff32": _pixels("tiff32"), "tiff16": _pixels("tiff16"), "png16": _pixels("png16"), "xyz-normals": _points,
    "grid-sag": _grid,
}  # fmt: skip
