"""Height maps of the optical faces: TIFF, PNG, point cloud with normals, and Zemax grid sag of a cell.

A map covers the cells of the face's own array, pixels at the middle of equal squares so that none lies
on a wall. Heights are along the outward normal of the sheet's face: a front face grows towards −z, a
back face towards +z, zero at the face's reference plane, the plane through its lenslets' apices.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from math import ceil, sqrt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Bools, Floats
from clacad.formats.maps.raster import Pixels, read_png, read_tiff, write_png, write_tiff
from clacad.sheet.window import Body, Face, Window, column, face_height, lens_height_and_normal
from clacad.storage.errors import FileDisagrees, UnreadableFile
from clacad.storage.reading import Spending

MOST_SAMPLES = 4_000_000
BLOCK = 1 << 18
NO_DATA = -(2.0**20)
"""Pixel of a float map where there is no face at all (a hole); in 16-bit maps such a pixel is 0."""


@dataclass(frozen=True, eq=False)
class HeightMap:
    """One optical face as a raster.

    window, body, face
    label : "array1-front" and so on; part of file names.
    pixel : Side of a pixel, design units.
    width, height : Pixels along x and y.
    origin : (x, y), lengths. Lower left corner of the map.
    reference : Sheet-frame z of the plane heights are counted from.
    low, high : Range of heights, design units, exact over the pixels.
    """

    window: Window
    body: Body
    face: Face
    label: str
    pixel: float
    width: int
    height: int
    origin: tuple[float, float]
    reference: float
    low: float
    high: float

    @property
    def step(self) -> float:
        """Height of one grey level of a 16-bit map, design units; level 1 is `low`, 65535 is `high`."""
        return (self.high - self.low) / 65534.0 or 1.0

    def places(self, columns: NDArray[np.int64], rows: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """Middles of pixels, lengths: x of columns, y of rows, which are counted from the top."""
        x = self.origin[0] + self.pixel * (columns + 0.5)
        return np.asarray(x), np.asarray(self.origin[1] + self.pixel * (self.height - 0.5 - rows))

    def calibration(self, scale: float) -> dict[str, object]:
        """Data that a machine needs to use the map, in millimetres (`scale`: millimetres per design unit)."""
        return {
            "face": self.label,
            "pixel_mm": self.pixel * scale,
            "width": self.width,
            "height": self.height,
            "left_mm": self.origin[0] * scale,
            "bottom_mm": self.origin[1] * scale,
            "reference_z_mm": self.reference * scale,
            "outward": "-z" if self.face.side > 0 else "+z",
            "low_mm": self.low * scale,
            "high_mm": self.high * scale,
            "step_mm": self.step * scale,
            "level_of_low": 1,
            "row_0": "top (greatest y)",
            "column_0": "left (least x)",
            "hole": {"u16": 0, "f32": NO_DATA},
        }

    def read(self, path: Path, kind: str) -> Pixels:
        """Pixels (height, width) of a file of this map, "tiff32", "tiff16" or "png16".

        Raises UnreadableFile: Damaged, or of another size.
        """
        pixels: Pixels = read_png(path) if kind == "png16" else read_tiff(path)
        if pixels.shape != (self.height, self.width):
            raise UnreadableFile(
                f"{path.name}: {pixels.shape[1]} × {pixels.shape[0]} pixels, a map of {self.label} has"
                f" {self.width} × {self.height}"
            )
        return pixels

    def heights_of(self, pixels: Floats, kind: str, scale: float) -> tuple[Floats, Bools]:
        """Heights of pixels of a file, design units, and which of them are holes."""
        if kind == "tiff32":
            return pixels / scale, pixels == NO_DATA
        return self.low + (pixels - 1.0) * self.step, pixels == 0

    def room(self, kind: str) -> float:
        """Rounding of the heights in a file, design units."""
        if kind == "tiff32":
            return 2.0**-23 * max(abs(self.low), abs(self.high)) + 1e-15
        return 0.51 * self.step

    def blocks(self, upwards: bool = False) -> Iterator[Floats]:
        """Heights (k, width) from the top row down, or up, design units, NaN where there is no face."""
        x = self.origin[0] + self.pixel * (np.arange(self.width) + 0.5)
        rows = max(1, BLOCK // self.width)
        for first in range(0, self.height, rows):
            row = np.arange(first, min(first + rows, self.height))
            y = self.origin[1] + self.pixel * ((row if upwards else self.height - 1 - row) + 0.5)
            gx, gy = np.meshgrid(x, y)
            yield outward_height(
                self.window, self.body, self.face, gx.ravel(), gy.ravel(), self.reference
            ).reshape(gx.shape)


def outward_height(window: Window, body: Body, face: Face, x: Floats, y: Floats, reference: float) -> Floats:
    """Height of a face above its reference plane, away from the material, at sheet points (n,)."""
    index, u, v = _located(window, face, x, y)
    z = face_height(window, face, u, v, index)
    if body.columnar:
        front, back = column(window, body, u, v, index)
        z = front if face is body.front else back
    land = np.nan if face.land is None else face.land
    z = np.where(window.lattice.contains(index), z, land)
    return np.asarray(-face.side * (z - reference))


def _located(window: Window, face: Face, x: Floats, y: Floats) -> tuple[NDArray[np.int64], Floats, Floats]:
    assert face.array is not None
    return window.locate(face.array, x, y)


def structured_faces(window: Window) -> list[tuple[Body, Face, str]]:
    """List the faces that carry lenslets, with a label each."""
    found = []
    for body in window.bodies:
        for face, side in ((body.front, "front"), (body.back, "back")):
            if face.array is not None:
                found.append((body, face, f"{body.name}-{side}"))
    return found


def samples_per_cell(window: Window) -> int:
    """Pixels per pitch: the number that keeps a map under `MOST_SAMPLES`, between 4 and 64."""
    return int(min(64, max(4, sqrt(MOST_SAMPLES / max(1, window.lattice.cell_count)))))


def height_maps(window: Window) -> Iterator[HeightMap]:
    """Maps of all structured faces as exports write them. Raises FileDisagrees: As `height_map`."""
    for body, face, label in structured_faces(window):
        yield height_map(window, body, face, label)


def height_map(window: Window, body: Body, face: Face, label: str, per_cell: int | None = None) -> HeightMap:
    """Lay out the map of a face and find its range of heights.

    per_cell : Pixels per pitch; None: `samples_per_cell`.

    Raises FileDisagrees: The face is undercut: its graph ends inside the optical zone and there is no land
        below.
    """
    per_cell = samples_per_cell(window) if per_cell is None else per_cell
    plain = plain_map(window, body, face, label, per_cell)
    alike = body.front.change is None and body.back.change is None
    low, high = range_of_cell(window, body, face, per_cell) if alike else _range_of_pixels(plain)
    if not high >= low:
        raise FileDisagrees(f"{label}: the face has no height anywhere; there is nothing to draw")
    return replace(plain, low=low, high=high)


def plain_map(window: Window, body: Body, face: Face, label: str, per_cell: int) -> HeightMap:
    """Lay out the map of a face, with its range of heights still unknown (0 to 0)."""
    assert face.array is not None
    dx, dy = window.shifts[face.array]
    x0, x1, y0, y1 = replace(window.placements[face.array], shift=(0.0, 0.0)).extent(window.lattice)
    pixel = window.lattice_of(face.array).pitch[0] / per_cell
    width, height = ceil((x1 - x0) / pixel * (1 - 1e-12)), ceil((y1 - y0) / pixel * (1 - 1e-12))
    # A map that is not a whole number of pixels wide is centred on the cells.
    origin = (dx + 0.5 * (x0 + x1 - width * pixel), dy + 0.5 * (y0 + y1 - height * pixel))
    return HeightMap(window, body, face, label, pixel, width, height, origin, face.vertex[2], 0.0, 0.0)


def range_of_cell(window: Window, body: Body, face: Face, per_cell: int) -> tuple[float, float]:
    """Range of heights over one cell, twice as fine as the map, borders and corners included."""
    assert face.array is not None
    tile = window.lattice_of(face.array).tile()
    n = 2 * per_cell + 1
    x, y = np.meshgrid(
        np.linspace(tile[:, 0].min(), tile[:, 0].max(), n), np.linspace(tile[:, 1].min(), tile[:, 1].max(), n)
    )
    points = np.concatenate([np.column_stack([x.ravel(), y.ravel()]), tile])
    u, v = points.T
    if body.columnar:
        front, back = column(window, body, u, v)
        z = front if face is body.front else back
    else:
        z = face_height(window, face, u, v)
    heights = -face.side * (z - face.vertex[2])
    if face.land is not None:
        heights = np.append(heights, -face.side * (face.land - face.vertex[2]))
    return float(np.nanmin(heights, initial=np.inf)), float(np.nanmax(heights, initial=-np.inf))


def _range_of_pixels(map_: HeightMap) -> tuple[float, float]:
    """Range of heights over all pixels of a map of a non-uniform sheet."""
    low, high = np.inf, -np.inf
    for block in map_.blocks():
        low, high = (
            min(low, float(np.nanmin(block, initial=np.inf))),
            max(high, float(np.nanmax(block, initial=-np.inf))),
        )
    return low, high


# -- TIFF and PNG --------------------------------------------------------------------------------


def write_map(map_: HeightMap, path: Path, kind: str, scale: float) -> None:
    """Write a height map as "tiff32" (millimetres), "tiff16" or "png16" (levels).

    scale : Millimetres per design unit.
    Raises OSError, FileDisagrees.
    """
    text = (
        f"clacad height map {map_.label}, pixel {map_.pixel * scale!r} mm, low {map_.low * scale!r} mm, step"
        f" {map_.step * scale!r} mm"
    )
    per_mm = 1.0 / (map_.pixel * scale)
    if kind == "tiff32":
        rows: Iterator[Pixels] = (_millimetres(block, scale) for block in map_.blocks())
        write_tiff(rows, path, map_.width, map_.height, 32, 10.0 * per_mm, text)
    elif kind == "tiff16":
        levels: Iterator[Pixels] = (map_levels(map_, block) for block in map_.blocks())
        write_tiff(levels, path, map_.width, map_.height, 16, 10.0 * per_mm, text)
    else:
        write_png(
            (map_levels(map_, block) for block in map_.blocks()),
            path,
            map_.width,
            map_.height,
            1000.0 * per_mm,
        )


def _millimetres(heights: Floats, scale: float) -> NDArray[np.float32]:
    return np.where(np.isfinite(heights), heights * scale, NO_DATA).astype(np.float32)


def map_levels(map_: HeightMap, heights: Floats) -> NDArray[np.uint16]:
    """Grey levels of heights: 1 is the map's low, 65535 its high, 0 a hole."""
    with np.errstate(invalid="ignore"):
        level = 1.0 + np.rint((heights - map_.low) / map_.step)
    return np.where(np.isfinite(heights), np.clip(level, 1, 65535), 0).astype(np.uint16)


