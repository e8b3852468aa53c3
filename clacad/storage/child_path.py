"""Module path of child processes: it never includes the current folder."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import clacad


def module_path() -> list[str]:
    """Module folders of this process without the current folder; the package's own is appended if missing."""
    path = [entry for entry in sys.path if entry]
    home = os.path.dirname(os.path.dirname(os.path.abspath(clacad.__file__)))
    return path if home in path else [*path, home]


@contextmanager
def safe_children() -> Iterator[None]:
    """Within the block, Python processes started by libraries exclude the current folder from their path."""
    before = os.environ.get("PYTHONSAFEPATH")
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ["PYTHONSAFEPATH"]
        else:
            os.environ["PYTHONSAFEPATH"] = before
