"""Content of a table of cells: rows or arrays, validated before use."""

from __future__ import annotations

import os
import zipfile
import zlib
from dataclasses import dataclass, replace
from math import inf
from typing import IO, Any, Final, NamedTuple, NoReturn

import numpy as np

from clacad.base.npy_header import array_head
from clacad.base.text import printable
from clacad.base.types import Bools, Floats, Ints
from clacad.design.number_rows import NumberRows, RowBlock
from clacad.sheet.lattice import Lattice

COLUMNS: Final = ("i", "j", "delta_x", "delta_y")
ETA: Final = "eta"
"""Name of the optional column and of the optional array."""
NOT_HERE: Final = (
    (
        "eta_",
        (
            "eta is one number of a cell, of both axes: two lenses of two focal lengths each would not be"
            " confocal in both"
        ),
    ),
)
LARGEST: Final = 1e6
"""Largest |δ| and |η|, as for the keys law.delta and law.eta."""
LEAST_ETA: Final = 1e-6
"""Least |η|, as for the key law.eta."""
ARRAY: Final = "delta"


class CellNumbers(NamedTuple):
    """Numbers of a table: δ (n1, n2, 2), and η (n1, n2) or None;
    0 and the law's η for cells that an outline leaves out.
    """

    deltas: Floats
    etas: Floats | None


def _eta_range(eta: float) -> tuple[float, float]:
    """Open interval of the cells' η in a sheet whose law has `eta`: f1 and f2 keep their signs."""
    return next(ends for ends in ((-inf, 0.0), (0.0, 1.0), (1.0, inf)) if eta <= ends[1])


