"""Worker process that reads an untrusted file with a native library: memory and CPU time limited by the
file's size.
"""

from __future__ import annotations

from pathlib import Path

from clacad.exporting.formats.registry import kind_ending, kinds
from clacad.exporting.limits import worker_memory
from clacad.formats.step.read_back import OCC_BYTES
from clacad.storage.reading import Spending
from clacad.storage.worker import Worker

WAITS, START = 3, 60.0
"""Seconds to wait per second of processor time, and a constant in addition: other programs run too."""


def reading_worker(path: Path) -> Worker:
    """Start a worker that may read one STEP, BREP or GDSII file and trace light through its faces.

    Raises
    ------
    OverBudget
        The file is larger than the reader accepts.
    OSError
        The file does not exist.
    """
    spent, size = _spending(path)
    most = worker_memory()
    allowed = spent.budget.memory_for(size)
    seconds = spent.budget.seconds_for(size)
    return Worker(memory=most if allowed is None else min(most, allowed), cpu=max(1, int(seconds)))


def longest_wait(path: Path) -> float:
    """Seconds after which a worker that has not answered is ended."""
    spent, size = _spending(path)
    return START + WAITS * spent.budget.seconds_for(size)


def _spending(path: Path) -> tuple[Spending, int]:
    """Budget of a file (a separate one where only its text is read), and its size in bytes."""
    size = path.stat().st_size
    kind = kind_ending(path.suffix)
    if kind is None or not kind.native:
        kind = next(one for one in kinds() if one.text_budget)
    by_text = kind.text_budget and size > OCC_BYTES
    return Spending(kind.text_budget if by_text else kind.word, path, size), size
