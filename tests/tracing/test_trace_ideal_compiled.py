"""Rungs "law" and "thin" compiled: compared with the numpy path on every form, at its edges, and with 50 digits."""

from __future__ import annotations

from dataclasses import astuple, replace

import numpy as np
import pytest
from benchmarks.fates import all_directions, windows
from mpmath import mp, mpf
from oracle import law as oracle
from oracle.windows import PITCH, beam, biconvex

from clacad.effects.trace import trace
from clacad.optics.law import Law
from clacad.optics.rays import Fate, Rays
from clacad.tracing import trace as tracer
from clacad.tracing import which_path
from clacad.tracing.which_path import task, trace_seconds

WINDOWS = windows()
RUNGS = ("law", "thin")


def same_light(window, rays, rung):
    """Trace by both paths, hold one to the other, and return the compiled path's result."""
    one, two = (trace(window, rays, rung=rung, path=path) for path in ("numpy", "numba"))
    for column in ("fate", "cell", "order", "surface", "flux"):
        np.testing.assert_array_equal(getattr(one, column), getattr(two, column), column)
    np.testing.assert_allclose(two.direction, one.direction, rtol=0, atol=1.4e-15)
    way = np.maximum(PITCH, np.abs(one.optical_path))  # to a far ghost a last bit grows as the way does
    sound = one.fate != Fate.INVALID
    given, found = (np.column_stack([r.position, r.optical_path])[sound] for r in (one, two))
    size = np.maximum(way[sound, None], np.abs(given))
    np.testing.assert_array_less(np.abs(found - given), 1.4e-15 * size)
    return two


def lit(window, number, seed=0):
    """Rays along the field's middle and up to 0.1 off it, from before the sheet to all over it."""
    rng = np.random.default_rng(seed)
    x0, x1, y0, y1 = window.lattice.extent()
    slope = rng.uniform(-0.1, 0.1, (number, 2)) + np.divide(window.thin.shift, window.thin.offset[2])
    aim = rng.uniform((x0, y0), (x1, y1), (number, 2))
    return np.column_stack([aim - PITCH * slope, np.full(number, -PITCH)]), np.column_stack(
        [slope, np.ones(number)]
    )


def edge_points(window, rng):
    """Points (n, 2) of a cell at distances of 1e-15 to 1e-6 of it from its corners, its borders and its seam's."""
    tile = window.lattice.tile()
    along = rng.uniform(0.0, 1.0, (20, 1, 1))
    edges = (tile * along + np.roll(tile, -1, axis=0) * (1.0 - along)).reshape(-1, 2)
    inner = edges * (1.0 - window.land.seam / PITCH)
    points = np.concatenate([tile, edges, inner])
    distances = np.concatenate([[0.0], 10.0 ** np.arange(-15, -5)])
    away = (distances[:, None, None] * PITCH * rng.normal(size=(len(points), 2))).reshape(-1, 2)
    return np.tile(points, (len(distances), 1)) + away


def rays_at_edges(window, seed):
    """Rays through the edges of cells of lens 1, and through centres of lens 1, undeviated, to those of lens 2."""
    rng = np.random.default_rng(seed)
    points, pair = edge_points(window, rng), window.thin
    cells = window.lattice.cells()
    centre = window.lattice.centres(cells[rng.integers(len(cells), size=len(points))])
    middle = np.array([*np.divide(pair.shift, pair.offset[2]), 1.0])
    through = np.column_stack([points, np.full(len(points), pair.offset[2])]) + [*pair.shift, 0.0]
    at_one = np.column_stack([centre + points, np.zeros(len(points))])
    at_centre = np.column_stack([centre, np.zeros(len(points))])
    oblique = middle + np.column_stack([rng.uniform(-0.2, 0.2, (len(points), 2)), np.zeros(len(points))])
    aims = np.concatenate([at_one, at_one, at_centre])
    along = np.concatenate([np.tile(middle, (len(points), 1)), oblique, through / PITCH])
    return Rays(aims - 0.03 * along, along)


@pytest.mark.parametrize("rung", RUNGS)
@pytest.mark.parametrize("name", WINDOWS)
def test_both_paths_give_rays_from_all_directions_the_same_fate(name, rung):
    result = same_light(WINDOWS[name], all_directions(WINDOWS[name], 4000, 7), rung)
    assert len(np.unique(result.fate)) >= (2 if rung == "law" else 3)


