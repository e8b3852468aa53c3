"""The passes over faces, compiled: one loop over the rays of a block, all faces of a ray at once.

Compiled versions of the numpy passes in `fresnel`, `absorption` and `polarisation` (bare faces), with the
same closed forms in D·D'. Loaded only together with the tracer's compiled kernels.

Split paths, compiled: partial reflections followed from lens to lens.

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
from clacad.base.types import Bytes, Cells, Floats, Rows
from clacad.optics.rays import Fate
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.array_cells import on_line
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
    if sheet.lattice[slot.LINED] == k:
        array = int(sheet.lattice[slot.LINE_ARRAY])
        i, j, cx, cy = _cell_of(sheet.lattice, array, x, y)
        if on_line(sheet, k, array, i, j, cx, cy):
            return np.nan, ray, 0.0, ray
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


GHOST, TIR, MISSED = int(Fate.GHOST), int(Fate.TIR), int(Fate.MISSED)


class Traced(NamedTuple):
    """Record of a trace, and the refractive indices along it.

    start, ray : (n, 3). As launched, directions of any length.
    hits, turns : (f, n, 3). Point at which each face was hit and the direction behind it.
    fate : (n,) bytes, last : (n,) ints. Fate of the ray, and the last face that it hit.
    media : (f + 1,). Refractive index before the first face and behind each.
    """

    start: Floats
    ray: Floats
    hits: Floats
    turns: Floats
    fate: Bytes
    last: Cells
    media: Floats


@exact
def crosses(traced: Traced, k: int, row: int) -> bool:
    """Whether a ray crossed face k: its hit differs from the one before, and it did not end there."""
    fate, last = traced.fate[row], traced.last[row]
    if fate <= GHOST:
        return True
    if last < k or fate >= MISSED or (fate >= TIR and last == k):
        return False
    for c in range(3):
        before = traced.start[row, c] if k == 0 else traced.hits[k - 1, row, c]
        if traced.hits[k, row, c] != before:
            return True
    return False


@exact
def deviation(before: Vector, after: Vector) -> float:
    """1 − D·D' of unit directions, without its cancellation."""
    x, y, z = before
    u, v, w = after
    return 0.5 * ((u - x) * (u - x) + (v - y) * (v - y) + (w - z) * (w - z))


@exact
def reflected(turn: float, n1: float, n2: float) -> float:
    """Share of unpolarised light reflected at a bare face that deflects the ray by 1 − D·D' = turn.

    The only compiled version of `clacad.optics.surface.fresnel_coefficients.amplitudes`.
    """
    step = (n2 - n1) * (n2 + n1)
    if step == 0.0:
        return 0.0
    square = (n2 - n1) * (n2 - n1)
    cos, s = 1.0 - turn, square + 2.0 * n1 * n2 * turn
    p = (square - (n1 * n1 + n2 * n2) * turn) / cos
    return 0.5 * (s * s + p * p) / (step * step)


@exact
def fresnel_share(traced: Traced, row: int) -> float:
    """Share of unpolarised light that all bare faces crossed by one ray transmit; see `fresnel_pass`."""
    ray, turns, index = traced.ray, traced.turns, traced.media
    x, y, z = ray[row, 0], ray[row, 1], ray[row, 2]
    length = 1.0 / sqrt(x * x + y * y + z * z)
    x, y, z = x * length, y * length, z * length
    share = 1.0
    for k in range(len(index) - 1):
        u, v, w = turns[k, row, 0], turns[k, row, 1], turns[k, row, 2]
        if traced.fate[row] <= GHOST or crosses(traced, k, row):
            share *= 1.0 - reflected(deviation((x, y, z), (u, v, w)), index[k], index[k + 1])
        x, y, z = u, v, w
    return share


@entry
def fresnel_pass(traced: Traced, flux: Floats) -> None:
    """Multiply each ray's flux (n,) by the transmission of bare faces for unpolarised light."""
    for row in range(len(flux)):
        flux[row] *= fresnel_share(traced, row)


