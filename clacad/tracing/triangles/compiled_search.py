"""Compiled search of triangles from any source: the first one a ray meets, in a tree of boxes.

The search knows nothing of sheets: the walk of `compiled_hierarchy` and the judge of a file's facets call it.
"""

from __future__ import annotations

from math import inf, nan

import numpy as np

from clacad.base.compiled import exact, owning
from clacad.base.types import Floats, Ints
from clacad.tracing.compiled.records import DEPTH, Ray, Vector
from clacad.tracing.triangles.hierarchy import LEAF, Hierarchy

INWARDS, OUTWARDS, BOTH = 1, 2, 3
"""Results of `ways_through`: the direction in which triangles are passed."""

BEFORE = -1e-300
"""A facet at the very start of a ray counts."""

UPRIGHT = 1e-300
"""Slope used in place of 0, whose reciprocal times a distance of 0 from a box's side would be NaN."""


@exact
def _enters(box: Floats, x: float, y: float, z: float, inverse: Vector, far: float) -> float:
    """Distance at which a ray enters a box, or inf, with a rounding tolerance.

    `inverse` is of its direction.
    """
    il, im, iz = inverse
    a, b = (box[0] - x) * il, (box[3] - x) * il
    c, d = (box[1] - y) * im, (box[4] - y) * im
    e, f = (box[2] - z) * iz, (box[5] - z) * iz
    near = max(min(a, b), max(min(c, d), min(e, f)))
    leave = min(max(a, b), min(max(c, d), max(e, f)))
    slack = 1e-12 * (abs(near) + abs(leave))
    return near - slack if near <= leave + 2.0 * slack and near <= far else inf


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
def _tree(trees: Hierarchy, b: int) -> tuple[int, int, int, int]:
    """The tree of body b: first box, first triangle, triangles, boxes that are no leaves."""
    root = trees.tree[b, 0]
    nodes = (trees.tree[b + 1, 0] if b + 1 < len(trees.tree) else len(trees.box)) - root
    return root, trees.tree[b, 1], trees.tree[b, 2], (nodes - 1) // 2


@exact
def _next_leaf(
    trees: Hierarchy, b: int, place: Vector, inverse: Vector, far: float, stack: Ints, waiting: int
) -> tuple[int, int, int]:
    """Range of triangles (first, end) of the next leaf that a ray enters before `far`; 0, 0 at the end.

    place : a point of the ray in the frame of the boxes; `inverse` is of its direction
    waiting : boxes on the stack; the number that remain is returned last
    """
    root, first, count, inner = _tree(trees, b)
    while waiting > 0:
        waiting -= 1
        node = stack[waiting]
        if not _enters(trees.box[root + node], place[0], place[1], place[2], inverse, far) < inf:
            continue
        if node >= inner:
            start = (node - inner) * LEAF
            return first + start, first + min(start + LEAF, count), waiting
        stack[waiting], stack[waiting + 1] = 2 * node + 2, 2 * node + 1
        waiting += 2
    return 0, 0, 0


@exact
def search(
    trees: Hierarchy, b: int, origin: Vector, ray: Ray, least: float, most: float, stack: Ints
) -> tuple[float, int]:
    """Nearest triangle of body b at a distance between `least` and `most`: distance and number, inf and −1.

    The ray is relative to `origin`, the centre of its cell; `stack` (DEPTH,) is scratch.
    """
    inverse = (1.0 / ray.L, 1.0 / ray.M, 1.0 / ray.N)
    place = (origin[0] + ray.x, origin[1] + ray.y, origin[2] + ray.z)
    best, which = most, -1
    stack[0] = 0
    begin, end, waiting = _next_leaf(trees, b, place, inverse, best, stack, 1)
    while begin < end:
        for k in range(begin, end):
            t = hit(trees.corner[k], origin, ray)[0]
            if least < t < best:
                best, which = t, k
        begin, end, waiting = _next_leaf(trees, b, place, inverse, best, stack, waiting)
    return (best, which) if which >= 0 else (inf, -1)


@exact
def ways_through(
    trees: Hierarchy, b: int, origin: Vector, ray: Ray, least: float, most: float, stack: Ints
) -> int:
    """Direction in which the ray passes the triangles between two distances: INWARDS, OUTWARDS, BOTH, or 0
    for none.
    """
    inverse = (1.0 / ray.L, 1.0 / ray.M, 1.0 / ray.N)
    place = (origin[0] + ray.x, origin[1] + ray.y, origin[2] + ray.z)
    found, stack[0] = 0, 0
    begin, end, waiting = _next_leaf(trees, b, place, inverse, most, stack, 1)
    while begin < end:
        for k in range(begin, end):
            if least < hit(trees.corner[k], origin, ray)[0] < most:
                nx, ny, nz = normal_of(trees, k)
                found |= OUTWARDS if nx * ray.L + ny * ray.M + nz * ray.N > 0.0 else INWARDS
        begin, end, waiting = _next_leaf(trees, b, place, inverse, most, stack, waiting)
    return found


@exact
def normal_of(trees: Hierarchy, k: int) -> tuple[float, float, float]:
    """Outward normal of a triangle, of length twice its area."""
    c = trees.corner[k]
    ux, uy, uz = c[1, 0] - c[0, 0], c[1, 1] - c[0, 1], c[1, 2] - c[0, 2]
    vx, vy, vz = c[2, 0] - c[0, 0], c[2, 1] - c[0, 1], c[2, 2] - c[0, 2]
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@owning
def first_facet(
    trees: Hierarchy, normals: Floats, position: Floats, direction: Floats, facing: float, distance: Floats,
    facet: Ints,
) -> None:  # fmt: skip
    """Fill `distance` (n,) and `facet` (n,) for rays with d_z > 0; NaN and −1 where none is met.

    The nearest facet ahead, of body 0 of `trees`, with facing × normal · direction > 0.
    """
    origin, stack = (0.0, 0.0, 0.0), np.empty(DEPTH, dtype=np.int64)
    for r in range(len(position)):
        u, v, w = direction[r, 0], direction[r, 1], direction[r, 2]
        u, v = u if u != 0.0 else UPRIGHT, v if v != 0.0 else UPRIGHT
        ray = Ray(position[r, 0], position[r, 1], position[r, 2], u, v, w)
        t, which = search(trees, 0, origin, ray, BEFORE, inf, stack)
        while which >= 0:
            n = normals[which]
            if facing * (n[0] * u + n[1] * v + n[2] * w) > 0.0:
                break
            t, which = search(trees, 0, origin, ray, t, inf, stack)
        distance[r], facet[r] = t if which >= 0 else nan, which
