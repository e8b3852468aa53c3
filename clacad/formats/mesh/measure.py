"""Measure of a stream of triangles in one pass: whether it is closed, its volume, area and box; its vertices.

Every facet has three directed edges. A surface is closed and consistently wound when each edge is traversed
as often forwards as backwards. Two independent 64-bit hashes of the undirected edge are added for one sense
and subtracted for the other. The sums vanish for a closed surface, and for anything else only with
probability 2^-128. A facet left out, turned over or moved by one bit is detected. A repeated part of a file
is measured once per orientation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import fsum
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Bools, Floats, Ints, Words
from clacad.formats.mesh.file_mesh import CHUNK, FileMesh, Part, kinds_and_ends, listed, shared_chunks

if TYPE_CHECKING:
    from clacad.formats.mesh.compiled_measure import VertexTable


@dataclass(frozen=True, slots=True)
class Measure:
    """Results of one pass over a mesh.

    imbalance : (int, int). Hash sums over directed edges; (0, 0) for a closed, consistently wound surface.
    volume : Enclosed volume, file unit³ (positive when facets are wound counter-clockwise from outside).
    area : File unit².
    low, high : (3,) tuples. Corners of the bounding box.
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


Corners = tuple[Floats, Ints]
"""Points (n, 3) and facets (k, 3), given by rows of these."""


def measure(chunks: Iterable[Floats | Corners], origin: Floats | None = None) -> Measure:
    """Measure a mesh given as chunks of corners (k, 3, 3), or of points and facets.

    origin : (3,) array or None
        Point the volume's cones start from; a point near the mesh keeps digits. Default: its first corner.

    Notes
    -----
    Corners are one vertex when all bits of their float64 coordinates agree (−0 is 0). The volume is the
    divergence sum of det(a, b, c)/6. The rounding errors of that sum and of the area's are kept in addition.
    """
    from clacad.formats.mesh.compiled_measure import AREA, VOLUME, add_facets

    count = 0
    sums, totals = np.zeros(2, dtype=np.uint64), np.zeros(4)
    box = np.array([[np.inf] * 3, [-np.inf] * 3])
    for chunk in chunks:
        points, facets = chunk if isinstance(chunk, tuple) else listed(chunk)
        if not len(facets):
            continue
        if origin is None:
            origin = points[facets[0, 0]].copy()
        count += len(facets)
        points, facets = np.ascontiguousarray(points), np.ascontiguousarray(facets, dtype=np.int64)
        hashes = np.empty((len(points), 2), dtype=np.uint64)
        middle = np.asarray(origin, dtype=np.float64)
        add_facets(points, _words(points), facets, hashes, middle, sums, totals, box)
    if np.isnan(totals[VOLUME]):  # a corner that is no number has no position
        box[:] = np.nan
    volume, area = (float(totals[k] + totals[k + 1]) for k in (VOLUME, AREA))
    return Measure(count, (int(sums[0]), int(sums[1])), volume / 6.0, 0.5 * area, *map(_triple, box))


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
    from clacad.formats.mesh.compiled_measure import hash_points

    points = np.ascontiguousarray(corners, dtype=np.float64).reshape(-1, 3)
    found = np.empty(len(points), dtype=np.uint64)
    hash_points(_words(points), found)
    return found.reshape(-1, 3)


MOST_KINDS = 16
"""Largest number of orientations and scales of one part that are measured; a sheet needs one."""


def measure_mesh(
    mesh: FileMesh, factor: float, passing: Callable[[Floats, Ints], object] = lambda *_: None
) -> Measure:
    """Measure a file in design units; a repeated part is measured once per orientation.

    factor : Design units per file unit.
    passing : Receives the facets of the unrepeated parts: points (n, 3), file unit, and rows of them (k, 3).
    """
    single = [part for part in mesh.parts if not part.repeated]

    def chunks() -> Iterator[Corners]:
        for part in single:
            for points, facets in shared_chunks(part):
                passing(points, facets)
                yield points if factor == 1.0 else points * factor, facets

    return joined([measure(chunks(), origin=np.zeros(3)), measure_repeated(mesh, factor)])


def measure_repeated(mesh: FileMesh, factor: float) -> Measure:
    """Measure the repeated parts; the result is closed if each of them is closed by itself.

    Parts that share one list of places are one object, as a GLB mesh of several primitives is.
    """
    found = []
    for parts in objects(mesh):
        imbalance = [0, 0]
        for part in parts:
            for one in _measures(part, factor):
                imbalance = [(a + b) % (1 << 64) for a, b in zip(imbalance, one.imbalance, strict=True)]
                found.append(replace(one, imbalance=(0, 0)))
        found.append(Measure(0, (imbalance[0], imbalance[1]), 0.0, 0.0, (np.inf,) * 3, (-np.inf,) * 3))
    # an open object is not closed by another with the opposite gap
    gaps = (one.imbalance for one in found if one.imbalance != (0, 0))
    whole = joined([replace(one, imbalance=(0, 0)) for one in found])
    return replace(whole, imbalance=next(gaps, (0, 0)))


