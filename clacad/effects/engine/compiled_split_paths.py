"""Split paths, compiled: partial reflections followed from lens to lens.

The fast version of `clacad.effects.engine.nonsequential` for light that passed lenses only. From every
recorded hit a part is reflected back through the faces it came through, each in the lenslet before it or on
the flat border, and is reflected forward once more. Cases that need a walk end the path here: steps between
lenslets, seams, the sheet's edge, total reflection. That is a few per cent of light that is itself a few per
cent.
"""

from __future__ import annotations

from math import cos, exp, pi, sqrt
from typing import NamedTuple

import numpy as np

from clacad.base.compiled import entry, exact
from clacad.base.types import Floats, Rows
from clacad.effects.engine.compiled_passes import deviation, reflected
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.cells import in_zone, kept, relocate
from clacad.tracing.compiled.column import well_inside
from clacad.tracing.compiled.face import bend, to_lens, to_sheet
from clacad.tracing.compiled.packing import Packed
from clacad.tracing.compiled.records import Ray, Vector


class Passing(NamedTuple):
    """Properties of faces and bodies for light of one wavelength.

    media : (f + 1,). Refractive index before the first face and behind each.
    rates : (b,), inverse lengths. Attenuation of each body.
    layer : 0 for bare faces, else design wavelength over wavelength of a quarter-wave layer.
    """

    media: Floats
    rates: Floats
    layer: float


class SplitPaths(NamedTuple):
    """Result: for each ray first the f paths back to the camera's side, then the pairs of reflections.

    position, direction : (m, f (f + 1)/2, 3), flux : (m, f (f + 1)/2). Flux 0 where a path ended.
    """

    position: Floats
    direction: Floats
    flux: Floats


@exact
def reflected_share(turn: float, n1: float, n2: float, layer: float) -> float:
    """Share of unpolarised light reflected at a face that deflects the ray by 1 − D·D' = turn.

    Layer as in `Passing`.
    """
    if layer == 0.0 or n1 == n2:
        return reflected(turn, n1, n2)
    square, c = (n2 - n1) * (n2 - n1), 1.0 - turn
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
def _cell_of(lat: Floats, array: int, x: float, y: float) -> tuple[float, float, float, float]:
    """Cell of an array that holds a sheet point, and the point relative to its centre."""
    x, y = x - lat[slot.SHIFT + 2 * array], y - lat[slot.SHIFT + 2 * array + 1]
    return relocate(lat, x - lat[slot.X0], y - lat[slot.Y0])


@exact
def meet_lens_or_land(sheet: Packed, k: int, ray: Ray) -> tuple[float, Vector]:
    """Distance to face k along a ray of the sheet's frame and the unit normal there.

    NaN where a walk is needed.
    """
    t, normal = meet_lens(sheet, k, ray)
    face, b, lat = sheet.faces[k], k // 2, sheet.lattice
    if t == t or face[slot.ARRAY] < 0.0 or lat[slot.OPAQUE] != 0.0:
        return t, normal
    t = (face[slot.LAND] + sheet.bodies[b, slot.LEVEL] - ray.z) / ray.N
    px, py = ray.x + t * ray.L, ray.y + t * ray.M
    if t >= 0.0 and well_inside(sheet.bodies, b, px, py):
        i, j, _, _ = _cell_of(lat, int(face[slot.ARRAY]), px, py)
        if not kept(lat, sheet.rows, i, j):
            return t, (0.0, 0.0, 1.0)
    return np.nan, normal


