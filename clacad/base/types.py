"""Types used by all packages: arrays by their content, rungs of the ladder, progress."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

Rows = NDArray[np.intp]
"""Indices of rays or rows in an array."""

Cells = NDArray[np.int32]
"""Cell indices as the compiled code stores them."""

Words = NDArray[np.uint64]
"""Hashes and random numbers, 64 bits."""

Bytes = NDArray[np.uint8]
"""Fates, states and pixels."""

Singles = NDArray[Any]
"""Arrays of either precision: compiled passes over float32 accept both."""

Pair2 = tuple[float, float]
"""One number for each of two axes or lenses."""

Rung = Literal["law", "thin", "surfaces", "mesh"]
"""Step of the ladder of exactness on which a trace runs."""

Progress = Callable[[str, float], None]
"""Called with the current stage and the fraction of it that is done (0 … 1; NaN: not known)."""


def silent(_stage: str, _done: float) -> None:
    """Ignore progress."""