def objects(mesh: FileMesh) -> list[list[Part]]:
    """Repeated parts, grouped by identical lists of places."""
    found: dict[int, list[Part]] = {}
    for part in mesh.parts:
        if part.repeated:
            found.setdefault(id(part.places), []).append(part)
    return list(found.values())


def joined(measures: Sequence[Measure]) -> Measure:
    """Combined measures of several meshes."""
    if not measures:
        return measure(())
    low = np.min([one.low for one in measures], axis=0)
    high = np.max([one.high for one in measures], axis=0)
    sums = [sum(one.imbalance[k] for one in measures) % (1 << 64) for k in (0, 1)]
    return Measure(
        sum(one.facets for one in measures),
        (sums[0], sums[1]),
        fsum(one.volume for one in measures),
        fsum(one.area for one in measures),
        _triple(low),
        _triple(high),
    )


def _measures(part: Part, factor: float) -> Iterator[Measure]:
    """Measure a part for each orientation, times the number of its places in that orientation."""
    for number, (linear, times, first, last) in enumerate(kinds_and_ends(part)):
        if number == MOST_KINDS:  # too many orientations: the comparison of its places fails anyway
            break
        turn = linear * factor
        one = measure(
            (part.corners(k, k + CHUNK) @ turn for k in range(0, part.facet_count, CHUNK)), origin=np.zeros(3)
        )
        low, high = (_triple(end + move * factor) for end, move in ((one.low, first), (one.high, last)))
        facets, volume, area = one.facets * times, one.volume * times, one.area * times
        yield Measure(facets, one.imbalance, volume, area, low, high)


def _triple(values: Floats) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])


# -- shared vertices ---------------------------------------------------------------------------
FULLEST = 0.5
"""Largest used share of a table."""


def _table(places: int, columns: int) -> VertexTable:
    """Empty table with room for a number of places, or more."""
    from clacad.formats.mesh.compiled_measure import FREE, VertexTable

    size = 1 << max(4, (places - 1).bit_length())
    return VertexTable(np.empty((size, columns), dtype=np.uint64), np.full(size, FREE, dtype=np.int64))


class Welder:
    """Shared vertices of triangles that come block by block, numbered in the order they come.

    Vertices are equal where all bits of their numbers agree; −0 is 0. Only those of the last blocks are kept,
    by generations that the caller begins, and those that it names beforehand: memory is that of two
    generations, for any number of triangles.

    count : Number of distinct vertices.
    """

    def __init__(self, named: Floats) -> None:
        """Begin without vertices; `named` (n, c): those that are kept to the end."""
        from clacad.formats.mesh.compiled_measure import name_vertices

        self.count, self._columns = 0, named.shape[1]
        self._recent = self._older = _table(0, self._columns)
        self._used = 0
        self._always = _table(int(len(named) / FULLEST) + 1, self._columns)
        name_vertices(_words(named), self._always)

    def begin(self) -> None:
        """Begin a generation; the vertices of the last one are kept, those before it are not."""
        self._older, self._used = self._recent, 0
        self._recent = _table(len(self._older.number), self._columns)

    def numbers(
        self, rows: Floats, normals: Floats | None = None, places: CornerPlaces | None = None
    ) -> tuple[Ints, Ints]:
        """Number (n,) of each vertex (n, c), and the rows (k,) of those that are new, in order.

        normals : (n, 3) or None. Numbers of the vertices besides `rows`.
        places : Where the corners lie in cells, whose inner vertices are kept in their cell only.
        """
        from clacad.formats.mesh.compiled_measure import CellCorners, move_vertices, number_vertices

        smooth = np.empty((len(rows), 0)) if normals is None else normals
        numbers, fresh = (np.empty(len(rows), dtype=np.int64) for _ in range(2))
        start, points, inner = places or (np.array([0, len(rows)]), *_NOWHERE)
        last, before = np.full(len(inner), -1, dtype=np.int64), np.empty(len(points), dtype=np.int64)
        cells = CellCorners(start, points, inner, last, before)
        row = found = 0
        while True:
            tables, counts = (self._recent, self._older, self._always), (row, self.count, found, self._used)
            row, found, self._used = number_vertices(
                _words(rows), _words(smooth), cells, tables, counts, numbers, fresh
            )
            if row == len(rows):
                break
            larger = _table(2 * len(self._recent.number), self._columns)
            move_vertices(self._recent, larger)
            self._recent = larger
        self.count += found
        return numbers, fresh[:found]


CornerPlaces = tuple[Ints, Ints, Bools]
"""First corner of each cell of a block (cells + 1,); point of the footprint of each corner (n,), −1 where it
is not known; whether a point lies inside the cell (p,)."""

_NOWHERE = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.bool_)


def _words(rows: Floats) -> Words:
    return np.ascontiguousarray(rows).view(np.uint64)
