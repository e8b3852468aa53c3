"""Compiled search of foreign triangles: the first one a ray meets, in a tree of boxes."""

from __future__ import annotations

from math import inf, isnan

import numpy as np

from clacad.base.compiled import exact, owning
from clacad.base.types import Floats
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.column import DISTANCE, KIND, PLACE, box_span, sheet_xy, to_array
from clacad.tracing.compiled.face import height
from clacad.tracing.reference.column import ABOVE, ASIDE, BACK, BACK_LAND, FRONT, FRONT_LAND, WALL
from clacad.tracing.triangles.tiles import Tiles

NORMAL = PLACE + 8
LEAF = 4

STEEP = 0.05
"""Triangles whose |n_z| is below this are walls."""

LEVEL = 1e-5
"""Slope below which a triangle may be land."""

BOTH = 3

CLEAR = 1e-9
"""Share of a cell that a ray must have gone before it can meet a triangle again."""


@exact
def _enters(box: Floats, x: float, y: float, z: float, il: float, im: float, iz: float, far: float) -> float:
    """Distance at which a ray enters a box, or inf; a hair is granted for rounding."""
    a, b = (box[0] - x) * il, (box[3] - x) * il
    c, d = (box[1] - y) * im, (box[4] - y) * im
    e, f = (box[2] - z) * iz, (box[5] - z) * iz
    near = max(min(a, b), max(min(c, d), min(e, f)))
    leave = min(max(a, b), min(max(c, d), max(e, f)))
    slack = 1e-12 * (abs(near) + abs(leave))
    return near - slack if near <= leave + 2.0 * slack and near <= far else inf


@exact
def _hit(
    corner: Floats,
    ox: float,
    oy: float,
    oz: float,
    x: float,
    y: float,
    z: float,
    L: float,
    M: float,
    N: float,
) -> tuple[float, float, float, float]:
    """Distance to a triangle and barycentric coordinates; inf where it is missed.

    Corners are taken relative to the cell and then to the ray, sheared so that the ray runs along z: edges
    that two triangles share get the same number with opposite signs, so no ray slips between them. After
    Woop, Benthin and Wald, Watertight Ray/Triangle Intersection, JCGT 2 (2013); N > 0 is the largest axis here.
    """
    sx, sy = L / N, M / N
    ax, ay, az = (corner[0, 0] - ox) - x, (corner[0, 1] - oy) - y, (corner[0, 2] - oz) - z
    bx, by, bz = (corner[1, 0] - ox) - x, (corner[1, 1] - oy) - y, (corner[1, 2] - oz) - z
    cx, cy, cz = (corner[2, 0] - ox) - x, (corner[2, 1] - oy) - y, (corner[2, 2] - oz) - z
    ax, ay = ax - sx * az, ay - sy * az
    bx, by = bx - sx * bz, by - sy * bz
    cx, cy = cx - sx * cz, cy - sy * cz
    u, v, w = cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax
    if (u < 0.0 or v < 0.0 or w < 0.0) and (u > 0.0 or v > 0.0 or w > 0.0):
        return inf, 0.0, 0.0, 0.0
    total = u + v + w
    if total == 0.0:
        return inf, 0.0, 0.0, 0.0
    return (u * az + v * bz + w * cz) / (total * N), u / total, v / total, w / total


@owning
def nearest(
    tiles: Tiles, b: int, ox: float, oy: float, oz: float, x: float, y: float, z: float, L: float, M: float,
    N: float, least: float, most: float,
) -> tuple[float, int]:  # fmt: skip
    """Nearest triangle of body b at a distance between `least` and `most`: distance and number, inf and −1.

    (x, y, z) is relative to (ox, oy, oz), the centre of the ray's cell.
    """
    root, first, count = tiles.tree[b, 0], tiles.tree[b, 1], tiles.tree[b, 2]
    nodes = (tiles.tree[b + 1, 0] if b + 1 < len(tiles.tree) else len(tiles.box)) - root
    inner = (nodes - 1) // 2
    il, im, iz = 1.0 / L, 1.0 / M, 1.0 / N
    gx, gy, gz = ox + x, oy + y, oz + z
    best, which = most, -1
    stack = np.empty(64, dtype=np.int64)
    stack[0], height_of_stack = 0, 1
    while height_of_stack > 0:
        height_of_stack -= 1
        node = stack[height_of_stack]
        if not _enters(tiles.box[root + node], gx, gy, gz, il, im, iz, best) < inf:
            continue
        if node < inner:
            stack[height_of_stack], stack[height_of_stack + 1] = 2 * node + 2, 2 * node + 1
            height_of_stack += 2
            continue
        start = (node - inner) * LEAF
        for k in range(start, min(start + LEAF, count)):
            t = _hit(tiles.corner[first + k], ox, oy, oz, x, y, z, L, M, N)[0]
            if least < t < best:
                best, which = t, first + k
    return (best, which) if which >= 0 else (inf, -1)


