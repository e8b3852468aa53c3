"""Orientation of the lenses in the sheet (Euler angles φ, θ, ψ), and parameters of a law from its matrix.

Fixed axes (default): rotation by φ about the sheet's z axis, then by θ about its x axis, then by ψ about its
z axis, R = Rz(ψ) Rx(θ) Rz(φ), the literal text of Hamilton & Courtial 2009. Moving axes, the reading of
the source they cite: R = Rz(φ) Rx(θ) Rz(ψ). So fixed(φ, θ, ψ) = moving(ψ, θ, φ).

Differences of products without cancellation, and the angle between directions built from them.

A sum or product of two doubles equals its rounded value plus an error that is itself a double
(Dekker 1971, Knuth TAOCP 4.2.2). Carrying that error keeps differences such as m − δ m_z accurate to
the last place when the two terms cancel. This module must not be compiled with contracted products.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from math import atan2, cos, fmod, hypot, pi, radians, sin
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clacad.base.pairs import two_product, two_sum
from clacad.base.types import Floats
from clacad.base.vectors import axes_across

Axes = Literal["fixed", "moving"]
CosSin = Callable[[float], tuple[float, float]]

_QUARTER_TURNS = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))  # cos, sin of 0, 90, 180, 270°


def rotation(phi: float, theta: float, psi: float, axes: Axes = "fixed") -> Floats:
    """Rotation from the lens frame to the sheet frame, angles in radians.

    Parameters
    ----------
    phi, theta, psi : float, radians
        The double nearest to a multiple of 90° means that multiple: its sine and cosine are exact.
    axes : "fixed" or "moving"

    Returns
    -------
    (3, 3) array
        Columns: lens axes u, v and optical axis n = (sin ψ sin θ, −cos ψ sin θ, cos θ). Exactly the
        identity when all angles are 0.

    Raises
    ------
    ValueError
        If `axes` is neither "fixed" nor "moving".
    """
    if _ordered(axes) == "moving":
        phi, psi = psi, phi
    return _z_x_z(phi, theta, psi, _cos_sin)


def rotations(angles: Floats, axes: Axes = "fixed") -> Floats:
    """As `rotation`, (..., 3, 3), of φ, θ, ψ (..., 3), radians."""
    rows, which = np.unique(angles.reshape(-1, 3), axis=0, return_inverse=True)
    found = np.array([rotation(phi, theta, psi, axes) for phi, theta, psi in rows.tolist()])
    return found[which.ravel()].reshape(*angles.shape, 3)


def rotation_degrees(phi: float, theta: float, psi: float, axes: Axes = "fixed") -> Floats:
    """As `rotation`, angles in degrees: exact at every multiple of 90°.

    Parameters
    ----------
    phi, theta, psi : float, degrees
    axes : "fixed" or "moving"

    Returns
    -------
    (3, 3) array
    """
    if _ordered(axes) == "moving":
        phi, psi = psi, phi
    return _z_x_z(phi, theta, psi, _cos_sin_degrees)


def euler_angles(matrix: Floats) -> tuple[float, float, float]:
    """Fixed-axes φ, θ, ψ of a rotation, θ ≥ 0; where θ is 0 or 180°, ψ = 0.

    Parameters
    ----------
    matrix : (3, 3) array
        A proper rotation.

    Returns
    -------
    phi, theta, psi : float, radians
    """
    r = np.asarray(matrix, np.float64)
    tilt = hypot(r[2, 0], r[2, 1])
    if tilt < 1e-15:  # below the rounding of the matrix: only φ ± ψ has a meaning
        upright = 1.0 if r[2, 2] > 0 else -1.0
        return atan2(upright * r[1, 0], r[0, 0]), (0.0 if upright > 0 else pi), 0.0
    return atan2(r[2, 0], r[2, 1]), atan2(tilt, r[2, 2]), atan2(r[0, 2], -r[1, 2])


def _ordered(axes: str) -> str:
    if axes not in ("fixed", "moving"):
        raise ValueError(f'axes = {axes!r} is no Euler convention; use "fixed" or "moving"')
    return axes


def _cos_sin(angle: float) -> tuple[float, float]:
    """Cosine and sine; exact where the angle is the double nearest to a multiple of 90°."""
    turns = round(angle / (pi / 2))
    if angle in (turns * (pi / 2), radians(90.0 * turns)):
        return _QUARTER_TURNS[turns % 4]
    return cos(angle), sin(angle)


def _cos_sin_degrees(angle: float) -> tuple[float, float]:
    """Cosine and sine of degrees: reduced to ±45° first, which is exact, so quarter turns are too."""
    within = fmod(angle, 360.0)
    turns = round(within / 90.0)
    rest = radians(within - 90.0 * turns)
    c, s = _QUARTER_TURNS[turns % 4]
    return c * cos(rest) - s * sin(rest), s * cos(rest) + c * sin(rest)


def _z_x_z(phi: float, theta: float, psi: float, cos_sin: CosSin) -> Floats:
    """Rz(ψ) Rx(θ) Rz(φ)."""
    ct, st = cos_sin(theta)
    if st == 0.0:  # the axis is normal to the sheet: one rotation by φ ± ψ, rounded once
        c, s = cos_sin(phi + ct * psi)
        return np.array([[c, -s, 0.0], [ct * s, ct * c, 0.0], [0.0, 0.0, ct]]) + 0.0
    (cf, sf), (cp, sp) = cos_sin(phi), cos_sin(psi)
    return np.array(
        [
            [cp * cf - sp * ct * sf, -cp * sf - sp * ct * cf, sp * st],
            [sp * cf + cp * ct * sf, -sp * sf + cp * ct * cf, -cp * st],
            [st * sf, st * cf, ct],
        ]
    )


def difference_of_products(a: Floats, b: Floats, c: Floats, d: Floats) -> Floats:
    """a·b − c·d (n,) to about one unit in the last place of the result, also under cancellation.

    a, b, c, d : arrays of one shape, within the range of `clacad.base.pairs.two_product`
    """
    first, first_error = two_product(a, b)
    second, second_error = two_product(c, d)
    total, total_error = two_sum(first, -second)
    return total + (total_error + (first_error - second_error))


def power_of_two_scaled(vectors: Floats) -> Floats:
    """Rows scaled by powers of two so that the largest component lies in [1/2, 1): no rounding.

    vectors : (n, 3) array
    Returns (n, 3) array: Rows that are zero or not finite come back as they are.
    """
    largest = np.max(np.abs(vectors), axis=1)
    exponent = np.frexp(np.where(np.isfinite(largest), largest, 1.0))[1]
    return np.ldexp(vectors, -exponent[:, np.newaxis])


def is_direction(vectors: Floats) -> NDArray[np.bool_]:
    """Which rows (n,) of (n, 3) vectors are finite and not zero."""
    largest = np.max(np.abs(vectors), axis=1)  # NaN propagates, and is not greater than 0
    return np.asarray((largest > 0.0) & (largest < np.inf))


def angle_between(a: ArrayLike, b: ArrayLike) -> Floats:
    """Angle between directions, atan2(|a × b|, a · b): relative accuracy down to the tiniest angle.

    All angular errors are computed here. acos(a · b) loses every angle below 1.5e-8 rad, and a cross product
    whose terms are rounded before they cancel loses those below 1e-16; this function loses neither.

    Parameters
    ----------
    a, b : (..., 3) arrays, any length > 0
        Broadcast against each other.

    Returns
    -------
    (...) array, radians, 0 … π
        NaN where either vector is zero or not finite.
    """
    first, second = np.broadcast_arrays(np.asarray(a, np.float64), np.asarray(b, np.float64))
    shape = first.shape[:-1]
    p, q = power_of_two_scaled(first.reshape(-1, 3)), power_of_two_scaled(second.reshape(-1, 3))
    usable = is_direction(p) & is_direction(q)
    p, q = np.where(usable[:, np.newaxis], p, 1.0), np.where(usable[:, np.newaxis], q, 1.0)
    cross = np.stack(
        [difference_of_products(p[:, i], q[:, j], p[:, j], q[:, i]) for i, j in ((1, 2), (2, 0), (0, 1))]
    )
    # The largest component is taken out before squaring: 1e-200 rad must not underflow.
    largest = np.max(np.abs(cross), axis=0)
    unit = np.where(largest > 0, largest, 1.0)
    sine = largest * np.sqrt(np.sum((cross / unit) ** 2, axis=0))
    angle = np.arctan2(sine, np.sum(p * q, axis=1))
    return np.where(usable, angle, np.nan).reshape(shape)


_ROUNDING = 1e-12  # of |A₁||A₂|: far above the rounding of two matrices, far below any design's intent
_ACROSS = 1e-6  # cosine of an optical axis perpendicular to the light, with its rounding
_EDGE = 1e-9  # radians; φ = 45° is common in designs, and the range of φ ends there


class LawParameters(NamedTuple):
    """Parameters of a `Law`: η and δ (numbers), φ, θ, ψ (radians) and their convention."""

    eta_x: float
    eta_y: float
    delta_x: float
    delta_y: float
    phi: float
    theta: float
    psi: float
    axes: Axes = "fixed"

    @property
    def rotation(self) -> Floats:
        """(3, 3) rotation, lens frame → sheet frame; its last column is the optical axis."""
        return rotation(self.phi, self.theta, self.psi, self.axes)

    @property
    def optical_axis(self) -> Floats:
        """(3,) unit vector along the axis of lens 1 in the sheet frame."""
        return self.rotation[:, 2]

    def matrix(self) -> Floats:
        """(3, 3) matrix A in the sheet frame, d' ∝ A d: R M Rᵀ with A's eigenvalue along nᵀ equal to 1."""
        r = self.rotation
        lens = np.array(
            [
                [1.0 / self.eta_x, 0.0, -self.delta_x / self.eta_x],
                [0.0, 1.0 / self.eta_y, -self.delta_y / self.eta_y],
                [0.0, 0.0, 1.0],
            ]
        )
        return np.asarray(r @ lens @ r.T)


class Decomposition(NamedTuple):
    """A law read from a matrix for one assumed optical axis, with residuals that rate the axis."""

    law: LawParameters
    axis_residual: float
    asymmetry: float

    @property
    def optical_axis(self) -> Floats:
        """(3,) unit vector along the law's optical axis, sheet frame."""
        return self.law.optical_axis


