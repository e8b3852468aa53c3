"""From matrices back to laws: composition, and the canonical parameters of a law."""

from __future__ import annotations

from itertools import combinations
from math import atan2, cos, pi, sin
from typing import NamedTuple

import numpy as np

from clacad.base.types import Floats
from clacad.base.vectors import axes_across
from clacad.optics.law.orientation import Axes, angle_between, euler_angles, rotation

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

    Parameters
    ----------
    matrix : (3, 3) array
    axis : (3,) array
        Assumed optical axis n, any length; taken with n_z > 0.

    Returns
    -------
    Decomposition or None
        The law of the nearest matrix of a Law with this axis; `axis_residual` = |nᵀA − k nᵀ| and
        `asymmetry` = antisymmetric part of A across n, both in the units of A. None where k = nᵀAn ≤ 0
        or A across the axis is singular.
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

    Parameters
    ----------
    matrix : (3, 3) array

    Returns
    -------
    list of (3,) arrays

    Notes
    -----
    The axis is a left eigenvector n with n · w = 0, w = (A₃₂ − A₂₃, A₁₃ − A₃₁, A₂₁ − A₁₂): A is then
    symmetric
    across n. Where two eigenvalues agree (η = 1 along an axis) every mixture of their vectors is a left
    eigenvector and n · w = 0 picks the one; rounding or noise may have split them into a complex pair.
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
