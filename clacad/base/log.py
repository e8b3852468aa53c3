"""A log of what is done: one JSON object a line on the error stream, and nothing unless it was asked for.

`clacad -v` turns it on. Every line has `t` (seconds since the log began) and `event`; the other keys belong to
the event:

=========  ================================================================
event      keys
=========  ================================================================
start      version, python, system, arguments, folder
stage      name: what is being done now
file       name, format, bytes, sha256, checks, seconds: written and read back
failure    format, sentence, details: one output that could not be made
error      kind, sentence, status, traceback (list of lines), details
end        status, seconds, memory (greatest, bytes)
=========  ================================================================

Lines of the log begin with `{`; other talk on the error stream never does. The log names folders and the
arguments of the call, and is therefore kept out of every file that is written.
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

    Parameters
    ----------
    stream : text stream or None
        Where lines go; None is the error stream.
    """
    global _stream, _began  # one process, one error stream
    _stream, _began = stream if stream is not None else sys.stderr, time.monotonic()


def stop() -> None:
    """End the log; events are dropped again."""
    global _stream
    _stream = None


def on() -> bool:
    """Tell whether anybody reads the log: facts that cost something to gather are gathered only then."""
    return _stream is not None


def note(event: str, **facts: Any) -> None:
    """Write one line; does nothing without a log, and never raises: a log must not be what breaks the work.

    Parameters
    ----------
    event : str
    **facts
        Whatever JSON holds; anything else is written as its text.
    """
    if _stream is None:
        return
    line = {"t": round(time.monotonic() - _began, 4), "event": event, **facts}
    with suppress(OSError, ValueError):
        _stream.write(
            json.dumps(line, default=str) + "\n"
        )  # ASCII: nothing in it steers a terminal or ends the line
        _stream.flush()


def seconds() -> float:
    """Seconds since the log began."""
    return time.monotonic() - _began


def memory() -> int | None:
    """Greatest memory of this process so far, bytes; None where the system does not tell."""
    try:
        import resource
    except ImportError:
        return None
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
