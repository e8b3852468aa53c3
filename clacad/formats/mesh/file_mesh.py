"""A mesh as a file contains it: triangles, possibly a unit, names and normals."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from clacad.base.arrays import distinct, welded
from clacad.base.types import Bools, Floats, Ints
from clacad.formats.placements import ALONE, Placements
from clacad.storage.errors import UnreadableFile

CHUNK = 1 << 16
"""Facets handled at a time; 65,536 facets are 4.7 MB of float64 corners."""

SHARED = 1 << 18
"""Facets of shared vertices handled at a time."""

MOST_EXPANDED = 100_000_000
"""Facets up to which a file that repeats its parts may be walked as if each of them were written out."""

ONE_PLACE = np.concatenate([np.eye(3), np.zeros((1, 3))])[None]


def put(places: Floats) -> Placements:
    """Placements from affine maps (m, 4, 3) in row-vector form."""
    return Placements(np.swapaxes(places, 1, 2))


class Soup(Protocol):
    """Triangles that are read on demand."""

    def __len__(self) -> int:
        """Number of triangles."""

    def __getitem__(self, which: slice, /) -> NDArray[np.floating]:
        """Corners (k, 3, 3) of a run of triangles."""


@dataclass(frozen=True, slots=True)
class FileRows:
    """Rows of numbers in a file, read from it on each access; memory is that of the rows.

    path : File.
    start : Byte of the first row.
    kind : Type of a row.
    count : Number of rows.
    column : Name of the numbers of a row that are used, where `kind` has names.
    """

    path: Path
    start: int
    kind: np.dtype[Any]
    count: int
    column: str | None = None

    def __len__(self) -> int:
        """Number of rows."""
        return self.count

    def __getitem__(self, which: slice | Ints, /) -> NDArray[Any]:
        """Rows of a run, or those of chosen numbers, in the shape of the numbers.

        Raises UnreadableFile: The file was cut since.
        """
        if isinstance(which, slice):
            start, stop, step = which.indices(self.count)
            return self._read(start, max(start, stop))[::step]
        if not which.size:
            return self._read(0, 0)[which.astype(np.int64)]
        low, high = int(which.min()), int(which.max()) + 1
        if high - low <= 4 * which.size + CHUNK:
            return self._read(low, high)[which - low]
        run, some = which // CHUNK, self._read(0, 0)
        found = np.empty((*which.shape, *some.shape[1:]), dtype=some.dtype)
        for k in distinct(run.ravel()).tolist():
            mine = run == k
            found[mine] = self._read(k * CHUNK, min((k + 1) * CHUNK, self.count))[which[mine] - k * CHUNK]
        return found

    def _read(self, start: int, stop: int) -> NDArray[Any]:
        with self.path.open("rb") as stream:
            stream.seek(self.start + start * self.kind.itemsize)
            block = stream.read((stop - start) * self.kind.itemsize)
        if len(block) != (stop - start) * self.kind.itemsize:
            raise UnreadableFile(f"{self.path.name}: it ends before row {stop:,}")
        rows = np.frombuffer(block, dtype=self.kind)
        return rows if self.column is None else rows[self.column]


HELD = 1 << 24
"""Bytes of an array up to which it is read once and held."""


def rows_of(rows: FileRows) -> FileRows | NDArray[Any]:
    """The same rows, in memory if they are few."""
    return rows[:] if rows.count * rows.kind.itemsize <= HELD else rows


NO_NUMBER, NO_VERTEX = "a vertex that is not a number", "a triangle that uses a vertex that is not there"
"""Faults of the numbers of a mesh."""


def fault_of(vertices: Table, triangles: Table, normals: Table | None = None) -> str | None:
    """What is wrong with the numbers of a mesh, a noun; None where nothing is."""
    if any(
        not np.isfinite(rows[first : first + CHUNK]).all()
        for rows in (vertices, *(() if normals is None else (normals,)))
        for first in range(0, len(rows), CHUNK)
    ):
        return NO_NUMBER
    for first in range(0, len(triangles), CHUNK):
        some = triangles[first : first + CHUNK]
        if some.min() < 0 or some.max() >= len(vertices):
            return NO_VERTEX
    return None


Table = FileRows | NDArray[Any]


@dataclass(frozen=True, eq=False)
class Part:
    """One mesh of a file and its placements.

    name : As written in the file, "" where there is none.
    vertices : (v, 3) array, rows of the file, or None, file unit
    triangles : (t, 3) ints or None. Rows of `vertices`, counter-clockwise seen from outside.
    soup : (t, 3, 3) float32 array, or an object that slices like one, or None
        Corners of each triangle instead of the two above (STL); usually read from the file when sliced.
    normals : (v, 3) or None. Unit vertex normals, where the format has them.
    places : Placements of the mesh in the file.
    """

    name: str
    vertices: Table | None = None
    triangles: Table | None = None
    soup: Soup | None = None
    normals: Table | None = None
    places: Placements = field(default_factory=lambda: Placements(ALONE))

    @cached_property
    def placements(self) -> Floats:
        """All placements (m, 4, 3) as affine maps in row-vector form: x' = x @ place[:3] + place[3].

        Raises UnreadableFile: There are too many to be written out.
        """
        return np.ascontiguousarray(np.swapaxes(self.places.all(), 1, 2))

    def placed_at(self, numbers: Ints) -> Floats:
        """Selected placements, (k, 4, 3)."""
        return np.ascontiguousarray(np.swapaxes(self.places.at(numbers), 1, 2))

    @property
    def facet_count(self) -> int:
        """Facets of one placement."""
        if self.soup is not None:
            return len(self.soup)
        assert self.triangles is not None
        return len(self.triangles)

    @property
    def repeated(self) -> bool:
        """Whether it has more than one placement."""
        return len(self.places) > 1

    def corners(self, start: int, stop: int) -> Floats:
        """Corners of facets start … stop − 1 before placing, (k, 3, 3), file unit."""
        if self.soup is not None:
            return np.asarray(self.soup[start:stop], dtype=np.float64)
        assert self.vertices is not None
        assert self.triangles is not None
        return np.asarray(self.vertices[self.triangles[start:stop]], dtype=np.float64)

    def corner_normals(self, start: int, stop: int) -> Floats | None:
        """Vertex normals at the corners of facets start … stop − 1, (k, 3, 3), or None."""
        if self.normals is None:
            return None
        assert self.triangles is not None
        return np.asarray(self.normals[self.triangles[start:stop]], dtype=np.float64)

    def picked(self, facets: Ints) -> Floats:
        """Corners of chosen facets before placing, (k, 3, 3), file unit."""
        if self.soup is None:
            assert self.vertices is not None
            assert self.triangles is not None
            return np.asarray(self.vertices[self.triangles[facets]], dtype=np.float64)
        found = np.empty((len(facets), 3, 3))
        run = facets // CHUNK
        for k in np.unique(run):
            mine = run == k
            found[mine] = self.corners(int(k) * CHUNK, (int(k) + 1) * CHUNK)[facets[mine] - k * CHUNK]
        return found

    def welded(self) -> tuple[Floats, Ints]:
        """Vertices (v, 3) of its facets before placing, equal ones merged, and facets (t, 3) by number."""
        if self.soup is not None:
            return welded(self.corners(0, self.facet_count))
        assert self.vertices is not None
        assert self.triangles is not None
        used = self._used()
        vertices, index = welded(np.asarray(self.vertices[np.flatnonzero(used)], dtype=np.float64))
        return vertices, index[(np.cumsum(used) - 1)[self.triangles[:]]]

    def _used(self) -> Bools:
        """Which of its vertices (v,) are corners of facets."""
        assert self.vertices is not None
        assert self.triangles is not None
        used = np.zeros(len(self.vertices), dtype=np.bool_)
        for start in range(0, len(self.triangles), CHUNK):
            used[self.triangles[start : start + CHUNK]] = True
        return used

    def own_box(self) -> tuple[Floats, Floats]:
        """Lowest and highest corner of its facets before placing, (3,) each."""
        return _box_of(self._corners_used())

    def _corners_used(self) -> Iterator[Floats]:
        """Corners (k, 3) of its facets before placing; those that facets share come once."""
        if self.soup is None and self.facet_count:
            assert self.vertices is not None
            used = self._used()
            for start in range(0, len(used), CHUNK):
                corners = np.asarray(self.vertices[start : start + CHUNK], dtype=np.float64)
                yield corners[used[start : start + CHUNK]]
            return
        for start in range(0, self.facet_count, CHUNK):
            yield self.corners(start, start + CHUNK).reshape(-1, 3)

    def pairs(self, size: int = CHUNK) -> Iterator[tuple[Floats, Floats | None]]:
        """Chunks as of `chunks`, with the unit normals (k, 3, 3) stored for their corners, or None."""
        if self.normals is None:
            yield from ((corners, None) for corners in self.chunks(size))
            return
        for place in self.placements:
            yield from self.pairs_at(place, size)

    def pairs_at(self, place: Floats, size: int = CHUNK) -> Iterator[tuple[Floats, Floats | None]]:
        """Corners and stored normals, both (k, 3, 3), of the facets at one placement (4, 3)."""
        for start in range(0, self.facet_count, size):
            stop = min(start + size, self.facet_count)
            normals = self.corner_normals(start, stop)
            if normals is not None:
                normals = turned_normals(normals, place)
            yield _placed(self.corners(start, stop), place), normals

    def chunks(self, size: int = CHUNK) -> Iterator[Floats]:
        """Corners of all facets of all placements, (k ≤ size, 3, 3) at a time, file unit.

        Small meshes with many placements are expanded many at a time, never all at once.
        """
        count = self.facet_count
        if count == 0:
            return
        if count >= size or not self.repeated:
            for place in self.placements:
                for start in range(0, count, size):
                    yield _placed(self.corners(start, min(start + size, count)), place)
            return
        corners = self.corners(0, count)
        together = max(1, size // count)
        for first in range(0, len(self.placements), together):
            places = self.placements[first : first + together]
            moved = np.einsum("tcx,pxy->ptcy", corners, places[:, :3]) + places[:, None, None, 3]
            yield moved.reshape(-1, 3, 3)


@dataclass(frozen=True, eq=False)
class FileMesh:
    """A mesh file that was read.

    format : "stl-binary", "stl-ascii", "3mf", "ply", "glb", "obj".
    unit : Metres per file unit; None when the format does not define it.
    name : Name in the file (STL header text, 3MF title), "" if there is none.
    """

    format: str
    parts: tuple[Part, ...]
    unit: float | None = None
    name: str = ""

    @property
    def facet_count(self) -> int:
        """Number of facets with every placement counted."""
        return sum(part.facet_count * len(part.places) for part in self.parts)

    @property
    def stored_count(self) -> int:
        """Number of facets that are written in the file, each part once."""
        return sum(part.facet_count for part in self.parts)

    @property
    def expandable(self) -> bool:
        """Whether its facets are few enough to visit all at every placement; true without repeats."""
        return self.facet_count <= max(MOST_EXPANDED, self.stored_count)

    def chunks(self, size: int = CHUNK) -> Iterator[Floats]:
        """Corners of all facets, (k, 3, 3) at a time, file unit; memory does not grow with the file.

        Raises UnreadableFile: Its repeated parts represent more facets than MOST_EXPANDED: examine each part
            once.
        """
        for part in self._expanded():
            yield from part.chunks(size)

    def pairs(self, size: int = CHUNK) -> Iterator[tuple[Floats, Floats | None]]:
        """The chunks of `chunks`, each with the normals (k, 3, 3) stored for its corners, or None."""
        for part in self._expanded():
            yield from part.pairs(size)

    def _expanded(self) -> tuple[Part, ...]:
        if not self.expandable:
            raise UnreadableFile(f"its parts represent {self.facet_count} facets, more than {MOST_EXPANDED}")
        return self.parts

    def box(self) -> tuple[Floats, Floats]:
        """Lowest and highest corner, (3,) each, file unit."""
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for part in self.parts:
            for linear, _, first, last in kinds_and_ends(part):
                plain = np.array_equal(linear, np.eye(3))
                chunks = (part.corners(k, k + CHUNK) for k in range(0, part.facet_count, CHUNK))
                least, most = _box_of((c if plain else c @ linear).reshape(-1, 3) for c in chunks)
                low, high = np.minimum(low, least + first), np.maximum(high, most + last)
        return low, high


def shared_chunks(part: Part) -> Iterator[tuple[Floats, Ints]]:
    """Facets (k, 3) of all placements of a part, in runs, as rows of points (n, 3), file unit."""
    size = CHUNK if part.soup is not None else SHARED
    for place in part.placements:
        for start in range(0, part.facet_count, size):
            points, facets = _shared(part, start, min(start + size, part.facet_count))
            yield _placed(points, place), facets


def _shared(part: Part, start: int, stop: int) -> tuple[Floats, Ints]:
    """Facets start … stop − 1 before placing, as rows of points that they share where these are near."""
    if part.soup is not None:
        return listed(part.corners(start, stop))
    assert part.vertices is not None
    assert part.triangles is not None
    facets = np.asarray(part.triangles[start:stop], dtype=np.int64)
    low, high = int(facets.min()), int(facets.max()) + 1
    if high - low > 3 * facets.size:
        return listed(np.asarray(part.vertices[facets], dtype=np.float64))
    return np.asarray(part.vertices[low:high], dtype=np.float64), facets - low


def listed(corners: Floats) -> tuple[Floats, Ints]:
    """Corners (k, 3, 3) as points (3 k, 3), and the rows of each facet (k, 3) among them."""
    return corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)


def _box_of(chunks: Iterable[Floats]) -> tuple[Floats, Floats]:
    """Lowest and highest corner, (3,) each, of points (k, 3) that come some at a time."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for points in chunks:
        low = np.minimum(low, points.min(axis=0, initial=np.inf))
        high = np.maximum(high, points.max(axis=0, initial=-np.inf))
    return low, high


