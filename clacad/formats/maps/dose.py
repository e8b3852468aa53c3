"""Levels of a writer for the depths of a face, by a measured calibration, and the coupon that gives one.

Depth is counted from the highest point of a face into the material. A calibration is a table of levels and
depths with straight lines between; of the whole levels the one whose depth is nearest is written, of two
equally near ones the lower. A depth outside the table is refused, never extrapolated.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.text import did_you_mean, near, printable
from clacad.base.types import Floats, Ints
from clacad.base.units import LENGTHS
from clacad.base.untrusted_files import BUDGETS, read_regular
from clacad.formats.maps.raster import read_bmp, read_png, write_bmp, write_png
from clacad.formats.maps.sag import HeightMap
from clacad.storage.errors import BadRequest, FileDisagrees, OverBudget, UnreadableFile
from clacad.storage.reading import Spending

READER = "calibration"
"""Budget of the reader of calibrations."""

BYTE, WORD = 255, 65535
"""Highest levels of pictures of 8 and of 16 bits."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """Measured depths of levels, straight lines between.

    name : File, or what the depths follow from.
    levels : (k,) whole numbers, rising. depths : (k,) metres, rising.
    """

    name: str
    levels: Ints
    depths: Floats

    @staticmethod
    def straight(deepest: float) -> Calibration:
        """Levels in proportion to depth, 255 at the deepest point (metres)."""
        return Calibration("in proportion to depth", np.array([0, BYTE]), np.array([0.0, deepest]))

    @property
    def most(self) -> int:
        """Highest level of the pictures that the table is for, 255 or 65535."""
        return BYTE if self.levels[-1] <= BYTE else WORD

    def steps(self, most: int) -> tuple[Ints, Floats]:
        """Every level of a picture that the table covers, with its depth (metres).

        most : Highest level of the picture, 255 or 65535; level 255 of one is 65535 of the other.
        """
        per = most / self.most
        first, last = (int(np.ceil(self.levels[0] * per)), int(np.floor(self.levels[-1] * per)))
        levels = np.arange(first, last + 1)
        return levels, np.interp(levels / per, self.levels, self.depths)

    def level_of(self, depth: Floats, most: int = BYTE) -> tuple[Ints, Floats]:
        """Levels of depths (metres), and the depth that each level gives less the wished one.

        Raises BadRequest: A depth lies outside the table.
        """
        levels, depths = self.steps(most)
        known = depth[np.isfinite(depth)]
        if known.size and not (depths[0] - SLACK <= known.min() and known.max() <= depths[-1] + SLACK):
            raise BadRequest(
                f"{self.name}: depths of {1e6 * known.min():.6g} to {1e6 * known.max():.6g} um are wished,"
                f" the calibration covers {1e6 * depths[0]:.6g} to {1e6 * depths[-1]:.6g} um; measure a"
                " coupon with deeper levels, or design a flatter face"
            )
        above = np.clip(np.searchsorted(depths, depth), 1, len(depths) - 1)
        low, high = depths[above - 1], depths[above]
        place = np.where(depth - low <= high - depth, above - 1, above)
        return levels[place], depths[place] - depth


def read_calibration(path: Path) -> Calibration:
    """Read a table of levels and depths: CSV with the columns `level`, `depth_um` and, unused, `u_um`.

    Raises UnreadableFile: Not such a table; fewer than two rows; levels or depths that do not rise.
    Raises OverBudget: Larger than is read.
    Raises OSError: No such file.
    """
    try:
        data = read_regular(path, BUDGETS[READER].bytes)
    except OSError as error:
        if "more than" in (error.strerror or ""):
            raise OverBudget(f"{path.name}: {error.strerror} ('clacad doctor' lists what is read)") from error
        raise
    try:
        lines = data.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise UnreadableFile(f"{path.name}: not a text of UTF-8") from None
    rows = [(k, line) for k, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")]
    if not rows:
        raise UnreadableFile(f"{path.name}: it is empty; its first line is level,depth_um")
    at, unit, columns = _columns(path, *rows[0])
    if len(rows) - 1 > (BUDGETS[READER].items or 0):
        raise OverBudget(f"{path.name}: {len(rows) - 1:,} rows; {BUDGETS[READER].items:,} are read")
    table = [_numbers(path, number, line, columns) for number, line in rows[1:]]
    return _checked(path, [number for number, _ in rows[1:]], [(r[at[0]], r[at[1]] * unit) for r in table])


def _columns(path: Path, number: int, line: str) -> tuple[tuple[int, int], float, int]:
    """Places of level and depth, metres per unit of depth, and the count of columns."""
    names = [name.strip() for name in line.split(",")]
    units = {f"depth_{word}": float(value) for word, value in LENGTHS.items()}
    spread = {f"u_{word}" for word in LENGTHS}
    for name in names:
        if name != "level" and name not in units and name not in spread:
            hint = did_you_mean(near(name, ["level", "depth_um", "u_um"]), before="; ")
            raise UnreadableFile(
                f"{path.name}, line {number}: column {printable(name)[:40]!r}{hint}; its columns are level,"
                " depth_um (or another length unit) and u_um"
            )
    depths = [name for name in names if name in units]
    if names.count("level") != 1 or len(depths) != 1:
        raise UnreadableFile(f"{path.name}, line {number}: one column level and one depth_um are needed")
    return (names.index("level"), names.index(depths[0])), units[depths[0]], len(names)


def _numbers(path: Path, number: int, line: str, columns: int) -> list[float]:
    words = next(csv.reader([line]), [])
    try:
        found = [float(word) for word in words]
    except ValueError:
        found = []
    if len(found) != columns or not all(map(isfinite, found)):
        raise UnreadableFile(
            f"{path.name}, line {number}: {printable(line)[:60]!r} is not {columns} finite numbers"
        )
    return found


def _checked(path: Path, lines: list[int], pairs: list[tuple[float, float]]) -> Calibration:
    """The table, whose levels are whole and rise, and whose depths rise."""
    if len(pairs) < 2:
        raise UnreadableFile(f"{path.name}: {len(pairs)} levels; a calibration takes two and more")
    for number, (level, depth) in zip(lines, pairs, strict=True):
        if level != int(level) or not 0 <= level <= WORD:
            raise UnreadableFile(
                f"{path.name}, line {number}: level {level:g}; levels are whole, 0 to 255 or {WORD}"
            )
        if not 0.0 <= depth < 1.0:
            raise UnreadableFile(f"{path.name}, line {number}: a depth of {depth:g} m; 0 to 1 m is believed")
    for number, (before, here) in zip(lines[1:], pairwise(pairs), strict=True):
        for what, k in (("level", 0), ("depth", 1)):
            if not here[k] > before[k]:
                raise UnreadableFile(
                    f"{path.name}, line {number}: {what} {_told(here, k)} after {_told(before, k)}: a"
                    " calibration rises from row to row; measure the coupon again, or leave the row out"
                )
    levels, depths = zip(*pairs, strict=True)
    return Calibration(path.name, np.array(levels).astype(np.int64), np.array(depths))


def _told(pair: tuple[float, float], k: int) -> str:
    return f"{pair[0]:g}" if k == 0 else f"{1e6 * pair[1]:.6g} um"


# -- maps of levels --------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class DoseMap:
    """Levels for the depths of a face, laid out as its height map and seen from outside.

    The picture of a front face is that of its height map with the rows reversed: the face turned about x.
    """

    map: HeightMap
    calibration: Calibration

    def levels(self, most: int) -> Iterator[tuple[Ints, Floats]]:
        """Levels (k, width) from the top row down, and residuals (metres); level 0 where there is no face."""
        unit = self.map.window.unit
        for heights in self.map.blocks(upwards=self.map.face.side > 0):
            depth = (self.map.high - heights) * unit
            held = np.isfinite(depth)
            level, residual = self.calibration.level_of(
                np.where(held, depth, self.calibration.depths[0]), most
            )
            yield np.where(held, level, 0), np.where(held, residual, 0.0)

    def write(self, path: Path) -> dict[str, Any]:
        """Write a PNG or BMP by its name, of 16 bits where its name ends so; read it back; return its facts.

        Raises FileDisagrees: The file read back holds other levels.
        """
        most = levels_of(path)
        residuals: list[tuple[float, float]] = []

        def rows() -> Iterator[NDArray[np.uint16]]:
            for level, residual in self.levels(most):
                residuals.append((float(np.abs(residual).max()), float((residual**2).sum())))
                yield level.astype(np.uint16)

        shape = (self.map.width, self.map.height)
        fine = 1.0 / (self.map.pixel * self.map.window.unit)
        if path.suffix == ".bmp":
            write_bmp(rows(), path, *shape, fine)
        else:
            write_png(rows(), path, *shape, fine, 16 if most == WORD else 8)
        self._check(path, most)
        rms = sqrt(sum(square for _, square in residuals) / (shape[0] * shape[1]))
        return {
            "levels": most + 1,
            "residual_max": max(worst for worst, _ in residuals) * 1e3,
            "residual_rms": rms * 1e3,
        }

    def _check(self, path: Path, most: int) -> None:
        found, row = read_levels(path), 0
        for level, _ in self.levels(most):
            if not (found[row : row + len(level)] == level).all():
                raise FileDisagrees(f"{path.name}: its levels are not those of {self.map.label}")
            row += len(level)
        if found.shape != (self.map.height, self.map.width):
            raise FileDisagrees(f"{path.name}: {found.shape[1]} × {found.shape[0]} pixels were read back")

    def depths(self, path: Path) -> Floats:
        """Calibrated depths (rows, columns), metres, of a file of this face, rows as in its height map.

        Raises UnreadableFile: Another size, or a level outside the calibration.
        """
        found, most = read_levels(path), levels_of(path)
        if found.shape != (self.map.height, self.map.width):
            raise UnreadableFile(
                f"{path.name}: {found.shape[1]} × {found.shape[0]} pixels, a map of {self.map.label} has"
                f" {self.map.width} × {self.map.height}"
            )
        levels, depths = self.calibration.steps(most)
        if found.min() < levels[0] or found.max() > levels[-1]:
            raise UnreadableFile(
                f"{path.name}: levels of {found.min()} to {found.max()}; its calibration covers {levels[0]}"
                f" to {levels[-1]}"
            )
        deep = np.asarray(depths[found.astype(np.int64) - levels[0]])
        return deep[::-1] if self.map.face.side > 0 else deep

    def misfit(self, path: Path) -> tuple[float, float, int]:
        """Largest distance (mm) of a calibrated depth from the face, half a level there, and the pixels."""
        deep, row, worst = self.depths(path), 0, 0.0
        for heights in self.map.blocks():
            wished = (self.map.high - heights) * self.map.window.unit
            held = np.isfinite(wished)
            worst = max(worst, float(np.abs(deep[row : row + len(wished)] - wished)[held].max(initial=0.0)))
            row += len(wished)
        _, depths = self.calibration.steps(levels_of(path))
        return worst * 1e3, (0.5 * float(np.diff(depths).max()) + SLACK) * 1e3, deep.size

    def to_dict(self, scale: float) -> dict[str, Any]:
        """Calibration and scales of the pictures of a face; `scale`: millimetres per design unit."""
        turned = ": turned by 180 degrees about x" if self.map.face.side > 0 else ""
        return {
            "calibration": self.calibration.name,
            "levels": self.calibration.levels.tolist(),
            "depths_um": (self.calibration.depths * 1e6).tolist(),
            "pixel_mm": self.map.pixel * scale,
            "width": self.map.width,
            "height": self.map.height,
            "depth_0": "the highest point of the face",
            "row_0": f"top, the face seen from outside{turned}",
        }


SLACK = 1e-12
"""Rounding of a depth (metres)."""


def levels_of(path: Path) -> int:
    """Highest level of a picture by its name."""
    return WORD if path.name.lower().endswith("16.png") else BYTE


def read_levels(path: Path) -> NDArray[np.uint16]:
    """Levels (rows, columns) of a PNG or BMP. Raises UnreadableFile, OverBudget."""
    return read_bmp(path) if path.suffix.lower() == ".bmp" else read_png(path)


def read_table(path: Path) -> dict[str, Calibration]:
    """Calibrations of the faces in the table next to dose maps. Raises UnreadableFile."""
    Spending("surface-table", path)
    try:
        faces = json.loads(path.read_text(encoding="utf-8"))["faces"]
        found = {
            str(label): [
                (float(level), float(depth) * 1e-6)
                for level, depth in zip(told["levels"], told["depths_um"], strict=True)
            ]
            for label, told in faces.items()
        }
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise UnreadableFile(f"{path.name}: no calibrations of faces ({type(error).__name__})") from None
    return {label: _checked(path, [0] * len(pairs), pairs) for label, pairs in found.items()}


def dose_of(map_: HeightMap, path: Path) -> DoseMap:
    """Dose map of a file of a face, with the calibration of the table next to it.

    Raises UnreadableFile: There is no such table, or the face is not in it.
    """
    stem = path.name.partition(f".{map_.label}.")[0]
    beside = path.with_name(f"{stem}.dose.json")
    if not beside.is_file():
        raise UnreadableFile(f"{path.name}: {beside.name} with its calibration is not next to it")
    table = read_table(beside)
    if map_.label not in table:
        raise UnreadableFile(f"{beside.name}: no calibration of {map_.label}")
    return DoseMap(map_, table[map_.label])


# -- the coupon ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Coupon:
    """Square fields, one for each level, row by row; between them nothing is exposed.

    side : length. Of a field; the fields lie 1.5 sides apart.
    """

    side: float = 0.1e-3
    levels: tuple[int, ...] = (*range(0, 255, 16), 255)
    row: int = 6

    @property
    def pitch(self) -> float:
        """Distance of neighbouring fields."""
        return 1.5 * self.side

    def middles(self) -> Floats:
        """Middles (k, 2) of the fields, from that of the first: x to the right, y upwards."""
        number = np.arange(len(self.levels))
        return np.asarray(np.stack([number % self.row, -(number // self.row)], axis=1) * self.pitch)

    def extent(self) -> tuple[float, float, float, float]:
        """x_min, x_max, y_min, y_max of the coupon with its land, half a side wide."""
        (x, y), reach = self.middles().T, self.side
        return float(x.min() - reach), float(x.max() + reach), float(y.min() - reach), float(y.max() + reach)

    def picture(self, pixel: float) -> Ints:
        """Level of each pixel (rows, columns), the top row first."""
        x0, x1, y0, y1 = self.extent()
        x = x0 + pixel * (np.arange(round((x1 - x0) / pixel)) + 0.5)
        y = y1 - pixel * (np.arange(round((y1 - y0) / pixel)) + 0.5)
        found = np.zeros((len(y), len(x)), dtype=np.int64)
        for level, (mx, my) in zip(self.levels, self.middles().tolist(), strict=True):
            inside = [np.flatnonzero(np.abs(at - m) < 0.5 * self.side) for at, m in ((y, my), (x, mx))]
            found[np.ix_(*inside)] = level
        return found

    def to_dict(self, pixel: float) -> dict[str, Any]:
        """Definition of the coupon for the file next to its picture, lengths in millimetres."""
        x0, _, _, y1 = self.extent()
        fields = [
            {"level": level, "x": x, "y": y}
            for level, (x, y) in zip(self.levels, (self.middles() * 1e3).tolist(), strict=True)
        ]
        return {
            "format": 1,
            "unit": "mm",
            "side": self.side * 1e3,
            "pitch": self.pitch * 1e3,
            "fields_per_row": self.row,
            "pixel": pixel * 1e3,
            "left": x0 * 1e3,
            "top": y1 * 1e3,
            "fields": fields,
            "field_x_y": "middle of a field from that of the first; x to the right, y upwards",
        }
