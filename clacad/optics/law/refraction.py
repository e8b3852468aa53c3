"""Directions behind a sheet by the law, with δ and η common to all directions or one value for each.

Homogeneous form: m = Rᵀd, then (m_x − δ_x m_z)/η_x, (m_y − δ_y m_z)/η_y, m_z. No slope is formed, so nothing
is divided by m_z. The differences are compensated: light that leaves along the axis because t ≈ δ keeps its
relative accuracy. Powers of two are carried apart, so neither 1e±200 in d nor |δ| = 1e200 nor η = 1e±200
overflows.

The law in one plane: the paper's equation 6 and its small-angle form, equation 10.

Embedded in three dimensions (x–z plane, tilt towards +x) it is the Law with
(φ, θ, ψ) = (−90°, θ, 90°), fixed axes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from clacad.base.pairs import two_product, two_sum
from clacad.base.types import Cells, Floats, Pair2

_HEADROOM = 500  # rows are scaled to 2**500: the rounding errors of tiny components stay representable
_BLOCK = 8192  # rows at a time: the temporaries stay in the cache


def refracted(eta: Pair2 | Floats, delta: Pair2 | Floats, turn: Floats, d: ArrayLike) -> Floats:
    """Directions behind a sheet; `Law.refract` lists the cases without an answer.

    eta : (2,) numbers, or (n, 2) array. η along the lens axes: of the sheet, or of each direction.
    delta : (2,) numbers, or (n, 2) array. δ along the lens axes: of the sheet, or of each direction.
    turn : (3, 3), or (n, 3, 3) array. Lens → sheet: of the sheet, or of each direction.
    d : (n, 3) array, or (..., 3) where δ is one
        Directions in the sheet frame, any length > 0; (n, 3) also where η is of each.
    Returns array of the shape of d: Unit directions, NaN rows where the law has no answer.
    Raises ValueError: If the last dimension of d is not 3.
    """
    directions = np.asarray(d, np.float64)
    if directions.ndim == 0 or directions.shape[-1] != 3:
        raise ValueError(f"directions have shape {directions.shape}; the last dimension must be 3")
    rows = directions.reshape(-1, 3)
    out = np.empty(rows.shape)
    each, ratio = np.asarray(delta, np.float64), np.asarray(eta, np.float64)
    for start in range(0, len(rows), _BLOCK):
        block = slice(start, start + _BLOCK)
        of_rows = [(one if one.ndim == 1 else one[block]).T for one in (ratio, each)]
        axes = turn if turn.ndim == 2 else np.moveaxis(turn[block], 0, -1)
        out[block] = _refract_rows(of_rows[0], of_rows[1], axes, rows[block])
    return out.reshape(directions.shape)


def _refract_rows(eta: Floats, delta: Floats, r: Floats, directions: Floats) -> Floats:
    """`refracted` for (n, 3) directions; η and δ are (2,) or (2, n), r is (3, 3) or (3, 3, n)."""
    # Scale rows by powers of two; rows without an answer are replaced by the sheet's normal.
    largest = np.maximum(
        np.maximum(np.abs(directions[:, 0]), np.abs(directions[:, 1])), np.abs(directions[:, 2])
    )
    answered = (directions[:, 2] > 0.0) & (largest < np.inf)
    rows = np.where(answered[:, np.newaxis], directions, (0.0, 0.0, 1.0))
    shift = _HEADROOM - np.frexp(np.where(answered, largest, 1.0))[1]
    x, y, z = np.ldexp(rows.T, shift)

    # Rotate into the lens frame; untilted sheets skip it, which keeps tiny components relative.
    turned = not np.array_equal(r, np.eye(3))
    if turned:
        x, y, z = _times(r.swapaxes(0, 1), x, y, z)
        answered &= z > 0.0

    # Apply M; each component is significand · 2**exponent.
    x, e_x = _offset_and_divide(x, z, delta[0], eta[0])
    y, e_y = _offset_and_divide(y, z, delta[1], eta[1])
    x, y, z = _common_scale(x, e_x, y, e_y, z)

    # Rotate back and reject invalid exits.
    if turned:
        x, y, z = _times(r, x, y, z)
    answered &= z > 0.0
    length = np.sqrt(x * x + y * y + z * z)
    out = np.stack([x, y, z], axis=1) / np.where(answered, length, 1.0)[:, np.newaxis]
    return np.where(answered[:, np.newaxis], out, np.nan)


def _times(matrix: Floats, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats, Floats]:
    """Matrix times columns, summed in a fixed order: a ray alone and in a batch agree to the last bit."""
    a, b, c = ((row[0] * x + row[1] * y) + row[2] * z for row in matrix)
    return a, b, c


def _offset_and_divide(m: Floats, m_z: Floats, delta: Floats, eta: Floats) -> tuple[Floats, Cells]:
    """(m − δ m_z)/η as q · 2**k, δ and η a number or (n,): q (n,) and k; difference compensated."""
    eta_significand, eta_exponent = np.frexp(eta)
    up: Cells = np.where(delta != 0.0, np.maximum(np.frexp(delta)[1], 0), 0)
    if np.any(delta):
        product, product_error = two_product(np.ldexp(delta, -up), m_z)
        total, total_error = two_sum(np.ldexp(m, -up), -product)
        m = total + (total_error - product_error)
    return m / eta_significand, up - eta_exponent


def _common_scale(x: Floats, e_x: Cells, y: Floats, e_y: Cells, z: Floats) -> tuple[Floats, Floats, Floats]:
    """Bring x · 2**e_x, y · 2**e_y and z to one common power of two per row: the largest is about 1."""
    top: Cells = np.frexp(z)[1]
    for q, e in ((x, e_x), (y, e_y)):
        top = np.maximum(top, np.where(q != 0.0, np.frexp(q)[1] + e, top))
    return np.ldexp(x, e_x - top), np.ldexp(y, e_y - top), np.ldexp(z, -top)


def refract_2d(alpha_1: ArrayLike, eta: float, delta: float = 0.0, theta: float = 0.0) -> Floats:
    """Angle behind the sheet, tan(α₂ − θ) = (tan(α₁ − θ) − δ)/η (Hamilton & Courtial 2009, eq. 6).

    Parameters
    ----------
    alpha_1 : array, radians
        Angle to the sheet's normal before the sheet.
    eta, delta : float
    theta : float, radians
        Tilt of the optical axis, towards positive α.

    Returns
    -------
    array, radians
        NaN where the law has no answer: α₁ or α₁ − θ not within ±90° (from behind the sheet or the
        lens), or the exit turned back through the sheet.

    Raises
    ------
    ValueError
        If eta is 0 or a parameter is not finite.
    """
    _refuse_impossible(eta, delta, theta)
    alpha = np.asarray(alpha_1, np.float64)
    forward = (np.abs(alpha) < np.pi / 2) & (np.abs(alpha - theta) < np.pi / 2)
    slope = np.tan(np.where(forward, alpha - theta, 0.0))
    with np.errstate(over="ignore"):  # an infinite slope is 90° to the axis, which the next lines reject
        out = theta + np.arctan((slope - delta) / eta)
    return np.where(forward & (np.abs(out) < np.pi / 2), out, np.nan)


def small_angle_2d(alpha_1: ArrayLike, eta: float, delta: float = 0.0, theta: float = 0.0) -> Floats:
    """Small-angle form α₂ ≈ α₁/η + ((η − 1)θ − δ)/η (Hamilton & Courtial 2009, eq. 10).

    Its error is of third order in the angles. It shows that θ acts as an offset δ = (1 − η)θ.

    Parameters
    ----------
    alpha_1 : array, radians
    eta, delta : float
    theta : float, radians

    Returns
    -------
    array, radians

    Raises
    ------
    ValueError
        If eta is 0 or a parameter is not finite.
    """
    _refuse_impossible(eta, delta, theta)
    return np.asarray(alpha_1, np.float64) / eta + ((eta - 1.0) * theta - delta) / eta


def _refuse_impossible(eta: float, delta: float, theta: float) -> None:
    if eta == 0 or not np.isfinite([eta, delta, theta]).all():
        raise ValueError(
            f"eta = {eta!r}, delta = {delta!r}, theta = {theta!r}: "
            "eta must be finite and not 0 (no lens pair has it), delta and theta finite"
        )
