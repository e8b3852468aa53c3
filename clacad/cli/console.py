"""Output of the commands: results on stdout, messages on stderr, progress of a wait."""

from __future__ import annotations

import json as json_module
import math
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clacad.base import log
from clacad.base.machine_rates import Clock, Rates, Span, processor_seconds, processor_seconds_now
from clacad.base.text import plain, printable_lines, span_text
from clacad.base.text import table as table
from clacad.cli.brief import Brief, clipped


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
