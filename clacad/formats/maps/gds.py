"""GDSII grey levels: a layer for each height of a face; written, and read back. Needs the extra `gds`.

A face's heights are cut into N equal levels; every pixel of a lenslet's cell goes to the layer of its level,
layer 0 the lowest. One cell is drawn and repeated by rows. On non-uniform sheets every cell is drawn and
placed once, in levels that are the same for all. Lengths in the file are micrometres on a grid of a
nanometre. The calibration file gives the height of each layer. gdstk and the bare records of the file read it
back for comparison with the lens formula.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from clacad.base.types import Bools, Floats, Ints
from clacad.formats.maps.sag import HeightMap, outward_height, plain_map, range_of_cell
from clacad.sheet.pattern import relocate
from clacad.sheet.representative_cells import representative_cells
from clacad.sheet.window import Body, Face, Window, column, face_height
from clacad.storage.errors import FileDisagrees, NotPossible, UnreadableFile
from clacad.storage.reading import Spending

PER_CELL = 64
"""Pixels across a cell."""
MOST_LEVELS = 256
"""Layers that every GDSII reader accepts."""
LENSLET = "lenslet"
"""Name of the cell that is repeated; with a number appended, of a cell that is placed once."""
SIZED = 8
"""Cells from which the size of a file of a non-uniform sheet is estimated."""
GRID = 1e-3
"""Database unit, micrometres."""
_DATE = datetime(2000, 1, 1)


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
        Layer of each pixel, row 0 the lowest y; −1 outside the cell and in holes. Of the first cell on a
        non-uniform sheet.
    """

    map: HeightMap
    levels: int
    pixel: tuple[float, float]
    level: Ints

    @property
    def step(self) -> float:
        """Height from one layer to the next, design units."""
        return (self.map.high - self.map.low) / (self.levels - 1)

    @property
    def own(self) -> bool:
        """Whether the cells of the face differ, so that each is drawn separately."""
        return own_cells(self.map.body)

    def of_cell(self, index: Ints) -> GreyCell:
        """The cell at `index` (2,); on a uniform sheet every cell is this one."""
        return replace(self, level=_levels_in(self.map, self.levels, index)) if self.own else self

    def each(self) -> Iterator[tuple[str, tuple[float, float], GreyCell]]:
        """Name, middle (micrometres per millimetre of the design's unit) and levels of every kept cell, row
        by row.
        """
        window, face = self.map.window, self.map.face
        assert face.array is not None
        cells = window.lattice.cells()
        for n, (index, place) in enumerate(
            zip(cells, window.centres(face.array, cells).tolist(), strict=True)
        ):
            yield f"{LENSLET}_{n}", (place[0], place[1]), self.of_cell(index)

    def calibration(self, scale: float) -> dict[str, object]:
        """Data that a machine needs to use the layers; `scale` = millimetres per design unit.

        Pixels of the one cell, or of all cells that differ.
        """
        counts: Counter[int] = Counter()
        for _, _, one in self.each() if self.own else (("", (0.0, 0.0), self),):
            counts.update(one.level[one.level >= 0].ravel().tolist())
        return {
            "face": self.map.label,
            "levels": self.levels,
            "layer_of_low": 0,
            "low_mm": self.map.low * scale,
            "high_mm": self.map.high * scale,
            "step_mm": self.step * scale,
            "pixel_um": list(self.pixel),
            "reference_z_mm": self.map.reference * scale,
            "outward": "-z" if self.map.face.side > 0 else "+z",
            "unit_um": 1.0,
            "grid_um": GRID,
            "pixels_of_layer": [counts.get(n, 0) for n in range(self.levels)],
        }

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
    """Raise an error that names the missing extra.

    Raises
    ------
    NotPossible
    """
    if find_spec("gdstk") is None:
        raise NotPossible('format gds needs the package gdstk\n  install it with: pip install "clacad[gds]"')


