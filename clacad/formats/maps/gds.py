"""GDSII grey levels: a layer for each height of a face, one cell drawn and repeated. Needs the extra `gds`.

A face's heights are cut into N equal levels; every pixel of a lenslet's cell goes to the layer of its level, layer 0
the lowest. Lengths in the file are micrometres on a grid of a nanometre. The calibration file gives the height of
each layer.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.formats.maps.sag import HeightMap, height_map, outward_height
from clacad.sheet.window import Body, Face, Window
from clacad.storage.errors import FileDisagrees, NotPossible, UnreadableFile
from clacad.storage.spending import Spending

PER_CELL = 64
"""Pixels across a cell."""
MOST_LEVELS = 256
"""Layers that every GDSII reader takes."""
GRID = 1e-3
"""Database unit, micrometres."""
_DATE = datetime(2000, 1, 1)
_LAYER, _BOUNDARY, _ENDLIB = 0x0D02, 0x0800, 0x0400


@dataclass(frozen=True, eq=False)
class GreyCell:
    """One lenslet's cell as levels.

    Parameters
    ----------
    map : HeightMap
        The face's heights, their range and reference plane.
    levels : int
        Number of layers.
    pixel : (width, height), micrometres
    level : (rows, columns) int
        Layer of each pixel, row 0 the lowest y; −1 outside the cell and in holes.
    """

    map: HeightMap
    levels: int
    pixel: tuple[float, float]
    level: Ints

    @property
    def step(self) -> float:
        """Height from one layer to the next, design units."""
        return (self.map.high - self.map.low) / (self.levels - 1)

    def calibration(self, scale: float) -> dict[str, object]:
        """What a machine needs to use the layers; `scale` = millimetres per design unit."""
        counts = Counter(self.level[self.level >= 0].ravel().tolist())
        return {
            "face": self.map.label, "levels": self.levels, "layer_of_low": 0, "low_mm": self.map.low * scale,
            "high_mm": self.map.high * scale, "step_mm": self.step * scale, "pixel_um": list(self.pixel),
            "reference_z_mm": self.map.reference * scale, "outward": "-z" if self.map.face.side > 0 else "+z",
            "unit_um": 1.0, "grid_um": GRID, "pixels_of_layer": [counts.get(n, 0) for n in range(self.levels)],
        }  # fmt: skip

    def boxes(self) -> Iterator[tuple[int, float, float, float, float]]:
        """Layer and (x0, y0, x1, y1) in micrometres of runs of equal pixels, the cell's centre at 0."""
        rows, columns = self.level.shape
        x = _on_grid((np.arange(columns + 1) - 0.5 * columns) * self.pixel[0])
        y = _on_grid((np.arange(rows + 1) - 0.5 * rows) * self.pixel[1])
        for j, row in enumerate(self.level):
            ends = np.flatnonzero(np.append(np.diff(row) != 0, True)) + 1
            start = 0
            for end in ends.tolist():
                if row[start] >= 0:
                    yield int(row[start]), float(x[start]), float(y[j]), float(x[end]), float(y[j + 1])
                start = end


def _on_grid(value: Floats) -> Floats:
    return np.asarray(np.rint(value / GRID) * GRID)


def require_gdstk() -> None:
    """Say which extra is missing.

    Raises
    ------
    NotPossible
    """
    if find_spec("gdstk") is None:
        raise NotPossible('format gds needs the package gdstk\n  install it with: pip install "clacad[gds]"')


