"""The straight path, compiled: blocks of rays in the first-level cache, face by face, two loops a face.

The twin of `clacad.tracing.reference.surfaces.in_cell`. Each pass is a plain loop over a block that a
compiler turns into vector instructions: no branch, no call, two square roots and two divisions a face.

Each condition of the straight path is a number that must be positive; the row GOOD keeps the least of them.
A miss or a total reflection is a NaN that propagates to the exit direction. Rays that fail are walked one by
one afterwards.

Positions are carried times N, so that the step to the vertex plane needs no division:
with (X, Y) = N (x, y) − z (L, M),  b = N B,  c = N² C  and  q = side N r − b  the hit is
((X q + c L), (Y q + c M), c N) / (N q) and r = (N r) q / (N q).
"""

from __future__ import annotations

from math import inf, sqrt

import numpy as np

from clacad.base.compiled import exact, inlined, least
from clacad.base.types import Floats, Rows
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.array_cells import (
    carry_own,
    framed,
    from_own_lens,
    into_array,
    lens_height,
    meet_framed,
    on_line,
    to_own_lens,
)
from clacad.tracing.compiled.block import (
    BEHIND_START,
    CI,
    CI0,
    CJ,
    CJ0,
    DEPTH,
    DX,
    DY,
    DZ,
    GOOD,
    GX,
    GY,
    GZ,
    KEPT,
    LEFT_X,
    LEFT_Y,
    OVER,
    PATH,
    QUADRIC_ROWS,
    ROOT,
    SHARE,
    STEEP,
    X,
    Y,
    Z,
    arrive,
    centres,
    copy_row,
    hold_in_zone,
    keep_hits,
    lane,
    lanes,
)
from clacad.tracing.compiled.cells import hexagon_steps, reach
from clacad.tracing.compiled.face import bend, meet
from clacad.tracing.compiled.packing import OwnCells, Packed
from clacad.tracing.compiled.records import MOST_ARRAYS, Vector
from clacad.tracing.facets.compiled_tiles import cross_facets
from clacad.tracing.facets.tiles import Tiles

Media = tuple[float, float]
"""Refractive indices before a face and behind it."""

FIELD = 2
"""Array of a field lens."""


@exact
def _meet_quadric(face: Floats, s: Floats, m: int, n1: float, offset: Vector) -> None:
    """First loop of a face: to the hit.

    Positions plus the offset are relative to the vertex; afterwards without it.
    """
    x, y, z, dx, dy, dz, root, path = lanes(s, (X, Y, Z, DX, DY, DZ, ROOT, PATH))
    cx, cy, kappa, side = face[slot.CX], face[slot.CY], face[slot.KX], face[slot.SIDE]
    real = s.dtype.type
    one, n1, ox, oy, oz = real(1.0), real(n1), real(offset[0]), real(offset[1]), real(offset[2])
    for i in range(m):
        u, v, w = dx[i], dy[i], dz[i]
        down = z[i] + oz
        px, py = w * (x[i] + ox) - down * u, w * (y[i] + oy) - down * v
        a = cx * u * u + cy * v * v + kappa * w * w
        b = cx * px * u + cy * py * v - side * w * w
        c = cx * px * px + cy * py * py
        r = sqrt(b * b - a * c)
        q = side * r - b
        inverse = one / (w * q)
        x[i] = (px * q + c * u) * inverse
        y[i] = (py * q + c * v) * inverse
        z[i] = c * w * inverse
        root[i] = r * q * inverse
        path[i] += n1 * ((c - down * q) * inverse)


@exact
def _turn_in(face: Floats, s: Floats, m: int, offset: Vector) -> None:
    """Positions plus the offset, and directions, from sheet axes to lens axes."""
    x, y, z, dx, dy, dz = lanes(s, (X, Y, Z, DX, DY, DZ))
    a, b, c = face[slot.R0], face[slot.R0 + 1], face[slot.R0 + 2]
    d, e, f = face[slot.R0 + 3], face[slot.R0 + 4], face[slot.R0 + 5]
    g, h, k = face[slot.R0 + 6], face[slot.R0 + 7], face[slot.R0 + 8]
    real = s.dtype.type
    ox, oy, oz = real(offset[0]), real(offset[1]), real(offset[2])
    for i in range(m):
        u, v, w = x[i] + ox, y[i] + oy, z[i] + oz
        x[i], y[i], z[i] = a * u + d * v + g * w, b * u + e * v + h * w, c * u + f * v + k * w
    for i in range(m):
        u, v, w = dx[i], dy[i], dz[i]
        dx[i], dy[i], dz[i] = a * u + d * v + g * w, b * u + e * v + h * w, c * u + f * v + k * w


