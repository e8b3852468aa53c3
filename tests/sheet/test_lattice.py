"""Which cell holds a point, exactly."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clacad.sheet.lattice import Circle, Lattice, Rectangle

KINDS = {
    "square": Lattice("square", (0.5, 0.5), (7, 4)),
    "rectangular": Lattice("rectangular", (0.5, 0.3), (6, 5)),
    "hexagonal": Lattice("hexagonal", (0.5, 0.5), (5, 4)),
    "one hexagon": Lattice("hexagonal", (0.5, 0.5), (1, 1)),
}


@pytest.mark.parametrize("name", KINDS)
def test_the_mean_of_all_centres_is_the_origin(name):
    lattice = KINDS[name]
    np.testing.assert_allclose(lattice.centres(lattice.cells()).mean(axis=0), 0.0, atol=1e-16)
    assert len(lattice.cells()) == lattice.cell_count == lattice.count[0] * lattice.count[1]
    assert lattice.contains(lattice.cells()).all()


@pytest.mark.daily_cases("rectangular", "hexagonal", "one hexagon")
@pytest.mark.parametrize("name", KINDS)
def test_a_point_belongs_to_the_nearest_centre(name):
    lattice = KINDS[name]
    points = np.random.default_rng(1).uniform(-2.0, 2.0, (4_000, 2))
    index, x, y = lattice.locate(*points.T)
    around = np.array([(i, j) for i in range(-12, 18) for j in range(-10, 14)])
    nearest = np.linalg.norm(points[:, None] - lattice.centres(around)[None], axis=2).min(axis=1)
    if not lattice.hexagonal:  # in a rectangular lattice the nearest centre is the cell's too
        assert np.allclose(np.hypot(x, y), nearest, atol=1e-15)
    np.testing.assert_allclose(np.hypot(x, y), nearest, atol=1e-14)
    np.testing.assert_allclose(lattice.centres(index) + np.stack([x, y], axis=1), points, atol=1e-15)


@settings(max_examples=300, deadline=None)
@given(st.integers(-(10**9), 10**9), st.floats(-0.4999, 0.4999), st.sampled_from([200, 201]))
def test_a_cell_a_billion_pitches_away_loses_nothing_its_coordinate_had_not_lost(k, part, count):
    pitch = 0.005
    lattice = Lattice("square", (pitch, pitch), (count, count))
    x = float((Fraction(2 * k - count + 1) / 2 + Fraction(part)) * Fraction(pitch))
    index, local, _ = lattice.locate(np.array([x]), np.array([0.0]))
    exact = Fraction(x) - (2 * int(index[0, 0]) - (count - 1)) * Fraction(pitch / 2)
    assert local[0] == float(exact)
    assert abs(exact) <= Fraction(pitch) / 2


def test_a_point_on_a_wall_belongs_to_the_cell_above_it():
    lattice = Lattice("square", (0.25, 0.25), (4, 4))  # walls on exact doubles
    index, x, _ = lattice.locate(np.array([-0.25, 0.0, 0.25, -0.0]), np.full(4, 0.125))
    assert index[:, 0].tolist() == [1, 2, 3, 2]
    assert (x == -0.125).all()
    below, _, _ = lattice.locate(np.array([-0.25, 0.0, 0.25]) - 1e-16, np.full(3, 0.125))
    assert below[:, 0].tolist() == [0, 1, 2]


def test_low_order_parts_decide_on_which_side_of_a_wall_a_point_lies():
    lattice = Lattice("square", (0.25, 0.25), (4, 4))
    index, x, _ = lattice.locate(np.zeros(2), np.zeros(2), np.array([1e-30, -1e-30]), np.zeros(2))
    assert index[:, 0].tolist() == [2, 2]  # −1e-30 rounds onto the wall itself: an allowed tie
    index, x, _ = lattice.locate(np.zeros(2), np.zeros(2), np.array([1e-17, -1e-16]), np.zeros(2))
    assert index[:, 0].tolist() == [2, 1]
    assert x[1] == pytest.approx(0.125, abs=1e-15)


@pytest.mark.parametrize("outline", [Circle(2.0), Rectangle(1.7, 1.1)], ids=["circle", "rectangle"])
@pytest.mark.parametrize("name", ["square", "hexagonal"])
def test_an_outline_keeps_exactly_the_cells_that_lie_wholly_inside(name, outline):
    lattice = Lattice(name, (0.25, 0.25), (12, 12), outline)
    everything = Lattice(name, (0.25, 0.25), (12, 12))
    kept = {tuple(c) for c in lattice.cells()}
    assert 0 < len(kept) < everything.cell_count
    assert lattice.cell_count == len(kept)
    for cell in everything.cells():
        corners = everything.centres(cell) + everything.tile()
        if isinstance(outline, Circle):
            inside = (np.hypot(*corners.T) <= 1.0 + 1e-9).all()
        else:
            inside = (np.abs(corners) <= [0.85 + 1e-9, 0.55 + 1e-9]).all()
        assert (tuple(cell) in kept) == inside


@pytest.mark.parametrize("name", ["square", "rectangular", "hexagonal"])
def test_whether_an_outline_holds_a_cell_is_known_without_listing_them(name):
    """By counting every kept cell; the least outline keeps one, one a little smaller round or lower keeps none."""
    pitch = (0.25, 0.4 if name == "rectangular" else 0.25)
    chance = np.random.default_rng(3)
    for n1, n2 in np.ndindex(5, 7):
        free = Lattice(name, pitch, (n1 + 1, n2 + 1))
        sizes = chance.uniform(0.1, 1.5, (8, 2)).tolist()
        for outline in [*(Circle(a) for a, _ in sizes), *(Rectangle(a, b) for a, b in sizes)]:
            lattice = replace(free, outline=outline)
            assert lattice.holds_a_cell == (lattice.cell_count > 0)
            least = lattice.least_outline()
            assert replace(lattice, outline=least).cell_count > 0
            if isinstance(least, Circle):
                less: Circle | Rectangle = Circle(least.diameter * (1.0 - 1e-9))
            else:
                less = Rectangle(least.width, least.height * (1.0 - 1e-9))
            assert replace(lattice, outline=less).cell_count == 0
    assert Lattice(name, pitch, (3, 2)).holds_a_cell


@pytest.mark.parametrize("name", ["square", "rectangular", "hexagonal"])
def test_an_outline_keeps_the_same_cells_of_very_many_as_of_few_and_as_fast(name):
    """Every number of cells of one parity puts the cells of a square lattice at the same places."""
    for outline in (Circle(3.2), Rectangle(2.9, 0.7), Rectangle(0.3, 4.1)):
        few, many = (Lattice(name, (0.25, 0.4), (n, n), outline) for n in (40, 1_000_000))
        near, far = few.centres(few.cells()), many.centres(many.cells())
        np.testing.assert_allclose(far, near, rtol=0.0, atol=1e-9)
        assert many.cell_count == few.cell_count == len(near)
        assert many.row(0).shape == (0, 2)


def test_hexagons_are_centre_to_centre_and_flat_to_flat_one_pitch():
    lattice = Lattice("hexagonal", (0.5, 0.5), (3, 3))
    tile = lattice.tile()
    assert np.ptp(tile[:, 0]) == pytest.approx(0.5)
    for step in lattice.steps:
        assert np.hypot(*lattice.offset(*step)) == pytest.approx(0.5)
    shoelace = 0.5 * abs(np.sum(tile[:, 0] * np.roll(tile[:, 1], -1) - tile[:, 1] * np.roll(tile[:, 0], -1)))
    assert shoelace == pytest.approx(lattice.cell_area)
    rows = [lattice.centres(lattice.row(j))[:, 0].min() for j in range(3)]
    assert rows[1] - rows[0] == pytest.approx(0.25)  # odd rows moved by +p/2
    assert rows[2] == pytest.approx(rows[0])


def test_with_count_is_centred_and_drops_the_outline():
    lattice = Lattice("square", (0.5, 0.5), (200, 200), Circle(90.0)).with_count((3, 2))
    assert lattice.outline is None
    assert lattice.extent() == pytest.approx((-0.75, 0.75, -0.5, 0.5))


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("count", [(30, 28), (600, 500)])
def test_a_disc_keeps_the_cells_whose_corners_lie_in_it_whether_or_not_a_table_holds_them(kind, count):
    """Squared distances of the corners from the middle; a table of the second pattern would be too large."""
    lattice = Lattice(kind, (0.5, 0.5), count, Circle(0.45 * min(count)))
    index = np.random.default_rng(2).integers(-min(count), 2 * max(count), (20_000, 2))
    corners = (lattice.centres(index)[:, None] + lattice.tile()) ** 2
    held = (corners.sum(axis=2) <= (0.225 * min(count)) ** 2).all(axis=1)
    row = index[:, 0] + index[:, 1] // 2 if lattice.hexagonal else index[:, 0]
    there = (index[:, 1] >= 0) & (index[:, 1] < count[1]) & (row >= 0) & (row < count[0])
    assert np.array_equal(lattice.contains(index), held & there)
    assert 0 < (held & there).sum() < there.sum()
    assert np.array_equal(lattice.contains(index.reshape(100, 200, 2)).ravel(), held & there)
