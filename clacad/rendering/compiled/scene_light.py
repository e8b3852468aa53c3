"""The light of objects that rays meet, compiled: the twin of `rendering.scene_hits`' paints.

Formulas and their order are identical, one ray at a time, so that both paths agree to the last bits.
"""

from __future__ import annotations

import math

from clacad.base.compiled import exact
from clacad.base.types import Floats
from clacad.rendering.compiled.scene_tables import (
    AMBIENT,
    COLOUR,
    COLUMNS,
    END,
    GROUND,
    HORIZON,
    KEY,
    KIND,
    ORIGIN,
    PAINT,
    PATTERN,
    PIECE,
    ROWS,
    SIZE,
    TOWARDS_LIGHT,
    TURN,
    ZENITH,
    Tables,
)
from clacad.rendering.scene_arrays import (
    BOX,
    CHECKER,
    CONE,
    COORDINATES,
    FLOOR,
    IMAGE,
    MESH,
    PRISM,
    SPHERE,
    STRIPES,
)
from clacad.tracing.compiled.records import Ray
from clacad.tracing.facets.compiled_hierarchy import normal_of


@exact
def one_sky(world: Floats) -> bool:
    """Whether the sky has one colour at the zenith and at the horizon."""
    return bool(
        world[ZENITH] == world[HORIZON]
        and world[ZENITH + 1] == world[HORIZON + 1]
        and world[ZENITH + 2] == world[HORIZON + 2]
    )


@exact
def background(world: Floats, u: float, v: float, w: float) -> tuple[float, float, float]:
    """Light of the sky, or of the ground below the horizon."""
    if v < 0.0:
        return world[GROUND], world[GROUND + 1], world[GROUND + 2]
    share = 0.0
    if not one_sky(world):
        share = min(1.0, max(0.0, math.atan2(v, math.hypot(u, w)) / (0.5 * math.pi)))
    return (
        world[HORIZON] + (world[ZENITH] - world[HORIZON]) * share,
        world[HORIZON + 1] + (world[ZENITH + 1] - world[HORIZON + 1]) * share,
        world[HORIZON + 2] + (world[ZENITH + 2] - world[HORIZON + 2]) * share,
    )


@exact
def painted(tables: Tables, k: int, facet: int, ray: Ray, distance: float) -> tuple[float, float, float]:
    """Light of primitive k where a ray meets it."""
    world, prim, store = tables.world, tables.prim, tables.store
    x, y, z, u, v, w = ray
    px, py, pz = x - prim[k, ORIGIN], y - prim[k, ORIGIN + 1], z - prim[k, ORIGIN + 2]
    ru = u * prim[k, TURN + 0] + v * prim[k, TURN + 3] + w * prim[k, TURN + 6]
    rv = u * prim[k, TURN + 1] + v * prim[k, TURN + 4] + w * prim[k, TURN + 7]
    rw = u * prim[k, TURN + 2] + v * prim[k, TURN + 5] + w * prim[k, TURN + 8]
    lx = px * prim[k, TURN + 0] + py * prim[k, TURN + 3] + pz * prim[k, TURN + 6] + distance * ru
    ly = px * prim[k, TURN + 1] + py * prim[k, TURN + 4] + pz * prim[k, TURN + 7] + distance * rv
    lz = px * prim[k, TURN + 2] + py * prim[k, TURN + 5] + pz * prim[k, TURN + 8] + distance * rw
    paint, pattern = prim[k, PAINT], prim[k, PATTERN]
    if paint == COORDINATES:
        return lx / (2.0 * prim[k, SIZE]) + 0.5, ly / (2.0 * prim[k, SIZE + 1]) + 0.5, 1.0
    if paint == IMAGE:
        return sampled(prim, store, k, lx, ly)
    c = COLOUR
    if paint == CHECKER:
        tile = math.floor(lx / pattern) + math.floor(lz / pattern)
        c = COLOUR if tile - 2.0 * math.floor(0.5 * tile) == 1.0 else COLOUR + 3
    elif paint == STRIPES:
        stripe = math.floor(2.0 * lx / pattern)
        c = COLOUR if stripe - 2.0 * math.floor(0.5 * stripe) == 0.0 else COLOUR + 3
    light = world[AMBIENT]
    if world[KEY] != 0.0:
        nx, ny, nz = normal(tables, k, facet, lx, ly, lz)
        sx = nx * prim[k, TURN + 0] + ny * prim[k, TURN + 1] + nz * prim[k, TURN + 2]
        sy = nx * prim[k, TURN + 3] + ny * prim[k, TURN + 4] + nz * prim[k, TURN + 5]
        sz = nx * prim[k, TURN + 6] + ny * prim[k, TURN + 7] + nz * prim[k, TURN + 8]
        facing = sx * world[TOWARDS_LIGHT] + sy * world[TOWARDS_LIGHT + 1] + sz * world[TOWARDS_LIGHT + 2]
        if sx * u + sy * v + sz * w > 0.0:
            facing = -facing
        light = world[AMBIENT] + world[KEY] * max(0.0, facing)
    return prim[k, c] * light, prim[k, c + 1] * light, prim[k, c + 2] * light


