"""What of a measured side is form: where its cells are formed surface, its texture, and its deviation map."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from clacad.base.types import Bools, Floats, Ints
from clacad.measuring.fit_lenslets import CLIPPED, Lenslets, OwnPoints, conic, medians, parts_of
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
    across = 2.0 * float(bounds.min()) / (1.5 * max(measured.pixel))
    bins = int(np.clip(across, 8, BINS))
    formed = np.zeros((len(lenslets.index), bins, bins), dtype=bool)
    row, column = _grid_of(measured)
    sq = np.zeros((2, len(lenslets.index)))
    groups = OwnPoints.of(number, len(lenslets.index))
    lines = [np.linspace(-half, half, LOOK_UP) for half in bounds]
    nodes = lenslets.forms(*(one.ravel() for one in np.meshgrid(*lines, indexing="ij")))
    for some, rows, held in groups.batches():
        if not side.alike:
            for cell, mine, its in zip(own[some], rows, held, strict=True):
                target[mine[its]] = side.heights(cell, u[mine[its]], v[mine[its]])
        x, y = u[rows], v[rows]
        rest = z[rows] - conic(lenslets.values[some], x, y, slopes=False)[0]
        i, j = parts_of(x, y, bounds * (LOOK_UP / (LOOK_UP - 1.0)), LOOK_UP)  # the nearest node
        rest -= np.take_along_axis(lenslets.form[some] @ nodes.T, i * LOOK_UP + j, 1)
        inner = held & lenslets.aperture.holds(x, y)
        spread = 1.4826 * medians(np.abs(rest - medians(rest, inner)[:, None]), inner)
        sound = held & (np.abs(rest) <= (CLIPPED * spread + 1e-9 * float(bounds.min()))[:, None])
        formed[some] = _formed(x, y, sound, held, bounds, bins)
        sq[:, some] = _texture(rest, inner & sound, row[rows], column[rows], measured.regular)
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


def _formed(u: Floats, v: Floats, sound: Bools, held: Bools, bounds: Floats, bins: int) -> Bools:
    """Parts (m, bins, bins) of cells that are formed surface; lost points among formed ones are formed."""
    i, j = parts_of(u, v, bounds, bins)
    flat = (np.arange(len(u))[:, None] * bins + i) * bins + j
    good, count = (np.bincount(flat[one], minlength=len(u) * bins * bins) for one in (sound, held))
    formed = (2 * good > count).reshape(-1, bins, bins)
    padded = np.pad(formed, ((0, 0), (1, 1), (1, 1)), mode="edge").astype(np.int8)
    along = padded[:, :-2] + padded[:, 1:-1] + padded[:, 2:]
    return np.asarray(formed | (along[..., :-2] + along[..., 1:-1] + along[..., 2:] >= 4))


def _texture(rest: Floats, used: Bools, row: Ints, column: Ints, regular: bool) -> tuple[Floats, Floats]:
    """Rms (m,) of textures without noise of single points, and their standard uncertainties.

    rest : (m, n) What form leaves of points, of those that are used.
    """
    count = np.maximum(used.sum(axis=1), 1)
    rest = np.where(used, rest, 0.0)
    rest = np.where(used, rest - (rest.sum(axis=1) / count)[:, None], 0.0)
    whole = (rest * rest).sum(axis=1) / count
    doubt = whole * np.sqrt(5.0 / count)
    size = np.sqrt(whole)
    if regular:
        low = [np.where(used, one, one.max()).min(axis=1)[:, None] for one in (row, column)]
        at = np.nonzero(used)[0], (row - low[0])[used], (column - low[1])[used]
        grid, known = np.zeros((2, len(rest), *(int(one.max(initial=0)) + 1 for one in at[1:])))
        grid[at], known[at] = rest[used], 1.0
        both = (grid, known), (grid.swapaxes(1, 2), known.swapaxes(1, 2))
        lags = range(1, 1 + max(2, min(LAGS, min(grid.shape[1:]) - 1)))
        like = 0.5 * np.array([[_product(*one, lag) for one in both] for lag in lags]).sum(axis=1)
        least = np.maximum(2.0 * like[0] - like[1], np.abs(like).max(axis=0))
        size = np.sqrt(np.minimum(whole, np.maximum(least, 0.0)))
        return size, np.minimum(np.sqrt(doubt), doubt / np.maximum(2.0 * size, 1e-300))
    return size, 0.5 * np.sqrt(doubt)


def _product(grid: Floats, known: Floats, lag: int) -> Floats:
    """Mean product (m,) of what is known and `lag` rows apart."""
    sums, count = (np.einsum("mij,mij->m", one[:, lag:], one[:, :-lag]) for one in (grid, known))
    return np.asarray(sums / np.maximum(count, 1.0))
