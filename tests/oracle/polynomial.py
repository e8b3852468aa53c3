"""Even polynomials in 50 digits, from z = side (Q/(1 + w) + Σ a_ij x^2i y^2j) alone; shares no code with clacad.

Slopes are differences of heights. A crossing is sought by walking along the ray in many steps: the nearest to the
vertex plane at which the ray comes through to the side it goes to.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpmath import mp, mpf

DIGITS = 50
STEPS = 120


@dataclass(frozen=True)
class Shape:
    """Curvatures, conic constants, coefficients of fourth, sixth and eighth order, and side."""

    curvature: tuple
    conic: tuple
    a4: tuple
    side: int = 1
    a6: tuple = (0, 0, 0, 0)
    a8: tuple = (0, 0, 0, 0, 0)

    def monomials(self, x, y):
        """Every term over (x, y)."""
        return [
            mpf(value) * x ** (2 * (order - j)) * y ** (2 * j)
            for order, values in ((2, self.a4), (3, self.a6), (4, self.a8))
            for j, value in enumerate(values)
        ]

    def height(self, x, y):
        """Height over (x, y), None beyond the equator of the base."""
        (cx, cy), (kx, ky) = (map(mpf, pair) for pair in (self.curvature, self.conic))
        left = 1 - (1 + kx) * cx**2 * x * x - (1 + ky) * cy**2 * y * y
        if left < 0:
            return None
        base = (cx * x * x + cy * y * y) / (1 + mp.sqrt(left))
        return self.side * (base + sum(self.monomials(x, y), mpf(0)))

    def terms(self, x, y):
        """Sum of the sizes of the terms: what rounding is measured against."""
        (cx, cy), (kx, ky) = (map(mpf, pair) for pair in (self.curvature, self.conic))
        w = mp.sqrt(1 - (1 + kx) * cx**2 * x * x - (1 + ky) * cy**2 * y * y)
        base = (abs(cx) * x * x + abs(cy) * y * y) / (1 + w)
        return base + sum((abs(term) for term in self.monomials(x, y)), mpf(0))

    def normal(self, x, y):
        """Unit normal towards +z."""
        h = mpf(10) ** -20
        sx = (self.height(x + h, y) - self.height(x - h, y)) / (2 * h)
        sy = (self.height(x, y + h) - self.height(x, y - h)) / (2 * h)
        length = mp.sqrt(1 + sx * sx + sy * sy)
        return [-sx / length, -sy / length, 1 / length]


def crossing(shape, start, direction, reach):
    """Distance along the direction, None for a miss; the walk goes `reach` (length) either way from the vertex plane."""
    start, direction = [mpf(v) for v in start], [mpf(v) for v in direction]
    sense = -1 if direction[2] < 0 else 1
    middle = -start[2] / direction[2]

    def gap(t):
        x, y, z = (p + t * d for p, d in zip(start, direction))
        height = shape.height(x, y)
        return None if height is None else z - height

    places = [middle + mpf(reach) * (2 * mpf(k) / STEPS - 1) for k in range(STEPS + 1)]
    gaps = [gap(t) for t in places]
    found = []
    for one, two, first, second in zip(places, places[1:], gaps, gaps[1:]):
        if first is None or second is None or not sense * first < 0 <= sense * second:
            continue
        low, high = one, two
        for _ in range(160):
            half = (low + high) / 2
            low, high = (half, high) if sense * gap(half) < 0 else (low, half)
        found.append((abs(low - middle), low))
    return min(found)[1] if found else None
