"""Bulk reading of long runs of XML elements of one form.

A mesh in XML is a run of millions of elements of one form. A parser with a callback per element takes
microseconds for each; matching the run's text with a regular expression takes a tenth of that. Only text that
the parser has just located within the run's parent is read in bulk, and only as far as it has that form. All
other text goes to the parser.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

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

    Parameters
    ----------
    form : bytes
        Regular expression of one element.
    take : callable
        Receives the text of many elements, spaces between them included.
    """

    form: bytes
    take: Callable[[bytes], None]


@dataclass(eq=False)
class RunReader:
    """Passes text to a parser, except the runs in it.

    Parameters
    ----------
    parser : Parser
    runs : mapping
        Name of the parent → the run within it.
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
        found = self._forms[self._inside].match(self._rest)
        assert found is not None
        if found.end():
            text, self._rest = self._rest[: found.end()], self._rest[found.end() :]
            self.runs[self._inside].take(text)
            self._give(b"\n" * text.count(b"\n"))  # so that the parser's line numbers stay right
        if len(self._rest) < LONGEST:
            return False  # possibly the start of one more element
        self._inside = ""
        return True
