"""Triangles from anywhere in the walk, compiled: where a ray enters a body of them, or leaves it."""

from __future__ import annotations

from math import inf, isnan

from clacad.base.compiled import exact
from clacad.base.types import Floats
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.column import DISTANCE, KIND, PLACE, box_span, sheet_xy, to_array
from clacad.tracing.compiled.face import height
from clacad.tracing.reference.column import ABOVE, ASIDE, BACK, BACK_LAND, FRONT, FRONT_LAND, WALL
from clacad.tracing.triangles.compiled_search import BOTH, hit, nearest, normal_of, ways_through
from clacad.tracing.triangles.tiles import Tiles

NORMAL = PLACE + 8
STEEP = 0.05
"""Triangles whose |n_z| is below this are walls."""

LEVEL = 1e-5
"""Slope below which a triangle may be land."""

CLEAR = 1e-9
"""Share of a cell that a ray must have gone before it can meet a triangle again."""


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
        nx, ny, nz = normal_of(tiles, which)
        if not (inside and _is_wall(nx, ny, nz)):
            break
        senses = ways_through(tiles, b, ox, oy, oz, x, y, z, L, M, N, t - clear, t + clear)
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
    nx, ny, nz = normal_of(tiles, which)
    face = faces[2 * b + side]
    if face[slot.ARRAY] >= 0.0 and not isnan(face[slot.LAND]):
        place = PLACE + 4 * int(face[slot.ARRAY])
        lens = height(faces, 2 * b + side, event[place + 2] + t * L, event[place + 3] + t * M)
        flat = nx * nx + ny * ny <= LEVEL * LEVEL * nz * nz
        if flat and (isnan(lens) or abs(level - face[slot.LAND]) < abs(level - lens)):
            event[KIND] = FRONT_LAND if side == 0 else BACK_LAND
    if len(tiles.corner_normal) > 0:
        _, u, v, w = hit(tiles.corner[which], ox, oy, oz, x, y, z, L, M, N)
        n = tiles.corner_normal[which]
        nx, ny, nz = (
            u * n[0, 0] + v * n[1, 0] + w * n[2, 0],
            u * n[0, 1] + v * n[1, 1] + w * n[2, 1],
            u * n[0, 2] + v * n[1, 2] + w * n[2, 2],
        )
    sign = -1.0 if side == 0 else 1.0
    event[NORMAL], event[NORMAL + 1], event[NORMAL + 2] = sign * nx, sign * ny, sign * nz
