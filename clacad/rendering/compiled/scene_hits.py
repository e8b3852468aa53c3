"""Objects that rays meet in the scene and their light, compiled: the twin of `rendering.scene_hits`.

Rays are processed in blocks of columns: sky, floors and bounds in passes over the block. The rays that come
near an object are gathered and tested against its primitives in separate passes. Distances are in lengths of
the given direction. Imported inside functions only.

The light of objects that rays meet, compiled: the twin of `rendering.scene_hits`' paints.

Formulas and their order are identical, one ray at a time, so that both paths agree to the last bits.

Distances to primitives, compiled: a block of rays in a primitive's own frame, one plain loop a shape.

The twin of `rendering.scene_hits`' shapes. Distances are in lengths of the given direction; NaN or ∞ where a
ray misses.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clacad.base.compiled import exact, inlined, making, owning
from clacad.base.types import Floats, Ints
from clacad.rendering import scene_arrays as slot
from clacad.rendering.scene_arrays import Tables
from clacad.tracing.compiled.records import DEPTH, Ray
from clacad.tracing.facets.compiled_hierarchy import nearest, normal_of


@exact
def to_frame(prim: Floats, k: int, m: int, ray: Floats, local: Floats) -> None:
    """Starts and directions (6, m) of rays in the frame of primitive k."""
    origin, turn = prim[k, slot.ORIGIN : slot.ORIGIN + 3], prim[k, slot.TURN : slot.TURN + 9]
    unturned = turn[0] == 1.0 and turn[4] == 1.0 and turn[8] == 1.0  # of a rotation: none
    for i in range(m):
        x, y, z = ray[0, i] - origin[0], ray[1, i] - origin[1], ray[2, i] - origin[2]
        local[0, i], local[1, i], local[2, i] = (x, y, z) if unturned else _into_frame(turn, x, y, z)
    for i in range(m):
        x, y, z = ray[3, i], ray[4, i], ray[5, i]
        local[3, i], local[4, i], local[5, i] = (x, y, z) if unturned else _into_frame(turn, x, y, z)


@exact
def distances(prim: Floats, store: Floats, k: int, m: int, local: Floats, out: Floats, work: Floats) -> None:
    """Write the distance (m,) to primitive k, which is no mesh; `work` (2, m) is scratch."""
    kind, a, b, c = prim[k, slot.KIND], prim[k, slot.SIZE], prim[k, slot.SIZE + 1], prim[k, slot.SIZE + 2]
    if kind == slot.SPHERE:
        _sphere(m, local, a, out)
    elif kind == slot.BOX:
        _box(m, local, a, b, c, out)
    elif kind == slot.CONE:
        _cone(m, local, a, b, c, out)
    elif kind == slot.PRISM:
        _prism(store, int(prim[k, slot.PIECE]), int(prim[k, slot.END]), m, local, a, out, work)
    else:
        _screen(m, local, a, b, out)


@exact
def _sphere(m: int, local: Floats, radius: float, out: Floats) -> None:
    """Nearer hit above 0 of a sphere about the origin."""
    x, y, z, u, v, w = local[0, :m], local[1, :m], local[2, :m], local[3, :m], local[4, :m], local[5, :m]
    for i in range(m):
        inverse = 1.0 / (u[i] * u[i] + v[i] * v[i] + w[i] * w[i])
        middle = -(x[i] * u[i] + y[i] * v[i] + z[i] * w[i]) * inverse
        px, py, pz = x[i] + middle * u[i], y[i] + middle * v[i], z[i] + middle * w[i]
        half = math.sqrt((radius * radius - (px * px + py * py + pz * pz)) * inverse)
        near = middle - half
        out[i] = near if near > 0.0 else middle + half


@exact
def _span(p: float, d: float, half: float) -> tuple[float, float]:
    """Distances at which a ray enters and leaves a slab; all or nothing for a ray parallel to it."""
    inverse = 1.0 / d
    a, b = (-half - p) * inverse, (half - p) * inverse
    outside = abs(p) > half
    near, far = (a, b) if a < b else (b, a)
    along = d == 0.0
    near = (np.inf if outside else -np.inf) if along else near
    far = (-np.inf if outside else np.inf) if along else far
    return near, far


@exact
def _box(m: int, local: Floats, hx: float, hy: float, hz: float, out: Floats) -> None:
    """Nearer hit above 0 of a box about the origin."""
    x, y, z, u, v, w = local[0, :m], local[1, :m], local[2, :m], local[3, :m], local[4, :m], local[5, :m]
    for i in range(m):
        a, b = _span(x[i], u[i], hx)
        c, d = _span(y[i], v[i], hy)
        e, f = _span(z[i], w[i], hz)
        near = a if a > c else c
        near = near if near > e else e
        far = b if b < d else d
        far = far if far < f else f
        hit = near if near > 0.0 else far
        out[i] = hit if near <= far else np.nan


@exact
def _screen(m: int, local: Floats, hx: float, hy: float, out: Floats) -> None:
    """Hit of a rectangle in the plane z = 0."""
    x, y, z, u, v, w = local[0, :m], local[1, :m], local[2, :m], local[3, :m], local[4, :m], local[5, :m]
    for i in range(m):
        s = -z[i] / w[i]
        inside = (abs(x[i] + s * u[i]) <= hx) & (abs(y[i] + s * v[i]) <= hy)
        out[i] = s if inside else np.nan


@exact
def _cone(m: int, local: Floats, bottom: float, top: float, height: float, out: Floats) -> None:
    """Nearest hit above 0 of a closed frustum with axis y."""
    x, y, z, u, v, w = local[0, :m], local[1, :m], local[2, :m], local[3, :m], local[4, :m], local[5, :m]
    slope = (top - bottom) / height
    for i in range(m):
        middle = -(x[i] * u[i] + y[i] * v[i] + z[i] * w[i]) / (u[i] * u[i] + v[i] * v[i] + w[i] * w[i])
        px, py, pz = x[i] + middle * u[i], y[i] + middle * v[i], z[i] + middle * w[i]
        r = bottom + slope * py
        a = u[i] * u[i] + w[i] * w[i] - slope * slope * v[i] * v[i]
        b = px * u[i] + pz * w[i] - slope * v[i] * r
        c = px * px + pz * pz - r * r
        root = math.sqrt(b * b - a * c)
        q = -(b + (root if b >= 0.0 else -root))
        best = np.inf
        s = q / a
        at = py + s * v[i]
        good = (s + middle > 0.0) & (at >= 0.0) & (at <= height) & (bottom + slope * at >= 0.0)
        best = s + middle if good else best
        s = c / q
        at = py + s * v[i]
        good = (s + middle > 0.0) & (at >= 0.0) & (at <= height) & (bottom + slope * at >= 0.0)
        best = s + middle if good & (s + middle < best) else best
        s = -py / v[i]
        cx, cz = px + s * u[i], pz + s * w[i]
        good = (s + middle > 0.0) & (cx * cx + cz * cz <= bottom * bottom)
        best = s + middle if good & (s + middle < best) else best
        s = (height - py) / v[i]
        cx, cz = px + s * u[i], pz + s * w[i]
        good = (s + middle > 0.0) & (cx * cx + cz * cz <= top * top)
        out[i] = s + middle if good & (s + middle < best) else best


@exact
def _prism(
    store: Floats, first: int, end: int, m: int, local: Floats, half: float, out: Floats, work: Floats
) -> None:
    """Nearest hit above 0 of an extruded outline between z = −half and half."""
    x, y, z, u, v, w = local[0, :m], local[1, :m], local[2, :m], local[3, :m], local[4, :m], local[5, :m]
    best, level, odd = out[:m], work[0, :m], work[1, :m]
    for i in range(m):
        best[i] = np.inf
    for k in range(2):
        cap = half if k else -half
        for i in range(m):
            level[i], odd[i] = (cap - z[i]) / w[i], -1.0
        for n in range(first, end, 2):  # crossings of the outline to the right, counted by sign
            j = n + 2 if n + 2 < end else first
            x0, y0, x1, y1 = store[n], store[n + 1], store[j], store[j + 1]
            if y0 == y1:
                continue
            run = (x1 - x0) / (y1 - y0)
            for i in range(m):
                px, py = x[i] + level[i] * u[i], y[i] + level[i] * v[i]
                crosses = ((y0 > py) != (y1 > py)) & (px < run * (py - y0) + x0)
                odd[i] = -odd[i] if crosses else odd[i]
        for i in range(m):
            better = (odd[i] > 0.0) & (level[i] > 0.0) & (level[i] < best[i])
            best[i] = level[i] if better else best[i]
    for n in range(first, end, 2):
        j = n + 2 if n + 2 < end else first
        x0, y0, x1, y1 = store[n], store[n + 1], store[j], store[j + 1]
        nx, ny = y1 - y0, x0 - x1
        square = nx * nx + ny * ny
        for i in range(m):
            s = (nx * (x0 - x[i]) + ny * (y0 - y[i])) / (nx * u[i] + ny * v[i])
            along = (x[i] + s * u[i] - x0) * (x1 - x0) + (y[i] + s * v[i] - y0) * (y1 - y0)
            good = (
                (s > 0.0)
                & (s < best[i])
                & (along >= 0.0)
                & (along <= square)
                & (abs(z[i] + s * w[i]) <= half)
            )
            best[i] = s if good else best[i]


@exact
def one_sky(world: Floats) -> bool:
    """Whether the sky has one colour at the zenith and at the horizon."""
    return bool(
        world[slot.ZENITH] == world[slot.HORIZON]
        and world[slot.ZENITH + 1] == world[slot.HORIZON + 1]
        and world[slot.ZENITH + 2] == world[slot.HORIZON + 2]
    )


@exact
def background(world: Floats, u: float, v: float, w: float) -> tuple[float, float, float]:
    """Light of the sky, or of the ground below the horizon."""
    if v < 0.0:
        return world[slot.GROUND], world[slot.GROUND + 1], world[slot.GROUND + 2]
    share = 0.0
    if not one_sky(world):
        share = min(1.0, max(0.0, math.atan2(v, math.hypot(u, w)) / (0.5 * math.pi)))
    return (
        world[slot.HORIZON] + (world[slot.ZENITH] - world[slot.HORIZON]) * share,
        world[slot.HORIZON + 1] + (world[slot.ZENITH + 1] - world[slot.HORIZON + 1]) * share,
        world[slot.HORIZON + 2] + (world[slot.ZENITH + 2] - world[slot.HORIZON + 2]) * share,
    )


@inlined
def _into_frame(turn: Floats, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A vector of the scene in the frame of a primitive with these axes (9,)."""
    return (
        x * turn[0] + y * turn[3] + z * turn[6],
        x * turn[1] + y * turn[4] + z * turn[7],
        x * turn[2] + y * turn[5] + z * turn[8],
    )


