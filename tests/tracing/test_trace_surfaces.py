"""Rung "surfaces": against explicit sequences, between cells, from far away, on borders."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracle.windows import PITCH, beam, biconvex, collection, plano, slab

from clacad.effects.trace import trace
from clacad.optics.material.catalogue import find
from clacad.optics.rays import NO_CELL, Fate, Rays
from clacad.optics.sequence import Interface, trace_sequence
from clacad.sheet.lattice import Lattice

WINDOWS = collection()
PATHS = ("numpy", "numba")


def bundle(window, number=400, seed=0, spread=0.02):
    """Rays into the middle cells, about the middle of the field."""
    rng = np.random.default_rng(seed)
    middle = np.divide(window.thin.shift, window.thin.offset[2])
    direction = np.column_stack([rng.uniform(-spread, spread, (number, 2)) + middle, np.ones(number)])
    aim = np.column_stack([rng.uniform(-3 * PITCH, 3 * PITCH, (number, 2)), np.zeros(number)])
    return Rays(aim - 0.03 * direction, direction)


def interfaces(window, cell, order=(0, 0)):
    """The telescopelet of one cell as a sequence of surfaces."""
    out = []
    for body in window.bodies:
        for face, before, after in ((body.front, 1.0, body.index), (body.back, body.index, 1.0)):
            vertex = np.array(face.vertex)
            if face.array is not None:
                index = np.array(cell) + (order if face.array else (0, 0))
                vertex[:2] += window.lattice.centres(index) + window.shifts[face.array]
            out.append(Interface(face.surface, tuple(vertex), before, after, face.rotation))
    return out


def in_its_cells(window, result):
    """Rays whose every hit lies in the cell that `cell` and `order` name: none crossed a border inside a lens."""
    same = np.ones(len(result), dtype=bool)
    faces = [face for body in window.bodies for face in (body.front, body.back)]
    for face, hits in zip(faces, result.hits):
        if face.array is not None:
            shift = window.shifts[face.array]
            met, _, _ = window.lattice.locate(hits[:, 0] - shift[0], hits[:, 1] - shift[1])
            same &= (met == result.cell + face.array * result.order).all(axis=1)
    return same


@pytest.mark.daily_share(3)
@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("name", WINDOWS)
def test_what_passes_is_what_the_sequence_of_its_surfaces_does(name, path):
    window = WINDOWS[name]
    rays = bundle(window)
    result = trace(window, rays, path=path, record=True)
    passed = np.flatnonzero(np.isin(result.fate, (Fate.ALIVE, Fate.GHOST)) & in_its_cells(window, result))
    assert len(passed) > 50
    for cell in np.unique(np.column_stack([result.cell, result.order])[passed], axis=0):
        mine = passed[(np.column_stack([result.cell, result.order])[passed] == cell).all(axis=1)]
        one = trace_sequence(
            interfaces(window, cell[:2], cell[2:]), Rays(rays.position[mine], rays.direction[mine]), True
        )
        np.testing.assert_array_equal(one.fate, Fate.ALIVE)
        np.testing.assert_allclose(result.direction[mine], one.direction, rtol=0, atol=1e-13)
        np.testing.assert_allclose(result.position[mine], one.position, rtol=0, atol=1e-13 * 0.1)
        np.testing.assert_allclose(result.optical_path[mine], one.optical_path, rtol=0, atol=1e-14)
        np.testing.assert_allclose(result.hits[:, mine], one.hits, rtol=0, atol=1e-14)
        np.testing.assert_allclose(result.directions[:, mine], one.directions, rtol=0, atol=1e-13)


@pytest.mark.daily_share(3)
@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("name", WINDOWS)
def test_every_ray_has_one_fate_and_only_invalid_rows_hold_nan(name, path):
    window = WINDOWS[name]
    position, direction = beam(window, 3000, 5)
    direction[::17] *= -1.0
    direction[::29, 2] = 0.0
    direction[3], position[4, 1], direction[5, 0] = 0.0, np.inf, np.nan
    direction[6:9] *= np.array([[1e-300], [1e300], [5e-324]]) / np.abs(direction[6:9]).max()
    result = trace(window, Rays(position, direction), path=path, record=True)
    assert sum(result.counts().values()) == 3000
    np.testing.assert_array_equal(np.flatnonzero(result.fate == Fate.INVALID), [3, 4, 5])
    sound = result.fate != Fate.INVALID
    for column in (result.position, result.direction, result.optical_path, result.flux):
        assert np.isfinite(column[sound]).all()
    assert np.isfinite(result.hits[:, sound]).all()
    assert np.isfinite(result.directions[:, sound]).all()
    lost = np.isin(result.fate, (Fate.MISSED, Fate.INVALID))
    np.testing.assert_array_equal(result.position[lost], position[lost])
    np.testing.assert_array_equal(result.direction[lost], direction[lost])
    on = result.fate <= Fate.LAND
    assert (result.direction[on, 2] > 0).all()
    np.testing.assert_allclose(np.linalg.norm(result.direction[~lost], axis=1), 1.0, atol=1e-14)
    assert (result.order[result.fate == Fate.ALIVE] == 0).all()
    assert (result.order[result.fate == Fate.GHOST] != 0).any(axis=1).all()
    assert (result.cell[result.fate <= Fate.GHOST] != NO_CELL).all()
    assert (result.fate[direction[:, 2] <= 0] >= Fate.MISSED).all()


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("build", [biconvex, slab, plano])
def test_one_cell_does_what_every_cell_does_to_the_last_bit(build, path):
    # pitch and starts are short binary fractions, so that moving by whole cells is exact
    window = build(count=(513, 513))
    pitch = 2.0**-8
    window = replace(window, lattice=Lattice("square", (pitch, pitch), (513, 513)))
    rng = np.random.default_rng(3)
    start = np.round(rng.uniform(-pitch, pitch, (500, 3)) * 2**24) / 2**24 - [0, 0, 2.0**-5]
    direction = np.column_stack([rng.uniform(-0.02, 0.02, (500, 2)), np.ones(500)])
    here = trace(window, Rays(start, direction), path=path)
    step = np.array([201, -187])
    there = trace(window, Rays(start + [*(pitch * step), 0.0], direction), path=path)
    np.testing.assert_array_equal(here.fate, there.fate)
    np.testing.assert_array_equal(here.order, there.order)
    np.testing.assert_array_equal(here.direction, there.direction)
    np.testing.assert_array_equal(here.optical_path, there.optical_path)
    on = here.fate <= Fate.GHOST
    np.testing.assert_array_equal((there.cell - here.cell)[on], np.broadcast_to(step, (on.sum(), 2)))


@pytest.mark.parametrize("path", PATHS)
def test_the_distance_of_the_start_does_not_matter(path):
    window = biconvex(delta=(0.01, -0.02))
    rng = np.random.default_rng(8)
    # direction and distance are short binary fractions: the far start lies on the same line exactly
    direction = np.column_stack([np.round(rng.uniform(-0.03, 0.03, (400, 2)) * 2**12) / 2**12, np.ones(400)])
    near = np.round(rng.uniform(-0.02, 0.02, (400, 3)) * 2**20) / 2**20 - [0, 0, 2.0**-4]
    far = near - 1024.0 * direction
    one, two = (trace(window, Rays(start, direction), path=path) for start in (near, far))
    np.testing.assert_array_equal(one.fate, two.fate)
    np.testing.assert_array_equal(one.cell, two.cell)
    np.testing.assert_allclose(one.direction, two.direction, rtol=0, atol=2**-50)  # four ulp of 1
    on = one.fate <= Fate.GHOST
    np.testing.assert_allclose(one.position[on], two.position[on], rtol=0, atol=1e-17)


@pytest.mark.parametrize("path", PATHS)
def test_a_ray_on_a_border_or_corner_belongs_to_the_cell_above(path):
    window = biconvex(eta=(-1.0, -1.0), thickness=0.0012, count=(8, 10))
    x, y = np.meshgrid(np.array([-1.0, 0.0, 1.0]) * PITCH, np.array([-2.0, 0.0, 1.0]) * PITCH)
    start = np.column_stack([x.ravel(), y.ravel(), np.full(9, -0.02)])
    result = trace(window, Rays(start, np.tile([0.0, 0.0, 1.0], (9, 1))), path=path)
    assert np.isin(result.fate, (Fate.ALIVE, Fate.GHOST)).all()
    above, _, _ = window.lattice.locate(start[:, 0], start[:, 1])
    np.testing.assert_array_equal(result.cell, above)
    np.testing.assert_allclose(result.cell, start[:, :2] / PITCH + [4, 5])


@pytest.mark.parametrize("path", PATHS)
def test_crossing_a_border_where_neighbours_agree_meets_no_wall(path):
    # without tilt congruent neighbours meet at equal heights: there is no wall to hit, not even at a corner
    window = biconvex(eta=(-1.0, -1.0), thickness=0.0012)
    rng = np.random.default_rng(11)
    aim = np.column_stack([rng.integers(-3, 4, (400, 2)) * PITCH, np.full(400, 0.0)])
    aim[:200, 0] += rng.uniform(-0.5, 0.5, 200) * PITCH
    aim[:, 2] = rng.uniform(-0.0005, 0.0005, 400)
    direction = np.column_stack([rng.uniform(-0.1, 0.1, (400, 2)), np.ones(400)])
    result = trace(window, Rays(aim - 0.02 * direction, direction), path=path)
    assert not (result.fate == Fate.WALL).any()
    assert (result.fate <= Fate.GHOST).all()


def test_a_start_behind_a_face_is_missed_and_one_just_before_it_is_not():
    window = biconvex()
    depth = np.array([-0.02, -0.001, -4.6e-4, -4.4e-4, 0.0, 0.002, 0.03, 0.1])
    start = np.column_stack([np.full(8, 0.5 * PITCH), np.full(8, 0.5 * PITCH), depth])
    for path in PATHS:
        result = trace(window, Rays(start, np.tile([0.0, 0.0, 1.0], (8, 1))), path=path)
        assert [Fate(f).name for f in result.fate] == ["ALIVE"] * 3 + ["MISSED"] * 5


@pytest.mark.parametrize("path", PATHS)
def test_wavelengths_are_traced_with_their_own_index(path):
    window = biconvex()
    glass = find("PMMA")
    bodies = tuple(replace(body, material=glass, index=float(glass.index(550e-9))) for body in window.bodies)
    window = replace(window, bodies=bodies, wavelength=550e-9)
    rays = bundle(window, 300)
    waves = np.tile([450e-9, 550e-9, 650e-9], 100)
    mixed = trace(window, Rays(rays.position, rays.direction, waves), path=path)
    for wave in (450e-9, 550e-9, 650e-9):
        single = replace(
            window, bodies=tuple(replace(b, index=float(glass.index(wave)), material=None) for b in bodies)
        )
        mine = waves == wave
        alone = trace(single, Rays(rays.position[mine], rays.direction[mine]), path=path)
        np.testing.assert_array_equal(mixed.direction[mine], alone.direction)
    waves[7] = np.nan
    assert trace(window, Rays(rays.position, rays.direction, waves), path=path).fate[7] == Fate.INVALID