@exact
def normal(tables: Tables, k: int, facet: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Unit normal in the primitive's frame, of either sign."""
    prim = tables.prim
    kind, a, b, c = prim[k, KIND], prim[k, SIZE], prim[k, SIZE + 1], prim[k, SIZE + 2]
    nx, ny, nz = 0.0, 0.0, 1.0
    if kind == FLOOR:
        return 0.0, 1.0, 0.0
    if kind == SPHERE:
        nx, ny, nz = x / a, y / a, z / a
    elif kind == BOX:
        if abs(x) / a >= abs(y) / b and abs(x) / a >= abs(z) / c:
            nx, ny, nz = 1.0, 0.0, 0.0
        elif abs(y) / b >= abs(z) / c:
            nx, ny, nz = 0.0, 1.0, 0.0
    elif kind == CONE:
        slope, radius = (b - a) / c, math.hypot(x, z)
        if min(abs(y), abs(y - c)) < abs(radius - (a + slope * y)):
            nx, ny, nz = 0.0, 1.0, 0.0
        else:
            nx, ny, nz = x, -slope * radius, z
    elif kind == PRISM:
        nx, ny, nz = prism_normal(tables.store, int(prim[k, PIECE]), int(prim[k, END]), a, x, y, z)
    elif kind == MESH:
        nx, ny, nz = normal_of(tables.trees, facet)
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    return nx / length, ny / length, nz / length


@exact
def prism_normal(
    store: Floats, first: int, end: int, half: float, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Normal of the nearest side or cap of a prism."""
    best, nx, ny, nz = half - abs(z), 0.0, 0.0, 1.0
    for i in range(first, end, 2):
        j = i + 2 if i + 2 < end else first
        x0, y0, x1, y1 = store[i], store[i + 1], store[j], store[j + 1]
        ax, ay = y1 - y0, x0 - x1
        length = math.hypot(ax, ay)
        share = ((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / (length * length)
        share = min(1.0, max(0.0, share))
        off = math.hypot(x - x0 - share * (x1 - x0), y - y0 - share * (y1 - y0))
        if off < best:
            best, nx, ny, nz = off, ax / length, ay / length, 0.0
    return nx, ny, nz


@exact
def sampled(prim: Floats, store: Floats, k: int, x: float, y: float) -> tuple[float, float, float]:
    """Bilinear light of a picture; its right edge is at −x."""
    height, width = int(prim[k, ROWS]), int(prim[k, COLUMNS])
    px = min(width - 1.0, max(0.0, (0.5 - x / (2.0 * prim[k, SIZE])) * width - 0.5))
    py = min(height - 1.0, max(0.0, (0.5 - y / (2.0 * prim[k, SIZE + 1])) * height - 0.5))
    i, j = min(int(px), max(width - 2, 0)), min(int(py), max(height - 2, 0))
    f, g = px - i, py - j
    a = int(prim[k, PIECE]) + 3 * (j * width + i)
    right = 3 if width > 1 else 0
    down = 3 * width if height > 1 else 0
    b, c, d = a + right, a + down, a + down + right
    p, q, r, o = (1.0 - f) * (1.0 - g), f * (1.0 - g), (1.0 - f) * g, f * g
    return (
        store[a] * p + store[b] * q + store[c] * r + store[d] * o,
        store[a + 1] * p + store[b + 1] * q + store[c + 1] * r + store[d + 1] * o,
        store[a + 2] * p + store[b + 2] * q + store[c + 2] * r + store[d + 2] * o,
    )
