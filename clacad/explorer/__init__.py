"""The explorer: one self-contained page with sliders for the numbers of a design, which shows the view
through the sheet.

The page draws with rung `thin` in single precision, in the coordinates of each cell. It computes its verdict
by the closed forms of `clacad.sheet.vignetting` and `clacad.sheet.feasibility.derived_numbers`, which
JavaScript repeats and tests compare. The page that `explore` writes needs no network and no other file.
"""

from __future__ import annotations

from clacad.explorer.write_page import Explored, explore

__all__ = ["Explored", "explore"]
