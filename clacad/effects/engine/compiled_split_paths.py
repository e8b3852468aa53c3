"""Split paths, compiled: partial reflections followed from lens to lens.

The quick twin of `clacad.effects.engine.nonsequential` for light that went through lenses only: from every recorded hit a part is
reflected, meets the faces it came through again, each in the lenslet it stands before or on the flat border, and is
reflected forward once more. What a walk would have to decide (steps between lenslets, seams, the sheet's edge, total
reflection) ends the path here; that is a few per cent of light that is itself a few per cent.
"""

from __future__ import annotations

from math import cos, exp, floor, pi, sqrt

import numpy as np

from clacad.base.compiled import exact
from clacad.base.types import Floats, Ints, Rows

Ray = tuple[float, float, float, float, float, float]

# columns of a face's row
CX, CY, KAPPA, SIDE, VX, VY, VZ, SHIFT_X, SHIFT_Y, STRUCTURED, ROTATION = range(11)
LAND, MID_X, MID_Y, HALF_X, HALF_Y, RADIUS, COLUMNS = 19, 20, 21, 22, 23, 24, 25

# the lattice's numbers
HEXAGONAL, PITCH, ROW, ORIGIN_X, ORIGIN_Y, MARGIN, N1, N2, OPAQUE = range(9)


@exact
def reflected_share(turn: float, n1: float, n2: float, layer: float) -> float:
    """Share of unpolarised light reflected where a passage turns the ray by 1 − D·D' = turn.

    layer: 0 for a bare face, else design wavelength over wavelength of a quarter-wave layer.
    """
    step = (n2 - n1) * (n2 + n1)
    if step == 0.0:
        return 0.0
    square, c = (n2 - n1) * (n2 - n1), 1.0 - turn
    if layer == 0.0:
        s = (square + 2.0 * n1 * n2 * turn) / step
        p = (square - (n1 * n1 + n2 * n2) * turn) / (step * c)
        return 0.5 * (s * s + p * p)
    n = sqrt(n1 * n2)
    size = sqrt(square + 2.0 * n1 * n2 * turn)
    c1, c2 = abs(n2 * c - n1) / size, abs(n2 - n1 * c) / size
    inner = sqrt(max(1.0 - (n1 / n) * (n1 / n) * (1.0 - c1 * c1), 0.0))
    twice = cos(pi * layer * inner)
    total = 0.0
    for polarisation in range(2):
        if polarisation == 0:
            a1, a, a2 = n1 * c1, n * inner, n2 * c2
        else:
            a1, a, a2 = c1 / n1, inner / n, c2 / n2
        first, second = (a1 - a) / (a1 + a), (a - a2) / (a + a2)
        both = first * first + second * second + 2.0 * first * second * twice
        total += both / (1.0 + first * first * second * second + 2.0 * first * second * twice)
    return 0.5 * total


@exact
def centred(lattice: Floats, x: float, y: float) -> tuple[float, float, float, float]:
    """Give x, y from the centre of the cell they lie in, and that cell's i, j."""
    pitch, row = lattice[PITCH], lattice[ROW]
    x, y = x - lattice[ORIGIN_X], y - lattice[ORIGIN_Y]
    if lattice[HEXAGONAL] == 0.0:
        i, j = float(floor(x / pitch + 0.5)), float(floor(y / row + 0.5))
        return x - pitch * i, y - row * j, i, j
    # nearest of the two rows' nearest cells: cells of this lattice are its Voronoi cells
    best_x, best_y, best = 0.0, 0.0, np.inf
    best_i, best_j = -1.0, -1.0
    below = floor(y / row)
    for upper in range(2):
        j = float(below) + upper
        along = x - 0.5 * pitch * j
        i = float(floor(along / pitch + 0.5))
        u, v = along - pitch * i, y - row * j
        if u * u + v * v < best:
            best_x, best_y, best = u, v, u * u + v * v
            best_i, best_j = i, j
    return best_x, best_y, best_i, best_j


@exact
def has_cell(lattice: Floats, runs: Ints, i: float, j: float) -> bool:
    """Whether the sheet has this cell; a plain lattice has no table of rows."""
    if not 0.0 <= j < lattice[N2]:
        return False
    if len(runs) == 0:
        return bool(0.0 <= i < lattice[N1])
    row = int(j)
    return bool(runs[row, 0] <= i < runs[row, 1])


@exact
def in_lens(lattice: Floats, x: float, y: float) -> bool:
    """Whether a point of the cell frame lies in the optical zone."""
    half = 0.5 * lattice[PITCH] - lattice[MARGIN]
    if lattice[HEXAGONAL] == 0.0:
        return bool(abs(x) <= half and abs(y) <= 0.5 * lattice[ROW] - lattice[MARGIN])
    skew = 0.5 * sqrt(3.0) * abs(y)
    return bool(abs(x) <= half and 0.5 * abs(x) + skew <= half)


