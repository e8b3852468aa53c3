"""Lens faces of a body as exact B-Rep geometry in the cell frame, lengths in millimetres.

A quadric is exact: rational patch, rational arcs. Any other surface (a biconic) is replaced by ONE polynomial
patch z(x, y) over its cell, fitted at Chebyshev points. Its error is measured and stated, and its border
curves lie exactly on the fitted patch. An upright even polynomial on a paraboloid is an exact patch of its
own degree.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from clacad.base.types import Floats
from clacad.optics.surface import EvenPolynomial, Quadric, resized
from clacad.sheet.window import Face, lens_height
from clacad.solid.rational_conics import (
    Arc,
    PosedQuadric,
    RationalPatch,
    bernstein,
    line,
    parameter_curve,
    posed,
    quadric_patch,
    section_arc,
)
from clacad.topology.cannot_build import CannotBuild

STEEPEST = 0.02
"""Least weight of a patch; it falls from 1 on a flat lens to 0 where a corner of the patch reaches the
equator.
"""

PATCH_DEGREES = (2, 4, 8)
"""Degrees of a quadric's patch: raised where a weight would come near 0, without moving any point."""

HIGHEST_DEGREE = 20
"""Degree of a fitted patch in each direction beyond which it is refused."""

LOOSEST = 10.0
"""Largest error, in tolerances, that is stated rather than refused where the highest degree misses the
tolerance.
"""

HIGHEST_ARC = 20
"""Degree of an arc of a fitted patch over a slanting segment; CAD programs accept up to 25."""


class Lens(Protocol):
    """Interface of a lens face for the shell builder."""

    def height(self, x: Floats, y: Floats) -> Floats:
        """Heights over cell-frame points; NaN where there is no surface."""

    def arc(self, start: Floats, end: Floats) -> Arc:
        """Curve of the face over the straight segment from start to end, (2,) each."""

    def parameters(self, arc: Arc) -> Arc:
        """The arc in the parameters of `patch`, with the arc's own parameter."""

    @property
    def patch(self) -> RationalPatch:
        """The surface."""

    @property
    def error(self) -> float:
        """Largest distance along z between the patch and the lens (mm); 0 where it is exact."""


@dataclass(frozen=True, eq=False)
class QuadricLens:
    """A lens face that is a quadric; `u`, `v` is the parameter rectangle covered by its patch."""

    quadric: PosedQuadric
    u: tuple[float, float]
    v: tuple[float, float]
    degree: int = 2

    def height(self, x: Floats, y: Floats) -> Floats:
        """Heights (mm) over cell-frame points; NaN where there is no surface."""
        return self.quadric.height(x, y)

    def arc(self, start: Floats, end: Floats) -> Arc:
        """Exact section over the straight segment from start to end, (2,) each (mm)."""
        z = self.height(np.array([start[0], end[0]]), np.array([start[1], end[1]]))
        normal = np.array([start[1] - end[1], end[0] - start[0], 0.0])
        normal = normal / np.linalg.norm(normal)
        return section_arc(self.quadric, np.append(start, z[0]), np.append(end, z[1]), normal)

    def section(self, start: Floats, end: Floats, normal: Floats) -> Arc:
        """Exact section by any plane between two points (3,) of the section."""
        return section_arc(self.quadric, start, end, normal)

    def parameters(self, arc: Arc) -> Arc:
        """Exact curve of a section arc in the patch's parameters."""
        return parameter_curve(self.quadric, arc, self.u, self.v)

    @property
    def patch(self) -> RationalPatch:
        """The exact rational patch, 3×3 unless the lens is steep."""
        patch = quadric_patch(self.quadric, self.u, self.v)
        return patch if self.degree == 2 else patch.elevated(self.degree)

    @property
    def error(self) -> float:
        """Zero: the patch is exact."""
        return 0.0


@dataclass(frozen=True, eq=False)
class FittedLens:
    """A lens face replaced by a polynomial height z(x, y) over a rectangle; `poles` (m + 1, n + 1) in mm."""

    poles: Floats
    low: tuple[float, float]
    high: tuple[float, float]
    error: float

    def height(self, x: Floats, y: Floats) -> Floats:
        """Heights (mm) of the fitted patch."""
        x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        u = (x.ravel() - self.low[0]) / (self.high[0] - self.low[0])
        v = (y.ravel() - self.low[1]) / (self.high[1] - self.low[1])
        m, n = self.poles.shape
        z = np.einsum("ki,ij,kj->k", bernstein(m - 1, u), self.poles, bernstein(n - 1, v))
        return np.asarray(z.reshape(x.shape))

    def arc(self, start: Floats, end: Floats) -> Arc:
        """Curve of the fitted patch over a straight segment: polynomial, exact on the patch."""
        m, n = self.poles.shape
        along_x, along_y = abs(end[1] - start[1]) < 1e-15, abs(end[0] - start[0]) < 1e-15
        degree = m - 1 if along_x else n - 1 if along_y else min(m + n - 2, HIGHEST_ARC)
        t = 0.5 - 0.5 * np.cos(np.pi * np.arange(degree + 1) / degree)
        xy = start + t[:, None] * (end - start)
        z = np.linalg.solve(bernstein(degree, t), self.height(xy[:, 0], xy[:, 1]))
        share = np.linspace(0.0, 1.0, degree + 1)[:, None]
        return Arc(np.column_stack([start + share * (end - start), z]), np.ones(degree + 1))

    def parameters(self, arc: Arc) -> Arc:
        """The arc in plan view: the patch's parameters are linear in x and y, so nothing is fitted."""
        low, span = np.array(self.low), np.array(self.high) - np.array(self.low)
        poles = (arc.poles[:, :2] - low) / span
        steps = np.diff(poles, axis=0)
        if np.abs(steps - steps.mean(axis=0)).max() <= 1e-13:  # over a straight segment, evenly
            return line(poles[0], poles[-1])
        return Arc(poles, arc.weights)

    @property
    def patch(self) -> RationalPatch:
        """The fitted patch."""
        m, n = self.poles.shape
        x = np.linspace(self.low[0], self.high[0], m)
        y = np.linspace(self.low[1], self.high[1], n)
        grid = np.stack([*np.meshgrid(x, y, indexing="ij"), self.poles], axis=-1)
        return RationalPatch(grid, np.ones((m, n)))


