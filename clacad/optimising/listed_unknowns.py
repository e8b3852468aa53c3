"""Unknowns of a search over listed faces (`form = "plates"`): shapes, distances, joints.

Both meridians of a round face change together. Where the list is its own mirror image, it stays so: a face
and its image share their unknowns, with half as many to search.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from math import comb, inf
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats
from clacad.base.units import MONOMIALS
from clacad.design.faces import AIR, FaceSpec, vertices_of
from clacad.optimising.unknowns import CONICS, Unknown, refuse_words, refused, slope_of
from clacad.sheet.window import Body, Face, Window

if TYPE_CHECKING:
    from clacad.design import Design

LISTED_WORDS = ("radii", "conic", "a4", "a6", "a8", "thickness", "joints")

NEVER = {
    "offset": "array 2 of a list follows delta",
    "bending": "every face of a list has radii of its own: radii",
    "field": "its faces are listed with the others: radii",
    "separation": "the distances of a list are its thickness",
}

BOTH = -1
"""Part of an unknown of both meridians."""

SAME = 1e-6
"""Relative difference below which numbers of a list count as equal."""


@dataclass(frozen=True, eq=False)
class ListedUnknowns:
    """Free numbers of listed faces.

    start : Faces at the start of the search, each with its place.
    free : Of kind "c", "K", "a4", "a6", "a8", or "t": the distance behind a face.
    half : Half a cell, length.
    """

    start: tuple[FaceSpec, ...]
    free: tuple[Unknown, ...]
    half: float
    still: bool = True

    @property
    def vector(self) -> Floats:
        """Unknowns (k,) at the start of the search."""
        return np.array([self._read(one) for one in self.free])

    def conics(self, vector: Floats) -> Floats:
        """Conic constants among the unknowns (k,)."""
        return np.array([CONICS * v for one, v in zip(self.free, vector, strict=True) if one.kind == "K"])

    def faces(self, vector: Floats) -> tuple[tuple[FaceSpec, ...], None]:
        """Faces for unknowns (k,); array 2 keeps its place."""
        curvature = [list(face.curvature) for face in self.start]
        conic = [list(face.conic) for face in self.start]
        terms = {order: [list(getattr(face, order)) for face in self.start] for order in MONOMIALS}
        gaps = np.diff(vertices_of(self.start)).tolist()
        for one, value in zip(self.free, vector.tolist(), strict=True):
            for image, k in enumerate(one.faces):
                sign = -1.0 if image else 1.0
                if one.kind == "t":
                    gaps[k] = 2.0 * self.half * value
                elif one.kind in MONOMIALS:
                    size = sign * value / slope_of(one.kind, self.half)
                    row = terms[one.kind][k]
                    parts = range(len(row)) if one.part == BOTH else (one.part,)
                    for part in parts:
                        row[part] = size * (comb(len(row) - 1, part) if one.part == BOTH else 1)
                else:
                    size = sign * value / self.half if one.kind == "c" else value * CONICS
                    for part in (0, 1) if one.part == BOTH else (one.part,):
                        (curvature if one.kind == "c" else conic)[k][part] = size
        places = np.concatenate([[0.0], np.cumsum(gaps)]).tolist()
        made = []
        for k, face in enumerate(self.start):
            radius = [1.0 / c if c else inf for c in curvature[k]]
            a4, a6, a8 = (tuple(rows[k]) for rows in terms.values())
            shape = FaceSpec((radius[0], radius[1]), (conic[k][0], conic[k][1]), a4, a6, a8)
            made.append(replace(shape, z=places[k] if k else None, array=face.array, behind=face.behind))
        return tuple(made), None

    def _read(self, one: Unknown) -> float:
        face, part = self.start[one.faces[0]], max(one.part, 0)
        if one.kind == "t":
            return float(np.diff(vertices_of(self.start))[one.faces[0]]) / (2.0 * self.half)
        if one.kind == "c":
            return face.curvature[part] * self.half
        if one.kind == "K":
            return face.conic[part] / CONICS
        return float(getattr(face, one.kind)[part]) * slope_of(one.kind, self.half)


def listed_unknowns(design: Design, window: Window, words: tuple[str, ...]) -> ListedUnknowns:
    """Unknowns of a list of faces, named by words.

    Raises DesignError: A word is unknown, may never be free, or needs what the list lacks.
    """
    refuse_words(words, LISTED_WORDS, NEVER)
    places = vertices_of(design.pair.face)
    faces = tuple(
        replace(face, after=None, z=z if k else None)
        for k, (face, z) in enumerate(zip(design.pair.face, places, strict=True))
    )
    joints = [k for k, (one, two) in enumerate(pairwise(faces), 1) if AIR not in (one.behind, two.behind)]
    if "joints" in words and not joints:
        raise refused("CL113", "joints are free, but no face is one", "free", found="joints")
    image = _images(faces)
    free: list[Unknown] = []
    for k, face in enumerate(faces):
        if face.array is not None and image[k] >= k:
            own = tuple(dict.fromkeys((k, image[k])))
            free += _of_face(face, own, words, joint=k in joints)
    for k in range(len(faces) - 1):
        near_joint = bool({k, k + 1} & set(joints))
        other = len(faces) - 2 - k if image[0] else k
        if other >= k and ("thickness" in words or ("joints" in words and near_joint)):
            free.append(Unknown("t", tuple(dict.fromkeys((k, other))), BOTH))
    if not free:
        raise refused("CL107", "nothing of this list is free with these words", "free")
    return ListedUnknowns(faces, tuple(free), 0.5 * min(window.lattice.pitch))


def _of_face(
    face: FaceSpec, own: tuple[int, ...], words: tuple[str, ...], *, joint: bool
) -> Iterator[Unknown]:
    """Unknowns of one face and its mirror image."""
    round_face = face.radius[0] == face.radius[1] and face.conic[0] == face.conic[1]
    parts = (BOTH,) if round_face else (0, 1)
    if ("joints" if joint else "radii") in words and not face.plane:
        yield from (Unknown("c", own, part) for part in parts if face.curvature[max(part, 0)])
    if joint or face.plane:
        return
    if "conic" in words:
        yield from (Unknown("K", own, part) for part in parts)
    for order, names in MONOMIALS.items():
        if order in words:
            yield from (Unknown(order, own, part) for part in (parts if round_face else range(len(names))))


def _images(faces: tuple[FaceSpec, ...]) -> list[int]:
    """Number of the mirror image of each face: its own number where the list is not its own image."""
    count, places = len(faces), vertices_of(faces)
    media = [AIR, *(face.behind for face in faces)]
    own = list(range(count))
    if media != media[::-1]:
        return own
    for k, face in enumerate(faces):
        other = faces[count - 1 - k]
        numbers = [*face.curvature, *face.conic, *face.a4, *face.a6, *face.a8, places[k]]
        turned = [*(-c for c in other.curvature), *other.conic]
        turned += [-term for term in (*other.a4, *other.a6, *other.a8)]
        turned.append(places[-1] - places[count - 1 - k])
        if (face.array is None) != (other.array is None) or not np.allclose(numbers, turned, SAME, SAME):
            return own
    return own[::-1]


def with_listed(window: Window, faces: tuple[FaceSpec, ...]) -> Window:
    """Window of listed faces with other shapes and places of the same faces, without land."""
    places = iter(zip(faces, vertices_of(faces), strict=True))
    bodies: list[Body] = []
    for body in window.bodies:
        front = bodies[-1].back.seen_from_behind if body.joined else _shaped(body.front, *next(places))
        bodies.append(replace(body, front=front, back=_shaped(body.back, *next(places))))
    return replace(window, bodies=tuple(bodies))


def _shaped(face: Face, spec: FaceSpec, z: float) -> Face:
    """The face with the shape of a listed one, at another height (length)."""
    from clacad.prescription.face_list import surface_of

    x, y, _ = face.vertex
    surface = face.surface if face.array is None else surface_of(spec, face.side)
    return replace(face, surface=surface, vertex=(x, y, z))