def decompose(matrix: Floats, axis: Floats) -> Decomposition | None:
    """Read a law with the given optical axis from a matrix, d' ∝ A d.

    matrix : (3, 3) array
    axis : (3,) array. Assumed optical axis n, any length; taken with n_z > 0.
    Returns: The law of the nearest matrix of a Law with this axis; `axis_residual` = |nᵀA − k nᵀ| and
        `asymmetry` = antisymmetric part of A across n, both in the units of A. None where k = nᵀAn ≤ 0 or A
        across the axis is singular.
    """
    n = axis / np.linalg.norm(axis) * (1.0 if axis[2] > 0 else -1.0)
    k = float(n @ matrix @ n)
    if not k > 0.0:
        return None
    residual = float(np.linalg.norm(n @ matrix - k * n))

    # Principal axes: eigenvectors of the symmetric 2 × 2 block across n.
    across = axes_across(n)
    block = across.T @ matrix @ across / k
    asymmetry = float(abs(block[0, 1] - block[1, 0])) * k
    values, vectors = np.linalg.eigh((block + block.T) / 2)
    if not (np.isfinite(values).all() and np.all(values != 0.0)):
        return None
    u = across @ vectors[:, 0]
    frame = np.stack([u, np.cross(n, u), n], axis=1)

    offset = frame.T @ matrix @ n / k  # −δ_i/η_i along u and v
    phi, theta, psi = euler_angles(frame)
    eta = 1.0 / values
    numbers = [float(v) for v in (*eta, -offset[0] * eta[0], -offset[1] * eta[1])]
    if not np.isfinite(numbers).all():
        return None
    law = LawParameters(numbers[0], numbers[1], numbers[2], numbers[3], phi, theta, psi)
    return Decomposition(canonical(law), residual, asymmetry)


