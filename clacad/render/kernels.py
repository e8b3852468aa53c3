"""What rays meet in the scene and the light they find there, compiled: the twin of `clacad.render.meet`.

Imported inside functions only. The same formulas in the same order, one ray at a time, so both paths agree
to the last bits; distances are in lengths of the given direction.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clacad.render.stage import Stage
from clacad.trace.compiled import exact, owning

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


BLOCK = 256
"""Rays of a block: its columns stay in the first-level cache."""


@owning
def look_all(
    world: Floats, cluster: Floats, prim: Floats, store: Floats, origin: Floats, direction: Floats,
    limit: Floats, light: Floats, met: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Write the light each ray finds and whether it met an object; see `meet.look`."""
    ray = np.empty((6, BLOCK))
    best, colour, which, near = (
        np.empty(BLOCK),
        np.empty((3, BLOCK)),
        np.empty(BLOCK, np.int64),
        np.empty(BLOCK),
    )
    for start in range(0, len(origin), BLOCK):
        m = min(BLOCK, len(origin) - start)
        o, d = origin[start : start + m], direction[start : start + m]
        for i in range(m):
            ray[0, i], ray[1, i], ray[2, i] = o[i, 0], o[i, 1], o[i, 2]
            ray[3, i], ray[4, i], ray[5, i] = d[i, 0], d[i, 1], d[i, 2]
            best[i] = limit[start + i]
        look_block(world, cluster, prim, store, m, ray, best, which, near, colour)
        out, hit = light[start : start + m], met[start : start + m]
        for i in range(m):
            out[i, 0], out[i, 1], out[i, 2] = colour[0, i], colour[1, i], colour[2, i]
            hit[i] = which[i] >= 0


@owning
def law_all(
    world: Floats, cluster: Floats, prim: Floats, store: Floats, matrix: Floats, axis: Floats, edges: Floats,
    scale: float, before: bool, opaque: bool, origin: Floats, direction: Floats, light: Floats,
) -> None:  # fmt: skip
    """Light of camera rays past and through a homogeneous sheet in z = 0.

    Parameters
    ----------
    matrix, axis : (3, 3), (3,)
        Directions behind the sheet are matrix · d, where d · axis > 0 and they go on forwards; else black.
    edges : (4,) x_min, x_max, y_min, y_max of the sheet, window lengths; `scale` of them in a scene length
    before, opaque : bool
        Whether anything may stand before the sheet; whether nothing is seen beside it.
    """
    ray = np.empty((6, BLOCK))
    best, colour, which, near = (
        np.empty(BLOCK),
        np.empty((3, BLOCK)),
        np.empty(BLOCK, np.int64),
        np.empty(BLOCK),
    )
    state, front = np.empty(BLOCK, np.int64), np.empty((3, BLOCK))
    x0, x1, y0, y1 = edges[0] / scale, edges[1] / scale, edges[2] / scale, edges[3] / scale
    for start in range(0, len(origin), BLOCK):
        m = min(BLOCK, len(origin) - start)
        o, d = origin[start : start + m], direction[start : start + m]
        if before or opaque:
            for i in range(m):
                ray[0, i], ray[1, i], ray[2, i] = o[i, 0], o[i, 1], o[i, 2]
                ray[3, i], ray[4, i], ray[5, i] = d[i, 0], d[i, 1], d[i, 2]
                best[i] = -o[i, 2] / d[i, 2] if d[i, 2] > 0.0 else np.inf
            look_block(world, cluster, prim, store, m, ray, best, which, near, front)
        for i in range(m):
            u, v, w = d[i, 0], d[i, 1], d[i, 2]
            s = -o[i, 2] / w
            x, y = o[i, 0] + s * u, o[i, 1] + s * v
            on = (w > 0.0) & (s >= 0.0) & (x >= x0) & (x < x1) & (y >= y0) & (y < y1)
            eu = matrix[0, 0] * u + matrix[0, 1] * v + matrix[0, 2] * w
            ev = matrix[1, 0] * u + matrix[1, 1] * v + matrix[1, 2] * w
            ew = matrix[2, 0] * u + matrix[2, 1] * v + matrix[2, 2] * w
            goes = (axis[0] * u + axis[1] * v + axis[2] * w > 0.0) & (ew > 0.0)
            ray[0, i], ray[1, i], ray[2, i] = (
                (x if on else o[i, 0]),
                (y if on else o[i, 1]),
                (0.0 if on else o[i, 2]),
            )
            ray[3, i], ray[4, i], ray[5, i] = (eu if on else u), (ev if on else v), (ew if on else w)
            state[i] = (2 if goes else 1) if on else 0
            if before or opaque:
                state[i] = 3 if which[i] >= 0 and (on or opaque) else state[i]
            best[i] = np.inf
        look_block(world, cluster, prim, store, m, ray, best, which, near, colour)
        out = light[start : start + m]
        for i in range(m):
            shown = 1.0 if state[i] == 2 or (state[i] == 0 and not opaque) else 0.0
            out[i, 0], out[i, 1], out[i, 2] = shown * colour[0, i], shown * colour[1, i], shown * colour[2, i]
        if before or opaque:
            for i in range(m):
                if state[i] == 3:
                    out[i, 0], out[i, 1], out[i, 2] = front[0, i], front[1, i], front[2, i]


