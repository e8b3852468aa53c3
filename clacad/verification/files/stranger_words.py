"""Sanitized statements of an untrusted manifest about its files: names to show, numbers, units."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from pathlib import Path
from typing import Any

from clacad.base.text import printable
from clacad.base.units import LENGTHS

LONGEST_NAME = 255
"""Longest file name that a file system stores, in bytes."""


COUNTS = frozenset({"solids", "faces", "triangles", "quads", "merged_steps", "saddles", "wedges"})
MEASURES = frozenset(
    {"slope_error_rms", "sag_error_max", "volume", "volume_exact", "saddle_bevel", "fit_error", "rim_error"}
)
"""Keys of manifest entries whose values are whole numbers, and whose values are numbers, from 0 up."""


def is_there(path: Path) -> bool:
    """Whether a file exists; a name that no file can have is no error."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def believable(told: Mapping[str, Any]) -> dict[str, Any]:
    """Statements of a manifest entry without invalid numbers and units, which count as not stated."""

    def believed(key: str, value: object) -> bool:
        if key == "unit":
            return isinstance(value, str) and value in LENGTHS
        whole = isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**53
        if key in COUNTS:
            return whole
        return key not in MEASURES or whole or (isinstance(value, float) and 0.0 <= value < inf)

    return {key: value for key, value in told.items() if believed(key, value)}


def shown_name(name: object) -> str:
    """Name from an untrusted source, made printable and of limited length."""
    text = printable(str(name))
    return text if len(text) <= LONGEST_NAME else text[: LONGEST_NAME - 1] + "…"