def grey_cell(window: Window, body: Body, face: Face, label: str, levels: int, scale: float) -> GreyCell:
    """Cut a face's heights into levels, pixel by pixel of one cell.

    Parameters
    ----------
    levels : int
        2 to 256.
    scale : float
        Millimetres per design unit.

    Raises
    ------
    NotPossible
        Fewer than 2 or more than 256 levels, a flat face, or pixels below the file's grid.
    """
    if not 2 <= levels <= MOST_LEVELS:
        raise NotPossible(f"gds: {levels} grey levels; 2 to {MOST_LEVELS} layers can be written")
    map_ = height_map(window, body, face, label, PER_CELL)
    if not map_.high > map_.low:
        raise NotPossible(f"gds: {label} is flat; there is one level only")
    tile = window.lattice.tile()
    width, height = (float(np.ptp(tile[:, axis])) for axis in (0, 1))
    across, along = width / PER_CELL, window.lattice.a2[1] / PER_CELL
    rows = 2 * int(np.ceil(0.5 * height / along - 1e-9))
    if min(across, along) * scale * 1e3 < 4.0 * GRID:
        raise NotPossible(f"gds: pixels of {across * scale * 1e6:.3g} nm lie below the file's grid of 1 nm")
    x, y = np.meshgrid(
        (np.arange(PER_CELL) + 0.5 - 0.5 * PER_CELL) * across, (np.arange(rows) + 0.5 - 0.5 * rows) * along
    )
    level = _levels_at(window.with_cells((1, 1)), body, map_, levels, x.ravel(), y.ravel())
    um = scale * 1e3
    return GreyCell(map_, levels, (across * um, along * um), level.reshape(x.shape))


def _levels_at(one: Window, body: Body, map_: HeightMap, levels: int, x: Floats, y: Floats) -> Ints:
    """Level (n,) of a face at points (n,) from the centre of its cell, 0 the lowest; −1 outside the cell or the lens."""
    assert map_.face.array is not None
    index, _, _ = one.lattice.locate(x, y)
    dx, dy = one.shifts[map_.face.array]
    found = outward_height(one, body, map_.face, x + dx, y + dy, map_.reference)
    inside = (index == 0).all(axis=1) & np.isfinite(found)
    part = np.where(inside, (found - map_.low) / (map_.high - map_.low), 0.0)
    return np.where(inside, np.clip(np.rint(part * (levels - 1)), 0, levels - 1), -1).astype(np.int64)


def write_gds(cell: GreyCell, path: Path, scale: float) -> int:
    """Write the cell once and a reference a row of cells; the number of cells placed.

    Raises
    ------
    NotPossible
        The extra `gds` is not installed.
    OSError
    """
    require_gdstk()
    import gdstk

    library = gdstk.Library("clacad", unit=1e-6, precision=GRID * 1e-6)
    lenslet, sheet = library.new_cell("lenslet"), library.new_cell(cell.map.label.replace("-", "_"))
    for layer, x0, y0, x1, y1 in cell.boxes():
        lenslet.add(gdstk.rectangle((x0, y0), (x1, y1), layer=layer))
    placed = 0
    for origin, number, pitch in _runs(cell.map.window, cell.map.face, scale * 1e3):
        sheet.add(gdstk.Reference(lenslet, origin, columns=number, rows=1, spacing=(pitch, pitch)))
        placed += number
    library.write_gds(str(path), timestamp=_DATE)
    return placed


def _runs(window: Window, face: Face, um: float) -> Iterator[tuple[tuple[float, float], int, float]]:
    """Neighbouring cells of a row: place of the first, how many, pitch, micrometres."""
    lattice = window.lattice
    assert face.array is not None
    for j in range(lattice.count[1]):
        row = lattice.row(j)
        for run in np.split(row, np.flatnonzero(np.diff(row[:, 0]) != 1) + 1):
            if len(run):
                x, y = (lattice.centres(run[0]) + np.asarray(window.shifts[face.array])) * um
                yield (float(x), float(y)), len(run), lattice.pitch[0] * um


