"""The explorer: one self-contained page on which a design's numbers are moved and what an eye sees through it follows.

The page draws with rung `thin` in single precision, in the cell's own coordinates, and works out its verdict by the
closed forms of `clacad.sheet.vignetting` and `clacad.sheet.feasibility.pitch_for_eye`, written a second time in JavaScript
and held to them by tests. What it writes (`explore`) needs no network and no other file.
"""

from __future__ import annotations

from clacad.explorer.write_page import Explored, explore

__all__ = ["Explored", "explore"]
