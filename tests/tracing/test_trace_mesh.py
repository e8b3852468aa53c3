"""Rung "mesh": against every triangle of the expanded mesh, and its convergence to the exact surfaces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracle.windows import PITCH, beam, biconvex, collection

from clacad.effects.trace import trace
from clacad.mesh import tessellate
from clacad.optics.rays import Fate, Rays
from clacad.scene.sections import SHEET
from clacad.tracing.facets.triangle_soup import TriangleSoup

WINDOWS = collection()


def small(window):
    """The same window with a few cells, so that every ray can be compared with every triangle."""
    return window.with_cells((5, 4))


def nearest(corners, normals, start, ray, least):
    """Distance to the first triangle ahead of one ray and its number, by testing all of them."""
    along = normals @ ray
    with np.errstate(divide="ignore", invalid="ignore"):
        t = ((corners[:, 0] - start) * normals).sum(axis=1) / along
        point = start + t[:, None] * ray
        inside = np.ones(len(t), dtype=bool)
        for k in range(3):
            edge = corners[:, (k + 1) % 3] - corners[:, k]
            inside &= (np.cross(edge, point - corners[:, k]) * normals).sum(axis=1) >= 0
    t = np.where(inside & (t > least) & (along != 0), t, np.inf)
    k = int(np.argmin(t))
    return (t[k], k) if np.isfinite(t[k]) else (None, -1)


def snell(ray, normal, n1, n2):
    """Textbook vector form; None at total reflection."""
    normal = normal / np.linalg.norm(normal)
    normal = normal if ray @ normal > 0 else -normal
    cosine = ray @ normal
    radicand = n2 * n2 - n1 * n1 * (1 - cosine * cosine)
    return None if radicand < 0 else (n1 * ray + (np.sqrt(radicand) - n1 * cosine) * normal) / n2


def follow(bodies, indices, start, ray):
    """Fate and direction of one ray through the triangles of every body in turn."""
    ray, least = ray / np.linalg.norm(ray), 1e-9 * PITCH
    for (corners, normals), index in zip(bodies, indices):
        t, k = nearest(corners, normals, start, ray, -np.inf if (corners is bodies[0][0]) else least)
        if k < 0:
            return "PASSED", ray
        if t < 0:
            return "MISSED", ray
        for n1, n2, sense in ((1.0, index, -1), (index, 1.0, 1)):
            wall = abs(normals[k, 2]) < 0.05 * np.linalg.norm(normals[k])
            if wall or (normals[k] @ ray) * sense <= 0:
                return "WALL", ray
            start = start + t * ray
            out = snell(ray, normals[k], n1, n2)
            if out is None:
                return "TIR", ray
            ray = out
            if sense > 0 and ray[2] <= 0:
                return "BACKWARD", ray
            t, k = nearest(corners, normals, start, ray, least)
            if sense < 0 and k < 0:
                return "LOST", ray
        if k >= 0:
            return "WALL", ray
    return "THROUGH", ray


@pytest.mark.ci_cases("web", "hexagonal", "round slab with seam")
@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n in WINDOWS if n not in ("baffle", "opaque seam", "round of cells")])
def test_every_ray_does_what_all_triangles_together_say(name):
    window = small(WINDOWS[name])
    if window.outline is not None:
        window = replace(window, outline=None) if window.form != "slab" else window
    mesh = tessellate(window, quads=4)
    bodies = []
    for body in mesh.bodies:
        corners = np.concatenate(list(body.rows()))
        bodies.append((corners, np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])))
    position, direction = beam(window, 250, 13, steepest=0.9, spread=-0.5)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    indices = [b.index for b in window.bodies]
    told = [follow(bodies, indices, position[ray], direction[ray]) for ray in range(250)]
    for path in ("numba", "numpy"):
        result = trace(window, Rays(position, direction), rung="mesh", mesh=mesh, path=path)
        wrong = []
        for ray, (name_found, out) in enumerate(told):
            fate = Fate(result.fate[ray]).name
            if name_found == "THROUGH":
                same = fate in ("ALIVE", "GHOST", "LAND")
                same &= bool(np.abs(out - result.direction[ray]).max() < 1e-7)
            elif name_found == "PASSED":
                same = fate in ("MISSED", "LAND")
            else:
                same = fate == name_found
            if not same:
                wrong.append((ray, name_found, fate))
        # the mesh's land ring is a polygon where the outline is round
        assert len(wrong) <= (2 if window.outline is not None else 0), wrong


@pytest.mark.ci_cases("holes outside the rim", "opaque seam", "hexagonal", "round slab with seam")
@pytest.mark.slow
@pytest.mark.parametrize("name", WINDOWS)
def test_numpy_and_kernels_find_the_same_among_facets(name):
    window = WINDOWS[name]
    steep, shallow = beam(window, 1500, 21), beam(window, 1500, 22, steepest=0.1)
    position, direction = (np.concatenate(both) for both in zip(steep, shallow))
    rays, mesh = Rays(position, direction), tessellate(window, quads=6)
    for normals in ("facet", "vertex"):
        one, other = (
            trace(window, rays, rung="mesh", mesh=mesh, normals=normals, record=True, path=path)
            for path in ("numpy", "numba")
        )
        for column in ("fate", "cell", "order", "surface"):
            assert np.array_equal(getattr(one, column), getattr(other, column)), column
        apart = np.abs(one.direction - other.direction).max(axis=1)
        assert apart[1500:].max() <= 2e-15  # either is within 1e-15 of the truth
        near_total_reflection = 1e-13
        assert apart.max() <= (2e-15 if normals == "facet" else near_total_reflection)
        for column in ("position", "hits", "directions"):
            here, there = getattr(one, column), getattr(other, column)
            assert np.abs(here - there).max() <= 1e-13 * max(1.0, np.abs(there).max())


def test_few_rays_through_the_sheets_own_mesh_ask_for_no_kernel_where_their_number_decides(monkeypatch):
    def asked(*_):
        raise AssertionError("a kernel was asked for")

    window = small(WINDOWS["paper base"])
    rays = Rays(*beam(window, 500, 5))
    known = trace(window, rays, rung="mesh", mesh=8, path="numpy")
    monkeypatch.setattr("clacad.tracing.compiled.chunk.trace_chunk", asked)
    found = trace(window, rays, rung="mesh", mesh=8, path="size")
    assert np.array_equal(found.direction, known.direction)
    with pytest.raises(AssertionError, match="asked for"):
        trace(window, rays, rung="mesh", mesh=8)


def errors(window, normals, quads):
    position, direction = beam(window, 4000, 3, steepest=0.1, spread=-5.0)
    rays = Rays(position, direction)
    exact = trace(window, rays)
    rms = []
    for q in quads:
        found = trace(window, rays, rung="mesh", mesh=tessellate(window, quads=q), normals=normals)
        both = (exact.fate == Fate.ALIVE) & (found.fate == Fate.ALIVE)
        assert both.sum() > 1000
        rms.append(np.sqrt((np.cross(exact.direction[both], found.direction[both]) ** 2).sum(axis=1).mean()))
    return np.array(rms)


@pytest.mark.ci_cases("hexagonal-facet-1.0", "biconic slab-vertex-2.0", "plano outside-facet-1.0")
@pytest.mark.slow
@pytest.mark.parametrize(("normals", "order"), [("facet", 1.0), ("vertex", 2.0)])
@pytest.mark.parametrize("name", ["paper base", "hexagonal", "galilean", "biconic slab", "plano outside"])
def test_facets_converge_at_first_order_and_vertex_normals_at_second(name, normals, order):
    quads = np.array([8, 16, 32, 64])
    rms = errors(WINDOWS[name], normals, quads)
    slope = -np.polyfit(np.log(quads), np.log(rms), 1)[0]
    # facets: a coarse facet of lens 1 also throws light far across lens 2, which adds to the error there
    assert slope == pytest.approx(order, abs=0.15 if normals == "facet" else 0.06)


@pytest.mark.slow
def test_the_error_of_facets_is_what_their_slope_error_says():
    # contract: (n − 1) √2 sqrt(σ₂² + (σ₁/η)²) per meridian, σ = .41 L/R; measured 13.6 mrad at 16 quads
    window = biconvex(thickness=0.0009)
    rms = errors(window, "facet", [16])[0]
    assert 0.011 < rms < 0.016


@pytest.mark.ci_cases("tilted by 20 degrees", "opaque seam", "hexagonal", "round slab with seam")
@pytest.mark.slow
@pytest.mark.parametrize("name", WINDOWS)
def test_no_ray_is_lost_among_facets(name):
    window = WINDOWS[name]
    position, direction = beam(window, 3000, 4)
    direction[7] = 0.0
    mesh = tessellate(window, quads=6)
    for normals in ("facet", "vertex"):
        result = trace(
            window, Rays(position, direction), rung="mesh", mesh=mesh, normals=normals, record=True
        )
        assert sum(result.counts().values()) == 3000
        sound = result.fate != Fate.INVALID
        assert sound.sum() == 2999
        for column in (result.position, result.direction, result.optical_path):
            assert np.isfinite(column[sound]).all()
        assert np.isfinite(result.hits[:, sound]).all()
        on = result.fate <= Fate.LAND
        np.testing.assert_allclose(np.linalg.norm(result.direction[on], axis=1), 1.0, atol=1e-14)


@pytest.mark.slow
def test_fates_go_over_into_those_of_the_surfaces():
    window = WINDOWS["web"]
    rays = Rays(*beam(window, 3000, 5))
    exact = trace(window, rays, path="numpy")
    off = []
    for quads in (6, 48):
        found = trace(window, rays, rung="mesh", mesh=tessellate(window, quads=quads), normals="vertex")
        off.append((found.fate != exact.fate).mean())
    assert off[1] < 0.003
    assert off[0] < 0.03


def test_a_mesh_of_another_window_is_refused():
    rays = Rays([[0, 0, -1]], [[0, 0, 1]])
    with pytest.raises(ValueError, match="other bodies"):
        trace(biconvex(), rays, rung="mesh", mesh=tessellate(WINDOWS["biconic slab"], quads=4))
    with pytest.raises(ValueError, match="normals is 'smooth'"):
        trace(biconvex(), rays, rung="mesh", mesh=tessellate(biconvex(), quads=4), normals="smooth")


@pytest.mark.slow
def test_the_sheets_own_mesh_is_traced_where_none_is_given_or_only_how_fine():
    window = WINDOWS["web"].with_cells((5, 4))
    rays = Rays(*beam(window, 500, 3))
    for given, quads in ((None, 16), (5, 5)):
        found = trace(window, rays, rung="mesh", mesh=given)
        own = trace(window, rays, rung="mesh", mesh=tessellate(window, quads=quads))
        assert found.direction.tobytes() == own.direction.tobytes()
        assert (found.fate == own.fate).all()
    assert SHEET["quads"].default == 16, "a scene and a trace of the same sheet have the same mesh"
    with pytest.raises(ValueError, match="quads = 0"):
        trace(window, rays, rung="mesh", mesh=0)


def soup_of(mesh):
    """The mesh's triangles, known by nothing but their corners, in a random order."""
    corners = np.concatenate([np.concatenate(list(body.rows())) for body in mesh.bodies])
    return TriangleSoup(corners[np.random.default_rng(0).permutation(len(corners))])