def own_cells(body: Body) -> bool:
    """Whether the lenses of a body vary from cell to cell."""
    return body.front.change is not None or body.back.change is not None


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
    map_ = plain_map(window, body, face, label, PER_CELL)
    low, high = _range_of_cells(map_) if own_cells(body) else range_of_cell(window, body, face, PER_CELL)
    map_ = replace(map_, low=low, high=high)
    if not map_.high > map_.low:
        raise NotPossible(f"gds: {label} is flat; there is one level only")
    x, y, pixel = _pixels(map_)
    um = scale * 1e3
    if min(pixel) * um < 4.0 * GRID:
        raise NotPossible(
            f"gds: pixels of {min(pixel) * scale * 1e6:.3g} nm lie below the file's grid of 1 nm"
        )
    if own_cells(body):
        level = _levels_in(map_, levels, window.lattice.cells()[0])
    else:
        level = _levels_at(window.with_cells((1, 1)), body, map_, levels, x.ravel(), y.ravel()).reshape(
            x.shape
        )
    return GreyCell(map_, levels, (pixel[0] * um, pixel[1] * um), level)


def _pixels(map_: HeightMap) -> tuple[Floats, Floats, tuple[float, float]]:
    """Middles x, y (rows, columns) of the pixels from the middle of a cell; width and height, lengths."""
    assert map_.face.array is not None
    lattice = map_.window.lattice_of(map_.face.array)
    tile = lattice.tile()
    width, height = (float(np.ptp(tile[:, axis])) for axis in (0, 1))
    across, along = width / PER_CELL, lattice.a2[1] / PER_CELL
    rows = 2 * int(np.ceil(0.5 * height / along - 1e-9))
    x, y = np.meshgrid(
        (np.arange(PER_CELL) + 0.5 - 0.5 * PER_CELL) * across, (np.arange(rows) + 0.5 - 0.5 * rows) * along
    )
    return x, y, (across, along)


def _range_of_cells(map_: HeightMap) -> tuple[float, float]:
    """Range of heights of a face on a non-uniform sheet.

    Heights are taken at the corners and along the sides of every cell, and at its point nearest to its lens's
    apex, where a lens is highest or lowest.
    """
    window, face = map_.window, map_.face
    assert face.array is not None
    tile = window.lattice_of(face.array).tile()
    sides = np.concatenate([tile * (1.0 - t) + np.roll(tile, -1, axis=0) * t for t in (0.0, 0.25, 0.5, 0.75)])
    cells = window.lattice.cells()
    apex = np.clip(window.vertices(face, cells)[:, :2], tile.min(axis=0), tile.max(axis=0))
    index = np.repeat(cells, len(sides) + 1, axis=0)
    points = np.concatenate([np.broadcast_to(sides, (len(cells), *sides.shape)), apex[:, None]], axis=1)
    found = _outward(map_, points.reshape(-1, 2), index)
    lands = [] if face.land is None else [-face.side * (face.land - map_.reference)]
    ends = np.append(found[np.isfinite(found)], lands)
    return float(ends.min(initial=np.inf)), float(ends.max(initial=-np.inf))


def _outward(map_: HeightMap, points: Floats, index: Ints) -> Floats:
    """Heights (n,) of a face over points (n, 2) of cells (n, 2), away from the material; NaN in holes."""
    window, body, face = map_.window, map_.body, map_.face
    if body.columnar:
        z = column(window, body, points[:, 0], points[:, 1], index)[0 if face is body.front else 1]
    else:
        z = face_height(window, face, points[:, 0], points[:, 1], index)
    return np.asarray(-face.side * (z - map_.reference))


def _levels_in(map_: HeightMap, levels: int, cell: Ints) -> Ints:
    """Levels (rows, columns) of the kept cell (2,) of a face on a non-uniform sheet."""
    assert map_.face.array is not None
    x, y, _ = _pixels(map_)
    points = np.column_stack([x.ravel(), y.ravel()])
    steps, _ = relocate(map_.window.lattice_of(map_.face.array), points)
    found = _outward(map_, points, np.broadcast_to(cell, points.shape))
    return _cut(map_, levels, found, (steps == 0).all(axis=1)).reshape(x.shape)


