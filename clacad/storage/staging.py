"""Transactional replacement of files: old files are kept until the last new one is in place."""

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
"""Prefix of the name under which an old file is kept in the private folder."""


class Unfinished(OSError):
    """A publication neither completed nor undone; the next export into the folder finishes it."""


def exchange(
    private: Path, folder: Path, names: list[str], gone: list[str], last: tuple[str, str] | None = None
) -> None:
    """Move new files into place, old ones out, and one file last; undo everything if a move fails.

    `names` are moved from `private` into `folder`; files `gone` leave it first and for good; `last` is a
    private file and the name it is published by. OSError: nothing has changed. Unfinished: it could neither
    be done nor undone.
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
    """Restore all files in reverse order; a target always holds either old or new content."""
    for target, old, new in reversed(undo):
        if new != old and not os.path.lexists(new):
            _keep(target, new)
        if old is None:
            target.unlink(missing_ok=True)
        elif os.path.lexists(old):
            os.replace(old, target)
            old.unlink(missing_ok=True)  # two names of one file: the line above left both in place


BUSY = threading.Lock()
"""Held while files are exchanged; code that ends the process waits for it."""


@contextmanager
def undisturbed() -> Iterator[None]:
    """Delay signals for the few milliseconds in which files are exchanged.

    Handlers are replaced rather than signals blocked: a signal may reach any thread, but the main one handles
    it.
    """
    heard: list[int] = []
    aside: dict[int, Any] = {}
    try:
        if threading.current_thread() is threading.main_thread():
            for name in ("SIGINT", "SIGTERM", "SIGHUP"):
                number = getattr(signal, name, None)
                if number is not None and callable(signal.getsignal(number)):
                    aside[number] = signal.signal(number, lambda which, _: heard.append(which))
        with BUSY:  # after replacing the handlers: one of them waits for this lock to end the process
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
