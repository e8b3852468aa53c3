"""The ideal law in 400 digits, by tracing a ray through two thin lenses; shares no code with clacad.

Lens 1 (focal length f1 = s/(1 − η) in each meridian) at the origin of the lens frame, lens 2
(f2 = −ηf1) at (δ_x f1x, δ_y f1y, s). The ray is sent through the centre of lens 1 and bent by lens 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mpmath import mp, mpf

DIGITS = 400  # inputs of 1e±200 cancel without loss
Vector = list


@dataclass(frozen=True)
class Refused:
    """The law has no answer, and why."""

    reason: str


def turned(v: Sequence, axis: Sequence, angle: object) -> Vector:
    """Vector v turned about a unit axis (Rodrigues)."""
    c, s = mp.cos(angle), mp.sin(angle)
    along = sum(a * x for a, x in zip(axis, v))
    across = [
        axis[1] * v[2] - axis[2] * v[1],
        axis[2] * v[0] - axis[0] * v[2],
        axis[0] * v[1] - axis[1] * v[0],
    ]
    return [x * c + w * s + a * along * (1 - c) for x, w, a in zip(v, across, axis)]


def lens_frame(phi: object, theta: object, psi: object, axes: str = "fixed") -> list[Vector]:
    """Lens axes u, v and optical axis n in the sheet frame, one turn after the other."""
    frame = [[mpf(int(i == j)) for i in range(3)] for j in range(3)]
    if axes == "moving":  # each turn about the axis the lens has by then
        for which, angle in ((2, phi), (0, theta), (2, psi)):
            about = frame[which]
            frame = [turned(v, about, angle) for v in frame]
        return frame
    for about, angle in (((0, 0, 1), phi), ((1, 0, 0), theta), ((0, 0, 1), psi)):
        frame = [turned(v, [mpf(a) for a in about], angle) for v in frame]
    return frame


def unit(v: Sequence) -> Vector:
    length = mp.sqrt(sum(x * x for x in v))
    return [x / length for x in v]


def dot(a: Sequence, b: Sequence) -> object:
    return sum(x * y for x, y in zip(a, b))


def through_two_lenses(slope: object, eta: object, delta: object) -> object:
    """Slope behind two thin lenses a distance 1 apart that share a focal plane, in one meridian."""
    if eta == 1:  # no power: the limit of the pair is a prism
        return slope - delta
    f1 = 1 / (1 - eta)
    f2 = 1 - f1
    height = slope * 1  # the ray passes the centre of lens 1 straight on
    return slope - (height - delta * f1) / f2


def refract(law: Sequence, d: Sequence, axes: str = "fixed") -> Vector | Refused:
    """Unit direction behind the sheet for (η_x, η_y, δ_x, δ_y, φ, θ, ψ) taken as exact doubles."""
    with mp.workdps(DIGITS):
        eta_x, eta_y, delta_x, delta_y, *angles = (mpf(float(x)) for x in law)
        d = [mpf(x) for x in d]
        u, v, n = lens_frame(*angles, axes)
        if not any(d) or not all(mp.isfinite(x) for x in d):
            return Refused("direction zero or not finite")
        if d[2] <= 0:
            return Refused("not towards +z")
        if dot(d, n) <= 0:
            return Refused("behind the lens")
        x = through_two_lenses(dot(d, u) / dot(d, n), eta_x, delta_x)
        y = through_two_lenses(dot(d, v) / dot(d, n), eta_y, delta_y)
        out = unit([x * a + y * b + c for a, b, c in zip(u, v, n)])
        return out if out[2] > 0 else Refused("turned back")


def condition(law: Sequence, d: Sequence, axes: str = "fixed") -> float:
    """Largest stretch of the sphere of directions at d: how much a rounding of d grows."""
    with mp.workdps(DIGITS):
        d = unit([mpf(x) for x in d])
        helper = [mpf(0)] * 3
        helper[min(range(3), key=lambda i: abs(d[i]))] = mpf(1)
        e1 = unit([h - dot(helper, d) * x for h, x in zip(helper, d)])
        e2 = [d[1] * e1[2] - d[2] * e1[1], d[2] * e1[0] - d[0] * e1[2], d[0] * e1[1] - d[1] * e1[0]]
        step, here = mpf(10) ** -150, refract(law, d, axes)
        columns = []
        for e in (e1, e2):
            there = refract(law, [x + step * y for x, y in zip(d, e)], axes)
            columns.append([(a - b) / step for a, b in zip(there, here)])
        a, b, c = dot(columns[0], columns[0]), dot(columns[0], columns[1]), dot(columns[1], columns[1])
        return float(mp.sqrt((a + c + mp.sqrt((a - c) ** 2 + 4 * b * b)) / 2))


def angle(a: Sequence, b: Sequence) -> object:
    """Angle between two directions, half-angle form."""
    with mp.workdps(DIGITS):
        p, q = unit([mpf(x) for x in a]), unit([mpf(x) for x in b])
        apart = [x - y for x, y in zip(p, q)]
        together = [x + y for x, y in zip(p, q)]
        return 2 * mp.atan2(mp.sqrt(dot(apart, apart)), mp.sqrt(dot(together, together)))
