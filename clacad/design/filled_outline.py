"""How many cells an outline calls for, where the design leaves that to it."""

from __future__ import annotations

from math import floor, sqrt

ROUNDING = 1e-9
"""Of a cell: a size that is a whole number of cells but for rounding holds that many."""


def filling_count(kind: str, pitch: tuple[float, float], size: tuple[float, float]) -> tuple[int, int]:
    """Cells along the two lattice vectors that fill an outline; those that stick out of it are left out later.

    A cell wholly inside a width w lies within ±w/2, so floor(w/p) columns centred on the origin miss none. Rows of a
    hexagonal lattice stand √3/2 of the pitch apart, their cells are 2/√3 high, and every other row is moved by half a
    pitch, a quarter to either side of the middle: one more column than floor(w/p) misses none.

    Parameters
    ----------
    kind : {"square", "rectangular", "hexagonal"}
    pitch : (p_x, p_y), lengths
        Hexagonal: centre to centre, twice.
    size : (width, height), lengths
        Of the outline; a circle's diameter twice.

    Returns
    -------
    (n1, n2)
        1 at least.
    """
    if kind == "hexagonal":
        rows = _whole((size[1] - pitch[0] * 2.0 / sqrt(3.0)) / (pitch[0] * 0.5 * sqrt(3.0))) + 1
        return max(1, _whole(size[0] / pitch[0]) + 1), max(1, rows)
    return max(1, _whole(size[0] / pitch[0])), max(1, _whole(size[1] / pitch[1]))


def _whole(ratio: float) -> int:
    return floor(ratio + ROUNDING)
