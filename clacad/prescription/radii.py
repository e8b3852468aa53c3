"""Focal lengths and radii of confocal pairs, one meridian at a time.

f and R are positive for a converging meridian, negative for a diverging one, infinite without power.
η_i = −f2_i/f1_i (Hamilton & Courtial, their eq. for η).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import copysign, inf, isinf, nan, sqrt

from clacad.base.types import Pair2
from clacad.design.sections import PAIR


class NoSuchLens(ValueError):
    """A lens cannot be built; carries the number that would allow it.

    message : The fault, with the numbers.
    key : The design key at fault.
    hint : Two ways out, with the numbers.
    code : A code of `clacad.config.mistakes.CODES`.
    """

    def __init__(self, message: str, key: str = PAIR.thickness, hint: str = "", code: str = "CL120") -> None:
        super().__init__(message)
        self.message, self.key, self.hint, self.code = message, key, hint, code


@dataclass(frozen=True, slots=True)
class LensPair:
    """Both lenses of a pair in both meridians, tuples indexed [lens][meridian]; lengths.

    focal_length : ((f1x, f1y), (f2x, f2y)). Focal lengths as built.
    radius : ((R1x, R1y), (R2x, R2y)). Apex radii, negative when concave, infinite without power.
    thickness : (T1, T2)
    """

    focal_length: tuple[Pair2, Pair2]
    radius: tuple[Pair2, Pair2]
    thickness: Pair2

    def scaled(self, factor: float) -> LensPair:
        """Return the pair with all radii and focal lengths times a factor."""
        if factor == 1.0:
            return self
        focal, radius = _scaled(self.focal_length, factor), _scaled(self.radius, factor)
        return LensPair(focal, radius, self.thickness)


def thin_focal_lengths(eta: float, separation: float) -> Pair2:
    """f1 = s/(1 − η), f2 = −η f1 (lengths); infinite when η = 1."""
    if eta == 1.0:
        return inf, inf
    f1 = separation / (1.0 - eta)
    return f1, -eta * f1


def thin_pair(eta: Pair2, separation: float) -> tuple[Pair2, Pair2]:
    """Focal lengths ((f1x, f1y), (f2x, f2y)) of the ideal pair that shares a focal plane (lengths)."""
    (f1x, f2x), (f1y, f2y) = (thin_focal_lengths(value, separation) for value in eta)
    return (f1x, f1y), (f2x, f2y)


def field_focal_lengths(eta: Pair2, separation: float) -> Pair2:
    """Focal lengths (x, y) that image lens 1 onto lens 2: 1/f_F = 1/f1 + 1/f2 (lengths)."""
    (f1x, f1y), (f2x, f2y) = thin_pair(eta, separation)
    return f1x * f2x / separation, f1y * f2y / separation


def symmetric_radius(focal_length: float, thickness: float, index: float) -> float:
    """Radius R of a lens R, −R of given thick focal length (lengths).

    R = (n − 1) f (1 + sqrt(1 − T/(n f))), the inverse of 1/f = (n − 1)(2/R − (n − 1)T/(n R²)).
    NaN where no such lens exists (T > n f).
    """
    if isinf(focal_length):
        return inf
    inside = 1.0 - thickness / (index * focal_length)
    return (index - 1.0) * focal_length * (1.0 + sqrt(inside)) if inside >= 0.0 else nan


def back_focal_distance(focal_length: float, thickness: float, index: float) -> float:
    """Vertex to focus of a symmetric lens: f sqrt(1 − T/(n f)) (length); NaN where no such lens exists."""
    inside = 1.0 - thickness / (index * focal_length)
    return focal_length * sqrt(inside) if inside >= 0.0 else nan


def biconvex_thin(eta: Pair2, separation: float, thickness: Pair2, index: float) -> LensPair:
    """Paper's recipe: R = 2 (n − 1) f with the thin focal lengths, centres s apart."""
    focal = thin_pair(eta, separation)
    return LensPair(focal, _scaled(focal, 2.0 * (index - 1.0)), thickness)