def check_map(map_: HeightMap, path: Path, kind: str, scale: float) -> None:
    """Read a map back and compare about every 17th pixel with the lens formula of its cell.

    Raises FileDisagrees, UnreadableFile.
    """
    pixels: Pixels = read_png(path) if kind == "png16" else read_tiff(path)
    if pixels.shape != (map_.height, map_.width):
        raise FileDisagrees(f"{path.name}: {pixels.shape[1]} × {pixels.shape[0]} pixels were read back")
    chance = np.random.default_rng(0)
    row, col = chance.integers(0, map_.height, 2000), chance.integers(0, map_.width, 2000)
    got = np.asarray(pixels[row, col], dtype=np.float64)
    want = outward_height(map_.window, map_.body, map_.face, *map_.places(col, row), map_.reference)
    hole, (heights, empty) = ~np.isfinite(want), map_.heights_of(got, kind, scale)
    if (empty != hole).any() or (np.abs(heights - want)[~hole] > map_.room(kind)).any():
        raise FileDisagrees(f"{path.name}: its heights are not those of {map_.label}")


# -- points and grids as text --------------------------------------------------------------------


def write_points(window: Window, body: Body, face: Face, per_cell: int, path: Path, scale: float) -> int:
    """Write x y z nx ny nz of every cell's face, millimetres in the sheet frame, outward unit normals.

    Points are at the middle of per_cell × per_cell squares of each cell (those inside the cell); where land
    covers the lens the normal is that of the land. Returns the number of points.
    """
    assert face.array is not None
    total = 0
    with path.open("w", encoding="ascii", newline="\n") as stream:
        stream.write(f"# clacad points of {body.name}, unit mm, columns x y z nx ny nz (outward)\n")
        for j in range(window.lattice.count[1]):
            for line in point_lines(window, face, per_cell, window.lattice.row(j), scale):
                stream.write(line + "\n")
                total += 1
    return total


