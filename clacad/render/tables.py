"""A stage laid out for compiled code: four plain arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clacad.render.stage import Stage

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

BLOCK = 256
"""Rays of a block: its columns stay in the first-level cache."""


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
