"""Entry point: run a command line, turn errors into one sentence and an exit status.

0 done, all checks passed; 1 a check failed or did not run; 2 bad input; 3 refused by a limit;
4 cannot write, or workers were lost; 70 internal; 130 interrupted.

Ctrl-C ends a command within a second, regardless of its current work.

Python handles a signal only in its main thread. Compilers and kernels may occupy that thread for seconds, and
some swallow the exception. The signal therefore wakes a second thread. It allows half a second for the
ordinary end, in which every block cleans up, and then ends the process.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from errno import EAGAIN, ELOOP, EMFILE, ENAMETOOLONG, ENFILE
from types import FrameType
from typing import Any

from clacad.base import log
from clacad.base.text import printable_lines
from clacad.cli.console import make_writable

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


SENTENCE = "clacad: interrupted\n"

INTERRUPTED = 130
"""Exit status of an interrupted command."""

PATIENCE = 0.5
"""Seconds allowed for the ordinary end."""

SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)
)


class InterruptHandler:
    """Whether the command was interrupted; the message is printed once.

    Plain attributes: a lock taken in a signal handler could be one that the main thread holds.
    """

    def __init__(self) -> None:
        self.asked = False
        self.finished = threading.Event()
        self._heard = False
        self._untold = threading.Lock()

    def handle(self, _: int, frame: FrameType | None) -> None:
        """Handle a signal: the first is raised, later ones would only break off the cleaning up after it.

        Within the compiler of kernels, or while a module is loaded, the process ends instead: an exception
        through compiled code that expects none has ended in a segmentation fault.
        """
        self.asked = True
        if not self._heard:
            self._heard = True
            if "numba" in sys.modules or _loading(frame):
                self._leave()
            raise KeyboardInterrupt

    def tell(self, write: Callable[[str], object]) -> None:
        """Print that the command was interrupted, unless that was printed."""
        if self._untold.acquire(blocking=False):
            with suppress(OSError, ValueError):
                write(SENTENCE)

    def watch(self, wake: int) -> None:
        """Wait for signals, one byte each, until the other end is closed."""
        with os.fdopen(wake, "rb", buffering=0) as stream:
            while told := stream.read(1):
                if told[0] in SIGNALS:
                    self.asked = True
                    if not self._over_soon(told[0]):
                        self._leave()

    def _over_soon(self, number: int) -> bool:
        """Wait for the ordinary end; signal the main thread again if it missed the first signal."""
        for _ in range(5):
            if self.finished.wait(PATIENCE / 5):
                return True
            main = threading.main_thread().ident
            if not self._heard and main is not None and hasattr(signal, "pthread_kill"):
                signal.pthread_kill(main, number)
        return False

    def _leave(self) -> None:
        """End now: private folders and workers first, a publication under way is let finish."""
        atomic, worker = (sys.modules.get(f"clacad.storage.{name}") for name in ("atomic", "worker"))
        if worker is not None:
            worker.end_all()
        if atomic is not None:
            atomic.abandon_all()
        self.tell(lambda text: os.write(2, text.encode()))
        os._exit(INTERRUPTED)


def _loading(frame: FrameType | None) -> bool:
    """Whether a module is being loaded below this frame."""
    while frame is not None:
        if frame.f_globals.get("__name__") in ("importlib._bootstrap", "_frozen_importlib"):
            return True
        frame = frame.f_back
    return False


@contextmanager
def ended_in_time(interrupts: InterruptHandler) -> Iterator[None]:
    """Within the block a signal raises KeyboardInterrupt, and soon ends the process with `INTERRUPTED`.

    Only in the main thread, where signals are handled; elsewhere nothing is watched. A signal that is ignored
    (as by nohup), or that has another handler, is left alone.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    try:
        wake, tell = os.pipe()
    except OSError:  # no file may be opened any more: an error follows where one is needed
        yield
        return
    os.set_blocking(tell, False)
    watcher = threading.Thread(target=interrupts.watch, args=(wake,), daemon=True)
    before, hook = signal.set_wakeup_fd(tell, warn_on_full_buffer=False), sys.unraisablehook
    watcher.start()
    taken: dict[int, Any] = {}
    try:
        sys.unraisablehook = lambda lost: None if _swallowed(lost, interrupts) else hook(lost)
        for number in SIGNALS:
            if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
                taken[number] = signal.signal(number, interrupts.handle)
        yield
    finally:
        interrupts.finished.set()
        for number, handler in taken.items():
            signal.signal(number, handler)
        sys.unraisablehook = hook
        signal.set_wakeup_fd(before)
        os.close(tell)


def _swallowed(lost: Any, interrupts: InterruptHandler) -> bool:
    """Recognise an interruption that a library could not pass on; the watcher ends the process."""
    return interrupts.asked and issubclass(lost.exc_type, KeyboardInterrupt)
