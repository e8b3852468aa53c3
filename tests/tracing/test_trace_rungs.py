"""Rungs "law" and "thin": against the law, two thin lenses, and the closed form of vignetting and ghosts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from oracle.windows import PITCH, SPACING, beam, biconvex, collection, plano, slab

from clacad.cli import main
from clacad.effects.trace import trace
from clacad.optics.rays import NO_CELL, Fate, Rays
from clacad.sheet.lattice import Circle
from clacad.sheet.window import Baffle, Land

WINDOWS = collection()


@pytest.mark.parametrize("name", WINDOWS)
def test_rung_law_is_the_law_at_the_sheet_plane(name):
    window = WINDOWS[name]
    position, direction = beam(window, 3000, 1)
    result = trace(window, Rays(position, direction), rung="law", record=True)
    asked = window.law.refract(direction)
    alive = result.fate == Fate.ALIVE
    assert alive.sum() > 500
    np.testing.assert_array_equal(result.direction[alive], asked[alive])
    np.testing.assert_array_equal(result.position[alive, 2], 0.0)
    assert set(np.unique(result.fate)) <= {Fate.ALIVE, Fate.MISSED, Fate.BACKWARD}
    at = position - position[:, 2:] / direction[:, 2:] * direction
    over, _, _ = window.lattice.locate(at[:, 0], at[:, 1])
    crosses = window.lattice.contains(over) & (position[:, 2] <= 0)
    np.testing.assert_array_equal(result.fate != Fate.MISSED, crosses)
    np.testing.assert_array_equal(result.fate[crosses] == Fate.BACKWARD, np.isnan(asked[crosses, 0]))
    length = np.linalg.norm(result.position - position, axis=1)
    np.testing.assert_allclose(result.optical_path, np.where(crosses, length, 0.0), atol=1e-15)
    np.testing.assert_array_equal(result.hits[0], result.position)


def per_axis(slope, entry, first, second, offset):
    """A ray through two thin lenses sharing a focal plane: where it meets the second, and its slope behind."""
    image = first * slope  # height in the focal plane, relative to the axis of lens 1
    arrival = entry + SPACING * (image - entry) / first
    return arrival, (offset - image) / second


def test_rung_thin_is_what_two_lenses_sharing_a_focal_plane_do():
    window = biconvex(eta=(-0.5, -1.5), delta=(0.02, -0.03), count=(40, 40))
    rng = np.random.default_rng(0)
    slope = rng.uniform(-0.03, 0.03, (4000, 2)) + np.divide(window.thin.offset[:2], SPACING)
    aim = rng.uniform(-3 * PITCH, 3 * PITCH, (4000, 2))
    direction = np.column_stack([slope, np.ones(4000)])
    start = np.column_stack([aim, np.zeros(4000)]) - 0.02 * direction
    result = trace(window, Rays(start, direction), rung="thin", record=True)
    assert (result.fate <= Fate.GHOST).all()
    cell, *local = window.lattice.locate(aim[:, 0], aim[:, 1])
    np.testing.assert_array_equal(result.cell, cell)
    centre = window.lattice.centres(cell)
    for axis in (0, 1):
        first, second = (window.thin.focal_length[k][axis] for k in (0, 1))
        offset = window.thin.offset[axis]
        step = PITCH * result.order[:, axis]
        arrival, behind = per_axis(slope[:, axis], local[axis], first, second, offset + step)
        np.testing.assert_allclose(result.position[:, axis], centre[:, axis] + arrival, atol=1e-15)
        np.testing.assert_allclose(result.direction[:, axis] / result.direction[:, 2], behind, atol=1e-13)
        # the cell of array 2 that holds the arrival gives the order
        inside = np.abs(arrival - offset - step)
        assert (inside <= 0.5 * PITCH * (1 + 1e-12)).all()
    np.testing.assert_allclose(result.position[:, 2], SPACING, atol=1e-17)
    np.testing.assert_array_equal(result.fate == Fate.ALIVE, (result.order == 0).all(axis=1))


def closed_share(eta, slope, order):
    """V_m of the vignetting formula: overlap of the scaled entrance cell with cell m of array 2, one axis."""
    size, c = abs(eta), SPACING / PITCH * slope
    overlap = min(0.5, c - order + 0.5 * size) - max(-0.5, c - order - 0.5 * size)
    return max(0.0, overlap) / size


@pytest.mark.parametrize("eta", [-0.25, -1.0, -2.0, 0.5])
@pytest.mark.parametrize("slope", [0.0, 0.013, 0.05, 0.081])
@pytest.mark.parametrize("rung", ["thin", "surfaces"])
def test_the_share_of_every_ghost_order_is_the_closed_form(eta, slope, rung):
    window = biconvex(eta=(eta, eta), thickness=0.0012 if eta < 0 else 0.0002, count=(81, 81))
    side = 128  # one cell, sampled by its own grid: off by at most a row of samples a border
    at = (np.arange(side) + 0.5) / side * PITCH - 0.5 * PITCH
    x, y = (v.ravel() for v in np.meshgrid(at, at))
    start = np.column_stack([x, y, np.zeros(side * side)]) - 0.01 * np.array([slope, 0.0, 1.0])
    result = trace(window, Rays(start, np.tile([slope, 0.0, 1.0], (side * side, 1))), rung=rung)
    passed = result.fate <= Fate.GHOST
    tolerance = 2.0 / side if rung == "thin" else 0.05  # aberrated marginal rays miss the partner
    for m in (-1, 0, 1, 2):
        share = (passed & (result.order == [m, 0]).all(axis=1)).mean()
        expected = closed_share(eta, slope, m) * closed_share(eta, 0.0, 0)
        assert share == pytest.approx(expected, abs=tolerance)
    assert passed.mean() == pytest.approx(1.0, abs=1e-9 if rung == "thin" else 0.01)


@pytest.mark.parametrize("eta", [-0.25, -1.0, -2.0])
def test_ghosts_leave_at_their_own_slopes(eta):
    window = biconvex(eta=(eta, eta), thickness=0.0012, count=(81, 81))
    position, direction = beam(window, 4000, 2, steepest=0.2, spread=-30.3)
    result = trace(window, Rays(position, direction), rung="thin")
    ghost = result.fate == Fate.GHOST
    assert ghost.sum() > 300
    slope = direction[ghost, :2] / direction[ghost, 2:]
    expected = (slope - result.order[ghost] * (PITCH / SPACING) * (1.0 - eta)) / eta
    np.testing.assert_allclose(
        result.direction[ghost, :2] / result.direction[ghost, 2:], expected, atol=1e-12
    )


@pytest.mark.daily_share(4)
@pytest.mark.parametrize("rung", ["law", "thin", "surfaces"])
@pytest.mark.parametrize("name", WINDOWS)
def test_no_ray_is_lost_on_any_rung(name, rung):
    window = WINDOWS[name]
    position, direction = beam(window, 2000, 9)
    direction[0] = 0.0
    result = trace(window, Rays(position, direction), rung=rung, record=True)
    assert sum(result.counts().values()) == 2000
    assert (result.fate == Fate.INVALID).sum() == 1
    sound = result.fate != Fate.INVALID
    assert np.isfinite(result.position[sound]).all()
    assert np.isfinite(result.direction[sound]).all()
    assert np.isfinite(result.hits[:, sound]).all()
    if rung == "thin":
        assert not np.isin(result.fate, (Fate.TIR, Fate.WALL)).any()


def test_light_between_two_tilted_patches_goes_straight_on_as_land():
    tilt = 0.35
    window = biconvex(euler=(0.0, tilt, 0.0), thickness=0.003, count=(40, 60))
    axis = window.law.optical_axis
    rng = np.random.default_rng(4)
    aim = np.column_stack([rng.uniform(-3 * PITCH, 3 * PITCH, (20_000, 2)), np.zeros(20_000)])
    # a patch has area 1/cos τ cells; light that leans as far the other way sees it under 2τ, the sheet under τ
    covered = {"along": 1.0, "upright": 1.0, "against": np.cos(2 * tilt) / np.cos(tilt) ** 2}
    beams = {"along": axis, "upright": np.array([0.0, 0.0, 1.0]), "against": axis * [-1, -1, 1]}
    for name, ray in beams.items():
        rays = Rays(aim - 0.05 * ray, np.tile(ray, (20_000, 1)))
        result = trace(window, rays, rung="thin", record=True)
        met = result.fate != Fate.MISSED
        slipped = (np.abs(result.directions[0] - ray).max(axis=1) < 1e-14) & met
        assert slipped.mean() == pytest.approx((1.0 - covered[name]) * met.mean(), abs=0.01)
        assert (result.fate[slipped] == Fate.LAND).all()


@pytest.mark.parametrize("rung", ["thin", "surfaces"])
def test_a_baffle_stops_the_ghosts_and_what_its_walls_cover(rung):
    wall = 0.0005
    open_window = biconvex(eta=(-0.5, -0.5), thickness=0.0012, count=(81, 81))
    window = replace(open_window, baffle=Baffle(wall))
    side = 100
    at = (np.arange(side) + 0.5) / side * PITCH - 0.5 * PITCH
    x, y = (v.ravel() for v in np.meshgrid(at, at))
    start = np.column_stack([x, y, np.full(side * side, -0.01)])
    rays = Rays(start, np.tile([0.0, 0.0, 1.0], (side * side, 1)))
    free, stopped = (trace(w, rays, rung=rung) for w in (open_window, window))
    assert not (stopped.fate == Fate.GHOST).any()
    passes = stopped.fate == Fate.ALIVE
    # on axis a cell of half the size arrives: only the walls at lens 1 take light
    assert passes.mean() == pytest.approx((1 - wall / PITCH) ** 2, abs=0.02)
    np.testing.assert_array_equal(free.direction[passes], stopped.direction[passes])
    assert set(np.unique(stopped.fate)) <= {Fate.ALIVE, Fate.VIGNETTED}
    held = stopped.fate == Fate.VIGNETTED
    assert (stopped.position[held, 2] > -0.001).all()
    assert (stopped.position[held, 2] < SPACING + 0.001).all()


@pytest.mark.parametrize("rung", ["thin", "surfaces"])
@pytest.mark.parametrize("opaque", [False, True])
def test_seams_are_land_and_opaque_ones_stop_light(rung, opaque):
    seam = 0.0008
    window = biconvex(thickness=0.002, web=0.0003, land=Land(seam, opaque), count=(40, 40))
    rng = np.random.default_rng(6)
    aim = np.column_stack([rng.uniform(-5 * PITCH, 5 * PITCH, (20_000, 2)), np.full(20_000, -0.01)])
    result = trace(window, Rays(aim, np.tile([0.0, 0.0, 1.0], (20_000, 1))), rung=rung)
    _, x, y = window.lattice.locate(aim[:, 0], aim[:, 1])
    on_seam = np.maximum(np.abs(x), np.abs(y)) > 0.5 * (PITCH - seam)
    label = Fate.VIGNETTED if opaque else Fate.LAND
    np.testing.assert_array_equal(result.fate[on_seam], label)
    straight = result.fate == Fate.LAND
    if not opaque:
        np.testing.assert_allclose(
            result.direction[straight & on_seam], np.tile([0.0, 0.0, 1.0], ((straight & on_seam).sum(), 1))
        )


def test_cells_outside_a_round_outline_are_land_or_nothing():
    bare = biconvex(cut=Circle(0.08))
    bordered = slab(land=(0.0004, 0.0746), cut=Circle(0.08), outline=Circle(0.1))
    position = np.column_stack([np.linspace(-0.06, 0.06, 241), np.full(241, 1e-4), np.full(241, -0.01)])
    rays = Rays(position, np.tile([0.0, 0.0, 1.0], (241, 1)))
    radius = np.abs(position[:, 0])
    for rung in ("thin", "surfaces"):
        one, two = (trace(window, rays, rung=rung) for window in (bare, bordered))
        assert (one.fate[radius > 0.04] == Fate.MISSED).all()
        assert (one.fate[radius < 0.03] <= Fate.GHOST).all()
        assert (two.fate[(radius > 0.041) & (radius < 0.0499)] == Fate.LAND).all()
        assert (two.cell[(radius > 0.041) & (radius < 0.0499)] == NO_CELL).all()
        assert (two.fate[radius > 0.0501] == Fate.MISSED).all()


def test_plano_windows_obey_their_law_for_a_small_bundle():
    for window in (plano(eta=(-0.5, -1.0)), plano(eta=(-0.5, -1.0), inside=True), slab(eta=(-0.5, -1.0))):
        rng = np.random.default_rng(1)
        centre = window.lattice.centres(np.array([10, 15]))
        local = rng.uniform(-1e-5, 1e-5, (200, 2))
        direction = np.column_stack([rng.uniform(-1e-4, 1e-4, (200, 2)), np.ones(200)])
        start = np.column_stack([centre + local, np.full(200, -0.01)])
        result = trace(window, Rays(start, direction))
        assert (result.fate == Fate.ALIVE).all()
        np.testing.assert_allclose(result.direction, window.law.refract(direction), rtol=0, atol=5e-9)


def test_unknown_rungs_are_refused():
    with pytest.raises(ValueError, match="rung is 'exact'"):
        trace(biconvex(), Rays([[0, 0, -1]], [[0, 0, 1]]), rung="exact")


def test_words_that_the_tracer_does_not_know_are_refused_and_the_known_ones_named():
    one = Rays([[0, 0, -1]], [[0, 0, 1]])
    with pytest.raises(ValueError, match='path is \'Numba\', not "numpy", "numba", "size" or None'):
        trace(biconvex(), one, path="Numba")
    with pytest.raises(ValueError, match="path is 'gpu'"):
        trace(biconvex(), one, rung="law", effects=("fresnel",), path="gpu")
    with pytest.raises(ValueError, match="rung is 'Thin'"):
        trace(biconvex(), one, rung="Thin", effects=("facets",))
    with pytest.raises(ValueError, match='normals is \'Vertex\', not "facet" or "vertex"'):
        trace(biconvex(), one, normals="Vertex")


@pytest.mark.parametrize("rung", ["law", "thin", "surfaces"])
def test_a_mesh_and_its_normals_are_refused_where_no_facets_are_traced(rung):
    one = Rays([[0, 0, -1]], [[0, 0, 1]])
    with pytest.raises(ValueError, match=f"mesh= is for rung \"mesh\", not '{rung}'"):
        trace(biconvex(), one, rung=rung, mesh="sheet.stl")
    with pytest.raises(ValueError, match=f'normals="vertex" is for rung "mesh", not \'{rung}\''):
        trace(biconvex(), one, rung=rung, normals="vertex")


@pytest.mark.parametrize("option", ["--mesh sheet.stl", "--normals vertex"])
def test_the_command_line_refuses_options_of_facets_on_other_rungs(tmp_path, capsys, option):
    rays, design = tmp_path / "rays.npz", str(Path(__file__).parents[2] / "designs" / "slab.toml")
    np.savez(rays, position=[[0.0, 0.0, -1.0]], direction=[[0.0, 0.0, 1.0]])
    asked = ["trace", design, str(rays), "-o", str(tmp_path / "out.npz"), "--rung", "thin"]
    assert main([*asked, *option.split()]) == 2
    said = capsys.readouterr().err
    assert f"{option.removesuffix(' sheet.stl')}: it is for --rung mesh, not thin" in said
    assert not (tmp_path / "out.npz").exists()
    assert main(asked) == 0
