"""Whether triangles close a solid: every directed edge balanced, every edge used exactly twice.

Input is plain triangle corners, as in a file: corners with equal coordinates are one vertex. A mesh of any
size is examined in passes over hash partitions of its edges, so memory is bounded by the partition, not by
the mesh. Edges that the hashes mark as suspicious are decided by their coordinates.

Flux through triangles, which sums to a mesh's volume; the design's is in `clacad.sheet.volume_and_extent`.

Error of the facets against the exact surfaces: slope and sag.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from math import fsum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.arrays import components
from clacad.base.hashing import mixed, point_hashes
from clacad.base.types import Floats, Ints, Words
from clacad.base.vectors import doubled_normals
from clacad.mesh.integer_heights import LENS
from clacad.optics.law.orientation import angle_between
from clacad.sheet.window import Body, Face, lens_height_and_normal

if TYPE_CHECKING:
    from clacad.mesh.prototile import Prototile

Chunks = Callable[[], Iterable[NDArray[Any]]]

_EDGES_A_PASS = 60_000_000  # 0.5 GB of edge hashes
_JOINED_A_PASS = 8_000_000  # with owners and their order: 0.3 GB
_LISTED = 64  # largest number of bad edges in a report


@dataclass(frozen=True, eq=False)
class Health:
    """Result of an examination of a triangle mesh.

    triangles : int
    degenerate : int
        Triangles with two equal corners.
    open_edges : int
        Undirected edges used by one triangle, or by two in the same direction.
    four_face_edges : int
        Undirected edges used by more than two triangles.
    bad_edges : (k, 2, 3)
        Ends of the first bad edges (lengths).
    pieces : int or None
        Number of pieces connected through edges; None if not requested.
    volume : float
        Flux of (0, 0, z) outward (length³); the enclosed volume where closed.
    """

    triangles: int
    degenerate: int
    open_edges: int
    four_face_edges: int
    bad_edges: Floats
    pieces: int | None
    volume: float

    @property
    def closed(self) -> bool:
        """Whether every directed edge has its reverse and is used once, and no triangle is degenerate."""
        return self.triangles > 0 and self.open_edges == self.four_face_edges == self.degenerate == 0

    @property
    def outward(self) -> bool:
        """Whether the triangles are seen counter-clockwise from outside (positive volume)."""
        return self.volume > 0.0


def check_closed(
    source: NDArray[Any] | tuple[NDArray[Any], NDArray[Any]] | Chunks, pieces: bool = True
) -> Health:
    """Examine a triangle mesh.

    Parameters
    ----------
    source : (n, 3, 3) array, or (vertices, triangles), or a function that yields (k, 3, 3) arrays
        The function is called three times or more: once per pass (20 million triangles, or 2.7 million
        where pieces are counted).
    pieces : bool
        Count the connected pieces too (needs 8 bytes more per triangle).

    Returns
    -------
    Health
    """
    chunks = _as_chunks(source)
    count, degenerate, volume = 0, 0, []
    for corners in chunks():
        keys = point_hashes(corners)
        degenerate += int(_degenerate(keys).sum())
        volume.append(_flux(corners))
        count += len(corners)
    passes = max(1, -(-3 * count // (_JOINED_A_PASS if pieces else _EDGES_A_PASS)))
    label = np.arange(count, dtype=np.int64) if pieces else np.empty(0, dtype=np.int64)
    suspicious: list[Words] = []
    for number in range(passes):
        edges, owner = _edges(chunks, number, passes, pieces)
        if pieces:
            label = _join(label, edges, owner)
        edges.sort()
        suspicious.append(_unbalanced(edges))
    doubtful = np.unique(np.concatenate(suspicious))
    once, often, listed = _decide(chunks, doubtful) if len(doubtful) else (0, 0, np.empty((0, 2, 3)))
    found = int(len(np.unique(label))) if pieces else None
    return Health(count, degenerate, once, often, listed, found, fsum(volume))


def _as_chunks(source: NDArray[Any] | tuple[NDArray[Any], NDArray[Any]] | Chunks) -> Chunks:
    """Turn any source into a function that yields blocks of corners."""
    if callable(source):
        return source
    vertices, rows = source if isinstance(source, tuple) else (None, source)

    def blocks() -> Iterator[NDArray[Any]]:
        for start in range(0, len(rows), 1_000_000):
            some = rows[start : start + 1_000_000]
            yield some if vertices is None else vertices[some]

    return blocks


def _degenerate(keys: Words) -> NDArray[np.bool_]:
    return np.asarray((keys[:, 0] == keys[:, 1]) | (keys[:, 1] == keys[:, 2]) | (keys[:, 2] == keys[:, 0]))


def _edge_hashes(keys: Words) -> Words:
    """Hash each triangle's directed edges (t, 3): the last bit is the direction, the rest the edge."""
    a, b = keys, np.roll(keys, -1, axis=1)
    undirected = mixed(mixed(np.minimum(a, b)) + np.maximum(a, b))
    return np.asarray((undirected & ~np.uint64(1)) | (a < b).astype(np.uint64))