@exact
def within(face: Floats, x: float, y: float) -> bool:
    """Whether a point of the sheet frame lies well inside the body's footprint."""
    mx, my = x - face[MID_X], y - face[MID_Y]
    return bool(abs(mx) < face[HALF_X] and abs(my) < face[HALF_Y] and mx * mx + my * my < face[RADIUS] ** 2)


@exact
def meet(face: Floats, lattice: Floats, runs: Ints, ray: Ray) -> tuple[float, float, float, float]:
    """Distance to a face along a ray of the sheet frame and the unit normal there; NaN where the walk must decide."""
    t, nx, ny, nz = meet_lens(face, lattice, runs, ray)
    if t == t or face[STRUCTURED] == 0.0 or lattice[OPAQUE] != 0.0:
        return t, nx, ny, nz
    x, y, z, u, v, w = ray
    t = (face[LAND] - z) / w
    px, py = x + t * u, y + t * v
    if t >= 0.0 and within(face, px, py):
        _, _, i, j = centred(lattice, px - face[SHIFT_X], py - face[SHIFT_Y])
        if not has_cell(lattice, runs, i, j):
            return t, 0.0, 0.0, 1.0
    return np.nan, nx, ny, nz


@exact
def meet_lens(face: Floats, lattice: Floats, runs: Ints, ray: Ray) -> tuple[float, float, float, float]:
    """Distance to the lens of a face and the unit normal there; NaN where there is none."""
    x, y, z, u, v, w = ray
    t = (face[VZ] - z) / w
    t_hit = np.nan
    nx, ny, nz = 0.0, 0.0, 1.0
    r = face[ROTATION : ROTATION + 9]
    for _ in range(2):
        # first the cell under the vertex plane, then the cell under the hit
        px, py, pz = x + t * u, y + t * v, z + t * w
        if not within(face, px, py):
            return np.nan, nx, ny, nz
        cx, cy, i, j = px, py, 0.0, 0.0
        if face[STRUCTURED] > 0.0:
            cx, cy, i, j = centred(lattice, px - face[SHIFT_X], py - face[SHIFT_Y])
        ox, oy, oz = cx - face[VX], cy - face[VY], pz - face[VZ]
        a, b, c = (
            r[0] * ox + r[3] * oy + r[6] * oz,
            r[1] * ox + r[4] * oy + r[7] * oz,
            r[2] * ox + r[5] * oy + r[8] * oz,
        )
        d, e, f = (
            r[0] * u + r[3] * v + r[6] * w,
            r[1] * u + r[4] * v + r[7] * w,
            r[2] * u + r[5] * v + r[8] * w,
        )
        lift = -c / f
        a, b = a + lift * d, b + lift * e
        side = face[SIDE]
        square = face[CX] * d * d + face[CY] * e * e + face[KAPPA] * f * f
        half = face[CX] * a * d + face[CY] * b * e - side * f
        rest = face[CX] * a * a + face[CY] * b * b
        under = half * half - square * rest
        if not under > 0.0:
            return np.nan, nx, ny, nz
        sign = side if f > 0.0 else -side
        step = rest / (sign * sqrt(under) - half)
        hx, hy, hz = a + step * d, b + step * e, step * f
        gx, gy, gz = -side * face[CX] * hx, -side * face[CY] * hy, 1.0 - side * face[KAPPA] * hz
        if not gz > 0.0:
            return np.nan, nx, ny, nz
        t_hit = t + lift + step
        length = 1.0 / sqrt(gx * gx + gy * gy + gz * gz)
        nx = (r[0] * gx + r[1] * gy + r[2] * gz) * length
        ny = (r[3] * gx + r[4] * gy + r[5] * gz) * length
        nz = (r[6] * gx + r[7] * gy + r[8] * gz) * length
        if face[STRUCTURED] == 0.0:
            return t_hit, nx, ny, nz
        lx, ly = cx + (t_hit - t) * u, cy + (t_hit - t) * v
        if in_lens(lattice, lx, ly):
            top = face[VZ] + (pz - face[VZ]) + (t_hit - t) * w
            buried = (top - face[LAND]) * side > 0.0  # never so for NaN, a face without land
            if buried or not has_cell(lattice, runs, i, j):
                return np.nan, nx, ny, nz
            return t_hit, nx, ny, nz
        t = t_hit
    return np.nan, nx, ny, nz


