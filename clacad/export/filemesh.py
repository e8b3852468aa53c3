"""A mesh as a file holds it: nothing is known but triangles, perhaps a unit, names and normals."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CHUNK = 1 << 16
"""Facets handled at a time; 65,536 facets are 4.7 MB of float64 corners."""

ONE_PLACE = np.concatenate([np.eye(3), np.zeros((1, 3))])[None]


class Soup(Protocol):
    """Triangles that are read when they are asked for."""

    def __len__(self) -> int:
        """Number of triangles."""

    def __getitem__(self, which: slice, /) -> NDArray[np.floating]:
        """Corners (k, 3, 3) of a run of triangles."""


@dataclass(frozen=True, eq=False)
class Part:
    """One mesh of a file and the places it is put at.

    Parameters
    ----------
    name : str
        As written in the file, "" when it has none.
    vertices : (v, 3) array or None, file unit
    triangles : (t, 3) int array or None
        Rows of `vertices`, counter-clockwise seen from outside.
    soup : (t, 3, 3) float32 array, or what slices like one, or None
        Corners of each triangle instead of the two above (STL); usually read from the file when sliced.
    normals : (v, 3) array or None
        Unit vertex normals, where the format holds them.
    placements : (m, 4, 3) array
        Affine maps in row-vector form: x' = x @ place[:3] + place[3].
    """

    name: str
    vertices: Floats | None = None
    triangles: Ints | None = None
    soup: Soup | None = None
    normals: Floats | None = None
    placements: Floats = field(default_factory=lambda: ONE_PLACE)

    @property
    def facet_count(self) -> int:
        """Facets of one placement."""
        if self.soup is not None:
            return len(self.soup)
        assert self.triangles is not None
        return len(self.triangles)

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

    def chunks(self, size: int = CHUNK) -> Iterator[Floats]:
        """Corners of all facets of all placements, (k ≤ size, 3, 3) at a time, file unit.

        Small meshes placed many times are expanded many at a time, never all at once.
        """
        count = self.facet_count
        if count == 0:
            return
        if count >= size or len(self.placements) == 1:
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

    Parameters
    ----------
    format : str
        "stl-binary", "stl-ascii", "3mf", "ply", "glb", "obj".
    parts : tuple of Part
    unit : float or None
        Metres per file unit; None when the format does not say.
    name : str
        What the file calls itself (STL header text, 3MF title), "" if nothing.
    """

    format: str
    parts: tuple[Part, ...]
    unit: float | None = None
    name: str = ""

    @property
    def facet_count(self) -> int:
        """Number of facets with every placement counted."""
        return sum(part.facet_count * len(part.placements) for part in self.parts)

    def chunks(self, size: int = CHUNK) -> Iterator[Floats]:
        """Corners of all facets, (k, 3, 3) at a time, file unit; memory does not grow with the file."""
        for part in self.parts:
            yield from part.chunks(size)

    def box(self) -> tuple[Floats, Floats]:
        """Lowest and highest corner, (3,) each, file unit."""
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for corners in self.chunks():
            low = np.minimum(low, corners.min(axis=(0, 1)))
            high = np.maximum(high, corners.max(axis=(0, 1)))
        return low, high


def _placed(corners: Floats, place: Floats) -> Floats:
    if np.array_equal(place, ONE_PLACE[0]):
        return corners
    return np.asarray(corners @ place[:3] + place[3])
