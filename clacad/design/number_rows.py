"""Untrusted CSV tables of numbers: a header, and rows with one number per column."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import IO, Final, NamedTuple, NoReturn

import numpy as np

from clacad.base.types import Floats
from clacad.base.untrusted_files import BUDGETS
from clacad.config.design_error import DesignError, DesignTooLarge
from clacad.config.mistakes import Mistake

LONGEST_ROW: Final = 1000
BLOCK: Final = 1 << 16
"""Rows read at a time."""


class RowBlock(NamedTuple):
    """Several rows: their numbers (n, columns), their text,
    and the number of the first in the file (from 1).
    """

    numbers: Floats
    lines: list[str]
    first: int


@dataclass(frozen=True)
class NumberRows:
    """A CSV file of numbers.

    Parameters
    ----------
    path : str
    columns : tuple of str
        The header.
    key : str
        Key of the design that names the file, "" where none does.
    elsewhere : tuple of (str, str)
        Prefixes of columns that do not belong to the table, and what to do instead.
    """

    path: str
    columns: tuple[str, ...]
    key: str = ""
    elsewhere: tuple[tuple[str, str], ...] = ()

    def names(self) -> list[str]:
        """Columns of the header, valid or not.

        Raises
        ------
        DesignError
            The header is not UTF-8, or too long.
        """
        with open(self.path, "rb") as stream:
            line = self._text(stream.readline(LONGEST_ROW), 1).removeprefix("\ufeff")
        return [part.strip() for part in line.split(",")]

    def blocks(self) -> Iterator[RowBlock]:
        """Iterate over blocks of rows.

        Raises
        ------
        DesignError
            With row and column: another header, a value that is no number, too few or many values, text that
            is not UTF-8.
        DesignTooLarge
            More rows than the reader's limit.
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
        raise DesignError(
            [
                Mistake(
                    "CL124",
                    message,
                    self.key,
                    self.path,
                    row,
                    place,
                    allowed=allowed,
                    hint=hint,
                    source_line=line,
                )
            ]
        )

    def _header(self, line: str) -> None:
        names = [part.strip() for part in line.split(",")]
        if names != [*self.columns]:
            wrong = next(
                (k for k, pair in enumerate(zip(names, self.columns)) if pair[0] != pair[1]),
                min(len(names), len(self.columns)),
            )
            hint = next(
                (way for start, way in self.elsewhere for name in names if name.startswith(start)), ""
            )
            self.refuse(
                "the header is not the required one",
                1,
                line,
                wrong,
                allowed=",".join(self.columns),
                hint=hint,
            )

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
                raise DesignTooLarge([Mistake("CL124", f"more than {most:,} rows", self.key, self.path, row)])
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
