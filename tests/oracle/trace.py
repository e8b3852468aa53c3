"""Sequential tracing in 60 digits, written from the textbook definitions; shares no code with clacad.

A quadric is solved by the two roots of its quadratic; a biconic by all roots of the quartic
z² P − 2 side z Q + Q² = 0 that follows from z = side Q/(1 + sqrt(1 − P)); a polynomial face by walking along the ray over
the stretch where its base is real, and narrowing every change of sign. Snell's law is used as n1 sin i = n2 sin t in
the plane of incidence. Everything happens in sheet coordinates, which 60 digits can afford.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from mpmath import mp, mpf

DIGITS = 60
STEP = mpf(2) ** -90
WALK = 4001
"""Places along a ray at which a polynomial face is looked at first."""


@dataclass(frozen=True)
class Face:
    """One surface: kind, its five numbers, vertex, indices, Euler angles or a rotation matrix (row by row), and the
    coefficients of x⁴, x² y², y⁴, x⁶, …, y⁸ of a polynomial face.
    """

    kind: str
    shape: tuple[float, float, float, float, int]  # cx, cy, kappa or K_x, 0 or K_y, side
    vertex: tuple[float, float, float] = (0.0, 0.0, 0.0)
    before: float = 1.0
    after: float = 1.5
    euler: tuple[float, float, float] | None = None
    rotation: object = None
    terms: tuple = ()


@dataclass
class Path:
    """What became of one ray."""

    status: str = "ok"
    surface: int | None = None
    hits: list = field(default_factory=list)
    directions: list = field(default_factory=list)
    optical_path: list = field(default_factory=list)


def quadric(cx, cy, kappa, side=1, **place):
    """A quadric face."""
    return Face("quadric", (cx, cy, kappa, 0.0, side), **place)


def biconic(cx, cy, conic_x, conic_y, side=1, **place):
    """A biconic face."""
    return Face("biconic", (cx, cy, conic_x, conic_y, side), **place)


def polynomial(cx, cy, conic_x, conic_y, a4, a6=(0, 0, 0, 0), a8=(0, 0, 0, 0, 0), side=1, **place):
    """A conic with terms of order 4, 6 and 8 on top."""
    return Face("polynomial", (cx, cy, conic_x, conic_y, side), terms=(*a4, *a6, *a8), **place)


POWERS = [(2 * (order - j), 2 * j) for order in (2, 3, 4) for j in range(order + 1)]
"""Powers of x and y of the terms, in their order."""


def terms_of(face, x, y):
    """Height of a polynomial face's terms and its slopes, times side."""
    side, height, in_x, in_y = mpf(face.shape[4]), mpf(0), mpf(0), mpf(0)
    for a, (m, n) in zip(face.terms, POWERS):
        if a == 0:
            continue
        a = side * mpf(a)
        height += a * x**m * y**n
        in_x += a * m * x ** (m - 1) * y**n if m else 0
        in_y += a * n * x**m * y ** (n - 1) if n else 0
    return height, in_x, in_y


def dot(a, b):
    """Scalar product."""
    return sum((u * v for u, v in zip(a, b)), mpf(0))