@exact
def absorbed(hits: Floats, rates: Floats, row: int) -> float:
    """Share of one ray that bodies of these attenuations (b,) transmit between its hits (2 b, n, 3)."""
    depth = 0.0
    for b in range(len(rates)):
        square = 0.0
        for c in range(3):
            step = hits[2 * b + 1, row, c] - hits[2 * b, row, c]
            square += step * step
        depth += rates[b] * sqrt(square)
    return exp(-depth)


@entry
def absorption_pass(hits: Floats, rates: Floats, flux: Floats) -> None:
    """Multiply each ray's flux by exp(−Σ rate · length) over the bodies (b,) between its hits (2 b, n, 3)."""
    for row in range(len(flux)):
        flux[row] *= absorbed(hits, rates, row)


@entry
def losses_pass(traced: Traced, rates: Floats, reflects: bool, flux: Floats) -> None:
    """Compute the flux of rays without one (NaN) from their hits; the straight trace failed for them."""
    for row in range(len(flux)):
        if flux[row] == flux[row]:
            continue
        flux[row] = absorbed(traced.hits, rates, row)
        if reflects:
            flux[row] *= fresnel_share(traced, row)


@exact
def across(wx: float, wy: float, x: float, y: float, z: float) -> Vector:
    """Unit vector across the ray (x, y, z) in the direction (wx, wy, 0)."""
    along = wx * x + wy * y
    a, b, c = wx - along * x, wy - along * y, -along * z
    scale = 1.0 / sqrt(a * a + b * b + c * c)
    return a * scale, b * scale, c * scale


@exact
def carried(field: Vector, before: Vector, after: Vector, n1: float, n2: float) -> Vector:
    """Carry the field E over a face that deflects the ray D into D'.

    Snell's law makes τ_s = τ_p D·D', so that τ_p (D·D' E − (E·D') D) is the field behind the face: its part
    across the plane of incidence times τ_s, the rest rotated and times τ_p. τ_p² = 4 n1 n2 (n2 c − n1)(n2 −
    n1 c)/(n2² − n1²)² c².
    """
    (a, b, c), (x, y, z), (u, v, w) = field, before, after
    turn = deviation(before, after)
    cos, less, step = 1.0 - turn, n2 - n1, (n2 - n1) * (n2 + n1)
    tau = 1.0
    if step != 0.0:
        tau = 2.0 * sqrt(n1 * n2 * (less - n2 * turn) * (less + n1 * turn)) / (abs(step) * cos)
    own, back = tau * cos, tau * (a * u + b * v + c * w)
    return own * a - back * x, own * b - back * y, own * c - back * z


@entry
def polarisation_pass(traced: Traced, analyser: Floats, polariser: Floats, flux: Floats) -> None:
    """Multiply each ray's flux by the transmission of polariser, faces and analyser.

    See `clacad.effects.polarisation`.

    analyser, polariser : (2,). Directions (cos, sin) of the sheet's x and y; NaN where there is none.
    """
    ray, turns, index = traced.ray, traced.turns, traced.media
    single = analyser[0] == analyser[0]
    filtered = polariser[0] == polariser[0]
    for row in range(len(flux)):
        x, y, z = ray[row, 0], ray[row, 1], ray[row, 2]
        scale = 1.0 / sqrt(x * x + y * y + z * z)
        ox, oy, oz = x * scale, y * scale, z * scale
        total = 0.0
        for field in range(1 if single else 2):
            x, y, z = ox, oy, oz
            a, b, c = across(analyser[0], analyser[1], x, y, z) if single else across(1.0, 0.0, x, y, z)
            if field == 1:
                a, b, c = y * c - z * b, z * a - x * c, x * b - y * a
            for k in range(len(turns)):
                u, v, w = turns[k, row, 0], turns[k, row, 1], turns[k, row, 2]
                if traced.fate[row] <= GHOST or crosses(traced, k, row):
                    a, b, c = carried((a, b, c), (x, y, z), (u, v, w), index[k], index[k + 1])
                x, y, z = u, v, w
            if filtered:
                p, q, r = across(polariser[0], polariser[1], x, y, z)
                total += (a * p + b * q + c * r) * (a * p + b * q + c * r)
            else:
                total += a * a + b * b + c * c
        flux[row] *= 0.5 * total
