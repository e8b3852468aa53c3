"""GDSII grey levels: a layer for each height of a face; written, and read back. Needs the extra `gds`.

A face's heights are cut into N equal levels; every pixel of a lenslet's cell goes to the layer of its level,
layer 0 the lowest. One cell is drawn and repeated by rows. Where the cells of a face differ each is drawn and
placed once, in levels that are the same for all: a stream made twice from the lens formula, once to write
the file and once to compare it. Lengths in the file are micrometres on a grid of a nanometre. The calibration
file gives the height of each layer. gdstk and the bare records of the file read it back.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Bools, Floats, Ints
from clacad.formats.maps.sag import HeightMap, plain_map, range_of_cell, structured_faces
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
TOGETHER = 32
"""Cells whose pixels are held at once."""
READ_WHOLE = 256 << 20
"""Largest file (bytes) of cells that differ that is read where it is not the stream that was expected."""
LOOK = 1 << 17
"""Bytes of a file that are looked at once; a record has less than half of them."""
SIZED = 8
"""Cells from which the size of a file of a non-uniform sheet is estimated."""
GRID = 1e-3
"""Database unit, micrometres."""
_DATE = datetime(2000, 1, 1)


@dataclass(frozen=True, eq=False)
class GreyCell:
    """One lenslet's cell as levels.

    map : The face's heights, their range and reference plane.
    levels : Number of layers.
    pixel : (width, height), micrometres
    level : (rows, columns) int. Layer of each pixel, row 0 the lowest y; −1 outside the cell and in holes. Of
        the first cell on a non-uniform sheet.
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
        return own_cells(self.map.body, self.map.face)

    def batches(self, cells: Ints | None = None) -> Iterator[Ints]:
        """Levels (b, rows, columns) of the given cells (n, 2), or of all kept ones, a few at once."""
        cells = self.map.window.lattice.cells() if cells is None else cells
        laid = _Pixels.of(self.map, self.levels)
        for low in range(0, len(cells), TOGETHER):
            yield laid.levels_in(cells[low : low + TOGETHER])

    def drawn(self) -> Iterator[Ints]:
        """Levels (b, rows, columns) of all drawn cells, a few at once: of one where all are alike."""
        yield from self.batches() if self.own else (self.level[None],)

    def name(self, number: int) -> str:
        """Name of a drawn cell in the file."""
        return f"{LENSLET}_{number}" if self.own else LENSLET

    @property
    def coordinates(self) -> tuple[Floats, Floats]:
        """Borders of the columns and of the rows of pixels, micrometres, the cell's centre at 0."""
        rows, columns = self.level.shape
        return (
            _on_grid((np.arange(columns + 1) - 0.5 * columns) * self.pixel[0]),
            _on_grid((np.arange(rows + 1) - 0.5 * rows) * self.pixel[1]),
        )

    def calibration(self, scale: float, counts: Ints | None = None) -> dict[str, object]:
        """Data that a machine needs to use the layers; `scale` = millimetres per design unit.

        counts : (levels,)
            Pixels of each layer: of the one cell, or of all cells that differ. None: they are counted.
        """
        if counts is None:
            none = np.zeros(self.levels, dtype=np.int64)
            counts = sum((_counted(level, self.levels) for level in self.drawn()), none)
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
            "pixels_of_layer": counts.tolist(),
        }


def _on_grid(value: Floats) -> Floats:
    return np.asarray(np.rint(value / GRID) * GRID)


def require_gdstk() -> None:
    """Raise an error that names the missing extra. Raises NotPossible."""
    if find_spec("gdstk") is None:
        raise NotPossible('format gds needs the package gdstk\n  install it with: pip install "clacad[gds]"')


def own_cells(body: Body, face: Face) -> bool:
    """Whether a face varies from cell to cell: its lenses, or in a column those of the other face."""
    faces = (body.front, body.back) if body.columnar else (face,)
    return any(one.change is not None for one in faces)


def _counted(level: Ints, levels: int) -> Ints:
    """Number (levels,) of pixels of each layer."""
    return np.bincount(level.ravel() + 1, minlength=levels + 1)[1:]


