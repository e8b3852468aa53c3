"""What a STEP file will cost before it is written: bytes, seconds, memory, solids, faces."""

from __future__ import annotations

import io
import time
from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np

from clacad.base.types import Floats
from clacad.sheet.window import Window

_SAMPLES = ((3, 3), (6, 3), (3, 6), (6, 6))
_BASE_MEMORY = 120_000_000
_MEMORY_PER_FACE = 1400
"""Bytes of memory per face of a fused body, measured on sheets of 20 000 to 800 000 faces."""

_SECONDS_PER_FACE = 9e-5
"""Processor time per face of a fused body, measured on an x86-64 server core."""


@dataclass(frozen=True, slots=True)
class StepForecast:
    """Cost of one STEP file.

    Attributes
    ----------
    mode : "fused" or "instanced"
    bytes : int
        Within 10 %; exact for instanced files.
    seconds : float
        Processor time.
    memory : int
        Bytes of the writing process.
    solids, faces : int
        As placed.
    """

    mode: str
    bytes: int
    seconds: float
    memory: int
    solids: int
    faces: int


class _Counter(io.TextIOBase):
    """A stream that only counts."""

    def __init__(self) -> None:
        self.count = self.references = self.lines = 0

    def write(self, text: str) -> int:
        """Count characters, references and entities."""
        self.count += len(text)
        self.references += text.count("#")
        self.lines += text.count("\n")
        return len(text)


def forecast(window: Window, mode: str, write: Callable[[Window, Any], dict[str, Any]]) -> StepForecast:
    """Forecast by describing the sheet to a stream that only counts: whole if instanced, small if fused.

    Faces and entities of a fused sheet of n1 × n2 cells are a + b n1 + c n2 + d n1 n2; four small sheets give the
    numbers. Entity numbers grow longer with the file, so their digits are counted apart.

    Parameters
    ----------
    window : Window
    mode : "fused" or "instanced"
    write : callable
        Writes a window to a stream and gives its facts.
    """
    if mode == "instanced":
        stream, facts, seconds = _tried(window, write)
        return StepForecast(mode, stream.count, seconds, _BASE_MEMORY, facts["solids"], facts["faces"])
    rows, speeds = [], []
    for count in _SAMPLES:
        stream, facts, seconds = _tried(window.with_cells(count), write)
        plain = stream.count - stream.references * _mean_digits(stream.lines)
        rows.append([plain, stream.references, stream.lines, facts["faces"], facts["solids"]])
        speeds.append(seconds)
    sides = np.array(_SAMPLES, dtype=np.float64)
    terms = np.linalg.solve(_bilinear(sides[:, 0], sides[:, 1]), np.array(rows, dtype=np.float64))
    cells = window.lattice.cell_count
    n1, n2 = window.lattice.count if window.lattice.outline is None else (sqrt(cells), sqrt(cells))
    counts = (_bilinear(np.array([float(n1)]), np.array([float(n2)])) @ terms)[0]
    faces, solids = round(float(counts[3])), round(float(counts[4]))
    size = int(counts[0] + counts[1] * _mean_digits(counts[2]))
    memory = _BASE_MEMORY + _MEMORY_PER_FACE * faces
    return StepForecast(mode, size, max(speeds) + _SECONDS_PER_FACE * faces, memory, solids, faces)


def _bilinear(n1: Floats, n2: Floats) -> Floats:
    return np.stack([np.ones_like(n1), n1, n2, n1 * n2], axis=-1)


def _mean_digits(entities: float) -> float:
    """Mean number of digits of the numbers 1 … entities."""
    digits, below = 0.0, 1.0
    for d in range(1, 12):
        upto = min(entities + 1.0, 10.0**d)
        digits += d * max(0.0, upto - below)
        below = 10.0**d
    return digits / max(1.0, entities)


def _tried(
    window: Window, write: Callable[[Window, Any], dict[str, Any]]
) -> tuple[_Counter, dict[str, Any], float]:
    stream, start = _Counter(), time.process_time()
    facts = write(window, stream)
    return stream, facts, time.process_time() - start
