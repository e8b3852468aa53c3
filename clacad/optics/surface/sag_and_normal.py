"""Quadrics, biconics and even polynomials in apex form: their sag and normal.

`Quadric`:  cx x² + cy y² + κ z² − 2 side z = 0,  apex at the origin. Sphere cx = cy = κ, paraboloid κ = 0,
hyperboloid κ < 0, cylinder cy = 0, plane 0, 0, 0: none is a special case, for nothing is divided by a
curvature.
`Biconic`:  z = side Q/(1 + w),  Q = cx x² + cy y²,  w² = 1 − (1 + K_x) cx² x² − (1 + K_y) cy² y².
`EvenPolynomial`:  z = side (Q/(1 + w) + P): a biconic plus terms P of order 4 to 8,
`clacad.optics.surface.sag_and_normal`.

side = +1: positive curvature bends towards +z (front of a biconvex lens); side = −1: towards −z (its back).
(cx, cy, κ, side) and (−cx, −cy, −κ, −side) are the same points; `side` is kept as the face was built and the
curvatures carry the sign, so a concave face has negative cx, cy and κ. Only the half nearer the apex belongs.

Notation inside: position (x, y, z), direction (L, M, N), apex curvatures cx, cy, index ratio µ = n1/n2; G is
the unnormalised normal (−side cx x, −side cy y, 1 − side κ z). At a hit D·G = r = sqrt(B² − AC) for a unit
direction, so the cosine of incidence comes free and no normal is normalised. A miss and a total reflection
are NaN and stay NaN: `clacad.trace` turns them into fates. After Welford, Aberrations of Optical Systems, ch.
4.

Terms of fourth, sixth and eighth order that an even polynomial adds to its conic, and their slopes.

    a4: a x⁴ + b x² y² + c y⁴
    a6: a x⁶ + b x⁴ y² + c x² y⁴ + d y⁶
    a8: a x⁸ + b x⁶ y² + c x⁴ y⁴ + d x² y⁶ + e y⁸

Nested in x² and y², the coefficient innermost: a zero term stays 0 for any x and y. The rounding error of the
height is at most 6 ulp of the sum of the sizes of all terms.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from math import inf, isfinite
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from clacad.base.pairs import Pair, negated, pair, pair_product, pair_sum, two_product, two_sum
from clacad.base.types import Bools, Floats, Ints
from clacad.base.units import A4, A6, A8, NO_A6, NO_A8


def even_terms(a4: A4, a6: A6, a8: A8, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
    """Height of the terms and its slopes in x and y, (n,) each, over x, y (n,), lengths."""
    xx, yy = x * x, y * y
    height, px, py = _fourth(a4, xx, yy)
    if np.ndim(a6[0]) or any(a6) or any(a8):
        six, eight = _sixth(a6, xx, yy), _eighth(a8, xx, yy)
        height, px, py = (
            one + (two + three) for one, two, three in zip((height, px, py), six, eight, strict=True)
        )
    return np.asarray(height), np.asarray(x * px), np.asarray(y * py)


def sharpest_of_terms(a4: A4, a6: A6, a8: A8, reach: float) -> float:
    """Bound (1/length) of the second derivatives of the terms within `reach` (length) of the apex."""
    square = reach * reach
    of = [factor * sum(map(abs, terms)) for factor, terms in ((12.0, a4), (30.0, a6), (56.0, a8))]
    return square * (of[0] + square * (of[1] + square * of[2]))


Three = tuple[Floats, Floats, Floats]
"""A height, and its slopes over x and y."""


def _fourth(terms: A4, xx: Floats, yy: Floats) -> Three:
    a, b, c = terms
    in_x, in_y = a * xx + b * yy, c * yy
    return xx * in_x + yy * in_y, 4.0 * a * xx + 2.0 * b * yy, 2.0 * b * xx + 4.0 * c * yy


def _sixth(terms: A6, xx: Floats, yy: Floats) -> Three:
    a, b, c, d = terms
    height = xx * (xx * (a * xx + b * yy) + yy * (c * yy)) + yy * (yy * (d * yy))
    px = xx * (6.0 * a * xx + 4.0 * b * yy) + yy * (2.0 * c * yy)
    py = xx * (2.0 * b * xx + 4.0 * c * yy) + yy * (6.0 * d * yy)
    return height, px, py


def _eighth(terms: A8, xx: Floats, yy: Floats) -> Three:
    a, b, c, d, e = terms
    height = xx * (xx * (xx * (a * xx + b * yy) + yy * (c * yy)) + yy * (yy * (d * yy))) + yy * (
        yy * (yy * (e * yy))
    )
    px = xx * (xx * (8.0 * a * xx + 6.0 * b * yy) + yy * (4.0 * c * yy)) + yy * (yy * (2.0 * d * yy))
    py = xx * (xx * (2.0 * b * xx + 4.0 * c * yy) + yy * (6.0 * d * yy)) + yy * (yy * (8.0 * e * yy))
    return height, px, py


ULP = 2.0**-52


class _OverXY:
    """Methods common to all surfaces given as a height over (x, y)."""

    __slots__ = ()

    def sag(self, x: ArrayLike, y: ArrayLike) -> Floats:
        """Height (...) above the apex plane over x, y (...), lengths; see `sag`."""
        return sag(cast("Surface", self), x, y)

    def normal(self, x: ArrayLike, y: ArrayLike) -> Floats:
        """Unit normal (..., 3) towards +z over x, y (...), lengths; see `normal`."""
        return normal(cast("Surface", self), x, y)


@dataclass(frozen=True, slots=True)
class Quadric(_OverXY):
    """Quadric cx x² + cy y² + κ z² − 2 side z = 0 with its apex at the origin.

    Parameters
    ----------
    curvature_x, curvature_y : float, 1/length
        1/apex radius in x and in y; 0 is flat, negative is concave.
    kappa : float, 1/length
        Coefficient of z², not the conic constant: K_x = kappa/curvature_x − 1.
    side : +1 or −1
        +1: positive curvature bends towards +z.

    Raises
    ------
    ValueError
        A number is not finite, or side is neither +1 nor −1.
    """

    curvature_x: float
    curvature_y: float
    kappa: float
    side: int = 1

    def __post_init__(self) -> None:
        _check("Quadric", self.side, self.curvature_x, self.curvature_y, self.kappa)


@dataclass(frozen=True, slots=True)
class Biconic(_OverXY):
    """Surface with its own apex curvature and conic constant in x and in y.

    Parameters
    ----------
    curvature_x, curvature_y : float, 1/length
    conic_x, conic_y : float
        Conic constants K: 0 circle, −1 parabola, below −1 hyperbola.
    side : +1 or −1
        +1: positive curvature bends towards +z.

    Raises
    ------
    ValueError
        A number is not finite, or side is neither +1 nor −1.

    Notes
    -----
    z = side Q/(1 + w) as in the module docstring, with the cross term x² y²; the sum of two profiles
    z_x(x) + z_y(y), elsewhere also called biconic, is another surface.
    """

    curvature_x: float
    curvature_y: float
    conic_x: float
    conic_y: float
    side: int = 1

    def __post_init__(self) -> None:
        _check("Biconic", self.side, self.curvature_x, self.curvature_y, self.conic_x, self.conic_y)


@dataclass(frozen=True, slots=True)
class EvenPolynomial(_OverXY):
    """A biconic plus terms of fourth, sixth and eighth order.

    Parameters
    ----------
    curvature_x, curvature_y : float, 1/length
    conic_x, conic_y : float
        Conic constants of the base; −1: the surface is a polynomial, of degree 4 unless a6 or a8 raise it.
    a4 : (3,) tuple of float, 1/length³
        Coefficients of x⁴, x² y² and y⁴; positive adds height on the side the material bulges to.
    side : +1 or −1
        As for a biconic; a number that is not finite raises ValueError there, too.
    a6, a8 : (4,) and (5,) tuple of float, 1/length⁵ and 1/length⁷
        Coefficients of the next orders as in `clacad.optics.surface.sag_and_normal`.

    Notes
    -----
    z = side (Q/(1 + w) + P) is defined where the base is. Where base and terms cancel, the error of z is
    that of
    the larger of them.
    """

    curvature_x: float
    curvature_y: float
    conic_x: float
    conic_y: float
    a4: A4
    side: int = 1
    a6: A6 = NO_A6
    a8: A8 = NO_A8

    def __post_init__(self) -> None:
        numbers = (self.curvature_x, self.curvature_y, self.conic_x, self.conic_y)
        _check("EvenPolynomial", self.side, *numbers, *self.a4, *self.a6, *self.a8)

    @property
    def degree(self) -> int | None:
        """Degree in x and y of a face on a paraboloid, which is a polynomial; None on any other base."""
        if not self.conic_x == self.conic_y == -1.0:
            return None
        return 8 if any(self.a8) else 6 if any(self.a6) else 4


Surface = Quadric | Biconic | EvenPolynomial
Given = TypeVar("Given", Quadric, Biconic, EvenPolynomial, Surface)


def principal_radii(surface: Surface) -> tuple[float, float]:
    """Signed apex radii (R_x, R_y), length; infinite in a flat meridian."""
    curvatures = (surface.curvature_x, surface.curvature_y)
    radius_x, radius_y = (1.0 / c if c else inf for c in curvatures)
    return radius_x, radius_y


def other_side(surface: Surface) -> Surface:
    """The same points with the signs of a face on the other side: of material before it, not behind it."""
    changed: dict[str, Any] = {
        name: tuple(0.0 - term for term in value) if isinstance(value, tuple) else 0.0 - value
        for name, value in ((one.name, getattr(surface, one.name)) for one in fields(surface))
        if name in ("curvature_x", "curvature_y", "kappa", "a4", "a6", "a8")
    }
    return replace(surface, side=-surface.side, **changed)


def resized(surface: Surface, size: float) -> Surface:
    """The shape with all lengths times `size`."""
    cx, cy = surface.curvature_x / size, surface.curvature_y / size
    if isinstance(surface, Quadric):
        return Quadric(cx, cy, surface.kappa / size, surface.side)
    if isinstance(surface, Biconic):
        return Biconic(cx, cy, surface.conic_x, surface.conic_y, surface.side)
    a4 = tuple(term / size**3 for term in surface.a4)
    a6, a8 = tuple(term / size**5 for term in surface.a6), tuple(term / size**7 for term in surface.a8)
    terms = (cast("A4", a4), surface.side, cast("A6", a6), cast("A8", a8))
    return EvenPolynomial(cx, cy, surface.conic_x, surface.conic_y, *terms)


def stretched(surface: Surface, aspect: ArrayLike) -> Surface:
    """The surface with its curvature along y times `aspect`, for the same recipe of its form.

    A quadric's κ, the geometric mean of its curvatures or a depth, is multiplied by sqrt(aspect); the conic
    constants of a biconic are kept. A term x^m y^n of order N = m + n is multiplied by aspect^(n (N − 1)/N):
    scaled about its apex, the profile along either axis is then that of the lens scaled for this axis. With
    an aspect for each of n points, what it changes are arrays (n,).
    """
    of: Any = aspect
    changed: dict[str, Any] = {"curvature_y": surface.curvature_y * of}
    if isinstance(surface, Quadric):
        changed["kappa"] = surface.kappa * np.sqrt(of)
    elif isinstance(surface, EvenPolynomial):
        higher = ("a6", "a8") if any(surface.a6) or any(surface.a8) else ()
        for name in ("a4", *higher):
            terms = getattr(surface, name)
            order = 2 * len(terms) - 2
            changed[name] = tuple(one * of ** (2 * k * (order - 1) / order) for k, one in enumerate(terms))
    return replace(surface, **changed)


def of_rows(surface: Given, rows: Ints | Bools) -> Given:
    """The surface of some of the points, where it differs from point to point (`stretched`)."""
    if np.ndim(surface.curvature_y) == 0:
        return surface
    return replace(
        surface, **{one.name: _rows_of(getattr(surface, one.name), rows) for one in fields(surface)}
    )


def _rows_of(value: Any, rows: Ints | Bools) -> Any:
    """Some of the numbers of a field of a surface, which has one for all points or one each."""
    if isinstance(value, tuple):
        return tuple(_rows_of(one, rows) for one in value)
    return value[rows] if np.ndim(value) else value


def sharpest_bend(surface: Surface, reach: float) -> float:
    """Bound (1/length) of a face's second derivatives: apex curvatures plus even terms within `reach`."""
    bend = abs(surface.curvature_x) + float(np.max(np.abs(surface.curvature_y)))
    if isinstance(surface, EvenPolynomial):
        bend += float(np.max(sharpest_of_terms(surface.a4, surface.a6, surface.a8, reach)))
    return bend


