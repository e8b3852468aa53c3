"""Output of the commands: results on stdout, messages on stderr, progress of a wait.

Results within 24 lines of 100 columns: verdict, facts, problems, files, next commands, verdict.
"""

from __future__ import annotations

import json as json_module
import math
import os
import re
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from shutil import get_terminal_size
from typing import Any
from unicodedata import combining, east_asian_width

from clacad.base import log
from clacad.base.machine_rates import Clock, Rates, Span, processor_seconds, processor_seconds_now
from clacad.base.text import plain, printable_lines, span_text
from clacad.base.text import table as table


@dataclass(frozen=True)
class Console:
    """Output of one command.

    json : Whether results are JSON.
    quiet : Whether only errors are printed, and JSON.
    all : Whether results are printed whole, not within `brief.LINES` lines.
    """

    json: bool = False
    quiet: bool = False
    all: bool = False

    def show(
        self, document: Callable[[], Any], text: Callable[[], str], brief: Callable[[], Brief] | None = None
    ) -> None:
        """Print a result: one JSON document, its text, or its most important lines (default: the first)."""
        if self.json:
            show_json(document())
        elif self.quiet:
            return
        elif self.all:
            show_text(text())
        else:
            show_text(str(brief()) if brief is not None else clipped(text()))

    def print(self, text: str) -> None:
        """Print text on stdout unless quiet."""
        show_text(text, quiet=self.quiet)

    def say(self, text: str) -> None:
        """Print a message on stderr unless quiet."""
        say(text, quiet=self.quiet)

    @contextmanager
    def progress(self) -> Iterator[Progress]:
        """Line of progress for the time of the block."""
        progress = Progress(quiet=self.quiet)
        try:
            yield progress
        finally:
            progress.done()

    @contextmanager
    def forecast(
        self, task: str, modelled: float | Span, *, clock: Clock = processor_seconds
    ) -> Iterator[Span]:
        """Print the cost of the block on this machine, then record its actual cost.

        A run in which kernels were compiled is not recorded: the next one will be faster.

        task : Name under which it is recorded.
        modelled : Seconds by the model of the reference machine; or a range measured on a part of the work,
            which is corrected by earlier runs of the same task.
        clock : Processor seconds so far.
        """
        rates = Rates.here()
        middle = modelled.middle if isinstance(modelled, Span) else modelled
        span = rates.span(task, middle)
        if isinstance(modelled, Span) and span.seen == 0:
            span = modelled
        self.announce(span, span.high)
        kept, began = _kernels(), clock()
        yield span
        if _kernels() == kept:
            rates.note(task, middle, clock() - began)

    def announce(self, span: Span, seconds: float) -> None:
        """Print a forecast if some of its seconds are worth it."""
        if seconds >= WORTH_PRINTING:
            self.say(f"this takes {span} of processor time")

    def announce_compiling(self, task: str, modelled: float) -> None:
        """Print the cost of compiling on top of a forecast (modelled seconds); nothing for 0."""
        if modelled > 0.0:
            takes = Rates.here().span(task, modelled)
            self.say(f"what traces is compiled on the way, once on this machine: {takes} more")


WORTH_PRINTING = 2.0
"""Processor seconds from which a forecast is printed."""


def _kernels() -> frozenset[tuple[Path, int]]:
    """Compiled kernels of every package in the caches, with their times of modification."""
    from clacad.doctor import kernel_cache

    own = Path(__file__).parent.parent.glob("**/__pycache__/*.nbc")
    found = set()
    for kept in {*kernel_cache()[1], *own}:
        with suppress(OSError):  # another process replaces it
            found.add((kept, kept.stat().st_mtime_ns))
    return frozenset(found)


# -- streams -------------------------------------------------------------------------------------------------


def show_json(value: Any) -> None:
    """Print one JSON document on stdout."""
    sys.stdout.write(json_text(value, ascii_only=not _is_unicode(getattr(sys.stdout, "encoding", "utf-8"))))


def json_text(value: Any, *, ascii_only: bool = False) -> str:
    """One JSON document: sorted keys, no NaN (null instead), paths as text."""
    return (
        json_module.dumps(plain(value), indent=1, sort_keys=True, ensure_ascii=ascii_only, default=str) + "\n"
    )


def show_text(text: str, *, quiet: bool = False) -> None:
    """Print result text on stdout."""
    if not quiet:
        sys.stdout.write(printable_lines(text) + "\n")


def say(text: str, *, quiet: bool = False) -> None:
    """Print a message on stderr."""
    if not quiet:
        sys.stderr.write(printable_lines(text) + "\n")


