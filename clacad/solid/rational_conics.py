"""Exact rational geometry of quadrics: surface patches, plane-section arcs, their parameter curves.

A quadric in any pose is covered by ONE 3×3 rational patch, a plane cuts it in ONE rational quadratic arc,
and the arc's curve in the patch's parameters is again a rational quadratic with the same parameter. Nothing
is fitted, nothing is tessellated; every formula is free of the cancellation of big radii.

Notation: local surface A x² + B y² + C z² − 2 s z = 0 (A, B, C curvatures, s = ±1 the side), pose
P = R p + d. In the sheet frame F(P) = (P−d)ᵀ M (P−d) + 2 q·(P−d), M = R diag(A, B, C) Rᵀ, q = −s R e_z.
Curves and patches are in Bézier form: poles and weights, parameter 0 … 1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clacad.base.types import Floats, Ints

STRAIGHT = 1e-15
"""Sine of the angle between end tangents below which an arc is a straight line in double precision."""


@dataclass(frozen=True, eq=False, slots=True)
class Arc:
    """A rational Bézier curve, parameter 0 … 1.

    poles : (n + 1, 3) or (n + 1, 2). Control points (lengths, or surface parameters).
    weights : (n + 1,)
    """

    poles: Floats
    weights: Floats

    @property
    def degree(self) -> int:
        """Degree n of the curve."""
        return len(self.poles) - 1

    @property
    def straight(self) -> bool:
        """Whether the curve is a straight line by construction (degree 1)."""
        return len(self.poles) == 2

    def at(self, t: Floats) -> Floats:
        """Points at parameters t (k,), as (k, dimension)."""
        basis = bernstein(self.degree, np.asarray(t, dtype=np.float64)) * self.weights
        return np.asarray((basis @ self.poles) / basis.sum(axis=1)[:, None])

    def moved(self, offset: Floats) -> Arc:
        """Return the curve displaced by `offset` (dimension,)."""
        return Arc(self.poles + offset, self.weights)

    def with_ends(self, first: float, last: float) -> Arc:
        """Return the curve with the z of its end poles replaced (lengths)."""
        poles = self.poles.copy()
        poles[0, 2], poles[-1, 2] = first, last
        return Arc(poles, self.weights)

    def elevated(self, degree: int) -> Arc:
        """Return the curve written with a higher degree."""
        poles, weights = self.poles, self.weights
        while len(weights) - 1 < degree:
            n = len(weights)
            share = np.arange(n + 1) / n
            homogeneous = np.column_stack([poles * weights[:, None], weights])
            padded = np.vstack([homogeneous, homogeneous[-1]])
            before = np.vstack([homogeneous[0], homogeneous])
            raised = share[:, None] * before + (1.0 - share)[:, None] * padded
            weights = raised[:, -1]
            poles = raised[:, :-1] / weights[:, None]
        return Arc(poles, weights)


@dataclass(frozen=True, eq=False, slots=True)
class RationalPatch:
    """A rational tensor-product Bézier patch, parameters 0 … 1.

    poles : (m + 1, n + 1, 3), lengths
    weights : (m + 1, n + 1)
    """

    poles: Floats
    weights: Floats

    def at(self, u: Floats, v: Floats) -> Floats:
        """Points at parameters u, v (k,), as (k, 3) lengths."""
        m, n = self.weights.shape
        along = bernstein(m - 1, np.asarray(u, dtype=np.float64))
        across = bernstein(n - 1, np.asarray(v, dtype=np.float64))
        basis = along[:, :, None] * across[:, None, :] * self.weights
        return np.asarray(np.einsum("kij,ijc->kc", basis, self.poles) / basis.sum(axis=(1, 2))[:, None])

    def elevated(self, degree: int) -> RationalPatch:
        """Return the patch written with a higher degree in both directions."""
        poles, weights = self.poles, self.weights
        for _ in range(2):  # columns of the net, then its rows
            arcs = [
                Arc(p, w).elevated(degree) for p, w in zip(np.moveaxis(poles, 1, 0), weights.T, strict=True)
            ]
            poles, weights = np.stack([arc.poles for arc in arcs]), np.stack([arc.weights for arc in arcs])
        return RationalPatch(poles, weights)


def bernstein(degree: int, t: Floats) -> Floats:
    """Bernstein basis at t (k,), as (k, degree + 1)."""
    from math import comb

    i = np.arange(degree + 1)
    choose = np.array([comb(degree, k) for k in range(degree + 1)], dtype=np.float64)
    return np.asarray(choose * t[:, None] ** i * (1.0 - t[:, None]) ** (degree - i))


@dataclass(frozen=True, eq=False, slots=True)
class PosedQuadric:
    """A quadric in its pose.

    curvatures : (3,). A, B, C of the local equation, 1/length.
    side : +1 or −1
    rotation : (3, 3). Lens → sheet.
    apex : (3,), lengths. Vertex d.
    matrix, linear : (3, 3), (3,). M and q of the sheet-frame equation.
    """

    curvatures: tuple[float, float, float]
    side: int
    rotation: Floats
    apex: Floats
    matrix: Floats
    linear: Floats

    def height(self, x: Floats, y: Floats) -> Floats:
        """Height z (lengths) of the graph over sheet points; NaN where there is none or past the equator.

        The root is computed as c0/(b ± sqrt(b² − M33 c0)), which is accurate for flat lenses.
        """
        m, q = self.matrix, self.linear
        dx, dy = np.asarray(x) - self.apex[0], np.asarray(y) - self.apex[1]
        b = m[0, 2] * dx + m[1, 2] * dy + q[2]
        c0 = m[0, 0] * dx * dx + 2.0 * m[0, 1] * dx * dy + m[1, 1] * dy * dy + 2.0 * (q[0] * dx + q[1] * dy)
        graph = np.sign(q[2])  # the branch through the apex keeps the sign of b
        with np.errstate(invalid="ignore", divide="ignore"):
            root = np.sqrt(b * b - m[2, 2] * c0)
            z = np.where(graph * b + root > 0.0, -c0 / (b + graph * root), np.nan)
        return np.asarray(self.apex[2] + z)

    def gradient(self, point: Floats) -> Floats:
        """Half the gradient of F at points (..., 3): M (P − d) + q, unnormalised normal."""
        return np.asarray((point - self.apex) @ self.matrix + self.linear)

    def value(self, point: Floats) -> Floats:
        """F at points (..., 3); zero on the surface (lengths)."""
        p = point - self.apex
        return np.asarray(np.einsum("...i,ij,...j->...", p, self.matrix, p) + 2.0 * (p @ self.linear))

    def parameters(self, point: Floats) -> tuple[Floats, Floats]:
        """Stereographic parameters (u, v) (..., 2) (lengths) of points on the surface, and the divisor (...).

        (u, v) = (x, y)/(1 − C s z/2). The map is projective, so it also carries the poles of an arc.
        """
        local = (point - self.apex) @ self.rotation
        divisor = 1.0 - 0.5 * self.curvatures[2] * self.side * local[..., 2]
        return np.asarray(local[..., :2] / divisor[..., None]), np.asarray(divisor)

    def moved(self, offset: Floats) -> PosedQuadric:
        """Return the quadric displaced by `offset` (3,)."""
        return PosedQuadric(
            self.curvatures, self.side, self.rotation, self.apex + offset, self.matrix, self.linear
        )


def posed(curvatures: tuple[float, float, float], side: int, rotation: Floats, apex: Floats) -> PosedQuadric:
    """Put a quadric (A, B, C; side) in its pose: rotation lens → sheet (3, 3), apex (3,)."""
    rotation = np.asarray(rotation, dtype=np.float64)
    matrix = rotation @ np.diag(curvatures) @ rotation.T
    linear = -side * rotation[:, 2]
    return PosedQuadric(
        curvatures, side, rotation, np.asarray(apex, dtype=np.float64), 0.5 * (matrix + matrix.T), linear
    )


def quadric_patch(quadric: PosedQuadric, u: tuple[float, float], v: tuple[float, float]) -> RationalPatch:
    """Cover a parameter rectangle of a quadric by one exact 3×3 rational patch.

    u, v : (low, high), lengths. Range of the stereographic parameters; see `PosedQuadric.parameters`.
    Returns: In the sheet frame; parameters 0 … 1 map to the given ranges.

    Notes
    -----
    (x, y, z) = (u, v, s Q/2)/(1 + C Q/4), Q = A u² + B v²: numerator and denominator are quadratic in u and
    v, so their Bézier nets follow by blossoming 1, u, u².
    """
    a, b, c = quadric.curvatures
    one = np.ones(3)
    lin_u, lin_v = np.array([u[0], 0.5 * (u[0] + u[1]), u[1]]), np.array([v[0], 0.5 * (v[0] + v[1]), v[1]])
    sq_u, sq_v = np.array([u[0] ** 2, u[0] * u[1], u[1] ** 2]), np.array([v[0] ** 2, v[0] * v[1], v[1] ** 2])
    q = a * np.outer(sq_u, one) + b * np.outer(one, sq_v)
    weights = 1.0 + 0.25 * c * q
    local = np.stack([np.outer(lin_u, one), np.outer(one, lin_v), 0.5 * quadric.side * q], axis=-1)
    local = local / weights[..., None]
    return RationalPatch(local @ quadric.rotation.T + quadric.apex, weights)


def section_arc(quadric: PosedQuadric, start: Floats, end: Floats, normal: Floats) -> Arc:
    """Cut a quadric by a plane: the exact rational arc between two points of the section.

    start, end : (3,), lengths
        Points of the section; the shorter arc between them is used (less than half a turn).
    normal : (3,). Normal of the cutting plane, any length.
    Returns: Degree 2. The middle pole is the intersection of the end tangents; the weight is w² =
        (DᵀMD/4)/(EᵀME), D = P2 − P0, E = P1 − P0, in which no big numbers cancel. A straight section has w =
        1.
    """
    chord = end - start
    tangent0 = _cross(normal, quadric.gradient(start))
    tangent2 = _cross(normal, quadric.gradient(end))
    tangent0 = tangent0 / np.linalg.norm(tangent0)
    tangent2 = tangent2 / np.linalg.norm(tangent2)
    turn = float(_cross(tangent0, tangent2) @ normal)
    if abs(turn) <= STRAIGHT * float(np.linalg.norm(normal)):
        middle, weight = 0.5 * (start + end), 1.0
    else:
        reach = float(_cross(chord, tangent2) @ normal) / turn
        to_middle = reach * tangent0
        middle = start + to_middle
        bend = float(to_middle @ quadric.matrix @ to_middle)
        square = 0.25 * float(chord @ quadric.matrix @ chord) / bend if bend != 0.0 else 1.0
        weight = float(np.sqrt(square)) if square > 0.0 else 1.0
    return Arc(np.array([start, middle, end]), np.array([1.0, weight, 1.0]))


def _cross(a: Floats, b: Floats) -> Floats:
    """Cross product of two vectors (3,), a tenth of `np.cross`'s time and the same bits."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def parameter_curve(quadric: PosedQuadric, arc: Arc, u: tuple[float, float], v: tuple[float, float]) -> Arc:
    """Return the exact curve of a section arc in the parameters of `quadric_patch(quadric, u, v)`.

    It has the arc's own parameter: at every t the patch at the curve's (u, v) is the arc's point. If the end
    poles of an arc were moved to a vertex, pass the unmoved arc.
    """
    poles, divisor = quadric.parameters(arc.poles)
    low, span = np.array([u[0], v[0]]), np.array([u[1] - u[0], v[1] - v[0]])
    weights = arc.weights * divisor
    return Arc((poles - low) / span, weights / weights[0])


