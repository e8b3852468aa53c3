"""Hashes of 64 bits: words, points by their coordinates, rows of bits.

The finaliser of SplitMix64 (Steele, Lea and Flood, OOPSLA 2014); its compiled counterpart is
`clacad.base.compiled.mixed`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from clacad.base.types import Words

GOLDEN = 0x9E3779B97F4A7C15
"""2^64 over the golden ratio: the step of SplitMix64."""

MIX, STIR = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
"""Factors of the finaliser (Stafford's variant 13)."""

LOW, MIDDLE, HIGH = np.uint64(30), np.uint64(27), np.uint64(31)
"""Shifts of the finaliser, in order."""


def mixed(words: Words) -> Words:
    """Hash words (...): every bit of the result depends on every bit of the word; one-to-one."""
    found = words ^ (words >> LOW)
    found *= MIX
    found ^= found >> MIDDLE
    found *= STIR
    found ^= found >> HIGH
    return found


def point_hashes(corners: NDArray[Any]) -> Words:
    """Hash corner coordinates (..., 3) to 64 bits; equal coordinates have equal hashes (0 and −0 too)."""
    bits = np.ascontiguousarray(corners + np.zeros(1, dtype=corners.dtype)).view(
        np.uint32 if corners.dtype == np.float32 else np.uint64
    )
    out = np.zeros(bits.shape[:-1], dtype=np.uint64)
    for axis in range(3):
        out = mixed(out + bits[..., axis].astype(np.uint64) + np.uint64(GOLDEN * (axis + 1) % 2**64))
    return out


def hashed_rows(words: Words) -> Words:
    """Hash rows of bits (n, c) to (n,); a few operations a column."""
    key = words[:, 0].copy()
    for column in words.T[1:]:
        key ^= key >> np.uint64(29)
        key *= MIX
        key += column * np.uint64(GOLDEN)
    key ^= key >> np.uint64(32)
    return key