def cross(a, b):
    """Vector product."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def unit(a):
    """A vector of length 1."""
    length = mp.sqrt(dot(a, a))
    return [u / length for u in a]


def euler_matrix(phi, theta, psi):
    """Rz(psi) Rx(theta) Rz(phi), each written out and multiplied."""

    def about_z(angle):
        c, s = mp.cos(angle), mp.sin(angle)
        return [[c, -s, mpf(0)], [s, c, mpf(0)], [mpf(0), mpf(0), mpf(1)]]

    def about_x(angle):
        c, s = mp.cos(angle), mp.sin(angle)
        return [[mpf(1), mpf(0), mpf(0)], [mpf(0), c, -s], [mpf(0), s, c]]

    def times(a, b):
        return [[dot(row, column) for column in zip(*b)] for row in a]

    return times(about_z(mpf(psi)), times(about_x(mpf(theta)), about_z(mpf(phi))))


def sag(face, x, y):
    """Height of a face over its own plane, or None beyond its equator."""
    cx, cy, k, m, side = (mpf(v) for v in face.shape)
    x, y = mpf(x), mpf(y)
    q = cx * x * x + cy * y * y
    p = k * q if face.kind == "quadric" else (1 + k) * cx**2 * x * x + (1 + m) * cy**2 * y * y
    if p > 1:
        return None
    return side * q / (1 + mp.sqrt(1 - p)) + terms_of(face, x, y)[0]


def slope(face, x, y):
    """Partial derivatives of `sag`, by differences; call it at 60 digits or more, the step is 1e-25 of a radius."""
    h = mpf(10) ** -25 * (1 / max(abs(mpf(c)) for c in face.shape[:2]) if any(face.shape[:2]) else 1)
    in_x = (sag(face, mpf(x) + h, y) - sag(face, mpf(x) - h, y)) / (2 * h)
    in_y = (sag(face, x, mpf(y) + h) - sag(face, x, mpf(y) - h)) / (2 * h)
    return in_x, in_y


def trace(faces, start, direction, digits=DIGITS):
    """Trace one ray; numbers are taken as they are."""
    with mp.workdps(digits):
        return _trace(faces, [mpf(v) for v in start], [mpf(v) for v in direction])


def _trace(faces, position, direction):
    path, length = Path(), mpf(0)
    direction = unit(direction)
    for number, face in enumerate(faces):
        turn = _matrix(face)
        local = [dot(column, [p - mpf(v) for p, v in zip(position, face.vertex)]) for column in zip(*turn)]
        ray = [dot(column, direction) for column in zip(*turn)]
        distance = _first_crossing(face, local, ray)
        if distance is None:
            path.status, path.surface = "missed", number
            return path
        hit = [p + distance * d for p, d in zip(local, ray)]
        out = _snell(ray, _normal(face, hit), mpf(face.before), mpf(face.after))
        length += mpf(face.before) * distance
        position = [dot(row, hit) + mpf(v) for row, v in zip(turn, face.vertex)]
        path.hits.append(position)
        path.optical_path.append(length)
        if out is None:
            path.status, path.surface = "tir", number
            return path
        direction = [dot(row, out) for row in turn]
        path.directions.append(direction)
        if distance < 0:
            path.status, path.surface = "missed", number
            return path
    return path


def _matrix(face):
    if face.rotation is not None:
        return [[mpf(float(v)) for v in row] for row in face.rotation]
    return euler_matrix(*(face.euler or (0, 0, 0)))


def _level(face, x, y, z):
    """κ-like number at a point: 1 − side·level·z is the z component of the normal."""
    cx, cy, k, m, _ = (mpf(v) for v in face.shape)
    if face.kind == "quadric":
        return k
    q = cx * x * x + cy * y * y
    return ((1 + k) * cx**2 * x * x + (1 + m) * cy**2 * y * y) / q if q else mpf(0)


def _normal(face, hit):
    """Normal towards +z from the implicit equation's gradient."""
    cx, cy, k, m, side = (mpf(v) for v in face.shape)
    x, y, z = hit
    if face.kind == "quadric":
        return unit([-side * cx * x, -side * cy * y, 1 - side * k * z])
    a, b = (1 + k) * cx**2, (1 + m) * cy**2
    w = mp.sqrt(1 - a * x * x - b * y * y)
    q = cx * x * x + cy * y * y
    slope_x = side * (2 * cx * x / (1 + w) + q * a * x / (w * (1 + w) ** 2))
    slope_y = side * (2 * cy * y / (1 + w) + q * b * y / (w * (1 + w) ** 2))
    _, more_x, more_y = terms_of(face, x, y)
    return unit([-slope_x - more_x, -slope_y - more_y, mpf(1)])


def _first_crossing(face, p, d):
    """Distance to the crossing of the apex half that leads to the side the ray goes to."""
    onward = -1 if d[2] < 0 else 1
    good = []
    for t in _real_roots(face, p, d):
        hit = [u + t * v for u, v in zip(p, d)]
        if _on_apex_half(face, hit) and onward * dot(_normal(face, hit), d) >= 0:
            good.append((abs(hit[2]), t))
    return min(good)[1] if good else None


