"""An event log: one JSON object per line on the error stream, only when requested.

`clacad -v` turns it on. Every line has `t` (seconds since the log began) and `event`; the other keys depend
on the event:
=========  ================================================================
event      keys
=========  ================================================================
start      version, python, system, arguments, folder
stage      name: the stage that begins
file       name, format, bytes, sha256, checks, seconds: written and read back
failure    format, sentence, details: one output that could not be written
error      kind, sentence, status, traceback (list of lines), details
end        status, seconds, memory (greatest, bytes)
=========  ================================================================

Lines of the log begin with `{`; other messages on the error stream never do. The log contains folder names
and the arguments of the call. It is therefore kept out of every written file.
"""

from __future__ import annotations

import json
import sys
import time
from contextlib import suppress
from typing import Any, TextIO

_stream: TextIO | None = None
_began = 0.0


def start(stream: TextIO | None = None) -> None:
    """Begin a log.

    stream : text stream or None. Destination of the lines; None is the error stream.
    """
    global _stream, _began  # one process, one error stream
    _stream, _began = stream if stream is not None else sys.stderr, time.monotonic()


def stop() -> None:
    """End the log; later events are dropped."""
    global _stream
    _stream = None


def on() -> bool:
    """Whether the log is on: facts that are costly to gather are gathered only then."""
    return _stream is not None


def note(event: str, **facts: Any) -> None:
    """Write one line; without a log do nothing. Never raise: the log must not interrupt the work.

    **facts : Any JSON value; another object is written as its text.
    """
    if _stream is None:
        return
    line = {"t": round(time.monotonic() - _began, 4), "event": event, **facts}
    with suppress(OSError, ValueError):
        _stream.write(
            json.dumps(line, default=str) + "\n"
        )  # ASCII: no character controls a terminal or ends the line
        _stream.flush()


def seconds() -> float:
    """Seconds since the log began."""
    return time.monotonic() - _began


def memory() -> int | None:
    """Peak memory of this process so far, bytes; None where the system does not report it."""
    try:
        import resource
    except ImportError:
        return None
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
