"""What the commands say: data on stdout, talk on stderr, progress only when it takes longer than a second."""

from __future__ import annotations

import json as json_module
import math
import sys
import threading
import time
from typing import Any

from clacad.base import log
from clacad.base.machine_rates import processor_seconds_now, span_text
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


AGAIN, AGAIN_IN_LOG = 1.0, 30.0
"""Seconds after which the stage at work is said again: on a terminal, and where each time is a line of its own."""

ENOUGH = 0.5
"""Processor seconds of a command from which on its speed is known."""


class Progress:
    """One line on stderr that says which stage is at work and how far it is.

    Silent for the first second, and when quiet; then it says the stage at work again and again, whether or not that tells of itself.
    What is left is the forecast's processor seconds as fast as the machine lets this command have them. On a
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
        self._expected_from = self._start, 0.0
        self._lock = threading.RLock()
        self._next: threading.Timer | None = None
        if not quiet and not log.on():
            self._show_again_in(after)

    def expect(self, seconds: float) -> None:
        """Say what all of it is forecast to take from now on, processor seconds."""
        self._expected = seconds
        self._expected_from = time.monotonic(), processor_seconds_now()

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

    def _show_again_in(self, seconds: float) -> None:
        self._next = threading.Timer(seconds, self._show_again)
        self._next.daemon = True
        self._next.start()

    def _show_again(self) -> None:
        """The stage at work, if nothing was said of it for a while."""
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
        """What is left of all by the forecast, or that it takes longer; nothing where no forecast was made, or the
        difference is less than a second.
        """
        if not self._expected > 0.0:
            return ""
        began, used_before = self._expected_from
        used = processor_seconds_now() - used_before
        if used > self._expected:
            if used < self._expected + 1.0:
                return ""
            return f" (longer than forecast: {used:.0f} s of processor time for {self._expected:.0f})"
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
            self._shown = math.inf  # nothing is said any more
            if self._next is not None:
                self._next.cancel()
            self._clear()