def _edges(chunks: Chunks, number: int, passes: int, owners: bool) -> tuple[Words, Ints]:
    """Directed edges of one partition, and the triangle of each."""
    found, owner, start = [], [], 0
    for corners in chunks():
        keys = point_hashes(corners)
        edges = _edge_hashes(keys).ravel()
        keep = np.repeat(~_degenerate(keys), 3)
        if passes > 1:
            # the top bits choose the partition: both directions have the same ones
            keep &= (edges >> np.uint64(40)) % np.uint64(passes) == np.uint64(number)
        found.append(edges[keep])
        if owners:
            owner.append((np.flatnonzero(keep) // 3 + start).astype(np.int64))
        start += len(corners)
    empty = np.empty(0, dtype=np.int64)
    return (np.concatenate(found) if found else empty.astype(np.uint64)), (
        np.concatenate(owner) if owner else empty
    )


def _unbalanced(edges: Words) -> Words:
    """Edges (without direction) of a sorted list that are not used exactly once each way."""
    if len(edges) % 2 == 0 and all(_paired(edges, at) for at in range(0, len(edges), 2_000_000)):
        return np.empty(0, dtype=np.uint64)
    plain = edges >> np.uint64(1)
    first = np.ones(len(edges), dtype=bool)
    first[1:] = plain[1:] != plain[:-1]
    start = np.flatnonzero(first)
    length = np.diff(np.append(start, len(edges)))
    pair = length == 2
    good = np.zeros(len(start), dtype=bool)
    at = start[pair]
    good[pair] = edges[at] != edges[at + 1]
    return np.asarray(plain[start[~good]])


def _paired(edges: Words, start: int) -> bool:
    """Whether a stretch of a sorted list consists of pairs of one edge in both directions, no edge twice."""
    part = edges[start : start + 2_000_002]
    here = part[:2_000_000]
    both = bool(((here[0::2] ^ here[1::2]) == 1).all())
    return both and bool((part[1:-1:2] ^ part[2::2] > 1).all())


def _join(label: Ints, edges: Words, owner: Ints) -> Ints:
    """Join the pieces of triangles that share an edge."""
    plain = edges >> np.uint64(1)
    order = np.argsort(plain, kind="stable")
    same = plain[order[1:]] == plain[order[:-1]]
    one, two = owner[order[:-1][same]], owner[order[1:][same]]
    return np.asarray(components(len(label), np.stack([label[one], label[two]], axis=1))[label])


def _decide(chunks: Chunks, doubtful: Words) -> tuple[int, int, Floats]:
    """Count the doubtful edges by their coordinates: (open, with more than two faces, listed ends)."""
    uses: dict[tuple[bytes, bytes], list[int]] = {}
    for corners in chunks():
        keys = point_hashes(corners)
        edges = _edge_hashes(keys) >> np.uint64(1)
        at, side = np.nonzero(np.isin(edges, doubtful) & ~_degenerate(keys)[:, None])
        real = corners[at].astype(np.float64) + 0.0
        a, b = real[np.arange(len(at)), side], real[np.arange(len(at)), (side + 1) % 3]
        for p, q in zip(a, b):
            pair = (p.tobytes(), q.tobytes())
            forward = pair[0] < pair[1]
            uses.setdefault(pair if forward else pair[::-1], [0, 0])[int(forward)] += 1
    bad = {pair: n for pair, n in uses.items() if n != [1, 1]}
    often = sum(1 for n in bad.values() if sum(n) > 2)
    listed = [[np.frombuffer(end) for end in pair] for pair in list(bad)[:_LISTED]]
    return len(bad) - often, often, np.array(listed).reshape(-1, 2, 3)


def _flux(corners: NDArray[Any]) -> float:
    return (
        fsum(flux(corners.astype(np.float64)).tolist())
        if len(corners) < 100_000
        else float(np.sum(flux(corners.astype(np.float64)), dtype=np.longdouble))
    )


def flux(corners: Floats) -> Floats:
    """Flux of (0, 0, z) through triangles (t, 3, 3): a closed surface's sum is its volume (t,).

    Vertical walls add nothing, and a shift in x, y changes nothing.
    """
    ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray((ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]) * corners[:, :, 2].sum(axis=1) / 6.0)


# edge middles, centroid, and the three inner points of the rule that is exact to degree 2
_EDGES = np.array([(0.5, 0.5, 0.0), (0.0, 0.5, 0.5), (0.5, 0.0, 0.5), (1 / 3, 1 / 3, 1 / 3)])
_INNER = np.array([(2 / 3, 1 / 6, 1 / 6), (1 / 6, 2 / 3, 1 / 6), (1 / 6, 1 / 6, 2 / 3)])


def facet_errors(tile: Prototile, body: Body) -> tuple[float, float]:
    """Slope and sag error of a prototile's optical facets.

    Returns
    -------
    slope : float
        rms angle between facet and exact normal over the facets' area, worse of the two faces (radians).
    sag : float
        Largest normal distance found at edge middles, centroids and inner points (length).
    """
    slopes, sags = [0.0], [0.5 * tile.step]
    for side, face in enumerate((body.front, body.back)):
        chosen = (tile.part[:, side] == LENS) & ~tile.bevelled(side)
        if face.array is None or not chosen.any() or (np.abs(tile.lens[:, side]) >= 2**60).all():
            continue
        slope, sag = _face_errors(tile, face, side, chosen)
        slopes.append(slope)
        sags.append(sag)
    return max(slopes), max(sags)


def _face_errors(tile: Prototile, face: Face, side: int, chosen: NDArray[np.bool_]) -> tuple[float, float]:
    """Rms angle (radians) and largest distance (length) of the chosen facets of one face from its surface."""
    triangles = tile.plan.triangles[chosen]
    corner = np.concatenate(
        [tile.plan.xy[triangles], (tile.lens[triangles, side] * tile.step)[..., None]], axis=2
    )
    cross = doubled_normals(corner)
    area = np.linalg.norm(cross, axis=1)
    flat = area > 0.0
    corner, cross, area = corner[flat], cross[flat], area[flat]
    normal = cross / area[:, None]
    squares = np.zeros(len(area))
    sag = 0.0
    for weights in (*_INNER, *_EDGES):
        at = np.einsum("c,tcd->td", weights, corner)
        z, exact = lens_height_and_normal(face, at[:, 0], at[:, 1])
        sag = max(sag, float(np.nanmax(np.abs(z - at[:, 2]) * exact[:, 2], initial=0.0)))
        if weights.max() == 2 / 3:
            angle = angle_between(normal, exact)
            squares += np.where(np.isnan(angle), 0.0, angle) ** 2 / 3.0
    return float(np.sqrt(np.sum(area * squares) / np.sum(area))), sag
