"""What the commands say: data on stdout, talk on stderr, progress only when it takes longer than a second."""

from __future__ import annotations

import json as json_module
import math
import sys
import threading
import time
from typing import Any

from clacad.base import log
from clacad.base.machine_rates import span_text
from clacad.base.text import plain, printable_lines
from clacad.base.text import table as table
from clacad.cli.streams import is_unicode


def show_json(value: Any) -> None:
    """Print one JSON document on stdout."""
    sys.stdout.write(json_text(value, ascii_only=not is_unicode(getattr(sys.stdout, "encoding", "utf-8"))))


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
    """Print talk on stderr."""
    if not quiet:
        sys.stderr.write(printable_lines(text) + "\n")


def size(count: float) -> str:
    """Bytes as a person reads them."""
    for unit in ("B", "kB", "MB", "GB"):
        if count < 1000.0:
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.3g} {unit}"
        count /= 1000.0
    return f"{count:.3g} TB"


class Progress:
    """One line on stderr that says which stage is at work and how far it is.

    Silent for the first second, and when quiet; then it says the stage at work, whether or not that tells of itself. On a
    terminal the line is rewritten; elsewhere every stage gets one line. Call it as a function: progress(stage, fraction),
    fraction None or NaN where unknown.
    """

    def __init__(self, *, quiet: bool = False, after: float = 1.0) -> None:
        self._start = time.monotonic()
        self._after = after
        self._quiet = quiet
        self._stage = ""
        self._stage_start = self._start
        self._shown = 0.0
        self._open = False
        self._terminal = sys.stderr.isatty()
        self._expected = 0.0
        self._lock = threading.RLock()
        self._first: threading.Timer | None = None
        if not quiet and not log.on():
            self._first = threading.Timer(after, self._show_first)
            self._first.daemon = True
            self._first.start()

    def expect(self, seconds: float) -> None:
        """Say what all of it is forecast to take from now on, processor seconds."""
        self._expected = time.monotonic() - self._start + seconds

    def say(self, text: str) -> None:
        """A line that stays."""
        with self._lock:
            self._clear()
            say(text, quiet=self._quiet)

    def __call__(self, stage: str, fraction: float | None = None) -> None:
        """Tell how far a stage is, 0 to 1."""
        now = time.monotonic()
        with self._lock:
            fresh = stage != self._stage
            if fresh:
                self._stage, self._stage_start = stage, now
            if log.on():  # the log says what the line would
                if fresh:
                    log.note("stage", name=stage)
                return
            if self._quiet or now - self._start < self._after:
                return
            self._show(stage, fraction, now, fresh=fresh)

    def _show_first(self) -> None:
        """The stage at work when the silent second ends, if it has not been said by then."""
        with self._lock:
            if self._stage and not self._shown:
                self._show(self._stage, None, time.monotonic(), fresh=True)

    def _show(self, stage: str, fraction: float | None, now: float, *, fresh: bool) -> None:
        if not self._terminal:
            if fresh or not self._shown:
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
        """What is left of all by the forecast; nothing where none was made, or less than a second is."""
        left = self._expected - (now - self._start)
        return f" (of all, about {span_text(left, left).removeprefix('about ')} left)" if left >= 1.0 else ""

    def _clear(self) -> None:
        if self._open:
            sys.stderr.write("\r\x1b[2K")
            sys.stderr.flush()
            self._open = False

    def done(self) -> None:
        """Clear the line."""
        if self._first is not None:
            self._first.cancel()
        with self._lock:
            self._shown = self._shown or math.inf  # nothing is said any more that was not
            self._clear()
