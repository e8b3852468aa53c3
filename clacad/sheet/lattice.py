"""The finite pattern of cells of a sheet: which cells exist, which contains a point, and where in it.

This is the reference for cell-of-point; `test_trace_kernels` compares the compiled counterparts of
`Lattice.locate` and `relocate` with it bit for bit. A point a billion pitches away keeps all accuracy of its
coordinate in its cell.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from clacad.base.pairs import two_product, two_sum
from clacad.base.types import Bools, Floats, Ints
from clacad.sheet.pattern import Kind, Pattern, in_hexagon, turned, turned_pairs
from clacad.sheet.plate import Plate, whole_cells

BLOCK = 1 << 15
"""Cells listed at once."""


def runs(columns: Ints) -> Ints:
    """Runs (k, 2) of consecutive integers, first and one past the last, the longest run first."""
    if not len(columns):
        return np.empty((0, 2), dtype=np.int64)
    ends = np.flatnonzero(np.diff(columns) > 1)
    first, last = np.append(columns[:1], columns[ends + 1]), np.append(columns[ends], columns[-1:]) + 1
    return np.stack([first, last], axis=-1)[np.argsort(first - last, kind="stable")]


@dataclass(frozen=True, slots=True)
class Circle:
    """A circular outline of the given diameter (length), centred on the origin."""

    diameter: float


@dataclass(frozen=True, slots=True)
class Rectangle:
    """A rectangular outline of the given width and height (lengths), centred on the origin."""

    width: float
    height: float


Outline = Circle | Rectangle | Plate


def inside_outline(outline: Outline, points: Floats) -> Bools:
    """Which points (..., 2), lengths, lie in an outline;
    the edge counts as inside, with a tolerance of 1e-12 of its size.
    """
    if isinstance(outline, Plate):
        return outline.inside(points)
    x, y = points[..., 0], points[..., 1]
    room = 0.5 * (1 + 1e-12)
    if isinstance(outline, Circle):
        return np.asarray(np.hypot(x, y) <= room * outline.diameter)
    return np.asarray((np.abs(x) <= room * outline.width) & (np.abs(y) <= room * outline.height))


def in_sector(points: Floats, copies: int) -> Bools:
    """Which points (..., 2) lie in the first of 2 or 4 sectors about the origin, each with its first edge."""
    x, y = points[..., 0], points[..., 1]
    return np.asarray((y >= 0.0) & (x > 0.0) if copies == 4 else (y > 0.0) | ((y == 0.0) & (x > 0.0)))


def grown(outline: Outline, border: float) -> Outline:
    """Outline with a border (length) of constant width added around a circle or a rectangle;
    a `Plate` is returned as drawn.
    """
    if isinstance(outline, Circle):
        return Circle(outline.diameter + 2.0 * border)
    if isinstance(outline, Rectangle):
        return Rectangle(outline.width + 2.0 * border, outline.height + 2.0 * border)
    return outline


def half_sizes(outline: Outline) -> tuple[float, float]:
    """Half sizes of an outline: its reach from the origin along x and y (lengths)."""
    if isinstance(outline, Plate):
        return outline.reach
    if isinstance(outline, Circle):
        return 0.5 * outline.diameter, 0.5 * outline.diameter
    return 0.5 * outline.width, 0.5 * outline.height


@dataclass(frozen=True)
class Lattice(Pattern):
    """A finite pattern of identical cells whose mean centre is the origin.

    Parameters
    ----------
    kind : "square", "rectangular" or "hexagonal"
    pitch : (p_x, p_y), lengths
        Hexagonal: p_x is centre to centre = flat to flat, p_y is ignored; cells point up.
    count : (n1, n2)
        Hexagonal: n2 rows of n1 cells, odd rows displaced by +p/2; indices are axial (i, j).
    outline : Circle, Rectangle, Plate or None
        Only cells whose whole footprint lies inside are kept.
    turn : float, radians
        Rotation of the whole pattern about its centre, from +x to +y; 0 for a pattern with an outline.
    copies : 1, 2 or 4
        Above 1: only cells of the first half (y > 0) or quarter (x, y > 0) are kept; with their turned copies
        they are the whole pattern, less a cell at its centre.
    """

    kind: Kind
    pitch: tuple[float, float]
    count: tuple[int, int]
    outline: Outline | None = None
    turn: float = 0.0
    copies: int = 1

    @property
    def straight(self) -> Lattice:
        """The pattern in its own axes, without rotation."""
        return replace(self, turn=0.0) if self.turn else self

    def with_count(self, count: tuple[int, int]) -> Lattice:
        """Lattice of the same kind and pitch with another count, without outline, about the origin."""
        return Lattice(self.kind, self.pitch, count)

    def contains(self, index: Ints) -> Bools:
        """Whether each index (..., 2) names a kept cell, (...) bool."""
        i, j = index[..., 0], index[..., 1]
        first = -(j // 2) if self.hexagonal else np.zeros_like(j)
        n1, n2 = self.count
        inside = (j >= 0) & (j < n2) & (i >= first) & (i < first + n1)
        if self.copies > 1:
            inside &= in_sector(self.centres(index), self.copies)
        if self.outline is None:
            return np.asarray(inside)
        if not isinstance(self.outline, Plate) and n1 * n2 > MOST_TABLED:
            return np.asarray(inside & _in_outline(self, index))
        held = _on_plate(self, self.outline) if isinstance(self.outline, Plate) else _kept(self)
        rows, columns = np.where(inside, j, 0), np.where(inside, i - first, 0)
        return np.asarray(inside & held[rows, columns])

    def cells(self) -> Ints:
        """List the kept cells, row by row, as (n, 2) indices."""
        if self.outline is None and self.copies == 1:
            return _of_rows(self, np.arange(self.count[1], dtype=np.int64))
        return self._selected

    @cached_property
    def _selected(self) -> Ints:
        """The cells that an outline or a sector keeps, found once, read-only."""
        found = np.concatenate([np.empty((0, 2), dtype=np.int64), *_blocks(self)])
        found.flags.writeable = False
        return found

    def row(self, j: int) -> Ints:
        """List the kept cells of row j as (n, 2) indices."""
        return _of_rows(self, np.array([j], dtype=np.int64))

    @property
    def cell_count(self) -> int:
        """Number of kept cells."""
        if self.outline is None and self.copies == 1:
            return self.count[0] * self.count[1]
        return len(self._selected)

    @property
    def holds_a_cell(self) -> bool:
        """Whether any cell is kept."""
        if isinstance(self.outline, Plate):
            return bool(_on_plate(self, self.outline).any())
        return bool(self.contains(_middle(self)).any())

    def least_outline(self) -> Circle | Rectangle:
        """Return the smallest outline of the lattice's kind that contains the cell nearest to the centre."""
        corners = np.abs(self.centres(_middle(self))[:, None, :] + self.tile())
        nearest = corners[np.argmin(np.hypot(corners[..., 0], corners[..., 1]).max(axis=1))]
        if isinstance(self.outline, Rectangle):
            return Rectangle(*(2.0 * nearest.max(axis=0)).tolist())
        return Circle(2.0 * float(np.hypot(nearest[:, 0], nearest[:, 1]).max()))

    def extent(self) -> tuple[float, float, float, float]:
        """Bounding box (x_min, x_max, y_min, y_max) of the kept cells' footprints (lengths)."""
        if self.outline is not None or self.copies > 1:
            index = self.cells()
        elif self.hexagonal:
            index = np.concatenate([self.row(j) for j in {0, min(1, self.count[1] - 1), self.count[1] - 1}])
        else:
            index = np.array([(0, 0), (self.count[0] - 1, self.count[1] - 1)])
        corners = self.centres(index)[:, None, :] + self.tile()
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        return float(low[0]), float(high[0]), float(low[1]), float(high[1])

    @property
    def first_centre(self) -> tuple[float, float]:
        """Centre (x, y) of cell (0, 0) along the pattern's own axes (lengths)."""
        n1, n2 = self.count
        if self.hexagonal:
            p = self.pitch[0]
            odd_rows = n2 // 2
            return (-0.5 * p * ((n1 - 1) + odd_rows / n2), -0.5 * self.row_height * (n2 - 1))
        return (-0.5 * self.pitch[0] * (n1 - 1), -0.5 * self.pitch[1] * (n2 - 1))

    def centres(self, index: Ints) -> Floats:
        """Centres of the cells `index` (..., 2), kept or not, as (..., 2) lengths."""
        if self.turn:
            return turned(self.straight.centres(index), self.turn)
        i, j = index[..., 0], index[..., 1]
        n1, n2 = self.count
        if self.hexagonal:
            x0, y0 = self.first_centre
            return np.stack([x0 + (i + 0.5 * j) * self.pitch[0], y0 + j * self.row_height], axis=-1)
        x = (2 * i - (n1 - 1)) * (0.5 * self.pitch[0])
        y = (2 * j - (n2 - 1)) * (0.5 * self.pitch[1])
        return np.stack([x, y], axis=-1)

    def locate(
        self, x: Floats, y: Floats, x_low: Floats | float = 0.0, y_low: Floats | float = 0.0
    ) -> tuple[Ints, Floats, Floats]:
        """Find the cell that contains each point, and the point relative to the cell's centre.

        Parameters
        ----------
        x, y : (n,) arrays, lengths
            Points in the lattice's frame (subtract an array's displacement first).
        x_low, y_low : (n,) arrays or 0
            Low-order parts: the points are x + x_low, y + y_low in double-double.

        Returns
        -------
        index : (n, 2) int64
            Cell indices, kept or not. A point on a border belongs to the cell with the
            greater x or y.
        local_x, local_y : (n,) arrays, lengths
            Exact differences from the centre, rounded once; −p/2 ≤ local < p/2. For a turned pattern they are
            along the sheet's axes too, and rounded once more.
        """
        if self.turn:
            whole = (x, np.broadcast_to(x_low, x.shape)), (y, np.broadcast_to(y_low, y.shape))
            (u, u_low), (v, v_low) = turned_pairs(*whole, -self.turn)
            index, u, v = self.straight.locate(u, v, u_low, v_low)
            inside = turned(np.stack([u, v], axis=-1), self.turn)
            return index, inside[:, 0], inside[:, 1]
        if not self.hexagonal:
            i, local_x = _locate_axis(x, x_low, self.pitch[0], self.count[0])
            j, local_y = _locate_axis(y, y_low, self.pitch[1], self.count[1])
            return np.stack([i, j], axis=-1).astype(np.int64), local_x, local_y
        (x0, y0), pitch, row = self.first_centre, self.pitch[0], self.row_height

        def local(i: Floats, j: Floats) -> tuple[Floats, Floats]:
            along = _minus_multiple(x, x_low, i + 0.5 * j, pitch, x0)
            return along, _minus_multiple(y, y_low, j, row, y0)

        return in_hexagon(self, local, x - x0, y - y0)

    def over_cell(self, unit_square: Floats) -> Floats:
        """Points (n, 2) spread uniformly over a cell, relative to its centre (lengths).

        Points of the unit square (n, 2) are mapped to the parallelogram of the lattice vectors and folded
        into the cell.
        """
        u, v = unit_square[:, 0] - 0.5, unit_square[:, 1] - 0.5
        (ax, ay), (bx, by) = self.a1, self.a2
        centre = self.centres(np.zeros((1, 2), dtype=np.int64))[0]
        _, x, y = self.locate(centre[0] + u * ax + v * bx, centre[1] + u * ay + v * by)
        return np.column_stack([x, y])


