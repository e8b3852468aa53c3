"""Files change places all together or not at all: what was there is kept until the last one stands."""

from __future__ import annotations

import os
import shutil
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

OLD = "~"
"""What was at a final name before is kept in the private folder under that name with this before it."""


class Unfinished(OSError):
    """A publication that could be neither carried out nor undone; the next export into the folder finishes it."""


def exchange(
    private: Path, folder: Path, names: list[str], gone: list[str], last: tuple[str, str] | None = None
) -> None:
    """Move files into place, old ones out of it, and one last; undo it all if one cannot be moved.

    `names` are moved from `private` into `folder`; files `gone` leave it first and for good; `last` is a private file
    and the name it is published by. OSError: nothing has changed. Unfinished: it could neither be done nor undone.
    """

    def kept(name: str) -> Path:
        return private / (OLD + name)

    undo: list[tuple[Path, Path | None, Path]] = []  # target, its old content, where the new content was
    try:
        for name in gone:
            undo.append((folder / name, kept(name), kept(name)))
            os.replace(folder / name, kept(name))
        if gone:
            flush(folder)
        for name, public in [*zip(names, names), *([last] if last else [])]:
            target = folder / public
            there = os.path.lexists(target)
            if there:
                _keep(target, kept(name))
            undo.append((target, kept(name) if there else None, private / name))
            if last == (name, public):
                flush(folder)
            os.replace(private / name, target)
    except OSError as error:
        try:
            _undone(undo)
        except OSError as again:
            raise Unfinished(error.errno, error.strerror, error.filename) from again
        raise


def _keep(file: Path, as_well: Path) -> None:
    """Give a file a second name; where there are no hard links, a copy."""
    with suppress(FileNotFoundError):
        as_well.unlink()
    try:
        os.link(file, as_well, follow_symlinks=False)
    except (OSError, NotImplementedError):
        shutil.copy2(file, as_well, follow_symlinks=False)


def _undone(undo: list[tuple[Path, Path | None, Path]]) -> None:
    """Put everything back where it was, the last first; a target never holds anything but old or new content."""
    for target, old, new in reversed(undo):
        if new != old and not os.path.lexists(new):
            _keep(target, new)
        if old is None:
            target.unlink(missing_ok=True)
        elif os.path.lexists(old):
            os.replace(old, target)
            old.unlink(missing_ok=True)  # two names of one file: the line above left both


BUSY = threading.Lock()
"""Held while files change places: who wants to end the process waits for it."""


@contextmanager
def undisturbed() -> Iterator[None]:
    """Let signals wait for the few milliseconds in which files change places.

    The handlers are put aside, not the signals: those may come to any thread, and are handled in the main one.
    """
    heard: list[int] = []
    aside: dict[int, Any] = {}
    try:
        if threading.current_thread() is threading.main_thread():
            for name in ("SIGINT", "SIGTERM", "SIGHUP"):
                number = getattr(signal, name, None)
                if number is not None and callable(signal.getsignal(number)):
                    aside[number] = signal.signal(number, lambda which, _: heard.append(which))
        with BUSY:  # after the handlers are aside: one of them waits for it to end the process
            yield
    finally:
        for number, handler in aside.items():
            signal.signal(number, handler)
    for number in heard[:1]:
        signal.raise_signal(number)


def flush(path: Path) -> None:
    """Force a file or folder to the disk (folders: where the system allows it)."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError:
        if not path.is_dir():
            raise
    finally:
        os.close(descriptor)