@exact
def painted(tables: Tables, k: int, facet: int, ray: Ray, distance: float) -> tuple[float, float, float]:
    """Light of primitive k where a ray meets it."""
    world, prim, store = tables.world, tables.prim, tables.store
    x, y, z, u, v, w = ray
    turn, towards = prim[k, slot.TURN : slot.TURN + 9], world[slot.TOWARDS_LIGHT : slot.TOWARDS_LIGHT + 3]
    px, py, pz = x - prim[k, slot.ORIGIN], y - prim[k, slot.ORIGIN + 1], z - prim[k, slot.ORIGIN + 2]
    ru, rv, rw = _into_frame(turn, u, v, w)
    lx, ly, lz = _into_frame(turn, px, py, pz)
    lx, ly, lz = lx + distance * ru, ly + distance * rv, lz + distance * rw
    paint, pattern = prim[k, slot.PAINT], prim[k, slot.PATTERN]
    if paint == slot.COORDINATES:
        return lx / (2.0 * prim[k, slot.SIZE]) + 0.5, ly / (2.0 * prim[k, slot.SIZE + 1]) + 0.5, 1.0
    if paint == slot.IMAGE:
        return sampled(prim, store, k, lx, ly)
    c = slot.COLOUR
    if paint == slot.CHECKER:
        tile = math.floor(lx / pattern) + math.floor(lz / pattern)
        c = slot.COLOUR if tile - 2.0 * math.floor(0.5 * tile) == 1.0 else slot.COLOUR + 3
    elif paint == slot.STRIPES:
        stripe = math.floor(2.0 * lx / pattern)
        c = slot.COLOUR if stripe - 2.0 * math.floor(0.5 * stripe) == 0.0 else slot.COLOUR + 3
    light = world[slot.AMBIENT]
    if world[slot.KEY] != 0.0:
        nx, ny, nz = normal(tables, k, facet, lx, ly, lz)
        sx = nx * turn[0] + ny * turn[1] + nz * turn[2]
        sy = nx * turn[3] + ny * turn[4] + nz * turn[5]
        sz = nx * turn[6] + ny * turn[7] + nz * turn[8]
        facing = sx * towards[0] + sy * towards[1] + sz * towards[2]
        if sx * u + sy * v + sz * w > 0.0:
            facing = -facing
        light = world[slot.AMBIENT] + world[slot.KEY] * max(0.0, facing)
    return prim[k, c] * light, prim[k, c + 1] * light, prim[k, c + 2] * light


