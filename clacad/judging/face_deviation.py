"""Deviation of a part's points and facets from the design's faces, and the resulting direction error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from clacad.base.sobol import sobol
from clacad.base.types import Floats, Ints
from clacad.judging.cell_triangles import CellFacets, body_facing, exact_height, levels, owner, telescopelet
from clacad.sheet.face_order import media_of
from clacad.sheet.vignetting import focal_ratio
from clacad.sheet.window import (
    Face,
    Window,
    column,
    face_height,
    heights_and_normals_of_lenses,
    heights_of_lenses,
    lens_height_and_normal,
)
from clacad.tracing.facets.telescopelet import FacetBody, FacetFace, first_crossing, on_land

STEEP = 0.3
"""Facets whose |n_z| is below this belong to walls and edges, not to faces."""

INWARD = 1e-6
"""Least displacement of a corner to its facet's middle, over that distance, to find the corner's cell."""

MOST_INWARD = 0.2
"""Largest such displacement, over the distance to the facet's middle."""

ROOM = 2e-4
"""Displacement in pitches where the facet is large enough.

Fitted poses and coordinates rounded to float32 leave corners on the wrong side of a border; where the border
has a step, the wrong cell is far off.
"""


def drawn_in(window: Window, inward: Floats, noise: float = 0.0) -> Floats:
    """Displacements (n, 3) that move corners safely over the cell of their own facet.

    inward : (n, 3) lengths. From each corner to the middle of its facet.
    noise : length. Scatter of the corners.
    """
    length = np.linalg.norm(inward, axis=1, keepdims=True)
    room = max(ROOM * min(window.lattice.pitch), 4.0 * noise)
    share = room / np.where(length > 0.0, length, 1.0)
    return np.asarray(inward * np.clip(share, INWARD, MOST_INWARD))


WIDE = 8.0
"""Least height of a facet over its longest edge, in multiples of the noise, for a reliable direction."""


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
    normal : (n, 3). Unit normal of the face, towards +z; NaN likewise.
    face : (n,) ints. Number of the face in the order of the light, −1 for no face.
    cell : (n, 2) ints, local : (n, 2) lengths. Cell of the face's array and position in it.
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

    points : (n, 3) lengths
    facing : (n, 3)
        Outward unit normals of the part at the points: they determine the side; steep ones belong to no face.
    present : names of the bodies of the part, or None for all
    between : (3, bodies − 1) lengths or None
        Heights between the bodies from `levels`, where they are already known.
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
    body_of = np.full(n, held[0])
    if len(held) != 1:
        body_of = body_facing(levels(window) if between is None else between, points[:, 2], facing[:, 2])
    steep = np.abs(facing[:, 2]) < STEEP
    for number in held:
        body = window.bodies[number]
        for side, face in enumerate((body.front, body.back)):
            mine = ~steep & (body_of == number) & ((facing[:, 2] > 0.0) == bool(side))
            rows = np.flatnonzero(mine)
            if len(rows):
                told = None if aside is None else aside[rows]
                _compare_points(
                    window, face, owner(body, face), points[rows], told, rows, 2 * number + side, found
                )
    return found


