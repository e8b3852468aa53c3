"""Rays that a textbook tracer gets wrong: one list, each with its reason.

Every case is a sequence of surfaces, a start and a direction, all of them doubles taken as they are. What the
right answer is, and how much of it the inputs' own rounding leaves, is the oracle's business (`oracle.trace`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import asin, cos, sin

import numpy as np
from oracle import trace as oracle

KM = 1e3


@dataclass(frozen=True)
class Hard:
    """A ray that a textbook tracer gets wrong, and why."""

    name: str
    why: str
    faces: list
    start: tuple
    direction: tuple
    undecidable: bool = False  # the fate depends on the rounding of the inputs: every finite answer is right


def lens(cx, cy, kappa, thickness=0.0005, z=0.0, n=1.5, centre=(0.0, 0.0)):
    """Biconvex lens of two equal quadrics round z."""
    low, high = (*centre, z - thickness / 2), (*centre, z + thickness / 2)
    return [
        oracle.quadric(cx, cy, kappa, 1, vertex=low, before=1.0, after=n),
        oracle.quadric(cx, cy, kappa, -1, vertex=high, before=n, after=1.0),
    ]


def pair(centre=(0.0, 0.0)):
    """The paper's confocal pair, η = (-1/4, -1), thin recipe."""
    first = lens(25.0, 40.0, 31.622776601683796, centre=centre)
    return [*first, *lens(100.0, 40.0, 63.24555320336759, z=0.05, centre=centre)]


def joint(ratio, film=0.0):
    """Cemented doublet: two glasses whose indices have a ratio, or a film of the second between two of the first."""
    front = oracle.quadric(40.0, 30.0, 35.0, 1, before=1.0, after=1.5)
    found = [front, oracle.quadric(60.0, 50.0, 55.0, -1, vertex=(0, 0, 1e-3), before=1.5, after=1.5 * ratio)]
    if film:
        found.append(replace(found[1], vertex=(0, 0, 1e-3 + film), before=1.5 * ratio, after=1.5))
    return [
        *found,
        oracle.quadric(40.0, 30.0, 35.0, -1, vertex=(0, 0, 2e-3), before=found[-1].after, after=1.0),
    ]


def turned(faces, *euler):
    """The same faces, each turned about its vertex."""
    return [replace(face, euler=euler) for face in faces]


def critical(sign):
    """Incidence 1e-9 of itself from the critical angle of a plane, n = 1.5."""
    sine = (1 - sign * 1e-9) / 1.5
    return (sine, 0.0, float(np.sqrt(1 - sine * sine)))


def tangent(nudge):
    """A ray that passes the unit sphere round (0, 0, 1) below its equator, `nudge` from touching it."""
    d, up = np.array([0.6, 0.8, 0.25]), np.array([0.0, 0.0, 1.0])
    below = d * 0.25 - up * (d @ d) + 0.5 * np.cross(d, up)
    start = up + (1 + nudge) * below / np.linalg.norm(below) - 0.4 * d
    return tuple(start.tolist()), tuple(d.tolist())


