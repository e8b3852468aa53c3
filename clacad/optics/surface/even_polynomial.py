"""Intersection of a ray with an even polynomial: safeguarded Newton.

Notation as in `clacad.optics.surface.sag_and_normal`.

Along the ray, taken upwards, F = z − sag must change from − to +. The search stays on the stretch of the ray
over which the base is real: the one with the base point, else the nearest. It keeps the signs it has found as
a bracket and takes Newton's step wherever that step is usable. Otherwise it halves the bracket, or doubles
its stride until it has one. A ray steeper than the surface has one such crossing. A grazing ray may cross
upwards more than once; the crossing found first is then taken. A search that does not converge is a miss:
NaN.

Error of the point along z: at most 8 ulp of |Q|/(1 + w) and the sizes of all terms over |H|/(w |N|), the
factor by which the ray grazes (1 at right angles); largest seen 3.3, tests/optics/test_even_polynomial.py.
Where the base is steep, the w of a hit's normal is computed from the height: 1 − w² from (x, y) has lost
accuracy that z still has.
"""

from __future__ import annotations

import numpy as np

from clacad.base.types import Bools, Floats
from clacad.optics.surface.quadric import Columns
from clacad.optics.surface.sag_and_normal import (
    ULP,
    EvenPolynomial,
    even_terms,
    lateral_gradient,
    lateral_square,
    slope_terms,
)

POLYNOMIAL_STEPS = 120
"""Four steps suffice for lens-like hits; the rest is for grazing rays, and for halvings down to the last
bit.
"""

SETTLED = 2.0**-34
"""Relative step after which Newton's next error, its square, is below rounding."""

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
    search = _Search(surface, first[rows], last[rows])
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
        return _Search(self.surface, self.first[rows], self.last[rows])

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
