"""From matrices back to laws: composition, and the canonical parameters of a law."""

from __future__ import annotations

from math import atan2, cos, pi, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clacad.law.model import Law
from clacad.law.rotation import euler_angles

Floats = NDArray[np.float64]

_ROUNDING = 1e-12  # of |A₁||A₂|: far above the rounding of two matrices, far below any design's intent
_EDGE = 1e-9  # radians; φ = 45° is common in designs, so the edge of the range of φ lies just beside it


class Decomposition(NamedTuple):
    """A Law read from a matrix for one supposed optical axis, and how badly the axis fits."""

    law: Law
    axis_residual: float
    asymmetry: float


def decompose(matrix: Floats, axis: Floats) -> Decomposition | None:
    """Read a Law with the given optical axis from a matrix, d' ∝ A d.

    Parameters
    ----------
    matrix : (3, 3) array
    axis : (3,) array
        Supposed optical axis n, any length; taken with n_z > 0.

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
    helper = np.eye(3)[np.argmin(np.abs(n))]
    e1 = np.cross(helper, n)
    e1 /= np.linalg.norm(e1)
    across = np.stack([e1, np.cross(n, e1)], axis=1)
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
    law = Law(eta[0], eta[1], -offset[0] * eta[0], -offset[1] * eta[1], phi, theta, psi)
    return Decomposition(canonical(law), residual, asymmetry)


def candidate_axes(matrix: Floats) -> list[Floats]:
    """Real left eigenvectors of positive eigenvalue: the optical axes a Law's matrix can have.

    Parameters
    ----------
    matrix : (3, 3) array

    Returns
    -------
    list of (3,) arrays
    """
    values, vectors = np.linalg.eig(matrix.T)
    real = (np.abs(values.imag) <= 1e-9 * np.abs(values)) & (values.real > 0)
    return [vectors[:, i].real for i in range(3) if real[i] and vectors[:, i].real.any()]


def compose(first: Law, second: Law) -> Law:
    """`Law.then`: the Law with matrix ∝ A₂A₁, or ValueError."""
    if np.array_equal(first.rotation, second.rotation):
        return Law(
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
    axes = [first.optical_axis, second.optical_axis, *candidate_axes(matrix)]
    found = [d for n in axes if (d := decompose(matrix, n)) is not None]
    with_axis = [d for d in found if d.axis_residual <= allowed]
    laws = [d for d in with_axis if d.asymmetry <= allowed]
    if laws:
        middle = first.optical_axis + second.optical_axis
        return max(laws, key=lambda d: float(d.law.optical_axis @ middle)).law
    if with_axis:
        worst = min(d.asymmetry for d in with_axis) / float(np.linalg.norm(matrix))
        raise ValueError(
            "the two sheets do not compose to one: their principal axes do not agree, so the product is not "
            f"symmetric across the optical axis (antisymmetric part {worst:.3g} of its norm, a turn of the "
            "light about the axis); use the same phi + psi, or one sheet with eta_x = eta_y"
        )
    tilt = float(np.degrees(np.arccos(np.clip(first.optical_axis @ second.optical_axis, -1.0, 1.0))))
    raise ValueError(
        "the two sheets do not compose to one: they have no common optical axis (no real left eigenvector of "
        f"the product with a positive eigenvalue keeps its direction; their axes stand {tilt:.3g} degrees "
        "apart); use the same theta and psi"
    )


def canonical(law: Law) -> Law:
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
    if eta_x == eta_y:  # a round lens: turning it turns only its offset
        c, s = (1.0, 0.0) if phi == 0.0 else (cos(phi), sin(phi))
        delta_x, delta_y, phi = c * delta_x - s * delta_y, s * delta_x + c * delta_y, 0.0
    turns = int(np.ceil((phi - pi / 4 - _EDGE) / (pi / 2)))
    for _ in range(turns % 4):  # (η_x, η_y, δ_x, δ_y, φ + 90°) ≡ (η_y, η_x, −δ_y, δ_x, φ)
        eta_x, eta_y, delta_x, delta_y = eta_y, eta_x, -delta_y, delta_x
    return Law(eta_x, eta_y, delta_x, delta_y, phi - turns * (pi / 2), theta, _wrapped(psi))


def _wrapped(angle: float) -> float:
    """The angle within (−π, π]; angles already there are kept bit for bit."""
    if -pi < angle <= pi:
        return angle
    return atan2(sin(angle), cos(angle))
