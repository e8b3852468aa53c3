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
from collections.abc import Iterator
from contextlib import contextmanager, suppress

PATIENCE = 0.5
"""Seconds that the ordinary way has."""

ENDING = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)
)


class Ending:
    """Whether the command was told to end."""

    def __init__(self) -> None:
        self.asked = threading.Event()
        self.over = threading.Event()

    def watch(self, wake: int, status: int) -> None:
        """Wait for signals, one byte each, until the other end is closed."""
        with os.fdopen(wake, "rb", buffering=0) as stream:
            while told := stream.read(1):
                if told[0] in ENDING:
                    self.asked.set()
                    if not self.over.wait(PATIENCE):
                        _leave(status)


@contextmanager
def ended_in_time(status: int) -> Iterator[Ending]:
    """Within the block a signal ends the process with `status` after PATIENCE, should nothing else end it.

    Only in the main thread, where signals can be heard; elsewhere nothing is watched.
    """
    ending = Ending()
    if threading.current_thread() is not threading.main_thread():
        yield ending
        return
    wake, tell = os.pipe()
    os.set_blocking(tell, False)
    watcher = threading.Thread(target=ending.watch, args=(wake, status), daemon=True)
    before = signal.set_wakeup_fd(tell, warn_on_full_buffer=False)
    watcher.start()
    try:
        yield ending
    finally:
        ending.over.set()
        signal.set_wakeup_fd(before)
        os.close(tell)


def _leave(status: int) -> None:
    """End now: private folders and workers first, a publication under way is let finish."""
    atomic, worker = (sys.modules.get(f"clacad.export.{name}") for name in ("atomic", "worker"))
    if worker is not None:
        worker.end_all()
    if atomic is not None:
        atomic.abandon_all()
    with suppress(OSError, ValueError):
        os.write(2, b"clacad: interrupted\n")
    os._exit(status)
