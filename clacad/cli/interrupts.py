"""Ctrl-C ends a command within a second, regardless of its current work.

Python handles a signal only in its main thread. Compilers and kernels may occupy that thread for seconds, and
some swallow the exception. The signal therefore wakes a second thread. It allows half a second for the
ordinary end, in which every block cleans up, and then ends the process.
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
