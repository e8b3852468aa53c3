"""Triangles from any source over a grid of bins in the sheet plane, so that a straight ray tests only a few.

A sheet is flat: between the lowest and the highest point of its lenses a ray crosses a bin or two. Each bin
lists the facets over it that are no walls, and bins with walls are counted. What a ray meets along so short a
stretch is then known beyond doubt for any triangles, or the ray is left to the trees of `hierarchy`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clacad.base.facet_vectors import doubled_normals
from clacad.base.types import Floats, Ints
from clacad.sheet.window import WALL
from clacad.tracing.triangles.hierarchy import Hierarchy
from clacad.tracing.triangles.squares import squares
from clacad.tracing.triangles.tiles import over_bins

# Columns of a body's row: corner of the grid, bins per length, bins in x and y, number of the first bin and
# of the first corner of bins, and the heights between which facets that face down, and those that face up,
# lie. Of its squares: direction of diagonals on both sides, the steepest slopes there, and the deviation of
# corners.
LOW_X, LOW_Y, PER_X, PER_Y, BINS_X, BINS_Y, BIN, CORNER, DOWN_LOW, DOWN_HIGH, UP_LOW, UP_HIGH = range(12)
SPLIT, CLIMB, OFF = 12, 14, 16
GRID_NUMBERS = 17

HAIR = 1e-4
"""Share of a bin, along its borders, in which a ray is left to the trees: facets that extend no further are
not listed.
"""

FULLEST = 16
"""Entries for each triangle, on average, beyond which no grid is made."""


class FacetGrid(NamedTuple):
    """Bins of every body, one body after the other.

    Attributes
    ----------
    table : (bodies, GRID_NUMBERS)
        Lengths in the sheet frame.
    start : (bins + 1,) ints, member : ints
        Triangles of the hierarchy over bin b are member[start[b] : start[b + 1]].
    walled : (corners of bins,) ints
        For each corner of bins, the number of bins to its left and below that contain walls: four of them
        give the count in any rectangle.
    odd : (corners of bins,) ints
        As `walled`, for bins that contain walls or are not halved; see `squares`.
    plane : (2 bins, 2, 4)
        See `squares`.
    """

    table: Floats
    start: Ints
    member: NDArray[np.int32]
    walled: NDArray[np.int32]
    odd: NDArray[np.int32]
    plane: Floats


class Triangles(NamedTuple):
    """Triangles from any source, in both of their orders.

    trees : Hierarchy
    grid : FacetGrid
    """

    trees: Hierarchy
    grid: FacetGrid


NO_GRID = FacetGrid(
    np.zeros((0, GRID_NUMBERS)),
    np.zeros(1, dtype=np.int64),
    np.zeros(0, dtype=np.int32),
    np.zeros(0, dtype=np.int32),
    np.zeros(0, dtype=np.int32),
    np.zeros((0, 2, 4)),
)


def facet_grid(trees: Hierarchy) -> FacetGrid:
    """Sort a hierarchy's triangles into bins; `NO_GRID` where their sizes are too different for that to help."""
    made: list[FacetGrid] = []
    first = edge = 0
    for begin, count in trees.tree[:, 1:3].tolist():
        own = _body_grid(trees.corner[begin : begin + count])
        if own is None:
            return NO_GRID
        own.table[0, BIN], own.table[0, CORNER] = first, edge
        made.append(own._replace(member=(own.member + begin).astype(np.int32)))
        first, edge = first + len(own.start) - 1, edge + len(own.walled)
    ends = np.cumsum([0, *(grid.start[-1] for grid in made)])
    starts = [grid.start[1:] + end for grid, end in zip(made, ends, strict=False)]
    return FacetGrid(
        np.concatenate([grid.table for grid in made]),
        np.concatenate([np.zeros(1, dtype=np.int64), *starts]),
        *(np.concatenate([getattr(grid, name) for grid in made]) for name in FacetGrid._fields[2:]),
    )


def _body_grid(corners: Floats) -> FacetGrid | None:
    """One body's grid, its members numbers among `corners`; None where there is none."""
    normal = doubled_normals(corners)
    walls = normal[:, 2] ** 2 < WALL**2 * np.einsum("ij,ij->i", normal, normal)
    lens = np.flatnonzero(~walls)
    if not len(lens):
        return None
    low, high = corners[..., :2].min(axis=(0, 1)), corners[..., :2].max(axis=(0, 1))
    box_low, box_high = corners[..., :2].min(axis=1), corners[..., :2].max(axis=1)
    width = np.median(box_high[lens] - box_low[lens], axis=0)
    limit = max(1.0, np.sqrt(4.0 * len(lens)))
    with np.errstate(divide="ignore", invalid="ignore"):
        bins = np.clip(
            np.nan_to_num(np.rint((high - low) / width), nan=1.0, posinf=limit), 1.0, limit
        ).astype(np.int64)
    per = bins / np.maximum(high - low, 1e-300)
    begin, end = (box_low - low) * per, (box_high - low) * per
    thin = end - begin < 4.0 * HAIR  # might lie along a border and be listed on neither side
    margin = np.where(thin, 0.0, HAIR)
    i0 = np.clip(np.floor(begin + margin), 0, bins - 1).astype(np.int64)
    i1 = np.clip(np.floor(end - margin), 0, bins - 1).astype(np.int64)
    across = np.maximum(i1 - i0 + 1, 1)
    if int(across[lens].prod(axis=1).sum()) > FULLEST * len(corners) + int(bins.prod()):
        return None
    facet, where = over_bins(lens, i0, across, int(bins[0]))
    order = np.argsort(where, kind="stable")
    facet, where = facet[order], where[order]
    start = np.searchsorted(where, np.arange(int(bins.prod()) + 1)).astype(np.int64)
    up = normal[lens, 2] > 0.0
    heights = [_range(corners[lens[side], :, 2]) for side in (~up, up)]
    halved = squares((corners[..., :2] - low) * per, corners, normal, facet, where, bins)
    table = [
        *low,
        *per,
        *bins.astype(float),
        0.0,
        0.0,
        *heights[0],
        *heights[1],
        *halved.split,
        *halved.climb,
        halved.off,
    ]
    walled = over_bins(np.flatnonzero(walls), i0, across, int(bins[0]))[1]
    odd = np.concatenate([walled, np.flatnonzero(halved.odd)])
    return FacetGrid(
        np.array([table]), start, facet.astype(np.int32), _sums(walled, bins), _sums(odd, bins), halved.plane
    )


def _range(heights: Floats) -> tuple[float, float]:
    """Lowest and highest; an empty range where there are none."""
    return (float(heights.min()), float(heights.max())) if heights.size else (np.inf, -np.inf)


def _sums(held: Ints, bins: Ints) -> NDArray[np.int32]:
    """Number of the given bins to the left and below every corner of bins, row by row."""
    found = np.zeros((int(bins[1]) + 1, int(bins[0]) + 1), dtype=np.int32)
    j, i = np.divmod(held, int(bins[0]))
    found[j + 1, i + 1] = 1
    return np.ascontiguousarray(found.cumsum(axis=0, dtype=np.int32).cumsum(axis=1, dtype=np.int32)).ravel()