@pytest.mark.ci_cases("web", "hexagonal", "round slab with seam")
@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n in WINDOWS if n != "round of cells"])
def test_triangles_from_anywhere_do_what_the_sheets_own_mesh_does(name):
    window = WINDOWS[name].with_cells((9, 8))
    mesh = tessellate(window, quads=6)
    rays = Rays(*beam(window, 3000, 17, steepest=1.2))
    own = trace(window, rays, rung="mesh", mesh=mesh)
    found = trace(window, rays, rung="mesh", mesh=soup_of(mesh))
    same = (own.fate == found.fate) & (own.order == found.order).all(axis=1)
    # a border of land that is round is a polygon in the triangles; elsewhere only rays through an edge may differ
    assert (~same).mean() < (0.02 if window.outline is not None else 0.001)
    on = same & (own.fate <= Fate.LAND) & (own.surface >= 0)
    np.testing.assert_allclose(own.direction[on], found.direction[on], rtol=0, atol=1e-7)


@pytest.mark.slow
def test_a_file_is_traced_like_the_mesh_it_was_written_from(tmp_path):
    window = biconvex(count=(9, 8))
    mesh = tessellate(window, quads=6)
    corners = np.concatenate([np.concatenate(list(body.rows())) for body in mesh.bodies])
    file = tmp_path / "sheet.stl"
    record = np.zeros(len(corners), dtype=[("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")])
    record["c"] = corners * 1000.0  # millimetres, which the file cannot record
    file.write_bytes(b" " * 80 + np.uint32(len(corners)).tobytes() + record.tobytes())
    rays = Rays(*beam(window, 3000, 18, steepest=0.4))
    own = trace(window, rays, rung="mesh", mesh=mesh)
    found = trace(window, rays, rung="mesh", mesh=file)
    assert (own.fate == found.fate).mean() > 0.995
    both = (own.fate == Fate.ALIVE) & (found.fate == Fate.ALIVE)
    error = np.linalg.norm(np.cross(own.direction[both], found.direction[both]), axis=1)
    assert np.sqrt((error**2).mean()) < 2e-4  # corners rounded to float32: spacing over facet
    with pytest.raises(ValueError, match="has none"):
        trace(window, rays, rung="mesh", mesh=file, normals="vertex")
    with pytest.raises(ValueError, match="no unit fits"):
        trace(biconvex(count=(9, 7)), rays, rung="mesh", mesh=file)


@pytest.mark.slow
def test_cells_written_as_touching_solids_pass_light_through_their_common_walls():
    window = biconvex(count=(9, 8), thickness=0.0012)
    fused = tessellate(window, quads=6)
    one = tessellate(window.with_cells((1, 1)), quads=6)
    corners = []
    for array, body in enumerate(one.bodies):
        own = np.concatenate(list(body.rows()))
        own = own - np.append(window.shifts[array], 0.0)
        for centre in window.lattice.centres(window.lattice.cells()) + window.shifts[array]:
            corners.append(own + np.append(centre, 0.0))
    rays = Rays(*beam(window, 3000, 19, steepest=0.5))
    apart = trace(window, rays, rung="mesh", mesh=TriangleSoup(np.concatenate(corners)))
    whole = trace(window, rays, rung="mesh", mesh=fused)
    # copies are rounded each in their own place; rays within that of a border may end in the gap
    assert (apart.fate == whole.fate).mean() > 0.999
    assert (whole.fate == Fate.GHOST).sum() > 100
