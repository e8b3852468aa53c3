"""Content of a table of cells: rows or arrays of an untrusted file, validated before use."""

from __future__ import annotations

import os
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf
from typing import IO, Any, Final, NamedTuple, NoReturn

import numpy as np

from clacad.base.text import printable
from clacad.base.types import Bools, Floats, Ints, Pair2
from clacad.base.untrusted_files import BUDGETS, array_head
from clacad.config.mistakes import design_error, too_large
from clacad.sheet.cell_places import places_in_rows
from clacad.sheet.lattice import Lattice

LONGEST_ROW: Final = 1000
BLOCK: Final = 1 << 16
"""Rows read at a time."""


class RowBlock(NamedTuple):
    """Several rows: numbers (n, columns), text, and the number of the first in the file (from 1)."""

    numbers: Floats
    lines: list[str]
    first: int


@dataclass(frozen=True)
class NumberRows:
    """A CSV file of numbers.

    columns : The header.
    key : Key of the design that names the file, "" where none does.
    """

    path: str
    columns: tuple[str, ...]
    key: str = ""

    def names(self) -> list[str]:
        """Columns of the header, valid or not. Raises DesignError: The header is not UTF-8, or too long."""
        with open(self.path, "rb") as stream:
            line = self._text(stream.readline(LONGEST_ROW), 1).removeprefix("\ufeff")
        return [part.strip() for part in line.split(",")]

    def blocks(self) -> Iterator[RowBlock]:
        """Iterate over blocks of rows.

        Raises DesignError: With row and column: another header, a value that is no number, too few or many
            values, text that is not UTF-8.
        Raises DesignTooLarge: More rows than the reader's limit.
        """
        with open(self.path, "rb") as stream:
            self._header(self._text(stream.readline(LONGEST_ROW), 1).removeprefix("\ufeff"))
            first = 2
            for lines in self._lines(stream):
                yield RowBlock(self._numbers(lines, first), lines, first)
                first += len(lines)

    def refuse(
        self,
        message: str,
        row: int | None = None,
        line: str = "",
        column: int | None = None,
        *,
        allowed: str = "",
        hint: str = "",
    ) -> NoReturn:
        """Refuse the table, at a column (from 0) of a row (from 1)."""
        place = None
        if column is not None:
            place = 1 + min(len(line), sum(len(part) + 1 for part in line.split(",")[:column]))
        raise design_error(
            "CL124",
            message,
            self.key,
            self.path,
            line=row,
            column=place,
            allowed=allowed,
            hint=hint,
            source_line=line,
        )

    def _header(self, line: str) -> None:
        names = [part.strip() for part in line.split(",")]
        if names != [*self.columns]:
            wrong = next(
                (k for k, pair in enumerate(zip(names, self.columns)) if pair[0] != pair[1]),
                min(len(names), len(self.columns)),
            )
            self.refuse("the header is not the required one", 1, line, wrong, allowed=",".join(self.columns))

    def _lines(self, stream: IO[bytes]) -> Iterator[list[str]]:
        """Blocks of rows after the header; empty lines at the end are ignored."""
        row, read, empty = 1, 0, 0
        lines: list[str] = []
        most = BUDGETS["cell-table"].items or 0
        while raw := stream.readline(LONGEST_ROW):
            row += 1
            line = self._text(raw, row)
            if not line.strip():
                empty = empty or row
                continue
            if empty:
                self.refuse("an empty row inside the table", empty, allowed=",".join(self.columns))
            lines.append(line)
            read += 1
            if read > most:
                raise too_large("CL124", f"more than {most:,} rows", self.key, self.path, line=row)
            if len(lines) == BLOCK:
                yield lines
                lines = []
        if lines:
            yield lines

    def _text(self, raw: bytes, row: int) -> str:
        """Text of a row without its line end."""
        if len(raw) == LONGEST_ROW:
            self.refuse(f"a row of {LONGEST_ROW} characters or more", row, allowed=",".join(self.columns))
        try:
            return raw.decode("utf-8").rstrip("\r\n")
        except UnicodeDecodeError:
            self.refuse("the row is not UTF-8 text", row, allowed=",".join(self.columns))

    def _numbers(self, lines: list[str], first: int) -> Floats:
        """Numbers (n, columns) of rows, the first of which is row `first` of the file."""
        if any(not part.strip() for line in lines for part in line.split(",")):
            self._refuse_first(lines, first)  # numpy warns of an empty cell
        try:
            numbers = np.loadtxt(lines, delimiter=",", comments=None, ndmin=2, dtype=np.float64)
        except ValueError:
            numbers = np.empty((0, 0))
        if numbers.shape != (len(lines), len(self.columns)):
            self._refuse_first(lines, first)
        return numbers

    def _refuse_first(self, lines: list[str], first: int) -> NoReturn:
        """Refuse the table at the first row and column that is no number."""
        for row, line in enumerate(lines, first):
            parts = line.split(",")
            for column, part in enumerate(parts[: len(self.columns)]):
                if not part.strip():
                    self.refuse(f"{self.columns[column]} is empty", row, line, column, allowed="a number")
                try:
                    np.loadtxt([part], comments=None, dtype=np.float64)
                except ValueError:
                    self.refuse(f"{self.columns[column]} is no number", row, line, column, allowed="a number")
            if len(parts) != len(self.columns):
                self.refuse(
                    f"{len(parts)} values in a row",
                    row,
                    line,
                    min(len(parts), len(self.columns)),
                    allowed=",".join(self.columns),
                )
        self.refuse("the rows are not numbers separated by commas", first, allowed=",".join(self.columns))