@exact
def through(
    faces: Floats, lattice: Floats, runs: Ints, k: int, ray: Ray, n1: float, n2: float, layer: float
) -> tuple[float, Ray, float, Ray]:
    """Cross face k: distance (NaN where the path ends), ray behind it, share reflected, and the reflected ray."""
    x, y, z, u, v, w = ray
    t, nx, ny, nz = meet(faces[k], lattice, runs, ray)
    if not t >= 0.0:
        return np.nan, ray, 0.0, ray
    x, y, z = x + t * u, y + t * v, z + t * w
    along = u * nx + v * ny + w * nz
    if along < 0.0:
        nx, ny, nz, along = -nx, -ny, -nz, -along
    mu = n1 / n2
    square = 1.0 - mu * mu * (1.0 - along) * (1.0 + along)
    if not square > 0.0:
        return np.nan, ray, 0.0, ray
    g = sqrt(square) - mu * along
    p, q, r = mu * u + g * nx, mu * v + g * ny, mu * w + g * nz
    turn = 0.5 * ((p - u) * (p - u) + (q - v) * (q - v) + (r - w) * (r - w))
    back = 2.0 * along
    return (
        t,
        (x, y, z, p, q, r),
        reflected_share(turn, n1, n2, layer),
        (x, y, z, u - back * nx, v - back * ny, w - back * nz),
    )


@exact
def forward(
    faces: Floats, lattice: Floats, runs: Ints, k: int, ray: Ray, flux: float, index: Floats, rates: Floats,
    layer: float,
) -> tuple[float, Ray]:  # fmt: skip
    """Light going on from behind face k − 1 through faces k, k + 1, …: its share and ray behind the last."""
    for face in range(k, len(faces)):
        n1, n2 = index[face], index[face + 1]
        t, ray, lost, _ = through(faces, lattice, runs, face, ray, n1, n2, layer)
        if not (t >= 0.0 and ray[5] > 0.0):
            return 0.0, ray
        flux *= 1.0 - lost
        if face % 2 == 1:
            flux *= exp(-rates[face // 2] * t)
    return flux, ray


@exact
def bounce_pass(
    faces: Floats, lattice: Floats, runs: Ints, index: Floats, rates: Floats, layer: float, order: int, rows: Rows,
    start: Floats, hits: Floats, turns: Floats, position: Floats, direction: Floats, flux: Floats,
) -> None:  # fmt: skip
    """Split paths of rays whose every face was a lens.

    Parameters
    ----------
    faces : (f, COLUMNS), lattice : (9,)
    runs : (n2, 2)
        First kept cell of each row of the lattice and one past its last; empty where all rows are alike.
    index : (f + 1,)
        Before the first face and behind each.
    rates : (b,)
        Attenuation of each body.
    rows : (m,)
        Rays to split.
    start : (n, 3)
        Unit directions as launched.
    hits, turns : (f, n, 3)
    position, direction : (m, f (f + 1)/2, 3), flux : (m, f (f + 1)/2)
        Result: first the f paths back to the camera's side, then the pairs; flux 0 where a path ended.
    """
    count = len(faces)
    for i in range(len(rows)):
        row = rows[i]
        share, pair = 1.0, count
        u, v, w = start[row, 0], start[row, 1], start[row, 2]
        for k in range(count):
            p, q, r = turns[k, row, 0], turns[k, row, 1], turns[k, row, 2]
            n1, n2 = index[k], index[k + 1]
            turn = 0.5 * ((p - u) * (p - u) + (q - v) * (q - v) + (r - w) * (r - w))
            lost = reflected_share(turn, n1, n2, layer)
            if k % 2 == 1:
                length = 0.0
                for c in range(3):
                    length += (hits[k, row, c] - hits[k - 1, row, c]) ** 2
                share *= exp(-rates[k // 2] * sqrt(length))
            nx, ny, nz = n2 * p - n1 * u, n2 * q - n1 * v, n2 * r - n1 * w
            square = nx * nx + ny * ny + nz * nz
            ray = (hits[k, row, 0], hits[k, row, 1], hits[k, row, 2], u, v, w)
            part = share * lost if square > 0.0 else 0.0
            if part > 0.0:
                back = 2.0 * (u * nx + v * ny + w * nz) / square
                ray = (ray[0], ray[1], ray[2], u - back * nx, v - back * ny, w - back * nz)
            for step in range(k):
                face = k - 1 - step
                flux[i, pair] = 0.0
                if part > 0.0 and ray[5] < 0.0:
                    t, beyond, again, turned = through(
                        faces, lattice, runs, face, ray, index[face + 1], index[face], layer
                    )
                    if t >= 0.0:
                        if face % 2 == 0:  # it came through the material behind a front face
                            part *= exp(-rates[face // 2] * t)
                        if order > 1 and turned[5] > 0.0:
                            flux[i, pair], end = forward(
                                faces, lattice, runs, face + 1, turned, part * again, index, rates, layer
                            )
                            for c in range(3):
                                position[i, pair, c], direction[i, pair, c] = end[c], end[c + 3]
                        ray = beyond
                        part *= 1.0 - again
                    else:
                        part = 0.0
                else:
                    part = 0.0
                pair += 1
            flux[i, k] = part if ray[5] < 0.0 else 0.0
            for c in range(3):
                position[i, k, c], direction[i, k, c] = ray[c], ray[c + 3]
            share *= 1.0 - lost
            u, v, w = p, q, r