@dataclass(frozen=True)
class TableFile:
    """A table of cells on disk, and the lattice whose cells it must cover.

    Parameters
    ----------
    path : str
    lattice : Lattice
    key : str
        Key of the design that names the table.
    eta : float
        η of the sheet's law, along x.
    """

    path: str
    lattice: Lattice
    key: str
    eta: float = -1.0

    def numbers(self) -> CellNumbers:
        """Read δ of every cell, and η if the table has it; see `clacad.design.cell_table.read_table`."""
        if self.path.lower().endswith(".npz"):
            return self._of_array()
        return self._of_rows()

    def refuse(self, message: str, *, allowed: str = "") -> NoReturn:
        """Refuse the table as a whole."""
        NumberRows(self.path, COLUMNS, self.key).refuse(message, allowed=allowed)

    # --- CSV ------------------------------------------------------------------------------------------

    def _of_rows(self) -> CellNumbers:
        rows = NumberRows(self.path, COLUMNS, self.key, NOT_HERE)
        if ETA in rows.names():
            rows = replace(rows, columns=(*COLUMNS, ETA))
        made = np.full((*self.lattice.count, len(rows.columns) - 2), np.nan)
        for block in rows.blocks():
            self._enter(made, block, rows)
        made = self._whole(made)
        return CellNumbers(made[..., :2], made[..., 2] if ETA in rows.columns else None)

    def _enter(self, made: Floats, block: RowBlock, rows: NumberRows) -> None:
        """Write the numbers of a block of rows to their cells."""
        numbers, lines, first = block
        n1, n2 = self.lattice.count
        whole = (numbers[:, :2] == np.rint(numbers[:, :2])) & (np.abs(numbers[:, :2]) < 2.0**53)
        index: Ints = np.where(whole, numbers[:, :2], -(2.0**53)).astype(np.int64)
        i, j = index[:, 0], index[:, 1]
        place = i + j // 2 if self.lattice.hexagonal else i
        outside = np.column_stack([(place < 0) | (place >= n1), (j < 0) | (j >= n2)])
        good = np.abs(numbers[:, 2:4]) <= LARGEST  # False for NaN
        flaws: tuple[tuple[Bools, int, str, str], ...] = (
            (~whole[:, 0], 0, "i is no whole number", "a whole number"),
            (~whole[:, 1], 1, "j is no whole number", "a whole number"),
            (outside[:, 1], 1, "j lies outside the sheet", f"0 to {n2 - 1}"),
            (outside[:, 0], 0, "i lies outside the sheet", f"0 to {n1 - 1}" + self._less_rows()),
            (~good[:, 0], 2, "delta_x is out of range", f"a number from -{LARGEST:g} to {LARGEST:g}"),
            (~good[:, 1], 3, "delta_y is out of range", f"a number from -{LARGEST:g} to {LARGEST:g}"),
            *((~self._has_lens(eta), 4, "eta is out of range", self._etas()) for eta in numbers.T[4:]),
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
            rows.refuse(
                f"cell ({i[row]}, {j[row]}) occurs twice in the table",
                first + row,
                lines[row],
                0,
                allowed="each cell once",
            )
        made[place, j] = numbers[:, 2:]

    def _less_rows(self) -> str:
        return " less j // 2, as hexagons are counted" if self.lattice.hexagonal else ""

    def _whole(self, made: Floats) -> Floats:
        """Numbers of every cell, 0 and the law's η for cells that are not kept;
        refuse a kept cell without numbers.
        """
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
        return np.where(missing[..., None], (0.0, 0.0, self.eta)[: made.shape[2]], made)

    def _has_lens(self, eta: Floats) -> Bools:
        """Whether each η (...) gives lenses with the signs of the law's lenses."""
        low, high = _eta_range(self.eta)
        size = np.abs(eta)
        return np.asarray((low < eta) & (eta < high) & (size >= LEAST_ETA) & (size <= LARGEST))

    def _etas(self) -> str:
        """Describe the η that cells may have."""
        low, high = _eta_range(self.eta)
        low, high = max(low, -LARGEST), min(high, LARGEST)
        return (
            f"a number between {low:g} and {high:g}, |eta| >= {LEAST_ETA:g}: both lenses as law.eta ="
            f" {self.eta:g} bends them"
        )

    # --- NPZ ------------------------------------------------------------------------------------------

    def _of_array(self) -> CellNumbers:
        """Read the arrays after validating their headers; never read more than the size in the header."""
        most = 48 * self.lattice.count[0] * self.lattice.count[1] + (1 << 20)
        if (
            size := os.stat(self.path).st_size
        ) > most:  # the library makes an object of each entry before any is validated
            self.refuse(f"{size:,} bytes are more than such arrays have", allowed=self._shapes())
        try:
            with zipfile.ZipFile(self.path) as archive:
                names = archive.namelist()
                deltas, etas = self._entry(archive, names, ARRAY), self._entry(archive, names, ETA)
        except (
            zipfile.BadZipFile,
            zlib.error,
            RuntimeError,
            NotImplementedError,
            EOFError,
            OSError,
        ) as error:
            self.refuse(
                f"not an .npz archive that can be read: {printable(str(error))[:100]}", allowed=self._shapes()
            )
        if deltas is None:
            self.refuse(f"no array {ARRAY!r} in the archive", allowed=self._shapes())
        others = [name for name in names if name.removesuffix(".npy") not in (ARRAY, ETA)]
        if others:  # an ignored array would seem to be built
            self.refuse(
                f"{printable(others[0])[:100]} is none of the arrays that are read", allowed=self._shapes()
            )
        bad = ~(np.abs(deltas) <= LARGEST)
        if bad.any():
            i, j, axis = (int(v[0]) for v in np.nonzero(bad))
            self.refuse(
                f"delta[{i}, {j}, {axis}] = {deltas[i, j, axis]} is out of range",
                allowed=f"numbers from -{LARGEST:g} to {LARGEST:g}",
            )
        return CellNumbers(deltas, None if etas is None else self._kept_etas(etas))

    def _entry(self, archive: zipfile.ZipFile, names: list[str], name: str) -> Floats | None:
        """One array of the archive; None where no array has this name."""
        found = [entry for entry in names if entry.removesuffix(".npy") == name]
        if len(found) > 1:
            self.refuse(f"{len(found)} arrays {name!r} in the archive", allowed=self._shapes())
        if not found:
            return None
        with archive.open(found[0]) as stream:
            return self._array(stream, name)

    def _kept_etas(self, etas: Floats) -> Floats:
        """η of every cell, the law's for cells that are not kept; refuse a kept cell with η out of range."""
        for j in np.flatnonzero((~self._has_lens(etas)).any(axis=0)).tolist():
            row = self.lattice.row(j)
            places = row[:, 0] + j // 2 if self.lattice.hexagonal else row[:, 0]
            bad = places[~self._has_lens(etas[places, j])]
            if len(bad):
                self.refuse(f"eta[{bad[0]}, {j}] = {etas[bad[0], j]} is out of range", allowed=self._etas())
        return np.where(self._has_lens(etas), etas, self.eta)

    def _array(self, stream: IO[bytes], name: str) -> Floats:
        shapes = {ARRAY: (*self.lattice.count, 2), ETA: self.lattice.count}
        try:
            shape, fortran, kind = array_head(stream)
        except ValueError as error:
            self.refuse(f"array {name!r}: {error}", allowed=self._shapes())
        if shape != tuple(shapes[name]) or kind.kind not in "fiu" or fortran:
            pickled = ": pickled objects are not read" if kind.hasobject else ""
            self.refuse(
                f"array {name!r} is {shape} of {kind}{', Fortran order' if fortran else ''}{pickled}",
                allowed=self._shapes(),
            )
        size = int(np.prod(shape)) * kind.itemsize
        data = stream.read(size + 1)
        if len(data) != size:
            self.refuse(f"array {name!r} is not as long as its header says", allowed=self._shapes())
        typed: Any = np.frombuffer(data, dtype=kind).reshape(shape)
        return np.asarray(typed, dtype=np.float64)

    def _shapes(self) -> str:
        n1, n2 = self.lattice.count
        return f"array {ARRAY!r} ({n1}, {n2}, 2) of numbers, C order; perhaps {ETA!r} ({n1}, {n2})"
