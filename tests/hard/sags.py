"""Heights of surfaces that R - sqrt(R² - r²) or 1 - r²/R² loses; each with its reason."""

from __future__ import annotations

from dataclasses import dataclass

from oracle import trace as oracle

oq, ob, op = oracle.quadric, oracle.biconic, oracle.polynomial


@dataclass(frozen=True)
class HardSag:
    """A surface, a place, and why its height there is hard."""

    name: str
    why: str
    face: oracle.Face
    x: float
    y: float


SAGS = [
    HardSag("sphere, r/R 1e-3", "R - sqrt(R² - r²) has lost six digits", oq(1, 1, 1), 1e-3, 2e-4),
    HardSag("sag 5e-17 of R", "the textbook form gives 0", oq(1, 1, 1), 1e-8, 0.0),
    HardSag("sag 5e-201 of R", "r² is 1e-200 beside R²", oq(1, 1, 1), 1e-100, 1e-101),
    *(HardSag(f"sag 1e-{k} of R", "each decade of sag costs the textbook a digit", oq(40, 40, 40), 1.4142135623730951 * 10 ** (-k / 2) / 40, 0.0)
      for k in (4, 8, 12, 16, 100, 200)),
    HardSag("r/R 0.999999", "near the equator 1 - r²/R² cancels", oq(1, 1, 1), 0.999999, 0.0),
    HardSag("near the equator, both coordinates", "the sum under the root cancels to 1e-14", oq(1, 1, 1), 0.6, 0.79999999999999),
    HardSag("near the equator, triaxial", "three curvatures, one cancellation", oq(2, 0.5, 1), 0.5, 0.9999999),
    HardSag("on the equator", "the root is 0, the height exactly R", oq(1, 1, 1), 1.0, 0.0),
    HardSag("R = 1e9", "R² = 1e18 leaves nothing of r²", oq(1e-9, 1e-9, 1e-9), 0.3, 0.4),
    HardSag("R = 1e12", "the same, a million times worse", oq(1e-12, 1e-12, 1e-12), 0.3, 0.4),
    HardSag("plane", "divides by curvature 0", oq(0, 0, 0), 0.3, 0.4),
    HardSag("paraboloid", "1/(1 + K) is infinite", oq(0.1, 0.1, 0.0), 1.0, 2.0),
    HardSag("K = -1 + 1e-12", "1/(1 + K) is 1e12", oq(0.1, 0.1, 1e-13), 1.0, 2.0),
    HardSag("K = -1 - 1e-12", "and changes sign", oq(0.1, 0.1, -1e-13), 1.0, 2.0),
    HardSag("hyperboloid far out", "r is 500 apex radii of its asymptotic cone", oq(0.1, 0.1, -0.2), 30.0, 40.0),
    HardSag("radii 1 : 1000", "one meridian flat beside the other", oq(1.0, 1e-3, 0.0316), 0.1, 20.0),
    HardSag("radii 1 : 1e6", "the same, to the limit", oq(1.0, 1e-6, 1e-3), 0.1, 300.0),
    HardSag("concave back", "every sign turned", oq(-3.0, -2.0, -2.5, -1), 0.1, 0.05),
    HardSag("saddle near its straight line", "cx x² + cy y² itself cancels", oq(1.0, -1.0, 0.0), 0.3, 0.3 + 1e-15),
    HardSag("cylinder near its equator", "one curvature is 0, the root nearly", oq(2.0, 0.0, 2.0), 0.4999999, 7.0),
    HardSag("biconic", "no quadric", ob(1, 0.7, -0.444, -0.444), 0.1, 0.2),
    HardSag("biconic near its equator", "its own radicand cancels", ob(1, 0.7, 0.5, -2.0), 0.81649658, 1e-3),
    HardSag("biconic near its equator, K = 0.1", "1 + K is rounded before it is multiplied", ob(1, 0.7, 0.1, -0.3), 0.9534625891978545, 0.0),
    HardSag("saddle biconic round K = -1", "Q changes sign, 1 + K does", ob(1, -0.7, -1.0, -1.0 + 1e-12, -1), 0.3, 0.1),
    HardSag("scale 1e-9", "nanometres in metres", oq(4e10, 3e10, 3.5e10), 1e-12, 2e-12),
    HardSag("scale 1e9", "the same from the other end", oq(4e-8, 3e-8, 3.5e-8), 1e6, 2e6),
    HardSag("polynomial, small", "terms of 1e-16 beside a base of 1e-4", op(1, 1, -1, -1, (0.2, 0.4, 0.1)), 1e-4, 2e-4),
    HardSag("polynomial near its equator", "the radicand cancels, the terms do not", op(1, 1, 0, 0, (0.3, 0.6, 0.3)), 0.999999, 0.0),
    HardSag("polynomial of eighth order", "powers of 2.5 from 40 to 1500", op(0.1, 0.1, -1, -1, (1, 2, 1), (1, 3, 3, 1), (1, 4, 6, 4, 1)), 2.5, -1.5),
    HardSag("polynomial, x beyond 1e50", "0 times an eighth power that overflows is 0", op(0, 0, 0, 0, (1e-200, 0, 0), a8=(0, 0, 0, 0, 1e-300)), 1e55, 0.0),
]  # fmt: skip