def line(start: Floats, end: Floats) -> Arc:
    """Straight edge between two points (3,) or (2,), degree 1."""
    return Arc(np.array([start, end], dtype=np.float64), np.ones(2))


def ruled_wall(low: Arc, high: Arc) -> RationalPatch:
    """Rule a wall between two arcs: degree (n, 1), v = 0 is `low` and v = 1 is `high` with their own
    parameters.

    In homogeneous coordinates S(u, v) = (1 − v) low(u) + v high(u). Both arcs and the wall lie in one
    vertical plane. ∂S/∂u × ∂S/∂v points along (direction of the arcs) × up.
    """
    degree = max(low.degree, high.degree)
    low, high = low.elevated(degree), high.elevated(degree)
    return RationalPatch(
        np.stack([low.poles, high.poles], axis=1), np.stack([low.weights, high.weights], axis=1)
    )


# -- many cells at once: the formulas above in arrays ---------------------------------------------------


@dataclass(frozen=True, eq=False)
class LensGeometry:
    """Patches and border arcs of n cells, each in the frame of its cell.

    patch, patch_weights : (n, 3, 3, 3), (n, 3, 3)
    arcs, weights : (n, m, 3, 3), (n, m, 3). Arc over every side of the tile.
    curves, curve_weights : (n, m, 3, 2), (n, m, 3). The same arcs in the parameters of the patch.
    """

    patch: Floats
    patch_weights: Floats
    arcs: Floats
    weights: Floats
    curves: Floats
    curve_weights: Floats


