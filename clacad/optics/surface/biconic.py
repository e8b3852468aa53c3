"""Intersection of a ray with a biconic: Newton on quadrics, else a quartic.

Notation as in `clacad.optics.surface.sag_and_normal`.
"""

from __future__ import annotations

from math import inf

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats
from clacad.optics.surface.quadric import Columns, pick, quadric_root
from clacad.optics.surface.sag_and_normal import (
    ULP,
    Biconic,
    lateral_gradient,
    lateral_square,
    sag,
    skewness,
    slope_root,
    slope_terms,
)

NEWTON_STEPS = 24
"""Two to four steps suffice for lens-like hits; the rest is for rays that pass near the equator."""


FLAT = 0.1
"""1 − dT/dt below which Newton's step would exceed ten plain steps; the plain step is then taken."""


POLISHES = 8
"""Newton steps from a root of the quartic, which may be off by 1e-4 where two roots nearly meet."""


SETTLED = 2.0**-34
"""Relative change after which Newton's next error, its square, is below rounding."""


def biconic_root(surface: Biconic, start: Columns, base: Columns, ray: Columns) -> tuple[Floats, Floats]:
    """Distance (length) from the base point and r, (n,) each, of a biconic: Newton from the quadric of its
    curvatures.

    The few rays that do not converge (misses, or hits near the equator) are solved by the roots of a quartic.
    """
    of_x = (1.0 + surface.conic_x) * surface.curvature_x
    of_y = (1.0 + surface.conic_y) * surface.curvature_y
    guess, _ = quadric_root(surface, 0.5 * (of_x + of_y), start, base, ray)
    t, root = _newton(surface, guess, start, base, ray)
    rows = np.flatnonzero(np.isnan(t))
    if rows.size:
        t[rows] = _quartic_root(surface, pick(base, rows), pick(ray, rows))
        root[rows] = 0.0  # finite; the hit's own normal gives it
    return t, root


def _newton(
    surface: Biconic, t: Floats, start: Columns, base: Columns, ray: Columns
) -> tuple[Floats, Floats]:
    """Solve t = T(t), where T is the root of the quadric whose κ the biconic has at the azimuth of the point
    at t.

    At azimuth (x : y) the biconic agrees with the quadric of κ = (a x² + b y²)/(cx x² + cy y²). Newton takes
    dT/dt = side sign(N) E x y (y L − x M)/((1 + w)² r). A κ that is 1e-8 off moves t by far less, so the last
    step has the quadric's own accuracy. NaN where it does not converge on the apex half.
    """
    skew = np.where(ray[2] < 0, -surface.side, surface.side) * skewness(surface)
    settled = np.zeros(t.shape, dtype=np.bool_)
    root = np.full_like(t, np.nan)
    for _ in range(NEWTON_STEPS):
        x, y = base[0] + t * ray[0], base[1] + t * ray[1]
        target, root = quadric_root(surface, _azimuth_kappa(surface, x, y), start, base, ray)
        w = np.nan_to_num(slope_root(surface, x, y), nan=0.0)  # beyond the equator only at intermediate steps
        slope = skew * x * y * (y * ray[0] - x * ray[1]) / ((1.0 + w) ** 2 * root)
        change = (target - t) / np.where(np.abs(1.0 - slope) > FLAT, 1.0 - slope, 1.0)
        t = t + change
        settled = np.abs(change) <= SETTLED * np.abs(t)
        if (settled | np.isnan(t)).all():
            break
    x, y, z = (p + t * d for p, d in zip(base, ray))
    return np.where(settled & _near_half(surface, x, y, z), t, np.nan), root


def _azimuth_kappa(surface: Biconic, x: Floats, y: Floats) -> Floats:
    """κ of the quadric that shares the biconic's profile at the azimuth of (x, y)."""
    (a, _), (b, _) = slope_terms(surface)
    q = lateral_square(surface, x, y)
    kappa = (a * x * x + b * y * y) / q
    return np.where(q == 0, (1.0 + surface.conic_x) * surface.curvature_x, kappa)


def _near_half(surface: Biconic, x: Floats, y: Floats, z: Floats) -> NDArray[np.bool_]:
    """Whether points of the full biconic lie on the half side Q/(1 + w), not on side Q/(1 − w).

    The apex half is at most Q high and on Q's side. The other half is higher than Q where w < 1, and on the
    wrong side where w > 1 (a hyperbolic azimuth, where it may be lower than Q).
    """
    q = lateral_square(surface, x, y)
    rounding = 8 * ULP * (np.abs(surface.curvature_x) * x * x + np.abs(surface.curvature_y) * y * y)
    height = surface.side * np.where(q < 0, -z, z)
    return np.asarray((height >= -rounding) & (height <= np.abs(q) + rounding))


def _quartic_root(surface: Biconic, base: Columns, ray: Columns) -> Floats:
    """Distance to a biconic from the real roots of z² (a x² + b y²) − 2 side z Q + Q² = 0, polished.

    Both halves satisfy it, and crossings in either sense; the lowest valid one is taken.
    """
    (x, y, z), (L, M, N) = base, ray
    (a, _), (b, _) = slope_terms(surface)
    cx, cy, side = surface.curvature_x, surface.curvature_y, surface.side
    p = (a * x * x + b * y * y, 2 * (a * x * L + b * y * M), a * L * L + b * M * M)
    q = (cx * x * x + cy * y * y, 2 * (cx * x * L + cy * y * M), cx * L * L + cy * M * M)
    height = (z, N)
    quartic = np.zeros((len(x), 5))
    for i in range(3):
        for j in range(3):
            quartic[:, i + j] += q[i] * q[j]
        for j in range(2):
            quartic[:, i + j] -= 2 * side * q[i] * height[j]
            for k in range(2):
                quartic[:, i + j + k] += p[i] * height[j] * height[k]
    companion = np.zeros((len(x), 4, 4))
    companion[:, 1:, :-1] = np.eye(3)
    companion[:, :, -1] = -quartic[:, :4] / quartic[:, 4:]
    usable = np.isfinite(companion).all(axis=(1, 2))
    best, lowest = np.full_like(x, np.nan), np.full_like(x, inf)
    roots = np.full((len(x), 4), np.nan, dtype=np.complex128)
    roots[usable] = np.linalg.eigvals(companion[usable])
    for i in range(4):
        t, level = _polished(surface, np.real(roots[:, i]), base, ray)
        better = level < lowest
        best, lowest = np.where(better, t, best), np.where(better, level, lowest)
    return best


def _polished(surface: Biconic, t: Floats, base: Columns, ray: Columns) -> tuple[Floats, Floats]:
    """Newton on z − sag along the ray; |z| at the hit, infinite where there is none in the ray's sense."""
    along = np.where(ray[2] < 0, -1.0, 1.0)
    error, onward, z = np.full_like(t, inf), np.zeros_like(t), t
    for _ in range(POLISHES):
        x, y, z = (p + t * d for p, d in zip(base, ray))
        w = slope_root(surface, x, y)
        gx, gy = lateral_gradient(surface, x, y, w)
        onward = along * (gx * ray[0] + gy * ray[1] + w * ray[2])
        error = (z - sag(surface, x, y)) * w / (along * onward)
        t = t - error
    hit = (np.abs(error) <= SETTLED * np.abs(t)) & (onward > 0)
    return t, np.where(hit, np.abs(z), inf)