def grey_cell(window: Window, body: Body, face: Face, label: str, levels: int, scale: float) -> GreyCell:
    """Cut a face's heights into levels, pixel by pixel of one cell.

    levels : 2 to 256.
    scale : Millimetres per design unit.
    Raises NotPossible: Fewer than 2 or more than 256 levels, a flat face, or pixels below the file's grid.
    """
    if not 2 <= levels <= MOST_LEVELS:
        raise NotPossible(f"gds: {levels} grey levels; 2 to {MOST_LEVELS} layers can be written")
    map_ = plain_map(window, body, face, label, PER_CELL)
    low, high = (
        _range_of_cells(map_) if own_cells(body, face) else range_of_cell(window, body, face, PER_CELL)
    )
    map_ = replace(map_, low=low, high=high)
    if not map_.high > map_.low:
        raise NotPossible(f"gds: {label} is flat; there is one level only")
    _, _, pixel = _pixels(map_)
    um = scale * 1e3
    if min(pixel) * um < 4.0 * GRID:
        raise NotPossible(
            f"gds: pixels of {min(pixel) * scale * 1e6:.3g} nm lie below the file's grid of 1 nm"
        )
    level = _Pixels.of(map_, levels).levels_in(window.lattice.cells()[:1])[0]
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
    points = np.concatenate([np.broadcast_to(sides, (len(cells), *sides.shape)), apex[:, None]], axis=1)
    found = _outward(map_, points[..., 0], points[..., 1], cells[:, None])
    lands = [] if face.land is None else [-face.side * (face.land - map_.reference)]
    ends = np.append(found[np.isfinite(found)], lands)
    return float(ends.min(initial=np.inf)), float(ends.max(initial=-np.inf))


def _outward(map_: HeightMap, x: Floats, y: Floats, index: Ints) -> Floats:
    """Heights (...) of a face over points (...) of cells (..., 2), away from the material; NaN in holes."""
    window, body, face = map_.window, map_.body, map_.face
    if body.columnar:
        z = column(window, body, x, y, index)[0 if face is body.front else 1]
    else:
        z = face_height(window, face, x, y, index)
    return np.asarray(-face.side * (z - map_.reference))


@dataclass(frozen=True, eq=False)
class _Pixels:
    """Middles of the pixels of a cell, (rows, columns) each, and which lie inside it."""

    map: HeightMap
    levels: int
    x: Floats
    y: Floats
    inside: Bools

    @classmethod
    def of(cls, map_: HeightMap, levels: int) -> _Pixels:
        """Pixels of a face's cells; a quadric is evaluated as one."""
        assert map_.face.array is not None
        x, y, _ = _pixels(map_)
        steps, _ = relocate(map_.window.lattice_of(map_.face.array), np.column_stack([x.ravel(), y.ravel()]))
        front, back = map_.body.front.simplified, map_.body.back.simplified
        body = replace(map_.body, front=front, back=back)
        map_ = replace(map_, body=body, face=front if map_.face is map_.body.front else back)
        return cls(map_, levels, x, y, (steps == 0).all(axis=1).reshape(x.shape))

    def levels_in(self, cells: Ints) -> Ints:
        """Levels (n, rows, columns) of kept cells (n, 2), −1 outside and in holes."""
        map_, levels = self.map, self.levels
        found = _outward(map_, self.x, self.y, cells[:, None, None])
        found = np.broadcast_to(found, (len(cells), *self.x.shape))
        inside = self.inside & np.isfinite(found)
        part = np.where(inside, (found - map_.low) / (map_.high - map_.low), 0.0)
        return np.where(inside, np.clip(np.rint(part * (levels - 1)), 0, levels - 1), -1).astype(np.int64)


def write_gds(cell: GreyCell, path: Path, scale: float) -> tuple[int, Ints, str]:
    """Write the cell once and a reference a row of cells, or each cell that differs; return the number of
    cells placed, that of pixels of each layer (levels,), and the SHA-256 of what was written.

    Raises NotPossible: The extra `gds`, which reads files back, is not installed.
    Raises OSError.
    """
    require_gdstk()
    counts = np.zeros(cell.levels, dtype=np.int64)
    digest = sha256()
    with path.open("wb") as stream:
        for part in _stream(cell, scale, counts):
            stream.write(part)
            digest.update(part)
    return cell.map.window.lattice.cell_count, counts, digest.hexdigest()


def _stream(cell: GreyCell, scale: float, counts: Ints) -> Iterator[bytes]:
    """Yield the records of a file, in the memory of a few cells; `counts` (levels,) grows by their pixels."""
    yield b"".join((_record(0x0002, b"\2\x58"), _record(0x0102, _DATES), _named(0x0206, "clacad"), _UNITS))
    x, y = (np.rint(one / GRID).astype(">i4").view(np.int32) for one in cell.coordinates)
    number = 0
    for level in cell.drawn():
        counts += _counted(level, cell.levels)
        boxes, ends = _boxes(level, x, y)
        parts = []
        for low, high in zip([0, *ends[:-1]], ends, strict=True):
            parts += [_BEGIN, _named(0x0606, cell.name(number)), boxes[low:high].tobytes(), _END]
            number += 1
        yield b"".join(parts)
    yield _BEGIN + _named(0x0606, sheet_name(cell))
    for n, place in enumerate(_on_nanometres(cell, scale).astype(">i4") if cell.own else ()):
        yield b"".join((_REFERENCE, _named(0x1206, cell.name(n)), _PLACE, place.tobytes(), _END_ELEMENT))
    for (x0, y0), many, pitch in () if cell.own else _runs(cell.map.window, cell.map.face, scale * 1e3):
        columns = _record(0x1302, struct.pack(">HH", many, 1))
        corners = np.array([[x0, y0], [x0 + many * pitch, y0], [x0, y0 + pitch]]) * _SCALING
        place = _record(0x1003, _rounded(corners).astype(">i4").tobytes())
        yield b"".join((_ARRAY, _named(0x1206, LENSLET), columns, place, _END_ELEMENT))
    yield _END + _record(_ENDLIB)


