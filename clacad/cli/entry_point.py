"""Entry point: run a command line, turn errors into one sentence and an exit status.

0 done, all checks passed; 1 a check failed or did not run; 2 bad input; 3 refused by a limit;
4 cannot write, or workers were lost; 70 internal; 130 interrupted.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from errno import EAGAIN, ELOOP, EMFILE, ENAMETOOLONG, ENFILE
from typing import Any

from clacad.base import log
from clacad.base.text import printable_lines
from clacad.cli.console import make_writable
from clacad.cli.interrupts import INTERRUPTED, InterruptHandler, ended_in_time

OK, FAILED, BAD_INPUT, REFUSED, CANNOT_WRITE, INTERNAL = 0, 1, 2, 3, 4, 70


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status; prints a traceback only in the log.

    Parameters
    ----------
    arguments : sequence of str, optional
        Without the program's name; default sys.argv[1:].
    """
    make_writable()
    given = list(sys.argv[1:] if arguments is None else arguments)
    interrupts = InterruptHandler()
    try:
        status = _answered(given, interrupts)
        log.note("end", status=status, seconds=round(log.seconds(), 3), memory=log.memory())
        return status
    except KeyboardInterrupt:  # just before handlers were set, or just after they were restored
        interrupts.tell(sys.stderr.write)
        return INTERRUPTED
    finally:
        log.stop()


@contextmanager
def _own_warnings_plain() -> Iterator[None]:
    """Within the block the package's warnings are printed like its errors, without file and line."""
    before = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
        if category.__module__.startswith("clacad."):
            _say(str(message))
        else:
            before(message, category, *place, **more)

    warnings.showwarning = show
    try:
        yield
    finally:
        warnings.showwarning = before


def _answered(given: list[str], interrupts: InterruptHandler) -> int:
    with ended_in_time(interrupts), _own_warnings_plain():
        try:
            status = _status(given, interrupts)
        except KeyboardInterrupt:
            status = INTERRUPTED
        if interrupts.asked and status != OK:  # a library turned the interruption into another error
            status = INTERRUPTED
        if status == INTERRUPTED:
            interrupts.tell(sys.stderr.write)
        return status


def _status(given: list[str], interrupts: InterruptHandler) -> int:
    """Run the command; the exit status of its end, or of the error it raised."""
    try:
        from clacad.cli.app import run

        status = run(given)
        sys.stdout.flush()
        return status
    except BrokenPipeError:
        return _unread()
    except SystemExit:
        if interrupts.asked:
            return INTERRUPTED
        raise
    except Exception as error:
        return INTERRUPTED if interrupts.asked else _explained(error)


def _unread() -> int:
    """The reader of our output closed it: that is no error."""
    sys.stdout = open(os.devnull, "w")
    return OK


def _explained(error: Exception) -> int:
    """Print an error and return its exit status."""
    status = status_of(error)
    if log.on():
        log.note("error", **_facts(error), status=INTERNAL if status is None else status)
    if status is None:
        text = f"internal error: {type(error).__name__}: {error}".rstrip(": ")
        if isinstance(error, MemoryError):
            text = f"out of memory ({error}): reduce the number of rays, quads or cells".replace(" ()", "")
        _say(
            text
            if log.on() or isinstance(error, MemoryError)
            else f"{text}\n  run again with -v for the details"
        )
        return INTERNAL
    _say(_sentence(error))
    return status


def _sentence(error: Exception) -> str:
    """Sentence of an error; of a system error its file and cause, without the number."""
    if isinstance(error, OSError) and error.strerror:
        place = f"{error.filename}: " if isinstance(error.filename, str) else ""
        more = "; ulimit -n raises the limit" if error.errno == EMFILE else ""
        return f"{place}{error.strerror.lower()}{more}"
    return str(error)


def _facts(error: Exception) -> dict[str, Any]:
    """Facts of an error for the log: all that the sentence leaves out."""
    import traceback

    return {
        "kind": type(error).__name__,
        "sentence": str(error),
        "details": getattr(error, "details", ""),
        "traceback": "".join(traceback.format_exception(error)).splitlines(),
    }


def status_of(error: Exception) -> int | None:
    """Exit status of an error clacad knows, None for one it does not."""
    known = getattr(error, "exit_status", None)
    if isinstance(known, int):
        return known
    if isinstance(error, (FileNotFoundError, IsADirectoryError, NotADirectoryError, UnicodeError)):
        return BAD_INPUT
    if isinstance(error, OSError) and error.errno in (ENAMETOOLONG, ELOOP):
        return BAD_INPUT
    if isinstance(error, OSError) and error.errno in (EMFILE, ENFILE, EAGAIN):
        return REFUSED
    if isinstance(error, OSError):
        return CANNOT_WRITE
    return None


LONGEST_LINE = 500
"""Most characters of a line on the error stream; texts of users may be longer."""


def _shortened(line: str) -> str:
    """A line with its middle left out if it is too long to be read."""
    return line if len(line) <= LONGEST_LINE else f"{line[: LONGEST_LINE - 200]} ... {line[-190:]}"


def _say(text: str) -> None:
    text = printable_lines(text)
    lines = text.split("\n") if "\n" in text else [f"clacad: {text}"]
    print("\n".join(map(_shortened, lines)), file=sys.stderr)  # noqa: T201