def candidate_axes(matrix: Floats) -> list[Floats]:
    """Optical axes that a Law's matrix, exact or noisy, can have.

    matrix : (3, 3) array
    Returns list of (3,) arrays.

    Notes
    -----
    The axis is a left eigenvector n with n · w = 0, w = (A₃₂ − A₂₃, A₁₃ − A₃₁, A₂₁ − A₁₂): A is then
    symmetric across n. Where two eigenvalues agree (η = 1 along an axis) every mixture of their vectors is a
    left eigenvector and n · w = 0 picks the one; rounding or noise may have split them into a complex pair.
    """
    values, vectors = np.linalg.eig(matrix.T)
    span = [part for v in vectors.T[values.imag >= 0] for part in (v.real, v.imag) if part.any()]
    w = np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
    mixed = [p * (q @ w) - q * (p @ w) for p, q in combinations(span, 2)]
    return [n for n in (*span, *mixed) if n.any()]


def compose(first: LawParameters, second: LawParameters) -> LawParameters:
    """`Law.then`: parameters of the law with matrix ∝ A₂A₁, or ValueError."""
    if np.array_equal(first.rotation, second.rotation):
        return LawParameters(
            first.eta_x * second.eta_x,
            first.eta_y * second.eta_y,
            first.delta_x + first.eta_x * second.delta_x,
            first.delta_y + first.eta_y * second.delta_y,
            first.phi,
            first.theta,
            first.psi,
            first.axes,
        )
    a1, a2 = first.matrix(), second.matrix()
    matrix = a2 @ a1
    allowed = _ROUNDING * float(np.linalg.norm(a1) * np.linalg.norm(a2))
    n1, n2 = first.optical_axis, second.optical_axis
    found = [d for n in (n1, n2, *candidate_axes(matrix)) if (d := decompose(matrix, n)) is not None]
    # An axis perpendicular to the light can keep the product symmetric too, but would refuse half the light.
    forward = [d for d in found if min(d.optical_axis @ n1, d.optical_axis @ n2) > _ACROSS]
    laws = [d for d in forward if max(d.axis_residual, d.asymmetry) <= allowed]
    if laws:
        return max(laws, key=lambda d: float(d.optical_axis @ (n1 + n2))).law
    raise ValueError(_why_not(n1, n2, min((d.asymmetry for d in forward), default=np.inf), matrix))