@exact
def _turn_out(face: Floats, s: Floats, m: int, climb: float) -> None:
    """Rotate back to sheet axes; normals must face up, rays must climb."""
    x, y, z, dx, dy, dz, good = lanes(s, (X, Y, Z, DX, DY, DZ, GOOD))
    gx, gy, gz = lanes(s, (GX, GY, GZ))
    a, b, c = face[slot.R0], face[slot.R0 + 1], face[slot.R0 + 2]
    d, e, f = face[slot.R0 + 3], face[slot.R0 + 4], face[slot.R0 + 5]
    g, h, k = face[slot.R0 + 6], face[slot.R0 + 7], face[slot.R0 + 8]
    climb = s.dtype.type(climb)
    for i in range(m):
        u, v, w = x[i], y[i], z[i]
        x[i], y[i], z[i] = a * u + b * v + c * w, d * u + e * v + f * w, g * u + h * v + k * w
    for i in range(m):
        u, v, w = dx[i], dy[i], dz[i]
        up = g * u + h * v + k * w
        dx[i], dy[i], dz[i] = a * u + b * v + c * w, d * u + e * v + f * w, up
        good[i] = least(good[i], least(g * gx[i] + h * gy[i] + k * gz[i], up - climb))


@exact
def _refract_quadric(
    face: Floats, s: Floats, m: int, media: Media, climb: float, hx: float, hy: float
) -> None:
    """Second loop of a face: Snell's law.

    The normal must be of the apex half, the hit inside hx and hy of the cell's centre, and the ray must climb
    on. These comparisons cost no time: they run during the divisions.
    """
    x, y, z, dx, dy, dz, root, good = lanes(s, (X, Y, Z, DX, DY, DZ, ROOT, GOOD))
    sx, sy = -face[slot.SIDE] * face[slot.CX], -face[slot.SIDE] * face[slot.CY]
    sk, vx, vy = face[slot.SIDE] * face[slot.KX], face[slot.VX], face[slot.VY]
    n1, n2 = media
    real = s.dtype.type
    one, mu, weight = real(1.0), real(n1 / n2), real((n2 - n1) / n2 * ((n2 + n1) / n2))
    climb, hx, hy = real(climb), real(hx), real(hy)
    for i in range(m):
        gx, gy, gz = sx * x[i], sy * y[i], one - sk * z[i]
        incident = mu * root[i]
        g = bend(gx * gx + gy * gy + gz * gz, incident, weight)
        dx[i] = mu * dx[i] + g * gx
        dy[i] = mu * dy[i] + g * gy
        up = mu * dz[i] + g * gz
        dz[i] = up
        inside = least(hx - abs(x[i] + vx), hy - abs(y[i] + vy))
        good[i] = least(least(good[i], inside), least(gz, up - climb))


@exact
def _normals(face: Floats, s: Floats, m: int) -> None:
    """Normals of a quadric at the hits."""
    x, y, z, gx, gy, gz = lanes(s, (X, Y, Z, GX, GY, GZ))
    sx, sy = -face[slot.SIDE] * face[slot.CX], -face[slot.SIDE] * face[slot.CY]
    sk, one = face[slot.SIDE] * face[slot.KX], s.dtype.type(1.0)
    for i in range(m):
        gx[i], gy[i], gz[i] = sx * x[i], sy * y[i], one - sk * z[i]


@exact
def _meet_biconic(faces: Floats, f: int, s: Floats, m: int, n1: float, offset: Vector) -> None:
    """First loop of a biconic face, ray by ray: the number of Newton steps varies."""
    ox, oy, oz = offset
    for i in range(m):
        t, x, y, z, gx, gy, gz, root = meet(
            faces, f, s[X, i] + ox, s[Y, i] + oy, s[Z, i] + oz, s[DX, i], s[DY, i], s[DZ, i]
        )
        s[X, i], s[Y, i], s[Z, i], s[ROOT, i] = x, y, z, root
        s[GX, i], s[GY, i], s[GZ, i] = gx, gy, gz
        s[PATH, i] += n1 * t
        if not gz > 0.0:
            s[GOOD, i] = 0.0