@dataclass(frozen=True, eq=False)
class LensArray:
    """One lens face, a quadric, of every cell of a sheet; one row where all cells are alike.

    face : 0 front, 1 back
    side : +1 or −1
    land : Height of the face's land.
    rotation : (3, 3), or (n, 3, 3) of each. Lens → sheet.
    curvatures : (n, 3), 1/mm. A, B, C of the local equation (see `clacad.solid.rational_conics`).
    apex : (n, 3). In the cell frame.
    """

    face: int
    side: int
    land: float | None
    rotation: Floats
    curvatures: Floats
    apex: Floats

    @property
    def alike(self) -> bool:
        """Whether one row describes all cells."""
        return len(self.apex) == 1

    def of(self, cells: Ints) -> LensArray:
        """The lenses of some cells; one row where all are alike."""
        if self.alike:
            return self
        turn = self.rotation if self.rotation.ndim == 2 else self.rotation[cells]
        return replace(self, curvatures=self.curvatures[cells], apex=self.apex[cells], rotation=turn)

    @property
    def matrix(self) -> Floats:
        """M of the sheet-frame equation, (n, 3, 3)."""
        turn = self.rotation
        return np.asarray(np.einsum("...ia,...a,...ja->...ij", turn, self.curvatures, turn))

    @property
    def _turns(self) -> Floats:
        """Rotations that multiply points (n, m, k, 3)."""
        return self.rotation if self.rotation.ndim == 2 else self.rotation[:, None]

    @property
    def linear(self) -> Floats:
        """Vector q, (3,) or (n, 3), of the sheet-frame equation."""
        return np.asarray(-self.side * self.rotation[..., 2])

    def heights(self, x: Floats, y: Floats) -> Floats:
        """Heights (n, k) over points x, y, (k,) or (n, k), of the cell frames; NaN where there is none."""
        m, q = self.matrix[:, :, :, None], self.linear.T[..., None]
        dx, dy = x - self.apex[:, :1], y - self.apex[:, 1:2]
        b = m[:, 0, 2] * dx + m[:, 1, 2] * dy + q[2]
        square = m[:, 0, 0] * dx * dx + 2.0 * m[:, 0, 1] * dx * dy + m[:, 1, 1] * dy * dy
        c0 = square + 2.0 * (q[0] * dx + q[1] * dy)
        graph = np.sign(q[2])
        with np.errstate(invalid="ignore", divide="ignore"):
            root = np.sqrt(b * b - m[:, 2, 2] * c0)
            z = np.where(graph * b + root > 0.0, -c0 / (b + graph * root), np.nan)
        return np.asarray(self.apex[:, 2:] + z)

    def geometry(self, starts: Floats, ends: Floats) -> LensGeometry:
        """Patches and arcs over the segments from `starts` to `ends`, (m, 2) each, which bound the cells."""
        arcs, weights = self._sections(starts, ends)
        points, divisor = self._parameters(arcs)
        low, high = points.min(axis=(1, 2)), points.max(axis=(1, 2))
        spare = 0.01 * (high - low)
        low, high = low - spare, high + spare
        patch, patch_weights = self._patches(low, high)
        curves = (points - low[:, None, None]) / (high - low)[:, None, None]
        curve_weights = weights * divisor
        return LensGeometry(
            patch, patch_weights, arcs, weights, curves, curve_weights / curve_weights[..., :1]
        )

    def _sections(self, starts: Floats, ends: Floats) -> tuple[Floats, Floats]:
        """Exact arcs over segments; see `clacad.solid.rational_conics.section_arc`."""
        x, y = np.concatenate([starts, ends]).T
        z = self.heights(x, y)
        many, sides = len(z), len(starts)
        start = np.concatenate([np.broadcast_to(starts, (many, sides, 2)), z[:, :sides, None]], axis=2)
        end = np.concatenate([np.broadcast_to(ends, (many, sides, 2)), z[:, sides:, None]], axis=2)
        way = ends - starts
        normal = np.column_stack([-way[:, 1], way[:, 0], np.zeros(sides)]) / np.hypot(*way.T)[:, None]
        matrix, chord = self.matrix[:, None], end - start
        first, last = (self._tangent(point, normal, matrix) for point in (start, end))
        turn = _triple(first, last, normal)
        bent = np.abs(turn) > STRAIGHT
        reach = _triple(chord, last, normal) / np.where(bent, turn, 1.0)
        middle = reach[..., None] * first
        bend = _form(middle, matrix)
        square = 0.25 * _form(chord, matrix) / np.where(bent & (bend != 0.0), bend, 1.0)
        weight = np.where(bent & (bend != 0.0) & (square > 0.0), np.sqrt(np.abs(square)), 1.0)
        inner = start + np.where(bent[..., None], middle, 0.5 * chord)
        one = np.ones_like(weight)
        return np.stack([start, inner, end], axis=2), np.stack([one, weight, one], axis=2)

    def _tangent(self, point: Floats, normal: Floats, matrix: Floats) -> Floats:
        gradient = (
            np.einsum(
                "nki,nkij->nkj", point - self.apex[:, None], np.broadcast_to(matrix, (*point.shape[:2], 3, 3))
            )
            + self.linear[..., None, :]
        )
        tangent = np.cross(np.broadcast_to(normal, gradient.shape), gradient)
        return np.asarray(tangent / np.linalg.norm(tangent, axis=2)[..., None])

    def _parameters(self, points: Floats) -> tuple[Floats, Floats]:
        """Stereographic parameters (n, m, k, 2) of points (n, m, k, 3), and the divisor (n, m, k)."""
        local = (points - self.apex[:, None, None]) @ self._turns
        divisor = 1.0 - 0.5 * self.side * self.curvatures[:, 2, None, None] * local[..., 2]
        return np.asarray(local[..., :2] / divisor[..., None]), np.asarray(divisor)

    def _patches(self, low: Floats, high: Floats) -> tuple[Floats, Floats]:
        """Poles (n, 3, 3, 3) and weights (n, 3, 3); see `clacad.solid.rational_conics.quadric_patch`."""
        a, b, c = self.curvatures.T[:, :, None, None]
        middle = 0.5 * (low + high)
        u, v = (np.stack([low[:, i], middle[:, i], high[:, i]], axis=1) for i in (0, 1))
        uu, vv = (np.stack([low[:, i] ** 2, low[:, i] * high[:, i], high[:, i] ** 2], axis=1) for i in (0, 1))
        q = a * uu[:, :, None] + b * vv[:, None, :]
        weights = 1.0 + 0.25 * c * q
        u, v = np.broadcast_arrays(u[:, :, None], v[:, None, :])
        local = np.stack([u, v, 0.5 * self.side * q], axis=-1) / weights[..., None]
        return local @ self._turns.swapaxes(-1, -2) + self.apex[:, None, None], weights


def _triple(a: Floats, b: Floats, normal: Floats) -> Floats:
    return np.asarray((np.cross(a, b) * normal).sum(axis=2))


def _form(a: Floats, matrix: Floats) -> Floats:
    return np.asarray(np.einsum("nki,nkij,nkj->nk", a, np.broadcast_to(matrix, (*a.shape[:2], 3, 3)), a))
