"""Every kernel the same on the hard list: numpy, compiled, facets, and whole windows by every path.

The scalar kernels are driven surface by surface through the list of rays; windows go through `trace` by both of
paths. Facets are exact where the surfaces are planes, so rung "mesh" is compared with those.
"""

from __future__ import annotations

import inspect
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from called_parts import called
from hard.measure import ULP, assert_whole, error, fate_of, interfaces, off, relative
from hard.paths import PAGE, PATHS, faceted, turned_by_facets
from hard.rays import HARD
from hard.sheets import SHEETS, window_of
from mpmath import mp, mpf
from oracle import law as law_oracle
from oracle import sheet as sheet_oracle
from oracle import trace as trace_oracle

from clacad import tessellate, trace
from clacad.optics.rays import NO_CELL, Fate, Rays
from clacad.optics.sequence import (
    largest,
    launch,
    pass_on,
    to_sheet,
    to_surface,
    trace_sequence,
    unit_directions,
)
from clacad.optics.surface import Biconic, EvenPolynomial, Quadric, meet
from clacad.tracing.compiled import packing as slot

numba = pytest.importorskip("numba")
from clacad.tracing.compiled import face as kernel  # noqa: E402  (needs numba)


def packed(surface):
    """A surface as the row of numbers that kernels read."""
    row = np.zeros(slot.FACE_NUMBERS)
    row[slot.CX], row[slot.CY], row[slot.SIDE] = surface.curvature_x, surface.curvature_y, surface.side
    if isinstance(surface, Quadric):
        row[slot.KX] = surface.kappa
    else:
        row[slot.BICONIC], row[slot.KX], row[slot.KY] = 1.0, surface.conic_x, surface.conic_y
    if isinstance(surface, EvenPolynomial):
        row[slot.BICONIC] = slot.POLYNOMIAL
        row[slot.A40 : slot.A08 + 1] = (*surface.a4, *surface.a6, *surface.a8)
    return row


def test_python_is_told_that_it_cannot_call_a_part():
    with pytest.raises(TypeError):
        kernel.snell((0.0, 0.0, 1.0), (-0.5, 0.0, 1.0), 1.0, 1.0, 1.5)


def kernel_meet(surface, point, ray):
    """The compiled `meet` of one surface, packed as one row; some kernels take the table and the row's number."""
    row = packed(surface)
    by_number = "row" in inspect.signature(kernel.meet.py_func).parameters
    return called(kernel.meet)(*((row[None], 0) if by_number else (row,)), *point, *ray)


def by_kernel(case):
    """Fate, direction and path of one ray, each surface by the compiled `meet` and `snell`."""
    seq = interfaces(case.faces)
    ray, scaled = unit_directions(np.array([case.direction], dtype=float))
    offset, travelled = launch(np.array([case.start], dtype=float), scaled, seq[0].vertex)
    path = 0.0
    for k, face in enumerate(seq):
        if k:
            offset, travelled = pass_on(offset, seq[k - 1].vertex, face.vertex), np.zeros(1)
        start, local = to_surface(face.rotation, offset), to_surface(face.rotation, ray)
        t, x, y, z, gx, gy, gz, root = kernel_meet(face.surface, start[0], local[0])
        if not np.isfinite(t):
            return Fate.MISSED, ray[0], path
        out = called(kernel.snell)(tuple(local[0]), (gx, gy, gz), root, face.index_before, face.index_after)
        if np.isnan(out[0]):
            return Fate.TIR, ray[0], path
        if t + travelled[0] < -8 * ULP * (largest(start)[0] + abs(t)):
            return Fate.MISSED, ray[0], path
        path += face.index_before * (t + travelled[0])
        offset, ray = to_sheet(face.rotation, np.array([[x, y, z]])), to_sheet(face.rotation, np.array([out]))
    return (Fate.ALIVE if ray[0, 2] > 0 else Fate.BACKWARD), ray[0], path


@pytest.mark.daily_share(3)
@pytest.mark.parametrize("case", HARD, ids=[case.name for case in HARD])
def test_the_compiled_surfaces_treat_a_hard_ray_as_the_oracle_does(case):
    exact = trace_oracle.trace(case.faces, case.start, case.direction)
    fate, direction, path = by_kernel(case)
    numpy_path = trace_sequence(interfaces(case.faces), Rays([case.start], [case.direction]))
    assert fate == numpy_path.fate[0], case.why
    if case.undecidable:
        return
    assert fate == fate_of(exact), case.why
    if exact.status == "ok":
        condition = max(1.0, float(trace_oracle.condition(case.faces, case.start, case.direction)))
        assert off(direction, exact.directions[-1]) <= 4 * condition, case.why
        assert abs(path - numpy_path.optical_path[0]) <= 4 * ULP * condition * abs(path)