@pytest.mark.parametrize("rung", RUNGS)
@pytest.mark.parametrize("name", WINDOWS)
def test_both_paths_agree_on_rays_within_rounding_of_edges(name, rung):
    same_light(WINDOWS[name], rays_at_edges(WINDOWS[name], 3), rung)


@pytest.mark.ci_cases(
    "paper base", "web", "hexagonal", "round slab with seam", "biconvex tilted by 15 degrees"
)
@pytest.mark.slow
@pytest.mark.parametrize("name", WINDOWS)
def test_both_paths_agree_on_many_rays_of_both_ideal_rungs(name):
    for rung in RUNGS:
        same_light(WINDOWS[name], all_directions(WINDOWS[name], 200_000, 8), rung)
        for seed in range(10):
            same_light(WINDOWS[name], rays_at_edges(WINDOWS[name], seed), rung)


@pytest.mark.parametrize("rung", RUNGS)
def test_rays_that_are_none_and_rays_of_insane_size_are_the_same_on_both_paths(rung):
    window = biconvex(euler=(0.3, 0.1, 0.2))
    position, direction = (np.repeat(part, 2, axis=0) for part in lit(window, 60))
    for column in range(3):
        for k, odd in enumerate((np.nan, np.inf, -np.inf, 1e300, -1e300, 1e-300, 5e-324, 0.0, -1.0)):
            position[9 * column + k, column] = odd
            direction[9 * column + k + 30, column] = odd
    direction[60] = 0.0
    direction[61:70] *= -1.0
    unscaled = Rays(position[70:80], direction[70:80])
    direction[70:75] *= 10.0 ** np.array([-300, -160, 60, 160, 300])[:, None]
    direction[75:80] *= 10.0 ** np.array([-40, -3, 1, 3, 40])[:, None]
    far = 10.0 ** np.arange(3, 33)[:, None]
    position[80:110] -= far * direction[80:110]
    result = same_light(window, Rays(position, direction), rung)
    assert (result.fate[:9] == Fate.INVALID).any()
    assert result.fate[60] == Fate.INVALID
    assert (result.fate[61:70] == Fate.MISSED).all()
    np.testing.assert_array_equal(
        result.fate[70:80], trace(window, unscaled, rung=rung, path="numpy").fate, "length decides nothing"
    )
    waves = np.full(len(position), 5e-7)
    waves[::5], waves[1::5], waves[2::5] = np.nan, 0.0, -1.0
    coloured = same_light(window, Rays(position, direction, waves), rung)
    np.testing.assert_array_equal(coloured.fate == Fate.INVALID, (result.fate == Fate.INVALID) | ~(waves > 0))


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("rung", RUNGS)
def test_no_ray_and_one_are_traced_as_well(rung, number):
    result = same_light(biconvex(), Rays(*lit(biconvex(), number)), rung)
    assert len(result) == number


@pytest.mark.parametrize("rung", RUNGS)
def test_threads_change_no_bit_of_the_ideal_rungs(rung):
    window = WINDOWS["tilted by 20 degrees"]
    rays = Rays(*beam(window, 150_000, 3))
    one, two = (trace(window, rays, rung=rung, path="numba", threads=threads) for threads in (1, 2))
    for column in ("position", "direction", "fate", "cell", "order", "optical_path", "surface", "flux"):
        np.testing.assert_array_equal(getattr(one, column), getattr(two, column))


@pytest.fixture
def left_to_numpy(monkeypatch):
    """Numbers of rays that each trace leaves to the numpy path, in a process that has compiled nothing yet."""
    given, by_numpy = [], tracer._by_numpy

    def counted(layout, some, *more):
        given.append(len(some))
        return by_numpy(layout, some, *more)

    monkeypatch.setattr(tracer, "_by_numpy", counted)
    which_path.LOADED.clear()
    return given


@pytest.mark.parametrize("name", ["paper base", "offset", "galilean", "round of cells"])
@pytest.mark.parametrize("rung", RUNGS)
def test_rays_that_surely_miss_a_flat_sheet_need_no_numpy_either(rung, name, left_to_numpy):
    result = same_light(WINDOWS[name], Rays(*beam(WINDOWS[name], 20_000, 11)), rung)
    assert (result.fate == Fate.MISSED).sum() > 3000
    given = left_to_numpy[1:]  # the first is the numpy path's own trace
    assert sum(given) < 20