def _boxes(level: Ints, x: NDArray[np.int32], y: NDArray[np.int32]) -> tuple[NDArray[np.int32], list[int]]:
    """Boxes of runs of equal pixels, each the 16 words of a file, and each cell's end among them.

    level : (b, rows, columns)
    x, y : borders of columns and rows, nanometres, their bytes swapped
    """
    number, rows, columns = level.shape
    last = np.ones(level.shape, dtype=bool)
    np.not_equal(level[..., 1:], level[..., :-1], out=last[..., :-1])
    end = np.flatnonzero(last)
    layer = level.ravel()[end]
    kept = layer >= 0
    start = np.append(0, end[:-1] + 1)[kept]
    end, layer = end[kept], layer[kept]
    line, column_ = np.divmod(start, columns)
    row = line % rows
    words = np.empty((len(start), len(_BOX)), dtype=np.int32)
    words[:] = _BOX
    words[:, 2] = _LAYERS[layer]
    words[:, 5] = words[:, 11] = words[:, 13] = x[column_]
    words[:, 7] = words[:, 9] = x[column_ + end - start + 1]
    words[:, 6] = words[:, 8] = words[:, 14] = y[row]
    words[:, 10] = words[:, 12] = y[row + 1]
    return words, np.searchsorted(start, np.arange(1, number + 1) * (rows * columns)).tolist()


def _record(kind: int, data: bytes = b"") -> bytes:
    return struct.pack(">HH", 4 + len(data), kind) + data


def _named(kind: int, text: str) -> bytes:
    return _record(kind, text.encode("ascii") + b"\0" * (len(text) % 2))


_LAYER, _BOUNDARY, _ENDLIB = 0x0D02, 0x0800, 0x0400
_DATES = struct.pack(">12h", *(2 * [_DATE.year - 1900, _DATE.month, _DATE.day, 0, 0, 0]))
_UNITS = _record(0x0305, bytes.fromhex("3e4189374bc6a7f03944b82fa09b5a54"))  # 1e-3 and 1e-9, base 16
_BEGIN, _END, _REFERENCE, _ARRAY, _END_ELEMENT = (
    _record(0x0502, _DATES),
    _record(0x0700),
    _record(0x0A00),
    _record(0x0B00),
    _record(0x1100),
)
_SCALING = 1e-6 / (GRID * 1e-6)
"""Database units in a micrometre, as the quotient of their lengths."""
_PLACE = b"\0\x0c\x10\3"
_BOX = np.array([0x00040800, 0x00060D02, 6, 0x0E020000, 0x002C1003, *10 * [0], 0x00041100], ">u4").view("i4")
"""Words of a rectangle on layer 0: boundary, layer, data type, five corners."""
_LAYERS = (np.arange(MOST_LEVELS) << 16 | 6).astype(">u4").view(np.int32)


def _on_nanometres(cell: GreyCell, scale: float) -> Ints:
    """Centres (n, 2) of all cells on the file's grid, nanometres; halves are rounded away from 0."""
    window, face = cell.map.window, cell.map.face
    assert face.array is not None
    return _rounded(window.centres(face.array, window.lattice.cells()) * (scale * 1e3 / GRID))


def _rounded(at: Floats) -> Ints:
    """Whole numbers next to numbers, halves away from 0."""
    return np.trunc(at + np.copysign(0.5, at)).astype(np.int64)


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
    total = 0
    for body, face, label in structured_faces(window):
        cell = grey_cell(window, body, face, label, levels, scale)
        if cell.own:
            tried = representative_cells(window, "sample", SIZED)
            drawn = sum(map(_count_of_boxes, cell.batches(tried)))
            total += 400 + int(window.lattice.cell_count * (64 * drawn / len(tried) + 130))
            continue
        runs = sum(1 for _ in _runs(window, face, 1.0))
        total += 400 + 64 * _count_of_boxes(cell.level[None]) + 60 * runs
    return total


def _count_of_boxes(level: Ints) -> int:
    """Number of boxes of cells (b, rows, columns)."""
    return len(_boxes(level, *2 * [np.zeros(level.shape[2] + level.shape[1], dtype=np.int32)])[0])


