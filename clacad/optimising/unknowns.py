"""Unknowns of a search: words to a vector of order 1, and back to faces.

A unit of an unknown changes the slope at the border of a cell by about 1: curvatures times half a cell,
coefficients of order 2k times 2k (half a cell)^(2k − 1). Conic constants are scaled by ten. The two faces of
a lens are alike unless it is bent.

Designs and windows with replaced faces: unchecked trials of a search, or its checked result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from math import comb, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.text import did_you_mean, near
from clacad.base.types import Floats
from clacad.base.units import MONOMIALS, POWER
from clacad.config.mistakes import DesignError, Mistake
from clacad.config.value_kinds import shown
from clacad.design.faces import AIR, FaceSpec, vertices_of
from clacad.optics.surface import Quadric, Surface
from clacad.prescription.bodies import face_spec, given_surface, radius_of
from clacad.sheet.window import Body, Face, Window

if TYPE_CHECKING:
    from clacad.design import Design

WORDS = ("radii", "conic", "bending", "a4", "a6", "a8", "offset", "field")
"""Words for pairs; `LISTED_WORDS` has those for listed faces."""

NEVER = {
    "separation": "the error falls as the cube of pitch over separation, without limit",
    "thickness": "the error falls as the cube of pitch over separation, without limit",
}

CONICS = 10.0

BOTH = -1
"""Part of an unknown of both meridians of a round face."""

Terms = dict[str, list[list[Any]]]
"""Coefficients of each order, of every face."""


@dataclass(frozen=True, slots=True)
class Unknown:
    """One free number of some faces, in a meridian or of a term.

    `kind` is "c", "K", "a4", "a6" or "a8" of the faces that share it, or "d": offset of lens 2.
    """

    kind: str
    faces: tuple[int, ...]
    part: int


@dataclass(frozen=True, eq=False)
class FreeNumbers:
    """Free numbers of faces.

    start : All faces in the order of the light, at the start of the search.
    free : The unknowns.
    half : Half a cell, length.
    """

    start: tuple[FaceSpec, ...]
    free: tuple[Unknown, ...]
    half: float

    @property
    def vector(self) -> Floats:
        """Unknowns (k,) at the start of the search."""
        return np.array([self._read(one) for one in self.free])

    def conics(self, vector: Floats) -> Floats:
        """Conic constants among the unknowns (k,)."""
        return np.array([CONICS * v for one, v in zip(self.free, vector, strict=True) if one.kind == "K"])

    def _read(self, one: Unknown) -> float:
        """An unknown of a face at the start."""
        face, part = self.start[one.faces[0]], max(one.part, 0)
        if one.kind == "c":
            return face.curvature[part] * self.half
        if one.kind == "K":
            return face.conic[part] / CONICS
        return float(getattr(face, one.kind)[part]) * slope_of(one.kind, self.half)

    def _shapes(
        self, vector: Floats, image_sign: float
    ) -> tuple[list[list[float]], list[list[float]], Terms]:
        """Curvatures, conic constants and terms of each order of the faces for unknowns (k,).

        image_sign : Sign of curvatures and terms of all but the first of the faces that share an unknown.
        """
        curvature, conic = ([list(getattr(f, name)) for f in self.start] for name in ("curvature", "conic"))
        terms = {order: [list(getattr(face, order)) for face in self.start] for order in MONOMIALS}
        for one, value in zip(self.free, vector.tolist(), strict=True):
            for image, k in enumerate(one.faces):
                size = image_sign * value if image else value
                if one.kind == "c":
                    row, size = curvature[k], size / self.half
                elif one.kind == "K":
                    row, size = conic[k], value * CONICS
                elif one.kind in MONOMIALS:
                    row, size = terms[one.kind][k], size / slope_of(one.kind, self.half)
                else:
                    continue
                for part in range(len(row)) if one.part == BOTH else (one.part,):
                    row[part] = size * (comb(len(row) - 1, part) if one.part == BOTH else 1)
        return curvature, conic, terms


def _specs(curvature: list[list[float]], conic: list[list[float]], terms: Terms) -> tuple[FaceSpec, ...]:
    """Faces of these shapes."""
    orders = (terms[order] for order in MONOMIALS)
    return tuple(
        FaceSpec((radius_of(c[0]), radius_of(c[1])), (k[0], k[1]), tuple(a4), tuple(a6), tuple(a8))
        for c, k, a4, a6, a8 in zip(curvature, conic, *orders, strict=True)
    )


@dataclass(frozen=True, eq=False)
class Unknowns(FreeNumbers):
    """Free numbers of the faces of a pair.

    offset : (2,) lengths or None
        Offset of lens 2, free or fixed at its start value; None: it is 0 and fixed.
    still : Whether lens 2 keeps its position: its offset is not free.
    ellipsoids : Conic constants follow from the radii: κ = √(c_x c_y).
    """

    offset: tuple[float, float] | None
    still: bool
    ellipsoids: bool

    def faces(self, vector: Floats) -> tuple[tuple[FaceSpec, ...], tuple[float, float] | None]:
        """Faces, and the offset of lens 2, for unknowns (k,)."""
        curvature, conic, terms = self._shapes(vector, 1.0)
        offset = None if self.offset is None else list(self.offset)
        for one, value in zip(self.free, vector.tolist(), strict=True):
            if one.kind == "d":
                assert offset is not None
                offset[one.part] = value * self.half
        if self.ellipsoids:
            conic = [_ellipsoid(c, k) for c, k in zip(curvature, conic, strict=True)]
        made = _specs(curvature, conic, terms)
        return made, None if offset is None else (offset[0], offset[1])

    def _read(self, one: Unknown) -> float:
        if one.kind == "d":
            assert self.offset is not None
            return self.offset[one.part] / self.half
        return super()._read(one)


def slope_of(order: str, half: float) -> float:
    """Slope at the border of a cell (`half` a cell wide) of a term of this order whose coefficient is 1."""
    power = POWER[order]
    return float((power + 1.0) * half**power)


def _ellipsoid(curvature: list[float], conic: list[float]) -> list[float]:
    """Conic constants with one κ for both meridians; unchanged where the curvatures have opposite signs."""
    cx, cy = curvature
    if cx * cy <= 0.0:
        return conic
    kappa = sqrt(cx * cy) * (1.0 if cx > 0.0 else -1.0)
    return [kappa / cx - 1.0, kappa / cy - 1.0]


def chosen(window: Window, words: tuple[str, ...]) -> Unknowns:
    """Unknowns named by words, for a start window.

    Raises DesignError: A word is unknown, may never be free, or does not apply to this form.
    """
    _refuse(window, words)
    faces = tuple(face_spec(face.surface) for face in window.faces)
    lenses = [k for k, face in enumerate(window.faces) if face.array in (0, 1)]
    bent = "bending" in words
    groups = _groups(window, lenses, bent=bent)
    ellipsoids = (
        "conic" not in words and "a4" not in words and all(_ellipsoidal(f.surface) for f in window.faces)
    )
    if "a4" in words:  # on paraboloids: polynomials of degree 4, whose patches are exact
        faces = tuple(replace(f, conic=(-1.0, -1.0)) if k in lenses else f for k, f in enumerate(faces))
    free: list[Unknown] = []
    for group in groups:
        if bent or "radii" in words:
            free += [Unknown("c", group, i) for i in (0, 1) if bent or faces[group[0]].curvature[i] != 0.0]
        if "conic" in words:
            free += [Unknown("K", group, i) for i in (0, 1)]
        for order in MONOMIALS:
            free += [Unknown(order, group, i) for i in range(len(MONOMIALS[order])) if order in words]
    free += _of_field(window, faces, words)
    d, half = window.recipe["d"], 0.5 * min(window.lattice.pitch)
    still = "offset" not in words
    # an offset of delta f1 would follow the radii, and with it the cells of array 2, and tilted the
    # separation
    offset = None if still and d[0] == d[1] == 0.0 else (float(d[0]), float(d[1]))
    free += [] if still else [Unknown("d", (), i) for i in (0, 1)]
    return Unknowns(faces, tuple(free), half, offset, still, ellipsoids)


def _groups(window: Window, lenses: list[int], *, bent: bool) -> list[tuple[int, ...]]:
    """Lens faces that change together: those of one lens, unless it is bent."""
    if bent:
        return [(k,) for k in lenses]
    return [tuple(k for k in lenses if window.faces[k].array == array) for array in (0, 1)]


def _of_field(window: Window, faces: tuple[FaceSpec, ...], words: tuple[str, ...]) -> list[Unknown]:
    """Curvature and conic constant of each face of the field lens, in the meridians where it has power."""
    found: list[Unknown] = []
    for k, face in enumerate(window.faces):
        if face.array != 2 or "field" not in words:
            continue
        for kind in ("c", "K"):
            found += [Unknown(kind, (k,), i) for i in (0, 1) if faces[k].curvature[i] != 0.0]
    return found


def refused(
    code: str, message: str, key: str, *, found: str = "", allowed: str = "", hint: str = ""
) -> DesignError:
    """Error with one mistake."""
    return DesignError([Mistake(code, message, key, found=found, allowed=allowed, hint=hint)])


@dataclass(frozen=True, slots=True)
class _Need:
    """What a word needs of the start window or of the other words; `message` may name the form."""

    word: str
    met: Callable[[Window, tuple[str, ...]], bool]
    code: str
    message: str
    hint: str
    allowed: str = ", ".join(WORDS)


def _has(word: str, _: Window, words: tuple[str, ...]) -> bool:
    return word in words


_NEEDS = (
    _Need(
        "field",
        lambda window, _: window.field_array,
        "CL113",
        "field is free, but there is no field lens",
        "pair.field_lens = true",
        ", ".join(word for word in WORDS if word != "field"),
    ),
    *(
        _Need(
            higher,
            partial(_has, lower),
            "CL113",
            f"{higher} comes on top of {lower}, where that leaves too much",
            f"free {lower}, too",
        )
        for higher, lower in (("a6", "a4"), ("a8", "a6"))
    ),
    _Need(
        "bending",
        lambda window, _: window.form == "biconvex",
        "CL114",
        "bending needs two faces a lens; a {form} pair has one",
        'pair.form = "biconvex" can be bent',
        "radii, conic, a4, a6, a8, offset",
    ),
)


def refuse_words(words: tuple[str, ...], known: tuple[str, ...], never: Mapping[str, str]) -> None:
    """Refuse words that are unknown or may never be free, and none."""
    every = ", ".join(known)
    for word in words:
        if word in never:
            message = f"{word} is not to be free: {never[word]}"
            raise refused("CL107", message, "free", found=word, allowed=every)
        if word not in known:
            message = f"{shown(word)} is nothing that can be free"
            hint = did_you_mean(near(word.lower(), known, 0.5), quote='"')
            raise refused("CL107", message, "free", found=word, allowed=every, hint=hint)
    if not words:
        raise refused("CL107", "nothing is free", "free", allowed=every)


def _refuse(window: Window, words: tuple[str, ...]) -> None:
    """Refuse words that are unknown, may never be free, or need what the design lacks."""
    refuse_words(words, WORDS, NEVER)
    for need in _NEEDS:
        if need.word in words and not need.met(window, words):
            message = need.message.format(form=window.form)
            raise refused(need.code, message, "free", found=need.word, allowed=need.allowed, hint=need.hint)


def _ellipsoidal(surface: Surface) -> bool:
    """Whether a face is the ellipsoid that recipes build: one κ, the geometric mean; a plane is, too."""
    if not isinstance(surface, Quadric):
        return False
    cx, cy = surface.curvature_x, surface.curvature_y
    return cx * cy >= 0.0 and abs(abs(surface.kappa) - sqrt(cx * cy)) <= 1e-9 * (abs(cx) + abs(cy))


def trial_design(
    design: Design, window: Window, faces: tuple[FaceSpec, ...], offset: tuple[float, float] | None
) -> Design:
    """Unchecked design with these faces, as a trial of the search."""
    if design.pair.form == "plates":
        return replace(design, pair=replace(design.pair, face=faces))
    thickness = design.pair.thickness if design.pair.form == "slab" else tuple(window.recipe["T"])
    given = replace(
        design.pair,
        prescription="given",
        face=faces,
        thickness=thickness,
        vertex=design.pair.vertex if offset is None else offset,
    )
    return replace(design, pair=given)


def with_faces(window: Window, faces: tuple[FaceSpec, ...]) -> Window:
    """Window with replaced surfaces."""
    made = iter(faces)
    bodies = []
    for body in window.bodies:
        front, back = (
            replace(face, surface=given_surface(spec, face.side)) if face.array is not None else face
            for face, spec in ((body.front, next(made)), (body.back, next(made)))
        )
        bodies.append(replace(body, front=front, back=back))
    return replace(window, bodies=tuple(bodies))


# -- listed faces (form = "plates"): shapes, distances, joints -------------------------------------
#
# Both meridians of a round face change together. Where the list is its own mirror image, it stays so: a
# face and its image share their unknowns, with half as many to search.

LISTED_WORDS = ("radii", "conic", "a4", "a6", "a8", "thickness", "joints")

LISTED_NEVER = {
    "offset": "array 2 of a list follows delta",
    "bending": "every face of a list has radii of its own: radii",
    "field": "its faces are listed with the others: radii",
    "separation": "the distances of a list are its thickness",
}

SAME = 1e-6
"""Relative difference below which numbers of a list count as equal."""


@dataclass(frozen=True, eq=False)
class ListedUnknowns(FreeNumbers):
    """Free numbers of listed faces, each with its place; an unknown "t" is the distance behind a face."""

    still: bool = True

    def faces(self, vector: Floats) -> tuple[tuple[FaceSpec, ...], None]:
        """Faces for unknowns (k,); array 2 keeps its place."""
        gaps = np.diff(vertices_of(self.start)).tolist()
        for one, value in zip(self.free, vector.tolist(), strict=True):
            for k in one.faces if one.kind == "t" else ():
                gaps[k] = 2.0 * self.half * value
        places = np.concatenate([[0.0], np.cumsum(gaps)]).tolist()
        made = [
            replace(shape, z=places[k] if k else None, array=face.array, behind=face.behind)
            for k, (shape, face) in enumerate(
                zip(_specs(*self._shapes(vector, -1.0)), self.start, strict=True)
            )
        ]
        return tuple(made), None

    def _read(self, one: Unknown) -> float:
        if one.kind == "t":
            return float(np.diff(vertices_of(self.start))[one.faces[0]]) / (2.0 * self.half)
        return super()._read(one)


def listed_unknowns(design: Design, window: Window, words: tuple[str, ...]) -> ListedUnknowns:
    """Unknowns of a list of faces, named by words.

    Raises DesignError: A word is unknown, may never be free, or needs what the list lacks.
    """
    refuse_words(words, LISTED_WORDS, LISTED_NEVER)
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
