"""Compiled search of triangles from any source: the first one a ray meets, in a tree of boxes.

The search knows nothing of sheets; the judge of a file's facets and pictures of scenes call it too. In the
walk of a sheet's light it gives where a ray enters or leaves a body of triangles.
"""

from __future__ import annotations

from math import inf, isnan, nan

import numpy as np

from clacad.base.compiled import exact, inlined, least, owning
from clacad.base.types import Floats, Ints
from clacad.optics.ledger import ABOVE, ASIDE, BACK, BACK_LAND, FRONT, FRONT_LAND, WALL
from clacad.sheet.window import WALL as WALL_SLOPE
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.cells import sheet_xy, to_array
from clacad.tracing.compiled.column import box_span
from clacad.tracing.compiled.face import height
from clacad.tracing.compiled.packing import Packed
from clacad.tracing.compiled.records import (
    DEPTH,
    DISTANCE,
    FACET_NORMAL,
    KIND,
    MOST_ARRAYS,
    PLACE,
    CellRay,
    Ray,
    Vector,
)
from clacad.tracing.facets.hierarchy import COUNT, FIRST, LEVELS, ROOT, Hierarchy

INWARDS, OUTWARDS, BOTH = 1, 2, 3
"""Results of `ways_through`: the direction in which triangles are passed."""

BEFORE = -1e-300
"""A facet at the very start of a ray counts."""

ROUNDED = 1e-12
"""Share of distances to the sides of boxes that rounding may change."""

UPRIGHT = 1e-300
"""Slope used in place of 0, whose reciprocal times a distance of 0 from a box's side would be NaN."""


@exact
def _most(a: float, b: float) -> float:
    """Return the greater of two numbers, a where b is NaN: one machine instruction."""
    return b if b > a else a


@inlined
def _entered(box: Floats, k: int, ray: Ray, inverse: Vector, near: float, far: float) -> float:
    """Distance at which a ray enters box k, inf where it is not in it between two distances.

    `inverse` is of the ray's direction.
    """
    a, b = (box[k, 0] - ray.x) * inverse[0], (box[k, 3] - ray.x) * inverse[0]
    c, d = (box[k, 1] - ray.y) * inverse[1], (box[k, 4] - ray.y) * inverse[1]
    e, f = (box[k, 2] - ray.z) * inverse[2], (box[k, 5] - ray.z) * inverse[2]
    begin = _most(least(a, b), _most(least(c, d), least(e, f)))
    end = least(_most(a, b), least(_most(c, d), _most(e, f)))
    end += ROUNDED * abs(end)
    return begin if (begin <= end) & (begin <= far) & (end >= near) else inf


@exact
def inverse_of(ray: Ray) -> Vector:
    """Reciprocals of a direction, finite for the components 0."""
    u, v, w = ray.L, ray.M, ray.N
    u, v, w = u if u != 0.0 else UPRIGHT, v if v != 0.0 else UPRIGHT, w if w != 0.0 else UPRIGHT
    return 1.0 / u, 1.0 / v, 1.0 / w


@exact
def hit(corner: Floats, origin: Vector, ray: Ray) -> tuple[float, float, float, float]:
    """Distance to a triangle and barycentric coordinates; inf where it is missed.

    Corners are taken relative to the cell and then to the ray, sheared so that the ray runs along z. Edges
    that two triangles share get the same number with opposite signs, so no ray slips between them. After
    Woop, Benthin and Wald, Watertight Ray/Triangle Intersection, JCGT 2 (2013); N > 0 is the largest axis
    here.
    """
    ox, oy, oz = origin
    x, y, z, L, M, N = ray
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


@exact
def next_leaf(
    trees: Hierarchy, b: int, ray: Ray, inverse: Vector, near: float, far: float, stack: Ints, waiting: int
) -> tuple[int, int, int]:
    """Range of triangles (first, end) of the next leaf that a ray enters between two distances; 0, 0 at the
    end.

    Of two boxes the one whose middle lies nearer along the ray comes first.

    ray : in the frame of the boxes; `inverse` is of its direction
    waiting : boxes on the stack; the number that remain is returned last
    """
    root, first, count = trees.tree[b, ROOT], trees.tree[b, FIRST], trees.tree[b, COUNT]
    levels = trees.tree[b, LEVELS]
    inner = (1 << levels) - 1
    far += ROUNDED * abs(far)
    while waiting > 0:
        waiting -= 1
        node = stack[waiting]
        if not _entered(trees.box, root + node, ray, inverse, near, far) < inf:
            continue
        while node < inner:
            node = 2 * node + 1
            left = _entered(trees.box, root + node, ray, inverse, near, far)
            right = _entered(trees.box, root + node + 1, ray, inverse, near, far)
            # branches, not selected numbers: the next boxes are loaded before these are computed
            if left < inf:
                if right < inf:
                    if left <= right:
                        stack[waiting] = node + 1
                    else:
                        stack[waiting] = node
                        node += 1
                    waiting += 1
            elif right < inf:
                node += 1
            else:
                break
        else:
            leaf = node - inner
            return first + ((leaf * count) >> levels), first + (((leaf + 1) * count) >> levels), waiting
    return 0, 0, 0