def scaled_face(face: Face, scale: float) -> Face:
    """Return a face with its lengths multiplied by `scale` (design unit → mm)."""
    surface = resized(face.surface, scale)
    vx, vy, vz = face.vertex
    land = None if face.land is None else face.land * scale
    return replace(face, surface=surface, vertex=(vx * scale, vy * scale, vz * scale), land=land)


def posed_quadric(face: Face) -> PosedQuadric | None:
    """Return the quadric of a (scaled) face in its pose, or None if the surface is of another kind."""
    surface = face.surface
    if not isinstance(surface, Quadric):
        return None
    coefficients = (surface.curvature_x, surface.curvature_y, surface.kappa)
    return posed(coefficients, surface.side, face.rotation, np.asarray(face.vertex, dtype=np.float64))


def quadric_lens(quadric: PosedQuadric, boundary: Floats) -> QuadricLens:
    """Return a quadric lens whose patch covers the poles of its boundary arcs (k, 3) with a margin of 1 %.

    Raises
    ------
    ValueError
        The lens is so steep that the patch would have to pass its equator.
    """
    parameters, _ = quadric.parameters(boundary)
    low, high = parameters.min(axis=0), parameters.max(axis=0)
    spare = 0.01 * (high - low)
    low, high = low - spare, high + spare
    for degree in PATCH_DEGREES:
        lens = QuadricLens(quadric, (float(low[0]), float(high[0])), (float(low[1]), float(high[1])), degree)
        if float(lens.patch.weights.min()) >= STEEPEST:
            break
    else:
        raise CannotBuild(
            "CL133",
            "the lens is too steep for one rational patch: over its cell it comes near its equator; "
            "give it a longer radius, a smaller cell or a thicker web",
        )
    return lens


def fitted_lens(face: Face, zone: Floats, tolerance: float) -> FittedLens:
    """Fit a polynomial patch to any surface over the bounding rectangle of its zone.

    Parameters
    ----------
    face : Face
        Scaled to mm.
    zone : (m, 2), mm
        Corners of the optical zone.
    tolerance : float, mm
        The degree rises until the error on a 41 × 41 grid is below it, else the best within `LOOSEST` times
        is used.

    Raises
    ------
    ValueError
        The surface ends inside the rectangle, or the highest degree does not reach the tolerance.
    """
    low, high, fine = zone.min(axis=0), zone.max(axis=0), np.linspace(0.0, 1.0, 41)
    true = _heights(face, low, high, fine)
    best: FittedLens | None = None
    for degree in range(_degree_of(face), HIGHEST_DEGREE + 1):
        t = 0.5 - 0.5 * np.cos(np.pi * np.arange(degree + 1) / degree)
        basis = bernstein(degree, t)
        grid = _heights(face, low, high, t)
        poles = np.linalg.solve(basis, np.linalg.solve(basis, grid).T).T
        check = bernstein(degree, fine) @ poles @ bernstein(degree, fine).T
        error = float(np.max(np.abs(check - true)))
        if best is None or error < best.error:
            best = FittedLens(poles, (float(low[0]), float(low[1])), (float(high[0]), float(high[1])), error)
        if error <= tolerance:
            return best
    assert best is not None
    allowed = LOOSEST * tolerance
    if best.error > allowed:
        raise CannotBuild(
            "CL133",
            f"a polynomial patch of degree {HIGHEST_DEGREE} misses the surface by {best.error:.2g} mm "
            f"(allowed {allowed:.2g} mm); reduce its curvature or conic constant",
        )
    return best


def _degree_of(face: Face) -> int:
    """Initial degree: that of a face that is a polynomial in x and y, whose patch is then the face itself."""
    surface = face.surface
    return (surface.degree if isinstance(surface, EvenPolynomial) else None) or 4


def _heights(face: Face, low: Floats, high: Floats, t: Floats) -> Floats:
    x, y = np.meshgrid(low[0] + t * (high[0] - low[0]), low[1] + t * (high[1] - low[1]), indexing="ij")
    z = lens_height(face, x, y)
    if not np.isfinite(z).all():
        raise CannotBuild(
            "CL130",
            "the lens surface ends inside the rectangle round its optical zone; a longer radius or a smaller"
            " cell",
        )
    return z