def _on_apex_half(face, hit):
    side = face.shape[4]
    x, y, z = hit
    if face.kind == "quadric":
        return 1 - side * mpf(face.shape[2]) * z > 0
    height = sag(face, x, y)
    size = mpf(10) ** (-mp.dps // 2) * (abs(x) + abs(y) + abs(z))
    if face.kind == "polynomial":
        return height is not None and abs(height - z) <= size
    return height is not None and abs(height - z) <= size and _level(face, x, y, z) * side * z < 1


def _real_roots(face, p, d):
    cx, cy, k, m, side = (mpf(v) for v in face.shape)
    (x, y, z), (L, M, N) = p, d
    if face.kind == "polynomial":
        return _walked_roots(face, p, d)
    q = [cx * L * L + cy * M * M, 2 * (cx * x * L + cy * y * M), cx * x * x + cy * y * y]
    height = [N, z]
    if face.kind == "quadric":
        squared = _times(height, height)
        return _quadratic([a + k * b - c for a, b, c in zip(q, squared, [0, 2 * side * N, 2 * side * z])])
    a, b = (1 + k) * cx**2, (1 + m) * cy**2
    p2 = [a * L * L + b * M * M, 2 * (a * x * L + b * y * M), a * x * x + b * y * y]
    quartic = _times(_times(height, height), p2)
    for i, value in enumerate(_times(q, q)):
        quartic[i] += value
    for i, value in enumerate(_times(height, q)):
        quartic[i + 1] -= 2 * side * value
    return _polynomial_roots(quartic)


def _walked_roots(face, p, d):
    """Every crossing of a polynomial face: changes of sign of z − sag along the ray, narrowed to all digits."""
    size = _size(face)
    middle = -p[2] / d[2] if abs(d[2]) > mpf("1e-3") else -dot(p, d)
    t = np.linspace(-40.0, 40.0, WALK)
    at = [float((u + middle * v) / size) + float(v) * t for u, v in zip(p, d)]
    heights = at[2] - _heights(face, at[0], at[1], float(size))
    real = np.isfinite(heights)
    changes = real[:-1] & real[1:] & (np.sign(heights[:-1]) != np.sign(heights[1:]))

    def place(k):
        return middle + size * (mpf(80) * mpf(int(k)) / (WALK - 1) - 40)

    def gap(s):
        height = sag(face, p[0] + s * d[0], p[1] + s * d[1])
        return None if height is None else p[2] + s * d[2] - height

    brackets = [(place(k), place(k + 1)) for k in np.flatnonzero(changes)]
    for k in np.flatnonzero(
        real[:-1] != real[1:]
    ):  # the base ends here: from just inside to the first real place
        inside, outside = (k, k + 1) if real[k] else (k + 1, k)
        brackets.append((_end_of_base(gap, place(inside), place(outside)), place(inside)))
    found = [_narrowed(gap, low, high) for low, high in brackets]
    return [root for root in found if root is not None]


def _end_of_base(gap, inside, outside):
    """The last place, to all digits, at which there is a height."""
    for _ in range(4 * mp.dps):
        half = (inside + outside) / 2
        inside, outside = (half, outside) if gap(half) is not None else (inside, half)
    return inside


def _size(face):
    """A length of the order of the shortest radius of a polynomial face, or of the reach of its terms."""
    curved = [abs(mpf(c)) for c in face.shape[:2]]
    curved += [abs(mpf(a)) ** (mpf(1) / (m + n - 1)) for a, (m, n) in zip(face.terms, POWERS)]
    return 1 / max(curved)


def _heights(face, x, y, size):
    """Heights in lengths of `size`, double precision: where to look, not what is found."""
    cx, cy, kx, ky, side = (float(v) for v in face.shape)
    cx, cy = cx * size, cy * size
    with np.errstate(invalid="ignore"):
        w = np.sqrt(1 - (1 + kx) * cx**2 * x * x - (1 + ky) * cy**2 * y * y)
    height = (cx * x * x + cy * y * y) / (1 + w)
    for a, (m, n) in zip(face.terms, POWERS):
        if a:
            height = height + float(mpf(a) * mpf(size) ** (m + n - 1)) * x**m * y**n
    return side * height


def _narrowed(gap, low, high):
    """Root between two places of opposite signs, by the Illinois rule; None where the signs are the same."""
    at_low, at_high, before, side = gap(low), gap(high), None, 0
    if at_low is None or at_high is None or at_low * at_high > 0:
        return None
    close = abs(high - low) * mpf(10) ** (4 - mp.dps)
    for _ in range(4 * mp.dps):
        here = (low * at_high - high * at_low) / (at_high - at_low)
        if before is not None and abs(here - before) <= close:
            return here
        before, at_here = here, gap(here)
        if at_here == 0:
            return here
        if at_here * at_high > 0:
            high, at_high, at_low = here, at_here, at_low / 2 if side < 0 else at_low
            side = -1
        else:
            low, at_low, at_high = here, at_here, at_high / 2 if side > 0 else at_high
            side = 1
    return before


def _times(a, b):
    out = [mpf(0)] * (len(a) + len(b) - 1)
    for i, u in enumerate(a):
        for j, v in enumerate(b):
            out[i + j] += u * v
    return out


def _quadratic(coefficients):
    a, b, c = coefficients
    if a == 0:
        return [-c / b] if b else []
    disc = b * b - 4 * a * c
    if disc < 0:
        return []
    big = -(b + (1 if b >= 0 else -1) * mp.sqrt(disc)) / 2
    return [big / a, c / big] if big else [mpf(0)]


def _polynomial_roots(coefficients):
    trailing = []
    while len(coefficients) > 1 and coefficients[-1] == 0:
        coefficients, trailing = coefficients[:-1], [mpf(0)]
    top = max(abs(c) for c in coefficients)
    while coefficients and abs(coefficients[0]) <= top * mpf(10) ** (-2 * mp.dps):
        coefficients = coefficients[1:]
    if len(coefficients) < 2:
        return trailing
    roots = mp.polyroots(coefficients, maxsteps=500, extraprec=4 * mp.prec)
    real = [mp.re(r) for r in roots if abs(mp.im(r)) <= mpf(10) ** (-mp.dps // 2) * abs(r)]
    return trailing + real


def _snell(d, normal, n1, n2):
    """Sine scaled by n1/n2 in the plane of incidence, cosine from Pythagoras; None at total reflection."""
    if dot(d, normal) < 0:
        normal = [-u for u in normal]
    along = dot(d, normal)
    tangential = [(u - along * v) * n1 / n2 for u, v in zip(d, normal)]
    cosine2 = 1 - dot(tangential, tangential)
    if cosine2 < 0:
        return None
    return [u + mp.sqrt(cosine2) * v for u, v in zip(tangential, normal)]


def condition(faces, start, direction, digits=DIGITS):
    """Change of the last direction per relative change of the inputs, summed over them.

    Inputs: start (relative to the first vertex), direction, curvatures and indices, one at a time.
    """
    return _amplification(faces, start, direction, digits, lambda path: path.directions[-1])


def sag_condition(faces, start, direction, digits=DIGITS):
    """Relative change of the height of the last hit over the vertex's level, likewise."""
    level = mpf(faces[-1].vertex[2])
    return _amplification(
        faces, start, direction, digits, lambda path: [mp.log(abs(path.hits[-1][2] - level))]
    )


def _amplification(faces, start, direction, digits, answer):
    with mp.workdps(digits):
        base = trace(faces, start, direction, digits)
        if base.status != "ok":
            return mpf(0)
        total = mpf(0)
        for nudged in _nudges(faces, start, direction):
            there = trace(*nudged, digits)
            if there.status != base.status:
                return mp.inf
            change = [u - v for u, v in zip(answer(there), answer(base))]
            total += mp.sqrt(dot(change, change)) / STEP
        return total


def _nudges(faces, start, direction):
    vertex = faces[0].vertex
    for i in range(3):
        moved = [mpf(v) for v in start]
        moved[i] += STEP * (moved[i] - mpf(vertex[i]))
        yield faces, moved, direction
        turned = [mpf(v) for v in direction]
        turned[i] *= 1 + STEP
        yield faces, start, turned
    for k, face in enumerate(faces):
        for i in range(4):
            shape = list(face.shape)
            shape[i] = mpf(shape[i]) * (1 + STEP)
            if face.shape[i]:
                yield [*faces[:k], replace(face, shape=tuple(shape)), *faces[k + 1 :]], start, direction
        for i, term in enumerate(face.terms):
            if term:
                terms = (*face.terms[:i], mpf(term) * (1 + STEP), *face.terms[i + 1 :])
                yield [*faces[:k], replace(face, terms=terms), *faces[k + 1 :]], start, direction
        changed = replace(face, after=mpf(face.after) * (1 + STEP))
        if face.after != face.before:
            yield [*faces[:k], changed, *faces[k + 1 :]], start, direction