def _levels_at(one: Window, body: Body, map_: HeightMap, levels: int, x: Floats, y: Floats) -> Ints:
    """Level (n,) of a face at points (n,) from the centre of its cell, 0 the lowest; −1 outside the lens."""
    assert map_.face.array is not None
    index, _, _ = one.lattice_of(map_.face.array).locate(x, y)
    dx, dy = one.shifts[map_.face.array]
    found = outward_height(one, body, map_.face, x + dx, y + dy, map_.reference)
    return _cut(map_, levels, found, (index == 0).all(axis=1))


def _cut(map_: HeightMap, levels: int, found: Floats, inside: Bools) -> Ints:
    """Levels (n,) of heights (n,), −1 outside and in holes."""
    inside = inside & np.isfinite(found)
    part = np.where(inside, (found - map_.low) / (map_.high - map_.low), 0.0)
    return np.where(inside, np.clip(np.rint(part * (levels - 1)), 0, levels - 1), -1).astype(np.int64)


def write_gds(cell: GreyCell, path: Path, scale: float) -> int:
    """Write the cell once and a reference a row of cells, or each cell that differs; return the number of
    cells placed.

    Raises
    ------
    NotPossible
        The extra `gds` is not installed.
    OSError
    """
    require_gdstk()
    import gdstk

    name = sheet_name(cell)
    if cell.own:
        return _write_each(cell, path, scale, name)
    library = gdstk.Library("clacad", unit=1e-6, precision=GRID * 1e-6)
    lenslet, sheet = library.new_cell(LENSLET), library.new_cell(name)
    _draw(cell, lenslet)
    placed = 0
    for origin, number, pitch in _runs(cell.map.window, cell.map.face, scale * 1e3):
        sheet.add(gdstk.Reference(lenslet, origin, columns=number, rows=1, spacing=(pitch, pitch)))
        placed += number
    library.write_gds(str(path), timestamp=_DATE)
    return placed


def _write_each(cell: GreyCell, path: Path, scale: float, name: str) -> int:
    """Write cells that vary one after another, in the memory of one, then the sheet of references to them."""
    import gdstk

    writer = gdstk.GdsWriter(str(path), "clacad", unit=1e-6, precision=GRID * 1e-6, timestamp=_DATE)
    sheet = gdstk.Cell(name)
    for drawn, (x, y), one in cell.each():
        lenslet = gdstk.Cell(drawn)
        _draw(one, lenslet)
        writer.write(lenslet)
        sheet.add(gdstk.Reference(gdstk.Cell(drawn), (x * scale * 1e3, y * scale * 1e3)))
    writer.write(sheet)
    writer.close()
    return len(sheet.references)


def _draw(cell: GreyCell, lenslet: Any) -> None:
    """Draw the boxes of a cell's levels into a cell of the file."""
    import gdstk

    for layer, x0, y0, x1, y1 in cell.boxes():
        lenslet.add(gdstk.rectangle((x0, y0), (x1, y1), layer=layer))


def sheet_name(cell: GreyCell) -> str:
    """Name of the cell of a file that contains all others."""
    return cell.map.label.replace("-", "_")


def _runs(window: Window, face: Face, um: float) -> Iterator[tuple[tuple[float, float], int, float]]:
    """Runs of neighbouring cells of a row: position of the first, number, pitch, micrometres."""
    lattice = window.lattice
    assert face.array is not None
    for j in range(lattice.count[1]):
        row = lattice.row(j)
        for run in np.split(row, np.flatnonzero(np.diff(row[:, 0]) != 1) + 1):
            if len(run):
                x, y = window.centres(face.array, run[0]) * um
                yield (float(x), float(y)), len(run), window.lattice_of(face.array).pitch[0] * um