@exact
def _refract_biconic(s: Floats, m: int, media: Media) -> None:
    """Second loop of a face with stored normals: Snell's law."""
    dx, dy, dz, root, gx, gy, gz = lanes(s, (DX, DY, DZ, ROOT, GX, GY, GZ))
    n1, n2 = media
    real = s.dtype.type
    mu, weight = real(n1 / n2), real((n2 - n1) / n2 * ((n2 + n1) / n2))
    for i in range(m):
        g = bend(gx[i] * gx[i] + gy[i] * gy[i] + gz[i] * gz[i], mu * root[i], weight)
        dx[i], dy[i], dz[i] = mu * dx[i] + g * gx[i], mu * dy[i] + g * gy[i], mu * dz[i] + g * gz[i]


@exact
def _proud(face: Floats, s: Floats, m: int) -> None:
    """Require that hits lie on the lens where land could cover it."""
    z, good = lanes(s, (Z, GOOD))
    vz, land, side = face[slot.VZ], face[slot.LAND], face[slot.LAND_SIDE]
    for i in range(m):
        good[i] = least(good[i], (land - vz - z[i]) * side)


@exact
def _in_cell_at(lat: Floats, s: Floats, m: int, level: float, ox: float, oy: float, margin: float) -> None:
    """Require that rays are in their cell, `margin` inside, where they cross a level; times N, undivided."""
    x, y, z, dx, dy, dz, good = lanes(s, (X, Y, Z, DX, DY, DZ, GOOD))
    real = s.dtype.type
    level, ox, oy, margin, middle = real(level), real(ox), real(oy), real(margin), real(0.5)
    half, half_y, slant = lat[slot.HALF] - margin, lat[slot.HALF + 1] - margin, lat[slot.NORMAL + 3]
    if lat[slot.HEXAGONAL] == 0.0:
        for i in range(m):
            rise = level - z[i]
            u, v = (x[i] + ox) * dz[i] + rise * dx[i], (y[i] + oy) * dz[i] + rise * dy[i]
            good[i] = least(good[i], least(half * dz[i] - abs(u), half_y * dz[i] - abs(v)))
        return
    for i in range(m):
        rise, edge = level - z[i], half * dz[i]
        u, v = (x[i] + ox) * dz[i] + rise * dx[i], (y[i] + oy) * dz[i] + rise * dy[i]
        one, two, three = abs(u), abs(middle * u + slant * v), abs(middle * u - slant * v)
        good[i] = least(least(good[i], edge - one), least(edge - two, edge - three))


@exact
def _carry(
    lat: Floats, s: Floats, m: int, level: float, index: float, arrays: tuple[int, int], origin: Vector
) -> None:
    """Carry rays to a level and into the cells of the array there, with equal or different pitch.

    level : Height over the body's level, and the rays' height afterwards.
    arrays : (int, int). Array in whose cells the rays are, and array into whose cells they are carried.
    origin : (x, y, z). The rays' origin, seen from the centre of their cell and the body's level.
    """
    x, y, z, dx, dy, dz, path, ci, cj = lanes(s, (X, Y, Z, DX, DY, DZ, PATH, CI, CJ))
    real = s.dtype.type
    ox, oy, oz = origin
    rise, level, index, middle, one = real(level - oz), real(level), real(index), real(0.5), real(1.0)
    at = slot.BETWEEN + 4 * (MOST_ARRAYS * arrays[0] + arrays[1])
    rx, ry = real(ox - lat[at]), real(oy - lat[at + 1])
    wi, wj = real(lat[at + 2]), real(lat[at + 3])
    pitch, row = lat[slot.PITCH], lat[slot.ROW]
    per_pitch, per_row = one / pitch, one / row
    if lat[slot.HEXAGONAL] == 0.0:
        for i in range(m):
            t = (rise - z[i]) / dz[i]
            u, v = x[i] + rx + t * dx[i], y[i] + ry + t * dy[i]
            a, b = np.floor(u * per_pitch + middle), np.floor(v * per_row + middle)
            x[i], y[i], z[i] = u - a * pitch, v - b * row, level
            ci[i] += a - wi
            cj[i] += b - wj
            path[i] += index * t
        return
    half, slant = middle * pitch, row / pitch
    for i in range(m):
        t = (rise - z[i]) / dz[i]
        x[i] += rx + t * dx[i]
        y[i] += ry + t * dy[i]
        z[i] = level
        path[i] += index * t
    for i in range(m):
        b = np.floor(y[i] * per_row + middle)
        a = np.floor(x[i] * per_pitch - middle * b + middle)
        u, v = x[i] - (a + middle * b) * pitch, y[i] - b * row
        i_step, j_step = hexagon_steps(u, v, half, slant, middle)
        a, b = a + i_step, b + j_step
        x[i] -= (a + middle * b) * pitch
        y[i] -= b * row
        ci[i] += a - wi
        cj[i] += b - wj


