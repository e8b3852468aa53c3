"""Squares of triangles from any source decide no ray otherwise than the trees do, and decide most of them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from oracle.windows import biconvex, slab

import clacad
from clacad.tracing import trace as tracer
from clacad.tracing.facets import triangle_soup as soups
from clacad.tracing.facets.hierarchy import hierarchy
from clacad.tracing.facets.squares import NO_SQUARES, find_squares
from clacad.tracing.facets.triangle_soup import TriangleSoup

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
from fates import all_directions, windows
from peer_jobs import beam

sys.path.pop(0)
WINDOWS = windows()
CELLS = {"square": slab(count=(8, 8)), "hexagonal": slab(eta=(-0.5, -0.5), kind="hexagonal", count=(8, 8))}


def soup(window, quads):
    """The sheet's own triangles as a file gives them: in float32, in no order."""
    mesh = clacad.tessellate(window, quads=quads)
    corners = np.concatenate([rows for body in mesh.bodies for rows in body.rows()])
    return TriangleSoup(np.random.default_rng(1).permutation(corners).astype(np.float32).astype(float))


def without_squares(window, triangles, rays):
    """The same trace by the trees alone."""
    facets = soups.facets_of(window, triangles, "facet")
    found_in = facets.found_in._replace(squares=NO_SQUARES)
    return tracer._compiled(facets.layout, rays, 0, 1, found_in)


def both_ways(window, triangles, rays):
    """Rays through triangles with and without squares; their fates, cells, orders and surfaces are the same."""
    found = clacad.trace(window, rays, "mesh", mesh=triangles)
    wanted = without_squares(window, triangles, rays)
    for column in ("fate", "cell", "order", "surface"):
        assert (getattr(found, column) == getattr(wanted, column)).all(), column
    return found, wanted


@pytest.mark.ci_cases(
    "paper base", "web", "hexagonal", "round slab with seam", "biconvex tilted by 15 degrees"
)
@pytest.mark.slow
@pytest.mark.parametrize("name", WINDOWS)
def test_rays_end_as_they_do_in_the_trees(name):
    window = WINDOWS[name]
    triangles, rays = soup(window, 6), all_directions(window, 2000, 3)
    found, wanted = both_ways(window, triangles, rays)
    alive = wanted.fate <= 1
    assert np.abs(found.direction - wanted.direction)[alive].max(initial=0.0) <= 1.4e-15
    assert np.abs(found.position - wanted.position)[alive].max(initial=0.0) <= 4e-15
    assert np.abs(found.optical_path - wanted.optical_path)[alive].max(initial=0.0) <= 1e-14


