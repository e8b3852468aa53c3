"""Types that every room speaks of: arrays by what they hold, rungs of the ladder, progress."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

Rows = NDArray[np.intp]
"""Numbers of rays or rows in an array."""

Cells = NDArray[np.int32]
"""Cell indices as the compiled code stores them."""

Words = NDArray[np.uint64]
"""Hashes and random numbers, 64 bits."""

Bytes = NDArray[np.uint8]
"""Fates, states and pixels."""

Singles = NDArray[Any]
"""Compiled passes over float32 take either precision."""

Pair2 = tuple[float, float]
"""A number for each of two axes or lenses."""

Rung = Literal["law", "thin", "surfaces", "mesh"]
"""Step of the ladder of exactness that a trace runs on."""

Progress = Callable[[str, float], None]
"""Called with what is being done, and the part of it that is done (0 … 1; NaN: not known)."""


def silent(_stage: str, _done: float) -> None:
    """Progress that nobody wants to hear of."""
