"""Roots of a ray and a surface: closed form for quadrics, iterations for biconics and even polynomials.

Quadric: the cancellation-free root. Biconic: Newton on quadrics, else a quartic. Even polynomial: safeguarded
Newton. Notation as in `clacad.optics.surface.sag_and_normal`.

Even polynomial: along the ray, taken upwards, F = z − sag must change from − to +. The search stays on the
stretch of the ray over which the base is real: the one with the base point, else the nearest. It keeps the
signs it has found as a bracket and takes Newton's step wherever that step is usable. Otherwise it halves the
bracket, or doubles its stride until it has one. A ray steeper than the surface has one such crossing. A
grazing ray may cross upwards more than once; the crossing found first is then taken. A search that does not
converge is a miss: NaN.

Error of the point along z: at most 8 ulp of |Q|/(1 + w) and the sizes of all terms over |H|/(w |N|), the
factor by which the ray grazes (1 at right angles); largest seen 3.3, tests/optics/test_even_polynomial.py.
Where the base is steep, the w of a hit's normal is computed from the height: 1 − w² from (x, y) has lost
accuracy that z still has.
"""

from __future__ import annotations

from math import inf

import numpy as np
from numpy.typing import NDArray

from clacad.base.pairs import negated, pair, pair_product, pair_sum, two_product
from clacad.base.types import Bools, Floats
from clacad.optics.surface.sag_and_normal import (
    ULP,
    Biconic,
    EvenPolynomial,
    Quadric,
    Surface,
    even_terms,
    lateral_gradient,
    lateral_square,
    of_rows,
    sag,
    skewness,
    slope_root,
    slope_terms,
)

Columns = tuple[Floats, Floats, Floats]


CANCELS = 1e3
"""B²/|B² − AC| above which the discriminant is formed in pairs: plain arithmetic loses about that factor."""


STEEPEST = 0.25
"""|N| below which rays are not carried to the vertex plane, which may lie far off, but to the apex's level.
"""


def carry(start: Columns, ray: Columns) -> tuple[Floats, Columns]:
    """Distance (n,) to a base point near the apex, and that point, three columns (n,); lengths.

    It lies in the vertex plane; for steep rays it is the point nearest to the apex.
    """
    (x, y, z), (L, M, N) = start, ray
    square = L * L + M * M + N * N
    flat = N * N >= STEEPEST * STEEPEST * square
    t = np.where(flat, -z / N, -(x * L + y * M + z * N) / square)
    return t, (x + t * L, y + t * M, np.where(flat, 0.0, z + t * N))


def quadric_root(
    surface: Surface, kappa: Floats | float, start: Columns, base: Columns, ray: Columns
) -> tuple[Floats, Floats]:
    """Distance from the base point (length) and r = sqrt(B² − AC), (n,) each, of a quadric of the surface's
    curvatures.

    kappa : 1/length, (n,) or one for all; start, base, ray : three columns (n,): point, base point,
        direction.
    """
    cx, cy, side = surface.curvature_x, surface.curvature_y, surface.side
    (x, y, z), (L, M, N) = base, ray
    a = cx * L * L + cy * M * M + kappa * N * N
    b = cx * x * L + cy * y * M + (kappa * z - side) * N
    c = cx * x * x + cy * y * y + (kappa * z - 2 * side) * z
    discriminant = b * b - a * c
    nearly_double = b * b > CANCELS * np.abs(discriminant)
    if nearly_double.any():
        rows = np.flatnonzero(nearly_double)
        chosen, some = np.broadcast_to(kappa, b.shape)[rows], of_rows(surface, rows)
        discriminant[rows] = _discriminant(some, chosen, pick(start, rows), pick(ray, rows))
    root = np.sqrt(discriminant)
    sign_root = np.where(N < 0, -side, side) * root
    adds = sign_root * b <= 0
    numerator = np.where(adds, c, -(b + sign_root))
    return numerator / np.where(adds, sign_root - b, a), root


