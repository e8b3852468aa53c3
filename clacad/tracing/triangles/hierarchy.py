"""Triangles in trees of boxes, one for each body, in which compiled code finds the triangles that a ray
meets.

Each is a complete binary tree over triangles in Morton order of their positions in the sheet plane: built by
sorting, without recursion.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Ints

LEAF = 4
"""Triangles in a leaf of a tree of boxes."""


class Hierarchy(NamedTuple):
    """Triangles of every body, one body after the other, each in its tree.

    Attributes
    ----------
    corner : (t, 3, 3) lengths
        Counter-clockwise seen from outside.
    corner_normal : (t, 3, 3) or (0, 3, 3)
        Outward normals at the corners, where requested.
    tree : (bodies, 3) ints
        First box of each body's tree, its first triangle, their number.
    box : (nodes, 6) lengths
        Low and high corner of each box. Node i has children 2 i + 1 and 2 i + 2; the last level's nodes are leaves.
    """

    corner: Floats
    corner_normal: Floats
    tree: Ints
    box: Floats


def hierarchy(bodies: list[Floats]) -> tuple[Ints, Hierarchy]:
    """Triangles of each body in a tree of boxes.

    Parameters
    ----------
    bodies : list of (t, 3, 3) lengths
        Corners, counter-clockwise seen from outside; none empty.

    Returns
    -------
    rank : (Σ t,) ints
        For each triangle of the hierarchy, its row in all bodies one after the other.
    trees : Hierarchy
        Without normals at the corners.
    """
    ranks, rows, boxes, first, root = [], [], [], 0, 0
    for corners in bodies:
        rank, own = _tree(corners)
        ranks.append(first + rank)
        rows.append((root, first, len(corners)))
        boxes.append(own)
        first, root = first + len(corners), root + len(own)
    which = np.concatenate(ranks)
    return which, Hierarchy(
        corner=np.ascontiguousarray(np.concatenate(bodies)[which]),
        corner_normal=np.zeros((0, 3, 3)),
        tree=np.array(rows, dtype=np.int64),
        box=np.concatenate(boxes),
    )


def _tree(corners: Floats) -> tuple[Ints, Floats]:
    """Order of the triangles, and the boxes (nodes, 6) of a complete binary tree over them, root first.

    Node i has children 2 i + 1 and 2 i + 2; the last level's nodes are leaves of `LEAF` triangles each.
    """
    middle = corners.mean(axis=1)[:, :2]
    low, high = middle.min(axis=0), middle.max(axis=0)
    cells = ((middle - low) / np.maximum(high - low, 1e-300) * 65535.0).astype(np.uint64)
    rank = np.argsort(_spread(cells[:, 0]) | (_spread(cells[:, 1]) << np.uint64(1)), kind="stable")
    ordered = corners[rank]
    leaves = 1 << max(0, int(np.ceil(np.log2(max(1, -(-len(corners) // LEAF))))))
    starts = np.arange(0, len(corners), LEAF)
    boxes = np.full((2 * leaves - 1, 6), np.nan)  # no ray enters a box without triangles
    level = boxes[leaves - 1 :]
    level[: len(starts), :3] = np.minimum.reduceat(ordered.min(axis=1), starts, axis=0)
    level[: len(starts), 3:] = np.maximum.reduceat(ordered.max(axis=1), starts, axis=0)
    first = leaves - 1
    while first > 0:
        parents = slice((first - 1) // 2, first)
        left, right = boxes[first : 2 * first + 1 : 2], boxes[first + 1 : 2 * first + 1 : 2]
        boxes[parents, :3] = np.fmin(left[:, :3], right[:, :3])
        boxes[parents, 3:] = np.fmax(left[:, 3:], right[:, 3:])
        first = (first - 1) // 2
    return rank, boxes


def _spread(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Put a zero bit between the bits of 16-bit numbers."""
    for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        x = (x | (x << np.uint64(shift))) & np.uint64(mask)
    return x
