"""Construction of faces from radii, and of bodies from poses."""

from __future__ import annotations

from dataclasses import dataclass
from math import copysign, isinf, sqrt
from typing import Protocol

import numpy as np

from clacad.base.types import Floats, Pair2
from clacad.optics.surface import Biconic, Quadric
from clacad.prescription.radii import LensPair
from clacad.sheet.window import IDENTITY, Body, Face, Surface


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


class Shaping(Protocol):
    """Source of the faces of a lens."""

    def face(self, radius: Pair2, side: int, lens: int) -> Surface:
        """Face of lens 0 or 1 on the given side (±1); `radius` (lengths) as computed by the recipe."""


@dataclass(frozen=True, eq=False)
class LensPose:
    """Pose of a lens: reference point relative to its own cell's centre (x, y) and in the sheet (z),
    and rotation.
    """

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
        Face(shape.face(radius, +1, number), pose.vertex(-half), _shared(pose.rotation), number, front_land),
        Face(shape.face(radius, -1, number), pose.vertex(+half), _shared(pose.rotation), number, back_land),
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
    """Lens `number` of a plano pair: one curved face at the reference point, one plane parallel to the
    sheet.
    """
    side = +1 if curved_front else -1
    curved = Face(
        shape.face(lenses.radius[number], side, number), pose.vertex(0.0), _shared(pose.rotation), number
    )
    plane = Face(Quadric(0.0, 0.0, 0.0, -side), (0.0, 0.0, plane_z))
    front, back = (curved, plane) if curved_front else (plane, curved)
    return Body(front, back, index, f"array{number + 1}")


def slab_body(lenses: LensPair, poses: tuple[LensPose, LensPose], shape: Shaping, index: float) -> Body:
    """One body with both arrays on its faces, each lens at its own pose (lengths)."""
    front, back = (
        Face(shape.face(lenses.radius[k], side, k), poses[k].vertex(0.0), _shared(poses[k].rotation), k)
        for k, side in ((0, +1), (1, -1))
    )
    return Body(front, back, index, "sheet")


def _shared(rotation: Floats) -> Floats:
    return IDENTITY if np.array_equal(rotation, IDENTITY) else rotation