@exact
def search(
    trees: Hierarchy, b: int, origin: Vector, ray: Ray, near: float, most: float, stack: Ints
) -> tuple[float, int]:
    """Nearest triangle of body b at a distance between `near` and `most`: distance and number, inf and −1.

    The ray is relative to `origin`, the centre of its cell; `stack` (DEPTH,) is scratch. Of triangles at one
    distance the lowest is returned.
    """
    inverse = inverse_of(ray)
    own = Ray(origin[0] + ray.x, origin[1] + ray.y, origin[2] + ray.z, ray.L, ray.M, ray.N)
    best, which = most, -1
    stack[0] = 0
    begin, end, waiting = next_leaf(trees, b, own, inverse, near, best, stack, 1)
    while begin < end:
        for k in range(begin, end):
            t = hit(trees.corner[k], origin, ray)[0]
            if near < t and (t < best or (t == best and k < which)):
                best, which = t, k
        begin, end, waiting = next_leaf(trees, b, own, inverse, near, best, stack, waiting)
    return (best, which) if which >= 0 else (inf, -1)


@exact
def ways_through(
    trees: Hierarchy, b: int, origin: Vector, ray: Ray, near: float, most: float, stack: Ints
) -> int:
    """How the ray passes the triangles between two distances: INWARDS, OUTWARDS, BOTH, or 0 for none."""
    inverse = inverse_of(ray)
    own = Ray(origin[0] + ray.x, origin[1] + ray.y, origin[2] + ray.z, ray.L, ray.M, ray.N)
    found, stack[0] = 0, 0
    begin, end, waiting = next_leaf(trees, b, own, inverse, near, most, stack, 1)
    while begin < end:
        for k in range(begin, end):
            if near < hit(trees.corner[k], origin, ray)[0] < most:
                nx, ny, nz = normal_of(trees, k)
                found |= OUTWARDS if nx * ray.L + ny * ray.M + nz * ray.N > 0.0 else INWARDS
        begin, end, waiting = next_leaf(trees, b, own, inverse, near, most, stack, waiting)
    return found


@exact
def nearest(trees: Hierarchy, b: int, ray: Ray, most: float, stack: Ints) -> tuple[float, int]:
    """First triangle of mesh b that a ray of any direction meets, as `hierarchy.nearest_triangle`."""
    inverse = inverse_of(ray)
    best, which = most, -1
    stack[0] = 0
    begin, end, waiting = next_leaf(trees, b, ray, inverse, 0.0, best, stack, 1)
    while begin < end:
        for k in range(begin, end):
            t = _to_triangle(trees.corner[k], ray)
            if t > 0.0 and (t < best or (t == best and k < which)):
                best, which = t, k
        begin, end, waiting = next_leaf(trees, b, ray, inverse, 0.0, best, stack, waiting)
    return best, which


@exact
def _to_triangle(corner: Floats, ray: Ray) -> float:
    """Distance to the plane of a triangle where it is hit, else NaN."""
    x, y, z, u, v, w = ray
    cx, cy, cz = corner[0, 0], corner[0, 1], corner[0, 2]
    ax, ay, az = corner[1, 0] - cx, corner[1, 1] - cy, corner[1, 2] - cz
    bx, by, bz = corner[2, 0] - cx, corner[2, 1] - cy, corner[2, 2] - cz
    px, py, pz = v * bz - w * by, w * bx - u * bz, u * by - v * bx
    det = px * ax + py * ay + pz * az
    sx, sy, sz = x - cx, y - cy, z - cz
    f = (sx * px + sy * py + sz * pz) / det
    qx, qy, qz = sy * az - sz * ay, sz * ax - sx * az, sx * ay - sy * ax
    g = (u * qx + v * qy + w * qz) / det
    if f >= 0.0 and g >= 0.0 and f + g <= 1.0:
        return float((qx * bx + qy * by + qz * bz) / det)
    return nan


@exact
def normal_of(trees: Hierarchy, k: int) -> tuple[float, float, float]:
    """Outward normal of a triangle, of length twice its area."""
    c = trees.corner[k]
    ux, uy, uz = c[1, 0] - c[0, 0], c[1, 1] - c[0, 1], c[1, 2] - c[0, 2]
    vx, vy, vz = c[2, 0] - c[0, 0], c[2, 1] - c[0, 1], c[2, 2] - c[0, 2]
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@owning
def first_facet(
    trees: Hierarchy,
    normals: Floats,
    position: Floats,
    direction: Floats,
    facing: float,
    distance: Floats,
    facet: Ints,
) -> None:
    """Fill `distance` (n,) and `facet` (n,) for rays with d_z > 0; NaN and −1 where none is met.

    The nearest facet ahead, of body 0 of `trees`, with facing × normal · direction > 0.
    """
    origin, stack = (0.0, 0.0, 0.0), np.empty(DEPTH, dtype=np.int64)
    for r in range(len(position)):
        u, v, w = direction[r, 0], direction[r, 1], direction[r, 2]
        ray = Ray(position[r, 0], position[r, 1], position[r, 2], u, v, w)
        t, which = search(trees, 0, origin, ray, BEFORE, inf, stack)
        while which >= 0:
            n = normals[which]
            if facing * (n[0] * u + n[1] * v + n[2] * w) > 0.0:
                break
            t, which = search(trees, 0, origin, ray, t, inf, stack)
        distance[r], facet[r] = t if which >= 0 else nan, which