def make_writable() -> None:
    """Redirect closed standard streams to the null device, and escape characters that an encoding lacks.

    A file opened later must not get the number of a closed stream, or printed text would end up in it. A
    terminal of ASCII only, or a file name that is no text, does not change the exit status.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            with suppress(OSError):
                os.open(os.devnull, os.O_RDWR)  # gets the lowest free number: the closed one
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _is_unicode(encoding: str | None) -> bool:
    return (encoding or "").lower().replace("-", "").replace("_", "").startswith("utf")


# -- progress ------------------------------------------------------------------------------------------------


AFTER, AFTER_IN_LOG = 1.0, 5.0
"""Seconds of silence before the first stage is printed: on a terminal, and elsewhere."""

AGAIN, AGAIN_IN_LOG = 1.0, 600.0
"""Seconds after which the current stage is printed again: on a terminal, and elsewhere, on a new line."""

ENOUGH = 0.5
"""Processor seconds of a command from which on its speed is known."""


class Progress:
    """One line on stderr with the current stage and its share of completion.

    Silent for the first seconds, and when quiet; then the current stage is printed repeatedly, even if it
    reports nothing. The remaining time is the forecast's processor seconds at the rate of this run. On
    a terminal the line is rewritten; elsewhere a long wait gets one line. Call it as a function:
    progress(stage, fraction), fraction None or NaN where unknown.
    """

    def __init__(self, *, quiet: bool = False, after: float | None = None) -> None:
        self._start = time.monotonic()
        self._terminal = sys.stderr.isatty()
        self._after = (AFTER if self._terminal else AFTER_IN_LOG) if after is None else after
        self._quiet = quiet
        self._stage = ""
        self._stage_start = self._start
        self._shown = 0.0
        self._open = False
        self._expected = 0.0
        self._expected_from = self._start, 0.0
        self._lock = threading.RLock()
        self._next: threading.Timer | None = None
        if not quiet and not log.on():
            self._show_again_in(self._after)

    def expect(self, seconds: float) -> None:
        """Set the forecast of the whole remaining work, processor seconds."""
        self._expected = seconds
        self._expected_from = time.monotonic(), processor_seconds_now()

    def say(self, text: str) -> None:
        """Print a line that stays."""
        with self._lock:
            self._clear()
            say(text, quiet=self._quiet)

    def __call__(self, stage: str, fraction: float | None = None) -> None:
        """Report the share of a stage that is done, 0 to 1."""
        now = time.monotonic()
        with self._lock:
            fresh = stage != self._stage
            if fresh:
                self._stage, self._stage_start = stage, now
            if log.on():  # the log has the same facts
                if fresh:
                    log.note("stage", name=stage)
                return
            if self._quiet or now - self._start < self._after:
                return
            self._show(stage, fraction, now, fresh=fresh)

    def _show_again_in(self, seconds: float) -> None:
        self._next = threading.Timer(seconds, self._show_again)
        self._next.daemon = True
        self._next.start()

    def _show_again(self) -> None:
        """Print the current stage if nothing was printed for a while."""
        pause = AGAIN if self._terminal else AGAIN_IN_LOG
        with self._lock:
            now = time.monotonic()
            if self._shown == math.inf:
                return
            if self._stage and (not self._shown or now - self._shown >= pause):
                self._show(self._stage, None, now, fresh=True)
            self._show_again_in(pause)

    def _show(self, stage: str, fraction: float | None, now: float, *, fresh: bool) -> None:
        if not self._terminal:
            if not self._shown or now - self._shown >= AGAIN_IN_LOG:
                sys.stderr.write(f"{stage} ...{self._left(now)}\n")
                self._shown = now
            return
        if now - self._shown < 0.1 and not fresh:
            return
        sys.stderr.write("\r\x1b[2K" + self._line(stage, fraction, now))
        sys.stderr.flush()
        self._shown, self._open = now, True

    def _line(self, stage: str, fraction: float | None, now: float) -> str:
        elapsed = now - self._stage_start
        if fraction is None or not math.isfinite(fraction) or fraction <= 0.0:
            return f"{stage}  {elapsed:.0f} s{self._left(now)}"
        left = elapsed * (1.0 - fraction) / fraction
        return f"{stage}  {100.0 * fraction:.0f} %  {elapsed:.0f} s, {left:.0f} s left{self._left(now)}"

    def _left(self, now: float) -> str:
        """Remaining time by the forecast, or its excess; "" without a forecast or for less than a second."""
        if not self._expected > 0.0:
            return ""
        began, used_before = self._expected_from
        used = processor_seconds_now() - used_before
        if used > self._expected:
            if used < self._expected + 1.0:
                return ""
            spent, planned = (span_text(s, s).removeprefix("about ") for s in (used, self._expected))
            return f" (longer than forecast: {spent} of processor time for {planned})"
        pace = (now - began) / used if used > ENOUGH else 1.0
        left = (self._expected - used) * pace
        return f" (of all, about {span_text(left, left).removeprefix('about ')} left)" if left >= 1.0 else ""

    def _clear(self) -> None:
        if self._open:
            sys.stderr.write("\r\x1b[2K")
            sys.stderr.flush()
            self._open = False

    def done(self) -> None:
        """Clear the line."""
        with self._lock:
            self._shown = math.inf  # nothing is printed any more
            if self._next is not None:
                self._next.cancel()
            self._clear()


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