def damaged(corners, how, seed):
    """Facets twice, gone, torn from their neighbours at one corner, or under a roof of their own."""
    rng = np.random.default_rng(seed)
    few = rng.choice(len(corners), len(corners) // 40, replace=False)
    if how == "gone":
        return np.delete(corners, few, axis=0)
    if how == "torn":
        torn = corners.copy()
        torn[few, rng.integers(0, 3, len(few)), 2] += 1e-6
        return torn
    more = corners[few] + (0.0, 0.0, 2e-6 if how == "roofed" else 0.0)
    return np.concatenate([corners, more])


@pytest.mark.slow
@pytest.mark.parametrize("how", ["twice", "gone", "torn", "roofed"])
def test_facets_that_are_no_whole_surface_are_met_as_in_the_trees(how):
    """A bin is looked up as two halves only where neighbours share every corner and nothing else is there."""
    window = WINDOWS["paper base"]
    rays = beam(window, 20000, 0.03, 1.0)
    triangles = TriangleSoup(damaged(soup(window, 8).corners, how, 6))
    found, wanted = both_ways(window, triangles, rays)
    alive = wanted.fate <= 1
    assert np.abs(found.direction - wanted.direction)[alive].max() <= 1.4e-15
    whole = soup(window, 8)
    assert (clacad.trace(window, rays, "mesh", mesh=whole).fate != wanted.fate).any() == (how != "twice")


@pytest.mark.parametrize("cells", CELLS)
def test_planes_of_squares_go_through_the_corners_of_their_facets(cells):
    """Compared with the corners themselves: the middle of every facet lies on the plane of the half that it is over."""
    found_in = soups.lay_out_soup(CELLS[cells], soup(CELLS[cells], 6), "facet")[1]
    trees, grid = found_in.trees, found_in.squares
    low, per, bins = grid.table[0, :2], grid.table[0, 2:4], grid.table[0, 4:6].astype(int)
    single = np.diff(np.diff(grid.odd.reshape(bins[::-1] + 1), axis=0), axis=1)
    normal = np.cross(trees.corner[:, 1] - trees.corner[:, 0], trees.corner[:, 2] - trees.corner[:, 0])
    lens = np.abs(normal[:, 2]) > 0.05 * np.linalg.norm(normal, axis=1)
    normal, middle = normal[lens], trees.corner[lens].mean(axis=1)
    middle[:, 1] -= grid.table[0, 17] * middle[:, 0]
    u, v = ((middle[:, :2] - low) * per).T
    middle[:, 1] += grid.table[0, 17] * middle[:, 0]
    i, j = u.astype(int), v.astype(int)
    side = (normal[:, 2] > 0.0).astype(int)
    split = grid.table[0, 12 + side]
    beyond = (v - j) + split * (u - i) > 0.5 + 0.5 * split
    halved = single[j, i] == 0
    assert halved.mean() > 0.7
    plane = grid.plane[2 * (j * bins[0] + i) + beyond, side][halved]
    off = np.einsum("kc,kc->k", plane[:, :3], middle[halved]) - plane[:, 3]
    assert np.abs(off / np.linalg.norm(plane[:, :3], axis=1)).max() < 4.0 * np.spacing(0.075)
    assert (plane[:, 2] > 0.0).all()


def test_bins_with_walls_off_the_rim_are_counted_in_every_rectangle_of_bins():
    window = biconvex(euler=(0.0, 0.1, 0.0), count=(3, 3))
    trees = hierarchy([np.concatenate(list(clacad.tessellate(window, quads=8).bodies[0].rows()))])[1]
    grid = find_squares(trees)
    low, per, (wide, high) = grid.table[0, :2], grid.table[0, 2:4], grid.table[0, 4:6].astype(int)
    held = grid.odd.reshape(high + 1, wide + 1)
    single = held[1:, 1:] - held[:-1, 1:] - held[1:, :-1] + held[:-1, :-1]
    assert set(np.unique(single)) == {0, 1}
    normal = np.cross(trees.corner[:, 1] - trees.corner[:, 0], trees.corner[:, 2] - trees.corner[:, 0])
    walls = trees.corner[np.abs(normal[:, 2]) < 0.01 * np.linalg.norm(normal, axis=1)]
    place = ((walls[..., :2] - low) * per) / (wide, high)
    rim = ((place.max(axis=1) < 1e-6) | (place.min(axis=1) > 1.0 - 1e-6)).any(axis=1)
    assert 0 < rim.sum() < len(walls)
    walls = walls[~rim]
    i, j = ((walls.mean(axis=1)[:, :2] - low) * per).clip(0, (wide - 1, high - 1)).astype(int).T
    assert (single[j, i] == 1).all()
    rng = np.random.default_rng(3)
    for _ in range(50):
        (i0, i1), (j0, j1) = np.sort(rng.integers(0, wide, 2)), np.sort(rng.integers(0, high, 2))
        counted = held[j1 + 1, i1 + 1] - held[j1 + 1, i0] - held[j0, i1 + 1] + held[j0, i0]
        assert counted == single[j0 : j1 + 1, i0 : i1 + 1].sum()


@pytest.mark.slow
@pytest.mark.parametrize("cells", CELLS)
def test_rays_of_a_view_are_decided_without_the_trees(cells):
    """So that a trace through a file costs about what one through the mesh in memory does."""
    from clacad.optics.ledger import Ledger
    from clacad.tracing.compiled.chunk import trace_chunk_of_triangles
    from clacad.tracing.compiled.packing import pack
    from clacad.tracing.compiled.records import Outcome

    window = CELLS[cells]
    facets = soups.lay_out_soup(window, soup(window, 16), "facet")
    rng = np.random.default_rng(4)
    x0, x1, y0, y1 = window.lattice.extent()
    direction = np.column_stack([rng.uniform(-0.005, 0.005, (4000, 2)), np.ones(4000)])
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    start = np.column_stack([rng.uniform((x0, y0), (x1, y1), (4000, 2)) * 0.7, np.full(4000, -0.001)])
    book = Ledger.blank(4000, 0)
    out = Outcome(
        book.position, book.direction, book.fate, book.optical_path, book.cell, book.order, book.surface,
        book.hits, book.directions,
    )  # fmt: skip
    layout, found_in = facets
    left = trace_chunk_of_triangles(
        found_in.trees, found_in.squares, pack(layout), np.arange(4000), start, direction, out
    )
    assert left < 0.01 * 4000
