"""Results within 24 lines of 100 columns: verdict, facts, problems, files, next commands, verdict."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from shutil import get_terminal_size
from unicodedata import combining, east_asian_width

from clacad.base.text import printable_lines, table

LINES, COLUMNS = 21, 100
"""Lines of a result without --all, and columns of a line: with three messages it fits 24 x 100."""

NARROWEST = 20
"""Least columns of a line."""

Entry = tuple[str, str]
"""One entry of a list: its name, and its text of one or more lines."""

ALL = "all numbers: --all"


@dataclass(frozen=True)
class Brief:
    """What a command prints without --all.

    head : The first line: what the result is of, and the verdict.
    lists : tuple of sequences of Entry
        Facts, problems, files: as much of each is printed as there is room for, and the names of the rest.
    next : Commands to run next; they are never cut.
    foot : The last line: the verdict of a command that judges.
    counts : What the last line keeps where the verdict is cut: numbers of checks.
    """

    head: str
    lists: tuple[Sequence[Entry], ...] = ()
    next: tuple[str, ...] = ()
    foot: str = ""
    counts: str = ""

    def __str__(self) -> str:
        """Return the text, at most `LINES` lines as wide as the terminal."""
        width = _columns()
        head = _folded(self.head, width, 2)
        foot = self._last(width)
        following = [
            line
            for number, command in enumerate(self.next)
            for line in _command(f"{'      ' if number else 'next: '}{command}", width)
        ]
        room = LINES - len(head) - len(foot) - len(following)
        lists = [one for one in self.lists if one]
        return "\n".join([*head, *_fitted(lists, width, room), *following, *foot])

    def _last(self, width: int) -> list[str]:
        """One line that begins with the verdict, which is cut; two on a terminal of few columns."""
        if not self.foot:
            return [ALL]
        tail = f"{self.counts and f': {self.counts}'} ({ALL})"
        if len(tail) > width - 2 * NARROWEST:
            return _folded(self.foot + tail, width, 2)
        word = re.sub(r" \(\d[^()]*\)$", "", self.foot)  # its number of checks: `counts` has them
        return [_folded(word, width - len(tail), 1)[0] + tail]


def facts(rows: Iterable[Sequence[str]]) -> list[Entry]:
    """Entries of a table, each named by its first column; rows without any other text are left out."""
    kept = [row for row in rows if any(row[1:])]
    return [(row[0], line) for row, line in zip(kept, table(kept).split("\n"))]


def clipped(text: str) -> str:
    """Text of at most `LINES` lines as wide as the terminal: its first lines, and its last one."""
    lines, width = printable_lines(text).split("\n"), _columns()
    for most in (LINES, 3, 2):
        folded = [part for line in lines for part in _folded(line, width, most)]
        if len(folded) <= LINES:
            return "\n".join(folded)
    *folded, last = (_folded(line, width, 1)[0] for line in lines)
    room = LINES - 2 if len(lines) > LINES else LINES - 1
    left = len(folded) - room
    more = f"... {f'{left} more lines' if left > 0 else 'lines are cut'}: --all"
    return "\n".join([*folded[:room], more, last])


def _columns() -> int:
    return max(NARROWEST, min(COLUMNS, get_terminal_size((COLUMNS, LINES)).columns))


def _fitted(lists: Sequence[Sequence[Entry]], width: int, room: int) -> Iterator[str]:
    """Lines of all lists: whole, with long texts cut, or with the last entries of each by name only."""
    for most in (LINES, 4, 3, 2, 1):
        made = [[(name, _entry(text, width, most)) for name, text in one] for one in lists]
        sizes = [sum(len(lines) for _, lines in one) for one in made]
        if sum(sizes) <= room:
            break
    for number, one in enumerate(made):
        share = room - sum(min(size, 3) for size in sizes[number + 1 :])
        count = len(one)
        while count and sum(len(lines) for _, lines in one[:count]) + (count < len(one)) > share:
            count -= 1
        for _, lines in one[:count]:
            yield from lines
            room -= len(lines)
        if count < len(one):
            names = ", ".join(dict.fromkeys(name for name, _ in one[count:]))
            yield _folded(f"  {len(one) - count} more (--all): {names}", width, 1)[0]
            room -= 1


SHELL_WORDS = r"\s*(?:'[^']*'|\"[^\"]*\"|[^\s'\"])+"
"""Words of a command, quoted or not, each with the space before it."""


def _command(line: str, width: int) -> list[str]:
    """A command broken between words, each line but the last ended by a backslash: it runs when pasted."""
    *broken, last = _folded(line, width, LINES, whole=True)
    if broken:
        *broken, last = _folded(line, width - 2, LINES, whole=True)
    return [*(f"{part} \\" for part in broken), last]


def _entry(text: str, width: int, most: int) -> list[str]:
    return [part for line in text.split("\n") for part in _folded(line, width, most)]


def _folded(line: str, width: int, most: int, *, whole: bool = False) -> list[str]:
    """A line broken between words into at most `most` lines, continued under its last column.

    A word longer than a line is broken, too, unless `whole`.
    """
    if _width(line) <= width:
        return [line]
    start = re.match(r"\s*(?:.*\S {2,})?", line)
    under = 0 if start is None else len(start[0])
    if under > width // 2:
        under = len(line) - len(line.lstrip()) + 2
    made, rest = [""], re.findall(SHELL_WORDS if whole else r"\s*\S+", line)
    while rest:
        word = rest.pop(0)
        if _width(made[-1] + word) <= width:
            made[-1] += word
            continue
        fresh = " " * under + word.lstrip()
        if not whole and _width(fresh) > width:  # as many characters as fit on what is left of this line
            count = next(n for n in range(len(word), -1, -1) if _width(made[-1] + word[:n]) <= width)
            fresh, made[-1] = " " * under + word[count:].lstrip(), made[-1] + word[:count]
            if _width(fresh) > width:
                rest.insert(0, word[count:])
                fresh = " " * under
        made.append(fresh)
    if len(made) > most:
        made = made[:most]
        while _width(made[-1]) > width - 4:
            made[-1] = made[-1].rstrip().rpartition(" ")[0].rstrip() or made[-1][:-1]
        made[-1] = f"{made[-1].rstrip()} ..."
    return made


def _width(text: str) -> int:
    """Columns of a text in a terminal."""
    if text.isascii():
        return len(text)
    return sum(0 if combining(c) else 2 if east_asian_width(c) in "WF" else 1 for c in text)
