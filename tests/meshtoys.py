"""Small closed meshes for tests of formats: a wavy block whose volume is known in closed form."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clacad.formats.placements import Piece, Places
from clacad.sheet.lattice import Lattice

Floats = NDArray[np.float64]


def block(
    size: tuple[float, float, float] = (1.0, 1.0, 0.25), steps: int = 4, bump: float = 0.05
) -> tuple[Floats, NDArray[np.int64]]:
    """A block about the origin whose top is raised by bump·(1 − 4u²)(1 − 4v²): vertices, triangles."""
    u = np.linspace(-0.5, 0.5, steps + 1)
    x, y = np.meshgrid(u, u, indexing="ij")
    top = np.stack([size[0] * x, size[1] * y, size[2] + bump * (1 - 4 * x * x) * (1 - 4 * y * y)], axis=-1)
    bottom = np.stack([size[0] * x, size[1] * y, np.zeros_like(x)], axis=-1)
    n = steps + 1
    vertices = np.concatenate([top.reshape(-1, 3), bottom.reshape(-1, 3)])
    at = np.arange(n * n).reshape(n, n)
    faces = []
    for a, b, c, d in zip(at[:-1, :-1].ravel(), at[1:, :-1].ravel(), at[1:, 1:].ravel(), at[:-1, 1:].ravel()):
        faces += [(a, b, c), (a, c, d), (c + n * n, b + n * n, a + n * n), (d + n * n, c + n * n, a + n * n)]
    rim = [*at[:-1, 0], *at[-1, :-1], *at[:0:-1, -1], *at[0, :0:-1]]
    for a, b in zip(rim, rim[1:] + rim[:1]):
        faces += [(a, a + n * n, b + n * n), (a, b + n * n, b)]
    return vertices, np.array(faces, dtype=np.int64)


def piece(name: str = "array1", places: Places | None = None, steps: int = 4) -> Piece:
    """The block as a piece with (made-up but unit) vertex normals."""
    vertices, triangles = block(steps=steps)
    outward = vertices - np.array([0.0, 0.0, 0.1])
    return Piece.of(
        name, vertices, triangles, outward / np.linalg.norm(outward, axis=1, keepdims=True), places
    )


def grid(n1: int, n2: int) -> Places:
    """Places of an n1 by n2 square lattice of pitch 1."""
    return Places(Lattice("square", (1.0, 1.0), (n1, n2)), (0.25, 0.0))


@dataclass
class Stream:
    """A body that yields its facets in chunks, as a tessellated sheet does."""

    name: str
    corners: Floats

    @property
    def facet_count(self) -> int:
        return len(self.corners)

    def rows(self) -> Iterator[Floats]:
        yield from np.array_split(self.corners, 3)


def stream(
    name: str = "array1", steps: int = 4, shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Stream:
    vertices, triangles = block(steps=steps)
    return Stream(name, (vertices + np.array(shift))[triangles])
