"""Resources used to read one file, compared with its reader's budget."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from clacad.base.reading_budgets import BUDGETS, MEGABYTE
from clacad.storage.errors import OverBudget, UnreadableFile

LONGEST_LINE = 1 << 16
LOOK = 4096
"""Number of lines or items between two checks of the clock."""


class Spending:
    """Counts the resources of reading one file; the file is rejected as soon as they exceed the budget.

    Parameters
    ----------
    reader : str
        A key of `BUDGETS`.
    path : path
    size : int or None
        Bytes of the file; None: its size on the disk.

    Raises
    ------
    OverBudget
        The file has more bytes than the reader's budget.
    OSError
        The file does not exist.
    """

    def __init__(self, reader: str, path: str | os.PathLike[str], size: int | None = None) -> None:
        self.name = Path(path).name
        self.budget = BUDGETS[reader]
        self.items = 0
        self._size = 0
        self._began, self._worked = time.thread_time(), 0.0
        self.unpacked(os.stat(path).st_size if size is None else size)

    def unpacked(self, size: int, of: str = "") -> None:
        """Record the (inflated) size of the file in bytes; more bytes allow more seconds.

        Raises
        ------
        OverBudget
        """
        self._size = max(self._size, size)
        if size > self.budget.bytes:
            raise self._refusal(f"{size:,} bytes{of} are more than the {self.budget.bytes:,} that are read")

    def count(self, items: int, at: str = "") -> None:
        """Record `items` more items; `at` gives the position in the file.

        Raises
        ------
        OverBudget
        """
        self.items += items
        most = self.budget.items
        if most is not None and self.items > most:
            raise self._refusal(f"more than {most:,} {self.budget.item}{at and ', ' + at}")

    def look(self, at: str = "") -> None:
        """Compare the processor seconds of this thread since the beginning with the budget.

        Raises
        ------
        OverBudget
        """
        self._hold(time.thread_time() - self._began, at)

    @contextmanager
    def working(self, at: str = "") -> Iterator[None]:
        """Compare the processor seconds of all such blocks with the budget, for a reader that works on
        demand.

        Raises
        ------
        OverBudget
        """
        began = time.thread_time()
        yield
        self._worked += time.thread_time() - began
        self._hold(self._worked, at)

    def _hold(self, seconds: float, at: str) -> None:
        most = self.budget.seconds_for(self._size)
        if seconds > most:
            raise self._refusal(
                f"reading its {self._size / MEGABYTE:.3g} MB took more than {most:.3g} s of processor time"
                f"{at and ', ' + at}"
            )

    def lines(self, stream: IO[bytes]) -> Iterator[bytes]:
        """Lines of a text file; the clock is checked at intervals.

        Raises
        ------
        UnreadableFile
            A line has more than 65,536 bytes.
        OverBudget
        """
        number = 0
        while line := stream.readline(LONGEST_LINE + 1):
            number += 1
            if len(line) > LONGEST_LINE:
                raise UnreadableFile(f"{self.name}: line {number} has more than {LONGEST_LINE:,} bytes")
            if number % LOOK == 0:
                self.look(f"in line {number:,}")
            yield line

    def _refusal(self, why: str) -> OverBudget:
        return OverBudget(f"{self.name}: {why} ('clacad doctor' lists what is read)")
