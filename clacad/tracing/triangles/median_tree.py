"""A tree of boxes over triangles, and the first hit of a ray in it. Pure numpy; numba and embree are faster.

Bounding volumes by median split; triangles by Möller & Trumbore, J. Graphics Tools 2, 21 (1997).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Ints

LEAF = 4
"""Triangles in a leaf at most."""


@dataclass(frozen=True, eq=False)
class Tree:
    """Boxes over triangles.

    Attributes
    ----------
    low, high : (n, 3) lengths
        Corners of each node's box; the first node is the root.
    first : (n,) ints
        Leaf: its first triangle. Other nodes: the left child; the right one follows it.
    count : (n,) ints
        Triangles of a leaf; 0 in other nodes.
    corners : (t, 3, 3) lengths
        Triangles, in the order of the leaves.
    """

    low: Floats
    high: Floats
    first: Ints
    count: Ints
    corners: Floats


def grow(corners: Floats) -> Tree:
    """Build the tree of triangles (t, 3, 3); triangles without area are left out.

    Memory is about 200 bytes a triangle. The split is at the median of the longest side, so the tree, and
    with it the picture, is identical on all machines.
    """
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    corners = corners[np.isfinite(corners).all(axis=(1, 2)) & area.any(axis=1)]
    if not len(corners):
        return Tree(np.full((1, 3), np.inf), np.full((1, 3), -np.inf), np.zeros(1, np.int64), np.ones(1, np.int64),
                    np.zeros((1, 3, 3)))  # fmt: skip
    middle = corners.mean(axis=1)
    lows, highs = corners.min(axis=1), corners.max(axis=1)
    order = np.arange(len(corners))
    low, high, first, count = [], [], [0], [0]
    stack = [(0, 0, len(corners))]
    low.append(lows.min(axis=0))
    high.append(highs.max(axis=0))
    while stack:
        node, a, b = stack.pop()
        if b - a <= LEAF:
            first[node], count[node] = a, b - a
            continue
        rows = order[a:b]
        axis = int(np.argmax(np.ptp(middle[rows], axis=0)))
        half = (b - a) // 2
        rows = rows[np.argpartition(middle[rows, axis], half, kind="introselect")]
        order[a:b] = rows
        left = len(first)
        first[node] = left
        for k, (c, d) in enumerate(((a, a + half), (a + half, b))):
            first.append(0)
            count.append(0)
            low.append(lows[order[c:d]].min(axis=0))
            high.append(highs[order[c:d]].max(axis=0))
            stack.append((left + k, c, d))
    return Tree(np.array(low), np.array(high), np.array(first), np.array(count), corners[order])


def nearest_triangle(
    tree: Tree, root: int, origin: Floats, direction: Floats, limit: Floats
) -> tuple[Floats, Ints]:
    """First triangle that each ray meets; whole bundles of rays traverse the tree together.

    Parameters
    ----------
    root : int
        Node to start from: one `Tree` may contain several trees.
    origin, direction : (n, 3) arrays
        In the tree's frame; directions of any length.
    limit : (n,)
        Only hits at distances (in lengths of the direction) above 0 and below this count.

    Returns
    -------
    distance : (n,)
        `limit` where nothing was met.
    triangle : (n,) ints
        Row of `tree.corners`, −1 where nothing was met.
    """
    distance, triangle = limit.copy(), np.full(len(origin), -1, dtype=np.int64)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / direction
        stack = [(root, np.arange(len(origin)))]
        while stack:
            node, rows = stack.pop()
            rows = rows[_meets_box(tree, node, origin[rows], inverse[rows], distance[rows])]
            if not len(rows):
                continue
            if tree.count[node]:
                for k in range(tree.first[node], tree.first[node] + tree.count[node]):
                    t = meet_triangle(tree.corners[k], origin[rows], direction[rows])
                    closer = (t > 0.0) & (t < distance[rows])
                    distance[rows[closer]] = t[closer]
                    triangle[rows[closer]] = k
            else:
                left = int(tree.first[node])
                stack += [(left + 1, rows), (left, rows)]
    return distance, triangle


def _meets_box(tree: Tree, node: int, origin: Floats, inverse: Floats, limit: Floats) -> NDArray[np.bool_]:
    a, b = (tree.low[node] - origin) * inverse, (tree.high[node] - origin) * inverse
    near = np.fmax.reduce(np.fmin(a, b), axis=1)
    far = np.fmin.reduce(np.fmax(a, b), axis=1)
    return np.asarray((near <= far * (1.0 + 1e-14)) & (far >= 0.0) & (near <= limit))


def meet_triangle(corner: Floats, origin: Floats, direction: Floats) -> Floats:
    """Distance (n,) along rays to the plane of a triangle (3, 3) where they hit it, else NaN."""
    edge1, edge2 = corner[1] - corner[0], corner[2] - corner[0]
    p = np.cross(direction, edge2)
    det = p @ edge1
    s = origin - corner[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("ij,ij->i", s, p) / det
        q = np.cross(s, edge1)
        v = np.einsum("ij,ij->i", direction, q) / det
        t = (q @ edge2) / det
        inside = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0)
    return np.where(inside, t, np.nan)


def meet_each(corner: Floats, origin: Floats, direction: Floats) -> Floats:
    """Distance (n,) along each ray to the plane of its own triangle (n, 3, 3) where it hits it, else NaN."""
    edge1, edge2 = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    p = np.cross(direction, edge2)
    s = origin - corner[:, 0]
    q = np.cross(s, edge1)
    with np.errstate(divide="ignore", invalid="ignore"):
        det = np.einsum("ij,ij->i", p, edge1)
        u, v = np.einsum("ij,ij->i", s, p) / det, np.einsum("ij,ij->i", direction, q) / det
        inside = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0)
        return np.where(inside, np.einsum("ij,ij->i", q, edge2) / det, np.nan)


def behind_one_another(trees: tuple[Tree, ...]) -> tuple[Tree, tuple[int, ...], tuple[int, ...]]:
    """All trees in one, with the root of each and its first triangle."""
    node, facet, parts, roots, facets = 0, 0, [], [], []
    for tree in trees:
        first = np.where(tree.count > 0, tree.first + facet, tree.first + node)
        parts.append(Tree(tree.low, tree.high, first, tree.count, tree.corners))
        roots.append(node)
        facets.append(facet)
        node, facet = node + len(tree.first), facet + len(tree.corners)
    if not parts:
        return grow(np.zeros((0, 3, 3))), (), ()
    names = ("low", "high", "first", "count", "corners")
    joined = Tree(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))
    return joined, tuple(roots), tuple(facets)