def upright_sag(surface: Quadric, x: Floats, y: Floats) -> Floats | None:
    """Sag (n,) over points x, y (n,), lengths; bit for bit the hit of a ray along +z. NaN past the equator.

    None where a point is so near the equator that the root needs the ray's compensated discriminant.
    """
    kappa, side = surface.kappa, surface.side
    with np.errstate(all="ignore"):  # beyond the equator there is no height, on purpose
        c = surface.curvature_x * x * x + surface.curvature_y * y * y
        discriminant = 1.0 - kappa * c
        if (CANCELS * np.abs(discriminant) < 1.0).any():
            return None
        sag = c / (side * np.sqrt(discriminant) + side)
        kept = (1.0 - side * kappa * sag > 0.0) & np.isfinite(sag)
    return np.where(kept, sag, np.nan)


def _discriminant(
    surface: Surface, kappa: Floats, start: tuple[Floats, ...], ray: tuple[Floats, ...]
) -> Floats:
    """B² − AC in pairs. It is constant along the ray, so the unrounded start is used."""
    cx, cy = pair(surface.curvature_x), pair(surface.curvature_y)
    side, k = float(surface.side), pair(kappa)
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


def pick(columns: Columns, rows: NDArray[np.intp]) -> Columns:
    """Select rows of three columns."""
    return columns[0][rows], columns[1][rows], columns[2][rows]


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
        t[rows] = _quartic_root(of_rows(surface, rows), pick(base, rows), pick(ray, rows))
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


POLYNOMIAL_STEPS = 120
"""Four steps suffice for lens-like hits; the rest is for grazing rays, and for halvings down to the last bit.
"""


CLOSE = 2.0**-24
"""Height over the surface, relative to the sizes of its terms, above which a small step does not count as a
root.

Near the equator of the base the surface is vertical, and every step is small.
"""

UPRIGHT = 0.7
"""w below which the height of a hit determines w more accurately than its x and y."""

TIGHT = 4 * ULP
"""Relative width of a bracket that cannot be halved any more."""


def polynomial_root(surface: EvenPolynomial, base: Columns, ray: Columns) -> Floats:
    """Distance (n,), length, from base points to the crossing towards the side the rays go to; NaN: none.

    base, ray : three columns (n,): base point, direction
    """
    sense = np.where(ray[2] < 0, -1.0, 1.0)
    up: Columns = (sense * ray[0], sense * ray[1], sense * ray[2])
    first, last = _real_stretch(surface, base, up)
    found = np.full(base[0].shape, np.nan)
    rows = np.flatnonzero(first <= last)
    search = _Search(of_rows(surface, rows), first[rows], last[rows])
    t = np.clip(np.zeros(rows.size), search.first, search.last)
    low, high = np.full(rows.size, -np.inf), np.full(rows.size, np.inf)
    stride = np.zeros(rows.size)
    for _ in range(POLYNOMIAL_STEPS):
        if not rows.size:
            break
        here, along = [p[rows] for p in base], [d[rows] for d in up]
        gap, onward, w, size = search.gap(here, along, t)
        low, high = np.where(gap < 0.0, t, low), np.where(gap < 0.0, high, t)
        step = t - gap * w / onward
        usable = (onward > 0.0) & np.isfinite(step) & (low <= step) & (step <= high)
        usable &= (search.first <= step) & (step <= search.last) & ((step != t) | (gap == 0.0) | (w > 0.0))
        bracketed = np.isfinite(low) & np.isfinite(high)
        stride = np.where(usable | bracketed, stride, np.maximum(2.0 * stride, 2.0 * np.abs(gap)))
        beyond = np.clip(t + np.where(gap < 0.0, stride, -stride), search.first, search.last)
        following = np.where(usable, step, np.where(bracketed, 0.5 * (low + high), beyond))
        near = usable & (np.abs(step - t) <= SETTLED * np.abs(step)) & (np.abs(gap) <= CLOSE * size)
        tight = bracketed & (high - low <= TIGHT * np.maximum(np.abs(low), np.abs(high))) & (onward > 0.0)
        stuck = ~usable & ~bracketed & (following == t)  # at an end of the real stretch, on the wrong side
        done = near | tight
        found[rows[done]] = following[done]
        going = ~(done | stuck | np.isnan(gap))
        rows, t, low, high, stride = (v[going] for v in (rows, following, low, high, stride))
        search = search.of(going)
    return np.asarray(sense * found)


