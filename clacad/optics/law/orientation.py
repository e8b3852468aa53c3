"""Orientation of the lenses in the sheet: Euler angles φ, θ, ψ and the matrix lens frame → sheet frame.

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
from math import atan2, cos, fmod, hypot, pi, radians, sin
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clacad.base.pairs import two_product, two_sum
from clacad.base.types import Floats

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

    Parameters
    ----------
    a, b, c, d : arrays of one shape, within the range of `clacad.base.pairs.two_product`
    """
    first, first_error = two_product(a, b)
    second, second_error = two_product(c, d)
    total, total_error = two_sum(first, -second)
    return total + (total_error + (first_error - second_error))


def power_of_two_scaled(vectors: Floats) -> Floats:
    """Rows scaled by powers of two so that the largest component lies in [1/2, 1): no rounding.

    Parameters
    ----------
    vectors : (n, 3) array

    Returns
    -------
    (n, 3) array
        Rows that are zero or not finite come back as they are.
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
