"""Worker process that reads an untrusted file with a native library: memory and CPU time limited by the
file's size.
"""

from __future__ import annotations

from pathlib import Path

from clacad.exporting.formats.registry import kind_ending, kinds
from clacad.formats.step.read_back import OCC_BYTES
from clacad.storage import worker
from clacad.storage.reading import Spending
from clacad.storage.worker import Worker, limited_worker


def reading_worker(path: Path) -> Worker:
    """Start a worker that may read one STEP, BREP or GDSII file and trace light through its faces.

    Raises
    ------
    OverBudget
        The file is larger than the reader accepts.
    OSError
        The file does not exist.
    """
    return limited_worker(_spending(path))


def longest_wait(path: Path) -> float:
    """Seconds after which a worker that has not answered is ended."""
    return worker.longest_wait(_spending(path))


def _spending(path: Path) -> Spending:
    """Budget of a file, a separate one where only its text is read."""
    size = path.stat().st_size
    kind = kind_ending(path.suffix)
    if kind is None or not kind.native:
        kind = next(one for one in kinds() if one.text_budget)
    by_text = kind.text_budget and size > OCC_BYTES
    return Spending(kind.text_budget if by_text else kind.word, path, size)
