"""Angles and stretches in 60 digits, from their definitions."""

from __future__ import annotations

from mpmath import mp, mpf

DIGITS = 450  # 1e±200 together with 1


def angle(first, second):
    """Angle between two directions: atan2 of cross product over scalar product."""
    with mp.workdps(DIGITS):
        a, b = [mpf(u) for u in first], [mpf(u) for u in second]
        cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
        return mp.atan2(mp.sqrt(sum(c * c for c in cross)), sum(u * v for u, v in zip(a, b)))


def stretch(eta, z, camera):
    """Size of an object seen through the sheet over its size without it, by tracing two rays of one camera.

    A ray of slope t meets the sheet at D t and leaves with t/η, so it arrives at D t + z t/η; without the sheet
    a ray of slope t' arrives at (D + z) t'. The same point is seen under both: the stretch is t/t'.
    """
    with mp.workdps(DIGITS):
        eta, z, camera = mpf(eta), mpf(z), mpf(camera)
        arrives = camera + z / eta  # at unit slope
        return mp.inf if arrives == 0 else (camera + z) / arrives


def stretch_condition(eta, z, camera):
    """Relative change of the stretch per relative change of D, z and η, summed."""
    with mp.workdps(DIGITS):
        step, base = mpf(2) ** -200, stretch(eta, z, camera)
        total = mpf(0)
        for k in range(3):
            inputs = [mpf(eta), mpf(z), mpf(camera)]
            inputs[k] *= 1 + step
            total += abs(stretch(*inputs) / base - 1) / step
        return total
