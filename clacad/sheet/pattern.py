"""An endless pattern of identical cells: shape of a cell, steps between cells, points in a cell, rotation.

Positions inside a cell are relative to the cell's centre and formed with an exact product (Dekker's
TwoProduct). A turned pattern is the same pattern in its own rotated axes; local coordinates in a cell stay
along the sheet's axes. Sine and cosine of an angle are stored as pairs, so that a rotation and its inverse
cancel to 2⁻¹⁰⁰: a cell ten thousand pitches from the centre is located to the last bits of a cell.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction as Exact
from functools import lru_cache
from math import hypot, sqrt
from typing import Final, Literal

import numpy as np

from clacad.base.pairs import Pair, negated, pair_product, pair_sum, two_product
from clacad.base.types import Floats, Ints, Pair2

Kind = Literal["square", "rectangular", "hexagonal"]

Step = tuple[int, int]
"""Index step (di, dj) from one cell to another."""

NodeCells = tuple[tuple[Step, int], ...]
"""Cells around a node, counter-clockwise: index step from the first cell,
and index of the tile's corner at the node.
"""


class Pattern:
    """An endless pattern of identical cells; `Lattice` is a finite part of one.

    kind : "square", "rectangular" or "hexagonal"
    pitch : (p_x, p_y), lengths
    turn : radians. Rotation of the pattern, from +x to +y.
    """

    __slots__ = ()

    kind: Kind
    pitch: Pair2
    turn: float

    @property
    def a1(self) -> tuple[float, float]:
        """First lattice vector (length)."""
        return _step((self.pitch[0], 0.0), self.turn)

    @property
    def a2(self) -> tuple[float, float]:
        """Second lattice vector (length)."""
        return _step((0.5 * self.pitch[0] if self.hexagonal else 0.0, self.row_height), self.turn)

    @property
    def row_height(self) -> float:
        """Distance between the centre lines of adjacent rows of cells (length)."""
        return 0.5 * sqrt(3.0) * self.pitch[0] if self.hexagonal else self.pitch[1]

    @property
    def hexagonal(self) -> bool:
        """Whether cells are hexagons."""
        return self.kind == "hexagonal"

    @property
    def steps(self) -> tuple[tuple[int, int], ...]:
        """Index steps (di, dj) across each border of a cell, counter-clockwise from +x."""
        if self.hexagonal:
            return ((1, 0), (0, 1), (-1, 1), (-1, 0), (0, -1), (1, -1))
        return ((1, 0), (0, 1), (-1, 0), (0, -1))

    @property
    def cell_area(self) -> float:
        """Area of one cell, length²."""
        return self.pitch[0] * self.row_height

    def past_borders(self, x: Floats, y: Floats) -> Floats:
        """Distances (m, ...) of points of the cell frame past each of its m borders; below 0: inside."""
        offsets = zip((self.offset(*step) for step in self.steps), self.half_widths)
        return np.stack([(x * ox + y * oy) / (2.0 * half) - half for (ox, oy), half in offsets])

    @property
    def half_widths(self) -> tuple[float, ...]:
        """Distance of each border of a cell from its centre (lengths), in the order of `steps`."""
        across, row = self.pitch[0], self.row_height
        lean = 0.5 * across if self.hexagonal else 0.0
        return tuple(0.5 * hypot(di * across + dj * lean, dj * row) for di, dj in self.steps)

    @property
    def circumradius(self) -> float:
        """Distance of the farthest corner of a cell from its centre (length)."""
        return float(np.max(np.hypot(*_upright_tile(self.hexagonal, self.pitch).T)))

    def offset(self, di: int, dj: int) -> tuple[float, float]:
        """Displacement (x, y) to the cell `di`, `dj` index steps away (lengths)."""
        (ax, ay), (bx, by) = self.a1, self.a2
        return (di * ax + dj * bx, di * ay + dj * by)

    def tile(self) -> Floats:
        """Corners of one cell relative to its centre, counter-clockwise, (4 or 6, 2), lengths.

        Edge k runs from corner k to corner k + 1 and is crossed by `steps[k]`.
        """
        upright = _upright_tile(self.hexagonal, self.pitch)
        return turned(upright, self.turn) if self.turn else upright


def section(base: Pattern, own: Pattern, wall: float = 0.0) -> Floats:
    """Map (2, 2) from a cell of `base` to one of `own`, less half of a wall (length) along every border."""
    across = (own.pitch[0], own.pitch[0] if own.hexagonal else own.pitch[1])
    before = (base.pitch[0], base.pitch[0] if base.hexagonal else base.pitch[1])
    found = np.diag([p / q * (1.0 - wall / p) for p, q in zip(across, before, strict=True)])
    return turned(found.T, own.turn).T if own.turn else found


def _step(step: Pair2, turn: float) -> Pair2:
    """Lattice vector of a pattern turned by an angle (radians)."""
    if not turn:
        return step
    x, y = turned(np.array(step), turn)
    return float(x), float(y)


def _upright_tile(hexagonal: bool, pitch: Pair2) -> Floats:
    """Corners of one cell of an unturned pattern, as `Pattern.tile`."""
    if hexagonal:
        p = pitch[0]
        edge = p / sqrt(3.0)
        half = 0.5 * p
        return np.array(
            [
                (half, -0.5 * edge),
                (half, 0.5 * edge),
                (0.0, edge),
                (-half, 0.5 * edge),
                (-half, -0.5 * edge),
                (0.0, -edge),
            ]
        )
    hx, hy = 0.5 * pitch[0], 0.5 * pitch[1]
    return np.array([(hx, -hy), (hx, hy), (-hx, hy), (-hx, -hy)])


def relocate(pattern: Pattern, local: Floats) -> tuple[Ints, Floats]:
    """Whole lattice steps (m, 2) and remaining local coordinates (m, 2) of points relative to a cell's
    centre, lengths.

    The rule is that of `Lattice.locate`: a border belongs to the cell above it. Multiples of the lattice
    vectors are formed exactly and the difference is rounded once.
    """
    if pattern.turn:
        steps, own = _relocate_upright(pattern, turned(local, -pattern.turn))
        return steps, np.where(steps.any(axis=-1, keepdims=True), turned(own, pattern.turn), local)
    return _relocate_upright(pattern, local)


def _relocate_upright(pattern: Pattern, local: Floats) -> tuple[Ints, Floats]:
    """As `relocate`, along the axes of the pattern."""
    x, y = local[:, 0], local[:, 1]
    if not pattern.hexagonal:
        column, local_x = _relocate_axis(x, pattern.pitch[0])
        line, local_y = _relocate_axis(y, pattern.pitch[1])
        return np.stack([column, line], axis=-1).astype(np.int64), np.stack([local_x, local_y], axis=-1)
    pitch, row = pattern.pitch[0], pattern.row_height

    def left(i: Floats, j: Floats) -> tuple[Floats, Floats]:
        return less_multiple(x, i + 0.5 * j, pitch), less_multiple(y, j, row)

    index, local_x, local_y = in_hexagon(pattern, left, x, y)
    return index, np.stack([local_x, local_y], axis=-1)


def less_steps(pattern: Pattern, local: Floats, steps: Ints) -> Floats:
    """Local coordinates (m, 2), lengths, relative to the cell `steps` (m, 2) away."""
    if not steps.any():
        return local
    if pattern.turn:
        own = _less_upright(pattern, turned(local, -pattern.turn), steps)
        return np.where(steps.any(axis=-1, keepdims=True), turned(own, pattern.turn), local)
    return _less_upright(pattern, local, steps)


def _less_upright(pattern: Pattern, local: Floats, steps: Ints) -> Floats:
    """As `less_steps`, along the axes of the pattern."""
    i, j = steps[:, 0].astype(np.float64), steps[:, 1].astype(np.float64)
    along, row = (i + 0.5 * j, pattern.row_height) if pattern.hexagonal else (i, pattern.pitch[1])
    x = less_multiple(local[:, 0], along, pattern.pitch[0])
    return np.stack([x, less_multiple(local[:, 1], j, row)], axis=-1)


def node_cells(pattern: Pattern) -> tuple[NodeCells, ...]:
    """List each class of nodes (points where corners of cells coincide) as the cells around it.

    Square and rectangular: one class, corner 1 (+x, +y) of its first cell. Hexagonal: two classes, corner 1
    (upper right) and corner 2 (top) of the first cell.
    """
    if pattern.hexagonal:
        # Walking counter-clockwise about a corner, a cell's corner index advances by two.
        return ((((0, 0), 1), ((1, 0), 3), ((0, 1), 5)), (((0, 0), 2), ((0, 1), 4), ((-1, 1), 0)))
    return ((((0, 0), 1), ((1, 0), 2), ((1, 1), 3), ((0, 1), 0)),)


def less_multiple(x: Floats, k: Floats, step: float) -> Floats:
    """Return x − k·step (n,), lengths, without rounding the product."""
    high, low = two_product(k, step)
    return np.asarray((x - high) - low)


def in_hexagon(
    pattern: Pattern, local: Callable[[Floats, Floats], tuple[Floats, Floats]], x: Floats, y: Floats
) -> tuple[Ints, Floats, Floats]:
    """Cells (n, 2) that contain points, and the points relative to their centres, by steps across borders
    from a guess.

    local : Indices i, j (n,) each → the points relative to those cells' centres.
    x, y : (n,) lengths. Points relative to the centre of cell (0, 0), rounded: for the guess.
    """
    pitch, row = pattern.pitch[0], pattern.row_height
    j: Floats = np.rint(y / row)
    i: Floats = np.rint(x / pitch - 0.5 * j)
    half, slant = 0.5 * pitch, row / pitch
    local_x, local_y = local(i, j)
    for _ in range(4):  # a nearest-row guess is at most one border off; corners settle in two
        moved = np.zeros(np.shape(i), dtype=np.bool_)
        for (di, dj), (ux, uy) in zip(
            pattern.steps[:3], ((1.0, 0.0), (0.5, slant), (-0.5, slant)), strict=True
        ):
            across = ux * local_x + uy * local_y
            step = np.where(moved, 0.0, 1.0 * (across >= half) - (across < -half))
            i, j = i + step * di, j + step * dj
            moved |= step != 0
        if not moved.any():
            break
        local_x, local_y = local(i, j)
    return np.stack([i, j], axis=-1).astype(np.int64), local_x, local_y


def _relocate_axis(x: Floats, pitch: float) -> tuple[Floats, Floats]:
    """Whole steps and remainder along one axis of a rectangular lattice."""
    half = 0.5 * pitch
    k = np.floor(x / pitch + 0.5)
    local = less_multiple(x, k, pitch)
    k = k + (local >= half) - (local < -half)
    return k, less_multiple(x, k, pitch)


# -- rotation ---------------------------------------------------------------------------------------

MOST_TURN: Final = 0.7853981633974483
"""Largest rotation, radians: a square pattern repeats after twice this angle."""

_ENOUGH: Final = Exact(1, 2**130)


def turned(points: Floats, angle: float) -> Floats:
    """Points (..., 2) rotated by an angle (radians) from +x to +y about the origin."""
    (c, _), (s, _) = cosine_and_sine(angle)
    x, y = points[..., 0], points[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def turned_pairs(x: Pair, y: Pair, angle: float) -> tuple[Pair, Pair]:
    """Points (n,), lengths in pairs, rotated by an angle (radians) from +x to +y about the origin."""
    c, s = (tuple(np.asarray(part) for part in parts) for parts in cosine_and_sine(angle))
    return (
        pair_sum(pair_product(x, c), negated(pair_product(y, s))),  # type: ignore[arg-type]
        pair_sum(pair_product(x, s), pair_product(y, c)),  # type: ignore[arg-type]
    )


@lru_cache(maxsize=64)
def cosine_and_sine(angle: float) -> tuple[Pair2, Pair2]:
    """Cosine and sine of an angle (radians, |angle| ≤ `MOST_TURN`), each as a number and its remainder."""
    exact, term, k = Exact(angle), Exact(1), 0
    sums = [Exact(0), Exact(0)]
    while abs(term) > _ENOUGH:
        sums[k % 2] += term if k % 4 < 2 else -term
        k += 1
        term = term * exact / k
    return _split(sums[0]), _split(sums[1])


def held_when_turned(sides: Pair2, angle: float) -> float:
    """Largest scale at which a rotated rectangle (side lengths) still fits inside the original."""
    (c, _), (s, _) = cosine_and_sine(abs(angle))
    width, height = sides
    return min(width / (c * width + s * height), height / (s * width + c * height))


def _split(value: Exact) -> Pair2:
    high = float(value)
    return high, float(value - Exact(high))
