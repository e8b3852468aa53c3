"""Prepared data of a tracer: the same light as prepared again, from threads, after pickling, and freed with its window."""

from __future__ import annotations

import gc
import pickle
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from weakref import ref

import numpy as np
import pytest
from oracle.windows import biconvex, slab

import clacad
from clacad.formats.mesh import stl
from clacad.optics.rays import Rays, TraceResult
from clacad.tracing import trace as tracers
from clacad.tracing.facets import triangle_soup as meshes
from clacad.tracing.facets import triangle_soup as soups
from clacad.tracing.layout import prepared


def beam(window: Any, count: int = 300) -> Rays:
    """Rays all over the sheet, a little oblique."""
    rng = np.random.default_rng(5)
    x0, x1, y0, y1 = window.lattice.extent()
    place = rng.uniform((x0, y0), (x1, y1), (count, 2))
    direction = np.column_stack([rng.uniform(-0.02, 0.02, (count, 2)), np.ones(count)])
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    return Rays(np.column_stack([place, np.full(count, window.z_range[0])]) - 0.01 * direction, direction)


def same(one: TraceResult, other: TraceResult) -> bool:
    """Whether all numbers of two results are the same bits."""
    columns = ("position", "direction", "fate", "optical_path", "cell", "order", "surface", "flux")
    return all(getattr(one, c).tobytes() == getattr(other, c).tobytes() for c in columns)


def written(window: Any, path: Path, quads: int) -> Path:
    """The sheet's own triangles, written by hand as one binary STL in the window's unit."""
    mesh = clacad.tessellate(window, quads=quads)
    corners = np.concatenate([rows for body in mesh.bodies for rows in body.rows()])
    record = np.zeros(len(corners), dtype=stl.FACET)
    record["corners"] = corners
    path.write_bytes(b"\0" * 80 + np.uint32(len(corners)).tobytes() + record.tobytes())
    return path


@pytest.mark.parametrize("rung", ["law", "thin", "surfaces"])
def test_a_tracer_called_twice_from_threads_and_after_pickling_gives_the_same_bits(rung: Any):
    window = slab(count=(4, 4))
    made = clacad.Tracer(window, rung=rung, path="size")
    rays = beam(window)
    first = made(rays)
    with ThreadPoolExecutor(4) as pool:
        assert all(same(first, other) for other in pool.map(made, [rays] * 8))
    assert same(first, pickle.loads(pickle.dumps(made))(rays))
    assert same(first, clacad.trace(window, rays, rung, path="size"))


@pytest.mark.slow
def test_a_mesh_is_laid_out_once_for_all_calls_and_again_for_other_normals(monkeypatch: pytest.MonkeyPatch):
    window = slab(count=(3, 3))
    mesh, rays, laid = clacad.tessellate(window, quads=4), beam(window), []
    lay_out = meshes.lay_out_mesh
    monkeypatch.setattr(meshes, "lay_out_mesh", lambda *given: laid.append(given) or lay_out(*given))
    first = clacad.trace(window, rays, "mesh", mesh=mesh)
    assert same(first, clacad.trace(window, rays, "mesh", mesh=mesh))
    assert len(laid) == 1
    clacad.trace(window, rays, "mesh", mesh=mesh, normals="vertex")
    assert len(laid) == 2
    made = pickle.loads(pickle.dumps(clacad.Tracer(window, rung="mesh", mesh=mesh)))
    assert same(first, made(rays))


@pytest.mark.slow
def test_a_file_of_triangles_is_read_once_until_it_changes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    window = slab(count=(3, 3))
    rays, read = beam(window), []
    read_soup = soups.read_soup
    monkeypatch.setattr(soups, "read_soup", lambda *given: read.append(given) or read_soup(*given))
    path = written(window, tmp_path / "sheet.stl", 4)
    coarse = clacad.trace(window, rays, "mesh", mesh=path)
    assert same(coarse, clacad.trace(window, rays, "mesh", mesh=str(path)))
    assert len(read) == 1
    kept = clacad.Tracer(window, rung="mesh", mesh=path)
    written(window, path, 8)
    fine = clacad.trace(window, rays, "mesh", mesh=path)
    assert len(read) == 2
    assert not same(coarse, fine)
    assert same(coarse, kept(rays))


@pytest.mark.slow
def test_a_window_and_all_that_was_laid_out_for_it_end_together():
    window, mesh = slab(count=(3, 3)), clacad.tessellate(slab(count=(3, 3)), quads=4)
    clacad.trace(window, beam(window), "mesh", mesh=mesh)
    ends = [ref(window), ref(prepared(window)["layout"]), ref(prepared(window)["facets"][2])]
    assert not prepared(pickle.loads(pickle.dumps(window)))
    del window, mesh
    gc.collect()
    assert [end() for end in ends] == [None, None, None]


def test_size_alone_decides_where_repeatable_bits_are_asked_for_and_loaded_kernels_where_not(
    monkeypatch: pytest.MonkeyPatch,
):
    window = biconvex(count=(4, 4))
    rays = beam(window)
    plain = clacad.trace(window, rays, path="numpy")
    clacad.trace(window, rays, path="numba")  # loads the kernels
    ran: list[str] = []
    for name in ("_compiled", "_by_numpy"):
        run = getattr(tracers, name)
        monkeypatch.setattr(
            tracers, name, lambda *a, name=name, run=run, **k: ran.append(name) or run(*a, **k)
        )
    assert same(clacad.trace(window, rays, path="size"), plain)
    quick = clacad.trace(window, rays)
    assert ran == ["_by_numpy", "_compiled"]
    assert (quick.fate == plain.fate).all()
    assert (quick.cell == plain.cell).all()
    alive = plain.fate == 0
    assert np.abs(quick.direction[alive] - plain.direction[alive]).max() <= 1.4e-15


def test_words_that_are_not_known_are_refused_with_those_that_are():
    with pytest.raises(ValueError, match='path is \'fast\', not "numpy", "numba", "size" or None'):
        clacad.Tracer(slab(count=(3, 3)), path="fast")  # type: ignore[arg-type]