@exact
def _in_inner(body: Floats, lat: Floats, s: Floats, m: int, array: int, ox: float, oy: float) -> None:
    """Require that rays are certainly over the body."""
    px, py, good = lanes(s, (GX, GY, GOOD))
    centres(lat, s, m, array, px, py, ox, oy)
    mx, my, hx, hy, radius = (
        body[slot.MID_X],
        body[slot.MID_Y],
        body[slot.INNER_X],
        body[slot.INNER_Y],
        body[slot.INNER_R],
    )
    square = radius * max(radius, s.dtype.type(0.0))
    for i in range(m):
        u, v = px[i] - mx, py[i] - my
        inside = least(hx - abs(u), hy - abs(v))
        good[i] = least(least(good[i], inside), square - (u * u + v * v))


@exact
def _thick(sheet: Packed, f: int, s: Floats, m: int) -> None:
    """Require that hits on one face lie on the right side of the body's other face."""
    faces = sheet.faces
    vx, vy, vz = faces[f, slot.VX], faces[f, slot.VY], faces[f, slot.VZ]
    other, sign = f + 1 - 2 * (f % 2), 1.0 - 2.0 * (f % 2)
    for i in range(m):
        if s[GOOD, i] > 0.0:
            over = lens_height(sheet, sheet.own, other, (s[CI, i], s[CJ, i]), s[X, i] + vx, s[Y, i] + vy)
            if not sign * (over - (s[Z, i] + vz)) >= 0.0:
                s[GOOD, i] = 0.0


@exact
def _between(face: Floats, other: Floats, s: Floats, m: int, sign: float) -> None:
    """Check as `_thick` where both faces are quadrics: the hit against the other's half space."""
    x, y, z, good = lanes(s, (X, Y, Z, GOOD))
    ox, oy, oz = (
        face[slot.VX] - other[slot.VX],
        face[slot.VY] - other[slot.VY],
        face[slot.VZ] - other[slot.VZ],
    )
    cx, cy, kappa, side = other[slot.CX], other[slot.CY], other[slot.KX], other[slot.SIDE]
    if other[slot.TURNED] == 0.0:
        for i in range(m):
            u, v, w = x[i] + ox, y[i] + oy, z[i] + oz
            over = w - 0.5 * side * (cx * u * u + cy * v * v + kappa * w * w)
            good[i] = least(good[i], least(1.0 - side * kappa * w, -sign * over))
        return
    a, b, c = other[slot.R0], other[slot.R0 + 1], other[slot.R0 + 2]
    d, e, f = other[slot.R0 + 3], other[slot.R0 + 4], other[slot.R0 + 5]
    g, h, k = other[slot.R0 + 6], other[slot.R0 + 7], other[slot.R0 + 8]
    for i in range(m):
        p, q, r = x[i] + ox, y[i] + oy, z[i] + oz
        u, v, w = a * p + d * q + g * r, b * p + e * q + h * r, c * p + f * q + k * r
        over = w - 0.5 * side * (cx * u * u + cy * v * v + kappa * w * w)
        good[i] = least(good[i], least(1.0 - side * kappa * w, -sign * over))


@exact
def _cross(
    own: OwnCells | None,
    sheet: Packed,
    f: int,
    s: Floats,
    m: int,
    media: Media,
    climb: float,
    offset: Vector,
    line: int,
) -> None:
    """Cross one face; positions plus the offset are relative to its vertex, afterwards without the offset.

    Hits on a structured face must lie in the optical zone of the cell; on non-uniform sheets `_out_of_lens`
    checks this.
    """
    faces, lat = sheet.faces, sheet.lattice
    face = faces[f]
    within, turned, quadric = (
        own is None and face[slot.ARRAY] >= 0.0,
        face[slot.TURNED] != 0.0 and not framed(own, f),
        face[slot.BICONIC] == 0.0 and not framed(own, f),
    )
    hx, hy, lowest, plain, first = inf, inf, climb, quadric and not turned, f or line <= 0
    margin = lat[slot.MARGIN]
    if within and plain and lat[slot.HEXAGONAL] == 0.0:
        hx, hy = lat[slot.HALF] - margin, lat[slot.HALF + 1] - margin
    if turned:
        if first:
            _turn_in(face, s, m, offset)
        offset, lowest = (0.0, 0.0, 0.0), -2.0
    if first and framed(own, f):
        meet_framed(own, sheet, f, s, m, media[0], offset)
        first = False
    if first and quadric:
        _meet_quadric(face, s, m, media[0], offset)
    elif first:
        _meet_biconic(faces, f, s, m, media[0], offset)
    if f == 0 and line == 0:
        keep_hits(s, m, False, _kept(own, face))
    if quadric:
        _refract_quadric(face, s, m, media, lowest, hx, hy)
    else:
        _refract_biconic(s, m, media)
    if turned:
        if quadric:
            _normals(face, s, m)
        _turn_out(face, s, m, climb)
    elif not quadric:
        _climbing(s, m, climb)
    if within and not (plain and lat[slot.HEXAGONAL] == 0.0):
        hold_in_zone(lat, s, m, margin, face[slot.VX], face[slot.VY])
    if own is None:
        _hold_proud(face, s, m)