def _compare_points(
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
    own = heights_of_lenses(face, places, x, y)
    flat = ~(np.abs(height - own) <= 1e-12 * window.lattice.circumradius)
    outside = ~window.lattice.contains(cell)
    if outside.any():  # plain border, or no material
        height = np.where(outside, np.nan if face.land is None else face.land, height)
        flat |= outside
    back = np.zeros((len(points), 2)) if aside is None else aside[:, :2]
    lens, normal = heights_and_normals_of_lenses(face, places, x - back[:, 0], y - back[:, 1])
    height = np.where(flat | ~np.isfinite(lens), height, lens)
    normal = np.where(flat[:, None], [0.0, 0.0, 1.0], normal)
    normal[np.isnan(height)] = np.nan
    found.normal[rows] = normal
    found.distance[rows] = (points[:, 2] - height) * normal[:, 2]


POINTS = 8192
"""Points over the middle cell at which facets are compared with the exact faces."""

FEWER = 1024
"""Points over each other cell."""

_ASIDE = np.sqrt([2.0, 3.0]) % 1.0
"""Shift of the points: on a cell's own diagonals, slivers without area would count like facets."""


@dataclass(frozen=True, eq=False)
class Deviation:
    """Deviation of the facets of one telescopelet from the design's faces, in the order of the light.

    slope : (faces, n, 2) slopes along lens x, y. Facet slope minus exact slope at the same n points of the
        cell; NaN where a facet or a lens is missing, 0 for a plane or a face that is not in the file.
    distance : (faces,) lengths. Largest distance along the normal.
    met : (faces,). Share of the points with material where a facet was found.
    """

    slope: Floats
    distance: Floats
    met: Floats

    @property
    def slope_rms(self) -> Floats:
        """(faces,) rms slope error, radians."""
        found = []
        for slope in self.slope:
            known = slope[np.isfinite(slope).all(axis=1)]
            found.append(float(np.sqrt((known**2).sum(axis=1).mean())) if len(known) else np.nan)
        return np.array(found)

    @property
    def complete(self) -> bool:
        """Whether every face has facets over more than 90 % of the cell."""
        return bool((self.met > 0.9).all())


def deviation(window: Window, bodies: tuple[FacetBody, ...], places: int = POINTS) -> Deviation:
    """Compare a telescopelet's facets with the exact faces at `places` points spread evenly over the cell."""
    points = window.lattice.over_cell((sobol(places, 2) + _ASIDE) % 1.0)
    slope, distance, met = [], [], []
    for piece, body in zip(bodies, window.bodies, strict=True):
        for facets, face in ((piece.front, body.front), (piece.back, body.back)):
            if not isinstance(facets, FacetFace):
                slope.append(np.zeros_like(points))
                distance.append(0.0)
                met.append(1.0)
                continue
            turn, off, number = _compare_facets(window, facets, face, points, entering=facets is piece.front)
            front, back = column(window, body, points[:, 0], points[:, 1])
            solid = np.isfinite(front if facets is piece.front else back)
            slope.append(turn)
            distance.append(off)
            met.append(float((number[solid] >= 0).mean()) if solid.any() else 1.0)
    return Deviation(np.array(slope), np.array(distance), np.array(met))


def deviations(window: Window, gathered: CellFacets, present: Sequence[str] | None) -> list[Deviation]:
    """Deviation of the facets of every chosen cell from the exact faces; `present` as for `telescopelet`."""
    return [
        deviation(
            gathered.alike(window, k)[0],
            telescopelet(window, gathered, k, present),
            FEWER if k else POINTS,
        )
        for k in range(len(gathered.cells))
    ]


def _compare_facets(
    window: Window, facets: FacetFace, face: Face, points: Floats, entering: bool
) -> tuple[Floats, float, Ints]:
    """Slope error (n, 2), largest distance, and the facet over each point, found by vertical rays."""
    below = facets.origin[2] + facets.z_range[0] - np.ptp(facets.z_range) - window.lattice.circumradius
    start = np.column_stack([points + facets.origin[:2], np.full(len(points), below)])
    height, number = first_crossing(facets, start, np.broadcast_to([0.0, 0.0, 1.0], start.shape), entering)
    if not (number >= 0).any():
        return np.full_like(points, np.nan), np.nan, number
    here = np.column_stack([points, start[:, 2] + height])
    flat = facets.land[number] & (number >= 0)
    off = np.abs(here[:, 2] - exact_height(face, flat, points[:, None])[:, 0])
    if face.array is None:
        return np.zeros_like(points), float(np.nanmax(off)), number
    _, normal = lens_height_and_normal(face, points[:, 0], points[:, 1])
    way = facets.normals[number]
    turn = (-way[:, :2] / way[:, 2:] + normal[:, :2] / normal[:, 2:]) @ face.rotation[:2, :2]
    turn[flat | (number < 0)] = np.nan
    off = off * np.where(flat, 1.0, normal[:, 2])
    known = np.isfinite(off)
    return turn, float(off[known].max()) if known.any() else np.nan, number


def forecast_rms(window: Window, found: Deviation) -> float:
    """Direction error (radians) that the facets' slope errors cause.

    A lens deflects light by (n − 1) times the slope of its thickness. The errors of its two faces at one
    place are therefore added before they are squared (they agree where both faces have the same facets). The
    error of lens 1 leaves the pair as 1/m per meridian.
    """
    ratio = np.array(focal_ratio(window.thin))
    turns: dict[int, Floats] = {}
    media = media_of(window.bodies)
    for number, face in enumerate(window.faces):
        if face.array is not None:
            error = (media[number] - media[number + 1]) * found.slope[number]
            turns[face.array] = turns.get(face.array, 0.0) + error
    total = 0.0
    for array, turn in turns.items():
        known = np.isfinite(turn).all(axis=1)
        if not known.any():
            return float("nan")
        # light is at a focus on a field lens (2): a deflection there does not change its exit direction
        gain = (1.0 / ratio, np.ones(2), np.zeros(2))[array]
        total += float(((turn[known] * gain) ** 2).sum(axis=1).mean())
    return sqrt(total)


def corner_distance(window: Window, face: Face, corners: Floats, place: Floats) -> float:
    """Largest distance (length) of facet corners (k, 3, 3) from the design's face, cell at `place`."""
    local = corners - [*place, 0.0]
    flat = on_land(window, face, corners)
    off = np.abs(local[..., 2] - exact_height(face, flat, local))
    if face.array is not None:
        _, normal = lens_height_and_normal(face, local[..., 0].ravel(), local[..., 1].ravel())
        off = off * np.where(flat[:, None], 1.0, normal[:, 2].reshape(off.shape))
    known = np.isfinite(off)
    return float(off[known].max()) if known.any() else float("nan")
