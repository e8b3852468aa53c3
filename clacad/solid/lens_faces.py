"""Lens faces of a body as exact B-Rep geometry in the cell frame, lengths in millimetres.

A quadric is exact: rational patch, rational arcs. Any other surface (a biconic) is replaced by ONE polynomial
patch z(x, y) over its cell, fitted at Chebyshev points. Its error is measured and stated, and its border
curves lie exactly on the fitted patch. An upright even polynomial on a paraboloid is an exact patch of its
own degree.

The ends of lenses are their common rims, and those on their land. A plane cuts a quadric in a conic, whose
arcs are exact; all other rims are fitted (`clacad.solid.fitted_rims`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from clacad.base.text import rounded_up
from clacad.base.types import Floats
from clacad.optics.surface import EvenPolynomial, Quadric, resized
from clacad.sheet.window import Face, lens_height
from clacad.solid.face_pattern import Kind, Pattern, Proud, divided_pattern, plain_pattern
from clacad.solid.fitted_rims import Gap, Graph, Rim, fitted_rim, lens_graph, level_graph
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
from clacad.topology.complex_parts import CannotBuild

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

    Raises ValueError: The lens is so steep that the patch would have to pass its equator.
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

    face : Scaled to mm.
    zone : (m, 2), mm. Corners of the optical zone.
    tolerance : mm. The degree rises until the error on a 41 × 41 grid is below it, else the best within
        `LOOSEST` times is used.
    Raises ValueError: The surface ends inside the rectangle, or the highest degree does not reach the
        tolerance.
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
    if best.error > LOOSEST * tolerance:
        raise CannotBuild(
            "CL133",
            f"a polynomial patch of degree {HIGHEST_DEGREE} misses the surface by {best.error:.2g} mm "
            f"(allowed {LOOSEST * tolerance:.2g} mm); reduce its curvature or conic constant",
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


UNDERCUT = 1e-6
"""A rim point further (mm) from the graph of its lens belongs to the other half of the surface."""


def common_rim(faces: tuple[Face, Face], zone: Floats, tolerance: float) -> tuple[Rim | None, Proud | None]:
    """The rim in which both faces of a body end.

    Where land bounds them, where the lens has positive thickness.

    Both results are None where the lens covers its zone.

    Raises CannotBuild: CL131: see `_check_web`. CL130, CL132, CL133: no such rim can be made.
    """
    lenses = [face for face in faces if face.array is not None]
    rim = _meeting(faces, zone, tolerance) if lenses else None
    if rim is None:
        return None, None
    if None not in [face.land for face in lenses]:
        if len(lenses) == 2:
            _check_web(faces, rim, zone)
        return None, Gap(_graph(faces[0]), _graph(faces[1])).proud
    if not any(region.kind == "lens" for region in rim.pattern.regions):
        raise CannotBuild(
            "CL130",
            "the faces of the lens enclose nothing over its cell: the surface ends inside its cell at its own"
            " equator, or lies beyond the other face; a longer radius (pair.separation), a smaller"
            " lattice.pitch, or more pair.thickness",
        )
    return rim, None


def _meeting(faces: tuple[Face, Face], zone: Floats, tolerance: float) -> Rim | None:
    """Intersection of the two faces of a body above its zone; None where the lens covers its zone.

    Two poses of one quadric intersect in a plane, and so do a quadric and a plane: their rim is exact. Others
    are fitted.
    """
    first, second = (posed_quadric(face) for face in faces)
    if first is not None and second is not None:
        x, y = zone_samples(zone)
        with np.errstate(invalid="ignore"):
            if (first.height(x, y) < second.height(x, y)).all():
                return None
        plane = _meeting_plane(faces, first, second)
        if plane is not None:

            def proud(px: Floats, py: Floats) -> NDArray[np.bool_]:
                with np.errstate(invalid="ignore"):
                    return np.asarray(first.height(px, py) < second.height(px, py))

            return _exact_rim(first if faces[0].array is not None else second, zone, plane, proud, "none")
    rim = fitted_rim(Gap(_graph(faces[0]), _graph(faces[1])), zone, "none", tolerance)
    return None if _covers(rim.pattern) else rim


def _graph(face: Face) -> Graph:
    return level_graph(face.vertex[2]) if face.array is None else lens_graph(face)


def _covers(pattern: Pattern) -> bool:
    return not pattern.chains and [region.kind for region in pattern.regions] == ["lens"]


def _meeting_plane(faces: tuple[Face, Face], first: PosedQuadric, second: PosedQuadric) -> Floats | None:
    """The plane z = c0 + c1 x + c2 y in which two faces intersect; None if there is none."""
    for face in faces:
        if face.array is None:
            return np.array([face.vertex[2], 0.0, 0.0])
    if not np.allclose(first.matrix, second.matrix, rtol=0.0, atol=1e-12 * float(np.abs(first.matrix).max())):
        return None
    # F_front − F_back is linear when both are poses of one quadric: their common points lie in a plane.
    gradient = 2.0 * (
        (first.linear - first.matrix @ first.apex) - (second.linear - second.matrix @ second.apex)
    )
    constant = float(first.value(np.zeros(3)) - second.value(np.zeros(3)))
    if abs(gradient[2]) < 1e-6 * float(np.linalg.norm(gradient)):
        return None
    return np.asarray(-np.array([constant, gradient[0], gradient[1]]) / gradient[2])


def _check_web(faces: tuple[Face, Face], rim: Rim, zone: Floats) -> None:
    """Refuse a web from which a tilted lens's rim protrudes: the union of lens and plate is no column there.

    At a rim point outside the plate, front and back of the lens meet at a height h above the plate's upper
    face (or below its lower one). Just inside the rim both faces are near h, so on one vertical line there is
    air between plate and lens. The lens overhangs the plate, which neither a height field nor a mould or an
    etch can make. (Meshes of such a design fill the space below the overhang: every column is solid from its
    lowest face to its highest, as in the tracer.) If the whole rim lies in the plate, nothing overhangs. Over
    the region inside the rim the front of a convex lens is a convex function of (x, y), with its maximum on
    the rim. So the front is nowhere above the plate's upper face, and the back nowhere below its lower one.

    Raises CannotBuild: CL131, with the thickness of a web that contains the rim.
    """
    front, back = faces
    assert front.land is not None
    assert back.land is not None
    arcs = [arc for chain in rim.arcs for arc in chain]
    if not arcs:
        return
    z = np.concatenate([arc.at(_ALONG)[:, 2] for arc in arcs])
    middle = 0.5 * (front.land + back.land)
    reach = float(np.abs(z - middle).max())
    if 2.0 * reach <= (back.land - front.land) * (1.0 + 1e-9):
        return
    x, y = zone_samples(zone)
    low, high = lens_graph(front)(x, y)[0], lens_graph(back)(x, y)[0]
    with np.errstate(invalid="ignore"):
        proud = (low <= high) & ((low < middle - reach) | (high > middle + reach))
    buries = "" if proud.any() else ", and buries it: the lens is too thin for its tilt"
    raise CannotBuild(
        "CL131",
        f"the rim of the tilted lens sticks out of its web; a web of at least {rounded_up(2.0 * reach)} mm"
        " holds it"
        f"{buries} (or give the lens more thickness, so that its rim leaves the cell: pair.thickness ="
        ' "auto")',
    )


_ALONG = np.linspace(0.0, 1.0, 1025)  # the highest point of an arc is missed by 1e-7 of its height at most


def zone_samples(zone: Floats) -> tuple[Floats, Floats]:
    """Points over a convex zone, its corners and sides included: (n,) each."""
    share = np.linspace(0.0, 1.0, 17)
    sides = [a + share[:, None] * (b - a) for a, b in zip(zone, np.roll(zone, -1, axis=0))]
    border = np.concatenate(sides)
    points = np.concatenate([border * r for r in np.linspace(0.0, 1.0, 9)])
    return points[:, 0], points[:, 1]


def _conic(quadric: PosedQuadric, plane: Floats) -> Floats:
    """Conic (3, 3) in x, y that the plane z = plane · (1, x, y) cuts from a quadric."""
    m, q, d = quadric.matrix, quadric.linear, quadric.apex
    linear = q - m @ d
    full = np.zeros((4, 4))
    full[:3, :3], full[:3, 3], full[3, :3] = m, linear, linear
    full[3, 3] = float(d @ m @ d - 2.0 * q @ d)
    lift = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [plane[1], plane[2], plane[0]], [0.0, 0.0, 1.0]])
    return np.asarray(lift.T @ full @ lift)


def land_rim(face: Face, thick: Proud | None, zone: Floats, tolerance: float) -> Rim:
    """Rim at which a lens ends on its land, if it has land.

    `thick`: where the lens has material at all. The surface of a thin tilted lens may leave its land again
    far beyond the end of the lens.
    """
    quadric, land = posed_quadric(face), face.land
    if land is None:
        return Rim(plain_pattern(zone, "lens"), ())
    if quadric is None:
        lens, level = lens_graph(face), level_graph(land)
        gap = Gap(lens, level, thick) if face.land_side > 0 else Gap(level, lens, thick)
        return fitted_rim(gap, zone, "land", tolerance)

    def proud(x: Floats, y: Floats) -> NDArray[np.bool_]:
        with np.errstate(invalid="ignore"):
            out = np.asarray(face.land_side * (quadric.height(x, y) - land) < 0.0)
        return out if thick is None else out & thick(x, y)

    x, y = zone_samples(zone)
    if proud(x, y).all():
        return Rim(plain_pattern(zone, "lens"), ())
    return _exact_rim(quadric, zone, np.array([land, 0.0, 0.0]), proud, "land")


def _exact_rim(quadric: PosedQuadric, zone: Floats, plane: Floats, proud: Proud, rest: Kind) -> Rim:
    """The rim in which a plane z = plane · (1, x, y) cuts a quadric."""
    pattern = divided_pattern(zone, _conic(quadric, plane), proud, rest)
    normal = np.array([-plane[1], -plane[2], 1.0])
    arcs = tuple(
        _rim_arcs(quadric, chain.points, chain.first is None, plane, normal) for chain in pattern.chains
    )
    return Rim(pattern, arcs)


def _rim_arcs(
    quadric: PosedQuadric, points: Floats, closed: bool, plane: Floats, normal: Floats
) -> tuple[Arc, ...]:
    z = plane[0] + points @ plane[1:]
    lifted = np.column_stack([points, z])
    away = np.abs(quadric.height(points[:, 0], points[:, 1]) - z)
    if not (away <= UNDERCUT).all():
        raise CannotBuild(
            "CL133",
            "the lens is undercut at its rim: its surface passes its equator before it meets its land or"
            " other face; tilt it less, or give it a longer radius",
        )
    following = np.roll(lifted, -1, axis=0) if closed else lifted[1:]
    return tuple(section_arc(quadric, a, b, normal) for a, b in zip(lifted, following))
