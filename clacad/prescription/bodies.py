"""Faces of lenses, derived or given, poses of lenses, and bodies of faces at poses.

Given faces: nothing is solved, focal lengths are computed from the faces. Vertices follow from the form, the
separation and the thickness, as for derived faces. The offset of lens 2 is δ f1 with f1 as built, unless it
is given too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import asin, copysign, inf, isinf, sqrt
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats, Pair2
from clacad.design.faces import FaceSpec, SearchRecord, face_table
from clacad.design.sections import LAW, OF_RECIPES, AimedAt, PairSpec
from clacad.optics.law import Law, rotation
from clacad.optics.sequence import STEP, parabasal
from clacad.optics.surface import Biconic, EvenPolynomial, Quadric, refract, simplest
from clacad.prescription.radii import LensPair, NoSuchLens
from clacad.sheet.face_order import refractions
from clacad.sheet.like_cell import interfaces
from clacad.sheet.window import IDENTITY, Body, Face, Surface, Window

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.optics.material.material import Material

# -- faces -----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Shape:
    """Form of a curved face beyond its apex radii.

    conic : (K_x, K_y) or None. None: the paper's ellipsoid, one κ for both meridians; else a biconic.
    depth : (1/κ of lens 1, of lens 2) or None, lengths. None: κ = sign · sqrt(c_x c_y).
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


def given_surface(face: FaceSpec, side: int) -> Surface:
    """Surface of a given face: a quadric where the face is one."""
    (cx, cy), (kx, ky) = face.curvature, face.conic
    if face.polynomial:
        return EvenPolynomial(cx, cy, kx, ky, face.a4, side, face.a6, face.a8)
    return simplest(Biconic(cx, cy, kx, ky, side))


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


def radius_of(curvature: float) -> float:
    """Apex radius; infinite where flat."""
    return 1.0 / curvature if curvature else inf


def face_spec(surface: Surface) -> FaceSpec:
    """Face specification of a surface."""
    cx, cy = surface.curvature_x, surface.curvature_y
    if cx == cy == 0.0 and not isinstance(surface, EvenPolynomial):
        return FaceSpec((inf, inf))
    terms = (surface.a4, surface.a6, surface.a8) if isinstance(surface, EvenPolynomial) else ()
    return FaceSpec((radius_of(cx), radius_of(cy)), given_conics(surface), *terms)


def given_design(
    design: Design,
    window: Window,
    faces: tuple[FaceSpec, ...],
    offset: tuple[float, float] | None,
    record: SearchRecord | None = None,
) -> Design:
    """Design with these faces and all values that its window fixed, checked as a design file is."""
    from clacad.design import Design

    data = {key: dict(value) if isinstance(value, Mapping) else value for key, value in design.given.items()}
    pair = {key: value for key, value in data["pair"].items() if key not in (*OF_RECIPES, "search")}
    if design.pair.form not in ("slab", "plates"):
        pair["thickness"] = list(window.recipe["T"])
    if offset is not None:
        pair["vertex"] = list(offset)
    if design.pair.form != "plates":
        pair["prescription"] = "given"
    pair["face"] = [face_table(face) for face in faces]
    if record is not None:
        pair["search"] = record.to_dict()
    return Design.from_dict({**data, "pair": pair})


def refuse_crossed(pair: PairSpec) -> None:
    """Refuse a pair of one cylinder in x and one in y: no law relates the light before and behind them.

    Raises NoSuchLens.
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


@dataclass(frozen=True, slots=True)
class Medium:
    """Material of a body, and the body's name; `index` at the design wavelength."""

    index: float
    name: str
    material: Material | None = None


Listed = tuple[Face, Medium | None]
"""A face and what lies behind it; None is air."""


def lens_face(
    surface: Surface, pose: LensPose, array: int, along: float = 0.0, land: float | None = None
) -> Face:
    """Lens of an array on the axis of a pose, `along` (length) behind its point."""
    return Face(surface, pose.vertex(along), shared(pose.rotation), array, land)


def bodies_of(faces: Sequence[Listed], moved: Pair2 = (0.0, 0.0)) -> tuple[Body, ...]:
    """Bodies between faces listed in the order of the light.

    A face between two media is a joint: the body behind it has the points of the one before.

    moved : displacement of the cells of array 2 (lengths); the faces are listed in the frame of cell 1
    """
    found: list[Body] = []
    joined = False
    for (front, medium), (back, _) in pairwise([(_in_cell(face, moved), behind) for face, behind in faces]):
        if medium is not None:
            front = found[-1].back.seen_from_behind if joined else front
            found.append(Body(front, back, medium.index, medium.name, medium.material, joined))
        joined = medium is not None
    return tuple(found)


def _in_cell(face: Face, moved: Pair2) -> Face:
    """Face of array 2 in the frame of its own cell; any other face as it is."""
    x, y, z = face.vertex
    return replace(face, vertex=(x - moved[0], y - moved[1], z)) if face.array == 1 else face


