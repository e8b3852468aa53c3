"""Is a stream of triangles closed? Told in one pass and a few bytes of memory.

Every facet has three directed edges. A surface is closed and consistently wound when each edge is
walked as often forwards as backwards. Two independent 64-bit hashes of the undirected edge are added
for one sense and subtracted for the other: the sums vanish for a closed surface, and for anything
else only by a chance of 2^-128. A facet left out, turned over or moved by one bit shows.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Words

_SEEDS = (np.uint64(0x9E3779B97F4A7C15), np.uint64(0xC2B2AE3D27D4EB4F))
_MIX = (np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB))


@dataclass(frozen=True, slots=True)
class Measure:
    """What one pass over a mesh tells.

    Parameters
    ----------
    facets : int
    imbalance : (int, int)
        Hash sums over directed edges; (0, 0) for a closed, consistently wound surface.
    volume : float
        Enclosed volume, file unit³ (positive when facets are wound counter-clockwise from outside).
    area : float
        File unit².
    low, high : (3,) tuples
        Corners of the bounding box.
    """

    facets: int
    imbalance: tuple[int, int]
    volume: float
    area: float
    low: tuple[float, float, float]
    high: tuple[float, float, float]

    @property
    def closed(self) -> bool:
        """Whether every edge is walked as often forwards as backwards."""
        return self.facets > 0 and self.imbalance == (0, 0)


def measure(chunks: Iterable[Floats], origin: Floats | None = None) -> Measure:
    """Measure a mesh given as chunks of corners (k, 3, 3).

    Parameters
    ----------
    chunks : iterable of (k, 3, 3) arrays
    origin : (3,) array or None
        Point the volume's cones start from; near the mesh keeps digits. Default: its first corner.

    Notes
    -----
    Corners are one vertex when all bits of their float64 coordinates agree (−0 is 0). The volume is the
    divergence sum of det(a, b, c)/6 with chunk sums added by `math.fsum`.
    """
    from math import fsum

    facets = 0
    sums = [np.uint64(0), np.uint64(0)]
    volumes: list[float] = []
    areas: list[float] = []
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for corners in chunks:
        if not len(corners):
            continue
        if origin is None:
            origin = corners[0, 0].copy()
        facets += len(corners)
        for k, value in enumerate(_edge_sums(corners)):
            with np.errstate(over="ignore"):
                sums[k] = sums[k] + value
        a, b, c = (corners[:, k] - origin for k in range(3))
        normal = np.cross(b - a, c - a)
        volumes.append(float(np.einsum("ij,ij->", a, normal)) / 6.0)
        areas.append(0.5 * float(np.linalg.norm(normal, axis=1).sum()))
        low = np.minimum(low, corners.min(axis=(0, 1)))
        high = np.maximum(high, corners.max(axis=(0, 1)))
    bottom, top = ((float(corner[0]), float(corner[1]), float(corner[2])) for corner in (low, high))
    return Measure(facets, (int(sums[0]), int(sums[1])), fsum(volumes), fsum(areas), bottom, top)


def _edge_sums(corners: Floats) -> tuple[np.uint64, np.uint64]:
    """Signed hash sums of the directed edges of (k, 3, 3) corners, modulo 2^64."""
    words = np.ascontiguousarray(corners + 0.0).view(np.uint64)
    result = []
    for seed in _SEEDS:
        point = _hashed(words, seed)
        total = np.uint64(0)
        for k in range(3):
            start, end = point[:, k], point[:, (k + 1) % 3]
            low, high = np.minimum(start, end), np.maximum(start, end)
            edge = _mixed(low * _MIX[1] + _mixed(high + seed))
            forwards = start < end
            with np.errstate(over="ignore"):
                total = total + np.add.reduce(edge[forwards]) - np.add.reduce(edge[start > end])
        result.append(total)
    return result[0], result[1]


def _hashed(words: Words, seed: np.uint64) -> Words:
    """One hash for each corner, (k, 3), from the bits of its three coordinates."""
    value = _mixed(words[:, :, 0] ^ seed)
    value = _mixed(value + words[:, :, 1] * _MIX[0])
    return _mixed(value + words[:, :, 2] * _MIX[1])


def _mixed(value: Words) -> Words:
    """Stafford's variant 13 of the 64-bit finaliser: every input bit reaches every output bit."""
    value = (value ^ (value >> np.uint64(30))) * _MIX[0]
    value = (value ^ (value >> np.uint64(27))) * _MIX[1]
    return np.asarray(value ^ (value >> np.uint64(31)))


def crowded_edges(corners: Floats) -> int:
    """Count undirected edges walked by other than two facets, for a mesh that fits in memory.

    `measure` lets an edge pass that four facets share (a saddle that touches itself); strict slicers do not.
    """
    _, index = welded(corners)
    edges = np.concatenate([index[:, [0, 1]], index[:, [1, 2]], index[:, [2, 0]]])
    edges.sort(axis=1)
    _, times = np.unique(edges[:, 0] * np.int64(index.max() + 1) + edges[:, 1], return_counts=True)
    return int(np.count_nonzero(times != 2))


def vertex_hashes(corners: Floats) -> Words:
    """One 64-bit number for each corner, (k, 3), from the bits of its coordinates; −0 is 0."""
    return _hashed(np.ascontiguousarray(corners + 0.0).view(np.uint64), _SEEDS[0])


def welded(corners: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Corners (t, 3, 3) that agree in all bits made one: vertices (v, 3), and facets (t, 3) of their numbers."""
    flat = corners.reshape(-1, 3) + 0.0
    _, first, index = np.unique(vertex_hashes(corners).ravel(), return_index=True, return_inverse=True)
    if not np.array_equal(
        flat[first][index.ravel()], flat
    ):  # two places of one hash: by the coordinates themselves
        words = np.ascontiguousarray(flat).view([("", np.uint64, 3)]).ravel()
        _, first, index = np.unique(words, return_index=True, return_inverse=True)
    return flat[first], index.reshape(-1, 3).astype(np.int64)
