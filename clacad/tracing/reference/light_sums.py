"""Sums over traced rays, in numpy: the contribution of each to the numbers of `clacad.tracing.light_sums`.

In the frame of the lenses a ray m is incident and the law sends it along w = (m_x/η_x − m_z δ_x/η_x, …, m_z).
With u = w/|w| and r the ray's own exit direction minus u, one step of Gauss and Newton in (1/η_x, 1/η_y,
δ_x/η_x, δ_y/η_y) solves N s = g with N = Σ Jᵀ J, g = Σ Jᵀ r and J = (1 − u uᵀ) ∂w/|w|, which needs only the
products below.
"""

from __future__ import annotations

import numpy as np

from clacad.base.types import Bools, Floats
from clacad.optics.law import Law, angle_between, linear_numbers
from clacad.optics.rays import Fate, TraceResult

KNOWN = len(Fate)
"""Index of the ALIVE rays for which the law has an answer; counts by fate come first."""

SQUARE, OUT = KNOWN + 1, KNOWN + 2
"""Indices of the squared angles to the law and of the exit directions of the ALIVE rays (3)."""

NORMAL, GRADIENT, NUMBERS = KNOWN + 5, KNOWN + 15, KNOWN + 19
"""Indices of the ten products that make up N, and of g (4)."""


def sums_of(law: Law, ray: Floats, result: TraceResult) -> tuple[Floats, float]:
    """Sums (NUMBERS,) over the rays of a result and the largest angle to the law (radians).

    ray : (m, 3)
        Directions before the sheet.
    """
    sums = np.zeros(NUMBERS)
    sums[:KNOWN] = np.bincount(result.fate, minlength=KNOWN)
    alive = result.fate == Fate.ALIVE
    sums[OUT : OUT + 3] = [np.ascontiguousarray(c).sum() for c in result.direction[alive].T]
    asked = law.refract(ray[alive])
    known = np.isfinite(asked[:, 0])
    angle = angle_between(result.direction[alive][known], asked[known])
    sums[KNOWN], sums[SQUARE] = known.sum(), (angle * angle).sum()
    sums[NORMAL:] = _step_sums(law, ray[alive], result.direction[alive], known)
    return sums, float(angle.max(initial=0.0))


def _step_sums(law: Law, ray: Floats, out: Floats, known: Bools) -> Floats:
    """N and g: (14,)."""
    m = (ray[known] / np.linalg.norm(ray[known], axis=1)[:, None]) @ law.rotation
    power_x, power_y, offset_x, offset_y = linear_numbers(law)
    w = np.stack([m[:, 0] * power_x - m[:, 2] * offset_x, m[:, 1] * power_y - m[:, 2] * offset_y, m[:, 2]])
    length = np.sqrt((w * w).sum(axis=0))
    x, y, z = w / length
    a, b, c = m.T / length
    more = (out[known] @ law.rotation).T - [x, y, z]
    gx, gy = more[:2] - (more * [x, y, z]).sum(axis=0) * [x, y]
    xx, yy, xy = 1.0 - x * x, 1.0 - y * y, -x * y
    terms = (
        xx * a * a, xx * a * c, xx * c * c, yy * b * b, yy * b * c, yy * c * c,
        xy * a * b, xy * a * c, xy * b * c, xy * c * c, a * gx, b * gy, c * gx, c * gy,
    )  # fmt: skip
    return np.array([term.sum() for term in terms])
