"""Bins of a grid that facets halve: two that face down and two that face up, each pair a square cut along its
diagonal.

Nearly all of a sheet's own mesh is made of such squares, and so are meshes of height maps. Where neighbouring
squares share their corners to the last bit, each side of a body is one piece of surface over them, without
holes, folds or steps. A ray steeper than all of its facets crosses it once, and one table lookup finds where.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Ints

NEAR = 1e-3
"""Share of a bin by which corners of facets may deviate from those of the bin: numbers in files are rounded.
"""

ROUNDED = 4.0
"""Multiple of the corner deviation: a point this far from a border is certainly on that side of it."""

WHOLE_OF = (15 - (1 << 0), 15 - (1 << 1), 15 - (1 << 2), 15 - (1 << 3))
"""Sets of three corners of a bin, by the missing corner; corners are 0, 1 along x and 2, 3 beyond them along
y.
"""


class Squares(NamedTuple):
    """Facets that halve the bins of one body.

    Attributes
    ----------
    split : (2,)
        Direction of diagonals below and above: −1 rising, +1 falling.
    off : float
        Share of a bin by which corners deviate from those of bins.
    climb : (2,)
        Sine of the steepest slope of each side.
    plane : (2 bins, 2, 4)
        Normal towards +z, of length twice the facet's area, and its product with the facet's first corner.
        For both halves of a bin, the one before its diagonal first, on both sides.
    odd : (bins,) bools
        Bins that are not halved.
    """

    split: Floats
    off: float
    climb: Floats
    plane: Floats
    odd: NDArray[np.bool_]


def squares(place: Floats, corners: Floats, normal: Floats, facet: Ints, where: Ints, bins: Ints) -> Squares:
    """Find the bins of a body that facets halve.

    Parameters
    ----------
    place : (t, 3, 2)
        Corners of the facets in the sheet plane, counted in bins.
    corners : (t, 3, 3) lengths
    normal : (t, 3)
    facet, where : (k,) ints
        Facets that are not walls and the bins they are over, bin after bin.
    bins : (2,) ints
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
    return Squares(split, off, climb, plane, odd)


def _lacking(local: Floats) -> tuple[Ints, Floats]:
    """Corner (k, 2) of its bin that each of two facets (k, 2, 3, 2) lacks, −1 where it is no half; and their
    deviation.
    """
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
