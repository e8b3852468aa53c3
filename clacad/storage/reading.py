"""Reading of files: resources spent, hash of what is read, and long runs of XML elements.

Resources used to read one file, compared with its reader's budget.

Hash of a file, computed while it is read for another purpose.

Bulk reading of long runs of XML elements of one form.

A mesh in XML is a run of millions of elements of one form. A parser with a callback per element takes
microseconds for each; matching the run's text with a regular expression takes a tenth of that. Only text that
the parser has just located within the run's parent is read in bulk, and only as far as it has that form. All
other text goes to the parser.
"""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import IO, Protocol

from clacad.base.text import size_in
from clacad.base.untrusted_files import BUDGETS
from clacad.storage.errors import OverBudget, UnreadableFile

LONGEST_LINE = 1 << 16
LOOK = 4096
"""Number of lines or items between two checks of the clock."""


class Spending:
    """Counts the resources of reading one file; the file is rejected as soon as they exceed the budget.

    reader : A key of `BUDGETS`.
    size : Bytes of the file; None: its size on the disk.
    Raises OverBudget: The file has more bytes than the reader's budget.
    Raises OSError: The file does not exist.
    size : Bytes of the file, unpacked.
    """

    def __init__(self, reader: str, path: str | os.PathLike[str], size: int | None = None) -> None:
        self.name = Path(path).name
        self.budget = BUDGETS[reader]
        self.items = 0
        self.size = 0
        self._began, self._worked = time.thread_time(), 0.0
        self.unpacked(os.stat(path).st_size if size is None else size)

    def unpacked(self, size: int, of: str = "") -> None:
        """Record the (inflated) size of the file in bytes; more bytes allow more seconds.

        Raises OverBudget.
        """
        self.size = max(self.size, size)
        if size > self.budget.bytes:
            raise self._refusal(f"{size:,} bytes{of} are more than the {self.budget.bytes:,} that are read")

    def count(self, items: int, at: str = "") -> None:
        """Record `items` more items; `at` gives the position in the file. Raises OverBudget."""
        self.items += items
        most = self.budget.items
        if most is not None and self.items > most:
            raise self._refusal(f"more than {most:,} {self.budget.item}{at and ', ' + at}")

    def look(self, at: str = "") -> None:
        """Compare the processor seconds of this thread since the beginning with the budget.

        Raises OverBudget.
        """
        self._hold(time.thread_time() - self._began, at)

    @contextmanager
    def working(self, at: str = "") -> Iterator[None]:
        """Compare the processor seconds of all such blocks with the budget, for a reader that works on
        demand.

        Raises OverBudget.
        """
        began = time.thread_time()
        yield
        self._worked += time.thread_time() - began
        self._hold(self._worked, at)

    def _hold(self, seconds: float, at: str) -> None:
        most = self.budget.seconds_for(self.size)
        if seconds > most:
            raise self._refusal(
                f"reading its {size_in(self.size, 'MB', '.3g')} took more than {most:.3g} s of processor time"
                f"{at and ', ' + at}"
            )

    def lines(self, stream: IO[bytes]) -> Iterator[bytes]:
        """Lines of a text file; the clock is checked at intervals.

        Raises UnreadableFile: A line has more than 65,536 bytes.
        Raises OverBudget.
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


BLOCK = 1 << 20


class Overheard:
    """SHA-256 of a file, computed from bytes read in order by another reader; the rest is read at the end.

    A file of gigabytes is therefore read once, and the hash is that of the checked bytes.

    heard : int. Number of bytes hashed so far, from the start of the file.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._digest, self.heard = path, sha256(), 0

    def hear(self, start: int, block: bytes) -> None:
        """Hash the bytes of the file from `start` on, if they are the next ones."""
        if start == self.heard:
            self._digest.update(block)
            self.heard += len(block)

    def hexdigest(self) -> str:
        """Hash of the whole file, hexadecimal."""
        with self._path.open("rb") as stream:
            stream.seek(self.heard)
            while block := stream.read(BLOCK):
                self.hear(self.heard, block)
        return self._digest.hexdigest()