def conic_constants(surface: Surface) -> tuple[float | None, float | None]:
    """Conic constants (K_x, K_y), pure numbers: κ/c − 1 of a quadric; None in a flat meridian."""
    if not isinstance(surface, Quadric):
        return surface.conic_x, surface.conic_y
    curvatures = (surface.curvature_x, surface.curvature_y)
    conic_x, conic_y = (surface.kappa / c - 1.0 if c else None for c in curvatures)
    return conic_x, conic_y


def as_quadric(biconic: Biconic) -> Quadric:
    """The quadric with the same points, where one exists.

    Raises
    ------
    ValueError
        (1 + K_x) cx and (1 + K_y) cy, either of which would be κ, differ by more than the rounding
        of 1 + K and of one product (4 ulp). A flat meridian sets no condition.
    """
    of_x = (1.0 + biconic.conic_x) * biconic.curvature_x
    of_y = (1.0 + biconic.conic_y) * biconic.curvature_y
    kappa = of_y if biconic.curvature_x == 0 else of_x
    curved = biconic.curvature_x != 0 and biconic.curvature_y != 0
    rounding = 4 * ULP * max(abs(biconic.curvature_x), abs(biconic.curvature_y), abs(of_x), abs(of_y))
    if curved and abs(of_x - of_y) > rounding:
        raise ValueError(
            f"a biconic is a quadric only if (1 + K_x) cx = (1 + K_y) cy: {of_x!r} is not {of_y!r}"
        )
    return Quadric(biconic.curvature_x, biconic.curvature_y, kappa, biconic.side)


