"""What rays meet in the scene and the light they find there, compiled: the twin of `clacad.render.meet`.

Imported inside functions only. The same formulas in the same order, one ray at a time, so both paths agree
to the last bits; distances are in lengths of the given direction.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clacad.render.stage import Stage
from clacad.trace.compiled import exact

Floats = NDArray[np.float64]

FLOOR, SPHERE, BOX, CONE, PRISM, SCREEN, MESH = range(7)
CHECKER, COORDINATES, STRIPES, IMAGE = 1, 2, 3, 4
# columns of `Tables.prim`
KIND, PAINT, PATTERN, PIECE, END, ROWS, COLUMNS, SIZE, BOUND, ORIGIN, TURN, COLOUR = (
    0, 1, 2, 3, 4, 5, 6, 7, 11, 15, 18, 27,
)  # fmt: skip
PRIM_WIDTH = 33
NODE, FACET = 8, 9
"""Numbers of a tree node (low, high, first, count) and of a triangle in `Tables.store`."""
DEPTH = 64
"""Nodes waiting in a tree at most: median splits make it no deeper than the number's bits."""


class Tables(NamedTuple):
    """A `Stage` in four plain arrays: compiled code passes few arrays quickly and many slowly.

    Attributes
    ----------
    world : (14,)
        Ambient, key, direction to the light (3), zenith (3), horizon (3), ground (3).
    cluster : (m, 6)
        First and end primitive, centre and radius of a sphere round them.
    prim : (n, 33)
        A primitive a row, columns as named above.
    store : (k,)
        Corners of prisms, pixels, nodes and triangles; places in it are absolute.
    """

    world: Floats
    cluster: Floats
    prim: Floats
    store: Floats


def tables(stage: Stage) -> Tables:
    """Lay a stage out for compiled code."""
    forest, n = stage.forest, len(stage.kind)
    sizes = [stage.outline.size, stage.pixels.size, NODE * len(forest.first), forest.corners.size]
    corner0, pixel0, node0, facet0 = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    leaf = forest.count > 0
    child = np.where(leaf, facet0 + FACET * forest.first, node0 + NODE * forest.first)
    nodes = np.column_stack([forest.low, forest.high, child, forest.count])
    store = np.concatenate([part.ravel() for part in (stage.outline, stage.pixels, nodes, forest.corners)])
    piece = np.zeros((n, 2))
    for kind, start, width in ((PRISM, corner0, 2), (SCREEN, pixel0, 3)):
        rows = stage.kind == kind
        piece[rows] = start + width * stage.piece[rows]
    meshes = stage.kind == MESH
    piece[meshes] = (node0 + NODE * stage.root[meshes])[:, None]
    prim = np.column_stack(
        [stage.kind, stage.paint, stage.pattern, piece, stage.picture, stage.size, stage.bound, stage.origin,
         stage.rotation.reshape(-1, 9), stage.colours.reshape(-1, 6)]
    )  # fmt: skip
    world = np.concatenate([[stage.ambient, stage.key], stage.towards_light, stage.sky.ravel(), stage.ground])
    cluster = np.column_stack([stage.cluster, stage.cluster_bound])
    return Tables(world, np.ascontiguousarray(cluster, dtype=np.float64), prim.reshape(-1, PRIM_WIDTH), store)


