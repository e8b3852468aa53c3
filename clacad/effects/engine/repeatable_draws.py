"""Deterministic draws: a ray with given bits and row number always gets the same numbers."""

from __future__ import annotations

import numpy as np

from clacad.base.hashing import GOLDEN, mixed
from clacad.base.types import Floats
from clacad.optics.rays import Rays


def uniform(rays: Rays, count: int, seed: int, salt: int) -> Floats:
    """Numbers in (0, 1), `count` columns per ray.

    Parameters
    ----------
    rays : Rays
        Their bits and their row numbers are the key, so blocks and tiles have different draws.
    salt : int
        One for each effect, so that effects draw independently.

    Returns
    -------
    (n, count) array

    Notes
    -----
    SplitMix64 (Steele, Lea and Flood, OOPSLA 2014) as a hash; 53 bits and half a step, never 0 or 1.
    """
    columns = (*rays.position.T, *rays.direction.T)
    word = mixed(np.arange(len(rays), dtype=np.uint64) * np.uint64(GOLDEN) + np.uint64(seed))
    for column in columns:
        word = mixed(word ^ np.ascontiguousarray(column).view(np.uint64))
    out = np.empty((len(rays), count))
    for k in range(count):
        step = np.uint64((97 * salt + k + 1) * GOLDEN % 2**64)
        bits = mixed(word + step) >> np.uint64(11)
        out[:, k] = (bits.astype(np.float64) + 0.5) * 2.0**-53
    return out


def normal(rays: Rays, pairs: int, seed: int, salt: int) -> Floats:
    """Standard normal numbers (n, 2 pairs), by Box and Muller."""
    u = uniform(rays, 2 * pairs, seed, salt)
    radius = np.sqrt(-2.0 * np.log(u[:, :pairs]))
    angle = 2.0 * np.pi * u[:, pairs:]
    return np.concatenate([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def disc(rays: Rays, seed: int, salt: int) -> Floats:
    """Points (n, 2) spread evenly over the unit disc."""
    u = uniform(rays, 2, seed, salt)
    radius, angle = np.sqrt(u[:, 0]), 2.0 * np.pi * u[:, 1]
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
