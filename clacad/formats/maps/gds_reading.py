"""GDSII files of grey levels read back: by gdstk and by their bare records, compared with the lens
formula.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from clacad.base.types import Ints
from clacad.formats.maps.gds import LENSLET, GreyCell, require_gdstk, sheet_name
from clacad.storage.errors import FileDisagrees, UnreadableFile
from clacad.storage.reading import Spending

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
