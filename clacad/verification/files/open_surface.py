"""Distinction between a measured surface, which has no volume, and a broken solid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats
from clacad.formats.mesh.closed_stream import welded
from clacad.formats.mesh.file_mesh import FileMesh

SECTORS = 36
"""Number of sectors around the part's middle."""

AROUND = 0.8
"""Least share of sectors in which an open surface has its boundary at the rim."""

AT_RIM = 0.8
"""Distance from the middle, over that to the rim, beyond which a boundary edge lies at the rim."""


@dataclass(frozen=True, eq=False)
class Rims:
    """Edges of a mesh without a second facet.

    count : int
        Directed edges without a partner.
    place : (3,) lengths, file unit
        Middle of one of them; NaN where there are none.
    middles : (count, 3)
        Middles of all of them.
    closed_pieces : int
        Connected pieces without such an edge: closed shells.
    corners : (v, 3)
        All vertices.
    """

    count: int
    place: Floats
    middles: Floats
    closed_pieces: int
    corners: Floats


def rims(mesh: FileMesh) -> Rims:
    """Find the boundary of a mesh, and the number of pieces without a boundary."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    corners, facets = welded(np.concatenate(list(mesh.chunks())))
    start, end = facets.ravel(), np.roll(facets, -1, axis=1).ravel()
    size = np.int64(len(corners))
    same = start == end  # a facet without area has no such edge
    low, high = np.minimum(start, end)[~same], np.maximum(start, end)[~same]
    keys, back = np.unique(low * size + high, return_inverse=True)
    balance = np.bincount(back, np.where((start < end)[~same], 1.0, -1.0))
    open_keys = keys[balance != 0.0]
    links = coo_array((np.ones(len(low), dtype=np.int8), (low, high)), shape=(len(corners), len(corners)))
    number, piece = connected_components(links, directed=False)
    is_open = np.zeros(number, dtype=bool)
    is_open[piece[open_keys // size]] = True
    used = np.zeros(number, dtype=bool)
    used[piece[facets.ravel()]] = True
    middles = 0.5 * (corners[open_keys // size] + corners[open_keys % size])
    count = int(np.abs(balance).sum())
    place = middles[0] if len(middles) else np.full(3, np.nan)
    return Rims(count, place, middles, int((used & ~is_open).sum()), corners)


def is_open_surface(found: Rims, turn: Floats | None = None) -> bool:
    """Whether a mesh is a surface without a volume, such as a scan, rather than an incomplete solid.

    Parameters
    ----------
    found : Rims
    turn : (3, 3) or None
        File → sheet frame: the rim lies around the third axis.

    Notes
    -----
    Facets connected by edges are a piece (union-find over vertices). A piece whose every edge is used once
    in each
    direction is a closed shell. It has a volume, however small, so the file is meant as a solid; any open
    edge next
    to it is a fault. Where no piece is closed, the boundary decides. A measured surface ends at the rim of
    the part:
    seen along the sheet's normal, boundary edges lie at the rim all around it (in four fifths of 36 sectors,
    in the
    outer fifth of the way). A solid without a facet, a patch or a whole side wall has its boundary around
    the gap
    only. A soup whose facets share no corner is open at every edge and also counts as a surface.
    """
    if found.count == 0 or found.closed_pieces:
        return False
    axes = np.eye(3) if turn is None else turn
    flat, edges = found.corners @ axes[:2].T, found.middles @ axes[:2].T
    low, high = flat.min(axis=0), flat.max(axis=0)
    middle, half = 0.5 * (low + high), 0.5 * np.where(high > low, high - low, 1.0)
    reach = _farthest((flat - middle) / half)
    rim = _farthest((edges - middle) / half)
    known = reach > 0.0
    return bool((rim[known] >= AT_RIM * reach[known]).mean() >= AROUND)


def _farthest(points: NDArray[np.float64]) -> Floats:
    """Largest distance from the origin of points (n, 2) in each sector, (SECTORS,)."""
    sector = ((np.arctan2(points[:, 1], points[:, 0]) / (2.0 * np.pi) + 0.5) * SECTORS).astype(np.int64)
    found = np.zeros(SECTORS)
    np.maximum.at(found, np.clip(sector, 0, SECTORS - 1), np.hypot(points[:, 0], points[:, 1]))
    return found
