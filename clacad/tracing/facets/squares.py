"""Bins of a grid that facets halve: two that face down and two that face up, each pair a square cut along its
diagonal. Bins may be sheared along y: the triangles of hexagonal cells halve such bins.

Nearly all of a sheet's own mesh is made of such squares, and so are meshes of height maps. Where neighbouring
squares share their corners to the last bit, each side of a body is one piece of surface over them, without
holes, folds or steps. A ray steeper than all of its facets crosses it once, and one table lookup finds where:
a tenth of the time of a tree of boxes, where a trace through a file costs more than 10 times one through the
mesh in memory. What is not of that kind is left to the trees of `hierarchy`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Bools, Floats, Ints
from clacad.base.vectors import doubled_normals
from clacad.sheet.window import WALL
from clacad.tracing.facets.hierarchy import COUNT, FIRST, Hierarchy
from clacad.tracing.facets.tiles import over_bins

# Columns of a body's row: corner of the grid, bins per length, bins in x and y, number of the first bin and
# of the first corner of bins, and the heights between which facets that face down, and those that face up,
# lie; direction of diagonals on both sides, the steepest slopes there, and the deviation of corners; slope of
# the rows of bins: the grid is regular in x and y − SHEAR x.
LOW_X, LOW_Y, PER_X, PER_Y, BINS_X, BINS_Y, BIN, CORNER, DOWN_LOW, DOWN_HIGH, UP_LOW, UP_HIGH = range(12)
SPLIT, CLIMB, OFF, SHEAR = 12, 14, 16, 17
SQUARE_NUMBERS = 18

HAIR = 1e-4
"""Share of a bin, along its borders, in which a ray is left to the trees."""

FULLEST = 16
"""Entries for each triangle, on average, beyond which no squares are looked for."""

NEAR = 1e-3
"""Share of a bin by which facet corners may deviate from those of the bin: numbers in files are rounded."""

ROUNDED = 4.0
"""Multiple of the corner deviation: a point this far from a border is certainly on that side of it."""

WHOLE_OF = (15 - (1 << 0), 15 - (1 << 1), 15 - (1 << 2), 15 - (1 << 3))
"""Sets of three corners of a bin, by the missing corner; corners 0, 1 lie along x and 2, 3 beyond in y."""


class Squares(NamedTuple):
    """Bins of every body, one body after the other.

    table : (bodies, SQUARE_NUMBERS). Columns as named above, lengths in the sheet frame. Diagonals are −1
        rising, +1 falling; slopes are sines; corners deviate by a share of a bin.
    odd : (corners of bins,) ints. For each corner of bins, the number of bins to its left and below that
        contain walls or are not halved: four of them give the count in any rectangle.
    plane : (2 bins, 2, 4). Normal towards +z, of length twice the facet's area, and its product with the
        facet's first corner. For both halves of a bin, the one before its diagonal first, on both sides.
    """

    table: Floats
    odd: NDArray[np.int32]
    plane: Floats


class Triangles(NamedTuple):
    """Triangles from any source: their trees, and those of them that halve the bins of a grid."""

    trees: Hierarchy
    squares: Squares


NO_SQUARES = Squares(np.zeros((0, SQUARE_NUMBERS)), np.zeros(0, dtype=np.int32), np.zeros((0, 2, 4)))


def find_squares(trees: Hierarchy, shear: float = 0.0) -> Squares:
    """Squares of a hierarchy's triangles, in rows of slope `shear`; `NO_SQUARES` where a body has none."""
    made: list[Squares] = []
    first = edge = 0
    for begin, count in trees.tree[:, [FIRST, COUNT]].tolist():
        own = _body_squares(trees.corner[begin : begin + count], shear)
        if own is None:
            return NO_SQUARES
        own.table[0, BIN], own.table[0, CORNER] = first, edge
        made.append(own)
        first, edge = first + len(own.plane) // 2, edge + len(own.odd)
    return Squares(*(np.concatenate([getattr(own, name) for own in made]) for name in Squares._fields))


def _body_squares(corners: Floats, shear: float) -> Squares | None:
    """Squares of one body; None where there are none."""
    normal = doubled_normals(corners)
    walls = normal[:, 2] ** 2 < WALL**2 * np.einsum("ij,ij->i", normal, normal)
    lens = np.flatnonzero(~walls)
    if not len(lens):
        return None
    flat = corners[..., :2] - corners[..., :1] * [0.0, shear]
    box_low, box_high = flat.min(axis=1), flat.max(axis=1)
    low, high = box_low.min(axis=0), box_high.max(axis=0)
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
    up = normal[lens, 2] > 0.0
    heights = [_range(corners[lens[side], :, 2]) for side in (~up, up)]
    place = (flat - low) * per
    split, climb, off, plane, odd = _halved(place, corners, normal, facet, where, bins)
    rim = ((end < HAIR) | (begin > bins - HAIR)).any(axis=1)  # rays so near the grid's border are left anyway
    odd[over_bins(np.flatnonzero(walls & ~rim), i0, across, int(bins[0]))[1]] = True
    table = [*low, *per, *bins.astype(float), 0.0, 0.0, *heights[0], *heights[1], *split, *climb, off, shear]
    return Squares(np.array([table]), _sums(odd, bins), plane)