@exact
def look_all(
    world: Floats, cluster: Floats, prim: Floats, store: Floats, origin: Floats, direction: Floats,
    limit: Floats, light: Floats, met: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Write the light each ray finds and whether it met an object; see `meet.look`."""
    for i in range(len(origin)):
        x, y, z = origin[i, 0], origin[i, 1], origin[i, 2]
        u, v, w = direction[i, 0], direction[i, 1], direction[i, 2]
        distance, which, facet = nearest(cluster, prim, store, x, y, z, u, v, w, limit[i])
        met[i] = which >= 0
        if which >= 0:
            r, g, b = painted(world, prim, store, which, facet, x, y, z, u, v, w, distance)
        else:
            r, g, b = background(world, u, v, w)
        light[i, 0], light[i, 1], light[i, 2] = r, g, b


@exact
def reach_all(
    world: Floats, cluster: Floats, prim: Floats, store: Floats, origin: Floats, direction: Floats,
    limit: Floats, distance: Floats,
) -> None:  # fmt: skip
    """Write the distance of the first hit of each ray, its limit where there is none."""
    for i in range(len(origin)):
        x, y, z = origin[i, 0], origin[i, 1], origin[i, 2]
        u, v, w = direction[i, 0], direction[i, 1], direction[i, 2]
        distance[i], _, _ = nearest(cluster, prim, store, x, y, z, u, v, w, limit[i])


@exact
def nearest(
    cluster: Floats, prim: Floats, store: Floats, x: float, y: float, z: float, u: float, v: float, w: float,
    limit: float,
) -> tuple[float, int, int]:  # fmt: skip
    """Distance, primitive and triangle of the first hit; −1 where there is none."""
    distance, which, facet = limit, -1, -1
    for c in range(len(cluster)):
        if not may_meet(cluster[c, 2], cluster[c, 3], cluster[c, 4], cluster[c, 5], x, y, z, u, v, w):
            continue
        for k in range(int(cluster[c, 0]), int(cluster[c, 1])):
            b = BOUND
            if not may_meet(prim[k, b], prim[k, b + 1], prim[k, b + 2], prim[k, b + 3], x, y, z, u, v, w):
                continue
            px, py, pz = x - prim[k, ORIGIN], y - prim[k, ORIGIN + 1], z - prim[k, ORIGIN + 2]
            lx = px * prim[k, TURN + 0] + py * prim[k, TURN + 3] + pz * prim[k, TURN + 6]
            ly = px * prim[k, TURN + 1] + py * prim[k, TURN + 4] + pz * prim[k, TURN + 7]
            lz = px * prim[k, TURN + 2] + py * prim[k, TURN + 5] + pz * prim[k, TURN + 8]
            ru = u * prim[k, TURN + 0] + v * prim[k, TURN + 3] + w * prim[k, TURN + 6]
            rv = u * prim[k, TURN + 1] + v * prim[k, TURN + 4] + w * prim[k, TURN + 7]
            rw = u * prim[k, TURN + 2] + v * prim[k, TURN + 5] + w * prim[k, TURN + 8]
            if prim[k, KIND] == MESH:
                s, f = in_tree(store, int(prim[k, PIECE]), lx, ly, lz, ru, rv, rw, distance)
                if f >= 0:
                    distance, which, facet = s, k, f
            else:
                s = to_primitive(prim, store, k, lx, ly, lz, ru, rv, rw)
                if s > 0.0 and s < distance:
                    distance, which = s, k
    return distance, which, facet


@exact
def may_meet(
    bx: float, by: float, bz: float, radius: float, x: float, y: float, z: float, u: float, v: float, w: float
) -> bool:
    """Whether a ray comes into a sphere at a distance above 0."""
    if radius == np.inf:
        return True
    px, py, pz = bx - x, by - y, bz - z
    along, length2 = px * u + py * v + pz * w, u * u + v * v + w * w
    off2 = (px * px + py * py + pz * pz) * length2 - along * along
    if off2 > radius * radius * length2 + 1e-12 * along * along:
        return False
    return along >= -radius * math.sqrt(length2)


@exact
def to_primitive(
    prim: Floats, store: Floats, k: int, x: float, y: float, z: float, u: float, v: float, w: float
) -> float:
    """Distance to a primitive in its own frame, NaN or ∞ where it is missed."""
    kind, a, b, c = prim[k, KIND], prim[k, SIZE], prim[k, SIZE + 1], prim[k, SIZE + 2]
    if kind == FLOOR:
        s = -y / v
        return s if s * math.sqrt(u * u + v * v + w * w) <= a else np.nan
    if kind == SPHERE:
        return to_sphere(x, y, z, u, v, w, a)
    if kind == BOX:
        return to_box(x, y, z, u, v, w, a, b, c)
    if kind == CONE:
        return to_cone(x, y, z, u, v, w, a, b, c)
    if kind == PRISM:
        return to_prism(store, int(prim[k, PIECE]), int(prim[k, END]), x, y, z, u, v, w, a)
    s = -z / w
    return s if abs(x + s * u) <= a and abs(y + s * v) <= b else np.nan


@exact
def to_sphere(x: float, y: float, z: float, u: float, v: float, w: float, radius: float) -> float:
    """Nearer hit above 0 of a sphere about the origin."""
    a = u * u + v * v + w * w
    middle = -(x * u + y * v + z * w) / a
    x, y, z = x + middle * u, y + middle * v, z + middle * w
    rest = (radius * radius - (x * x + y * y + z * z)) / a
    if not rest >= 0.0:
        return np.nan
    half = math.sqrt(rest)
    return middle - half if middle - half > 0.0 else middle + half


@exact
def to_box(
    x: float, y: float, z: float, u: float, v: float, w: float, hx: float, hy: float, hz: float
) -> float:
    """Nearer hit above 0 of a box about the origin."""
    near, far = -np.inf, np.inf
    for k in range(3):
        p = x if k == 0 else (y if k == 1 else z)
        d = u if k == 0 else (v if k == 1 else w)
        half = hx if k == 0 else (hy if k == 1 else hz)
        if d == 0.0:
            if abs(p) > half:
                return np.nan
            continue
        a, b = (-half - p) / d, (half - p) / d
        near, far = max(near, min(a, b)), min(far, max(a, b))
    if near > far:
        return np.nan
    return near if near > 0.0 else far


@exact
def to_cone(
    x: float, y: float, z: float, u: float, v: float, w: float, bottom: float, top: float, height: float
) -> float:
    """Nearest hit above 0 of a closed frustum with axis y."""
    slope = (top - bottom) / height
    middle = -(x * u + y * v + z * w) / (u * u + v * v + w * w)
    x, y, z = x + middle * u, y + middle * v, z + middle * w
    r = bottom + slope * y
    a, b = u * u + w * w - slope * slope * v * v, x * u + z * w - slope * v * r
    c = x * x + z * z - r * r
    best = np.inf
    square = b * b - a * c
    if square >= 0.0:
        q = -(b + math.copysign(math.sqrt(square), b))
        for k in range(2):
            s = q / a if k == 0 else c / q
            at = y + s * v
            inside = at >= 0.0 and at <= height and bottom + slope * at >= 0.0
            if s + middle > 0.0 and inside and s + middle < best:
                best = s + middle
    for k in range(2):
        level, radius = (0.0, bottom) if k == 0 else (height, top)
        s = (level - y) / v
        px, pz = x + s * u, z + s * w
        if s + middle > 0.0 and px * px + pz * pz <= radius * radius and s + middle < best:
            best = s + middle
    return best


@exact
def to_prism(
    store: Floats, first: int, end: int, x: float, y: float, z: float, u: float, v: float, w: float,
    half: float,
) -> float:  # fmt: skip
    """Nearest hit above 0 of an extruded outline between z = −half and half."""
    best = np.inf
    for k in range(2):
        s = ((half if k else -half) - z) / w
        if s > 0.0 and s < best and inside_outline(store, first, end, x + s * u, y + s * v):
            best = s
    for i in range(first, end, 2):
        j = i + 2 if i + 2 < end else first
        x0, y0, x1, y1 = store[i], store[i + 1], store[j], store[j + 1]
        nx, ny = y1 - y0, x0 - x1
        s = (nx * (x0 - x) + ny * (y0 - y)) / (nx * u + ny * v)
        if s > 0.0 and s < best and abs(z + s * w) <= half:
            along = (x + s * u - x0) * (x1 - x0) + (y + s * v - y0) * (y1 - y0)
            if along >= 0.0 and along <= nx * nx + ny * ny:
                best = s
    return best


@exact
def inside_outline(store: Floats, first: int, end: int, x: float, y: float) -> bool:
    """Whether a point lies inside a polygon."""
    inside = False
    for i in range(first, end, 2):
        j = i + 2 if i + 2 < end else first
        y0, y1 = store[i + 1], store[j + 1]
        if (y0 > y) != (y1 > y):
            x0, x1 = store[i], store[j]
            if x < (x1 - x0) * (y - y0) / (y1 - y0) + x0:
                inside = not inside
    return inside


@exact
def in_tree(
    store: Floats, root: int, x: float, y: float, z: float, u: float, v: float, w: float, limit: float
) -> tuple[float, int]:
    """Distance and number of the first triangle below `limit`; −1 where there is none."""
    waiting = np.empty(DEPTH, dtype=np.int64)
    waiting[0] = root
    height, distance, facet = 1, limit, -1
    iu, iv, iw = 1.0 / u, 1.0 / v, 1.0 / w
    while height > 0:
        height -= 1
        node = waiting[height]
        if not meets_box(store, node, x, y, z, iu, iv, iw, distance):
            continue
        child, count = int(store[node + 6]), int(store[node + 7])
        if count == 0:
            waiting[height] = child + NODE
            waiting[height + 1] = child
            height += 2
            continue
        for k in range(child, child + FACET * count, FACET):
            s = to_triangle(store, k, x, y, z, u, v, w)
            if s > 0.0 and s < distance:
                distance, facet = s, k
    return distance, facet


@exact
def meets_box(
    store: Floats, node: int, x: float, y: float, z: float, iu: float, iv: float, iw: float, limit: float
) -> bool:
    """Whether a ray meets a box before `limit`; 0 times ∞ on a side's plane counts as inside."""
    near, far = -np.inf, np.inf
    for k in range(3):
        p = x if k == 0 else (y if k == 1 else z)
        d = iu if k == 0 else (iv if k == 1 else iw)
        a, b = (store[node + k] - p) * d, (store[node + 3 + k] - p) * d
        if a == a and b == b:
            near, far = max(near, min(a, b)), min(far, max(a, b))
    return near <= far * (1.0 + 1e-14) and far >= 0.0 and near <= limit


@exact
def to_triangle(store: Floats, k: int, x: float, y: float, z: float, u: float, v: float, w: float) -> float:
    """Distance to the plane of a triangle where it is hit, else NaN."""
    cx, cy, cz = store[k], store[k + 1], store[k + 2]
    ax, ay, az = store[k + 3] - cx, store[k + 4] - cy, store[k + 5] - cz
    bx, by, bz = store[k + 6] - cx, store[k + 7] - cy, store[k + 8] - cz
    px, py, pz = v * bz - w * by, w * bx - u * bz, u * by - v * bx
    det = px * ax + py * ay + pz * az
    sx, sy, sz = x - cx, y - cy, z - cz
    f = (sx * px + sy * py + sz * pz) / det
    qx, qy, qz = sy * az - sz * ay, sz * ax - sx * az, sx * ay - sy * ax
    g = (u * qx + v * qy + w * qz) / det
    if f >= 0.0 and g >= 0.0 and f + g <= 1.0:
        return float((qx * bx + qy * by + qz * bz) / det)
    return np.nan


# -- light -------------------------------------------------------------------------------------


@exact
def background(world: Floats, u: float, v: float, w: float) -> tuple[float, float, float]:
    """Light of the sky, or of the ground below the horizon."""
    if v < 0.0:
        return world[11], world[12], world[13]
    share = 0.0
    if world[5] != world[8] or world[6] != world[9] or world[7] != world[10]:
        share = min(1.0, max(0.0, math.atan2(v, math.hypot(u, w)) / (0.5 * math.pi)))
    return (
        world[8] + (world[5] - world[8]) * share,
        world[9] + (world[6] - world[9]) * share,
        world[10] + (world[7] - world[10]) * share,
    )


@exact
def painted(
    world: Floats, prim: Floats, store: Floats, k: int, facet: int, x: float, y: float, z: float, u: float,
    v: float, w: float, distance: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Light of primitive k where a ray meets it."""
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
    light = world[0]
    if world[1] != 0.0:
        nx, ny, nz = normal(prim, store, k, facet, lx, ly, lz)
        sx = nx * prim[k, TURN + 0] + ny * prim[k, TURN + 1] + nz * prim[k, TURN + 2]
        sy = nx * prim[k, TURN + 3] + ny * prim[k, TURN + 4] + nz * prim[k, TURN + 5]
        sz = nx * prim[k, TURN + 6] + ny * prim[k, TURN + 7] + nz * prim[k, TURN + 8]
        facing = sx * world[2] + sy * world[3] + sz * world[4]
        if sx * u + sy * v + sz * w > 0.0:
            facing = -facing
        light = world[0] + world[1] * max(0.0, facing)
    return prim[k, c] * light, prim[k, c + 1] * light, prim[k, c + 2] * light


@exact
def normal(
    prim: Floats, store: Floats, k: int, facet: int, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Unit normal in the primitive's frame, of either sign."""
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
        nx, ny, nz = prism_normal(store, int(prim[k, PIECE]), int(prim[k, END]), a, x, y, z)
    elif kind == MESH:
        cx, cy, cz = store[facet], store[facet + 1], store[facet + 2]
        ax, ay, az = store[facet + 3] - cx, store[facet + 4] - cy, store[facet + 5] - cz
        bx, by, bz = store[facet + 6] - cx, store[facet + 7] - cy, store[facet + 8] - cz
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
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