def simplest(surface: Surface) -> Surface:
    """The quadric with the same points, if one exists, as its rays need no iteration; else the surface."""
    if not isinstance(surface, Biconic) or np.ndim(surface.curvature_y):
        return surface
    try:
        return as_quadric(surface)
    except ValueError:
        return surface


def sag(surface: Surface, x: ArrayLike, y: ArrayLike) -> Floats:
    """Height z of the surface over (x, y).

    Parameters
    ----------
    x, y : arrays that broadcast, length

    Returns
    -------
    array of the broadcast shape, length
        NaN beyond the equator.

    Notes
    -----
    side q/(1 + sqrt(1 − κ q)), never R − sqrt(R² − r²); near the equator the radicand is formed in pairs.
    Largest error seen 2 ulp relative, tests/optics/test_surface.py.
    """
    x, y = _plane_point(x, y)
    height = surface.side * lateral_square(surface, x, y) / (1.0 + slope_root(surface, x, y))
    if isinstance(surface, EvenPolynomial):
        height = height + surface.side * even_terms(surface.a4, surface.a6, surface.a8, x, y)[0]
    return np.asarray(height)


def normal(surface: Surface, x: ArrayLike, y: ArrayLike) -> Floats:
    """Unit normal towards +z over (x, y): (..., 3), NaN beyond the equator."""
    g = gradient(surface, x, y)
    # np.hypot twice: components of 1e-200 are kept where squares would vanish
    length = np.hypot(np.hypot(g[..., 0], g[..., 1]), g[..., 2])
    return np.asarray(g / length[..., None])