def _why_not(n1: Floats, n2: Floats, asymmetry: float, matrix: Floats) -> str:
    """Which condition of a composition failed, in words."""
    apart = float(np.degrees(angle_between(n1, n2)))
    if apart > 1e-9:
        return (
            "the two sheets do not compose to one: they have no common optical axis (theirs are"
            f" {apart:.3g} degrees apart, and across no axis that the product keeps is it symmetric); use the"
            " same theta and psi"
        )
    return (
        "the two sheets do not compose to one: their principal axes do not agree, so the product is not"
        " symmetric across the optical axis (antisymmetric part"
        f" {asymmetry / float(np.linalg.norm(matrix)):.3g} of its norm, a turn of the light about the axis);"
        " use the same phi + psi, or one sheet with eta_x = eta_y"
    )


def canonical(law: LawParameters) -> LawParameters:
    """`Law.canonical`: one parameter set for each law, by exact identities only."""
    phi, theta, psi = law.phi, law.theta, law.psi
    if law.axes == "moving":  # fixed(φ, θ, ψ) = moving(ψ, θ, φ)
        phi, psi = psi, phi
    theta = _wrapped(theta)
    if theta < 0.0:  # (φ, θ, ψ) ≡ (φ + 180°, −θ, ψ + 180°)
        phi, theta, psi = phi + pi, -theta, psi + pi
    if theta == 0.0:  # only the sum matters
        phi, psi = phi + psi, 0.0
    eta_x, eta_y, delta_x, delta_y = law.eta_x, law.eta_y, law.delta_x, law.delta_y
    phi = _wrapped(phi)
    if eta_x == eta_y:  # a round lens: rotating it rotates only its offset
        c, s = (1.0, 0.0) if phi == 0.0 else (cos(phi), sin(phi))
        delta_x, delta_y, phi = c * delta_x - s * delta_y, s * delta_x + c * delta_y, 0.0
    turns = int(np.ceil((phi - pi / 4 - _EDGE) / (pi / 2)))
    for _ in range(turns % 4):  # (η_x, η_y, δ_x, δ_y, φ + 90°) ≡ (η_y, η_x, −δ_y, δ_x, φ)
        eta_x, eta_y, delta_x, delta_y = eta_y, eta_x, -delta_y, delta_x
    return LawParameters(eta_x, eta_y, delta_x, delta_y, phi - turns * (pi / 2), theta, _wrapped(psi))


def _wrapped(angle: float) -> float:
    """The angle within (−π, π]; angles already there are kept bit for bit."""
    if -pi < angle <= pi:
        return angle
    return atan2(sin(angle), cos(angle))
