"""Whether a stream of triangles is closed, decided in one pass and a few bytes of memory.

Every facet has three directed edges. A surface is closed and consistently wound when each edge is traversed
as often forwards as backwards. Two independent 64-bit hashes of the undirected edge are added for one sense
and subtracted for the other. The sums vanish for a closed surface, and for anything else only with
probability 2^-128. A facet left out, turned over or moved by one bit is detected.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from clacad.base.types import Floats, Ints, Words


@dataclass(frozen=True, slots=True)
class Measure:
    """Results of one pass over a mesh.

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
        """Whether every edge is traversed as often forwards as backwards."""
        return self.facets > 0 and self.imbalance == (0, 0)


def measure(chunks: Iterable[Floats], origin: Floats | None = None) -> Measure:
    """Measure a mesh given as chunks of corners (k, 3, 3).

    Parameters
    ----------
    chunks : iterable of (k, 3, 3) arrays
    origin : (3,) array or None
        Point the volume's cones start from; a point near the mesh keeps digits. Default: its first corner.

    Notes
    -----
    Corners are one vertex when all bits of their float64 coordinates agree (−0 is 0). The volume is the
    divergence sum of det(a, b, c)/6. The rounding errors of that sum and of the area's are kept in addition.
    """
    from clacad.formats.mesh.compiled_measure import AREA, VOLUME, add_facets

    facets = 0
    sums, totals = np.zeros(2, dtype=np.uint64), np.zeros(4)
    box = np.array([[np.inf] * 3, [-np.inf] * 3])
    for corners in chunks:
        if not len(corners):
            continue
        if origin is None:
            origin = corners[0, 0].copy()
        facets += len(corners)
        whole = np.ascontiguousarray(corners)
        add_facets(whole, whole.view(np.uint64), np.asarray(origin, dtype=np.float64), sums, totals, box)
    if np.isnan(totals[VOLUME]):  # a corner that is no number has no position
        box[:] = np.nan
    volume, area = (float(totals[k] + totals[k + 1]) for k in (VOLUME, AREA))
    bottom, top = ((float(corner[0]), float(corner[1]), float(corner[2])) for corner in box)
    return Measure(facets, (int(sums[0]), int(sums[1])), volume / 6.0, 0.5 * area, bottom, top)


def crowded_edges(times: Ints) -> int:
    """Count undirected edges traversed by other than two facets, from the result of `edge_times`.

    `measure` accepts an edge that four facets share (a saddle that touches itself); strict slicers do not.
    """
    return int(np.count_nonzero(times != 2))


def edge_times(facets: Ints) -> Ints:
    """Number of the facets (t, 3), given by numbers of vertices, that traverse each undirected edge, (e,)."""
    if not len(facets):
        return np.zeros(0, dtype=np.int64)
    start, end = facets.ravel(), facets[:, [1, 2, 0]].ravel()
    edges = np.minimum(start, end) * np.int64(facets.max() + 1) + np.maximum(start, end)
    edges.sort()
    last = np.append(np.flatnonzero(edges[1:] != edges[:-1]), len(edges) - 1)
    return np.diff(last, prepend=-1)


def vertex_hashes(corners: Floats) -> Words:
    """One 64-bit number for each corner, (k, 3), from the bits of its coordinates; −0 is 0."""
    from clacad.formats.mesh.compiled_measure import hash_corners

    found = np.empty(corners.shape[:2], dtype=np.uint64)
    hash_corners(np.ascontiguousarray(corners, dtype=np.float64).view(np.uint64), found)
    return found
