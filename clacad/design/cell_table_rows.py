"""What stands in a table of cells: its rows or its array, each judged before it is used."""

from __future__ import annotations

import os
import zipfile
import zlib
from dataclasses import dataclass
from typing import IO, Any, Final, NoReturn

import numpy as np

from clacad.base.npy_header import array_head
from clacad.base.text import printable
from clacad.base.types import Bools, Floats, Ints
from clacad.design.number_rows import NumberRows, RowBlock
from clacad.sheet.lattice import Lattice

COLUMNS: Final = ("i", "j", "delta_x", "delta_y")
NOT_HERE: Final = (
    (
        "eta",
        "eta is one for all cells, law.eta: with one of its own each lens would have a radius of its own, which is not made",
    ),
)
LARGEST: Final = 1e6
"""Largest |δ|, as of the key law.delta."""
ARRAY: Final = "delta"


@dataclass(frozen=True)
class TableFile:
    """A table of cells on disk, and the cells that it shall have.

    Parameters
    ----------
    path : str
    lattice : Lattice
    key : str
        Key of the design that names it.
    """

    path: str
    lattice: Lattice
    key: str

    def deltas(self) -> Floats:
        """Read δ of every cell, (n1, n2, 2); see `clacad.design.cell_table.read_table`."""
        if self.path.lower().endswith(".npz"):
            return self._of_array()
        return self._of_rows()

    def refuse(self, message: str, *, allowed: str = "") -> NoReturn:
        """Refuse the table as a whole."""
        NumberRows(self.path, COLUMNS, self.key).refuse(message, allowed=allowed)

    # --- CSV ------------------------------------------------------------------------------------------

    def _of_rows(self) -> Floats:
        made = np.full((*self.lattice.count, 2), np.nan)
        rows = NumberRows(self.path, COLUMNS, self.key, NOT_HERE)
        for block in rows.blocks():
            self._enter(made, block, rows)
        return self._whole(made)

    def _enter(self, made: Floats, block: RowBlock, rows: NumberRows) -> None:
        """Write the δ of rows to their cells."""
        numbers, lines, first = block
        n1, n2 = self.lattice.count
        whole = (numbers[:, :2] == np.rint(numbers[:, :2])) & (np.abs(numbers[:, :2]) < 2.0**53)
        index: Ints = np.where(whole, numbers[:, :2], -(2.0**53)).astype(np.int64)
        i, j = index[:, 0], index[:, 1]
        place = i + j // 2 if self.lattice.hexagonal else i
        outside = np.column_stack([(place < 0) | (place >= n1), (j < 0) | (j >= n2)])
        good = np.abs(numbers[:, 2:]) <= LARGEST  # NaN is not
        flaws: tuple[tuple[Bools, int, str, str], ...] = (
            (~whole[:, 0], 0, "i is no whole number", "a whole number"),
            (~whole[:, 1], 1, "j is no whole number", "a whole number"),
            (outside[:, 1], 1, "j lies outside the sheet", f"0 to {n2 - 1}"),
            (outside[:, 0], 0, "i lies outside the sheet", f"0 to {n1 - 1}" + self._less_rows()),
            (~good[:, 0], 2, "delta_x is out of range", f"a number from -{LARGEST:g} to {LARGEST:g}"),
            (~good[:, 1], 3, "delta_y is out of range", f"a number from -{LARGEST:g} to {LARGEST:g}"),
        )
        bad = np.flatnonzero(np.any([flaw[0] for flaw in flaws], axis=0))
        if len(bad):
            row = int(bad[0])
            _, column, message, allowed = next(flaw for flaw in flaws if flaw[0][row])
            rows.refuse(message, first + row, lines[row], column, allowed=allowed)
        flat = place * n2 + j
        _, earliest = np.unique(flat, return_index=True)
        twice = ~np.isnan(made[place, j, 0])
        twice[np.setdiff1d(np.arange(len(flat)), earliest)] = True
        if twice.any():
            row = int(np.argmax(twice))
            rows.refuse(f"cell ({i[row]}, {j[row]}) stands in the table twice", first + row, lines[row], 0,
                        allowed="each cell once")  # fmt: skip
        made[place, j] = numbers[:, 2:]

    def _less_rows(self) -> str:
        return " less j // 2, as hexagons are counted" if self.lattice.hexagonal else ""

    def _whole(self, made: Floats) -> Floats:
        """δ of every cell, 0 where none is kept; a kept one that has none is refused."""
        missing = np.isnan(made[..., 0])
        for j in np.flatnonzero(missing.any(axis=0)).tolist():
            kept = self.lattice.row(j)
            places = kept[:, 0] + j // 2 if self.lattice.hexagonal else kept[:, 0]
            lacking = kept[missing[places, j]]
            if len(lacking):
                self.refuse(
                    f"cell ({lacking[0, 0]}, {j}) is missing",
                    allowed=f"a row for each of {self.lattice.cell_count:,} cells",
                )
        return np.where(missing[..., None], 0.0, made)

    # --- NPZ ------------------------------------------------------------------------------------------

    def _of_array(self) -> Floats:
        """Read the array after its header was judged; what its entry says it inflates to is never exceeded."""
        most = 32 * self.lattice.count[0] * self.lattice.count[1] + (1 << 20)
        if (
            size := os.stat(self.path).st_size
        ) > most:  # the library makes an object of each entry before any is judged
            self.refuse(f"{size:,} bytes are more than such an array has", allowed=self._shape())
        try:
            with zipfile.ZipFile(self.path) as archive:
                names = [name for name in archive.namelist() if name.removesuffix(".npy") == ARRAY]
                if len(names) != 1:
                    self.refuse(f"no array {ARRAY!r} in the archive", allowed=self._shape())
                with archive.open(names[0]) as stream:
                    made = self._array(stream)
        except (
            zipfile.BadZipFile,
            zlib.error,
            RuntimeError,
            NotImplementedError,
            EOFError,
            OSError,
        ) as error:
            self.refuse(
                f"not an .npz archive that can be read: {printable(str(error))[:100]}", allowed=self._shape()
            )
        bad = ~(np.abs(made) <= LARGEST)
        if bad.any():
            i, j, axis = (int(v[0]) for v in np.nonzero(bad))
            self.refuse(f"delta[{i}, {j}, {axis}] = {made[i, j, axis]} is out of range",
                        allowed=f"numbers from -{LARGEST:g} to {LARGEST:g}")  # fmt: skip
        return made

    def _array(self, stream: IO[bytes]) -> Floats:
        try:
            shape, fortran, kind = array_head(stream)
        except ValueError as error:
            self.refuse(f"array {ARRAY!r}: {error}", allowed=self._shape())
        if shape != (*self.lattice.count, 2) or kind.kind not in "fiu" or fortran:
            pickled = ": pickled objects are not read" if kind.hasobject else ""
            self.refuse(f"array {ARRAY!r} is {shape} of {kind}{', Fortran order' if fortran else ''}{pickled}",
                        allowed=self._shape())  # fmt: skip
        size = int(np.prod(shape)) * kind.itemsize
        data = stream.read(size + 1)
        if len(data) != size:
            self.refuse(f"array {ARRAY!r} is not as long as its header says", allowed=self._shape())
        typed: Any = np.frombuffer(data, dtype=kind).reshape(shape)
        return np.asarray(typed, dtype=np.float64)

    def _shape(self) -> str:
        n1, n2 = self.lattice.count
        return f"array {ARRAY!r} ({n1}, {n2}, 2) of numbers, C order"