@inlined
def _hold_proud(face: Floats, s: Floats, m: int) -> None:
    """Require that hits lie on the lens, if land could cover it."""
    if face[slot.WHOLE] == 0.0 and face[slot.LAND] == face[slot.LAND]:
        _proud(face, s, m)


@inlined
def _into_lens(own: OwnCells | None, sheet: Packed, f: int, s: Floats, m: int, offset: Vector) -> None:
    """Transform rays to the lens of each ray's own cell, where lenses vary from cell to cell."""
    if own is not None:
        to_own_lens(sheet, own, f, s, m, offset)


@inlined
def _out_of_lens(own: OwnCells | None, sheet: Packed, f: int, s: Floats, m: int) -> None:
    """Undo `_into_lens`; hits on a structured face must lie in the optical zone of the cell."""
    if own is not None:
        from_own_lens(own, f, s, m, (0.0, 0.0, 0.0))
        face = sheet.faces[f]
        if face[slot.ARRAY] >= 0.0:
            lat = sheet.lattices[int(face[slot.ARRAY])]
            hold_in_zone(lat, s, m, lat[slot.MARGIN], face[slot.VX], face[slot.VY])
        _hold_proud(face, s, m)


@exact
def _climbing(s: Floats, m: int, climb: float) -> None:
    """Require that rays climb faster than a face does."""
    dz, good, climb = lane(s, DZ), lane(s, GOOD), s.dtype.type(climb)
    for i in range(m):
        good[i] = least(good[i], dz[i] - climb)


@exact
def _start_ahead(s: Floats, m: int, carried: Floats) -> None:
    """Require that the first face does not lie behind the start."""
    path, good, behind = lane(s, PATH), lane(s, GOOD), s.dtype.type(BEHIND_START)
    for i in range(m):
        slack = behind * (abs(carried[i]) + abs(path[i] - carried[i]))
        good[i] = least(good[i], path[i] - slack)


