"""Ctrl-C ends a command within a second, whatever it is in the middle of.

Python hears a signal when its main thread comes back to it. Compilers and kernels may keep that thread for
seconds, and some swallow the exception. So another thread is woken by the signal itself; it gives the ordinary
way, in which everything cleans up after itself, half a second, and then ends the process.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

SENTENCE = "clacad: interrupted\n"

INTERRUPTED = 130
"""Exit status of a command that was told to end."""

PATIENCE = 0.5
"""Seconds that the ordinary way has."""

SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)
)


class InterruptHandler:
    """Whether the command was told to end; who says so first says it alone.

    Plain attributes: a lock taken in a signal handler could be one that the main thread holds.
    """

    def __init__(self) -> None:
        self.asked = False
        self.finished = threading.Event()
        self._heard = False
        self._untold = threading.Lock()

    def handle(self, _: int, frame: FrameType | None) -> None:
        """Handle a signal: the first is raised, later ones would only break off the cleaning up after it.

        Not through the compiler of kernels, nor through the loading of a module: an exception that unwinds compiled
        code which does not expect one has been seen to end in a segmentation fault.
        """
        self.asked = True
        if not self._heard:
            self._heard = True
            if "numba" in sys.modules or _loading(frame):
                self._leave()
            raise KeyboardInterrupt

    def tell(self, write: Callable[[str], object]) -> None:
        """Say that the command was interrupted, unless that was said."""
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
        """Wait for the ordinary way; call the main thread again if it began to wait just before it could hear."""
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
    """Within the block a signal raises KeyboardInterrupt, and ends the process with `INTERRUPTED` should that not do it.

    Only in the main thread, where signals can be heard; elsewhere nothing is watched. A signal that is ignored
    (as by nohup), or that somebody else handles, is left alone.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    try:
        wake, tell = os.pipe()
    except OSError:  # no file may be opened any more: what needs one will say so
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
    """Tell the interruption that a library could not pass on, which the watcher will carry out."""
    return interrupts.asked and issubclass(lost.exc_type, KeyboardInterrupt)