def _range(heights: Floats) -> tuple[float, float]:
    """Lowest and highest; an empty range where there are none."""
    return (float(heights.min()), float(heights.max())) if heights.size else (np.inf, -np.inf)


def _sums(held: Bools, bins: Ints) -> NDArray[np.int32]:
    """Number of the marked bins (bins,) to the left and below every corner of bins, row by row."""
    found = np.zeros((int(bins[1]) + 1, int(bins[0]) + 1), dtype=np.int32)
    found[1:, 1:] = held.reshape(int(bins[1]), int(bins[0]))
    return np.ascontiguousarray(found.cumsum(axis=0, dtype=np.int32).cumsum(axis=1, dtype=np.int32)).ravel()


def _halved(
    place: Floats, corners: Floats, normal: Floats, facet: Ints, where: Ints, bins: Ints
) -> tuple[Floats, Floats, float, Floats, Bools]:
    """Numbers of halved bins, as in `Squares`: split, climb, off, plane; and which bins (b,) are not halved.

    place : (t, 3, 2), corners of the facets in the sheet plane, counted in bins
    corners, normal : (t, 3, 3) lengths, (t, 3)
    facet, where : (k,), facets that are not walls and the bins they are over, bin after bin
    bins : (2,)
    """
    count = int(bins.prod())
    split, climb, off = np.ones(2), np.zeros(2), 0.0
    plane, odd = np.zeros((2 * count, 2, 4)), np.zeros(count, dtype=np.bool_)
    for side in (0, 1):
        mine = (normal[facet, 2] > 0.0) == (side == 1)
        own, at = facet[mine], where[mine]
        two = np.bincount(at, minlength=count) == 2
        pair, at = own[two[at]].reshape(-1, 2), at[two[at]][::2]
        lacks, far = _lacking(place[pair] - np.stack(np.divmod(at, bins[0])[::-1], axis=1)[:, None, None])
        fits = (lacks >= 0).all(axis=1) & (lacks.sum(axis=1) == 3)
        falling = np.isin(lacks[:, 0], (0, 3))
        split[side] = 1.0 if 2 * (falling & fits).sum() >= fits.sum() else -1.0
        fits &= falling == (split[side] > 0.0)
        pair, at, lacks = pair[fits], at[fits], lacks[fits]
        held = _whole(corners, place, pair, at, bins)
        odd |= ~held
        off = max(off, float(far[fits].max(initial=0.0)))
        beyond = lacks == (0 if split[side] > 0.0 else 1)
        up = normal[pair] * (1.0 if side == 1 else -1.0)
        rows = np.concatenate([up, np.einsum("kpc,kpc->kp", up, corners[pair, 0])[..., None]], axis=2)
        plane[2 * at[:, None] + beyond, side] = rows
        slope = np.hypot(up[..., 0], up[..., 1]) / np.sqrt(np.einsum("kpc,kpc->kp", up, up))
        climb[side] = slope.max(initial=0.0) * (1.0 + 1e-12)
    return split, climb, off, plane, odd


def _lacking(local: Floats) -> tuple[Ints, Floats]:
    """Corner (k, 2) of its bin that two facets (k, 2, 3, 2) each lack, −1 for no half; their deviation."""
    near = np.rint(local)
    far = np.abs(local - near).max(axis=(1, 2, 3), initial=0.0)
    sound = (near >= 0.0).all(axis=(2, 3)) & (near <= 1.0).all(axis=(2, 3)) & (far < NEAR)[:, None]
    number = np.where(sound[..., None], near[..., 0] + 2.0 * near[..., 1], 0.0).astype(np.int64)
    held = np.bitwise_or.reduce(1 << number, axis=2)
    lacks = np.full(held.shape, -1, dtype=np.int64)
    for corner, rest in enumerate(WHOLE_OF):
        lacks[sound & (held == rest)] = corner
    return lacks, far


def _whole(corners: Floats, place: Floats, pair: Ints, at: Ints, bins: Ints) -> NDArray[np.bool_]:
    """Bins (bins,) whose two facets, and halved neighbours, have the same corners to the last bit."""
    wide, high = int(bins[0]), int(bins[1])
    first, second = (np.full((high * wide, 4, 3), np.nan) for _ in (0, 1))
    for table, which in ((first, pair[:, 0]), (second, pair[:, 1])):
        near = np.rint(place[which] - np.stack([at % wide, at // wide], axis=1)[:, None]).astype(np.int64)
        table[at[:, None], near[..., 0] + 2 * near[..., 1]] = corners[which]
    held = np.zeros(high * wide, dtype=np.bool_)
    held[at] = True
    held &= ((first == second) | np.isnan(first) | np.isnan(second)).all(axis=(1, 2))
    corner = np.where(np.isnan(first), second, first).reshape(high, wide, 4, 3)
    known, apart = held.reshape(high, wide), np.zeros((high, wide), dtype=np.bool_)
    for one, other, ends in (
        (np.s_[:, :-1], np.s_[:, 1:], ((1, 0), (3, 2))),
        (np.s_[:-1, :], np.s_[1:, :], ((2, 0), (3, 1))),
    ):
        parted = np.zeros_like(known[one])
        for mine, its in ends:
            parted |= (corner[one][..., mine, :] != corner[other][..., its, :]).any(axis=-1)
        parted &= known[one] & known[other]
        apart[one] |= parted
        apart[other] |= parted
    return (known & ~apart).ravel()