def point_lines(
    window: Window, face: Face, per_cell: int, cells: NDArray[np.int64], scale: float
) -> Iterator[str]:
    """Lines of the given cells (k, 2) of a face."""
    assert face.array is not None
    if len(cells):
        local, z, normal = _cell_points(window, face, per_cell)
    for index, centre in zip(cells, window.centres(face.array, cells) * scale if len(cells) else ()):
        if face.change is not None:
            local, z, normal = _cell_points(window, face, per_cell, index)
        table = np.column_stack([local * scale + centre, z * scale, normal])
        yield from map(_LINE.__mod__, map(tuple, table.tolist()))


_LINE = "%.9f %.9f %.9f %.12f %.12f %.12f"


def _cell_points(
    window: Window, face: Face, per_cell: int, index: NDArray[np.int64] | None = None
) -> tuple[Floats, Floats, Floats]:
    """Points (n, 2) of a grid inside a cell, about its centre; heights (n,) there; outward unit normals (n,
    3).

    index : (2,) or None. The cell, on a non-uniform sheet.
    """
    face = face if index is None else window.in_cell(face, index)
    assert face.array is not None
    lattice = window.lattice_of(face.array)
    tile = lattice.tile()
    x0, x1, y0, y1 = tile[:, 0].min(), tile[:, 0].max(), tile[:, 1].min(), tile[:, 1].max()
    u = x0 + (x1 - x0) * (np.arange(per_cell) + 0.5) / per_cell
    v = y0 + (y1 - y0) * (np.arange(per_cell) + 0.5) / per_cell
    gx, gy = (g.ravel() for g in np.meshgrid(u, v))
    inside = (lattice.past_borders(gx, gy) < 0.0).all(axis=0)
    gx, gy = gx[inside], gy[inside]
    z = face_height(window, face, gx, gy)
    lens, normal = lens_height_and_normal(face, gx, gy)
    flat = ~(z == lens)
    normal = np.where(flat[:, None], np.array([0.0, 0.0, 1.0]), normal) * -face.side
    keep = np.isfinite(z)
    return np.column_stack([gx, gy])[keep], z[keep], normal[keep]