@pytest.mark.parametrize("seed", range(3))
def test_compiled_and_numpy_biconics_agree_on_rays_from_everywhere(seed):
    rng = np.random.default_rng(seed)
    for _ in range(8):
        size = 10.0 ** rng.uniform(-3, 3)
        surface = Biconic(*(rng.uniform(-1, 1, 2) / size), *rng.uniform(-3, 3, 2), int(rng.choice([-1, 1])))
        start, ray = rng.normal(0, 3 * size, (150, 3)), rng.normal(0, 1, (150, 3))
        ray /= np.linalg.norm(ray, axis=1)[:, None]
        expected = meet(surface, start, ray)
        got = np.array([kernel_meet(surface, p, d) for p, d in zip(start, ray)])
        both = np.isfinite(expected.distance) & np.isfinite(got[:, 0])
        assert (
            np.isfinite(expected.distance) == np.isfinite(got[:, 0])
        ).mean() > 0.99  # the rest grazes the equator
        steep = np.abs((expected.gradient * ray).sum(axis=1)) > 1e-3 * np.linalg.norm(
            expected.gradient, axis=1
        )
        apart = np.abs(expected.distance - got[:, 0])[both & steep]
        assert (apart <= 1e-9 * size).mean() > 0.99


@cache
def oracle_of(name):
    """Result of the oracle for a case, and its condition: the same for every path."""
    case = next(case for case in SHEETS if case.name == name)
    window = window_of(dict(case.changes))
    exact = sheet_oracle.trace(window, case.start, case.direction)
    decided = not case.undecidable and exact.fate != "MISSED"
    return exact, float(sheet_oracle.condition(window, case.start, case.direction)) if decided else 1.0


@pytest.mark.daily_share(3)
@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("case", SHEETS, ids=[case.name for case in SHEETS])
def test_a_hard_ray_through_a_whole_sheet_is_traced_as_the_oracle_does(case, path):
    window = window_of(dict(case.changes))
    exact, condition = oracle_of(case.name)
    result = PATHS[path](window, Rays([case.start], [case.direction]))
    assert_whole(result, 1)
    if case.undecidable:
        return
    assert Fate(result.fate[0]).name == exact.fate, case.why
    if exact.fate == "MISSED":
        assert (result.cell == NO_CELL).all()
        return
    assert tuple(result.cell[0]) == exact.cells[0], case.why
    assert tuple(result.cell[0] + result.order[0]) == exact.cells[-1], case.why
    apart = law_oracle.angle(result.direction[0], exact.direction)
    assert apart <= 4 * ULP * max(1.0, condition), case.why
    # light that leaves glass n times as dense leaves with n² times the error of its direction's length
    dense = max(body.index for body in window.bodies)
    assert abs(np.linalg.norm(result.direction[0]) - 1) <= 4 * ULP * dense**2
    gone = float(exact.optical_path)
    assert error(result.optical_path, [exact.optical_path]) <= 8 * ULP * condition * abs(gone)
    assert error(result.position[0], exact.position) <= 8 * ULP * (
        np.abs(result.position[0]).max() + abs(gone)
    )


@pytest.mark.parametrize("seed", range(6))
def test_the_kernel_tells_a_nearly_tangent_ray_from_a_miss_to_the_last_bit(seed):
    rng, sphere, centre = np.random.default_rng(seed), Quadric(1, 1, 1), np.array([0.0, 0.0, 1.0])
    direction = np.append(rng.uniform(-1, 1, 2), rng.uniform(0.2, 0.9))
    below = direction * direction[2] - centre * (direction @ direction) + 0.5 * np.cross(direction, centre)
    touching = centre + below / np.linalg.norm(below)
    for step in range(-40, 41):
        start = touching - rng.uniform(0.5, 3) * direction + below * step * 2.0**-53
        exact = trace_oracle.trace([trace_oracle.quadric(1, 1, 1, after=1.0)], start, direction)
        assert np.isfinite(kernel_meet(sphere, start, direction)[0]) == (exact.status == "ok")


@pytest.mark.parametrize("step", [1e-6, 1e-10, -1e-13])
def test_the_kernel_tells_how_little_a_small_index_step_bends(step):
    """An axial ray on a slope of 1/2: its x component behind is the bending alone, and keeps its digits."""
    out = called(kernel.snell)((0.0, 0.0, 1.0), (-0.5, 0.0, 1.0), 1.0, 1.0, 1 + step)
    with mp.workdps(60):
        length2, mu = mpf(5) / 4, 1 / mpf(1 + step)
        bend = mp.sqrt(1 - mu**2 * (1 - 1 / length2)) / mp.sqrt(length2) - mu / length2
        assert relative(out[0], -bend / 2) <= 4