def biconvex_exact(eta: Pair2, separation: float, thickness: Pair2, index: float) -> LensPair:
    """Pair of symmetric thick lenses, centres s apart, afocal with exactly η in both meridians.

    Per meridian f1 is the one root of BFD(f1) + BFD(−η f1) = s − (T1 + T2)/2 (physics notes, thick lenses).

    Raises NoSuchLens: A meridian has no root, or needs a lens thicker than n f.
    """
    found = [
        _exact_meridian(value, separation, thickness, index, axis)
        for value, axis in zip(eta, "xy", strict=True)
    ]
    focal = ((found[0][0], found[1][0]), (found[0][1], found[1][1]))
    (first_x, first_y), (second_x, second_y) = (
        (symmetric_radius(fx, t, index), symmetric_radius(fy, t, index))
        for (fx, fy), t in zip(focal, thickness, strict=True)
    )
    radius = ((first_x, first_y), (second_x, second_y))
    return LensPair(focal, radius, thickness)


def _exact_meridian(eta: float, separation: float, thickness: Pair2, index: float, axis: str) -> Pair2:
    """Focal lengths (f1, f2) as built in the meridian `axis`; see `biconvex_exact`."""
    thin1, thin2 = thin_focal_lengths(eta, separation)
    if isinf(thin1):
        return inf, inf
    gap = separation - 0.5 * (thickness[0] + thickness[1])
    refuse_too_thick(thin1, thin2, thickness, index, axis, separation)

    def defect(f1: float) -> float:
        first = back_focal_distance(f1, thickness[0], index)
        return first + back_focal_distance(-eta * f1, thickness[1], index) - gap

    # Domain of f1: both lenses exist (T < n f for a converging one).
    least = 0.0
    for f, t in ((thin1, thickness[0]), (thin2, thickness[1])):
        if f > 0.0:
            least = max(least, abs(thin1) * (t / (index * f)))
    low = max(0.25 * abs(thin1), least * (1.0 + 1e-15))
    f1 = _root(lambda size: defect(copysign(size, thin1)), low, 4.0 * abs(thin1))
    if f1 != f1:
        raise NoSuchLens(
            f"no pair of biconvex lenses of thickness {thickness[0]:.6g}, {thickness[1]:.6g} is confocal in"
            f" {axis} with centres {separation:.6g} apart",
            hint=(
                f"thickness well below n f = {index * min(abs(thin1), abs(thin2)):.6g}, or a larger"
                " separation"
            ),
        )
    f1 = copysign(f1, thin1)
    return f1, -eta * f1


def refuse_too_thick(
    f1: float, f2: float, thickness: Pair2, index: float, axis: str, separation: float
) -> None:
    """Refuse a biconvex lens thicker than n f (lengths); CL120."""
    for number, (f, t) in enumerate(zip((f1, f2), thickness, strict=True), start=1):
        if f > 0.0 and t >= index * f:
            raise NoSuchLens(
                f"{t:.6g} is too thick for the focal length of lens {number} in {axis}: a biconvex lens needs"
                f" thickness < n f, and f{number}_{axis} = {f:.6g} makes n f = {index * f:.6g}",
                hint=f"thickness < {index * f:.6g}, or separation > {separation * t / (index * f):.6g}",
            )


def _root(function: Callable[[float], float], low: float, high: float) -> float:
    """Root of a monotone function on [low, high] by bisection to the last bit; NaN if there is none."""
    f_low, f_high = function(low), function(high)
    if not f_low * f_high <= 0.0:
        return nan
    for _ in range(200):
        middle = 0.5 * (low + high)
        if middle in (low, high):
            break
        value = function(middle)
        if value == 0.0:
            return middle
        if (value < 0.0) == (f_low < 0.0):
            low, f_low = middle, value
        else:
            high, f_high = middle, value
    return low if abs(f_low) <= abs(f_high) else high


def single_surface(eta: Pair2, separation: float, thickness: Pair2, index: float) -> LensPair:
    """Pair of lenses with one curved face each (plano, slab): R = (n − 1) f, f = s/(1 − η) in air.

    No thick-lens correction is needed: the plane faces (plano) or the common glass (slab) keep both
    meridians afocal for any thickness.
    """
    focal = thin_pair(eta, separation)
    return LensPair(focal, _scaled(focal, index - 1.0), thickness)


def _scaled(values: tuple[Pair2, Pair2], factor: float) -> tuple[Pair2, Pair2]:
    (a, b), (c, d) = values
    return (factor * a, factor * b), (factor * c, factor * d)