def check_points(window: Window, face: Face, path: Path, scale: float, count: int) -> None:
    """Read a point file back and compare 2,000 of its points with the lens formula of their cells.

    Raises FileDisagrees, UnreadableFile.
    """
    assert face.array is not None
    table = _points_of(path, _picked_lines(path, count))
    if table.shape[1] != 6:
        raise FileDisagrees(f"{path.name}: points without normals")
    index, u, v = _located(window, face, table[:, 0] / scale, table[:, 1] / scale)
    z = face_height(window, face, u, v, index) * scale
    if not (np.abs(table[:, 2] - z) <= 2e-9 + 1e-8 * abs(window.lattice.pitch[0] * scale)).all():
        raise FileDisagrees(f"{path.name}: a point does not lie on the face")
    if (np.abs(np.linalg.norm(table[:, 3:], axis=1) - 1.0) > 1e-9).any() or (
        table[:, 5] * -face.side <= 0
    ).any():
        raise FileDisagrees(f"{path.name}: a normal that is not a unit vector pointing outwards")


def _picked_lines(path: Path, count: int) -> list[str]:
    stride = max(1, count // 2000)
    picked, seen = [], 0
    with path.open(encoding="ascii", errors="replace") as stream:
        for line in stream:
            if line.startswith("#"):
                continue
            if seen % stride == 0:
                picked.append(line)
            seen += 1
    if seen != count:
        raise FileDisagrees(f"{path.name}: {seen} points were read back, {count} were written")
    return picked


def read_points(path: Path) -> Iterator[Floats]:
    """Read a point file in blocks, tables (k ≤ 65536, 6) of x y z (millimetres) and outward unit normal.

    Tables of a plain cloud, without normals, are (k, 3). Empty lines and lines that begin with # are skipped.

    Raises UnreadableFile.
    Raises OverBudget: More bytes, points or seconds than are read.
    """
    spent = Spending("points", path)
    columns = 0
    with path.open("rb") as stream:
        lines = (line for line in spent.lines(stream) if line.strip() and not line.startswith(b"#"))
        while block := list(islice(lines, 1 << 16)):
            spent.count(len(block))
            table = _points_of(path, block)
            columns = columns or table.shape[1]
            if table.shape[1] != columns:
                raise UnreadableFile(f"{path.name}: {_NO_POINT}")
            yield table


_NO_POINT = "a line that is neither x y z nor x y z and a normal, as the first line is"


def _points_of(path: Path, lines: Sequence[str | bytes]) -> Floats:
    """Lines of a point file as a table (k, 3) or (k, 6)."""
    try:
        table = np.array([[float(w) for w in line.split()] for line in lines])
    except ValueError as error:
        raise UnreadableFile(f"{path.name}: {_NO_POINT}") from error
    if table.ndim != 2 or table.shape[1] not in (3, 6):
        raise UnreadableFile(f"{path.name}: {_NO_POINT}")
    return table


def write_grid_sag(window: Window, face: Face, per_cell: int, path: Path, scale: float) -> None:
    """Write one cell as a Zemax grid sag file: sag and its derivatives at (n + 1) × (n + 1) nodes.

    Sag is along +z from the apex plane, x right, rows from the greatest y down; unit millimetres (flag 0).
    A node without a surface carries the no-data flag 1.
    """
    tile = window.lattice.tile()
    n = per_cell + 1
    half_x, half_y = float(tile[:, 0].max()), float(tile[:, 1].max())
    x, y = np.meshgrid(np.linspace(-half_x, half_x, n), np.linspace(half_y, -half_y, n))
    z, normal = lens_height_and_normal(face, x.ravel(), y.ravel())
    with np.errstate(invalid="ignore"):
        slope = -normal[:, :2] / normal[:, 2:]
    dx, dy = 2 * half_x / per_cell * scale, 2 * half_y / per_cell * scale
    with path.open("w", encoding="ascii", newline="\n") as stream:
        stream.write(f"{n} {n} {dx!r} {dy!r} 0 0 0\n")
        for sag, (sx, sy) in zip(((z - face.vertex[2]) * scale).tolist(), slope.tolist()):
            gone = sag != sag
            stream.write("0 0 0 0 1\n" if gone else f"{sag:.15e} {sx:.15e} {sy:.15e} 0 0\n")


def check_grid_sag(face: Face, path: Path, scale: float) -> None:
    """Read a grid sag file back and compare it with the surface's own `sag` in its lens frame.

    Raises FileDisagrees, UnreadableFile.
    """
    found, _ = read_grid_sag(face, path, scale)
    there = np.isfinite(found[:, 2])
    local = (found - np.asarray(face.vertex))[there] @ face.rotation
    sag = face.surface.sag(local[:, 0], local[:, 1])
    reach = float(np.max(np.abs(found[:, :2] - np.asarray(face.vertex)[:2])))
    if not there.any() or not (np.abs(sag - local[:, 2]) <= 1e-12 * reach).all():
        raise FileDisagrees(f"{path.name}: its sag is not that of the lens")


def read_grid_sag(face: Face, path: Path, scale: float) -> tuple[Floats, Floats]:
    """Read a grid sag file.

    face : Face whose apex plane sag is counted from.
    scale : Millimetres per design unit.

    Returns
    -------
    points : (n, 3) lengths
        Nodes in the cell frame, z in the sheet frame; NaN where the surface has no point.
    step : (2,) lengths
        Spacing of nodes.

    Raises UnreadableFile.
    Raises OverBudget: More bytes, nodes or seconds than are read.
    """
    nx, ny, dx, dy, table = _grid_numbers(path)
    if table.shape != (nx * ny, 5):
        raise UnreadableFile(f"{path.name}: {len(table)} lines for {nx} × {ny} nodes")
    x = np.tile((np.arange(nx) - 0.5 * (nx - 1)) * dx, ny) / scale
    y = -np.repeat((np.arange(ny) - 0.5 * (ny - 1)) * dy, nx) / scale
    z = np.where(table[:, 4] == 0, table[:, 0] / scale + face.vertex[2], np.nan)
    return np.column_stack([x, y, z]), np.array([dx, dy]) / scale


def _grid_numbers(path: Path) -> tuple[int, int, float, float, Floats]:
    """Nodes and steps along x and y from the head of a grid sag file, and its lines (k, 5)."""
    spent = Spending("grid-sag", path)
    numbers: array[float] = array("d")
    with path.open("rb") as stream:
        lines = spent.lines(stream)
        try:
            nx, ny, dx, dy, *_ = (float(w) for w in next(lines, b"").split())
            for line in lines:
                spent.count(1)
                sag, sx, sy, sxy, gone = (float(w) for w in line.split())
                numbers.extend((sag, sx, sy, sxy, gone))
            return int(nx), int(ny), dx, dy, np.array(numbers).reshape(-1, 5)
        except UnreadableFile:
            raise
        except (ValueError, OverflowError) as error:
            raise UnreadableFile(f"{path.name}: not a grid sag file") from error