def _blocks(lattice: Lattice) -> Iterator[Ints]:
    """Iterate over the kept cells (n, 2), some rows at once."""
    rows = np.array(_rows(lattice), dtype=np.int64)
    together = max(1, BLOCK // lattice.count[0])
    return (_of_rows(lattice, rows[low : low + together]) for low in range(0, len(rows), together))


def _of_rows(lattice: Lattice, rows: Ints) -> Ints:
    """List the kept cells (n, 2) of rows (m,); memory is theirs, limited to the outline's reach."""
    first = -(rows // 2) if lattice.hexagonal else np.zeros_like(rows)
    last = first + lattice.count[0]
    if lattice.outline is not None:
        middle = -lattice.centres(np.stack([np.zeros_like(rows), rows], axis=-1))[:, 0] / lattice.pitch[0]
        reach = half_sizes(lattice.outline)[0] / lattice.pitch[0] + 1.0
        first, last = (
            np.maximum(first, np.minimum(last, end)).astype(np.int64)
            for end in (middle - reach, middle + reach + 1.0)
        )
    number = last - first
    i = np.arange(number.sum()) + np.repeat(first - (np.cumsum(number) - number), number)
    index = np.stack([i, np.repeat(rows, number)], axis=-1)
    return index if lattice.outline is None and lattice.copies == 1 else index[lattice.contains(index)]


MOST_TABLED = 1 << 18
"""Largest number of cells of a pattern of which a table holds which are kept: it is found in milliseconds."""


@lru_cache(maxsize=32)
def _kept(lattice: Lattice) -> Bools:
    """Which cells an outline keeps, (n2, n1), each row from its first cell."""
    return _in_outline(lattice, _every_cell(lattice)).reshape(lattice.count[1], lattice.count[0])


def _in_outline(lattice: Lattice, index: Ints) -> Bools:
    """Which cells (..., 2) lie whole inside the outline."""
    assert lattice.outline is not None
    corners = lattice.centres(index)[..., None, :] + lattice.tile()
    return np.asarray(inside_outline(lattice.outline, corners).all(axis=-1))


def _every_cell(lattice: Lattice) -> Ints:
    """Indices (n, 2) of all cells of the rows, kept or not."""
    j, i = np.divmod(np.arange(lattice.count[0] * lattice.count[1]), lattice.count[0])
    return np.stack([i - j // 2 if lattice.hexagonal else i, j], axis=-1)


def _on_plate(lattice: Lattice, plate: Plate) -> Bools:
    """Which cells a plate holds, (n2, n1), each row from its first cell; computed once per pattern."""
    key = (lattice.kind, lattice.pitch, lattice.count)
    if key not in plate.kept:
        held = whole_on_plate(lattice, plate, _every_cell(lattice))
        plate.kept[key] = held.reshape(lattice.count[1], lattice.count[0])
    found: Bools = plate.kept[key]
    return found


def whole_on_plate(lattice: Lattice, plate: Plate, index: Ints) -> Bools:
    """Which cells (n, 2) a plate holds both where array 1 has them and where array 2 has them."""
    held = whole_cells(plate, lattice.tile(), lattice.centres(index), plate.room(lattice.pitch))
    pitch = lattice.pitch if plate.pitch is None else plate.pitch
    if (plate.moved, pitch, plate.turn) != ((0.0, 0.0), lattice.pitch, 0.0):
        second = replace(lattice, pitch=pitch, outline=None, turn=plate.turn)
        held &= whole_cells(
            plate, second.tile(), second.centres(index) + np.array(plate.moved), plate.room(pitch)
        )
    return held


def _rows(lattice: Lattice) -> range:
    """Rows within the outline's reach; all rows without an outline."""
    if lattice.outline is None:
        return range(lattice.count[1])
    middle, reach = 0.5 * (lattice.count[1] - 1), half_sizes(lattice.outline)[1] / lattice.row_height + 1.0
    low, high = (int(max(0, min(lattice.count[1], end))) for end in (middle - reach, middle + reach + 1.0))
    return range(low, high)


def _middle(lattice: Lattice) -> Ints:
    """List the cells, kept or not, next to the centre, at most nine, (n, 2).

    The outlines here are mirror-symmetric about both axes. A cell or a row farther out lies like one of
    these, only farther from an axis. If any cell is kept, one of these is.
    """
    (n1, n2), middle = lattice.count, lattice.count[1] // 2
    found = []
    for j in range(max(middle - 1, 0), min(middle + 2, n2)):
        first = -(j // 2) if lattice.hexagonal else 0
        near = round(-float(lattice.centres(np.array([[0, j]]))[0, 0]) / lattice.pitch[0])
        found += [(min(max(i, first), first + n1 - 1), j) for i in (near - 1, near, near + 1)]
    return np.unique(np.array(found, dtype=np.int64), axis=0)


def _locate_axis(x: Floats, x_low: Floats | float, pitch: float, count: int) -> tuple[Floats, Floats]:
    """Index and centred coordinate along one axis of a rectangular lattice."""
    guess = np.floor(x / pitch + 0.5 * count)
    half = 0.5 * pitch
    local = _minus_multiple(x, x_low, 2.0 * guess - (count - 1), half, 0.0)
    # The quotient is rounded: a point within an ulp of a border may be one cell off.
    # The exact remainder decides.
    guess = guess + (local >= half) - (local < -half)
    local = _minus_multiple(x, x_low, 2.0 * guess - (count - 1), half, 0.0)
    return guess, local


def _minus_multiple(x: Floats, x_low: Floats | float, k: Floats, step: float, origin: float) -> Floats:
    """Return (x + x_low) − k·step − origin with k·step formed exactly, rounded once."""
    high, low = two_product(k, step)
    a, lost_a = two_sum(x, -high)
    b, lost_b = two_sum(a, -origin)
    return np.asarray(b + ((lost_a + lost_b) + (x_low - low)))
