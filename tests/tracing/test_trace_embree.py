"""Foreign triangles found by Embree, by the own tree and by asking every triangle: one answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import clacad
from clacad.mesh import tessellate
from clacad.optics.law import angle_between
from clacad.optics.rays import Rays
from clacad.sheet.bundle import bundle
from clacad.tracing.triangles import embree
from clacad.tracing.triangles.triangle_soup import TriangleSoup, read_soup

needs_embree = pytest.mark.skipif(not embree.installed(), reason="embreex is not installed")


def soup_of(window, quads=6):
    return TriangleSoup(
        np.concatenate([rows for body in tessellate(window, quads=quads).bodies for rows in body.rows()])
    )


def wild_rays(window, count, seed):
    """Rays over the whole sheet, tilted up to 20 degrees, some of which hit walls or miss."""
    generator = np.random.default_rng(seed)
    x0, x1, y0, y1 = window.lattice.extent()
    at = generator.uniform([1.1 * x0, 1.1 * y0], [1.1 * x1, 1.1 * y1], (count, 2))
    slope = generator.uniform(-0.36, 0.36, (count, 2))
    down = 0.5 * min(window.lattice.pitch)
    start = np.column_stack([at - down * slope, np.full(count, window.z_range[0] - down)])
    return Rays(start, np.column_stack([slope, np.ones(count)]))


@pytest.mark.slow
@needs_embree
@pytest.mark.parametrize("name", ["paper-a-covered", "plano", "slab", "hexagonal", "galilean", "tilted-seam"])
def test_embree_and_the_own_tree_send_every_ray_the_same_way(name):
    design = clacad.load(f"designs/{name}.toml").with_cells((5, 5))
    window = clacad.prescribe(design)
    soup = soup_of(window)
    narrow = bundle(window, 3000, design.check.field).rays
    wild = wild_rays(window, 3000, seed=3)
    rays = Rays(
        np.concatenate([narrow.position, wild.position]), np.concatenate([narrow.direction, wild.direction])
    )
    own = clacad.trace(window, rays, rung="mesh", mesh=soup)
    other = clacad.trace(window, rays, rung="mesh", mesh=replace(soup, search="embree"))
    for field in ("fate", "cell", "order", "surface"):
        np.testing.assert_array_equal(getattr(other, field), getattr(own, field), err_msg=field)
    assert angle_between(own.direction, other.direction).max() < 1e-14
    size = max(window.lattice.pitch)
    np.testing.assert_allclose(other.position, own.position, rtol=0, atol=1e-13 * size)
    np.testing.assert_allclose(other.optical_path, own.optical_path, rtol=1e-13)
    assert len(np.unique(own.fate)) >= 3


def brute_force(corners, position, direction):
    """Nearest triangle each ray meets, by Cramer's rule on all of them: distance (n,), number (n,)."""
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
    return t.min(axis=1), t.argmin(axis=1)


@needs_embree
def test_what_is_decided_by_embree_is_what_asking_every_triangle_gives():
    # one plano body: the first face light meets is asked for alone
    window = clacad.prescribe(clacad.load("designs/slab.toml").with_cells((3, 3)))
    soup = soup_of(window)
    rays = wild_rays(window, 400, seed=8)
    unit = rays.direction / np.linalg.norm(rays.direction, axis=1, keepdims=True)
    index = embree.BodyTree.of(soup.corners)
    distance, normal, good = embree._hit(index, rays.position, unit, entering=True)
    nearest, which = brute_force(soup.corners, rays.position, unit)
    assert good.mean() > 0.5
    np.testing.assert_allclose(distance[good], nearest[good], rtol=1e-12)
    c = soup.corners[which]
    plain = np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0])
    assert angle_between(-plain, normal)[good].max() < 1e-12
    # and nothing that misses is called a hit
    assert not (good & ~np.isfinite(nearest)).any()


@needs_embree
def test_a_ray_on_an_edge_is_left_to_the_tree():
    window = clacad.prescribe(clacad.load("designs/slab.toml").with_cells((3, 3)))
    soup = soup_of(window)
    flat = soup.corners[soup.corners[..., 2].mean(axis=1) < 0.5 * sum(window.z_range)][:200]
    middles = 0.5 * (flat[:, 0] + flat[:, 1])
    start = middles - [0.0, 0.0, 1.0]
    up = np.tile([0.0, 0.0, 1.0], (len(start), 1))
    _, _, good = embree._hit(embree.BodyTree.of(soup.corners), start, up, entering=True)
    assert not good.any()


@pytest.mark.slow
def test_without_the_package_a_file_is_searched_by_the_tree_and_asking_for_embree_says_so(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(embree, "installed", lambda: False)
    design = clacad.load("designs/slab.toml").with_cells((2, 2))
    clacad.export(design, tmp_path, ("stl",), quads=4)
    window = clacad.prescribe(design)
    rays = bundle(window, 500, design.check.field).rays
    found = clacad.trace(window, rays, rung="mesh", mesh=tmp_path / "slab.stl")
    assert (found.fate == clacad.Fate.ALIVE).sum() > 300
    with pytest.raises(ValueError, match="needs the package embreex"):
        read_soup(tmp_path / "slab.stl", window, "embree")
