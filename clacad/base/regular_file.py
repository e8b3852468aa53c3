"""Reading of untrusted paths: regular files only, so that no read blocks, and only up to a given size."""

from __future__ import annotations

import os
import stat
from errno import EFBIG, EINVAL
from typing import Final

KINDS: Final = (
    (stat.S_ISFIFO, "a pipe"), (stat.S_ISCHR, "a device"), (stat.S_ISBLK, "a device"), (stat.S_ISSOCK, "a socket"),
    (stat.S_ISDIR, "a folder"),
)  # fmt: skip
"""File types other than a regular file that a path may name."""


def require_regular(path: str | os.PathLike[str]) -> None:
    """Refuse a path that names no regular file, without opening it: opening a pipe would block.

    Raises
    ------
    OSError
        The path does not exist, may not be inspected, or names another file type; `strerror` describes it.
    """
    _refuse_other(os.stat(path).st_mode, os.fspath(path))


def read_regular(path: str | os.PathLike[str], most: int) -> bytes:
    """Read a whole regular file.

    Parameters
    ----------
    path : path
    most : int
        Limit in bytes; a larger file is refused unread.

    Raises
    ------
    OSError
        As `require_regular`; errno EFBIG where the file is larger than `most`.
    """
    require_regular(path)
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    with os.fdopen(descriptor, "rb") as stream:
        found = os.fstat(descriptor)  # the opened file, even if the path names another one by now
        _refuse_other(found.st_mode, os.fspath(path))
        data = stream.read(most + 1) if found.st_size <= most else b""
    if found.st_size > most or len(data) > most:
        raise OSError(EFBIG, f"it has more than {most} bytes", os.fspath(path))
    return data


def _refuse_other(mode: int, name: str) -> None:
    if not stat.S_ISREG(mode):
        kind = next((words for is_so, words in KINDS if is_so(mode)), "something else")
        raise OSError(EINVAL, f"it is {kind}, not a file", name)