@owning
def _senses(
    tiles: Tiles, b: int, ox: float, oy: float, oz: float, x: float, y: float, z: float, L: float, M: float,
    N: float, least: float, most: float,
) -> int:  # fmt: skip
    """Which way the ray goes through the triangles between two distances: 1 inwards, 2 outwards, 3 both."""
    root, first, count = tiles.tree[b, 0], tiles.tree[b, 1], tiles.tree[b, 2]
    nodes = (tiles.tree[b + 1, 0] if b + 1 < len(tiles.tree) else len(tiles.box)) - root
    inner = (nodes - 1) // 2
    il, im, iz = 1.0 / L, 1.0 / M, 1.0 / N
    found = 0
    stack = np.empty(64, dtype=np.int64)
    stack[0], height_of_stack = 0, 1
    while height_of_stack > 0:
        height_of_stack -= 1
        node = stack[height_of_stack]
        if not _enters(tiles.box[root + node], ox + x, oy + y, oz + z, il, im, iz, most) < inf:
            continue
        if node < inner:
            stack[height_of_stack], stack[height_of_stack + 1] = 2 * node + 2, 2 * node + 1
            height_of_stack += 2
            continue
        start = (node - inner) * LEAF
        for k in range(start, min(start + LEAF, count)):
            t = _hit(tiles.corner[first + k], ox, oy, oz, x, y, z, L, M, N)[0]
            if least < t < most:
                nx, ny, nz = _normal(tiles, first + k)
                found |= 2 if nx * L + ny * M + nz * N > 0.0 else 1
    return found


@exact
def _normal(tiles: Tiles, k: int) -> tuple[float, float, float]:
    """Outward normal of a triangle, as long as twice its area."""
    c = tiles.corner[k]
    ux, uy, uz = c[1, 0] - c[0, 0], c[1, 1] - c[0, 1], c[1, 2] - c[0, 2]
    vx, vy, vz = c[2, 0] - c[0, 0], c[2, 1] - c[0, 1], c[2, 2] - c[0, 2]
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@exact
def _is_wall(nx: float, ny: float, nz: float) -> bool:
    return nz * nz < STEEP * STEEP * (nx * nx + ny * ny + nz * nz)


@exact
def first_soup_change(
    tiles: Tiles, faces: Floats, bodies: Floats, lat: Floats, b: int, array: int, i: float, j: float, x: float,
    y: float, z: float, L: float, M: float, N: float, inside: bool, event: Floats,
) -> None:  # fmt: skip
    """Find where a ray first enters the triangles of body b, or leaves them; see `reference.column.first_change`.

    Two cells that touch as separate solids have two walls in one place: light in the glass passes both.
    """
    sx, sy = sheet_xy(lat, array, i, j, x, y)
    ox, oy, oz = sx - x, sy - y, bodies[b, slot.LEVEL]
    aside = max(box_span(lat, bodies, b, sx, sy, L, M)[1], 0.0)
    above = inf if inside else (bodies[b, slot.BODY_HIGH] - z) / N
    clear = CLEAR * lat[slot.HALF]
    least, kind, t = clear, ASIDE, aside
    if event[DISTANCE] < 0.0:  # from the reference plane: nothing has been met yet
        least = -clear
    nx, ny, nz = 0.0, 0.0, 1.0
    which = -1
    for _ in range(64):
        t, which = nearest(tiles, b, ox, oy, oz, x, y, z, L, M, N, least, inf)
        if which < 0:
            break
        nx, ny, nz = _normal(tiles, which)
        if not (inside and _is_wall(nx, ny, nz)):
            break
        senses = _senses(tiles, b, ox, oy, oz, x, y, z, L, M, N, t - clear, t + clear)
        if senses != BOTH:
            break
        least = t + clear
    if which < 0 or t >= min(above, aside):
        kind = ABOVE if above <= aside else ASIDE
        t = min(above, aside)
    elif _is_wall(nx, ny, nz) or (nx * L + ny * M + nz * N > 0.0) != inside:
        kind = WALL
    else:
        kind = FRONT if nz < 0.0 else BACK
    event[KIND], event[DISTANCE] = kind, t
    for at in range(2):
        p, q, u, v = to_array(lat, array, at, i, j, x + t * L, y + t * M)
        place = PLACE + 4 * at
        event[place], event[place + 1], event[place + 2], event[place + 3] = p, q, u - t * L, v - t * M
    if kind == FRONT or kind == BACK:
        _name(tiles, faces, b, which, z + t * N, t, event, ox, oy, oz, x, y, z, L, M, N)


@exact
def _name(
    tiles: Tiles, faces: Floats, b: int, which: int, level: float, t: float, event: Floats, ox: float, oy: float,
    oz: float, x: float, y: float, z: float, L: float, M: float, N: float,
) -> None:  # fmt: skip
    """Tell land, level triangles nearer the design's land than its lens, and note the normal towards +z."""
    side = 0 if event[KIND] == FRONT else 1
    nx, ny, nz = _normal(tiles, which)
    face = faces[2 * b + side]
    if face[slot.ARRAY] >= 0.0 and not isnan(face[slot.LAND]):
        place = PLACE + 4 * int(face[slot.ARRAY])
        lens = height(faces, 2 * b + side, event[place + 2] + t * L, event[place + 3] + t * M)
        flat = nx * nx + ny * ny <= LEVEL * LEVEL * nz * nz
        if flat and (isnan(lens) or abs(level - face[slot.LAND]) < abs(level - lens)):
            event[KIND] = FRONT_LAND if side == 0 else BACK_LAND
    if len(tiles.corner_normal) > 0:
        _, u, v, w = _hit(tiles.corner[which], ox, oy, oz, x, y, z, L, M, N)
        n = tiles.corner_normal[which]
        nx, ny, nz = (
            u * n[0, 0] + v * n[1, 0] + w * n[2, 0],
            u * n[0, 1] + v * n[1, 1] + w * n[2, 1],
            u * n[0, 2] + v * n[1, 2] + w * n[2, 2],
        )
    sign = -1.0 if side == 0 else 1.0
    event[NORMAL], event[NORMAL + 1], event[NORMAL + 2] = sign * nx, sign * ny, sign * nz