@pytest.mark.parametrize("path", ["numpy", "numba"])
@pytest.mark.parametrize("power", [10, 20, 30])
def test_the_distance_of_the_source_costs_a_sheet_nothing(path, power):
    # everything in binary fractions, so that both starts lie on the very same line
    window = window_of({"lattice.pitch": 2.0**-8})
    near, ray = np.array([[3 * 2.0**-12, 5 * 2.0**-12, -(2.0**-5)]]), np.array([[2.0**-5, -3 * 2.0**-7, 1.0]])
    one = trace(window, Rays(near, ray), path=path)
    far = trace(window, Rays(near - 2.0**power * ray, ray), path=path)
    assert one.fate[0] == far.fate[0] == Fate.ALIVE
    assert np.array_equal(one.cell, far.cell)
    np.testing.assert_allclose(far.direction, one.direction, rtol=0, atol=4 * ULP)
    np.testing.assert_allclose(far.position, one.position, rtol=0, atol=4 * ULP)


@pytest.mark.slow
@pytest.mark.parametrize("case", SHEETS, ids=[case.name for case in SHEETS])
def test_facets_give_the_same_fate_and_cell_and_nearly_the_same_direction(case):
    """Rung mesh: facets of slope error e turn light by a few e, telescopes multiply it by 1/η.

    Where a case records that facets cannot decide it, the test shows why: the exact ray passes a border of a lens, or the
    start lies before a face, nearer than the facets' error.
    """
    window, mesh = faceted(case)
    rays = Rays([case.start], [case.direction])
    exact, result = trace(window, rays, record=True), trace(window, rays, rung="mesh", mesh=mesh)
    assert_whole(result, 1)
    bound = turned_by_facets(window, mesh)
    if case.facets:
        z = exact.hits[:, 0, 2]
        near_face = abs(z[0] - case.start[2]) <= mesh.sag_error
        cell = exact.cell[0] + exact.order[0]
        across = exact.hits[-1, 0, :2] - window.shifts[1] - window.lattice.centres(cell[None])[0]
        to_border = np.abs(0.5 * np.array(window.lattice.pitch) - np.abs(across)).min()
        assert near_face or to_border <= bound * (z[-1] - z[0])
        return
    if case.undecidable:
        return
    assert result.fate[0] == exact.fate[0], case.why
    assert np.array_equal(result.cell, exact.cell)
    assert np.array_equal(result.order, exact.order)
    assert law_oracle.angle(result.direction[0], exact.direction[0]) <= bound


def test_few_cases_are_beyond_facets_and_the_page_counts_them():
    beyond = [case for case in SHEETS if case.facets or case.undecidable]
    assert len(beyond) <= 4
    text = PAGE.read_text(encoding="utf-8")
    assert f"of {len(SHEETS)} cases" in text
    assert "differs" not in text
    assert "beyond its error" not in text
    for case in SHEETS:
        assert text.count(f"| {case.name} |") == 1
    for case in beyond:
        assert f"**{case.name}**" in text


@pytest.mark.slow
def test_facets_of_planes_are_exact():
    """A sheet as good as flat (R = 1e12): facets and surfaces are the same, to rounding."""
    window = window_of({"lattice.count": [5, 5]})
    flat = {1: Quadric(1e-12, 1e-12, 1e-12, 1), -1: Quadric(1e-12, 1e-12, 1e-12, -1)}
    bodies = tuple(
        replace(b, front=replace(b.front, surface=flat[1]), back=replace(b.back, surface=flat[-1]))
        for b in window.bodies
    )
    window = replace(window, bodies=bodies)
    rng = np.random.default_rng(4)
    start = np.column_stack([rng.uniform(-0.01, 0.01, (200, 2)), np.full(200, -0.01)])
    rays = Rays(start, np.column_stack([rng.uniform(-0.1, 0.1, (200, 2)), np.ones(200)]))
    exact, faceted = trace(window, rays), trace(window, rays, rung="mesh", mesh=tessellate(window, quads=4))
    assert np.array_equal(exact.fate, faceted.fate)
    assert np.array_equal(exact.cell, faceted.cell)
    np.testing.assert_allclose(faceted.direction, exact.direction, rtol=0, atol=1e-11)
    # vertices lie on the grid of single precision that STL files have
    np.testing.assert_allclose(faceted.position, exact.position, rtol=0, atol=2 * 0.0505 * 2.0**-24)