def gradient(surface: Surface, x: ArrayLike, y: ArrayLike) -> Floats:
    """Unnormalised normal G towards +z over (x, y): (..., 3), G_z = w >= 0, slopes ∂z/∂x = −G_x/G_z."""
    x, y = _plane_point(x, y)
    w = slope_root(surface, x, y)
    gx, gy = lateral_gradient(surface, x, y, w)
    return np.stack([gx + 0.0 * w, gy + 0.0 * w, w], axis=-1)


def lateral_gradient(surface: Surface, x: Floats, y: Floats, w: Floats) -> tuple[Floats, Floats]:
    """G_x, G_y (n,) of either surface at the points over (x, y), (n,) lengths, where G_z = w (n,).

    The biconic is Q + κ z² − 2 side z = 0 with κ = (a x² + b y²)/Q, which depends on the azimuth alone; its
    derivative gives the second terms. Even terms add −side w times their slopes.
    """
    gx, gy = -surface.side * surface.curvature_x * x, -surface.side * surface.curvature_y * y
    if isinstance(surface, EvenPolynomial):
        _, px, py = even_terms(surface.a4, surface.a6, surface.a8, x, y)
        gx, gy = gx - surface.side * w * px, gy - surface.side * w * py
    skew = skewness(surface)
    if not np.any(skew):
        return np.asarray(gx), np.asarray(gy)
    twist = surface.side * skew * x * y / ((1.0 + w) * (1.0 + w))
    return np.asarray(gx - twist * y), np.asarray(gy + twist * x)


