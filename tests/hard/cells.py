"""Points whose cell, or place in it, floor(x/p) and x - k p get wrong; each with its reason."""

from __future__ import annotations

from dataclasses import dataclass
from math import nextafter, sqrt


@dataclass(frozen=True)
class HardCell:
    """A lattice, a point in the frame of its centre, and why its cell is hard."""

    name: str
    why: str
    kind: str
    pitch: tuple[float, float]
    count: tuple[int, int]
    x: float
    y: float
    undecidable: bool = False  # a corner of hexagons within rounding: sqrt(3) is not a double


def square(name, why, p, n, x, y):
    """A square lattice of n by n cells."""
    return HardCell(name, why, "square", (p, p), (n, n), x, y)


def hexagonal(name, why, x, y, undecidable=False, p=0.005, n=7):
    """A hexagonal lattice of n by n cells."""
    return HardCell(name, why, "hexagonal", (p, p), (n, n), x, y, undecidable)


P, THIRD = 0.005, 0.1
FAR, FARTHER = 5000.0, 5e6
CELLS = [
    square("on a border", "a wall belongs to the cell above it", P, 2, 0.0, 0.001),
    HardCell("5e-324 below a border", "closer to the wall than a place in the cell can say", "square", (P, P), (2, 2), -5e-324, 0.001, True),
    square("1e-18 below a border", "the quotient rounds onto the wall", P, 2, -1e-18, 0.001),
    square("on a corner", "four cells meet", P, 4, 0.005, -0.005),
    square("one place below a corner", "the quotient rounds to the wrong cell", P, 4, nextafter(0.005, 0), nextafter(-0.005, -1)),
    square("border at 0.3 of pitch 0.1", "0.3/0.1 is 2.9999999999999996 in doubles", THIRD, 8, 0.3, 0.7),
    square("border at 0.7 of pitch 0.1, below", "0.7/0.1 is 6.999999999999999", THIRD, 16, nextafter(0.7, 0), 0.1),
    square("last cell of 200", "x - k p with a rounded product keeps 1e-14 of a pitch", P, 200, 0.4988, 0.4991),
    square("on the outer rim", "the last wall belongs to no cell", P, 200, 0.5, 0.4),
    square("a million pitches out", "the product k p is rounded to 1e-12", P, 2_000_000, FAR - 0.0012, -FAR + 0.0007),
    square("a thousand million pitches out", "the product k p is rounded to 1e-9", P, 2_000_000_000, FARTHER - 0.0012, -FARTHER + 0.0007),
    square("odd count, a million pitches out", "the centre of a cell is the origin", P, 2_000_001, FAR - 0.0012, 1e-9),
    square("pitch 1/3, far out", "the pitch is no decimal", 1 / 3, 3_000_001, 499_999.9, -123_456.1),
    square("scale 1e-9", "nanometres in metres", 5e-12, 200, 4.988e-10, 4.991e-10),
    square("scale 1e9", "the same from the other end", 5e6, 200, 4.988e8, 4.991e8),
    HardCell("oblong cells", "each axis its own pitch", "rectangular", (0.005, 0.007), (200, 3), 0.4988, -0.0069),
    hexagonal("hexagon, middle", "skewed axes", 0.0003, -0.0002),
    hexagonal("hexagon, on a border", "half the pitch to the right of a centre", -0.5 * 0.005 * (6 + 3 / 7) + 0.0025, -0.5 * 0.5 * sqrt(3.0) * 0.005 * 6, undecidable=True),
    hexagonal("hexagon, 1e-15 from a corner", "three cells meet", 1e-15 - 0.5 * 0.005 * (6 + 3 / 7) + 0.0025, 0.0025 / sqrt(3.0) - 0.5 * 0.5 * sqrt(3.0) * 0.005 * 6 - 1e-15),
    hexagonal("hexagon, far out", "rows and columns a million away", 1e3, -2e3, n=4_000_001),
]  # fmt: skip
