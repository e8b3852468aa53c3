"""Optical surfaces in apex form: sag, normal, where a ray meets them, Snell's law.

`Quadric`:  cx x² + cy y² + κ z² − 2 side z = 0,  apex at the origin. Sphere cx = cy = κ, paraboloid κ = 0,
hyperboloid κ < 0, cylinder cy = 0, plane 0, 0, 0: none is a special case, for nothing is divided by a curvature.
`Biconic`:  z = side Q/(1 + w),  Q = cx x² + cy y²,  w² = 1 − (1 + K_x) cx² x² − (1 + K_y) cy² y².

side = +1: positive curvature bends towards +z (front of a biconvex lens); side = −1: towards −z (its back).
(cx, cy, κ, side) and (−cx, −cy, −κ, −side) are the same points; `side` is kept as the face was built and the
curvatures carry the sign, so a concave face has negative cx, cy and κ. Only the half nearer the apex belongs.

Notation inside: position (x, y, z), direction (L, M, N), apex curvatures cx, cy, index ratio µ = n1/n2;
G is the unnormalised normal (−side cx x, −side cy y, 1 − side κ z). At a hit D·G = r = sqrt(B² − AC) for a unit
direction, so the cosine of incidence comes free and no normal is normalised. A miss and a total reflection are
NaN and stay NaN: `clacad.trace` turns them into fates. After Welford, Aberrations of Optical Systems, ch. 4.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clacad.compensated import Pair, negated, pair, pair_product, pair_sum, two_product, two_sum

FloatArray = NDArray[np.float64]
Columns = tuple[FloatArray, FloatArray, FloatArray]

ULP = 2.0**-52

CANCELS = 1e3
"""B²/|B² − AC| above which the discriminant is formed in pairs: plain arithmetic loses about this factor."""

STEEPEST = 0.125
"""Rays with |N| below this are not carried to the vertex plane, which may lie far off, but to the apex's level."""