def placed(
    aperture: str | Pair2 | AimedAt, faces: Sequence[Listed], lens_2: Floats
) -> tuple[tuple[Body, ...], Pair2]:
    """Bodies of faces with lens 2 at `lens_2` (3,), and the displacement of array 2's cells, lengths."""
    moved = displacement(aperture, lens_2[:2], float(lens_2[2]), bodies_of(faces))
    return bodies_of(faces, moved), moved


def shared(rotation: Floats) -> Floats:
    """`IDENTITY` itself in place of an equal rotation (3, 3)."""
    return IDENTITY if np.array_equal(rotation, IDENTITY) else rotation


# -- positions of lens 2 and of array 2's cells -----------------------------------------------------


def plano_outside_axis(
    turn: Floats, index: float, thickness: tuple[float, Floats | float], gap: float
) -> Floats:
    """Vector from V1 to V2 along the axis ray: glass, the refracted ray in the air gap, glass, lengths.

    turn : (3, 3), or (n, 3, 3) for n vectors (n, 3)
    `thickness` and `gap` are perpendicular to the sheet, as a caliper measures them.

    Raises NoSuchLens: The axis ray is totally reflected at the plane face.
    """
    axis = turn[..., 2].reshape(-1, 3)
    air, _ = refract(axis, np.broadcast_to((0.0, 0.0, 1.0), axis.shape), axis[:, 2], index, 1.0)
    if not np.isfinite(air).all():
        raise NoSuchLens(
            f"a tilt of {np.degrees(np.arccos(axis[:, 2].min())):.4g} deg sends the lens axis beyond total"
            " reflection at the plane faces",
            key=LAW.euler,
            hint=f"theta < {np.degrees(asin(1.0 / index)):.4g} deg, or form = 'biconvex' or 'slab'",
        )
    glass = np.reshape(thickness[0] + thickness[1], (-1, 1))
    return np.asarray(axis / axis[:, 2:] * glass + air / air[:, 2:] * gap).reshape(turn.shape[:-1])


def glass_of_tilts(turns: Floats, etas: Floats, index: float, separation: float, gap: float) -> Floats:
    """Glass (n,), lengths perpendicular to the sheet, of both lenses of plano pairs that leaves least power.

    turns : (n, 3, 3). Lens → sheet; etas : (n, 2)
    gap : Air between the plane faces, perpendicular to the sheet.

    A plane face is astigmatic for the axis ray: of air g the lenses see g/cos θ' across the tilt, and
    g cos²θ/cos³θ' along it, with sin θ' = n sin θ. The power left of the pair along each lens axis is
    k (s − seen − glass/(n cos θ)), k = −(1 − η)²/(η s²); its squares are least here.
    """
    level = turns[:, 2, 2]
    sine = np.sqrt(np.maximum(1.0 - level * level, 0.0))
    air = np.sqrt(1.0 - (index * sine) ** 2)
    along = np.divide(
        turns[:, 2, :2], sine[:, None], out=np.zeros((len(turns), 2)), where=sine[:, None] > 0.0
    )
    seen = gap * (1.0 / air[:, None] + (level**2 / air**3 - 1.0 / air)[:, None] * along**2)
    weight = ((1.0 - etas) ** 2 / etas) ** 2
    mean = (weight * (separation - seen)).sum(axis=1) / weight.sum(axis=1)
    return np.asarray(index * level * mean)


def shallower(law: Law, index: float) -> Floats:
    """R (3, 3), lens → sheet, with θ replaced by asin(sin θ / n): the lens axis in the glass."""
    return rotation(law.phi, asin(np.sin(law.theta) / index), law.psi, law.axes)


def best_gap(build: Callable[[float], Window], turn: Floats, guess: float) -> float:
    """Air gap (length) with the least power about the axis ray, by secant steps on the least-squares
    condition.

    build : Gap (length) → window.
    turn : (3, 3). Lens → sheet; lens 1's apex is the origin.
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

    aperture : "centred", "aligned", (ax, ay) or AimedAt (cells placed by `clacad.prescription.aimed_cells`)
    lateral : (2,). Lens 2's own lateral displacement.
    height : Height of centre 2 over centre 1.
    bodies : Bodies whose refraction between the reference points bends the chief ray (slab, plano): the ray
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


@dataclass(frozen=True, eq=False)
class FieldCells:
    """Cells of a field lens in the middle of the sheet, and what other cells need.

    shift : (x, y), lengths. Displacement of the cells.
    share : (2, 2). Place of the cells on the line from cell 1 to cell 2: 0 and 1 are its ends; sheet axes.
    faces : tuple of (2, 2). The same of the vertex of each field face, in the order of the light.
    added : (3,) lengths. Displacement of lens 2 because of the field plate.
    drift : Displacement of lens 2 from lens 1's axis that keeps the law, over that of its cell.
    focal : (x, y) or None, lengths. Displacement of lens 2 over δ; None: the focal length of lens 1.
    """

    shift: Pair2
    share: Floats
    faces: tuple[Floats, ...]
    added: Floats
    drift: float = 0.0
    focal: Pair2 | None = None
