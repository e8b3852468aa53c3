"""Output streams that can be written to, whatever the program was started with."""

from __future__ import annotations

import os
import sys
from contextlib import suppress


def make_writable() -> None:
    """Make standard streams that are closed go nowhere, and spell what a stream's encoding lacks.

    A file opened later must not get the number of a closed stream: what is printed would end up in it. A terminal that
    knows ASCII only, or a file name that is no text, is no reason for another exit status.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            with suppress(OSError):
                os.open(os.devnull, os.O_RDWR)  # gets the lowest number that is free: this one
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def is_unicode(encoding: str | None) -> bool:
    """Whether every character can be written."""
    return (encoding or "").lower().replace("-", "").replace("_", "").startswith("utf")
