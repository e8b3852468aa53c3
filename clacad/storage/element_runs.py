"""Elements of XML that follow one another by the million, taken many at a time.

A mesh in XML is a run of elements of one form. A parser that calls back for each of them takes microseconds each; the
run's own text, matched against that form as a whole, takes a tenth of it. Only text that the parser itself has just
said to lie within the run's parent is taken so, and only as far as it has that form: whatever else comes, in whatever
order, goes to the parser as ever.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

NUMBER = rb"-?[0-9]+(?:\.[0-9]+)?(?:[eE][-+]?[0-9]+)?"
"""A finite number as programs write it."""

WHOLE = rb"[0-9]{1,18}"
"""A whole number that fits 64 bits."""

LONGEST = 4096
"""Bytes that one element of a run may have."""

_SPACE = rb"[ \t\r\n]*+"
_PLAIN = (None, "utf-8", "us-ascii")
"""Encodings in which such text means what its bytes say."""


class Parser(Protocol):
    """What is asked of a parser of XML."""

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
        Gets the text of many of them, spaces between them included.
    """

    form: bytes
    take: Callable[[bytes], None]


@dataclass(eq=False)
class RunReader:
    """Hands text to a parser, except the runs in it.

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
        """Bytes that the parser got."""
        return self._given

    @property
    def held(self) -> int:
        """Bytes that wait for more."""
        return len(self._rest)

    def opened(self, tag: str, index: int) -> None:
        """To be told of every element that opens, with the byte at which the parser found it."""
        self._opened = (tag, index)

    def feed(self, block: bytes) -> None:
        """Take more text."""
        self._rest += block
        while self._inside or self._to_parent():
            if not self._through_run():
                return

    def end(self) -> None:
        """There is no more text."""
        rest, self._rest, self._inside = self._rest, b"", ""
        self._give(rest)

    def _give(self, text: bytes) -> None:
        if text:
            self.parser.Parse(text, False)
            self._given += len(text)

    def _to_parent(self) -> bool:
        """Give the parser all up to the next parent of a run; whether there is one and the parser says so, too."""
        found = self._parent.search(self._rest) if self.runs else None
        if found is None:
            # the beginning of such a name may be the end of this text
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
        """Take the elements that are there; whether the run has come to its end."""
        found = self._forms[self._inside].match(self._rest)
        assert found is not None
        if found.end():
            text, self._rest = self._rest[: found.end()], self._rest[found.end() :]
            self.runs[self._inside].take(text)
            self._give(b"\n" * text.count(b"\n"))  # so that the parser's line numbers stay right
        if len(self._rest) < LONGEST:
            return False  # the beginning of one more, perhaps
        self._inside = ""
        return True