def check_gds(cell: GreyCell, path: Path, scale: float, written: str = "", found: str = "") -> None:
    """Read a file back, by gdstk and by its bare records, and compare its levels with the lens formula.

    A file of cells that vary is compared with the stream that it should be; if it is another one, it is read.
    Where the SHA-256 of what was written and that of the file are given, they must agree.

    Raises FileDisagrees, UnreadableFile.
    """
    if cell.own and written != found:
        raise FileDisagrees(f"{path.name}: other bytes were read back than were written")
    if cell.own and (written or _is_stream(cell, path, scale)):
        return
    placed = cell.map.window.lattice.cell_count
    by_name = _cells(path)
    sheet = _of_name(by_name, sheet_name(cell), path)
    stands = sum(reference.repetition.size or 1 for reference in sheet.references)
    if stands != placed:
        raise FileDisagrees(f"{path.name}: {stands} cells were read back, {placed} written")
    counted: Counter[int] = Counter()
    for n, level in enumerate(level for some in cell.drawn() for level in some):
        name = cell.name(n)
        lenslet = _of_name(by_name, name, path)
        if not np.array_equal(_drawn(lenslet, cell), level):
            raise FileDisagrees(f"{path.name}: {name} was read back with other levels than were written")
        counted.update(polygon.layer for polygon in lenslet.polygons)
    if layer_counts(path) != counted:
        raise FileDisagrees(f"{path.name}: its records and its polygons do not agree on the layers")


def _is_stream(cell: GreyCell, path: Path, scale: float) -> bool:
    """Whether a file is, byte for byte, the stream of its cells."""
    with path.open("rb") as stream:
        for part in _stream(cell, scale, np.zeros(cell.levels, dtype=np.int64)):
            if stream.read(len(part)) != part:
                break
        else:
            return not stream.read(1)
    if path.stat().st_size > READ_WHOLE:
        raise FileDisagrees(f"{path.name}: its cells are not those of {cell.map.label}")
    return False


def _cells(path: Path) -> dict[str, Any]:
    import gdstk

    try:
        library: Any = gdstk.read_gds(str(path))
    except (OSError, RuntimeError, ValueError) as error:
        raise UnreadableFile(f"{path.name}: {error}") from error
    return {found.name: found for found in library.cells}


def _of_name(cells: Mapping[str, Any], name: str, path: Path) -> Any:
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

    Raises FileDisagrees, UnreadableFile: The levels are not those of the face.
    Raises NotPossible: The extra `gds` is not installed.
    """
    require_gdstk()
    window, face = cell.map.window, cell.map.face
    assert face.array is not None
    want = window.centres(face.array, window.lattice.cells()) * scale
    if cell.own and _is_stream(cell, path, scale):
        return float(np.abs(1e-3 * GRID * _on_nanometres(cell, scale) - want).max()), len(want)
    check_gds(cell, path, scale)
    sheet = _cells(path)[sheet_name(cell)]
    places = [
        np.asarray(one.origin) + (one.repetition.get_offsets() if one.repetition.size else np.zeros((1, 2)))
        for n, one in enumerate(sheet.references)
        if one.cell_name == cell.name(n)
    ]
    got = np.concatenate([*places, np.zeros((0, 2))]) * 1e-3
    turned = any(one.rotation or one.x_reflection or one.magnification != 1.0 for one in sheet.references)
    if got.shape != want.shape or turned:
        return float("inf"), len(got)
    return float(np.abs(got - want).max(initial=0.0)), len(got)


def layer_counts(path: Path) -> Counter[int]:
    """Number of boundaries on each layer, from the file's bare records.

    Raises UnreadableFile: The file is truncated or is no GDSII stream.
    Raises OverBudget: More bytes or records than are read.
    """
    spent = Spending("gds", path)
    counts: Counter[int] = Counter()
    data, at, boundary = b"", 0, False
    with path.open("rb") as stream:
        while True:
            if len(data) - at < LOOK:
                data, at = data[at:] + stream.read(64 * LOOK), 0
            layers = _layers_of_boxes(data, at)
            counts.update(layers.tolist())
            spent.count(5 * len(layers))
            at += 64 * len(layers)
            if at + 4 > len(data):
                break
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


def _layers_of_boxes(data: bytes, at: int) -> Ints:
    """Layers (n,) of the rectangles, written as here, that follow one another from byte `at`."""
    number = min(len(data) - at, LOOK) // 64
    if not number or not data.startswith(b"\0\4\x08\0", at):
        return np.zeros(0, dtype=np.int64)
    words = np.frombuffer(data, np.int32, 16 * number, at).reshape(number, 16)
    alike = (words == _BOX)[:, [0, 1, 3, 4, 15]].all(axis=1)
    number = number if alike.all() else int(alike.argmin())
    return np.frombuffer(data, ">i2", 32 * number, at)[4::32].astype(np.int64)