def slope_root_of_hit(surface: EvenPolynomial, x: Floats, y: Floats, z: Floats, w: Floats) -> Floats:
    """Third component w (n,) of the normal G at points hit (n,), lengths.

    It follows from Q/(1 + w) = side z − P where the w (n,) computed from x and y is small.
    """
    q = lateral_square(surface, x, y)
    base, terms = q / (1.0 + w), even_terms(surface.a4, surface.a6, surface.a8, x, y)[0]
    better = q / (base + surface.side * (z - surface.side * (base + terms))) - 1.0
    return np.where((w < UPRIGHT) & (better > 0.0), better, w)


class _Search:
    """The surface along m rays, and the stretch (m,) of each over which its base is real."""

    def __init__(self, surface: EvenPolynomial, first: Floats, last: Floats) -> None:
        self.surface, self.first, self.last = surface, first, last
        (self.a, _), (self.b, _) = slope_terms(surface)

    def of(self, rows: Bools) -> _Search:
        """The search restricted to some of the rays."""
        return _Search(of_rows(self.surface, rows), self.first[rows], self.last[rows])

    def gap(self, base: list[Floats], ray: list[Floats], t: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Height over the surface, G·D, w (0 where rounding passes the equator), size of subtracted terms.

        All at distances t (m,).
        """
        x, y, z = (p + t * d for p, d in zip(base, ray, strict=True))
        surface = self.surface
        w = np.sqrt(np.maximum(1.0 - (self.a * x * x + self.b * y * y), 0.0))
        above = lateral_square(surface, x, y) / (1.0 + w)
        terms = even_terms(surface.a4, surface.a6, surface.a8, x, y)[0]
        gx, gy = lateral_gradient(surface, x, y, w)
        size = np.abs(z) + np.abs(above) + np.abs(terms)
        return z - surface.side * (above + terms), gx * ray[0] + gy * ray[1] + w * ray[2], w, size


def _real_stretch(surface: EvenPolynomial, base: Columns, ray: Columns) -> tuple[Floats, Floats]:
    """Ends (n,), distances from the base point, of the stretch where 1 − a x² − b y² ≥ 0.

    There is no such stretch if first > last.

    Outside the roots of a quadratic that opens upwards there are two stretches. The one with 0 in it is
    taken, else the nearer.
    """
    (a, _), (b, _) = slope_terms(surface)
    (x, y, _), (L, M, _) = base, ray
    square = -(a * L * L + b * M * M) + 0.0  # never −0.0, which would change the sign of a root at infinity
    half, constant = -(a * x * L + b * y * M), 1.0 - (a * x * x + b * y * y)
    root = np.sqrt(half * half - square * constant)
    q = -(half + np.copysign(root, half))
    one, two = q / square, constant / q
    low, high = np.minimum(one, two), np.maximum(one, two)
    everywhere = (np.isnan(root) | (q == 0.0)) & (constant > 0.0)
    nowhere = (np.isnan(root) | (q == 0.0)) & ~(constant > 0.0)
    left = (low >= 0.0) | ((high > 0.0) & (-low <= high))
    first = np.where(square < 0.0, low, np.where(left, -np.inf, high))
    last = np.where(square < 0.0, high, np.where(left, low, np.inf))
    first = np.where(everywhere, -np.inf, np.where(nowhere, np.inf, first))
    return first, np.where(everywhere, np.inf, np.where(nowhere, -np.inf, last))