oq, ob, op = oracle.quadric, oracle.biconic, oracle.polynomial
GLASS = {"before": 1.5, "after": 1.0}
FAR = 5000.0
LEAN = 0.349  # a plane leaning by 20 degrees ...
LEVEL = LEAN + asin(cos(LEAN) / 1.5)  # ... and the direction from which light leaves along the sheet
RIM = 0.0035266839949164712  # where the faces of lens(40, 40, 40) meet
# two plates of η = −1 that touch at the common focus, and lens, crossed cylinders at foci 1e-9 apart, lens (K = −n²)
PLATES = [oq(80, 80, 80), oq(80, 80, 80, -1, vertex=(0, 0, 0.0375), **GLASS), oq(80, 80, 80, vertex=(0, 0, 0.0375)), oq(80, 80, 80, -1, vertex=(0, 0, 0.075), **GLASS)]  # fmt: skip
CROSSED = [*lens(40, 40, 40), oq(0, 160, -200, vertex=(0, 0, 0.025)), oq(160, 0, -200, -1, vertex=(0, 0, 0.025 + 1.5e-9), **GLASS), *lens(40, 40, 40, z=0.05)]  # fmt: skip
# a bent pair: own radii and terms on each face (metres)
BENT = [
    op(52.54, 74.86, -1, -1, (2678.1, 20547.3, 8549.4), vertex=(0, 0, -2.55e-4)),
    op(27.98, 5.69, -1, -1, (-3750.2, -10806.1, -14735.0), side=-1, vertex=(0, 0, 2.55e-4), **GLASS),
    op(34.1, 21.3, -1, -1, (-24310.5, -70110.2, -8120.7), vertex=(0, 0, 0.0495)),
    op(166.9, 58.4, -1, -1, (31250.4, 96400.9, 12100.3), side=-1, vertex=(0, 0, 0.0505), **GLASS),
]
HARD = [
    Hard("plane", "divides by curvature 0", [oq(0, 0, 0)], (0.3, 0.1, -5), (0.1, 0.2, 1)),
    Hard("R = 1e9", "R - sqrt(R² - r²) cancels", [oq(1e-9, 1e-9, 1e-9)], (0.3, 0.1, -5), (0.1, 0.2, 1)),
    Hard("R = 1e12", "sag is 1e-26 of R", [oq(1e-12, 1e-12, 1e-12)], (0.3, 0.1, -5), (0.1, 0.2, 1)),
    Hard("paraboloid", "1/(1 + K) is infinite", [oq(0.1, 0.1, 0.0)], (0.3, 0.1, -5), (0.1, 0.2, 1)),
    Hard("paraboloid, axial", "A = 0 as well", [oq(0.1, 0.1, 0.0)], (0.3, 0.1, -5), (0, 0, 1)),
    Hard("K = -1 + 1e-12", "A is rounding only", [oq(0.1, 0.1, 1e-13)], (0.3, 0.1, -5), (0, 0, 1)),
    Hard("K = -1 - 1e-12", "A has the other sign", [oq(0.1, 0.1, -1e-13)], (0.3, 0.1, -5), (0, 0, 1)),
    Hard("hyperboloid", "the second sheet is met too", [oq(0.1, 0.1, -0.2)], (0.3, 0.1, -5), (0.1, 0.2, 1)),
    Hard("saddle", "Q changes sign across the cell", [oq(1, -1.1, 0)], (0.3, 0.3, -1), (0.02, -0.03, 1)),
    Hard("flank of a hyperboloid", "σr - B cancels: the other form of the root is due",
         [oq(0.00646, 1.82, -15.0, -1)], (1.39, -20.1, 6.89), (0.99, -0.038, -0.13)),
    Hard("flank of a saddle", "the same on a steep ray", [oq(22.4, -17.2, -0.009)], (45.3, -37.4, 22.9), (-0.5, 0.033, -0.86)),
    Hard("biconic near its equator", "Newton settles nowhere, yet there is a hit",
         [ob(-0.29, -0.88, 2.5, 1.5)], (-0.68, 0, -3), (-0.42, 0.11, 1)),
    Hard("saddle biconic near its equator", "the same where κ of the azimuth is singular",
         [ob(-0.56, 0.89, 3.0, -0.8, -1)], (-0.35, 1, -3), (0.47, 0.17, 1)),
    Hard("biconic's other half", "Newton settles on the half that does not belong",
         [ob(-0.2, -0.73, 0.2, 0.6)], (-0.56, -0.16, -3), (0.17, -0.44, 1)),
    Hard("biconic's far sheet", "a hyperbolic azimuth: the other sheet is the lower one", [ob(1, 0.8, -3.0, -2.5)], (2.5, -4.1, -8.3), (-0.1, -0.9, -0.59)),
    Hard("biconic's near sheet behind the far one", "Newton settles on the sheet that does not belong", [ob(1, 0.8, -3.0, -2.5)], (-4.2, -4.5, -1.1), (-0.8, 0.9, 0.91)),
    Hard("saddle biconic", "κ of the azimuth is singular", [ob(1, -1, -2, 0.5)], (0.3, 0.3, -1), (0.02, 0.03, 1)),
    Hard("steep saddle biconic", "Newton from the quadric leaves the surface",
         [ob(0.9, -0.8, 2.0, 1.2, before=1.0, after=1.5)], (-0.55, 0.6, -0.6), (0.1, 0.1, 1)),
    Hard("sag 5e-9 of R", "sag from a difference keeps 8 digits", [oq(1, 1, 1)], (1e-4, 0, -1), (0, 0, 1)),
    Hard("sag 5e-201 of R", "squares are 1e-200", [oq(1, 1, 1)], (1e-100, 0, -1), (0, 0, 1)),
    Hard("radii 1 : 1000", "one meridian is flat beside the other", [oq(1, 1e3, 31.6)], (3e-2, 2e-4, -0.1), (0.01, 0.01, 1)),
    Hard("radii 1 : 1e6", "the same, to the limit", [oq(1, 1e6, 1e3)], (3e-4, 3e-7, -1e-3), (0.01, 1e-4, 1)),
    Hard("needle", "semi-axis 1000 times the apex radius", [oq(1, 1, 1e-3)], (0.7, 0.2, -3), (0.05, -0.1, 1)),
    Hard("disc", "semi-axis a thousandth of the apex radius", [oq(1, 1, 1e3)], (0.02, 0.01, -3), (1e-3, -2e-3, 1)),
    Hard("source at 1 km", "B² - AC of the start is 1e12", lens(40, 40, 40), (1e-3, -5e-4, -KM), (0, 0, 1)),
    Hard("source at 1 km, oblique", "x + tL cancels 1e5 times",
         lens(40, 40, 40), (1e-3 - 0.25 * KM, -5e-4 + 0.5 * KM, -KM), (0.25, -0.5, 1)),
    Hard("source at 1 km, tilted lens", "turning first rounds the kilometre",
         turned([oq(40, 40, 40)], 0.3, 0.2, -0.7), (1e-3 - 0.25 * KM, 0.5 * KM, -KM), (0.25, -0.5, 1)),
    Hard("source at 1e9", "only the ratios of the direction may count",
         [oq(40, 40, 40)], (0.25e9, 0, -1e9), (-0.25, 0, 1)),
    Hard("start on the apex", "t is 0 and C is 0", [oq(1, 2, 1.4)], (0, 0, 0), (0.1, 0.2, 1)),
    Hard("on the axis", "x = y = 0 everywhere", pair(), (0, 0, -0.01), (0, 0, 1)),
    Hard("negative zeros", "the sign of -0 must not choose a root", pair(), (-0.0, -0.0, -0.01), (-0.0, -0.0, 1)),
    Hard("direction of length 1e-300", "its square underflows", pair(), (1e-3, -5e-4, -0.01), (1e-302, 2e-302, 1e-300)),
    Hard("direction of length 1e300", "its square overflows", pair(), (1e-3, -5e-4, -0.01), (1e298, 2e298, 1e300)),
    Hard("touching just inside", "double root: 1e-13 from a miss", [oq(1, 1, 1)], *tangent(-1e-13)),
    Hard("touching just outside", "the naive discriminant is 0 or positive", [oq(1, 1, 1)], *tangent(1e-13)),
    Hard("touching at rounding", "one unit in the last place decides", [oq(1, 1, 1)], *tangent(-4e-16)),
    Hard("below critical", "cos t = sqrt of a cancelled difference", [oq(0, 0, 0, **GLASS)], (0, 0, -1), critical(1)),
    Hard("above critical", "the same difference, negative", [oq(0, 0, 0, **GLASS)], (0, 0, -1), critical(-1)),
    Hard("89.9 degrees, glass to air side", "cos i = 0.0017",
         [oq(1, 0.5, 0.7, before=1.0, after=1.5)], (-0.9999984769, 0, -0.00174532836), (0.99999847691, 0, 0.00174532837)),
    Hard("89.999 degrees, off the apex", "misses the bowl by its slope", [oq(1, 1, 1)], (-0.999, 0, -1.745e-5), (1, 0, 1.745e-5)),
    Hard("along the vertex plane", "N = 0: the plane is never reached", [oq(1, 1, 1)], (-2, 0, 0.5), (1, 0.1, 0)),
    Hard("index ratio 1 + 1e-10", "cos t - µ cos i cancels", lens(40, 30, 35, n=1 + 1e-10), (1e-3, 5e-4, -0.01), (0.1, 0.2, 1)),
    Hard("equal indices", "must be the identity", lens(40, 30, 35, n=1.0), (1e-3, 5e-4, -0.01), (0.1, 0.2, 1)),
    Hard("index 4", "strong bending, 36 % reflected", lens(40, 30, 35, n=4.0), (1e-3, 5e-4, -0.01), (0.1, 0.2, 1)),
    Hard("outside the rim", "the faces cross before the ray: distance < 0", lens(40, 40, 40), (4.2e-3, 3e-3, -0.01), (0, 0, 1)),
    Hard("far half only", "both roots are beyond the equator", [oq(1, 1, 1)], (2, 0, 1.5), (-1, 0, 0.01)),
    Hard("start beyond the cap", "the apex lies behind", [oq(1, 1, 1)], (0, 0, 1.9), (0, 0, 1)),
    Hard("tilt 60 degrees", "the local ray is steep", turned(lens(40, 30, 35), 0.4, 1.047, 0.2), (1e-4, 2e-4, -0.01), (0, 0.02, 1)),
    Hard("tilt 120 degrees", "the local ray runs backwards", [replace(oq(4, 3, 3.5), euler=(0.4, 2.094, 0.2))], (1e-2, 2e-2, -1), (0, 0.02, 1)),
    Hard("cell (199, 199)", "x² of sheet coordinates drowns the sag", pair((0.4975, 0.4975)), (0.4988, 0.4991, -0.01), (-0.02, 0.01, 1)),
    Hard("cell 1e6", "sheet coordinates keep 1e-12", pair((FAR, -FAR)), (FAR + 0.0013, -FAR - 0.0007, -0.01), (0.01, 0.02, 1)),
    Hard("cell 1e9", "sheet coordinates keep 1e-9", pair((1e3 * FAR, 0.0025)), (1e3 * FAR + 0.0013, 0.003, -0.01), (0.01, 0.02, 1)),
    Hard("scale 1e-9", "absolute tolerances bite", lens(4e10, 4e10, 4e10, 5e-13), (1e-12, 5e-13, -1e-11), (0.1, 0.2, 1)),
    Hard("scale 1e9", "the same from the other end", lens(4e-8, 4e-8, 4e-8, 5e5), (1e6, 5e5, -1e7), (0.1, 0.2, 1)),
    Hard("slab, biconic", "needs iteration", [ob(75, 120, -4 / 9, -4 / 9), ob(60, 60, -4 / 9, -4 / 9, -1, vertex=(0, 0, 0.02), **GLASS)], (-0.0025, 0.0012, -0.01), (0.05, -0.02, 1)),
    Hard("R = 1e200", "squares of the radius overflow", [oq(1e-200, 1e-200, 1e-200)], (0.3, 0.1, -5), (0.1, 0.2, 1)),
    Hard("nearly flat back, R = 1e9", "the thickness must survive beside R", lens(1e-9, 1e-9, 1e-9), (1e-3, 5e-4, -0.01), (0.1, 0.2, 1)),
    Hard("kappa 1e-300", "κ as good as 0, but not 0", [oq(0.1, 0.1, 1e-300)], (0.3, 0.1, -5), (0, 0, 1)),
    Hard("kappa -5e-324", "κ is the smallest double", [oq(0.1, 0.1, -5e-324)], (0.3, 0.1, -5), (0.1, 0.2, 1)),
    Hard("kappa 1e-12 of c, oblique", "both roots are near and far at once", [oq(0.1, 0.1, 1e-13)], (0.3, 0.1, -5), (0.1, 0.2, 1)),
    Hard("kappa -1e-12 of c, oblique", "the far root changes side", [oq(0.1, 0.1, -1e-13)], (0.3, 0.1, -5), (0.1, 0.2, 1)),
    Hard("A cancels", "an oblique ray along the asymptote: A is rounding only", [oq(1.0, 1.0, -1.0)], (-0.7, 0.0, -1), (1.0, 0.0, 1.0)),
    Hard("A nearly cancels", "1e-9 from the asymptote", [oq(1.0, 1.0, -1.0)], (-0.7, 0.0, -1), (1.0 + 1e-9, 0.0, 1.0)),
    Hard("hyperboloid, K = -100", "nearly a cone", [oq(0.1, 0.1, -9.9)], (0.3, 0.1, -5), (0.1, 0.2, 1)),
    Hard("hyperboloid pair", "K < -1 on both sides of the glass", lens(40, 30, -20), (1e-3, 5e-4, -0.01), (0.1, 0.2, 1)),
    *(Hard(f"sag 1e-{k} of R", "a sag from a difference keeps 16 - k digits, then none",
           [oq(1, 1, 1)], (1.4142135623730951 * 10.0 ** (-k / 2), 0, -1), (0, 0, 1)) for k in (4, 6, 8, 12, 16, 30, 60, 100, 200)),
    *(Hard(f"sag 1e-{k} of R, oblique", "the lateral step is larger than the sag's own place",
           [oq(1, 0.7, 0.8)], (0.1 + 10.0 ** (-k / 2), 0.2, -1), (-0.1, -0.2, 1)) for k in (8, 16)),
    Hard("radii 1 : 1000, other way round", "x flat, y curved", [oq(1e-3, 1, 0.0316)], (2, 3e-2, -5), (0.01, 0.01, 1)),
    Hard("flat meridian", "a cylinder has no apex radius in y", [oq(0.5, 0, 0.5)], (0.3, 7.0, -5), (0.1, 0.2, 1)),
    Hard("flat meridian of 1e-300", "as good as a cylinder", [oq(0.5, 1e-300, 0.5)], (0.3, 7.0, -5), (0.1, 0.2, 1)),
    Hard("parabolic cylinder, along it", "A = B's lateral part = 0", [oq(0.5, 0, 0)], (0.3, 7.0, -5), (0, 0.7, 1)),
    Hard("just inside the equator", "1 - r²/R² cancels; the normal lies flat", [oq(1, 1, 1)], (0.9999999, 0, -1), (0, 0, 1)),
    Hard("1e-13 inside the equator", "the same to the last digits", [oq(1, 1, 1)], (1 - 1e-13, 0, -1), (0, 0, 1)),
    Hard("a quarter steep, above", "N/|D| just above 1/4: the vertex plane serves", [oq(1, 0.8, 0.9)], (-3.0, 0.1, -0.7), (1, 0, 0.2581988897471613)),
    Hard("a quarter steep, below", "just below: the point nearest the apex serves", [oq(1, 0.8, 0.9)], (-3.0, 0.1, -0.7), (1, 0, 0.2581988897471609)),
    Hard("1e-6 steep", "the vertex plane is a million radii off", [oq(1, 0.8, 0.9)], (-3.0, 0.1, 0.3), (1, 0.01, 1e-6)),
    Hard("1e-12 steep, backwards", "N < 0 and the plane beyond every digit", [oq(1, 0.8, 0.9)], (3.0, 0.1, 0.3), (-1, 0.01, -1e-12)),
    Hard("discriminant 999 times cancelled", "plain arithmetic just below the switch to pairs", [oq(1, 1, 1)], (-0.9995, 0.0, -1.0), (0, 0, 1)),
    Hard("discriminant 1001 times cancelled", "pairs just above it", [oq(1, 1, 1)], (-0.999505, 0.0, -1.0), (0, 0, 1)),
    Hard("89.999 degrees into a plane", "cos i = 1.7e-5", [oq(0, 0, 0)], (-1.0, 0, -1.745e-5), (1, 0, 1.745e-5)),
    Hard("89.999 degrees out of a plane, n 1 + 1e-10", "beside the critical angle", [oq(0, 0, 0, before=1 + 1e-10, after=1.0)], (-1, 0, -1.745e-5), (1, 0, 1.745e-5)),
    Hard("1e-15 below critical", "one rounding decides", [oq(0, 0, 0, **GLASS)], (0, 0, -1), critical(1e-6)),
    Hard("1e-15 above critical", "the same, other side", [oq(0, 0, 0, **GLASS)], (0, 0, -1), critical(-1e-6)),
    Hard("critical on a back face", "total reflection where sag and slope matter",
         [oq(0, 0, 0), oq(1, 1, 1, -1, vertex=(0, 0, 1), **GLASS)], (0.6666, 0, -1), (0, 0, 1)),
    Hard("beyond critical on a back face", "the next ray is lost",
         [oq(0, 0, 0), oq(1, 1, 1, -1, vertex=(0, 0, 1), **GLASS)], (0.6667, 0, -1), (0, 0, 1)),
    Hard("index ratio 1 - 1e-10", "the same from the dense side", lens(40, 30, 35, n=1 - 1e-10), (1e-3, 5e-4, -0.01), (0.1, 0.2, 1)),
    Hard("index ratio 1 + 2e-16", "one unit in the last place", lens(40, 30, 35, n=1 + 2.0**-52), (1e-3, 5e-4, -0.01), (0.1, 0.2, 1)),
    Hard("inside the rim by 1e-9", "the glass is 1e-9 of its thickness", lens(40, 40, 40), (RIM * (1 - 1e-9), 0, -0.01), (0, 0, 1)),
    Hard("outside the rim by 1e-9", "the faces have crossed by 1e-9 of the thickness", lens(40, 40, 40), (RIM * (1 + 1e-9), 0, -0.01), (0, 0, 1)),
    Hard("on the rim", "front and back meet: rounding decides", lens(40, 40, 40), (RIM, 0, -0.01), (0, 0, 1), undecidable=True),
    Hard("start between the faces", "the first face lies behind", lens(40, 30, 35), (1e-3, 5e-4, 0.0), (0.1, 0.2, 1)),
    Hard("pair, offset 3 focal lengths", "lens 2 is met far from its axis", [*lens(25, 40, 31.6), *lens(100, 40, 63.2, z=0.05, centre=(0.0035, -0.003), thickness=0.002)], (1e-3, -5e-4, -0.01), (0.05, -0.04, 1)),
    Hard("pair, tilt 0.5 degrees", "the paper's tilt", turned(pair(), 0.7853981633974483, 0.008726646259971648, 0), (1e-3, -5e-4, -0.01), (0.01, 0.02, 1)),
    Hard("pair, tilt 10 degrees", "cells stand askew", turned(pair(), 0.3, 0.17453292519943295, 0.5), (1e-3, -5e-4, -0.01), (0.01, 0.02, 1)),
    Hard("pair, tilt 1e-9", "a tilt as good as none", turned(pair(), 0.3, 1e-9, 0.5), (1e-3, -5e-4, -0.01), (0.01, 0.02, 1)),
    Hard("degenerate Euler angles", "θ = 0: only φ + ψ means anything", turned(pair(), 1.2, 0.0, -1.2), (1e-3, -5e-4, -0.01), (0.01, 0.02, 1)),
    Hard("backward exit", "bent past the sheet: a direction, but no light behind the sheet", [replace(oq(0, 0, 0, **GLASS), euler=(0.0, 0.349, 0.0))], (0, 0.1, -1), (0, -0.866, 0.5)),
    *(Hard(f"exit at 90 degrees {sign:+g}e-9", "the sign of d_z is the fate", [replace(oq(0, 0, 0, **GLASS), euler=(0.0, LEAN, 0.0))],
           (0, 0.1, -1), (0, -sin(LEVEL + sign * 1e-9), cos(LEVEL + sign * 1e-9))) for sign in (-1, 1)),
    Hard("cell 1e6, tilted", "far and turned at once", turned(pair((FAR, -FAR)), 0.3, 0.01, -0.2), (FAR + 0.0013, -FAR - 0.0007, -0.01), (0.01, 0.02, 1)),
    Hard("cell 1e6, far below", "far both ways", pair((FAR, -FAR)), (FAR - 1e3, -FAR - 2e3, -1e5), (0.01, 0.02, 1)),
    Hard("pair, scale 1e-9", "nanometres in metres", [replace(f, shape=(*(c * 1e9 for c in f.shape[:3]), 0.0, f.shape[4]), vertex=tuple(v * 1e-9 for v in f.vertex)) for f in pair()], (1e-12, 5e-13, -1e-11), (0.01, 0.02, 1)),
    Hard("pair, scale 1e9", "the same from the other end", [replace(f, shape=(*(c * 1e-9 for c in f.shape[:3]), 0.0, f.shape[4]), vertex=tuple(v * 1e9 for v in f.vertex)) for f in pair()], (1e6, 5e5, -1e7), (0.01, 0.02, 1)),
    Hard("scale 1e-100", "products of three lengths underflow", [oq(4e101, 3e101, 3.5e101)], (-5e-103, -1.5e-102, -1e-101), (0.1, 0.2, 1)),
    Hard("scale 1e100", "products of three lengths overflow", [oq(4e-101, 3e-101, 3.5e-101)], (-5e99, -1.5e100, -1e101), (0.1, 0.2, 1)),
    Hard("slab, ellipsoid", "one body, glass between the arrays", [oq(75, 120, 94.86832980505137), oq(120, 120, 120, -1, vertex=(0, 0, 0.01875), **GLASS)], (-0.0015, 0.0012, -0.01), (0.05, -0.02, 1)),
    Hard("plano, curved inside", "plane, gap, plane", [oq(0, 0, 0), oq(20, 25, 22, -1, vertex=(0, 0, 1e-3), **GLASS), oq(30, 30, 30, vertex=(0, 0, 0.05)), oq(0, 0, 0, -1, vertex=(0, 0, 0.051), **GLASS)], (1e-3, 5e-4, -0.01), (0.02, -0.01, 1)),
    Hard("field faces at an exact focus", "light of one direction meets at both vertices", PLATES, (1e-3, -1.4e-3, -0.01), (0, 0, 1)),
    Hard("field faces at an exact focus, rim of the field", "the same, half a cell aside", PLATES, (1.4e-3, -0.9e-3, -0.01), (0.09, 0.05, 1)),
    Hard("crossed cylinders, foci 1e-9 apart", "a plate thinner than the heights of its faces: they cross beside the axis", CROSSED, (1e-3, -5e-4, -0.01), (0, 0, 1)),
    Hard("crossed cylinders, on both axes", "in glass of 1.5e-9", CROSSED, (0, 0, -0.01), (0, 0, 1)),
    Hard("field face at the limit of its radius", "met where it stands all but upright", [*lens(40, 40, 40), oq(250, 250, 250, vertex=(0, 0, 0.025)), oq(0, 0, 0, -1, vertex=(0, 0, 0.03), **GLASS)], (1e-3, 5e-4, -0.01), (0.148, 0.01, 1)),
    Hard("biconcave lens", "negative curvatures on side +1", lens(-40, -30, -35), (1e-3, 5e-4, -0.01), (0.1, 0.2, 1)),
    Hard("source at 1e15 of R", "the start keeps no digit of the lens", lens(40, 40, 40), (1e-3, -5e-4, -4e13), (0, 0, 1)),
    # faces with terms of order 4 to 8
    Hard("polynomial, inflection", "the slope's own slope is 0 where the ray meets it",
         [op(1, 1, -1, -1, (-0.52, -1.04, -0.52))], (0.35, -0.2, -1), (0.05, 0.01, 1)),
    Hard("polynomial, A4 cancels the base", "height 0 from two that are an eighth each",
         [op(1, 1, -1, -1, (-2, -4, -2))], (0.5, -1e-3, -1), (0, 0, 1)),
    Hard("polynomial, A4 nearly cancels the base", "the same, oblique and 1e-6 beside it",
         [op(1, 1, -1, -1, (-2, -4, -2))], (0.299999, 0.39, -0.1), (1e-5, 0.1, 1)),
    Hard("polynomial, A6 and A8 cancel the rest", "four orders of one size, their sum a hundredth",
         [op(1, 1, -1, -1, (-8, -16, -8), (20, 60, 60, 20), (3, 12, 18, 12, 3))], (0.29, -0.17, -1), (0.02, 0.03, 1)),
    Hard("polynomial, A4 dominates at the rim", "the base is a tenth of the height", [op(0.3, 0.3, 0, 0, (-4, -8, -4))], (0.5, 0.4, -2), (-0.02, 0.01, 1)),
    Hard("polynomial, root beyond the real rim", "the terms go on where the ellipsoid under them has ended",
         [op(1, 1, 0, 0, (0.3, 0.6, 0.3))], (1.001, 0.0, -1), (0, 0, 1)),
    Hard("polynomial, 1e-9 inside the real rim", "the base stands upright there, its root is 4e-5", [op(1, 1, 0, 0, (0.3, 0.6, 0.3))], (1 - 1e-9, 0.0, -1), (0, 0, 1)),
    Hard("polynomial, met on the real rim", "the root of the radicand is known from the height only",
         [op(1, 1, 0, 0, (0.1, 0.2, 0.1))], (-1.377342, 0.176576, 0.605835), (0.448, 0.163, 0.508)),
    Hard("polynomial, search from the real rim", "where it stands upright every step of Newton is small, root or no root",
         [op(1, 1, 0, 0, (0.1, 0.2, 0.1))], (-1.682, -0.575, 0.799), (0.94, 0.14, 0.34)),
    Hard("polynomial, met far from the vertex plane", "the ray passes that plane where the base has long ended",
         [op(1, 1, 0, 0, (0.1, 0.2, 0.1))], (-3.9, 0.05, -0.3), (0.9, 0.0, 0.3)),
    Hard("polynomial, start over no real height", "the base is real only farther along the ray", [op(1, 1, 0, 0, (0.1, 0.2, 0.1))], (-1.4, 0.1, -0.2), (0.8, 0, 0.6)),
    Hard("polynomial, grazing", "met at a flat angle: the place is ten times as far as the height is off",
         [op(0.5, 0.4, -1, -1, (0.1, -0.3, 0.2))], (-1.7, 0.1, -0.35), (1.0, 0.02, 0.25)),
    Hard("polynomial, ripple", "the ray crosses three times: the first towards its side is meant", [op(0, 0, 0, 0, (6, 12, 6), (-16, -48, -48, -16))], (0.1, 0, -0.05), (0.9, 0.1, 0.3)),
    Hard("polynomial without base", "a height of 1e-12 and its slope vanish at the apex", [op(0, 0, 0, 0, (0.7, -0.2, 1.1))], (1e-3, -2e-3, -1), (0, 0, 1)),
    Hard("polynomial saddle", "base and terms of either sign", [op(0.8, -0.7, -2, 0.5, (0.3, -0.9, 0.2), side=-1)], (0.3, -0.4, -1), (0.05, -0.02, 1)),
    Hard("polynomial, K = -1 + 1e-12", "the base is as good as a polynomial, but not one",
         [op(0.9, 1.2, -1 + 1e-12, -1 - 1e-12, (0.2, 0.4, 0.1))], (0.3, -0.2, -1), (0.1, 0.2, 1)),
    Hard("polynomial, backwards", "N < 0: it is crossed from above", [op(0.9, 1.2, 0.3, -2, (0.2, 0.4, 0.1))], (0.3, -0.2, 2), (0.1, 0.2, -1)),
    Hard("polynomial, scale 1e-9", "coefficients of 1e27 and 1e63", [op(0.9e9, 1.2e9, -1, -1, (2e26, 4e26, 1e26), a8=(3e62, 0, 0, 0, 1e62))], (3e-10, -2e-10, -1e-9), (0.1, 0.2, 1)),
    Hard("polynomial, scale 1e9", "coefficients of 1e-28 and 1e-64", [op(0.9e-9, 1.2e-9, -1, -1, (2e-28, 4e-28, 1e-28), a8=(3e-64, 0, 0, 0, 1e-64))], (3e8, -2e8, -1e9), (0.1, 0.2, 1)),
    Hard("polynomial, tilt 60 degrees", "the local ray is steep", [replace(op(0.9, 1.2, -1, -1, (0.2, 0.4, 0.1)), euler=(0.4, 1.047, 0.2))], (0.01, 0.02, -1), (0, 0.02, 1)),
    Hard("bent pair of polynomials", "four faces, each with its own radii and terms", BENT, (1e-3, -1.4e-3, -0.01), (0.012, -0.008, 1)),
    Hard("joint at 89.999 degrees", "cos i = 1.7e-5 between two glasses", [oq(0, 0, 0, before=1.5, after=1.6)], (-1.0, 0, -1.745e-5), (1, 0, 1.745e-5)),
    Hard("joint at 89.999 degrees, ratio 1 - 1e-12", "critical at 89.99992 degrees", [oq(0, 0, 0, before=1.5, after=1.5 * (1 - 1e-12))],
         (-1.0, 0, -1.745e-5), (1, 0, 1.745e-5)),
    Hard("joint at 89.9999 degrees, ratio 1 - 1e-12", "1e-7 of an angle beyond the critical one", [oq(0, 0, 0, before=1.5, after=1.5 * (1 - 1e-12))],
         (-1.0, 0, -1.2e-6), (1, 0, 1.2e-6)),
    Hard("joint below critical", "cos t = sqrt of a cancelled difference", [oq(0, 0, 0, before=1.8, after=1.2)], (0, 0, -1), critical(1)),
    Hard("joint above critical", "the same difference, negative", [oq(0, 0, 0, before=1.8, after=1.2)], (0, 0, -1), critical(-1)),
    Hard("curved joint, ratio 1 + 1e-12", "three faces, of which the middle one hardly bends", joint(1 + 1e-12), (1e-3, 5e-4, -0.01), (0.1, 0.2, 1)),
    Hard("curved joint, ratio 1 - 1e-12", "the same from the dense side", joint(1 - 1e-12), (1e-3, 5e-4, -0.01), (0.1, 0.2, 1)),
    Hard("curved joint, 1e-9 of index across it", "a layer in which light hardly changes its direction: all of its colour", joint(1 + 1e-9 / 1.5), (1e-3, 5e-4, -0.01), (0.1, 0.2, 1)),
    Hard("flat joint, 1e-9 of index across it", "the sine changes by 1e-10", [oq(0, 0, 0, before=1.8, after=1.8 + 1e-9)], (0.3, 0.1, -5), (0.1, 0.2, 1)),
    Hard("curved joint, ratio 1.25", "a joint that bends as a face of a lens does", joint(1.25), (1e-3, 5e-4, -0.01), (0.1, 0.2, 1)),
    Hard("film of 1e-6 pitches between joints", "the way through it is 1e-9 of that to it", joint(1.1, film=5e-10), (1e-3, 5e-4, -0.01), (0.1, 0.2, 1)),
    Hard("film of 1e-12 pitches between joints", "thinner than the rounding of its place", joint(1.1, film=5e-16), (1e-3, 5e-4, -0.01), (0.1, 0.2, 1)),
]  # fmt: skip