@exact
def normal(tables: Tables, k: int, facet: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Unit normal in the primitive's frame, of either sign."""
    prim = tables.prim
    kind, a, b, c = prim[k, slot.KIND], prim[k, slot.SIZE], prim[k, slot.SIZE + 1], prim[k, slot.SIZE + 2]
    nx, ny, nz = 0.0, 0.0, 1.0
    if kind == slot.FLOOR:
        return 0.0, 1.0, 0.0
    if kind == slot.SPHERE:
        nx, ny, nz = x / a, y / a, z / a
    elif kind == slot.BOX:
        if abs(x) / a >= abs(y) / b and abs(x) / a >= abs(z) / c:
            nx, ny, nz = 1.0, 0.0, 0.0
        elif abs(y) / b >= abs(z) / c:
            nx, ny, nz = 0.0, 1.0, 0.0
    elif kind == slot.CONE:
        slope, radius = (b - a) / c, math.hypot(x, z)
        if min(abs(y), abs(y - c)) < abs(radius - (a + slope * y)):
            nx, ny, nz = 0.0, 1.0, 0.0
        else:
            nx, ny, nz = x, -slope * radius, z
    elif kind == slot.PRISM:
        nx, ny, nz = prism_normal(tables.store, int(prim[k, slot.PIECE]), int(prim[k, slot.END]), a, x, y, z)
    elif kind == slot.MESH:
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
    height, width = int(prim[k, slot.ROWS]), int(prim[k, slot.COLUMNS])
    px = min(width - 1.0, max(0.0, (0.5 - x / (2.0 * prim[k, slot.SIZE])) * width - 0.5))
    py = min(height - 1.0, max(0.0, (0.5 - y / (2.0 * prim[k, slot.SIZE + 1])) * height - 0.5))
    i, j = min(int(px), max(width - 2, 0)), min(int(py), max(height - 2, 0))
    f, g = px - i, py - j
    a = int(prim[k, slot.PIECE]) + 3 * (j * width + i)
    right = 3 if width > 1 else 0
    down = 3 * width if height > 1 else 0
    b, c, d = a + right, a + down, a + down + right
    p, q, r, o = (1.0 - f) * (1.0 - g), f * (1.0 - g), (1.0 - f) * g, f * g
    return (
        store[a] * p + store[b] * q + store[c] * r + store[d] * o,
        store[a + 1] * p + store[b + 1] * q + store[c + 1] * r + store[d + 1] * o,
        store[a + 2] * p + store[b + 2] * q + store[c + 2] * r + store[d + 2] * o,
    )


class Pad(NamedTuple):
    """Scratch of a block of rays.

    ray : (6, BLOCK). Starts and directions.
    best : (BLOCK,), which : (BLOCK,) ints
        Distance of the hit, or the given limit before any; its primitive, −1 for none.
    colour : (3, BLOCK). Light found.
    near : (BLOCK,)
    some : (4, BLOCK) ints. Rays near an object; what each of them met, its triangle; waiting nodes of a tree.
    part : (16, BLOCK). Starts and directions of those rays, both in a primitive's frame, distances, scratch.
    """

    ray: Floats
    best: Floats
    which: Ints
    colour: Floats
    near: Floats
    some: Ints
    part: Floats


@making
def new_pad() -> Pad:
    """Scratch for one thread."""
    return Pad(
        np.empty((6, slot.BLOCK)),
        np.empty(slot.BLOCK),
        np.empty(slot.BLOCK, np.int64),
        np.empty((3, slot.BLOCK)),
        np.empty(slot.BLOCK),
        np.empty((4, max(slot.BLOCK, DEPTH)), np.int64),
        np.empty((16, slot.BLOCK)),
    )


@owning
def look_all(
    tables: Tables,
    origin: Floats,
    direction: Floats,
    limit: Floats,
    light: Floats,
    met: NDArray[np.bool_],
    distance: Floats,
) -> None:
    """Write the light of each ray, whether it met an object and its distance; see `scene_hits.look`.

    origin, direction : (n, 3)
    limit : (n,). Limit of the search, in lengths of the given directions.
    light : (n, 3), met : (n,), distance : (n,). Result; the distance of a ray that met nothing is its limit.
    """
    pad = new_pad()
    for start in range(0, len(origin), slot.BLOCK):
        m = min(slot.BLOCK, len(origin) - start)
        o, d = origin[start : start + m], direction[start : start + m]
        for i in range(m):
            for c in range(3):
                pad.ray[c, i], pad.ray[c + 3, i] = o[i, c], d[i, c]
            pad.best[i] = limit[start + i]
        look_block(tables, m, pad)
        for i in range(m):
            for c in range(3):
                light[start + i, c] = pad.colour[c, i]
            met[start + i], distance[start + i] = pad.which[i] >= 0, pad.best[i]


@exact
def look_block(tables: Tables, m: int, pad: Pad) -> None:
    """Light of the pad's m rays."""
    world, cluster, prim = tables.world, tables.cluster, tables.prim
    _behind(world, m, pad.ray, pad.which, pad.colour)
    for c in range(len(cluster)):
        k = int(cluster[c, slot.FIRST])
        if prim[k, slot.KIND] == slot.FLOOR and cluster[c, slot.PAST] == k + 1:
            _floor(world, prim, k, m, pad.ray, pad.best, pad.which, pad.colour)
            continue
        bound(cluster, c, m, pad.ray, pad.near)
        count = _gather(m, pad)
        if count:
            _object(tables, c, count, pad)
    _zenith(world, m, pad.ray, pad.which, pad.colour)


@exact
def _behind(world: Floats, m: int, ray: Floats, which: Any, colour: Floats) -> None:
    """Horizon and ground for every ray of the block."""
    v, red, green, blue = ray[4, :m], colour[0, :m], colour[1, :m], colour[2, :m]
    for i in range(m):
        which[i] = -1
    for i in range(m):
        down = v[i] < 0.0
        red[i] = world[slot.GROUND] if down else world[slot.HORIZON]
        green[i] = world[slot.GROUND + 1] if down else world[slot.HORIZON + 1]
        blue[i] = world[slot.GROUND + 2] if down else world[slot.HORIZON + 2]


@exact
def _zenith(world: Floats, m: int, ray: Floats, which: Any, colour: Floats) -> None:
    """Sky that changes with elevation, for rays that met nothing: an angle each, so it comes last."""
    if one_sky(world):
        return
    for i in range(m):
        if which[i] < 0 and ray[4, i] >= 0.0:
            colour[0, i], colour[1, i], colour[2, i] = background(world, ray[3, i], ray[4, i], ray[5, i])


@exact
def _floor(
    world: Floats, prim: Floats, k: int, m: int, ray: Floats, best: Floats, which: Any, colour: Floats
) -> None:
    """A chequered floor, without a branch in the ray loop."""
    x, y, z, u, v, w = ray[0, :m], ray[1, :m], ray[2, :m], ray[3, :m], ray[4, :m], ray[5, :m]
    red, green, blue, left, index = colour[0, :m], colour[1, :m], colour[2, :m], best[:m], which[:m]
    height, side, reach = prim[k, slot.ORIGIN + 1], prim[k, slot.PATTERN], prim[k, slot.SIZE]
    towards = 0
    for i in range(m):
        towards += 1 if (height - y[i]) * v[i] > 0.0 else 0
    if towards == 0:  # a block of sky, as half of most views is
        return
    up = world[slot.TOWARDS_LIGHT + 1]
    above, below = (
        world[slot.AMBIENT] + world[slot.KEY] * max(0.0, up),
        world[slot.AMBIENT] + world[slot.KEY] * max(0.0, -up),
    )
    per_side, square = 1.0 / side, reach * reach
    odd0, odd1, odd2 = prim[k, slot.COLOUR], prim[k, slot.COLOUR + 1], prim[k, slot.COLOUR + 2]
    even0, even1, even2 = prim[k, slot.COLOUR + 3], prim[k, slot.COLOUR + 4], prim[k, slot.COLOUR + 5]
    for i in range(m):
        s = (height - y[i]) / v[i]
        far = s * s * (u[i] * u[i] + v[i] * v[i] + w[i] * w[i])
        hit = (s > 0.0) & (s < left[i]) & (far <= square)
        tile = np.floor((x[i] + s * u[i]) * per_side) + np.floor((z[i] + s * w[i]) * per_side)
        odd = tile - 2.0 * np.floor(0.5 * tile) == 1.0
        lit = above if v[i] < 0.0 else below
        red[i] = (odd0 if odd else even0) * lit if hit else red[i]
        green[i] = (odd1 if odd else even1) * lit if hit else green[i]
        blue[i] = (odd2 if odd else even2) * lit if hit else blue[i]
        left[i] = s if hit else left[i]
        index[i] = k if hit else index[i]


@exact
def bound(cluster: Floats, c: int, m: int, ray: Floats, near: Floats) -> None:
    """Write a negative number where a ray certainly misses the box round object c.

    In the middle plane of the box, a ray through it lies within the box's extent plus its lateral travel over
    half the box's depth. One division suffices, because objects are seen along z.
    """
    x, y, z, u, v, w = ray[0, :m], ray[1, :m], ray[2, :m], ray[3, :m], ray[4, :m], ray[5, :m]
    out = near[:m]
    mx, my, mz, hx, hy, hz = (
        cluster[c, slot.CENTRE],
        cluster[c, slot.CENTRE + 1],
        cluster[c, slot.CENTRE + 2],
        cluster[c, slot.EXTENT],
        cluster[c, slot.EXTENT + 1],
        cluster[c, slot.EXTENT + 2],
    )
    for i in range(m):
        inverse = 1.0 / w[i]
        s, along, aside = (mz - z[i]) * inverse, u[i] * inverse, v[i] * inverse
        off_x = abs(x[i] + s * u[i] - mx) - (hx + abs(along) * hz)
        off_y = abs(y[i] + s * v[i] - my) - (hy + abs(aside) * hz)
        out[i] = -1.0 if (off_x > 0.0) | (off_y > 0.0) else 1.0


@exact
def _gather(m: int, pad: Pad) -> int:
    """Put the rays with `near` ≥ 0 into the pad's part; return their number."""
    count, near, chosen = 0, pad.near, pad.some[0]
    for i in range(m):
        count += 1 if near[i] >= 0.0 else 0
    if count == 0:
        return 0
    count = 0
    for i in range(m):
        chosen[count] = i
        count += 1 if near[i] >= 0.0 else 0
    for c in range(6):
        column, out = pad.ray[c], pad.part[c]
        for q in range(count):
            out[q] = column[chosen[q]]
    best, out = pad.best, pad.part[12]
    for q in range(count):
        out[q] = best[chosen[q]]
        pad.some[1, q] = -1
    return count


@exact
def _object(tables: Tables, c: int, count: int, pad: Pad) -> None:
    """Test the gathered rays against an object's primitives and paint those that meet one."""
    cluster, prim, store = tables.cluster, tables.prim, tables.store
    part, which, facet = pad.part, pad.some[1], pad.some[2]
    local, least, s = part[6:12], part[12], part[13]
    x0, x1, y0, y1 = _window(cluster, c, count, part)
    for k in range(int(cluster[c, slot.FIRST]), int(cluster[c, slot.PAST])):
        if (
            prim[k, slot.BOUND] > x1
            or prim[k, slot.BOUND + 3] < x0
            or prim[k, slot.BOUND + 1] > y1
            or prim[k, slot.BOUND + 4] < y0
        ):
            continue
        to_frame(prim, k, count, part, local)
        if prim[k, slot.KIND] == slot.MESH:
            for q in range(count):
                ray = Ray(local[0, q], local[1, q], local[2, q], local[3, q], local[4, q], local[5, q])
                t, f = nearest(tables.trees, int(prim[k, slot.PIECE]), ray, least[q], pad.some[3])
                if f >= 0:
                    least[q], which[q], facet[q] = t, k, f
            continue
        if prim[k, slot.KIND] == slot.FLOOR:
            _level(count, local, prim[k, slot.SIZE], s)
        else:
            distances(prim, store, k, count, local, s, part[14:])
        for q in range(count):
            closer = (s[q] > 0.0) & (s[q] < least[q])
            least[q] = s[q] if closer else least[q]
            which[q] = k if closer else which[q]
    _paint(tables, count, pad)


@inlined
def _paint(tables: Tables, count: int, pad: Pad) -> None:
    """Write distance, primitive and light of those gathered rays that met something."""
    world, prim, part, which, least = tables.world, tables.prim, pad.part, pad.some[1], pad.part[12]
    best, met, red, green, blue = pad.best, pad.which, pad.colour[0], pad.colour[1], pad.colour[2]
    luminous, own = world[slot.KEY] == 0.0, world[slot.AMBIENT]
    for q in range(count):
        k = which[q]
        if k < 0:
            continue
        i = pad.some[0, q]
        best[i], met[i] = least[q], k
        if luminous and prim[k, slot.PAINT] == slot.LIT:  # the same light everywhere: no call
            red[i], green[i], blue[i] = (
                prim[k, slot.COLOUR] * own,
                prim[k, slot.COLOUR + 1] * own,
                prim[k, slot.COLOUR + 2] * own,
            )
        else:
            ray = Ray(part[0, q], part[1, q], part[2, q], part[3, q], part[4, q], part[5, q])
            red[i], green[i], blue[i] = painted(tables, k, pad.some[2, q], ray, least[q])


@exact
def _window(cluster: Floats, c: int, count: int, part: Floats) -> tuple[float, float, float, float]:
    """Range of x and y of the gathered rays between an object's lowest and highest z."""
    x, y, z, u, v, w = part[0], part[1], part[2], part[3], part[4], part[5]
    level, half = cluster[c, slot.CENTRE + 2], cluster[c, slot.EXTENT + 2]
    x0, x1, y0, y1, steep = np.inf, -np.inf, np.inf, -np.inf, np.inf
    for q in range(count):
        inverse = 1.0 / w[q]
        s = (level - z[q]) * inverse
        px, py = x[q] + s * u[q], y[q] + s * v[q]
        lean, rise = abs(u[q] * inverse) * half, abs(v[q] * inverse) * half
        x0, x1 = min(x0, px - lean), max(x1, px + lean)
        y0, y1 = min(y0, py - rise), max(y1, py + rise)
        steep = min(steep, abs(w[q]))
    if not steep > 0.0 or half == np.inf:
        return -np.inf, np.inf, -np.inf, np.inf
    return x0, x1, y0, y1


@exact
def _level(m: int, local: Floats, reach: float, out: Floats) -> None:
    """Distance to a floor that is part of a group."""
    for q in range(m):
        s = -local[1, q] / local[4, q]
        u, v, w = local[3, q], local[4, q], local[5, q]
        out[q] = s if s * math.sqrt(u * u + v * v + w * w) <= reach else np.nan
