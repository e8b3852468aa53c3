"""Reading what others left under a name: only a regular file, so that nothing is waited for, and only up to a size."""

from __future__ import annotations

import os
import stat
from errno import EFBIG, EINVAL
from typing import Final

KINDS: Final = (
    (stat.S_ISFIFO, "a pipe"), (stat.S_ISCHR, "a device"), (stat.S_ISBLK, "a device"), (stat.S_ISSOCK, "a socket"),
    (stat.S_ISDIR, "a folder"),
)  # fmt: skip
"""What a name may stand for besides a file."""


def require_regular(path: str | os.PathLike[str]) -> None:
    """Refuse a name that stands for no regular file, without opening it: a pipe would be waited for.

    Raises
    ------
    OSError
        There is nothing, it may not be looked at, or it is something else; `strerror` says what.
    """
    _refuse_other(os.stat(path).st_mode, os.fspath(path))


def read_regular(path: str | os.PathLike[str], most: int) -> bytes:
    """Read a regular file whole.

    Parameters
    ----------
    path : path
    most : int
        Bytes; a larger file is refused unread.

    Raises
    ------
    OSError
        As `require_regular`; errno EFBIG where the file is larger.
    """
    require_regular(path)
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    with os.fdopen(descriptor, "rb") as stream:
        found = os.fstat(descriptor)  # what was opened, whatever has been put in its place since
        _refuse_other(found.st_mode, os.fspath(path))
        data = stream.read(most + 1) if found.st_size <= most else b""
    if found.st_size > most or len(data) > most:
        raise OSError(EFBIG, f"it has more than {most} bytes", os.fspath(path))
    return data


def _refuse_other(mode: int, name: str) -> None:
    if not stat.S_ISREG(mode):
        kind = next((words for is_so, words in KINDS if is_so(mode)), "something else")
        raise OSError(EINVAL, f"it is {kind}, not a file", name)
