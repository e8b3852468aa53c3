"""Given faces: nothing is solved, focal lengths are computed from the faces, impossible faces are refused.

Vertices follow from the form, the separation and the thickness, as for derived faces. The offset of
lens 2 is δ f1 with f1 as built, unless it is given too.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np

from clacad.base.types import Floats, Pair2
from clacad.design.faces import FaceSpec
from clacad.design.keys import PAIR
from clacad.design.sections import PairSpec
from clacad.optics.surface import Biconic, EvenPolynomial, Quadric, Surface, as_quadric
from clacad.prescription.cell_heights import face_range, least_thickness, zone_points
from clacad.prescription.radii import LensPair, NoSuchLens
from clacad.sheet.window import Body, Face, Window, lens_height


@dataclass(frozen=True, slots=True)
class GivenFaces:
    """Faces in the order light reaches them, a field lens's in the middle; an alternative to
    `faces_and_bodies.Shape`.

    form : "biconvex", "plano" or "slab"
    """

    form: str
    faces: tuple[FaceSpec, ...]

    def number(self, side: int, lens: int) -> int:
        """Index among the given faces of the face on the given side (±1) of lens 0 or 1."""
        last = len(self.faces) - 1
        if self.form == "slab" and last < 5:  # one face per lens, with or without field faces between
            return last * lens
        return (last - 1) * lens + (side < 0)

    def of_field(self, side: int, after: int) -> Surface:
        """Face number `after` of the field lens, on the given side (±1)."""
        return given_surface(self.faces[(len(self.faces) - 2) // 2 + after], side)

    def face(self, radius: Pair2, side: int, lens: int) -> Surface:
        """Given face of lens 0 or 1 on the given side; the recipe's `radius` is ignored."""
        return given_surface(self.faces[self.number(side, lens)], side)


def given_surface(face: FaceSpec, side: int) -> Surface:
    """Surface of a given face: a quadric where the face is one."""
    (cx, cy), (kx, ky) = face.curvature, face.conic
    if face.polynomial:
        return EvenPolynomial(cx, cy, kx, ky, face.a4, side, face.a6, face.a8)
    biconic = Biconic(cx, cy, kx, ky, side)
    try:
        return as_quadric(biconic)
    except ValueError:
        return biconic


def given_pair(pair: PairSpec, thickness: Pair2, index: float) -> LensPair:
    """Focal lengths of the given faces about their own axes, in air (slab: R/(n − 1)); radii of each lens's
    front.

    Thick lensmaker's equation per meridian: 1/f = (n − 1)(c + c' − (n − 1) T c c'/n), convex positive.
    """
    lenses = [pair.face[pair.lens_faces(lens)] for lens in (0, 1)]
    focal = [
        _focal_lengths([face.curvature for face in lens], t, index)
        for lens, t in zip(lenses, thickness, strict=True)
    ]
    return LensPair((focal[0], focal[1]), (lenses[0][0].radius, lenses[1][0].radius), thickness)


def _focal_lengths(curvatures: list[Pair2], thickness: float, index: float) -> Pair2:
    found = []
    for axis in (0, 1):
        front, back = curvatures[0][axis], curvatures[1][axis] if len(curvatures) > 1 else 0.0
        power = (index - 1.0) * (front + back - (index - 1.0) * thickness * front * back / index)
        found.append(1.0 / power if power else inf)
    return found[0], found[1]


def refuse_crossed(pair: PairSpec) -> None:
    """Refuse a pair of one cylinder in x and one in y: no law relates the light before and behind them.

    Raises
    ------
    NoSuchLens
    """
    powers = [
        [any(face.curvature[axis] != 0.0 for face in pair.face[pair.lens_faces(lens)]) for axis in (0, 1)]
        for lens in (0, 1)
    ]
    if sorted(powers) != [[False, True], [True, False]]:
        return
    axis = "xy"[powers[0].index(True)]
    other = "yx"[powers[0].index(True)]
    raise NoSuchLens(
        f"lens 1 is a cylinder with power in {axis}, lens 2 one with power in {other}: eta = -f2/f1 is"
        f" infinite in {axis} and 0 in {other}, for each axis needs two lenses",
        key="pair.face.0.radius",
        hint=(
            f"power in {axis} on both lenses (law.eta = {'[-1, 1]' if axis == 'x' else '[1, -1]'}), and a"
            f" sheet with power in {other} (law.eta = {'[1, -1]' if axis == 'x' else '[-1, 1]'}) behind it,"
            " at a separation of its own: clacad stack A.toml B.toml"
        ),
    )


def refuse_no_faces(window: Window) -> None:
    """Refuse given faces that have no height somewhere over their cell, or that cross there.

    Raises
    ------
    NoSuchLens
        A face has no real height somewhere over its cell, or front and back of a body without land intersect.
    """
    number = 0
    for body in window.bodies:
        for face in (body.front, body.back):
            if face.array is not None:
                _refuse_no_height(window, face, number)
            number += 1
        _refuse_crossing(window, body, number)


def _refuse_no_height(window: Window, face: Face, number: int) -> None:
    points = zone_points(window)
    missing = np.isnan(lens_height(face, points[:, 0], points[:, 1]))
    if not missing.any():
        return
    apart = points[missing] - np.asarray(face.vertex[:2])
    at = points[missing][int(np.argmin((apart**2).sum(axis=1)))]
    raise NoSuchLens(
        f"face {number + 1} has no real height over ({at[0]:.4g}, {at[1]:.4g}) of its cell",
        key=f"{PAIR.face}.{number}.conic",
        hint=_conic_that_fits(face, points),
    )


def _conic_that_fits(face: Face, points: Floats) -> str:
    """Conic constants of an upright face that reach every point (n, 2), lengths, of its zone."""
    surface = face.surface
    conics = given_conics(surface)
    x, y = (points - np.asarray(face.vertex[:2])).T
    square = [
        (1.0 + k) * c * c for k, c in zip(conics, (surface.curvature_x, surface.curvature_y), strict=True)
    ]
    worst = float((square[0] * x * x + square[1] * y * y).max())
    if worst <= 1.0:
        return "less tilt, longer radii or a smaller pitch"
    fits = [(1.0 + k) / worst - 1.0 for k in conics]
    return f"conic below [{fits[0]:.4g}, {fits[1]:.4g}], longer radii, or a smaller pitch"


def given_conics(surface: Surface) -> Pair2:
    """Conic constants (K_x, K_y); −1 in the flat meridian of a quadric, where the value has no effect."""
    if not isinstance(surface, Quadric):
        return surface.conic_x, surface.conic_y
    k = [surface.kappa / c - 1.0 if c else -1.0 for c in (surface.curvature_x, surface.curvature_y)]
    return k[0], k[1]


def _refuse_crossing(window: Window, body: Body, after: int) -> None:
    """Refuse a body without land whose front and back intersect over the cell."""
    faces = (body.front, body.back)
    if all(face.land is not None for face in faces if face.array is not None):
        return
    if body.columnar or None in (body.front.array, body.back.array):
        left = least_thickness(window, body)
    else:
        left = face_range(window, body.back)[0] - face_range(window, body.front)[1]
    if left <= 0.0:
        raise NoSuchLens(
            f"faces {after - 1} and {after} cross over their cell: {left:.4g} is left between them where they"
            " are nearest",
            key=PAIR.thickness if window.form != "slab" else PAIR.separation,
            hint=f"more than {-left:.4g} more thickness, or longer radii",
        )