@exact
def camera_all(
    position: Floats, ahead: Floats, right: Floats, down: Floats, width: int, height: int, pixels: Any,
    points: Floats, origin: Floats, direction: Floats,
) -> None:  # fmt: skip
    """Starts and directions of a pinhole's rays; see `camera.rays`."""
    n, count = points.shape[0], points.shape[1]
    for i in range(n):
        column, row = float(pixels[i] % width), float(pixels[i] // width)
        for j in range(count):
            u = (column + points[i, j, 0]) / width - 0.5
            v = (row + points[i, j, 1]) / height - 0.5
            k = i * count + j
            origin[k, 0], origin[k, 1], origin[k, 2] = position[0], position[1], position[2]
            direction[k, 0] = ahead[0] + u * right[0] + v * down[0]
            direction[k, 1] = ahead[1] + u * right[1] + v * down[1]
            direction[k, 2] = ahead[2] + u * right[2] + v * down[2]


@exact
def add_all(light: Floats, rows: Any, step: int, total: Floats, square: Floats) -> None:
    """Add the light of `step` samples a pixel, and its square, to the sums of the pixels `rows`."""
    for i in range(len(rows)):
        row = rows[i]
        for j in range(step):
            for k in range(3):
                value = light[i * step + j, k]
                total[row, k] += value
                square[row, k] += value * value


@exact
def crossing_all(box: Floats, origin: Floats, direction: Floats, inside: NDArray[np.bool_]) -> None:
    """Tell which rays come through a box (2, 3); see `view.may_cross`."""
    for i in range(len(origin)):
        near, far = -np.inf, np.inf
        for k in range(3):
            a = (box[0, k] - origin[i, k]) / direction[i, k]
            b = (box[1, k] - origin[i, k]) / direction[i, k]
            if a == a and b == b:
                near, far = max(near, min(a, b)), min(far, max(a, b))
        inside[i] = near <= far * (1.0 + 1e-12) and far > 0.0


@exact
def look_block(
    world: Floats, cluster: Floats, prim: Floats, store: Floats, m: int, ray: Floats, best: Floats, which: Any,
    near: Floats, colour: Floats,
) -> None:  # fmt: skip
    """Light of m rays in columns: floors and bounds in passes over the block, the rest ray by ray."""
    behind(world, m, ray, which, colour)
    for c in range(len(cluster)):
        k = int(cluster[c, 0])
        if cluster[c, 5] == np.inf and prim[k, KIND] == FLOOR:
            floor_pass(world, prim, k, m, ray, best, which, colour)
            continue
        bound_pass(cluster[c, 2], cluster[c, 3], cluster[c, 4], cluster[c, 5], m, ray, near)
        for i in range(m):
            if near[i] >= 0.0:
                x, y, z, u, v, w = ray[0, i], ray[1, i], ray[2, i], ray[3, i], ray[4, i], ray[5, i]
                s, k, f = nearest_of(cluster, c, prim, store, x, y, z, u, v, w, best[i])
                if k >= 0:
                    best[i], which[i] = s, k
                    r, g, b = painted(world, prim, store, k, f, x, y, z, u, v, w, s)
                    colour[0, i], colour[1, i], colour[2, i] = r, g, b


@exact
def behind(world: Floats, m: int, ray: Floats, which: Any, colour: Floats) -> None:
    """Sky and ground for every ray of the block."""
    v, red, green, blue = ray[4, :m], colour[0, :m], colour[1, :m], colour[2, :m]
    plain = world[5] == world[8] and world[6] == world[9] and world[7] == world[10]
    for i in range(m):
        which[i] = -1
        down = v[i] < 0.0
        red[i] = world[11] if down else world[8]
        green[i] = world[12] if down else world[9]
        blue[i] = world[13] if down else world[10]
    if not plain:
        for i in range(m):
            if v[i] >= 0.0:
                r, g, b = background(world, ray[3, i], v[i], ray[5, i])
                red[i], green[i], blue[i] = r, g, b


@exact
def floor_pass(
    world: Floats, prim: Floats, k: int, m: int, ray: Floats, best: Floats, which: Any, colour: Floats
) -> None:
    """A chequered floor, without a branch in the ray loop."""
    x, y, z, u, v, w = ray[0, :m], ray[1, :m], ray[2, :m], ray[3, :m], ray[4, :m], ray[5, :m]
    red, green, blue, left, index = colour[0, :m], colour[1, :m], colour[2, :m], best[:m], which[:m]
    height, side, reach = prim[k, ORIGIN + 1], prim[k, PATTERN], prim[k, SIZE]
    above, below = world[0] + world[1] * max(0.0, world[3]), world[0] + world[1] * max(0.0, -world[3])
    odd0, odd1, odd2 = prim[k, COLOUR], prim[k, COLOUR + 1], prim[k, COLOUR + 2]
    even0, even1, even2 = prim[k, COLOUR + 3], prim[k, COLOUR + 4], prim[k, COLOUR + 5]
    for i in range(m):
        s = (height - y[i]) / v[i]
        far = s * math.sqrt(u[i] * u[i] + v[i] * v[i] + w[i] * w[i])
        hit = (s > 0.0) & (s < left[i]) & (far <= reach)
        tile = np.floor((x[i] + s * u[i]) / side) + np.floor((z[i] + s * w[i]) / side)
        odd = tile - 2.0 * np.floor(0.5 * tile) == 1.0
        lit = above if v[i] < 0.0 else below
        red[i] = (odd0 if odd else even0) * lit if hit else red[i]
        green[i] = (odd1 if odd else even1) * lit if hit else green[i]
        blue[i] = (odd2 if odd else even2) * lit if hit else blue[i]
        left[i] = s if hit else left[i]
        index[i] = k if hit else index[i]


@exact
def bound_pass(bx: float, by: float, bz: float, radius: float, m: int, ray: Floats, near: Floats) -> None:
    """Write a number that is negative where a ray does not come into a sphere; see `may_meet`."""
    x, y, z, u, v, w = ray[0, :m], ray[1, :m], ray[2, :m], ray[3, :m], ray[4, :m], ray[5, :m]
    out = near[:m]
    for i in range(m):
        px, py, pz = bx - x[i], by - y[i], bz - z[i]
        along, length2 = px * u[i] + py * v[i] + pz * w[i], u[i] * u[i] + v[i] * v[i] + w[i] * w[i]
        off2 = (px * px + py * py + pz * pz) * length2 - along * along
        inside = radius * radius * length2 + 1e-12 * along * along - off2
        before = along + radius * math.sqrt(length2)
        out[i] = inside if before >= 0.0 else -1.0


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
        if may_meet(cluster[c, 2], cluster[c, 3], cluster[c, 4], cluster[c, 5], x, y, z, u, v, w):
            s, k, f = nearest_of(cluster, c, prim, store, x, y, z, u, v, w, distance)
            if k >= 0:
                distance, which, facet = s, k, f
    return distance, which, facet


@exact
def nearest_of(
    cluster: Floats, c: int, prim: Floats, store: Floats, x: float, y: float, z: float, u: float, v: float,
    w: float, limit: float,
) -> tuple[float, int, int]:  # fmt: skip
    """Distance, primitive and triangle of the first hit among one object's primitives; −1 where there is none."""
    distance, which, facet = limit, -1, -1
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


@owning
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