def lateral_square(surface: Surface, x: Floats, y: Floats) -> Floats:
    """The form cx x² + cy y² (n,), length; in pairs for a saddle, whose terms alone cancel."""
    cx, cy = surface.curvature_x, surface.curvature_y
    if np.any(cx * cy < 0):
        in_x = pair_product(pair(cx), two_product(x, x))
        return pair_sum(in_x, pair_product(pair(cy), two_product(y, y)))[0]
    return np.asarray(cx * x * x + cy * y * y)


def slope_terms(surface: Surface) -> tuple[Pair, Pair]:
    """(a, b) of the radicand 1 − a x² − b y², as pairs: κ cx, κ cy or (1 + K_x) cx², (1 + K_y) cy²."""
    cx, cy = surface.curvature_x, surface.curvature_y
    if isinstance(surface, Quadric):
        return two_product(surface.kappa, cx), two_product(surface.kappa, cy)
    in_x = pair_product(two_sum(1.0, surface.conic_x), two_product(cx, cx))
    return in_x, pair_product(two_sum(1.0, surface.conic_y), two_product(cy, cy))


def slope_root(surface: Surface, x: Floats, y: Floats) -> Floats:
    """Root (n,) of 1 − a x² − b y², which is G_z, over x, y (n,), lengths; NaN beyond the equator."""
    a, b = slope_terms(surface)
    x, y = np.broadcast_arrays(x, y)
    with np.errstate(invalid="ignore", over="ignore"):
        radicand = np.array(1.0 - (a[0] * x * x + b[0] * y * y))
        equator = np.abs(radicand) < 0.5  # where 1 cancels
        if equator.any():
            a, b = ((one[0][equator], one[1][equator]) if np.ndim(one[0]) else one for one in (a, b))
            radicand[equator] = _radicand(a, b, x[equator], y[equator])
        return np.asarray(np.sqrt(radicand))


def skewness(surface: Surface) -> float:
    """E = (1 + K_x) cx² cy − (1 + K_y) cy² cx, 1/length³: how far a biconic is from a quadric."""
    if isinstance(surface, Quadric):
        return 0.0
    cx, cy = surface.curvature_x, surface.curvature_y
    return cx * cy * ((1.0 + surface.conic_x) * cx - (1.0 + surface.conic_y) * cy)


def _radicand(a: Pair, b: Pair, x: Floats, y: Floats) -> Floats:
    """1 − a x² − b y², correct to its last bit."""
    in_x = pair_product(a, two_product(x, x))
    in_y = pair_product(b, two_product(y, y))
    return pair_sum(pair(np.ones_like(x)), negated(in_x), negated(in_y))[0]


def _check(kind: str, side: int, *numbers: float) -> None:
    """Refuse invalid numbers and sides."""
    if side not in (1, -1):
        raise ValueError(f"{kind}: side is {side!r}, not +1 or -1")
    if not all(isfinite(number) if np.ndim(number) == 0 else np.isfinite(number).all() for number in numbers):
        raise ValueError(
            f"{kind}: {numbers} holds a number that is not finite; a flat meridian has curvature 0"
        )


def _plane_point(x: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
    """Lateral coordinates as float64."""
    return np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
