"""Fast path for the commonest rays that the block trace leaves: through a hole next to a thin lens.

A rotated lens that is too thin does not fill its cell; a ray through the corner passes a hole there. Where
arrays are bundles of convex lenslets without land, a ray that stays in its cell either misses the lens or
crosses its two faces. The roots of its two quadrics decide both. Everything else is left to the walk.
"""

from __future__ import annotations

from math import inf, isfinite

import numpy as np

from clacad.base.compiled import exact
from clacad.base.types import Floats
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.cells import kept, sheet_xy, to_array
from clacad.tracing.compiled.face import lens_roots, meet, snell, to_lens, to_sheet
from clacad.tracing.compiled.packing import Packed
from clacad.tracing.compiled.records import Launched, Ray

UNDECIDED, DIRECT, STRAYED, PASSED_HOLE = range(4)

HAIR = 1e-9
"""Part of a cell within which nothing is decided here."""


def suits(sheet: Packed) -> bool:
    """Whether this module supports a sheet: convex quadrics in columns, no land, line or honeycomb."""
    faces, bodies, lattice = sheet.faces, sheet.bodies, sheet.lattice
    open_gap = lattice[slot.BAFFLE] == slot.NO_BAFFLE and lattice[slot.LINED] < 0.0
    plain = lattice[slot.PLAIN] != 0.0 and open_gap and lattice[slot.MARGIN] == 0.0
    columns = (bodies[:, slot.COLUMNAR] != 0.0).all() and (bodies[:, slot.OUTLINE] == slot.NO_OUTLINE).all()
    convex = (faces[:, (slot.CX, slot.CY, slot.KX)] > 0.0).all() and (faces[:, slot.BICONIC] == 0.0).all()
    bare = np.isnan(faces[:, slot.LAND]).all() and (faces[:, slot.ARRAY] >= 0.0).all()
    return bool(plain and columns and convex and bare)


@exact
def pass_quick(sheet: Packed, launched: Launched, position: Floats, direction: Floats) -> int:
    """Trace one launched ray; write where it leaves to row 0 of (1, 3), or return UNDECIDED."""
    faces, bodies, lat, rows, media = sheet.faces, sheet.bodies, sheet.lattice, sheet.rows, sheet.media
    i, j, x, y, z, L, M, N, _ = launched
    half_x, half_y = lat[slot.HALF], lat[slot.HALF + 1]
    hair = HAIR * half_x
    half_x, half_y = half_x - hair, half_y - hair
    first_i, first_j, at, hole, strayed = i, j, int(bodies[0, slot.ENTRY]), False, False
    for b in range(len(bodies)):
        array = int(bodies[b, slot.ENTRY])
        if b:
            z -= bodies[b, slot.LEVEL] - bodies[b - 1, slot.LEVEL]
            t = (bodies[b, slot.BODY_LOW] - z) / N
            i, j, x, y = to_array(lat, at, array, i, j, x + t * L, y + t * M)
            z, at = bodies[b, slot.BODY_LOW], array
        if not (kept(lat, rows, i, j) and abs(x) < half_x and abs(y) < half_y):
            return UNDECIDED
        rise = (bodies[b, slot.BODY_HIGH] - z) / N
        enter, by_front, leave, _ = _between(faces, 2 * b, Ray(x, y, z, L, M, N), hair)
        if enter == inf:
            x, y, z, hole = x + rise * L, y + rise * M, bodies[b, slot.BODY_HIGH], True
            if not (abs(x) < half_x and abs(y) < half_y):
                return UNDECIDED
            continue
        if not (by_front and 0.0 < enter < leave - hair and enter < rise):
            return UNDECIDED
        strayed = strayed or i != first_i or j != first_j
        t, (x, y, z, L, M, N) = _crossed(faces, 2 * b, Ray(x, y, z, L, M, N), media[2 * b], media[2 * b + 1])
        if not (abs(t - enter) <= hair and abs(x) < half_x and abs(y) < half_y and N > 0.0):
            return UNDECIDED
        _, _, leave, by_back = _between(faces, 2 * b, Ray(x, y, z, L, M, N), hair)
        if not (by_back and hair < leave < inf):
            return UNDECIDED
        t, (x, y, z, L, M, N) = _crossed(
            faces, 2 * b + 1, Ray(x, y, z, L, M, N), media[2 * b + 1], media[2 * b + 2]
        )
        if not (abs(t - leave) <= hair and N > 0.0):
            return UNDECIDED
        rise = max(0.0, (bodies[b, slot.BODY_HIGH] - z) / N)
        far = max(abs(x), abs(x + rise * L)) < half_x and max(abs(y), abs(y + rise * M)) < half_y
        if not far:
            return UNDECIDED
    position[0, 0], position[0, 1] = sheet_xy(lat, at, i, j, x, y)
    position[0, 2] = z + bodies[len(bodies) - 1, slot.LEVEL]
    direction[0, 0], direction[0, 1], direction[0, 2] = L, M, N
    return PASSED_HOLE if hole else (STRAYED if strayed else DIRECT)


@exact
def _between(faces: Floats, f: int, ray: Ray, hair: float) -> tuple[float, bool, float, bool]:
    """Stretch of a ray inside both quadrics of a lens: start, whether by the front, end, whether by the back.

    The start is ∞ for a certain miss; close calls are returned as neither front nor back.
    """
    x, y, z, L, M, N = ray
    a, b = lens_roots(faces, f, x, y, z, L, M, N)
    c, d = lens_roots(faces, f + 1, x, y, z, L, M, N)
    if not (isfinite(a) and isfinite(b) and isfinite(c) and isfinite(d)):
        missed = (a == inf and b == inf) or (c == inf and d == inf)
        return (inf if missed else -inf), False, -inf, False
    front0, front1, back0, back1 = min(a, b), max(a, b), min(c, d), max(c, d)
    enter, leave = max(front0, back0), min(front1, back1)
    if enter > leave + hair:
        return inf, False, -inf, False
    return enter, front0 > back0 + hair, leave, back1 < front1 - hair


@exact
def _crossed(faces: Floats, f: int, ray: Ray, n1: float, n2: float) -> tuple[float, Ray]:
    """Refract at one face: the distance, and the ray from there; NaN where there is none."""
    vx, vy, vz = faces[f, slot.VX], faces[f, slot.VY], faces[f, slot.VZ]
    sx, sy, sz = to_lens(faces, f, ray.x - vx, ray.y - vy, ray.z - vz)
    u, v, w = to_lens(faces, f, ray.L, ray.M, ray.N)
    t, px, py, pz, gx, gy, gz, root = meet(faces, f, sx, sy, sz, u, v, w)
    u, v, w = snell((u, v, w), (gx, gy, gz), root, n1, n2)
    px, py, pz = to_sheet(faces, f, px, py, pz)
    u, v, w = to_sheet(faces, f, u, v, w)
    return t, Ray(px + vx, py + vy, pz + vz, u, v, w)