@exact
def _open_baffle(sheet: Packed, f: int, gone: int, array: int, s: Floats, m: int) -> None:
    """Require that rays pass the honeycomb between the cells of array `gone`, which they left, and face f."""
    face, entry = sheet.faces[f], int(sheet.bodies[f // 2, slot.ENTRY])
    before, behind = sheet.lattices[gone], sheet.lattices[entry]
    for i in range(m):
        ci, cj = 1.0 * s[CI, i], 1.0 * s[CJ, i]
        x, y = 1.0 * s[X, i] + face[slot.VX], 1.0 * s[Y, i] + face[slot.VY]
        if face[slot.ARRAY] < 0.0:  # a plane face: the cells are still those of the array before
            ci, cj, x, y = into_array(sheet, sheet.own, array, entry, ci, cj, x, y)
        di, dj = ci - s[CI0, i], cj - s[CJ0, i]
        if s[GOOD, i] > 0.0 and reach(before, behind, s[LEFT_X, i], s[LEFT_Y, i], x, y, di, dj) <= 1.0:
            s[GOOD, i] = 0.0


@exact
def _off_line(sheet: Packed, f: int, array: int, s: Floats, m: int) -> None:
    """Leave rays that hit the opaque line of face f, in the cells of an array, to the walk."""
    vx, vy = sheet.faces[f, slot.VX], sheet.faces[f, slot.VY]
    for i in range(m):
        x, y = 1.0 * s[X, i] + vx, 1.0 * s[Y, i] + vy
        if s[GOOD, i] > 0.0 and on_line(sheet, f, array, 1.0 * s[CI, i], 1.0 * s[CJ, i], x, y):
            s[GOOD, i] = 0.0


@exact
def _let_through(face: Floats, s: Floats, m: int, n1: float, n2: float) -> None:
    """Multiply SHARE/OVER by the mean of T_s and T_p at an untilted quadric.

    With a = n1/n2 |g| cos i and b = |g| cos t, g the normal: T_s = 4 a b/(a + b)², T_p = 4 a b/(|g| cos i +
    n1/n2 b)².
    """
    x, y, z, dx, dy, dz, root, share, over = lanes(s, (X, Y, Z, DX, DY, DZ, ROOT, SHARE, OVER))
    sx, sy = -face[slot.SIDE] * face[slot.CX], -face[slot.SIDE] * face[slot.CY]
    sk = face[slot.SIDE] * face[slot.KX]
    mu = n1 / n2
    for i in range(m):
        a, b = mu * root[i], sx * x[i] * dx[i] + sy * y[i] * dy[i] + (1.0 - sk * z[i]) * dz[i]
        one, two = a + b, root[i] + mu * b
        one, two = one * one, two * two
        share[i] *= 2.0 * a * b * (one + two)
        over[i] *= one * two


@exact
def _let_through_turned(s: Floats, m: int, n1: float, n2: float) -> None:
    """Multiply SHARE/OVER by the mean of T_s and T_p at any face with stored normals, in any axes."""
    gx, gy, gz, root, share, over = lanes(s, (GX, GY, GZ, ROOT, SHARE, OVER))
    mu = n1 / n2
    weight = (n2 - n1) / n2 * ((n2 + n1) / n2)
    for i in range(m):
        a = mu * root[i]
        b = sqrt((gx[i] * gx[i] + gy[i] * gy[i] + gz[i] * gz[i]) * weight + a * a)
        one, two = a + b, root[i] + mu * b
        one, two = one * one, two * two
        share[i] *= 2.0 * a * b * (one + two)
        over[i] *= one * two


@exact
def _absorbed(s: Floats, m: int, rate: float, vz: float, side: int) -> None:
    """Add rate · length inside a body to DEPTH: the difference of its end heights, divided by N."""
    z, dz, depth, steep = lanes(s, (Z, DZ, DEPTH, STEEP))
    if side == 0:
        for i in range(m):
            steep[i] = rate / dz[i]
            depth[i] -= (z[i] + vz) * steep[i]
        return
    for i in range(m):
        depth[i] += (z[i] + vz) * steep[i]


@exact
def _reflect(sheet: Packed, f: int, s: Floats, m: int, media: Media) -> None:
    """Apply the losses at the face just crossed."""
    face, reflects = sheet.faces[f], sheet.losses[0] != 0.0
    n1, n2 = media
    if reflects and n1 != n2:
        if face[slot.TURNED] == 0.0 and face[slot.BICONIC] == 0.0:
            _let_through(face, s, m, n1, n2)
        else:
            _let_through_turned(s, m, n1, n2)


@inlined
def _leave(sheet: Packed, f: int, s: Floats, m: int, media: Media, facets: bool) -> None:
    """Leave the lens of a face just crossed, with its losses and those in the glass behind or before it."""
    counted = len(sheet.losses) > 0
    if counted:
        _reflect(sheet, f, s, m, media)
    if not facets:
        _out_of_lens(sheet.own, sheet, f, s, m)
    if counted and sheet.losses[1 + f // 2] != 0.0:
        _absorbed(s, m, sheet.losses[1 + f // 2], sheet.faces[f, slot.VZ], f % 2)


@exact
def _store_hit(sheet: Packed, f: int, s: Floats, array: int, chosen: Rows, hit: Floats, turn: Floats) -> None:
    """Record hits and directions at one face."""
    face, level, m = sheet.faces[f], sheet.bodies[f // 2, slot.LEVEL], len(chosen)
    px, py, base = lane(s, GX), lane(s, GY), level + face[slot.VZ]
    centres(sheet.lattices[array], s, m, array, px, py, face[slot.VX], face[slot.VY])
    for i in range(m):
        if s[GOOD, i] > 0.0:
            row = chosen[i]
            hit[row, 0], hit[row, 1], hit[row, 2] = px[i], py[i], s[Z, i] + base
            turn[row, 0], turn[row, 1], turn[row, 2] = s[DX, i], s[DY, i], s[DZ, i]


@exact
def _same_cell(s: Floats, m: int) -> None:
    """Leave rays whose field-lens cell is not that of lens 1 to the walk, which distinguishes the two."""
    ci, cj, ci0, cj0, good = lanes(s, (CI, CJ, CI0, CJ0, GOOD))
    for i in range(m):
        if ci[i] != ci0[i] or cj[i] != cj0[i]:
            good[i] = 0.0


@inlined
def _carry_on(
    own: OwnCells | None,
    sheet: Packed,
    s: Floats,
    m: int,
    level: float,
    index: float,
    arrays: tuple[int, int],
    origin: Vector,
) -> None:
    """Carry rays to a level and into the cells of the array there, of any pitch."""
    if own is None:
        _carry(sheet.lattice, s, m, level, index, arrays, origin)
    else:
        carry_own(sheet.lattices, s, m, level, index, arrays, origin)


@inlined
def _enter_array(sheet: Packed, f: int, s: Floats, m: int, index: float, array: int, origin: Vector) -> None:
    """Carry rays from the cells of an array to where they meet those of a structured face."""
    face, body = sheet.faces[f], sheet.bodies[f // 2]
    columnar = body[slot.COLUMNAR] != 0.0
    if f > 0:
        level = body[slot.BODY_LOW] if columnar else face[slot.LOW]
        _carry_on(sheet.own, sheet, s, m, level, index, (array, int(face[slot.ARRAY])), origin)
        array = int(face[slot.ARRAY])
    lat = sheet.lattices[array]
    arrive(lat, sheet.rows, s, m, face[slot.CLIMB])
    margin = sheet.lattice[slot.MARGIN]
    if not columnar and margin > 0.0:  # a lenslet with a seam is an island with walls
        hold_in_zone(lat, s, m, margin, 0.0, 0.0)


@inlined
def _stay_inside(sheet: Packed, f: int, s: Floats, m: int, facets: bool, vertex: Vector) -> None:
    """Require that a hit on a structured face is in its cell at the face's end, or before the other face."""
    face, body = sheet.faces[f], sheet.bodies[f // 2]
    vx, vy, vz = vertex
    if body[slot.COLUMNAR] == 0.0:
        lat = sheet.lattices[int(face[slot.ARRAY])]
        _in_cell_at(lat, s, m, face[slot.HIGH] - vz, vx, vy, lat[slot.MARGIN])
    elif body[slot.COVERED] == 0.0 and not facets:
        _before_other(sheet.own, sheet, f, s, m)


@inlined
def _before_other(own: OwnCells | None, sheet: Packed, f: int, s: Floats, m: int) -> None:
    """Require that a hit comes before the body's other face."""
    face, other = sheet.faces[f], sheet.faces[f + 1 - 2 * (f % 2)]
    if own is None and face[slot.BICONIC] == 0.0 and other[slot.BICONIC] == 0.0:
        _between(face, other, s, m, 1.0 - 2.0 * (f % 2))
    else:
        _thick(sheet, f, s, m)


@exact
def _past_joint(
    sheet: Packed, f: int, s: Floats, array: int, chosen: Rows, oz: float, hits: Floats, turns: Floats
) -> None:
    """Record rays on a joint as hits of its second face, and begin what the body behind it absorbs."""
    if len(sheet.losses):
        if sheet.losses[1 + f // 2] != 0.0:
            _absorbed(s, len(chosen), sheet.losses[1 + f // 2], oz, 0)
    elif len(hits):
        _store_hit(sheet, f, s, array, chosen, hits[f], turns[f])


@inlined
def _kept(own: OwnCells | None, face: Floats) -> int:
    """How many rows describe the hits on a first face (`keep_hits`)."""
    return QUADRIC_ROWS if own is None and face[slot.BICONIC] == 0.0 else len(KEPT)


@inlined
def _begin(sheet: Packed, s: Floats, m: int, line: int) -> None:
    """Nothing is lost yet; of a further line of light, fetch the hits on the first face."""
    for i in range(m if len(sheet.losses) > 0 else 0):
        s[SHARE, i], s[OVER, i], s[DEPTH, i] = 1.0, 1.0, 0.0
    if line > 0:
        keep_hits(s, m, True, _kept(sheet.own, sheet.faces[0]))


@inlined
def _leave_body(lat: Floats, s: Floats, m: int, ox: float, oy: float) -> None:
    """Remember where rays leave a body before a honeycomb."""
    if lat[slot.BAFFLE] != slot.NO_BAFFLE:
        for i in range(m):
            s[LEFT_X, i], s[LEFT_Y, i] = s[X, i] + ox, s[Y, i] + oy


@inlined
def _least_climb(face: Floats, other: Floats, columnar: bool) -> float:
    """Least climb of rays that pass a face: steeper than the lenses."""
    if face[slot.ARRAY] < 0.0:
        return 0.0
    climb: float = max(face[slot.CLIMB], other[slot.CLIMB]) if columnar else 1.0 * face[slot.CLIMB]
    return climb


@inlined
def _hold_before(
    sheet: Packed, f: int, gone: int, array: int, s: Floats, m: int, ox: float, oy: float, carried: Floats
) -> None:
    """Require that the way to a face just crossed was open: ahead of the start, through the honeycomb."""
    if sheet.bodies[f // 2, slot.COLUMNAR] == 0.0:
        _in_inner(sheet.bodies[f // 2], sheet.lattices[array], s, m, array, ox, oy)
    if f == 0:
        _start_ahead(s, m, carried)
    if f > 1 and f % 2 == 0 and sheet.lattice[slot.BAFFLE] != slot.NO_BAFFLE:
        _open_baffle(sheet, f, gone, array, s, m)


@exact
def straight(
    tiles: Tiles | None,
    sheet: Packed,
    s: Floats,
    chosen: Rows,
    hits: Floats,
    turns: Floats,
    carried: Floats,
    line: int,
) -> int:
    """Trace a launched block straight through every face; return the array its cells refer to at the end.

    Positions are relative to the face last crossed. Counted losses (`Packed.losses`) are in SHARE and DEPTH.
    line : Of several lines of light whose first hits are shared, the number of this one; −1: of one alone.
    """
    faces, bodies, lat, own = sheet.faces, sheet.bodies, sheet.lattice, sheet.own
    m, array, gone, met, counted = len(chosen), 0, 0, 0, len(sheet.losses) > 0
    _begin(sheet, s, m, line)
    ox, oy, oz = 0.0, 0.0, 0.0  # origin of the positions: cell's centre, body's level
    for b in range(len(bodies)):
        body, columnar = bodies[b], bodies[b, slot.COLUMNAR] != 0.0
        if not columnar and body[slot.COVERED] == 0.0:
            for i in range(m):
                s[GOOD, i] = 0.0
            return array
        if b:
            oz -= body[slot.LEVEL] - bodies[b - 1, slot.LEVEL]
            gone = array
            _leave_body(lat, s, m, ox, oy)
        for side in range(2):
            f = 2 * b + side
            face, other = faces[f], faces[2 * b + 1 - side]
            media = (1.0 * sheet.media[f], 1.0 * sheet.media[f + 1])  # in double precision
            structured = face[slot.ARRAY] >= 0.0
            if side == 0 and body[slot.JOINED] != 0.0:
                _past_joint(sheet, f, s, array, chosen, oz, hits, turns)
                continue
            if structured and (side == 0 or not columnar):
                if f or line <= 0:
                    _enter_array(sheet, f, s, m, media[0], array, (ox, oy, oz))
                if f > 0:
                    array, ox, oy, oz = int(face[slot.ARRAY]), 0.0, 0.0, 0.0
                if met == 0:
                    copy_row(lane(s, CI), lane(s, CI0), m)
                    copy_row(lane(s, CJ), lane(s, CJ0), m)
                elif array == FIELD:
                    _same_cell(s, m)
            climb = _least_climb(face, other, columnar)
            vx, vy, vz = face[slot.VX], face[slot.VY], face[slot.VZ]
            if tiles is not None:
                cross_facets(tiles, sheet, f, s, m, media, climb, (ox, oy, oz))
                if structured:
                    hold_in_zone(sheet.lattices[int(face[slot.ARRAY])], s, m, lat[slot.MARGIN], 0.0, 0.0)
            else:
                if f or line <= 0:
                    _into_lens(own, sheet, f, s, m, (ox - vx, oy - vy, oz - vz))
                _cross(own, sheet, f, s, m, media, climb, (ox - vx, oy - vy, oz - vz), line)
            _leave(sheet, f, s, m, media, tiles is not None)
            ox, oy, oz = vx, vy, vz
            if structured:
                met += 1
                _stay_inside(sheet, f, s, m, tiles is not None, (vx, vy, vz))
            if lat[slot.LINED] == f:
                _off_line(sheet, f, array, s, m)
            _hold_before(sheet, f, gone, array, s, m, ox, oy, carried)
            if len(hits) and not counted:
                _store_hit(sheet, f, s, array, chosen, hits[f], turns[f])
        if columnar:
            _in_cell_at(sheet.lattices[array], s, m, body[slot.BODY_HIGH] - oz, ox, oy, 0.0)
    return array
