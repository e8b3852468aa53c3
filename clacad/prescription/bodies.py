"""Faces of lenses, derived or given, poses of lenses, and bodies of faces at poses.

Given faces: nothing is solved, focal lengths are computed from the faces. Vertices follow from the form, the
separation and the thickness, as for derived faces. The offset of lens 2 is δ f1 with f1 as built, unless it
is given too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import asin, copysign, inf, isinf, sqrt
from typing import Protocol

import numpy as np

from clacad.base.types import Floats, Pair2
from clacad.design.faces import FaceSpec
from clacad.design.sections import LAW, AimedAt, PairSpec
from clacad.optics.law import Law, rotation
from clacad.optics.sequence import STEP, parabasal
from clacad.optics.surface import Biconic, EvenPolynomial, Quadric, as_quadric, refract
from clacad.prescription.radii import LensPair, NoSuchLens
from clacad.sheet.face_order import refractions
from clacad.sheet.like_cell import interfaces
from clacad.sheet.window import IDENTITY, Body, Face, Surface, Window

# -- faces -----------------------------------------------------------------------------------------


class Shaping(Protocol):
    """Source of the faces of a lens."""

    def face(self, radius: Pair2, side: int, lens: int) -> Surface:
        """Face of lens 0 or 1 on the given side (±1); `radius` (lengths) as computed by the recipe."""


@dataclass(frozen=True, slots=True)
class Shape:
    """Form of a curved face beyond its apex radii.

    conic : (K_x, K_y) or None
        None: the paper's ellipsoid, one κ for both meridians; else a biconic.
    depth : (1/κ of lens 1, of lens 2) or None, lengths
        None: κ = sign · sqrt(c_x c_y).
    """

    conic: Pair2 | None
    depth: Pair2 | None

    def face(self, radius: Pair2, side: int, lens: int) -> Surface:
        """Curved face of lens 0 or 1 with apex radii `radius` (lengths) on the given side."""
        cx, cy = (0.0 if isinf(r) else 1.0 / r for r in radius)
        if self.conic is not None:
            return Biconic(cx, cy, self.conic[0], self.conic[1], side)
        return Quadric(cx, cy, self._kappa(cx, cy, lens), side)

    def _kappa(self, cx: float, cy: float, lens: int) -> float:
        if self.depth is not None:
            return copysign(1.0 / self.depth[lens], cx + cy)
        if cx * cy > 0.0:
            # kappa has the curvature's sign, else a concave face would become a hyperboloid
            return copysign(sqrt(cx) * sqrt(cy) if cx > 0.0 else sqrt(-cx) * sqrt(-cy), cx)
        return cx + cy if cx == 0.0 or cy == 0.0 else 0.0  # circular cylinder; saddle


@dataclass(frozen=True, slots=True)
class GivenFaces:
    """Faces in the order light reaches them, a field lens's in the middle; an alternative to
    `Shape`.

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


def given_conics(surface: Surface) -> Pair2:
    """Conic constants (K_x, K_y); −1 in the flat meridian of a quadric, where the value has no effect."""
    if not isinstance(surface, Quadric):
        return surface.conic_x, surface.conic_y
    k = [surface.kappa / c - 1.0 if c else -1.0 for c in (surface.curvature_x, surface.curvature_y)]
    return k[0], k[1]


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


# -- bodies ----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class LensPose:
    """Pose of a lens: point relative to its cell's centre (x, y) and in the sheet (z), and rotation."""

    point: Floats
    rotation: Floats

    def vertex(self, along: float) -> tuple[float, float, float]:
        """Point at distance `along` (length) on the lens axis from the reference point."""
        x, y, z = self.point + along * self.rotation[:, 2]
        return float(x), float(y), float(z)


def biconvex_body(
    lenses: LensPair,
    number: int,
    pose: LensPose,
    shape: Shaping,
    index: float,
    land: tuple[float, float] | None,
) -> Body:
    """Lens `number` (0, 1) of a biconvex pair, apexes T/2 either side of its centre.

    land : (front z, back z) of the web, or None
    """
    half = 0.5 * lenses.thickness[number]
    radius = lenses.radius[number]
    front_land, back_land = (None, None) if land is None else land
    return Body(
        Face(shape.face(radius, +1, number), pose.vertex(-half), shared(pose.rotation), number, front_land),
        Face(shape.face(radius, -1, number), pose.vertex(+half), shared(pose.rotation), number, back_land),
        index,
        f"array{number + 1}",
    )


def plano_body(
    lenses: LensPair,
    number: int,
    pose: LensPose,
    shape: Shaping,
    index: float,
    curved_front: bool,
    plane_z: float,
) -> Body:
    """Lens `number` of a plano pair: a curved face at its point, a plane parallel to the sheet."""
    side = +1 if curved_front else -1
    curved = Face(
        shape.face(lenses.radius[number], side, number), pose.vertex(0.0), shared(pose.rotation), number
    )
    plane = Face(Quadric(0.0, 0.0, 0.0, -side), (0.0, 0.0, plane_z))
    front, back = (curved, plane) if curved_front else (plane, curved)
    return Body(front, back, index, f"array{number + 1}")