COLUMNS: Final = ("i", "j", "delta_x", "delta_y")
ETAS: Final = {"eta": (0, 1), "eta_x": (0,), "eta_y": (1,)}
"""Names of optional columns and arrays, and the lens axes whose η they state: eta alone, or the others."""
TURNS: Final = {"phi": 36000.0, "theta": 89.999, "psi": 36000.0}
"""Names of the optional columns and arrays after them, the angles of law.euler that cells may have, and the
largest of each in degrees, as for that key.
"""
LARGEST: Final = 1e6
"""Largest |δ| and |η|, as for the keys law.delta and law.eta."""
LEAST_ETA: Final = 1e-6
"""Least |η|, as for the key law.eta."""
ARRAY: Final = "delta"


class CellNumbers(NamedTuple):
    """Numbers of a table: δ (n1, n2, 2), η (n1, n2), or (n1, n2, 2) of each axis, or None, and φ, θ, ψ in
    degrees (n1, n2, 3), or None; 0 and the law's η and angles for left-out cells.
    """

    deltas: Floats
    etas: Floats | None
    euler: Floats | None = None


def _eta_range(etas: Iterable[float]) -> tuple[float, float]:
    """Open interval of the cells' η where the law has `etas`: f1 and f2 keep their signs. Or low ≥ high."""
    ends = ((-inf, 0.0), (0.0, 1.0), (1.0, inf))
    low, high = zip(*(next(each for each in ends if eta <= each[1]) for eta in etas), strict=True)
    return max(low), min(high)