def kinds(part: Part) -> list[tuple[Floats, Ints]]:
    """Group placements of a part by rotation and scale: linear map (3, 3), row numbers; commonest first."""
    linear = part.placements[:, :3].reshape(-1, 9)
    if (linear == linear[0]).all():
        return [(linear[0].reshape(3, 3), np.arange(len(linear)))]
    size = np.abs(linear).max(initial=1e-300)
    _, first, which, times = np.unique(
        np.round(linear / size, 12) + 0.0, axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    order = np.argsort(-times, kind="stable")
    rows = np.argsort(which.ravel(), kind="stable")
    ends = np.cumsum(times)
    return [(linear[first[k]].reshape(3, 3), rows[ends[k] - times[k] : ends[k]]) for k in order]


def kinds_and_ends(part: Part) -> list[tuple[Floats, int, Floats, Floats]]:
    """Groups as of `kinds` with counts, least and greatest moves (3,) of each; rows are not written out."""
    if part.places.in_rows:
        return [(np.eye(3), len(part.places), low, high) for _, low, high in part.places.ends()]
    moves = [(linear, part.placements[rows, 3]) for linear, rows in kinds(part)]
    return [(linear, len(move), move.min(axis=0), move.max(axis=0)) for linear, move in moves]


def turned_normals(normals: Floats, place: Floats) -> Floats:
    """Normals (k, 3, 3) of a part after placing; unit normals stay unit."""
    linear = place[:3]
    size = abs(float(np.linalg.det(linear)))
    if size == 0.0:
        return np.full_like(normals, np.nan)
    if np.array_equal(linear, np.eye(3)):
        return normals
    return np.asarray(normals @ (np.linalg.inv(linear).T * size ** (1.0 / 3.0)))


def _placed(corners: Floats, place: Floats) -> Floats:
    if np.array_equal(place, ONE_PLACE[0]):
        return corners
    return np.asarray(corners @ place[:3] + place[3])
