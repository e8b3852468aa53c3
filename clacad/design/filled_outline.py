"""Number of cells that fill an outline, where the design gives no count."""

from __future__ import annotations

from math import floor, sqrt

ROUNDING = 1e-9
"""Tolerance of a size in cells: a size within it of a whole number holds that many."""


def filling_count(kind: str, pitch: tuple[float, float], size: tuple[float, float]) -> tuple[int, int]:
    """Cells along the two lattice vectors that fill an outline; cells that extend beyond it are left out
    later.

    A cell wholly inside a width w lies within ±w/2, so floor(w/p) columns centred on the origin miss none. Rows of a
    hexagonal lattice are √3/2 of the pitch apart, and their cells are 2/√3 of the pitch high. Every other row
    is displaced by half a pitch, a quarter to either side of the centre: one more column than floor(w/p)
    misses none.

    Parameters
    ----------
    kind : {"square", "rectangular", "hexagonal"}
    pitch : (p_x, p_y), lengths
        Hexagonal: centre to centre, given twice.
    size : (width, height), lengths
        Size of the outline; a circle's diameter twice.

    Returns
    -------
    (n1, n2)
        At least 1 each.
    """
    if kind == "hexagonal":
        rows = _whole((size[1] - pitch[0] * 2.0 / sqrt(3.0)) / (pitch[0] * 0.5 * sqrt(3.0))) + 1
        return max(1, _whole(size[0] / pitch[0]) + 1), max(1, rows)
    return max(1, _whole(size[0] / pitch[0])), max(1, _whole(size[1] / pitch[1]))


def _whole(ratio: float) -> int:
    return floor(ratio + ROUNDING)