@dataclass(frozen=True)
class TableFile:
    """A table of cells on disk, and the lattice whose cells it must cover.

    key : Key of the design that names the table.
    eta : η of the sheet's law along the lens axes.
    euler : φ, θ, ψ of the sheet's law, degrees.
    """

    path: str
    lattice: Lattice
    key: str
    eta: Pair2 = (-1.0, -1.0)
    euler: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def law(self) -> dict[str, float]:
        """The law's number in place of a column or an array that a table lacks."""
        names = (*ETAS, *TURNS)
        return dict(zip(names, (self.eta[0], *self.eta, *self.euler), strict=True))

    def numbers(self) -> CellNumbers:
        """Read δ of every cell, and η and angles if the table has them; see `read_table`."""
        if self.path.lower().endswith(".npz"):
            return self._of_array()
        return self._of_rows()

    def refuse(self, message: str, *, allowed: str = "") -> NoReturn:
        """Refuse the table as a whole."""
        NumberRows(self.path, COLUMNS, self.key).refuse(message, allowed=allowed)

    # --- CSV ------------------------------------------------------------------------------------------

    def _of_rows(self) -> CellNumbers:
        rows = NumberRows(self.path, COLUMNS, self.key)
        names = rows.names()
        own = tuple(name for name in ETAS if name in names[4:])
        own = own[: 1 if "eta" in own else 2] + tuple(name for name in TURNS if name in names[4:])
        rows = replace(rows, columns=(*COLUMNS, *own))
        made = np.full((*self.lattice.count, len(rows.columns) - 2), np.nan)
        for block in rows.blocks():
            self._enter(made, block, rows)
        made = self._whole(made, own)
        return self._of_all(made[..., :2], dict(zip(own, np.moveaxis(made, -1, 0)[2:])))

    def _of_all(self, deltas: Floats, others: Mapping[str, Floats]) -> CellNumbers:
        """Numbers of δ, and of `others` by their names; an axis or an angle that none of them names has the
        law's.
        """

        def together(*names: str) -> Floats | None:
            if others.keys().isdisjoint(names):
                return None
            law = {name: np.full(self.lattice.count, self.law[name]) for name in names}
            return np.stack([others.get(name, law[name]) for name in names], axis=-1)

        etas = others["eta"] if "eta" in others else together("eta_x", "eta_y")
        return CellNumbers(deltas, etas, together(*TURNS))

    def _enter(self, made: Floats, block: RowBlock, rows: NumberRows) -> None:
        """Write the numbers of a block of rows to their cells."""
        numbers, lines, first = block
        n1, n2 = self.lattice.count
        less = " less j // 2, as hexagons are counted" if self.lattice.hexagonal else ""
        whole = (numbers[:, :2] == np.rint(numbers[:, :2])) & (np.abs(numbers[:, :2]) < 2.0**53)
        index: Ints = np.where(whole, numbers[:, :2], -(2.0**53)).astype(np.int64)
        place, j = places_in_rows(self.lattice, index), index[:, 1]
        outside = np.column_stack([(place < 0) | (place >= n1), (j < 0) | (j >= n2)])
        flaws: tuple[tuple[Bools, int, str, str], ...] = (
            (~whole[:, 0], 0, "i is no whole number", "a whole number"),
            (~whole[:, 1], 1, "j is no whole number", "a whole number"),
            (outside[:, 1], 1, "j lies outside the sheet", f"0 to {n2 - 1}"),
            (outside[:, 0], 0, "i lies outside the sheet", f"0 to {n1 - 1}" + less),
            *(
                (~self._has_lens(numbers[:, k], name), k, f"{name} is out of range", self._allowed(name))
                for k, name in enumerate(rows.columns[2:], 2)
            ),
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
                f"cell ({index[row, 0]}, {j[row]}) occurs twice in the table",
                first + row,
                lines[row],
                0,
                allowed="each cell once",
            )
        made[place, j] = numbers[:, 2:]

    def _whole(self, made: Floats, names: Sequence[str]) -> Floats:
        """Numbers of every cell, 0 and the law's η where it is not kept; refuse a kept one without any."""
        missing = np.isnan(made[..., 0])
        for j in np.flatnonzero(missing.any(axis=0)).tolist():
            kept = self.lattice.row(j)
            places = places_in_rows(self.lattice, kept)
            lacking = kept[missing[places, j]]
            if len(lacking):
                self.refuse(
                    f"cell ({lacking[0, 0]}, {j}) is missing",
                    allowed=f"a row for each of {self.lattice.cell_count:,} cells",
                )
        return np.where(missing[..., None], (0.0, 0.0, *(self.law[name] for name in names)), made)

    def _has_lens(self, eta: Floats, name: str) -> Bools:
        """Whether each η (...) gives lenses of the law's signs, or each δ or angle is not too large."""
        if name not in ETAS:
            return np.asarray(np.abs(eta) <= TURNS.get(name, LARGEST))  # False for NaN
        low, high = _eta_range(self.eta[axis] for axis in ETAS[name])
        size = np.abs(eta)
        return np.asarray((low < eta) & (eta < high) & (size >= LEAST_ETA) & (size <= LARGEST))

    def _allowed(self, name: str) -> str:
        """Describe the numbers that a column or an array may have."""
        if name not in ETAS:
            most, unit = TURNS.get(name, LARGEST), " of degrees" if name in TURNS else ""
            return f"a number{unit} from -{most:g} to {most:g}"
        low, high = _eta_range(self.eta[axis] for axis in ETAS[name])
        if low >= high:
            return "eta_x and eta_y: those of law.eta lie on two sides of 0 or 1, where no one number does"
        low, high = max(low, -LARGEST), min(high, LARGEST)
        return (
            f"a number between {low:g} and {high:g}, |{name}| >= {LEAST_ETA:g}: both lenses as law.eta ="
            f" {self.law[name]:g} bends them"
        )

    # --- NPZ ------------------------------------------------------------------------------------------

    def _of_array(self) -> CellNumbers:
        """Read the arrays after validating their headers; never read more than the size in the header."""
        most = 64 * self.lattice.count[0] * self.lattice.count[1] + (1 << 20)
        if (
            size := os.stat(self.path).st_size
        ) > most:  # the library makes an object of each entry before any is validated
            self.refuse(f"{size:,} bytes are more than such arrays have", allowed=self._shapes())
        try:
            with zipfile.ZipFile(self.path) as archive:
                names = archive.namelist()
                deltas = self._entry(archive, names, ARRAY)
                each = ((name, self._entry(archive, names, name)) for name in (*ETAS, *TURNS))
                others = {name: one for name, one in each if one is not None}
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
        own = [name for name in others if name in ("eta", *TURNS) or "eta" not in others]
        unread = [name for name in names if name.removesuffix(".npy") not in (ARRAY, *own)]
        if unread:  # an ignored array would seem to be built
            self.refuse(
                f"{printable(unread[0])[:100]} is none of the arrays that are read", allowed=self._shapes()
            )
        bad = ~(np.abs(deltas) <= LARGEST)
        if bad.any():
            i, j, axis = (int(v[0]) for v in np.nonzero(bad))
            self.refuse(
                f"delta[{i}, {j}, {axis}] = {deltas[i, j, axis]} is out of range",
                allowed=f"numbers from -{LARGEST:g} to {LARGEST:g}",
            )
        return self._of_all(deltas, {name: self._of_kept(one, name) for name, one in others.items()})

    def _entry(self, archive: zipfile.ZipFile, names: list[str], name: str) -> Floats | None:
        """One array of the archive; None where no array has this name."""
        found = [entry for entry in names if entry.removesuffix(".npy") == name]
        if len(found) > 1:
            self.refuse(f"{len(found)} arrays {name!r} in the archive", allowed=self._shapes())
        if not found:
            return None
        with archive.open(found[0]) as stream:
            return self._array(stream, name)

    def _of_kept(self, etas: Floats, name: str) -> Floats:
        """Numbers of every cell, the law's where none is kept; refuse a kept one with one out of range."""
        lensed = self._has_lens(etas, name)
        for j in np.flatnonzero((~lensed).any(axis=0)).tolist():
            places = places_in_rows(self.lattice, self.lattice.row(j))
            bad = places[~lensed[places, j]]
            if len(bad):
                why = f"{name}[{bad[0]}, {j}] = {etas[bad[0], j]} is out of range"
                self.refuse(why, allowed=self._allowed(name))
        return np.where(lensed, etas, self.law[name])

    def _array(self, stream: IO[bytes], name: str) -> Floats:
        wanted = (*self.lattice.count, 2) if name == ARRAY else tuple(self.lattice.count)
        try:
            shape, fortran, kind = array_head(stream)
        except ValueError as error:
            self.refuse(f"array {name!r}: {error}", allowed=self._shapes())
        if shape != wanted or kind.kind not in "fiu" or fortran:
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
        more = ", ".join((*ETAS, *TURNS))
        return f"array {ARRAY!r} ({n1}, {n2}, 2) of numbers, C order; perhaps {more} ({n1}, {n2})"