@dataclass(frozen=True, slots=True)
class Quadric:
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

    def sag(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Height above the apex plane; see `sag`."""
        return sag(self, x, y)

    def normal(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Unit normal towards +z; see `normal`."""
        return normal(self, x, y)


@dataclass(frozen=True, slots=True)
class Biconic:
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

    def sag(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Height above the apex plane; see `sag`."""
        return sag(self, x, y)

    def normal(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Unit normal towards +z; see `normal`."""
        return normal(self, x, y)


Surface = Quadric | Biconic


class Meeting(NamedTuple):
    """Where n rays meet a surface; rows are NaN where they do not.

    Attributes
    ----------
    distance : (n,) array
        Along the direction as given (length for a unit direction); negative if the surface lies behind.
    gradient : (n, 3) array
        Unnormalised normal G, turned to the side the ray goes to.
    root : (n,) array
        r = D·G >= 0, which is |D| |G| cos(incidence).
    """

    distance: FloatArray
    gradient: FloatArray
    root: FloatArray


def principal_radii(surface: Surface) -> tuple[float, float]:
    """Signed apex radii (R_x, R_y), length; infinite in a flat meridian."""
    curvatures = (surface.curvature_x, surface.curvature_y)
    radius_x, radius_y = (1.0 / c if c else inf for c in curvatures)
    return radius_x, radius_y


def conic_constants(surface: Surface) -> tuple[float | None, float | None]:
    """Conic constants (K_x, K_y): κ/c − 1 of a quadric; None in a flat meridian, which has none."""
    if isinstance(surface, Biconic):
        return surface.conic_x, surface.conic_y
    curvatures = (surface.curvature_x, surface.curvature_y)
    conic_x, conic_y = (surface.kappa / c - 1.0 if c else None for c in curvatures)
    return conic_x, conic_y


def as_quadric(biconic: Biconic) -> Quadric:
    """The quadric with the same points, where there is one.

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


def sag(surface: Surface, x: ArrayLike, y: ArrayLike) -> FloatArray:
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
    Largest error seen 2 ulp relative, tests/test_surface.py.
    """
    x, y = _plane_point(x, y)
    return np.asarray(surface.side * _square(surface, x, y) / (1.0 + _slope_root(surface, x, y)))


def normal(surface: Surface, x: ArrayLike, y: ArrayLike) -> FloatArray:
    """Unit normal towards +z over (x, y): (..., 3), NaN beyond the equator."""
    g = gradient(surface, x, y)
    # np.hypot twice: components of 1e-200 are kept where squares would vanish
    length = np.hypot(np.hypot(g[..., 0], g[..., 1]), g[..., 2])
    return np.asarray(g / length[..., None])


def gradient(surface: Surface, x: ArrayLike, y: ArrayLike) -> FloatArray:
    """Unnormalised normal G towards +z over (x, y): (..., 3), G_z = w >= 0, slopes ∂z/∂x = −G_x/G_z."""
    x, y = _plane_point(x, y)
    w = _slope_root(surface, x, y)
    gx, gy = _lateral_gradient(surface, x, y, w)
    return np.stack([gx + 0.0 * w, gy + 0.0 * w, w], axis=-1)


def meet(surface: Surface, position: FloatArray, direction: FloatArray) -> Meeting:
    """Distance along rays to the apex half of a surface, normal and root there; see `meet_at`."""
    return meet_at(surface, position, direction)[0]


def meet_at(surface: Surface, position: FloatArray, direction: FloatArray) -> tuple[Meeting, FloatArray]:
    """Where rays cross the apex half of a surface, in the surface's own frame.

    Parameters
    ----------
    position : (n, 3) array, length
        Apex at the origin.
    direction : (n, 3) array
        Unit direction cosines; another length scales `distance` and `root`.

    Returns
    -------
    meeting : Meeting
    point : (n, 3) array
        The point met, NaN on a miss; its z keeps relative accuracy however small the sag.

    Notes
    -----
    Of the two crossings of a quadric the one from the −z side of the surface to its +z side is meant
    (for N < 0 from the +z side). The distance may be negative: the caller decides what that means.
    The ray is carried to the vertex plane first and the root written C/(side r − B), whose terms add for
    lens-like hits; where they would cancel the other form of the same root is taken.
    """
    ray = _columns(direction)
    start = _columns(position)
    with np.errstate(all="ignore"):  # a miss is a NaN, on purpose
        carried, base = _carry(start, ray)
        if isinstance(surface, Quadric):
            t, root = _quadric_root(surface, surface.kappa, start, base, ray)
        else:
            t, root = _biconic_root(surface, start, base, ray)
        x, y, z = (p + t * d for p, d in zip(base, ray))
        return _judge(surface, carried + t, root, (x, y, z), ray)


def refract(
    direction: FloatArray, gradient: FloatArray, root: FloatArray, n1: ArrayLike, n2: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Snell's law in vector form, D' = µ D + g G.

    Parameters
    ----------
    direction : (n, 3) array
        Unit directions.
    gradient : (n, 3) array, root : (n,) array
        From `meet`: G turned along the ray, r = D·G.
    n1, n2 : float or (n,) array
        Index before and after.

    Returns
    -------
    direction : (n, 3) array, unit
        NaN at total internal reflection.
    q : (n,) array
        D'·G = |G| cos(refraction).

    Notes
    -----
    g = (1 − µ²)/(q + µ r) is (q − µ r)/G² without its cancellation, and 1 − µ² = (n2 − n1)(n2 + n1)/n2²: equal
    indices give back the direction exactly, and n2/n1 = 1 + 1e-10 loses nothing. No angle is ever formed.
    """
    n1, n2 = np.asarray(n1, dtype=np.float64), np.asarray(n2, dtype=np.float64)
    mu = n1 / n2
    w = (n2 - n1) / n2 * ((n2 + n1) / n2)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        gx, gy, gz = gradient[:, 0], gradient[:, 1], gradient[:, 2]
        incident = mu * root
        q = np.sqrt((gx * gx + gy * gy + gz * gz) * w + incident * incident)
        total = q + incident
        # 0/0 is a ray tangent to a surface between equal indices: it goes straight on
        g = np.where((w == 0) & (total == 0), 0.0, w / total)
        mu = np.broadcast_to(mu, root.shape)
        out = mu[:, None] * direction + g[:, None] * gradient
    return out, q


def fresnel(root: FloatArray, q: FloatArray, mu: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Amplitude reflection coefficients (r_s, r_p) from what `meet` and `refract` return; no square root.

    Parameters
    ----------
    root, q : (n,) arrays
        |G| cos(incidence) and |G| cos(refraction).
    mu : float or (n,) array
        n1/n2.
    """
    mu = np.asarray(mu, dtype=np.float64)
    return (mu * root - q) / (mu * root + q), (root - mu * q) / (root + mu * q)


def _check(kind: str, side: int, *numbers: float) -> None:
    """Refuse what is no surface."""
    if side not in (1, -1):
        raise ValueError(f"{kind}: side is {side!r}, not +1 or -1")
    if not all(isfinite(number) for number in numbers):
        raise ValueError(
            f"{kind}: {numbers} holds a number that is not finite; a flat meridian has curvature 0"
        )


def _plane_point(x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Lateral coordinates as float64."""
    return np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)


def _square(surface: Surface, x: FloatArray, y: FloatArray) -> FloatArray:
    """cx x² + cy y²; in pairs for a saddle, the only case whose terms cancel."""
    cx, cy = surface.curvature_x, surface.curvature_y
    if cx * cy < 0:
        in_x = pair_product(pair(cx), two_product(x, x))
        return pair_sum(in_x, pair_product(pair(cy), two_product(y, y)))[0]
    return np.asarray(cx * x * x + cy * y * y)


def _slope_terms(surface: Surface) -> tuple[Pair, Pair]:
    """(a, b) of the radicand 1 − a x² − b y², as pairs: κ cx, κ cy or (1 + K_x) cx², (1 + K_y) cy²."""
    cx, cy = surface.curvature_x, surface.curvature_y
    if isinstance(surface, Quadric):
        return two_product(surface.kappa, cx), two_product(surface.kappa, cy)
    in_x = pair_product(two_sum(1.0, surface.conic_x), two_product(cx, cx))
    return in_x, pair_product(two_sum(1.0, surface.conic_y), two_product(cy, cy))


def _slope_root(surface: Surface, x: FloatArray, y: FloatArray) -> FloatArray:
    """Root of 1 − a x² − b y², which is G_z; NaN beyond the equator."""
    a, b = _slope_terms(surface)
    x, y = np.broadcast_arrays(x, y)
    with np.errstate(invalid="ignore", over="ignore"):
        radicand = np.array(1.0 - (a[0] * x * x + b[0] * y * y))
        equator = np.abs(radicand) < 0.5  # where 1 cancels
        if equator.any():
            radicand[equator] = _radicand(a, b, x[equator], y[equator])
        return np.asarray(np.sqrt(radicand))


def _radicand(a: Pair, b: Pair, x: FloatArray, y: FloatArray) -> FloatArray:
    """1 − a x² − b y², correct to its last bit."""
    in_x = pair_product(a, two_product(x, x))
    in_y = pair_product(b, two_product(y, y))
    return pair_sum(pair(np.ones_like(x)), negated(in_x), negated(in_y))[0]


def _skewness(surface: Surface) -> float:
    """E = (1 + K_x) cx² cy − (1 + K_y) cy² cx: how far a biconic is from a quadric."""
    if isinstance(surface, Quadric):
        return 0.0
    cx, cy = surface.curvature_x, surface.curvature_y
    return cx * cy * ((1.0 + surface.conic_x) * cx - (1.0 + surface.conic_y) * cy)


def _lateral_gradient(
    surface: Surface, x: FloatArray, y: FloatArray, w: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """G_x, G_y of either surface at the point over (x, y) where G_z = w.

    The biconic is Q + κ z² − 2 side z = 0 with κ = (a x² + b y²)/Q, which depends on the azimuth alone; its
    derivative gives the second terms.
    """
    gx, gy = -surface.side * surface.curvature_x * x, -surface.side * surface.curvature_y * y
    skew = _skewness(surface)
    if skew == 0:
        return np.asarray(gx), np.asarray(gy)
    twist = surface.side * skew * x * y / ((1.0 + w) * (1.0 + w))
    return np.asarray(gx - twist * y), np.asarray(gy + twist * x)


def _carry(start: Columns, ray: Columns) -> tuple[FloatArray, Columns]:
    """Distance to a base point near the apex, and that point: the vertex plane, for steep rays the nearest."""
    (x, y, z), (L, M, N) = start, ray
    square = L * L + M * M + N * N
    flat = N * N >= STEEPEST * STEEPEST * square
    t = np.where(flat, -z / N, -(x * L + y * M + z * N) / square)
    return t, (x + t * L, y + t * M, np.where(flat, 0.0, z + t * N))


def _quadric_root(
    surface: Surface, kappa: FloatArray | float, start: Columns, base: Columns, ray: Columns
) -> tuple[FloatArray, FloatArray]:
    """Distance from the base point and r = sqrt(B² − AC) of a quadric with the surface's curvatures."""
    cx, cy, side = surface.curvature_x, surface.curvature_y, surface.side
    (x, y, z), (L, M, N) = base, ray
    a = cx * L * L + cy * M * M + kappa * N * N
    b = cx * x * L + cy * y * M + (kappa * z - side) * N
    c = cx * x * x + cy * y * y + (kappa * z - 2 * side) * z
    discriminant = b * b - a * c
    nearly_double = b * b > CANCELS * np.abs(discriminant)
    if nearly_double.any():
        pick = np.flatnonzero(nearly_double)
        chosen = np.broadcast_to(kappa, b.shape)[pick]
        p, d = tuple(u[pick] for u in start), tuple(u[pick] for u in ray)
        discriminant[pick] = _discriminant((cx, cy, side), chosen, p, d)
    root = np.sqrt(discriminant)
    sign_root = np.where(N < 0, -side, side) * root
    adds = sign_root * b <= 0
    numerator = np.where(adds, c, -(b + sign_root))
    return numerator / np.where(adds, sign_root - b, a), root


def _discriminant(
    shape: tuple[float, float, int],
    kappa: FloatArray,
    start: tuple[FloatArray, ...],
    ray: tuple[FloatArray, ...],
) -> FloatArray:
    """B² − AC in pairs. It is the same at every point of the ray, so the start serves, unrounded by a carry."""
    cx, cy = pair(shape[0]), pair(shape[1])
    side, k = float(shape[2]), pair(kappa)
    (x, y, z), (L, M, N) = start, ray
    level = pair_sum(two_product(kappa, z), pair(np.full_like(z, -side)))
    above = pair_sum(two_product(kappa, z), pair(np.full_like(z, -2 * side)))
    a = pair_sum(
        pair_product(cx, two_product(L, L)),
        pair_product(cy, two_product(M, M)),
        pair_product(k, two_product(N, N)),
    )
    b = pair_sum(
        pair_product(cx, two_product(x, L)), pair_product(cy, two_product(y, M)), pair_product(level, pair(N))
    )
    c = pair_sum(
        pair_product(cx, two_product(x, x)), pair_product(cy, two_product(y, y)), pair_product(above, pair(z))
    )
    return pair_sum(pair_product(b, b), negated(pair_product(a, c)))[0]


def _biconic_root(
    surface: Biconic, start: Columns, base: Columns, ray: Columns
) -> tuple[FloatArray, FloatArray]:
    """Distance from the base point and r of a biconic: Newton's method on the azimuth's own quadric.

    At azimuth (x : y) the biconic agrees with the quadric of κ = (a x² + b y²)/(cx x² + cy y²). T(t) is the
    cancellation-free root of the quadric whose κ belongs to the point at t; the hit is t = T(t), solved by
    Newton with dT/dt = side sign(N) E x y (y L − x M)/((1 + w)² r). A κ that is 1e-8 off moves t by far less,
    so the last step has the quadric's own accuracy.
    """
    t = _first_guess(surface, start, base, ray)
    skew = _skewness(surface)
    sign = np.where(ray[2] < 0, -surface.side, surface.side)
    last = np.full_like(t, inf)
    for _ in range(NEWTON_STEPS):
        x, y = base[0] + t * ray[0], base[1] + t * ray[1]
        target, root = _quadric_root(surface, _azimuth_kappa(surface, x, y), start, base, ray)
        w = _clipped_root(surface, x, y)
        slope = sign * skew * x * y * (y * ray[0] - x * ray[1]) / ((1.0 + w) ** 2 * root)
        change = (target - t) / np.where(np.abs(slope) < 0.9, 1.0 - slope, 1.0)
        t = np.where(np.isnan(change), t, t + change)
        last = np.where(np.isnan(change), inf, np.abs(change))
        if not (last > SETTLED * np.abs(t)).any():
            break
    return np.where(last <= SETTLED * np.abs(t), t, np.nan), root


NEWTON_STEPS = 24
"""Two to four do for lens-like hits; the rest is for rays that pass near the equator."""

SETTLED = 2.0**-34
"""Relative change after which Newton's next error, its square, is below rounding."""


def _first_guess(surface: Biconic, start: Columns, base: Columns, ray: Columns) -> FloatArray:
    """Root of the quadric of the same curvatures and mean κ; where it is missed, of its neighbours."""
    of_x = (1.0 + surface.conic_x) * surface.curvature_x
    of_y = (1.0 + surface.conic_y) * surface.curvature_y
    t = np.full_like(base[0], np.nan)
    for kappa in (0.5 * (of_x + of_y), of_x, of_y, 0.0):
        missing = np.isnan(t)
        if not missing.any():
            break
        t[missing] = _quadric_root(surface, kappa, start, base, ray)[0][missing]
    return t


def _azimuth_kappa(surface: Biconic, x: FloatArray, y: FloatArray) -> FloatArray:
    """κ of the quadric that shares the biconic's profile at the azimuth of (x, y)."""
    (a, _), (b, _) = _slope_terms(surface)
    q = _square(surface, x, y)
    kappa = (a * x * x + b * y * y) / q
    return np.where(q == 0, (1.0 + surface.conic_x) * surface.curvature_x, kappa)


def _clipped_root(surface: Biconic, x: FloatArray, y: FloatArray) -> FloatArray:
    """w, taken as 0 beyond the equator, where Newton may pass on its way."""
    return np.nan_to_num(_slope_root(surface, x, y), nan=0.0)


def _judge(
    surface: Surface, distance: FloatArray, root: FloatArray, point: Columns, ray: Columns
) -> tuple[Meeting, FloatArray]:
    """Keep the crossings of the apex half and give their normals."""
    x, y, z = point
    quadric = isinstance(surface, Quadric)
    gz = (
        1.0 - surface.side * surface.kappa * z if isinstance(surface, Quadric) else _slope_root(surface, x, y)
    )
    gx, gy = _lateral_gradient(surface, x, y, gz)
    if not quadric:
        root = np.abs(gx * ray[0] + gy * ray[1] + gz * ray[2])
    misses = ~((gz > 0) & np.isfinite(distance) & np.isfinite(root))
    along = np.where(ray[2] < 0, -1.0, 1.0)
    gradient_rows = np.stack([along * gx, along * gy, along * gz], axis=-1)
    point_rows = np.stack(point, axis=-1)
    for rows in (distance, root, gradient_rows, point_rows):
        rows[misses] = np.nan
    return Meeting(distance, gradient_rows, root), point_rows


def _columns(rows: FloatArray) -> Columns:
    """x, y and z of (n, 3) rows, each contiguous."""
    x, y, z = (np.ascontiguousarray(rows[:, i], dtype=np.float64) for i in range(3))
    return x, y, z
