"""Light through the triangles of a file themselves, one telescopelet at a time, in double precision.

A file is known here only as triangles. Those over one cell are gathered. In each body rays meet the first
facet that faces outward against them, then the first that faces outward along them. Walls (facets nearly
parallel to z) let nothing through. Nothing of the mesher or of the exact surfaces is used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Bools, Bytes, Floats, Ints, Rows
from clacad.optics.rays import NO_CELL, Fate, Rays, TraceResult
from clacad.optics.surface import meet, refract
from clacad.sheet.window import Face, Window, in_optical_tile
from clacad.tracing.sampled_face import SampledFace, meet_sampled
from clacad.tracing.triangles.hierarchy import Hierarchy, hierarchy


@dataclass(frozen=True, eq=False)
class FacetFace:
    """The facets of one side of one body over one cell, in a tree of boxes.

    trees : Hierarchy or None
        One body: the facets `trees.corner` (t, 3, 3), lengths relative to `origin`, wound counter-clockwise
        seen from
        outside.
    normals : (t, 3)
        Outward, length twice the facet's area.
    origin : (3,) lengths
        Sheet frame.
    z_range : (low, high), lengths, relative to origin
    land : (t,) bool
        Facets that are flat land: light through them is not lens light.
    """

    trees: Hierarchy | None
    normals: Floats
    origin: Floats
    z_range: tuple[float, float]
    land: Bools


@dataclass(frozen=True, eq=False)
class ExactFace:
    """A face of the design in place of facets, where a file contains only one of two bodies.

    face : Face
    origin : (3,) lengths
        Centre of the face's cell in the sheet frame, z = 0.
    window : Window or None
        Window whose optical zone ends the face; None: it continues.
    """

    face: Face
    origin: Floats
    window: Window | None = None


AnyFace = FacetFace | ExactFace | SampledFace


@dataclass(frozen=True, eq=False)
class FacetBody:
    """Front and back of one body over one cell, and its refractive index."""

    front: AnyFace
    back: AnyFace
    index: float


def facet_face(corners: Floats, origin: Floats, land: Bools | None = None) -> FacetFace:
    """Prepare facets (t, 3, 3), given in the sheet frame, about `origin` (3,); `land` (t,) marks flat
    land.
    """
    flat_land = np.zeros(len(corners), dtype=bool) if land is None else land
    local = np.asarray(corners, dtype=np.float64) - origin
    if not len(local):
        return FacetFace(None, np.zeros((0, 3)), origin, (0.0, 0.0), flat_land)
    rank, trees = hierarchy([local])
    local = trees.corner
    normals = np.cross(local[:, 1] - local[:, 0], local[:, 2] - local[:, 0])
    return FacetFace(
        trees, normals, origin, (float(local[..., 2].min()), float(local[..., 2].max())), flat_land[rank]
    )


def on_land(window: Window, face: Face, corners: Floats) -> Bools:
    """Which facets (k, 3, 3) are the face's flat land: all corners at its height, float32 rounding
    allowed.
    """
    if face.land is None:
        return np.zeros(len(corners), dtype=bool)
    reach = max(abs(v) for v in window.z_range)
    room = 1e-6 * min(window.lattice.pitch) + 2.0**-23 * reach
    return np.asarray((np.abs(corners[..., 2] - face.land) <= room).all(axis=1))


def first_crossing(
    face: FacetFace, position: Floats, direction: Floats, entering: bool
) -> tuple[Floats, Ints]:
    """Distance to the first facet that light enters (or leaves) through, and its number.

    Parameters
    ----------
    face : FacetFace
    position, direction : (n, 3) arrays
        Sheet frame; unit directions with d_z > 0.
    entering : bool
        Facets facing the light (outward normal against it), else those facing along it.

    Returns
    -------
    distance : (n,) array
        NaN where no facet is met ahead.
    facet : (n,) ints
        −1 there.
    """
    distance = np.full(len(position), np.nan)
    facet = np.full(len(position), -1, dtype=np.int64)
    if face.trees is not None and len(position):
        from clacad.tracing.triangles.compiled_search import first_facet

        start, ray = position - face.origin, np.ascontiguousarray(direction)
        first_facet(face.trees, face.normals, start, ray, -1.0 if entering else 1.0, distance, facet)
    return distance, facet


def _meet(face: AnyFace, position: Floats, direction: Floats, entering: bool) -> tuple[Floats, Floats, Bools]:
    """Distance (n,) along each ray, NaN for none; normal (n, 3) in the direction of the light; whether it is
    land.
    """
    if isinstance(face, FacetFace):
        if not len(face.normals):
            return np.full(len(position), np.nan), position, np.zeros(len(position), dtype=bool)
        distance, facet = first_crossing(face, position, direction, entering)
        return distance, face.normals[facet] * (-1.0 if entering else 1.0), face.land[facet]
    if isinstance(face, SampledFace):
        return meet_sampled(face, position, direction)
    turn = face.face.rotation
    apex = face.origin + np.asarray(face.face.vertex)
    met = meet(face.face.surface, (position - apex) @ turn, direction @ turn)
    distance = np.where(met.distance >= 0.0, met.distance, np.nan)
    if face.window is not None and face.face.array is not None:  # a hit beyond belongs to another lens
        x, y, _ = (position + distance[:, None] * direction - face.origin).T
        distance = np.where(in_optical_tile(face.window, x, y), distance, np.nan)
    return distance, met.gradient @ turn.T, np.zeros(len(position), dtype=bool)


def trace_facets(bodies: tuple[FacetBody, ...], rays: Rays) -> TraceResult:
    """Send rays through the facets over one telescopelet.

    Parameters
    ----------
    bodies : tuple of FacetBody
        In the order of the light.
    rays : Rays
        Sheet frame.

    Returns
    -------
    TraceResult
        ALIVE where the ray entered and left every body over this telescopelet and goes on forwards, LAND
        where it did so through land; TIR, BACKWARD; WALL where no facet was met (a wall, or another cell).
        `cell` and `order` are not known here.
    """
    passing = _Passing.launched(rays)
    live = np.arange(len(rays))
    number, before = 0, 1.0
    for body in bodies:
        for face, after, entering in ((body.front, body.index, True), (body.back, 1.0, False)):
            live = passing.cross(face, live, number, (before, after), entering)
            number, before = number + 1, after
    passing.fate[live[passing.aside[live]]] = Fate.LAND
    unknown = np.full((len(rays), 2), NO_CELL, dtype=np.int32)
    return TraceResult(
        passing.position,
        passing.direction,
        passing.fate,
        passing.path,
        unknown,
        unknown,
        passing.surface,
        np.ones(len(rays)),
    )


@dataclass(frozen=True, eq=False)
class _Passing:
    """n rays on their way through facets; columns are changed in place, `aside` (n,): through land."""

    position: Floats
    direction: Floats
    fate: Bytes
    surface: NDArray[np.int32]
    path: Floats
    aside: Bools

    @classmethod
    def launched(cls, rays: Rays) -> _Passing:
        """Rays before the first face, of unit direction."""
        n = len(rays)
        direction = rays.direction / np.linalg.norm(rays.direction, axis=1, keepdims=True)
        fate, surface = np.full(n, Fate.ALIVE, dtype=np.uint8), np.full(n, NO_CELL, dtype=np.int32)
        return cls(rays.position.copy(), direction, fate, surface, np.zeros(n), np.zeros(n, dtype=bool))

    def cross(
        self, face: AnyFace, live: Rows, number: int, indices: tuple[float, float], entering: bool
    ) -> Rows:
        """Move live rays (k,) to face `number` and refract them, between two refractive indices; return those
        that go on.
        """
        distance, normal, on_land = _meet(face, self.position[live], self.direction[live], entering)
        met = np.isfinite(distance)
        self.aside[live[met & on_land]] = True
        self.fate[live[~met]] = Fate.WALL
        live, distance, normal = live[met], distance[met], normal[met]
        self.position[live] += distance[:, None] * self.direction[live]
        self.path[live] += indices[0] * distance
        self.surface[live] = number
        root = np.einsum("ij,ij->i", normal, self.direction[live])
        out, _ = refract(self.direction[live], normal, root, *indices)
        reflected = np.isnan(out[:, 0])
        self.fate[live[reflected]] = Fate.TIR
        live, out = live[~reflected], out[~reflected]
        self.direction[live] = out
        back = out[:, 2] <= 0.0
        self.fate[live[back]] = Fate.BACKWARD
        return live[~back]