@pytest.mark.parametrize("name", ["paper base", "offset", "hexagonal"])
@pytest.mark.parametrize("rung", RUNGS)
def test_ordinary_light_needs_no_numpy(rung, name, left_to_numpy):
    window, rays = WINDOWS[name], Rays(*lit(WINDOWS[name], 20_000))
    result = trace(window, rays, rung=rung, path="numba")
    missed = int((result.fate == Fate.MISSED).sum())
    slipping = 0.05 if name == "hexagonal" and rung == "thin" else 1e-3  # its patches lean and step
    assert sum(left_to_numpy) <= missed + slipping * len(rays)
    assert rung in which_path.LOADED
    left_to_numpy.clear()
    trace(window, rays, rung=rung)
    assert sum(left_to_numpy) < len(rays), "once a kernel is loaded it is used"


@pytest.mark.parametrize("rung", RUNGS)
def test_a_forecast_knows_which_path_a_trace_of_an_ideal_rung_takes(rung):
    many, few = 1_000_000, 100_000
    for number, compiled in ((many, True), (few, False)):
        assert which_path.worth_compiled(number, which_path.IDEAL_FACES) is compiled
        assert task(rung, rays=number) == f"trace {rung}" + ("" if compiled else " numpy")
    assert task(rung, ("fresnel",), many) == f"trace {rung} numpy fresnel"
    assert trace_seconds(10 * many, rung) < trace_seconds(10 * many, rung, ("fresnel",)) / 4


def test_a_law_of_insane_numbers_is_left_to_numpy():
    window = biconvex()
    for law in (Law(1e40, 1.0), Law(1.0, 1e-40), Law(1.0, 1.0, delta_x=1e60)):
        same_light(replace(window, law=law), Rays(*lit(window, 200)), "law")


@pytest.mark.parametrize("name", ["offset", "tilted by 20 degrees", "hexagonal"])
def test_the_compiled_law_is_the_law_in_400_digits(name):
    window = WINDOWS[name]
    rays = Rays(*lit(window, 40, 2))
    result = trace(window, rays, rung="law", path="numba")
    alive = np.flatnonzero(result.fate == Fate.ALIVE)
    assert len(alive) > 30
    for row in alive:
        exact = oracle.refract(astuple(window.law)[:-1], rays.direction[row], window.law.axes)
        assert max(abs(mpf(a) - b) for a, b in zip(result.direction[row], exact)) < 4.5e-16


def through_two_planes(window, start, ray, cell, order):
    """Where a ray meets the second lens of cell + order, and its unit direction behind, in 50 digits."""
    lattice, pair = window.lattice, window.thin
    u, v, n = (mp.matrix([mpf(float(a)) for a in column]) for column in pair.rotation.T)
    at, way = (mp.matrix([mpf(float(a)) for a in row]) for row in (start, ray))
    dot = lambda a, b: (a.T * b)[0]  # noqa: E731
    centre = mp.matrix([*map(mpf, map(float, lattice.centres(np.asarray(cell)))), mpf(0)])
    for array, focal in enumerate(pair.focal_length):
        if array:
            step = np.asarray(lattice.offset(*(int(k) for k in order)))
            centre += mp.matrix([mpf(float(a)) for a in (*step, 0.0)]) + mp.matrix(
                [mpf(float(a)) for a in pair.offset]
            )
        at = at + dot(centre - at, n) / dot(way, n) * way
        offset, along = at - centre, dot(way, n)
        slopes = [
            dot(way, axis) / along - dot(offset, axis) / mpf(float(f)) for axis, f in zip((u, v), focal)
        ]
        way = slopes[0] * u + slopes[1] * v + n
    return at, way / mp.norm(way)


@pytest.mark.parametrize("name", ["paper base", "tilted by 20 degrees", "offset", "hexagonal", "galilean"])
def test_the_compiled_thin_pair_is_two_lenses_in_50_digits(name):
    window = WINDOWS[name]
    rays = Rays(*lit(window, 60, 4))
    result = trace(window, rays, rung="thin", path="numba")
    passed = np.flatnonzero(result.fate <= Fate.GHOST)
    assert len(passed) > 25
    assert (result.fate[passed] == Fate.GHOST).any()
    with mp.workdps(50):
        for row in passed:
            place, way = through_two_planes(
                window, rays.position[row], rays.direction[row], result.cell[row], result.order[row]
            )
            assert max(abs(mpf(a) - b) for a, b in zip(result.direction[row], way)) < 3e-15
            assert max(abs(mpf(a) - b) for a, b in zip(result.position[row], place)) < 3e-15 * 0.1