@exact
def meet_lens(sheet: Packed, k: int, ray: Ray) -> tuple[float, Vector]:
    """Distance to the lens of face k and the unit normal there; NaN where there is none."""
    faces, face, lat = sheet.faces, sheet.faces[k], sheet.lattice
    x, y, z, u, v, w = ray
    structured, side = face[slot.ARRAY] >= 0.0, face[slot.SIDE]
    level = sheet.bodies[k // 2, slot.LEVEL]
    t, normal = (face[slot.VZ] + level - z) / w, (0.0, 0.0, 1.0)
    d, e, f = to_lens(faces, k, u, v, w)
    for _ in range(2):
        # first the cell under the vertex plane, then the cell under the hit
        px, py, pz = x + t * u, y + t * v, z + t * w
        if not well_inside(sheet.bodies, k // 2, px, py):
            return np.nan, normal
        cx, cy, i, j = px, py, 0.0, 0.0
        if structured:
            i, j, cx, cy = _cell_of(lat, int(face[slot.ARRAY]), px, py)
        over = pz - (face[slot.VZ] + level)
        a, b, c = to_lens(faces, k, cx - face[slot.VX], cy - face[slot.VY], over)
        lift = -c / f
        a, b = a + lift * d, b + lift * e
        square = face[slot.CX] * d * d + face[slot.CY] * e * e + face[slot.KX] * f * f
        half = face[slot.CX] * a * d + face[slot.CY] * b * e - side * f
        rest = face[slot.CX] * a * a + face[slot.CY] * b * b
        under = half * half - square * rest
        if not under > 0.0:
            return np.nan, normal
        sign = side if f > 0.0 else -side
        step = rest / (sign * sqrt(under) - half)
        hx, hy, hz = a + step * d, b + step * e, step * f
        gx, gy, gz = -side * face[slot.CX] * hx, -side * face[slot.CY] * hy, 1.0 - side * face[slot.KX] * hz
        if not gz > 0.0:
            return np.nan, normal
        length = 1.0 / sqrt(gx * gx + gy * gy + gz * gz)
        nx, ny, nz = to_sheet(faces, k, gx, gy, gz)
        normal = (nx * length, ny * length, nz * length)
        t_hit = t + lift + step
        if not structured:
            return t_hit, normal
        on = t_hit - t
        if in_zone(lat, cx + on * u, cy + on * v, lat[slot.MARGIN]):
            buried = (
                pz + on * w - (face[slot.LAND] + level)
            ) * side > 0.0  # never true for NaN, a face without land
            if buried or not kept(lat, sheet.rows, i, j):
                return np.nan, normal
            return t_hit, normal
        t = t_hit
    return np.nan, normal


@exact
def through(
    sheet: Packed, k: int, ray: Ray, n1: float, n2: float, layer: float
) -> tuple[float, Ray, float, Ray]:
    """Cross face k: distance (NaN for none), ray behind it, share reflected, and the reflected ray."""
    x, y, z, u, v, w = ray
    t, (nx, ny, nz) = meet_lens_or_land(sheet, k, ray)
    if not t >= 0.0:
        return np.nan, ray, 0.0, ray
    x, y, z = x + t * u, y + t * v, z + t * w
    along = u * nx + v * ny + w * nz
    if along < 0.0:
        nx, ny, nz, along = -nx, -ny, -nz, -along
    mu = n1 / n2
    g = bend(1.0, mu * along, (n2 - n1) / n2 * ((n2 + n1) / n2))
    if not g == g:
        return np.nan, ray, 0.0, ray
    p, q, r = mu * u + g * nx, mu * v + g * ny, mu * w + g * nz
    share = reflected_share(deviation((u, v, w), (p, q, r)), n1, n2, layer)
    back = 2.0 * along
    return t, Ray(x, y, z, p, q, r), share, Ray(x, y, z, u - back * nx, v - back * ny, w - back * nz)


@exact
def forward(sheet: Packed, k: int, ray: Ray, flux: float, passing: Passing) -> tuple[float, Ray]:
    """Follow light from behind face k − 1 through faces k, k + 1, …: its share and ray behind the last."""
    for face in range(k, len(sheet.faces)):
        n1, n2 = passing.media[face], passing.media[face + 1]
        t, ray, lost, _ = through(sheet, face, ray, n1, n2, passing.layer)
        if not (t >= 0.0 and ray.N > 0.0):
            return 0.0, ray
        flux *= 1.0 - lost
        if face % 2 == 1:
            flux *= exp(-passing.rates[face // 2] * t)
    return flux, ray


@exact
def _way_back(
    sheet: Packed, passing: Passing, order: int, k: int, part: float, ray: Ray, paths: SplitPaths, i: int
) -> None:
    """Follow light reflected back at face k of row i, and its forward reflections at the faces it hits."""
    pair = len(sheet.faces) + k * (k - 1) // 2
    for face in range(k - 1, -1, -1):
        paths.flux[i, pair] = 0.0
        if part > 0.0 and ray.N < 0.0:
            n1, n2 = passing.media[face + 1], passing.media[face]
            t, beyond, again, turned = through(sheet, face, ray, n1, n2, passing.layer)
            if t >= 0.0:
                if face % 2 == 0:  # it came through the material behind a front face
                    part *= exp(-passing.rates[face // 2] * t)
                if order > 1 and turned.N > 0.0:
                    paths.flux[i, pair], end = forward(sheet, face + 1, turned, part * again, passing)
                    _put(paths, i, pair, end)
                ray = beyond
                part *= 1.0 - again
            else:
                part = 0.0
        else:
            part = 0.0
        pair += 1
    paths.flux[i, k] = part if ray.N < 0.0 else 0.0
    _put(paths, i, k, ray)


@exact
def _put(paths: SplitPaths, i: int, path: int, ray: Ray) -> None:
    """Write the end of a path of row i."""
    position, direction = paths.position, paths.direction
    position[i, path, 0], position[i, path, 1], position[i, path, 2] = ray.x, ray.y, ray.z
    direction[i, path, 0], direction[i, path, 1], direction[i, path, 2] = ray.L, ray.M, ray.N


@entry
def bounce_pass(
    sheet: Packed,
    passing: Passing,
    order: int,
    rows: Rows,
    start: Floats,
    hits: Floats,
    turns: Floats,
    paths: SplitPaths,
) -> None:
    """Split paths of rays that crossed lenses at every face.

    order : 1 or 2. Largest number of reflections in a path.
    rows : (m,). Rays to split.
    start : (n, 3). Unit directions as launched.
    hits, turns : (f, n, 3). Point at which each face was hit, and the direction behind it.
    """
    index = passing.media
    for i in range(len(rows)):
        row = rows[i]
        share, u, v, w = 1.0, start[row, 0], start[row, 1], start[row, 2]
        for k in range(len(sheet.faces)):
            p, q, r = turns[k, row, 0], turns[k, row, 1], turns[k, row, 2]
            n1, n2 = index[k], index[k + 1]
            lost = reflected_share(deviation((u, v, w), (p, q, r)), n1, n2, passing.layer)
            if k % 2 == 1:
                length = 0.0
                for c in range(3):
                    length += (hits[k, row, c] - hits[k - 1, row, c]) ** 2
                share *= exp(-passing.rates[k // 2] * sqrt(length))
            nx, ny, nz = n2 * p - n1 * u, n2 * q - n1 * v, n2 * r - n1 * w
            square = nx * nx + ny * ny + nz * nz
            part, back = share * lost if square > 0.0 else 0.0, 0.0
            if part > 0.0:
                back = 2.0 * (u * nx + v * ny + w * nz) / square
            hx, hy, hz = hits[k, row, 0], hits[k, row, 1], hits[k, row, 2]
            turned = Ray(hx, hy, hz, u - back * nx, v - back * ny, w - back * nz)
            _way_back(sheet, passing, order, k, part, turned, paths, i)
            share *= 1.0 - lost
            u, v, w = p, q, r
