"""Triangles from any source in trees of boxes, one tree a mesh, and the first triangle of each ray of a
bundle.

A tree is complete and binary. Every box is halved at the median of its longest side, level by level and by
stable sorting, so that the tree is the same on all machines. `compiled_hierarchy` is the compiled search; the
search here serves bundles of rays where no kernel is loaded. Triangles by Möller and Trumbore, J. Graphics
Tools 2, 21 (1997).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, log2
from typing import NamedTuple

import numpy as np

from clacad.base.types import Bools, Floats, Ints

LEAF = 4
"""Largest number of triangles in a leaf of a tree of boxes."""

# Columns of a tree's row: its first box, its first triangle, the number of triangles, levels above the
# leaves.
ROOT, FIRST, COUNT, LEVELS = range(4)


class Hierarchy(NamedTuple):
    """Triangles of every body or mesh, one after the other, each in its tree.

    corner : (t, 3, 3) lengths. Of bodies, counter-clockwise seen from outside.
    corner_normal : (t, 3, 3) or (0, 3, 3). Outward normals at the corners, where requested.
    tree : (bodies, 4) ints. Columns as named above.
    box : (nodes, 6) lengths. Low and high corner of each box. Node i has children 2 i + 1 and 2 i + 2; the
        2^LEVELS nodes of the last level are leaves. Of n triangles leaf k has those from k n / 2^LEVELS to (k
        + 1) n / 2^LEVELS, rounded down.
    """

    corner: Floats
    corner_normal: Floats
    tree: Ints
    box: Floats


def hierarchy(bodies: Sequence[Floats]) -> tuple[Ints, Hierarchy]:
    """Triangles of each body in a tree of boxes.

    bodies : sequence of (t, 3, 3) lengths. Corners; none empty.

    Returns
    -------
    rank : (Σ t,) ints
        For each triangle of the hierarchy, its row in all bodies one after the other.
    trees : Hierarchy
        Without normals at the corners.
    """
    ranks, each, first = [], [], 0
    for corners in bodies:
        rank, levels = _order(corners)
        ranks.append(first + rank)
        each.append(_boxed(corners[rank], levels))
        first += len(corners)
    return np.concatenate(ranks), joined(each)


def mesh_tree(corners: Floats) -> Hierarchy:
    """Tree of the triangles (t, 3, 3) of one mesh; triangles without area are left out.

    A mesh without triangles has one without area, in a box that no ray enters.
    """
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    corners = corners[np.isfinite(corners).all(axis=(1, 2)) & area.any(axis=1)]
    if len(corners):
        return hierarchy([corners])[1]
    empty = np.array([[np.inf] * 3 + [-np.inf] * 3])
    return Hierarchy(np.zeros((1, 3, 3)), np.zeros((0, 3, 3)), np.array([[0, 0, 1, 0]]), empty)


def joined(trees: Sequence[Hierarchy]) -> Hierarchy:
    """All trees in one hierarchy, in their order; without trees, that of a mesh without triangles."""
    if not trees:
        return mesh_tree(np.zeros((0, 3, 3)))
    rows, box, facet = [], 0, 0
    for one in trees:
        rows.append(one.tree + [box, facet, 0, 0])
        box, facet = box + len(one.box), facet + len(one.corner)
    parts = ([getattr(one, name) for one in trees] for name in ("corner", "corner_normal", "box"))
    corner, normal, boxes = (np.ascontiguousarray(np.concatenate(part)) for part in parts)
    return Hierarchy(corner, normal, np.concatenate(rows), boxes)


def _order(corners: Floats) -> tuple[Ints, int]:
    """Order of triangles (t, 3, 3) in the leaves of their tree, and its levels above the leaves."""
    middle, count = corners.mean(axis=1), len(corners)
    levels = max(0, ceil(log2(count / LEAF)))
    order = np.arange(count)
    for level in range(levels):
        ends = _ends(count, level)
        node = np.repeat(np.arange(1 << level), np.diff(ends))
        sorted_middle = middle[order]
        low = np.minimum.reduceat(sorted_middle, ends[:-1])
        size = np.maximum.reduceat(sorted_middle, ends[:-1]) - low
        side = np.argmax(size, axis=1)
        place = (
            sorted_middle[np.arange(count), side[node]] - np.take_along_axis(low, side[:, None], 1)[node, 0]
        )
        width = np.maximum(size.max(axis=1), 1e-300)[node]
        order = order[np.argsort(node + place / width * (1.0 - 1e-9), kind="stable")]
    return order, levels


def _ends(count: int, level: int) -> Ints:
    """Bounds (2^level + 1,) of the ranges of triangles that the nodes of a level have."""
    return (np.arange((1 << level) + 1) * count) >> level


def _boxed(corners: Floats, levels: int) -> Hierarchy:
    """Tree over ordered triangles."""
    ends, leaves = _ends(len(corners), levels), 1 << levels
    box = np.empty((2 * leaves - 1, 6))
    box[leaves - 1 :, :3] = np.minimum.reduceat(corners.min(axis=1), ends[:-1], axis=0)
    box[leaves - 1 :, 3:] = np.maximum.reduceat(corners.max(axis=1), ends[:-1], axis=0)
    for level in range(levels - 1, -1, -1):
        parents, children = (
            slice((1 << level) - 1, (2 << level) - 1),
            slice((2 << level) - 1, (4 << level) - 1),
        )
        pairs = box[children].reshape(-1, 2, 6)
        box[parents, :3] = pairs[..., :3].min(axis=1)
        box[parents, 3:] = pairs[..., 3:].max(axis=1)
    row = np.array([[0, 0, len(corners), levels]], dtype=np.int64)
    return Hierarchy(np.ascontiguousarray(corners), np.zeros((0, 3, 3)), row, box)


# -- bundles of rays ---------------------------------------------------------------------------
def nearest_triangle(
    trees: Hierarchy, b: int, origin: Floats, direction: Floats, limit: Floats
) -> tuple[Floats, Ints]:
    """First triangle of mesh b that each ray meets; whole bundles of rays traverse the tree together.

    origin, direction : (n, 3) arrays. In the tree's frame; directions of any length.
    limit : (n,). Only hits at distances (in lengths of the direction) above 0 and below this count.

    Returns
    -------
    distance : (n,)
        `limit` where nothing was met.
    triangle : (n,) ints
        Row of `trees.corner`, −1 where nothing was met; of triangles at one distance the lowest.
    """
    distance, triangle = limit.copy(), np.full(len(origin), -1, dtype=np.int64)
    root, first, count, levels = trees.tree[b].tolist()
    ends, inner = first + _ends(count, levels), (1 << levels) - 1
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / direction
        stack = [(0, np.arange(len(origin)))]
        while stack:
            node, rows = stack.pop()
            rows = rows[_meets_box(trees.box[root + node], origin[rows], inverse[rows], distance[rows])]
            if not len(rows):
                continue
            if node < inner:
                stack += [(2 * node + 2, rows), (2 * node + 1, rows)]
                continue
            for k in range(ends[node - inner], ends[node - inner + 1]):
                t = _meet_triangle(trees.corner[k], origin[rows], direction[rows])
                closer = (t > 0.0) & (t < distance[rows])
                distance[rows[closer]], triangle[rows[closer]] = t[closer], k
    return distance, triangle


def _meets_box(box: Floats, origin: Floats, inverse: Floats, limit: Floats) -> Bools:
    a, b = (box[:3] - origin) * inverse, (box[3:] - origin) * inverse
    near = np.fmax.reduce(np.fmin(a, b), axis=1)
    far = np.fmin.reduce(np.fmax(a, b), axis=1)
    return np.asarray((near <= far * (1.0 + 1e-14)) & (far >= 0.0) & (near <= limit))


def _meet_triangle(corner: Floats, origin: Floats, direction: Floats) -> Floats:
    """Distance (n,) along rays to the plane of a triangle (3, 3) where they hit it, else NaN."""
    edge1, edge2 = corner[1] - corner[0], corner[2] - corner[0]
    p = np.cross(direction, edge2)
    det = p @ edge1
    s = origin - corner[0]
    u = np.einsum("ij,ij->i", s, p) / det
    q = np.cross(s, edge1)
    v = np.einsum("ij,ij->i", direction, q) / det
    t = (q @ edge2) / det
    inside = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0)
    return np.where(inside, t, np.nan)
