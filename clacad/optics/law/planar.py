"""The law in one plane: the paper's equation 6 and its small-angle form, equation 10.

Embedded in three dimensions (x–z plane, tilt towards +x) it is the Law with
(φ, θ, ψ) = (−90°, θ, 90°), fixed axes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from clacad.base.types import Floats


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
