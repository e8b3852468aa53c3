"""Distance of points of a part from the faces of the design, in any cell, body and side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Ints
from clacad.sheet.window import Face, Window, face_height, lens_height, lens_height_and_normal
from clacad.verification.files.cell_triangles import levels, owner

STEEP = 0.3
"""Facets whose |n_z| is below this belong to walls and edges, not to faces."""

INWARD = 1e-6
"""Least displacement of a corner towards its facet's middle, over that distance, to determine the corner's
cell."""

MOST_INWARD = 0.2
"""Largest such displacement, over the distance to the facet's middle."""

ROOM = 2e-4
"""Displacement in pitches where the facet is large enough.

Fitted poses and coordinates rounded to float32 leave corners on the wrong side of a border; where the border
has a
step, the wrong cell is far off.
"""


def drawn_in(window: Window, inward: Floats, noise: float = 0.0) -> Floats:
    """Displacements (n, 3) that move corners safely over the cell of their own facet.

    inward : (n, 3) lengths
        From each corner to the middle of its facet.
    noise : float, length
        Scatter of the corners.
    """
    length = np.linalg.norm(inward, axis=1, keepdims=True)
    room = max(ROOM * min(window.lattice.pitch), 4.0 * noise)
    share = room / np.where(length > 0.0, length, 1.0)
    return np.asarray(inward * np.clip(share, INWARD, MOST_INWARD))


WIDE = 8.0
"""Least height of a facet over its longest edge, in multiples of the noise, for its direction to be
reliable."""


def believed(corners: Floats, noise: float) -> NDArray[np.bool_]:
    """Which facets (k, 3, 3) are wide enough for a reliable direction despite noise (length)."""
    edges = corners - np.roll(corners, 1, axis=1)
    twice = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    longest = np.sqrt((edges**2).sum(axis=-1).max(axis=1))
    return np.asarray((longest > 0.0) & (twice > WIDE * noise * longest))


@dataclass(frozen=True, eq=False)
class FaceDistance:
    """Distances of points from the faces of a design.

    distance : (n,) lengths
        Along the face's normal, positive above the face (towards +z); NaN where the point is on no face.
    normal : (n, 3)
        Unit normal of the face, towards +z; NaN likewise.
    face : (n,) ints
        Number of the face in the order of the light, −1 for no face.
    cell : (n, 2) ints, local : (n, 2) lengths
        Cell of the face's array and position in it.
    """

    distance: Floats
    normal: Floats
    face: Ints
    cell: Ints
    local: Floats

    @property
    def known(self) -> NDArray[np.bool_]:
        """Mask of the points that were compared."""
        return np.isfinite(self.distance)


def distance_to_faces(
    window: Window,
    points: Floats,
    facing: Floats,
    present: Sequence[str] | None = None,
    between: Floats | None = None,
    aside: Floats | None = None,
) -> FaceDistance:
    """Compare points (n, 3), sheet frame, with the faces that they belong to.

    Parameters
    ----------
    window : Window
    points : (n, 3) lengths
    facing : (n, 3)
        Outward unit normals of the part at the points: they determine the side; steep ones belong to no face.
    present : names of the bodies of the part, or None for all
    between : (bodies − 1,) lengths or None
        Heights midway between the bodies, where they are already known.
    aside : (n, 3) lengths or None
        Displacements with which the points determine the cell, and whether lens or land lies under them. The
        distance is that of the undisplaced points from that lens, extended beyond its border.
    """
    n = len(points)
    found = FaceDistance(
        np.full(n, np.nan),
        np.full((n, 3), np.nan),
        np.full(n, -1),
        np.zeros((n, 2), dtype=np.int64),
        np.zeros((n, 2)),
    )
    held = [k for k, body in enumerate(window.bodies) if present is None or body.name in present]
    body_of = (
        np.full(n, held[0])
        if len(held) == 1
        else np.searchsorted(levels(window) if between is None else between, points[:, 2])
    )
    steep = np.abs(facing[:, 2]) < STEEP
    for number in held:
        body = window.bodies[number]
        for side, face in enumerate((body.front, body.back)):
            mine = ~steep & (body_of == number) & ((facing[:, 2] > 0.0) == bool(side))
            rows = np.flatnonzero(mine)
            if len(rows):
                told = None if aside is None else aside[rows]
                _compare(window, face, owner(body, face), points[rows], told, rows, 2 * number + side, found)
    return found


def _compare(
    window: Window,
    face: Face,
    array: int,
    points: Floats,
    aside: Floats | None,
    rows: Ints,
    number: int,
    found: FaceDistance,
) -> None:
    """Compare points (k, 3) with one face, and write the result into its rows."""
    told = points if aside is None else points + aside
    cell, x, y = window.locate(array, told[:, 0], told[:, 1])
    found.face[rows], found.cell[rows], found.local[rows] = number, cell, np.column_stack([x, y])
    if face.array is None:
        found.distance[rows], found.normal[rows] = points[:, 2] - face.vertex[2], [0.0, 0.0, 1.0]
        return
    places = window.lenses(face, cell)
    height = face_height(window, face, x, y, cell)
    own = places.raised(lens_height(face, *places.seen(x, y)))
    flat = ~(np.abs(height - own) <= 1e-12 * window.lattice.circumradius)
    outside = ~window.lattice.contains(cell)
    if outside.any():  # plain border, or no material
        height = np.where(outside, np.nan if face.land is None else face.land, height)
        flat |= outside
    back = np.zeros((len(points), 2)) if aside is None else aside[:, :2]
    lens, normal = lens_height_and_normal(face, *places.seen(x - back[:, 0], y - back[:, 1]))
    lens = places.raised(lens)
    height = np.where(flat | ~np.isfinite(lens), height, lens)
    normal = np.where(flat[:, None], [0.0, 0.0, 1.0], normal)
    normal[np.isnan(height)] = np.nan
    found.normal[rows] = normal
    found.distance[rows] = (points[:, 2] - height) * normal[:, 2]
