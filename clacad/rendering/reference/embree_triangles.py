"""First triangles by embree, where it is installed: it says which triangle, the distance is our own.

Embree works in single precision. It is asked for nothing but the number of the triangle; the hit is computed
again in double precision on that triangle, and rays whose triangle does not hold there go down the tree.
"""

from __future__ import annotations

from functools import lru_cache
from importlib.util import find_spec
from typing import Any

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.rendering.reference.triangle_tree import Tree, meet_each, nearest_triangle

NOTHING = 0xFFFFFFFF
"""Embree's number for no triangle, read as unsigned."""

MANY = 4096
"""Rays below which the tree answers before embree has built its own."""

KEPT_SCENES = 8
"""Scenes kept at most."""

_SCENES: dict[tuple[int, int], tuple[Tree, Any]] = {}


@lru_cache(maxsize=1)
def installed() -> bool:
    """Whether embree can be asked."""
    return find_spec("embreex") is not None


def first_triangle(
    tree: Tree, first: int, end: int, root: int, origin: Floats, direction: Floats, limit: Floats
) -> tuple[Floats, Ints]:
    """First triangle each ray meets; as `triangle_tree.nearest_triangle`, by embree where it is installed.

    Parameters
    ----------
    tree : Tree
        Several meshes behind one another.
    first, end : int
        Triangles of this mesh in `tree.corners`; `root` is its first node.
    """
    if len(origin) < MANY or not installed() or first == end:
        return nearest_triangle(tree, root, origin, direction, limit)
    corners = tree.corners[first:end]
    low, high = tree.low[root], tree.high[root]
    middle, reach = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
    length = np.linalg.norm(direction, axis=1)
    unit = direction / length[:, None]
    # rays start close to the mesh: single precision counts from there
    ahead = np.maximum(0.0, np.einsum("ij,ij->i", middle - origin, unit) - 1.5 * reach)
    start = origin + ahead[:, None] * unit - middle
    found = _scene(tree, first, end, middle).run(
        start.astype(np.float32), unit.astype(np.float32), query="INTERSECT"
    )
    which = np.asarray(found).astype(np.int64)
    hit = (which >= 0) & (which != NOTHING)
    distance, triangle = limit.copy(), np.full(len(origin), -1, dtype=np.int64)
    rows = np.flatnonzero(hit)
    t = meet_each(corners[which[rows]], origin[rows], direction[rows])
    sound = t > 0.0
    closer = rows[sound & (t < limit[rows])]
    distance[closer], triangle[closer] = t[sound & (t < limit[rows])], which[closer] + first
    again = rows[~sound]
    if len(again):
        distance[again], triangle[again] = nearest_triangle(
            tree, root, origin[again], direction[again], limit[again]
        )
    return distance, triangle


def _scene(tree: Tree, first: int, end: int, middle: Floats) -> Any:
    """Embree's scene of a mesh, kept while its tree is."""
    key = id(tree), first
    kept = _SCENES.get(key)
    if kept is None or kept[0] is not tree:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        scene = EmbreeScene()
        TriangleMesh(scene, np.ascontiguousarray(tree.corners[first:end] - middle, dtype=np.float32))
        kept = (tree, scene)
        if len(_SCENES) >= KEPT_SCENES:
            _SCENES.clear()
        _SCENES[key] = kept
    return kept[1]