NUMBER = rb"-?[0-9]+(?:\.[0-9]+)?(?:[eE][-+]?[0-9]+)?"
"""Finite number as programs write it."""

WHOLE = rb"[0-9]{1,18}"
"""Whole number that fits 64 bits."""

LONGEST = 4096
"""Largest size (bytes) of one element of a run."""

_SPACE = rb"[ \t\r\n]*+"
_PLAIN = (None, "utf-8", "us-ascii")
"""Encodings in which the matched text is ASCII-compatible."""


class Parser(Protocol):
    """Required interface of an XML parser."""

    def Parse(self, data: bytes, isfinal: bool = ..., /) -> int:
        """Parse more text."""


@dataclass(frozen=True, eq=False)
class ElementRun:
    """Elements of one form in one parent.

    form : bytes. Regular expression of one element.
    take : Receives the text of many elements, spaces between them included.
    quick : Takes elements of a narrower form from the beginning of a text; returns the bytes that it took.
    """

    form: bytes
    take: Callable[[bytes], None]
    quick: Callable[[bytes], int] = lambda _: 0


@dataclass(eq=False)
class RunReader:
    """Passes text to a parser, except the runs in it.

    runs : Name of the parent → the run within it.
    """

    parser: Parser
    runs: Mapping[str, ElementRun]
    encoding: str | None = None
    _given: int = 0
    _opened: tuple[str, int] = ("", -1)
    _rest: bytes = b""
    _inside: str = ""
    _forms: dict[str, re.Pattern[bytes]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        names = b"|".join(re.escape(name.encode()) for name in self.runs)
        self._parent = re.compile(rb"<(%s)>" % names)
        self._forms = {
            name: re.compile(rb"(?:%s(?>%s))*+" % (_SPACE, run.form)) for name, run in self.runs.items()
        }

    @property
    def given(self) -> int:
        """Number of bytes passed to the parser."""
        return self._given

    @property
    def held(self) -> int:
        """Number of bytes held until more text arrives."""
        return len(self._rest)

    def opened(self, tag: str, index: int) -> None:
        """Record an opened element and its byte position; the caller reports every parent of a run."""
        self._opened = (tag, index)

    def feed(self, block: bytes) -> None:
        """Process more text."""
        self._rest += block
        while self._inside or self._to_parent():
            if not self._through_run():
                return

    def end(self) -> None:
        """Process the held text at the end of the input."""
        rest, self._rest, self._inside = self._rest, b"", ""
        self._give(rest)

    def _give(self, text: bytes) -> None:
        if text:
            self.parser.Parse(text, False)
            self._given += len(text)

    def _pass(self, size: int) -> bytes:
        """Drop and return text that was taken; the parser gets its line breaks and keeps its line numbers."""
        text, self._rest = self._rest[:size], self._rest[size:]
        self._give(b"\n" * text.count(b"\n"))
        return text

    def _to_parent(self) -> bool:
        """Pass text to the parser up to the next parent of a run; return whether the parser confirms one."""
        found = self._parent.search(self._rest) if self.runs else None
        if found is None:
            # this text may end within the name of a parent
            cut = self._rest.rfind(b"<", -64) if self.runs else -1
            head, self._rest = (self._rest, b"") if cut < 0 else (self._rest[:cut], self._rest[cut:])
            self._give(head)
            return False
        at = self._given + found.start()
        name = found.group(1).decode()
        head, self._rest = self._rest[: found.end()], self._rest[found.end() :]
        self._give(head)
        if self._opened == (name, at) and (self.encoding or "utf-8").lower() in _PLAIN:
            self._inside = name
            return True
        return self._to_parent()

    def _through_run(self) -> bool:
        """Read the available elements; return whether the run has ended."""
        run = self.runs[self._inside]
        self._pass(run.quick(self._rest))
        found = self._forms[self._inside].match(self._rest)
        assert found is not None
        if found.end():
            run.take(self._pass(found.end()))
        if len(self._rest) < LONGEST:
            return False  # possibly the start of one more element
        self._inside = ""
        return True
