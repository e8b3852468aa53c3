"""What of a measured side is form: where its cells are formed surface, its texture, and its deviation map."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from clacad.base.types import Bools, Floats, Ints
from clacad.measuring.fit_lenslets import CLIPPED, Lenslets, conic, parts_of
from clacad.measuring.light_through_form import MeasuredSide
from clacad.measuring.read_map import MeasuredMap
from clacad.measuring.sides import ShownCells

BINS = 128
"""Most parts of a cell along each side that are formed or not."""

LAGS = 8
"""Distances, in points, up to which heights of a texture are compared; noise of single points has none."""

LOOK_UP = 65
"""Nodes along a side of a cell at which the form is looked up."""


@dataclass(frozen=True, eq=False)
class Surface:
    """One measured side.

    measured : lengths in design units, scales taken off
    lit : Its lenslets, and where they are formed.
    sq, u_sq : (m,) lengths. Rms of the texture of each lenslet, without noise of single points where the
    points lie
        on a grid, and its standard uncertainty.
    deviation : (rows, columns) lengths. Measured surface less the design's, NaN where there is no whole
    lenslet.
    noise : length. Rms of what form leaves of single points.
    """

    measured: MeasuredMap
    lit: MeasuredSide
    sq: Floats
    u_sq: Floats
    deviation: Floats
    noise: float

    @property
    def lenslets(self) -> Lenslets:
        """The fitted lenslets."""
        return self.lit.lenslets

    @cached_property
    def targets(self) -> Floats:
        """Numbers (m, 7) of the design's lenslets, each of its own cell."""
        return self.lit.side.numbers(self.lit.cells.of(self.lenslets.index))

    @property
    def radius(self) -> float:
        """Mean radius (length) of the design's lenslets."""
        return 1.0 / float(self.targets[:, 3].mean())

    @property
    def texture(self) -> float:
        """Rms (length) of the texture of all lenslets."""
        return float(np.sqrt(np.mean(self.sq**2)))


def surface_of(measured: MeasuredMap, cells: ShownCells, lenslets: Lenslets, u_scale: float) -> Surface:
    """Separate formed surface from seams and texture, point by point.

    u_scale : Half width of the relative uncertainty of heights.
    """
    side = cells.side
    bounds = np.abs(side.lattice.tile()).max(axis=0)
    number, (u, v, z) = lenslets.placed(measured.points)
    own = cells.of(lenslets.index)
    target = side.heights(None, u, v) if side.alike else np.zeros(z.shape)
    off = np.full(z.shape, np.nan)
    across = 2.0 * float(bounds.min()) / (1.5 * max(measured.pixel))
    bins = int(np.clip(across, 8, BINS))
    formed = np.zeros((len(lenslets.index), bins, bins), dtype=bool)
    order = np.argsort(number.astype(np.min_scalar_type(-len(lenslets.index))), kind="stable")
    ends = np.searchsorted(number, np.arange(len(lenslets.index) + 1), sorter=order)
    row, column = _grid_of(measured)
    sq = np.zeros((2, len(lenslets.index)))
    for k in range(len(lenslets.index)):
        mine = order[ends[k] : ends[k + 1]]
        if not side.alike:
            target[mine] = side.heights(own[k], u[mine], v[mine])
        rest = z[mine] - _form(lenslets, k, u[mine], v[mine], bounds)
        off[mine] = rest
        inner = lenslets.aperture.holds(u[mine], v[mine])
        spread = 1.4826 * float(np.median(np.abs(rest[inner] - np.median(rest[inner]))))
        sound = np.abs(rest) <= CLIPPED * spread + 1e-9 * float(bounds.min())
        formed[k] = _formed(u[mine], v[mine], sound, bounds, bins)
        use = inner & sound
        sq[:, k] = _texture(rest[use], row[mine][use], column[mine][use], measured.regular)
    table = np.full(measured.shape, np.nan)
    held = number >= 0
    table[row[held], column[held]] = (z - target)[held]
    lit = MeasuredSide(cells, lenslets, formed, bounds, u_scale)
    return Surface(measured, lit, sq[0], sq[1], table, float(np.sqrt(np.mean(lenslets.texture**2))))


def _grid_of(measured: MeasuredMap) -> tuple[Ints, Ints]:
    """Row and column (n,) of each point."""
    at = [
        np.clip(
            np.rint(measured.points[k] / measured.pixel[k] + 0.5 * measured.shape[1 - k]).astype(np.int64),
            0,
            measured.shape[1 - k] - 1,
        )
        for k in (0, 1)
    ]
    return at[1], at[0]


def _form(lenslets: Lenslets, number: int, u: Floats, v: Floats, bounds: Floats) -> Floats:
    """Form (n,) of a lenslet: its conic, and the rest from a table of it."""
    lines = [np.linspace(-half, half, LOOK_UP) for half in bounds]
    gx, gy = (one.ravel() for one in np.meshgrid(*lines, indexing="ij"))
    rest = lenslets.heights(number, gx, gy) - conic(lenslets.values[number], gx, gy, slopes=False)[0]
    at = [
        np.clip(np.rint((one / half + 1.0) * 0.5 * (LOOK_UP - 1)).astype(np.int64), 0, LOOK_UP - 1)
        for one, half in zip((u, v), bounds, strict=True)
    ]
    return np.asarray(conic(lenslets.values[number], u, v, slopes=False)[0] + rest[at[0] * LOOK_UP + at[1]])


def _formed(u: Floats, v: Floats, sound: Bools, bounds: Floats, bins: int) -> Bools:
    """Parts (bins, bins) of a cell that are formed surface; lost points among formed ones are formed."""
    i, j = parts_of(u, v, bounds, bins)
    flat = i * bins + j
    good = np.bincount(flat, sound, minlength=bins * bins)
    count = np.bincount(flat, minlength=bins * bins)
    formed = (2.0 * good > count).reshape(bins, bins)
    padded = np.pad(formed, 1, mode="edge").astype(np.int64)
    around = sum(padded[1 + i : bins + 1 + i, 1 + j : bins + 1 + j] for i in (-1, 0, 1) for j in (-1, 0, 1))
    return np.asarray(formed | (around >= 4))


def _texture(rest: Floats, row: Ints, column: Ints, regular: bool) -> tuple[float, float]:
    """Rms (length) of a texture without noise of single points, and its standard uncertainty."""
    if len(rest) < 2:
        return 0.0, 0.0
    whole = float(np.mean((rest - rest.mean()) ** 2))
    doubt = whole * np.sqrt(5.0 / len(rest))
    if not regular:
        return float(np.sqrt(whole)), 0.5 * float(np.sqrt(doubt))
    grid = np.full((int(np.ptp(row)) + 1, int(np.ptp(column)) + 1), np.nan)
    grid[row - row.min(), column - column.min()] = rest - rest.mean()
    like = np.array(
        [
            0.5 * (_product(grid[:, k:], grid[:, :-k]) + _product(grid[k:], grid[:-k]))
            for k in range(1, min(LAGS, min(grid.shape) - 1) + 1)
        ]
    )
    if len(like) < 2:
        return float(np.sqrt(whole)), 0.5 * float(np.sqrt(doubt))
    square = min(whole, max(2.0 * float(like[0]) - float(like[1]), float(np.abs(like).max()), 0.0))
    size = float(np.sqrt(square))
    return size, float(min(np.sqrt(doubt), doubt / max(2.0 * size, 1e-300)))


def _product(one: Floats, two: Floats) -> float:
    """Mean product of what is known of both."""
    both = one * two
    known = np.isfinite(both)
    return float(both[known].mean()) if known.any() else 0.0
