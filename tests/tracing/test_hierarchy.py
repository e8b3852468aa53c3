"""Trees of boxes, searched by bundles of rays and by compiled code, find what asking every triangle gives."""

from __future__ import annotations

import numba
import numpy as np
import pytest

import clacad
from clacad.mesh import tessellate
from clacad.tracing.compiled.records import DEPTH, Ray
from clacad.tracing.facets.compiled_hierarchy import first_facet, nearest
from clacad.tracing.facets.hierarchy import COUNT, FIRST, LEAF, LEVELS, hierarchy, mesh_tree, nearest_triangle


@numba.njit
def nearest_of_many(trees, b, position, direction, distance, which):
    """Search of a picture, ray by ray; `distance` holds the limits at first."""
    stack = np.empty(DEPTH, dtype=np.int64)
    for r in range(len(position)):
        (x, y, z), (u, v, w) = position[r], direction[r]
        distance[r], which[r] = nearest(trees, b, Ray(x, y, z, u, v, w), distance[r], stack)


def brute_force(corners, position, direction, counts=None):
    """Nearest of the triangles (t,) that count for each ray, by Cramer's rule on all of them."""
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(direction[:, None], edge2[None])
    det = np.einsum("tk,ntk->nt", edge1, across)
    from_corner = position[:, None] - corners[None, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("ntk,ntk->nt", from_corner, across) / det
        q = np.cross(from_corner, edge1[None])
        v = np.einsum("nk,ntk->nt", direction, q) / det
        t = np.einsum("tk,ntk->nt", edge2, q) / det
    t = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf)
    return t if counts is None else np.where(counts, t, np.inf)


def scattered(count, seed):
    """Triangles of all sizes and rays of all directions, some along an axis."""
    rng = np.random.default_rng(seed)
    size = 10.0 ** rng.uniform(-2.0, 0.0, (count, 1, 1))
    corners = rng.normal(size=(count, 1, 3)) + size * rng.normal(size=(count, 3, 3))
    start, ray = rng.normal(size=(300, 3)) * 3.0, rng.normal(size=(300, 3))
    ray[:20, 0] = ray[20:40, 1] = ray[40:60, 2] = ray[:10, 1] = 0.0
    return corners, start, ray


@pytest.mark.daily_cases("3", "4", "5", "64", "65", "700")
@pytest.mark.parametrize("count", [1, 3, 4, 5, 64, 65, 700])
def test_the_first_triangle_is_that_of_asking_all(count):
    corners, start, ray = scattered(count, count)
    trees = hierarchy([corners[: count // 2 + 1], corners])[1]
    first = trees.tree[1, FIRST]
    t = brute_force(trees.corner[first:], start, ray)
    wanted = np.where(np.isfinite(t.min(axis=1)), t.argmin(axis=1) + first, -1)
    limit = np.full(len(start), np.inf)
    distance, which = nearest_triangle(trees, 1, start, ray, limit)
    np.testing.assert_array_equal(which, wanted)
    np.testing.assert_allclose(distance, t.min(axis=1), rtol=1e-9)
    own = np.empty_like(which)
    nearest_of_many(trees, 1, start, ray, limit, own)
    np.testing.assert_array_equal(own, wanted)
    np.testing.assert_allclose(limit, distance, rtol=1e-12)


def test_a_limit_is_kept_and_a_mesh_without_triangles_is_never_met():
    corners, start, ray = scattered(300, 8)
    trees = mesh_tree(corners)
    free = nearest_triangle(trees, 0, start, ray, np.full(300, np.inf))[0]
    limit = np.where(np.arange(300) % 2 == 0, 0.99, 1.01) * np.where(np.isfinite(free), free, 1.0)
    distance, which = nearest_triangle(trees, 0, start, ray, limit)
    assert ((which >= 0) == (np.isfinite(free) & (limit > free))).all()
    assert (distance[which < 0] == limit[which < 0]).all()
    none = mesh_tree(np.zeros((5, 3, 3)))
    own, met = np.full(300, np.inf), np.empty(300, dtype=np.int64)
    nearest_of_many(none, 0, start, ray, own, met)
    assert (met == -1).all()
    assert (nearest_triangle(none, 0, start, ray, np.full(300, np.inf))[1] == -1).all()


def test_light_enters_and_leaves_by_the_first_facet_that_faces_so():
    window = clacad.prescribe(clacad.load("designs/slab.toml").with_cells((3, 3)))
    mesh = tessellate(window, quads=6)
    rank, trees = hierarchy([np.concatenate(list(mesh.bodies[0].rows()))])
    assert sorted(rank) == list(range(len(trees.corner)))
    c = trees.corner
    normals = np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0])
    rng = np.random.default_rng(8)
    x0, x1, y0, y1 = window.lattice.extent()
    start = np.column_stack(
        [rng.uniform((x0, y0), (x1, y1), (400, 2)), np.full(400, window.z_range[0] - 1.0)]
    )
    slope = rng.uniform(-0.36, 0.36, (400, 2))
    start[:, :2] -= slope
    ray = np.column_stack([slope, np.ones(400)])
    ray /= np.linalg.norm(ray, axis=1)[:, None]
    for facing in (-1.0, 1.0):
        distance, which = np.empty(400), np.empty(400, dtype=np.int64)
        first_facet(trees, normals, start, ray, facing, distance, which)
        t = brute_force(c, start, ray, facing * (ray @ normals.T) > 0.0)
        met = np.isfinite(t.min(axis=1))
        assert met.mean() > 0.5
        assert ((which >= 0) == met).all()
        np.testing.assert_allclose(distance[met], t.min(axis=1)[met], rtol=1e-12)
        assert (which[met] == t.argmin(axis=1)[met]).mean() > 0.98  # an edge belongs to either side


def test_every_triangle_is_in_the_box_of_its_leaf_and_every_box_in_its_parents():
    corners = scattered(777, 2)[0]
    trees = hierarchy([corners])[1]
    _, _, count, levels = trees.tree[0].tolist()
    assert (trees.tree[0, COUNT], trees.tree[0, LEVELS]) == (777, 8)
    ends = (np.arange((1 << levels) + 1) * count) >> levels
    assert np.diff(ends).max() <= LEAF
    leaf = (1 << levels) - 1 + np.repeat(np.arange(1 << levels), np.diff(ends))
    assert (trees.corner.min(axis=1) >= trees.box[leaf, :3]).all()
    assert (trees.corner.max(axis=1) <= trees.box[leaf, 3:]).all()
    child = np.arange(1, len(trees.box))
    parent = (child - 1) // 2
    assert (trees.box[child, :3] >= trees.box[parent, :3]).all()
    assert (trees.box[child, 3:] <= trees.box[parent, 3:]).all()