LEVEL = 1e-5
"""Slope below which a triangle may be land."""

CLEAR = 1e-9
"""Share of a cell that a ray must travel before it can meet a triangle again."""


@exact
def _is_wall(nx: float, ny: float, nz: float) -> bool:
    return nz * nz < WALL_SLOPE * WALL_SLOPE * (nx * nx + ny * ny + nz * nz)


@exact
def is_level(nx: float, ny: float, nz: float) -> bool:
    """Whether a triangle of this normal may be land."""
    return nx * nx + ny * ny <= LEVEL * LEVEL * nz * nz


@exact
def first_soup_change(
    trees: Hierarchy, sheet: Packed, b: int, ray: CellRay, inside: bool, event: Floats, stack: Ints
) -> None:
    """Find where a ray first enters or leaves the triangles of body b; see `reference.column.first_change`.

    Two cells that touch as separate solids have two coincident walls: light in the glass passes both.
    """
    bodies, lat = sheet.bodies, sheet.lattice
    array, i, j, x, y, z, L, M, N = ray
    sx, sy = sheet_xy(lat, array, i, j, x, y)
    origin, own = (sx - x, sy - y, bodies[b, slot.LEVEL]), Ray(x, y, z, L, M, N)
    aside = max(box_span(lat, bodies, b, sx, sy, L, M)[1], 0.0)
    above = inf if inside else (bodies[b, slot.BODY_HIGH] - z) / N
    clear = CLEAR * lat[slot.HALF]
    least, kind, t = clear, ASIDE, aside
    if event[DISTANCE] < 0.0:  # from the reference plane: nothing has been met yet
        least = -clear
    nx, ny, nz = 0.0, 0.0, 1.0
    which = -1
    for _ in range(64):
        t, which = search(trees, b, origin, own, least, inf, stack)
        if which < 0:
            break
        nx, ny, nz = normal_of(trees, which)
        if not (inside and _is_wall(nx, ny, nz)):
            break
        if ways_through(trees, b, origin, own, t - clear, t + clear, stack) != BOTH:
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
    for at in range(MOST_ARRAYS):
        p, q, u, v = to_array(lat, array, at, i, j, x + t * L, y + t * M)
        place = PLACE + 4 * at
        event[place], event[place + 1], event[place + 2], event[place + 3] = p, q, u - t * L, v - t * M
    if kind == FRONT or kind == BACK:
        _tell_land(trees, sheet.faces, b, which, own, event)
        _note_normal(trees, which, origin, own, event)


@exact
def _tell_land(trees: Hierarchy, faces: Floats, b: int, which: int, ray: Ray, event: Floats) -> None:
    """Distinguish land from lens: land is level triangles nearer the design's land than its lens."""
    side, t = (0 if event[KIND] == FRONT else 1), event[DISTANCE]
    nx, ny, nz = normal_of(trees, which)
    face, level = faces[2 * b + side], ray.z + t * ray.N
    if face[slot.ARRAY] >= 0.0 and not isnan(face[slot.LAND]):
        place = PLACE + 4 * int(face[slot.ARRAY])
        lens = height(faces, 2 * b + side, event[place + 2] + t * ray.L, event[place + 3] + t * ray.M)
        if is_level(nx, ny, nz) and (isnan(lens) or abs(level - face[slot.LAND]) < abs(level - lens)):
            event[KIND] = FRONT_LAND if side == 0 else BACK_LAND


@exact
def _note_normal(trees: Hierarchy, which: int, origin: Vector, ray: Ray, event: Floats) -> None:
    """Record the normal towards +z: the triangle's, or that of its corners interpolated."""
    nx, ny, nz = normal_of(trees, which)
    if len(trees.corner_normal) > 0:
        _, u, v, w = hit(trees.corner[which], origin, ray)
        n = trees.corner_normal[which]
        nx, ny, nz = (
            u * n[0, 0] + v * n[1, 0] + w * n[2, 0],
            u * n[0, 1] + v * n[1, 1] + w * n[2, 1],
            u * n[0, 2] + v * n[1, 2] + w * n[2, 2],
        )
    sign = -1.0 if event[KIND] == FRONT or event[KIND] == FRONT_LAND else 1.0
    event[FACET_NORMAL], event[FACET_NORMAL + 1], event[FACET_NORMAL + 2] = sign * nx, sign * ny, sign * nz
