"""Compiled scalar pieces of the walk: one ray, one face. Formulas as in `clacad.optics.surface` and `face`.

Notation as in `clacad.optics.surface`. `snell` and `bend` are the only compiled form of Snell's law.
"""

from __future__ import annotations

from math import copysign, inf, isfinite, nan, sqrt
from typing import NamedTuple

from clacad.base.compiled import entry, exact, pair_product, pair_sum, two_product
from clacad.base.types import Floats, Ints
from clacad.optics.surface import ULP
from clacad.optics.surface.roots import CANCELS, FLAT, NEWTON_STEPS, POLISHES, SETTLED, STEEPEST
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.even_polynomial import polynomial_normal, polynomial_over, polynomial_root
from clacad.tracing.compiled.records import Ray, Vector

ROOT_STEPS = 60
"""Steps of the joint search for the roots of a quartic; a dozen suffice unless roots nearly coincide."""


class Conic(NamedTuple):
    """Coefficients of cx x² + cy y² + κ z² − 2 side z = 0, in inverse lengths."""

    cx: float
    cy: float
    kappa: float
    side: float


@exact
def to_lens(faces: Floats, row: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Sheet axes to lens axes."""
    if faces[row, slot.TURNED] == 0.0:
        return x, y, z
    return (
        faces[row, slot.R0] * x + faces[row, slot.R0 + 3] * y + faces[row, slot.R0 + 6] * z,
        faces[row, slot.R0 + 1] * x + faces[row, slot.R0 + 4] * y + faces[row, slot.R0 + 7] * z,
        faces[row, slot.R0 + 2] * x + faces[row, slot.R0 + 5] * y + faces[row, slot.R0 + 8] * z,
    )


@exact
def to_sheet(faces: Floats, row: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Lens axes to sheet axes."""
    if faces[row, slot.TURNED] == 0.0:
        return x, y, z
    return (
        faces[row, slot.R0] * x + faces[row, slot.R0 + 1] * y + faces[row, slot.R0 + 2] * z,
        faces[row, slot.R0 + 3] * x + faces[row, slot.R0 + 4] * y + faces[row, slot.R0 + 5] * z,
        faces[row, slot.R0 + 6] * x + faces[row, slot.R0 + 7] * y + faces[row, slot.R0 + 8] * z,
    )


@exact
def _discriminant(conic: Conic, ray: Ray) -> float:
    """B² − AC in pairs; equal at every point of the ray."""
    cx, cy, kappa, side = conic
    x, y, z, L, M, N = ray
    lh, ll = two_product(kappa, z)
    uh, ul = pair_sum(lh, ll, -2.0 * side, 0.0)
    lh, ll = pair_sum(lh, ll, -side, 0.0)
    ah, al = _three_products(cx, L, L, cy, M, M)
    h, e = two_product(N, N)
    h, e = pair_product(kappa, 0.0, h, e)
    ah, al = pair_sum(ah, al, h, e)
    bh, bl = _three_products(cx, x, L, cy, y, M)
    h, e = pair_product(lh, ll, N, 0.0)
    bh, bl = pair_sum(bh, bl, h, e)
    ch, cl = _three_products(cx, x, x, cy, y, y)
    h, e = pair_product(uh, ul, z, 0.0)
    ch, cl = pair_sum(ch, cl, h, e)
    bh, bl = pair_product(bh, bl, bh, bl)
    ah, al = pair_product(ah, al, ch, cl)
    return pair_sum(bh, bl, -ah, -al)[0]


@exact
def _three_products(a: float, b: float, c: float, d: float, e: float, f: float) -> tuple[float, float]:
    """Sum a b c + d e f as a pair."""
    h, low = two_product(b, c)
    h, low = pair_product(a, 0.0, h, low)
    g, rest = two_product(e, f)
    g, rest = pair_product(d, 0.0, g, rest)
    return pair_sum(h, low, g, rest)


@exact
def _carry(ray: Ray) -> tuple[float, Vector]:
    """Distance to a base point near the apex, and that point."""
    x, y, z, L, M, N = ray
    square = L * L + M * M + N * N
    if N * N >= STEEPEST * STEEPEST * square:
        t = -z / N
        return t, (x + t * L, y + t * M, 0.0)
    t = -(x * L + y * M + z * N) / square
    return t, (x + t * L, y + t * M, z + t * N)


@exact
def _quadric_root(conic: Conic, ray: Ray, base: Vector) -> tuple[float, float]:
    """Distance from the base point and r of the crossing from the −z side (for N > 0)."""
    cx, cy, kappa, side = conic
    _, _, _, L, M, N = ray
    bx, by, bz = base
    a = cx * L * L + cy * M * M + kappa * N * N
    b = cx * bx * L + cy * by * M + (kappa * bz - side) * N
    c = cx * bx * bx + cy * by * by + (kappa * bz - 2.0 * side) * bz
    disc = b * b - a * c
    if b * b > CANCELS * abs(disc):
        disc = _discriminant(conic, ray)
    if not disc >= 0.0:
        return nan, nan
    root = sqrt(disc)
    signed = -side * root if N < 0.0 else side * root
    if signed * b <= 0.0:
        return c / (signed - b), root
    return -(b + signed) / a, root


@exact
def _biconic_parts(faces: Floats, row: int, x: float, y: float) -> tuple[float, float]:
    """Q, w (0 beyond the equator) and the κ of the quadric that shares the profile at this azimuth."""
    cx, cy = faces[row, slot.CX], faces[row, slot.CY]
    a, b = (1.0 + faces[row, slot.KX]) * cx * cx, (1.0 + faces[row, slot.KY]) * cy * cy
    q = cx * x * x + cy * y * y
    p = a * x * x + b * y * y
    w = sqrt(1.0 - p) if p < 1.0 else 0.0
    return w, (p / q if q != 0.0 else (1.0 + faces[row, slot.KX]) * cx)


@exact
def _biconic_root(faces: Floats, row: int, ray: Ray, base: Vector) -> tuple[float, float]:
    """Newton on the azimuth's own quadric (`optics.surface.roots`); root search where it diverges."""
    bx, by, bz = base
    _, _, _, L, M, N = ray
    cx, cy, side = faces[row, slot.CX], faces[row, slot.CY], faces[row, slot.SIDE]
    of_x, of_y = (1.0 + faces[row, slot.KX]) * cx, (1.0 + faces[row, slot.KY]) * cy
    skew = cx * cy * (of_x - of_y)
    sign = -side if N < 0.0 else side
    t, root = _quadric_root(Conic(cx, cy, 0.5 * (of_x + of_y), side), ray, base)
    for _ in range(NEWTON_STEPS):
        u, v = bx + t * L, by + t * M
        w, kappa = _biconic_parts(faces, row, u, v)
        target, root = _quadric_root(Conic(cx, cy, kappa, side), ray, base)
        slope = sign * skew * u * v * (v * L - u * M) / ((1.0 + w) * (1.0 + w) * root)
        change = (target - t) / (1.0 - slope if abs(1.0 - slope) > FLAT else 1.0)
        if not isfinite(change):
            break
        t += change
        if abs(change) <= SETTLED * abs(t):
            u, v = bx + t * L, by + t * M
            q = cx * u * u + cy * v * v
            rounding = 8.0 * ULP * (abs(cx) * u * u + abs(cy) * v * v)
            level = side * (bz + t * N) * (-1.0 if q < 0.0 else 1.0)
            if -rounding <= level <= abs(q) + rounding:
                return t, root
            break
    return _biconic_quartic(faces, row, Ray(bx, by, bz, L, M, N)), 0.0


@exact
def _biconic_quartic(faces: Floats, row: int, ray: Ray) -> float:
    """Crossing of a ray where Newton failed: lowest qualifying root of z² P − 2 side z Q + Q² = 0."""
    x, y, z, L, M, N = ray
    cx, cy, side = faces[row, slot.CX], faces[row, slot.CY], faces[row, slot.SIDE]
    a, b = (1.0 + faces[row, slot.KX]) * cx * cx, (1.0 + faces[row, slot.KY]) * cy * cy
    p0, p1, p2 = a * x * x + b * y * y, 2.0 * (a * x * L + b * y * M), a * L * L + b * M * M
    q0, q1, q2 = cx * x * x + cy * y * y, 2.0 * (cx * x * L + cy * y * M), cx * L * L + cy * M * M
    k0 = q0 * q0 - 2.0 * side * q0 * z + p0 * z * z
    k1 = 2.0 * q0 * q1 - 2.0 * side * (q0 * N + q1 * z) + p1 * z * z + 2.0 * p0 * z * N
    k2 = 2.0 * q0 * q2 + q1 * q1 - 2.0 * side * (q1 * N + q2 * z) + p2 * z * z + 2.0 * p1 * z * N + p0 * N * N
    k3 = 2.0 * q1 * q2 - 2.0 * side * q2 * N + 2.0 * p2 * z * N + p1 * N * N
    k4 = q2 * q2 + p2 * N * N
    c0, c1, c2, c3 = k0 / k4, k1 / k4, k2 / k4, k3 / k4
    if not (isfinite(c0) and isfinite(c1) and isfinite(c2) and isfinite(c3)):
        return nan
    size = max(max(abs(c3), abs(c2) ** 0.5), max(abs(c1) ** (1.0 / 3.0), abs(c0) ** 0.25))
    if size == 0.0:
        return 0.0
    r0, r1, r2, r3 = _roots_of_four(c0 / size**4, c1 / size**3, c2 / size**2, c3 / size)
    best, lowest = nan, inf
    for t in (r0 * size, r1 * size, r2 * size, r3 * size):
        polished, level = _biconic_polished(faces, row, t, ray)
        if level < lowest:
            best, lowest = polished, level
    return best


@exact
def _roots_of_four(c0: float, c1: float, c2: float, c3: float) -> tuple[float, float, float, float]:
    """Real parts of the roots of t⁴ + c3 t³ + c2 t² + c1 t + c0, all at once (Durand 1960, Kerner 1966)."""
    u, v, w, s = 1.0 + 0.0j, 0.4 + 0.9j, -0.65 + 0.72j, -0.908 - 0.297j
    for _ in range(ROOT_STEPS):
        du = ((((u + c3) * u + c2) * u + c1) * u + c0) / ((u - v) * (u - w) * (u - s))
        u = u - du
        dv = ((((v + c3) * v + c2) * v + c1) * v + c0) / ((v - u) * (v - w) * (v - s))
        v = v - dv
        dw = ((((w + c3) * w + c2) * w + c1) * w + c0) / ((w - u) * (w - v) * (w - s))
        w = w - dw
        ds = ((((s + c3) * s + c2) * s + c1) * s + c0) / ((s - u) * (s - v) * (s - w))
        s = s - ds
        if abs(du) + abs(dv) + abs(dw) + abs(ds) < 1e-14:
            break
    return u.real, v.real, w.real, s.real


@exact
def _biconic_polished(faces: Floats, row: int, t: float, ray: Ray) -> tuple[float, float]:
    """Newton on z − sag along the ray; |z| at the hit, infinite where there is none in the ray's sense."""
    x, y, z, L, M, N = ray
    cx, cy, side = faces[row, slot.CX], faces[row, slot.CY], faces[row, slot.SIDE]
    skew = cx * cy * ((1.0 + faces[row, slot.KX]) * cx - (1.0 + faces[row, slot.KY]) * cy)
    along = -1.0 if N < 0.0 else 1.0
    error, onward = inf, 0.0
    for _ in range(POLISHES):
        u, v = x + t * L, y + t * M
        gap = _biconic_gap(faces, row, u, v, z + t * N)
        w, _ = _biconic_parts(faces, row, u, v)
        twist = side * skew * u * v / ((1.0 + w) * (1.0 + w))
        onward = along * ((-side * cx * u - twist * v) * L + (-side * cy * v + twist * u) * M + w * N)
        error = gap * w / (along * onward)
        t -= error
    if abs(error) <= SETTLED * abs(t) and onward > 0.0:
        return t, abs(z + t * N)
    return t, inf


@exact
def _biconic_gap(faces: Floats, row: int, x: float, y: float, z: float) -> float:
    """Height of a point over the biconic; NaN beyond the equator."""
    cx, cy = faces[row, slot.CX], faces[row, slot.CY]
    p = (1.0 + faces[row, slot.KX]) * cx * cx * x * x + (1.0 + faces[row, slot.KY]) * cy * cy * y * y
    if not p <= 1.0:
        return nan
    return float(z - faces[row, slot.SIDE] * (cx * x * x + cy * y * y) / (1.0 + sqrt(1.0 - p)))


@exact
def meet(
    faces: Floats, row: int, x: float, y: float, z: float, L: float, M: float, N: float
) -> tuple[float, float, float, float, float, float, float, float]:
    """Distance to the apex half in the lens frame, point, normal turned along the ray, r; NaN on a miss."""
    cx, cy, side = faces[row, slot.CX], faces[row, slot.CY], faces[row, slot.SIDE]
    ray = Ray(x, y, z, L, M, N)
    carried, base = _carry(ray)
    if faces[row, slot.BICONIC] == 0.0:
        t, root = _quadric_root(Conic(cx, cy, faces[row, slot.KX], side), ray, base)
    elif faces[row, slot.BICONIC] == slot.POLYNOMIAL:
        t, root = polynomial_root(faces, row, ray, base), 0.0
    else:
        t, root = _biconic_root(faces, row, ray, base)
    px, py, pz = base[0] + t * L, base[1] + t * M, base[2] + t * N
    gx, gy, gz = -side * cx * px, -side * cy * py, 1.0 - side * faces[row, slot.KX] * pz
    if faces[row, slot.BICONIC] == slot.POLYNOMIAL:
        gx, gy, gz = polynomial_normal(faces, row, px, py, pz)
        root = abs(gx * L + gy * M + gz * N)
    elif faces[row, slot.BICONIC] != 0.0:
        w, _ = _biconic_parts(faces, row, px, py)
        gz = w
        skew = cx * cy * ((1.0 + faces[row, slot.KX]) * cx - (1.0 + faces[row, slot.KY]) * cy)
        twist = side * skew * px * py / ((1.0 + w) * (1.0 + w))
        gx, gy = gx - twist * py, gy + twist * px
        root = abs(gx * L + gy * M + gz * N)
    if not (gz > 0.0 and isfinite(t) and isfinite(root)):
        return nan, nan, nan, nan, nan, nan, nan, nan
    if N < 0.0:
        gx, gy, gz = -gx, -gy, -gz
    return carried + t, px, py, pz, gx, gy, gz, root


@exact
def bend(square: float, incident: float, weight: float) -> float:
    """Multiple of the normal G that refraction adds to n1/n2 D, in the form without cancellation; NaN at
    total reflection.

    square : |G|²; incident : n1/n2 D·G > 0; weight : 1 − (n1/n2)²
    """
    return weight / (sqrt(square * weight + incident * incident) + incident)


@exact
def snell(direction: Vector, normal: Vector, root: float, n1: float, n2: float) -> Vector:
    """Direction behind a surface whose normal, turned along the ray, makes root = D·G; NaN for TIR."""
    L, M, N = direction
    gx, gy, gz = normal
    mu = n1 / n2
    weight = (n2 - n1) / n2 * ((n2 + n1) / n2)
    incident = mu * root
    square = gx * gx + gy * gy + gz * gz
    # between equal indices nothing is refracted along the face
    g = 0.0 if weight == 0.0 and incident <= 0.0 else bend(square, incident, weight)
    return mu * L + g * gx, mu * M + g * gy, mu * N + g * gz


@exact
def height(faces: Floats, row: int, x: float, y: float) -> float:
    """Height of the lens over the body's level above a point of the cell frame; NaN where there is none."""
    if faces[row, slot.ARRAY] < 0.0:
        return float(faces[row, slot.VZ])
    if faces[row, slot.TURNED] == 0.0 and faces[row, slot.BICONIC] == 0.0:
        x, y = x - faces[row, slot.VX], y - faces[row, slot.VY]
        q = faces[row, slot.CX] * x * x + faces[row, slot.CY] * y * y
        radicand = 1.0 - faces[row, slot.KX] * q
        return (
            faces[row, slot.VZ] + faces[row, slot.SIDE] * q / (1.0 + sqrt(radicand))
            if radicand > 0.0
            else nan
        )
    u, v, w = to_lens(faces, row, x - faces[row, slot.VX], y - faces[row, slot.VY], 0.0)
    L, M, N = to_lens(faces, row, 0.0, 0.0, 1.0)
    t, _, _, _, gx, gy, gz, _ = meet(faces, row, u, v, w, L, M, N)
    if not to_sheet(faces, row, gx, gy, gz)[2] > 0.0:
        return nan
    return float(faces[row, slot.VZ] + t)


@exact
def lens_roots(
    faces: Floats, row: int, x: float, y: float, z: float, L: float, M: float, N: float
) -> tuple[float, float]:
    """Both distances at which a ray crosses the whole of a lens's surface; inf where it does not."""
    x, y, z = to_lens(faces, row, x - faces[row, slot.VX], y - faces[row, slot.VY], z - faces[row, slot.VZ])
    L, M, N = to_lens(faces, row, L, M, N)
    cx, cy, side, kappa = faces[row, slot.CX], faces[row, slot.CY], faces[row, slot.SIDE], faces[row, slot.KX]
    if faces[row, slot.BICONIC] != 0.0:
        kappa = 0.5 * ((1.0 + faces[row, slot.KX]) * cx + (1.0 + faces[row, slot.KY]) * cy)
    a = cx * L * L + cy * M * M + kappa * N * N
    b = cx * x * L + cy * y * M + (kappa * z - side) * N
    c = cx * x * x + cy * y * y + (kappa * z - 2.0 * side) * z
    one, two = inf, inf
    disc = b * b - a * c
    if disc >= 0.0:
        q = -(b + copysign(sqrt(disc), b))
        one, two = _finite(c / q), _finite(q / a)
    if faces[row, slot.BICONIC] == 0.0:
        return one, two
    met = meet(faces, row, x, y, z, L, M, N)[0]
    other = two if abs(one - met) < abs(two - met) else one
    for _ in range(8):
        other -= _biconic_step(faces, row, x + other * L, y + other * M, z + other * N, L, M, N)
    return _finite(met), _finite(other)


@exact
def _biconic_step(
    faces: Floats, row: int, x: float, y: float, z: float, L: float, M: float, N: float
) -> float:
    """Newton step along the ray towards z = sag(x, y)."""
    if faces[row, slot.BICONIC] == slot.POLYNOMIAL:
        gx, gy, w, gap, _ = polynomial_over(faces, row, x, y, z)
        return float(gap * w / (L * gx + M * gy + N * w)) if w > 0.0 else nan
    cx, cy, side = faces[row, slot.CX], faces[row, slot.CY], faces[row, slot.SIDE]
    a, b = (1.0 + faces[row, slot.KX]) * cx * cx, (1.0 + faces[row, slot.KY]) * cy * cy
    p = a * x * x + b * y * y
    if not p <= 1.0:
        return nan
    w = sqrt(1.0 - p)
    sag = side * (cx * x * x + cy * y * y) / (1.0 + w)
    skew = cx * cy * ((1.0 + faces[row, slot.KX]) * cx - (1.0 + faces[row, slot.KY]) * cy)
    twist = side * skew * x * y / ((1.0 + w) * (1.0 + w))
    gx, gy = -side * cx * x - twist * y, -side * cy * y + twist * x
    return float((z - sag) * w / (L * gx + M * gy + N * w))


@exact
def _finite(t: float) -> float:
    return t if isfinite(t) else inf


@exact
def upward(faces: Floats, row: int, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Normal G towards +z at a point near a lens (lens frame), and its height over the lens, times |G|."""
    cx, cy, side = faces[row, slot.CX], faces[row, slot.CY], faces[row, slot.SIDE]
    if faces[row, slot.BICONIC] == 0.0:
        kappa = faces[row, slot.KX]
        over = -0.5 * side * (cx * x * x + cy * y * y + (kappa * z - 2.0 * side) * z)
        return -side * cx * x, -side * cy * y, 1.0 - side * kappa * z, over
    if faces[row, slot.BICONIC] == slot.POLYNOMIAL:
        gx, gy, w, gap, _ = polynomial_over(faces, row, x, y, z)
        return gx, gy, w, gap * w
    w, _ = _biconic_parts(faces, row, x, y)
    skew = cx * cy * ((1.0 + faces[row, slot.KX]) * cx - (1.0 + faces[row, slot.KY]) * cy)
    twist = side * skew * x * y / ((1.0 + w) * (1.0 + w))
    gap = _biconic_gap(faces, row, x, y, z)
    return -side * cx * x - twist * y, -side * cy * y + twist * x, w, gap * w


class FaceSequences(NamedTuple):
    """Sequences of single faces that differ by their places alone, without the cells around them.

    faces : (f, FACE_NUMBERS), media : (f, 2). Numbers of each face, and the indices before and behind it.
    vertices : (f, m, 3) lengths. Of each sequence.
    turns : (f, 3, 3), homes : (f, m, 3). A hit is noted as turnᵀ (hit − home).
    """

    faces: Floats
    media: Floats
    vertices: Floats
    turns: Floats
    homes: Floats


@entry
def through_faces(cells: FaceSequences, which: Ints, start: Floats, ray: Floats, hits: Floats) -> None:
    """Trace rays through single faces in the given order, as `optics.sequence`; NaN where one ends.

    which : (n,). The sequence of each ray.
    start, ray : (n, 3). Unit directions, changed to those behind the last face.
    hits : (f, n, 3). Receives the points.
    """
    faces, vertices, turns, homes = cells.faces, cells.vertices, cells.turns, cells.homes
    for i in range(len(start)):
        k, nothing = which[i], False
        L, M, N = ray[i, 0], ray[i, 1], ray[i, 2]
        x, y, z = start[i, 0], start[i, 1], start[i, 2]
        bx, by, bz = 0.0, 0.0, 0.0
        for f in range(len(faces)):
            vx, vy, vz = vertices[f, k, 0], vertices[f, k, 1], vertices[f, k, 2]
            sx, sy, sz = to_lens(faces, f, x + (bx - vx), y + (by - vy), z + (bz - vz))
            u, v, w = to_lens(faces, f, L, M, N)
            t, px, py, pz, gx, gy, gz, root = meet(faces, f, sx, sy, sz, u, v, w)
            nothing = nothing or not t >= -8.0 * ULP * (max(abs(sx), abs(sy), abs(sz)) + abs(t))
            u, v, w = snell((u, v, w), (gx, gy, gz), root, cells.media[f, 0], cells.media[f, 1])
            x, y, z = to_sheet(faces, f, px, py, pz)
            L, M, N = to_sheet(faces, f, u, v, w)
            bx, by, bz = vx, vy, vz
            a, b, c = x + (vx - homes[f, k, 0]), y + (vy - homes[f, k, 1]), z + (vz - homes[f, k, 2])
            for n in range(3):
                hits[f, i, n] = turns[f, 0, n] * a + turns[f, 1, n] * b + turns[f, 2, n] * c
        ends = nothing or not N > 0.0
        ray[i, 0], ray[i, 1], ray[i, 2] = nan if ends else L, nan if ends else M, nan if ends else N