def gds_bytes(window: Window, levels: int, scale: float) -> int:
    """Size of the GDSII files and their calibration, from the runs of one cell of each face."""
    from clacad.formats.maps.sag import structured_faces

    total = 0
    for body, face, label in structured_faces(window):
        cell = grey_cell(window, body, face, label, levels, scale)
        if cell.own:
            total += 400 + _own_bytes(cell)
            continue
        total += 400 + 64 * sum(1 for _ in cell.boxes()) + 60 * sum(1 for _ in _runs(window, face, 1.0))
    return total


def _own_bytes(cell: GreyCell) -> int:
    """Size of cells that vary, from the runs of a few of them."""
    window = cell.map.window
    tried = representative_cells(window, "sample", SIZED)
    boxes = sum(1 for index in tried for _ in cell.of_cell(index).boxes())
    return int(window.lattice.cell_count * (64 * boxes / len(tried) + 130))


_LAYER, _BOUNDARY, _ENDLIB = 0x0D02, 0x0800, 0x0400


def check_gds(cell: GreyCell, path: Path, placed: int) -> None:
    """Read a file back, by gdstk and by its bare records, and compare its levels with the lens formula.

    Raises
    ------
    FileDisagrees, UnreadableFile
    """
    by_name = _cells(path)
    sheet = _named(by_name, sheet_name(cell), path)
    stands = sum(reference.repetition.size or 1 for reference in sheet.references)
    if stands != placed:
        raise FileDisagrees(f"{path.name}: {stands} cells were read back, {placed} written")
    counted: Counter[int] = Counter()
    for name, _, one in cell.each() if cell.own else ((LENSLET, (0.0, 0.0), cell),):
        lenslet = _named(by_name, name, path)
        if not np.array_equal(_drawn(lenslet, one), one.level):
            raise FileDisagrees(f"{path.name}: {name} was read back with other levels than were written")
        counted.update(polygon.layer for polygon in lenslet.polygons)
    if layer_counts(path) != counted:
        raise FileDisagrees(f"{path.name}: its records and its polygons do not agree on the layers")


def _cells(path: Path) -> dict[str, Any]:
    import gdstk

    try:
        library: Any = gdstk.read_gds(str(path))
    except (OSError, RuntimeError, ValueError) as error:
        raise UnreadableFile(f"{path.name}: {error}") from error
    return {found.name: found for found in library.cells}


def _named(cells: Mapping[str, Any], name: str, path: Path) -> Any:
    if name not in cells:
        raise FileDisagrees(f"{path.name}: it has no cell {name}")
    return cells[name]


def _drawn(lenslet: Any, cell: GreyCell) -> Ints:
    """Levels (rows, columns) that the boxes of a cell of the file cover."""
    rows, columns = cell.level.shape
    drawn = np.full((rows, columns), -1, dtype=np.int64)
    for polygon in lenslet.polygons:
        (x0, y0), (x1, _) = polygon.bounding_box()
        i0, i1 = (round(x / cell.pixel[0] + 0.5 * columns) for x in (x0, x1))
        j0 = round(y0 / cell.pixel[1] + 0.5 * rows)
        if 0 <= j0 < rows:
            drawn[j0, max(0, i0) : i1] = polygon.layer
    return drawn


def gds_misfit(cell: GreyCell, path: Path, scale: float) -> tuple[float, int]:
    """Largest distance of any cell from its expected position, millimetres, and the number of cells; inf for
    other cells.

    Raises
    ------
    FileDisagrees, UnreadableFile
        The levels are not those of the face.
    NotPossible
        The extra `gds` is not installed.
    """
    require_gdstk()
    window, face = cell.map.window, cell.map.face
    check_gds(cell, path, window.lattice.cell_count)
    assert face.array is not None
    sheet = _cells(path)[sheet_name(cell)]
    places = [
        np.asarray(one.origin) + (one.repetition.get_offsets() if one.repetition.size else np.zeros((1, 2)))
        for n, one in enumerate(sheet.references)
        if one.cell_name == (f"{LENSLET}_{n}" if cell.own else LENSLET)
    ]
    want = window.centres(face.array, window.lattice.cells()) * scale
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
        The file is truncated or is no GDSII stream.
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