def check_gds(cell: GreyCell, path: Path, placed: int) -> None:
    """Read a file back, by gdstk and by its bare records, and hold its levels against the lens formula.

    Raises
    ------
    FileDisagrees, UnreadableFile
    """
    import gdstk

    try:
        library: Any = gdstk.read_gds(str(path))
    except (OSError, RuntimeError, ValueError) as error:
        raise UnreadableFile(f"{path.name}: {error}") from error
    by_name = {found.name: found for found in library.cells}
    lenslet = by_name["lenslet"]
    sheet = by_name[cell.map.label.replace("-", "_")]
    stands = sum(reference.repetition.size or 1 for reference in sheet.references)
    rows, columns = cell.level.shape
    drawn = np.full((rows, columns), -1, dtype=np.int64)
    for polygon in lenslet.polygons:
        (x0, y0), (x1, _) = polygon.bounding_box()
        i0, i1 = (round(x / cell.pixel[0] + 0.5 * columns) for x in (x0, x1))
        j0 = round(y0 / cell.pixel[1] + 0.5 * rows)
        drawn[j0, i0:i1] = polygon.layer
    if stands != placed or not np.array_equal(drawn, cell.level):
        raise FileDisagrees(
            f"{path.name}: {stands} cells were read back, {placed} written, or their levels differ"
        )
    if layer_counts(path) != Counter(polygon.layer for polygon in lenslet.polygons):
        raise FileDisagrees(f"{path.name}: its records and its polygons do not agree on the layers")


def gds_misfit(cell: GreyCell, path: Path, scale: float) -> tuple[float, int]:
    """Greatest distance of any cell from its place, millimetres, and the number of cells; inf for other cells.

    Raises
    ------
    FileDisagrees, UnreadableFile
        The levels are not those of the face.
    NotPossible
        The extra `gds` is not installed.
    """
    require_gdstk()
    import gdstk

    window, face = cell.map.window, cell.map.face
    check_gds(cell, path, window.lattice.cell_count)
    assert face.array is not None
    library: Any = gdstk.read_gds(str(path))
    (sheet,) = (found for found in library.cells if found.name == cell.map.label.replace("-", "_"))
    places = [
        np.asarray(one.origin) + (one.repetition.get_offsets() if one.repetition.size else np.zeros((1, 2)))
        for one in sheet.references
        if one.cell_name == "lenslet"
    ]
    rows = [window.lattice.centres(window.lattice.row(j)) for j in range(window.lattice.count[1])]
    want = (np.concatenate(rows) + np.asarray(window.shifts[face.array])) * scale
    got = np.concatenate([*places, np.zeros((0, 2))]) * 1e-3
    turned = any(one.rotation or one.x_reflection or one.magnification != 1.0 for one in sheet.references)
    if got.shape != want.shape or turned:
        return float("inf"), len(got)
    return float(np.abs(got - want).max(initial=0.0)), len(got)


def layer_counts(path: Path) -> Counter[int]:
    """Number of boundaries on each layer, from the file's bare records.

    Raises
    ------
    UnreadableFile
        The file is cut short or is no GDSII stream.
    OverBudget
        More bytes or records than are read.
    """
    spent = Spending("gds", path)
    data = path.read_bytes()
    counts: Counter[int] = Counter()
    at, boundary = 0, False
    while at + 4 <= len(data):
        size, kind = struct.unpack_from(">HH", data, at)
        spent.count(1)
        if size < 4 or at + size > len(data):
            break
        if kind == _ENDLIB:
            return counts
        if kind == _BOUNDARY:
            boundary = True
        elif kind == _LAYER and boundary:
            counts[struct.unpack_from(">h", data, at + 4)[0]] += 1
            boundary = False
        at += size
    raise UnreadableFile(f"{path.name}: a GDSII stream that ends in the middle")


def gds_bytes(window: Window, levels: int, scale: float) -> int:
    """Size of the GDSII files and their calibration, from the runs of one cell of each face."""
    from clacad.formats.maps.sag import structured_faces

    total = 0
    for body, face, label in structured_faces(window):
        cell = grey_cell(window, body, face, label, levels, scale)
        total += 400 + 64 * sum(1 for _ in cell.boxes()) + 60 * sum(1 for _ in _runs(window, face, 1.0))
    return total