def slab_body(lenses: LensPair, poses: tuple[LensPose, LensPose], shape: Shaping, index: float) -> Body:
    """One body with both arrays on its faces, each lens at its own pose (lengths)."""
    front, back = (
        Face(shape.face(lenses.radius[k], side, k), poses[k].vertex(0.0), shared(poses[k].rotation), k)
        for k, side in ((0, +1), (1, -1))
    )
    return Body(front, back, index, "sheet")


def shared(rotation: Floats) -> Floats:
    """`IDENTITY` itself in place of an equal rotation (3, 3)."""
    return IDENTITY if np.array_equal(rotation, IDENTITY) else rotation


# -- positions of lens 2 and of array 2's cells -----------------------------------------------------


def plano_outside_axis(turn: Floats, index: float, thickness: Pair2, gap: float) -> Floats:
    """Vector from V1 to V2 along the axis ray: glass, the refracted ray in the air gap, glass, (3,) lengths.

    `thickness` and `gap` are perpendicular to the sheet, as a caliper measures them.

    Raises
    ------
    NoSuchLens
        The axis ray is totally reflected at the plane face.
    """
    axis = turn[:, 2]
    up = np.array([[0.0, 0.0, 1.0]])
    air, _ = refract(axis[None], up, axis[None, 2], index, 1.0)
    if not np.isfinite(air).all():
        raise NoSuchLens(
            f"a tilt of {np.degrees(np.arccos(axis[2])):.4g} deg sends the lens axis beyond total reflection"
            " at the plane faces",
            key=LAW.euler,
            hint=f"theta < {np.degrees(asin(1.0 / index)):.4g} deg, or form = 'biconvex' or 'slab'",
        )
    glass = axis / axis[2]
    return np.asarray(glass * (thickness[0] + thickness[1]) + air[0] / air[0, 2] * gap)


def shallower(law: Law, index: float) -> Floats:
    """R (3, 3), lens → sheet, with θ replaced by asin(sin θ / n): the lens axis in the glass."""
    return rotation(law.phi, asin(np.sin(law.theta) / index), law.psi, law.axes)


def best_gap(build: Callable[[float], Window], turn: Floats, guess: float) -> float:
    """Air gap (length) with the least power about the axis ray, by secant steps on the least-squares
    condition.

    build : callable
        Gap (length) → window.
    turn : (3, 3)
        Lens → sheet; lens 1's apex is the origin.
    """

    def power(gap: float) -> Floats:
        window = build(gap)
        size = STEP * window.lattice.circumradius
        return parabasal(interfaces(window), turn, np.zeros(3), size).cosines

    # The power is linear in the gap to high order: repeat one Gauss-Newton step with the slope of a chord.
    gap, step = guess, 1e-3 * guess
    for _ in range(6):
        here = power(gap)
        slope = (power(gap + step) - here) / step
        change = -float((here * slope).sum() / (slope * slope).sum())
        gap += change
        if abs(change) <= 1e-14 * abs(gap):
            break
    return gap


def displacement(
    aperture: str | Pair2 | AimedAt, lateral: Floats, height: float, bodies: tuple[Body, ...] = ()
) -> Pair2:
    """Displacement of the cells of array 2 (lengths).

    Parameters
    ----------
    aperture : "centred", "aligned", (ax, ay) or AimedAt (cells placed by `clacad.prescription.aimed_cells`)
    lateral : (2,)
        Lens 2's own lateral displacement.
    height : float
        Height of centre 2 over centre 1.
    bodies : tuple of Body
        Bodies whose refraction between the reference points bends the chief ray (slab, plano): the ray
        through lens 1's vertex then carries (ax, ay), the slope in air at the centre of the field of view.
        Without them (biconvex pair) the ray is straight and the displacement is height · (ax, ay).
    """
    if aperture == "centred":
        return float(lateral[0]), float(lateral[1])
    if aperture == "aligned" or isinstance(aperture, AimedAt):
        return 0.0, 0.0
    ax, ay = (float(a) for a in aperture)
    if not bodies:
        return height * ax, height * ay
    return _chief_landing(bodies, np.array([ax, ay, 1.0]), height)


def _chief_landing(bodies: tuple[Body, ...], slope: Floats, height: float) -> tuple[float, float]:
    """Intersection (x, y) of the ray through lens 1's vertex with the height of lens 2's vertex."""
    ray = slope[None] / np.linalg.norm(slope)
    position, index = np.zeros(3), 1.0
    for _, face, _, after in refractions(bodies):
        if face.array == 1:
            break
        if face.array == 0:
            normal = face.rotation[:, 2]
        else:
            normal = np.array([0.0, 0.0, 1.0])
            if position[2] != face.vertex[2] and face.vertex[2] > 0.0:
                position = position + ray[0] / ray[0, 2] * (face.vertex[2] - position[2])
        ray, _ = refract(ray, normal[None], ray @ normal, index, after)
        index = after
    position = position + ray[0] / ray[0, 2] * (height - position[2])
    return float(position[0]), float(position[1])
