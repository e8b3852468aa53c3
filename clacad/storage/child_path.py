"""Where processes that this one starts find their modules: never in the current folder, whatever lies there."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import clacad


def module_path() -> list[str]:
    """Folders of modules as in this process, without the current one; the package's own stands last if nowhere else."""
    path = [entry for entry in sys.path if entry]
    home = os.path.dirname(os.path.dirname(os.path.abspath(clacad.__file__)))
    return path if home in path else [*path, home]


@contextmanager
def safe_children() -> Iterator[None]:
    """Within the block every Python that a library starts leaves the current folder off its path."""
    before = os.environ.get("PYTHONSAFEPATH")
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ["PYTHONSAFEPATH"]
        else:
            os.environ["PYTHONSAFEPATH"] = before
