"""A stage laid out for compiled code: four plain arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clacad.base.types import Floats
from clacad.rendering.scene_arrays import CONE, FLOOR, MESH, PRISM, SCREEN, SPHERE, SceneArrays
from clacad.tracing.facets.hierarchy import ROOT, Hierarchy

# Columns of `Tables.prim`.
KIND, PAINT, PATTERN, PIECE, END, ROWS, COLUMNS, SIZE, BOUND, ORIGIN, TURN, COLOUR = (
    *range(8),
    11,
    17,
    20,
    29,
)
PRIM_WIDTH = 35
# Numbers of `Tables.world`.
AMBIENT, KEY, TOWARDS_LIGHT, ZENITH, HORIZON, GROUND = 0, 1, 2, 5, 8, 11

# Columns of `Tables.cluster`.
FIRST, PAST, CENTRE, EXTENT = 0, 1, 2, 5

BLOCK = 256
"""Rays of a block: its columns stay in the first-level cache."""


class Tables(NamedTuple):
    """A `SceneArrays` in plain arrays: compiled code passes few arrays quickly and many slowly.

    world : (14,). Ambient, key, direction to the light (3), zenith (3), horizon (3), ground (3).
    cluster : (m, 8). First primitive and one past the last, centre and half extents of a box round them
        (infinite round a floor).
    prim : (n, 35)
        A primitive a row, columns as named above; BOUND: low and high corner of a box round it, scene frame.
    store : (k,). Corners of prisms and pixels; indices into it are absolute.
    trees : Meshes; the piece of a primitive is its number there.
    """

    world: Floats
    cluster: Floats
    prim: Floats
    store: Floats
    trees: Hierarchy


def tables(stage: SceneArrays) -> Tables:
    """Lay a stage out for compiled code."""
    n, pixel0 = len(stage.kind), stage.outline.size
    store = np.concatenate([stage.outline.ravel(), stage.pixels.ravel()])
    piece = np.zeros((n, 2))
    for kind, start, width in ((PRISM, 0, 2), (SCREEN, pixel0, 3), (MESH, 0, 1)):
        rows = stage.kind == kind
        piece[rows] = start + width * stage.piece[rows]
    boxes = np.array([_box(stage, k) for k in range(n)]).reshape(-1, 2, 3)
    prim = np.column_stack(
        [
            stage.kind,
            stage.paint,
            stage.pattern,
            piece,
            stage.picture,
            stage.size,
            boxes.reshape(-1, 6),
            stage.origin,
            stage.rotation.reshape(-1, 9),
            stage.colours.reshape(-1, 6),
        ]
    )
    world = np.concatenate([[stage.ambient, stage.key], stage.towards_light, stage.sky.ravel(), stage.ground])
    cluster = np.column_stack([stage.cluster, _round(stage, boxes)])
    cluster, prim = np.ascontiguousarray(cluster, dtype=np.float64), prim.reshape(-1, PRIM_WIDTH)
    return Tables(world, cluster, prim, store, stage.forest)


def _round(stage: SceneArrays, boxes: Floats) -> Floats:
    """Centre and half extents (m, 6) of a box along the scene's axes round each object."""
    found = np.empty((len(stage.cluster), 6))
    for row, (first, end) in enumerate(stage.cluster):
        corners = boxes[first:end]
        low, high = corners[:, 0].min(axis=0, initial=np.inf), corners[:, 1].max(axis=0, initial=-np.inf)
        if np.isfinite(corners).all():
            found[row, :3], found[row, 3:] = (0.5 * (low + high), 0.5 * (high - low))
        else:
            found[row, :3], found[row, 3:] = 0.0, np.inf
    return found


def _box(stage: SceneArrays, k: int) -> Floats:
    """Low and high corner (2, 3), scene frame, of a box round primitive k."""
    kind, (a, b, c, _) = stage.kind[k], stage.size[k]
    half, middle = np.array([a, b, c]), np.zeros(3)
    if kind == FLOOR:
        return np.array([[-np.inf] * 3, [np.inf] * 3])
    if kind == SPHERE:
        half = np.full(3, a)
    elif kind == CONE:
        radius = max(a, b)
        half, middle = np.array([radius, 0.5 * c, radius]), np.array([0.0, 0.5 * c, 0.0])
    elif kind == SCREEN:
        half = np.array([a, b, 0.0])
    elif kind in (PRISM, MESH):
        if kind == PRISM:
            outline = stage.outline[stage.piece[k, 0] : stage.piece[k, 1]]
            low, high = np.append(outline.min(axis=0), -a), np.append(outline.max(axis=0), a)
        else:
            low, high = stage.forest.box[stage.forest.tree[stage.piece[k, 0], ROOT]].reshape(2, 3)
        half, middle = 0.5 * (high - low), 0.5 * (high + low)
    turn = stage.rotation[k]
    centre, reach = turn @ middle + stage.origin[k], np.abs(turn) @ half
    reach = reach + 1e-9 * reach.max()
    return np.array([centre - reach, centre + reach])
