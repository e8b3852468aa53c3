"""Positions of the two lenses of a telescopelet, and displacement of array 2's cells."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import asin

import numpy as np

from clacad.base.types import Floats
from clacad.design.keys import LAW
from clacad.design.sections import AimedAt
from clacad.optics.law import Law, rotation
from clacad.optics.sequence import STEP, parabasal
from clacad.optics.surface import refract
from clacad.prescription.radii import NoSuchLens
from clacad.sheet.telescopelet import interfaces
from clacad.sheet.window import Body, Window

Aperture = str | tuple[float, float] | AimedAt


@dataclass(frozen=True, eq=False)
class Placement:
    """Reference point of lens 2 relative to that of lens 1, and the lens frame's rotation.

    lens_2 : (3,) sheet frame, lengths
    rotation : (3, 3) lens → sheet, of the built lenses
    """

    lens_2: Floats
    rotation: Floats


def biconvex_placement(turn: Floats, offset: Floats, separation: float) -> Placement:
    """Lens 2's centre at R (d_x, d_y, s); turn R (3, 3) lens → sheet, offset (2,) and separation in
    lengths.
    """
    return Placement(turn @ np.array([offset[0], offset[1], separation]), turn)


def slab_placement(turn: Floats, offset: Floats, thickness: float) -> Placement:
    """Lens 2's vertex at R (d_x, d_y, T), lengths: the common glass makes it exact for any tilt."""
    return Placement(turn @ np.array([offset[0], offset[1], thickness]), turn)


def plano_inside_placement(law: Law, offset: Floats, separation: float, index: float) -> Placement:
    """Curved faces inside: the plane faces refract the axis, so the lenses tilt by asin(sin θ/n)."""
    turn = shallower(law, index)
    return Placement(turn @ np.array([offset[0], offset[1], separation]), turn)


def plano_outside_axis(turn: Floats, index: float, thickness: tuple[float, float], gap: float) -> Floats:
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
    """R (3, 3), lens → sheet, with θ replaced by asin(sin θ / n): the tilt of the lens axis inside the
    glass.
    """
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
    bodies: tuple[Body, ...], aperture: Aperture, lateral: Floats, height: float, chief: bool
) -> tuple[float, float]:
    """Displacement of the cells of array 2 (lengths).

    Parameters
    ----------
    aperture : "centred", "aligned", (ax, ay) or AimedAt (cells placed by `clacad.prescription.aimed_cells`)
    lateral : (2,)
        Lens 2's own lateral displacement.
    height : float
        Height of centre 2 over centre 1.
    chief : bool
        Whether refraction between the reference points bends the chief ray (slab, plano). If so, the ray
        through lens 1's vertex carries (ax, ay), the slope in air at the centre of the field of view. For a
        biconvex pair the ray is straight and the displacement is height · (ax, ay).
    """
    if aperture == "centred":
        return float(lateral[0]), float(lateral[1])
    if aperture == "aligned" or isinstance(aperture, AimedAt):
        return 0.0, 0.0
    ax, ay = (float(a) for a in aperture)
    if not chief:
        return height * ax, height * ay
    return _chief_landing(bodies, np.array([ax, ay, 1.0]), height)


def _chief_landing(bodies: tuple[Body, ...], slope: Floats, height: float) -> tuple[float, float]:
    """Intersection (x, y) of the ray through lens 1's vertex with the height of lens 2's vertex."""
    ray = slope[None] / np.linalg.norm(slope)
    position, index = np.zeros(3), 1.0
    faces = [(f, n) for body in bodies for f, n in ((body.front, body.index), (body.back, 1.0))]
    for face, after in faces:
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
