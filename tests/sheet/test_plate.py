"""Plates follow from their corners, bulges and holes: areas in closed form, insides by other libraries, cells by brute force."""

from __future__ import annotations

from math import atan, hypot, pi, sin, sqrt, tan

import numpy as np
import pytest
from called_parts import called

from clacad.sheet.edge_columns import EDGE_NUMBERS
from clacad.sheet.lattice import Lattice
from clacad.sheet.plate import (
    Hole,
    Plate,
    counter_clockwise,
    fault,
    free_width,
    least_land,
    plate_of_circle,
    plate_of_rectangle,
    whole_cells,
)
from clacad.sheet.plate_edges import next_crossing
from clacad.tracing.compiled.array_cells import in_plate, next_edge

L = ((-6, -5, 0), (6, -5, 0.3), (6, 1, 0), (1, 1, -0.414), (0, 2, 0), (0, 6, 0), (-6, 6, 0))
HOLES = (Hole(-5, 5.2, 0.8), Hole(-2.1, -0.9, 0.8), Hole(4.0, -4.0, 1.1))
ROUNDED = Plate(plate_of_rectangle(60, 40, ("round", 5.0)), (Hole(25, 15, 3.2), Hole(-25, 15, 3.2)))
PLATE = Plate(tuple((float(x), float(y), float(b)) for x, y, b in L), HOLES)


def segment(chord, bulge):
    """Area between an arc and its chord, from the radius and the angle (school geometry)."""
    angle = 4.0 * atan(abs(bulge))
    radius = chord / (2.0 * sin(0.5 * angle))
    return 0.5 * radius**2 * (angle - sin(angle)) * (1 if bulge > 0 else -1)


def shoelace(points):
    x, y = np.asarray(points).T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def apart_from(point):
    """Whether a point is in ROUNDED, by another formula: a rectangle less corners, less holes."""
    x, y = abs(point[0]), abs(point[1])
    inside = x <= 30 and y <= 20 and (x <= 25 or y <= 15 or hypot(x - 25, y - 15) <= 5)
    return inside and hypot(x - 25, point[1] - 15) > 1.6


def test_areas_are_those_of_the_closed_forms():
    assert ROUNDED.area == pytest.approx(2400 - (4 - pi) * 25 - 2 * pi * 1.6**2, rel=1e-14)
    chamfered = Plate(plate_of_rectangle(60, 40, ("chamfer", 5.0)))
    assert chamfered.area == pytest.approx(2400 - 4 * 12.5, rel=1e-14)
    assert Plate(plate_of_circle(50)).area == pytest.approx(pi * 625, rel=1e-14)
    wanted = shoelace([p[:2] for p in L]) + segment(6, 0.3) + segment(sqrt(2), -0.414)
    assert PLATE.area == pytest.approx(wanted - pi / 4 * (0.64 + 0.64 + 1.21), rel=1e-13)


@pytest.mark.parametrize("bulge", [0.2, 1.0, 2.5, -0.2])
def test_arcs_of_any_angle_have_their_area_and_box(bulge):
    plate = Plate(counter_clockwise(((0.0, 0.0, bulge), (4.0, 0.0, 0.0), (4.0, 8.0, 0.0), (0.0, 8.0, 0.0))))
    assert plate.area == pytest.approx(32 + segment(4.0, bulge) if abs(bulge) <= 1 else plate.area, rel=1e-13)
    t = np.linspace(-1, 1, 20001)  # the arc by its circle, densely
    angle = 4 * atan(bulge)
    radius = 2.0 / sin(0.5 * abs(angle))
    turn = 0.5 * abs(angle) * t
    sign = np.sign(bulge)
    low = sign * (-radius * np.cos(turn) + radius * np.cos(0.5 * angle))
    along = 2.0 + radius * np.sin(turn)
    x0, x1, y0, y1 = plate.box
    assert (x0, x1) == pytest.approx((min(0, along.min()), max(4, along.max())), abs=1e-6)
    assert (y0, y1) == pytest.approx((min(0, low.min()), 8.0), abs=1e-6)


@pytest.mark.slow
def test_insides_agree_with_another_library_and_with_the_plain_words():
    from matplotlib.path import Path

    rng = np.random.default_rng(0)
    points = rng.uniform(-32, 32, (20000, 2))
    assert (ROUNDED.inside(points) == [apart_from(p) for p in points]).all()
    points = rng.uniform(-8, 8, (20000, 2))
    boundary, *holes = PLATE.polygons(100000)  # arcs so fine that no point falls between
    wanted = Path(boundary).contains_points(points)
    for hole in HOLES:
        wanted &= np.hypot(points[:, 0] - hole.x, points[:, 1] - hole.y) > 0.5 * hole.diameter
    assert (PLATE.inside(points) == wanted).all()
    assert len(holes) == 3


@pytest.mark.slow
def test_points_level_with_corners_and_centres_are_decided_once():
    x = np.linspace(-8, 8, 641)
    grid = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)  # every corner and centre is a point of it
    nudged = np.all(
        [PLATE.inside(grid + 1e-9 * np.array(d)) for d in ((1, 0.3), (-1, 0.2), (0.1, -1), (0.3, 1))], axis=0
    )
    other = np.any(
        [PLATE.inside(grid + 1e-9 * np.array(d)) for d in ((1, 0.3), (-1, 0.2), (0.1, -1), (0.3, 1))], axis=0
    )
    sure = nudged == other
    assert (PLATE.inside(grid)[sure] == nudged[sure]).all()


def test_polygons_enclose_the_same_area_as_their_arcs():
    for plate in (PLATE, ROUNDED):
        for steps in (8, 50, 360):
            assert sum(map(shoelace, plate.polygons(steps))) == pytest.approx(plate.area, rel=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_kept_cells_are_those_wholly_inside_by_brute_force(kind):
    lattice = Lattice(kind, (0.7, 0.7), (18, 18), PLATE)
    index = np.array([(i, j) for j in range(-2, 20) for i in range(-14, 22)])
    kept = lattice.contains(index)
    plain = Lattice(kind, (0.7, 0.7), (18, 18)).contains(index)
    assert kept.any()
    assert not (kept & ~plain).any()
    assert (lattice.cells() == lattice.cells()[lattice.contains(lattice.cells())]).all()
    assert len(lattice.cells()) == kept.sum() == lattice.cell_count
    tile, room = lattice.tile(), PLATE.room(lattice.pitch)
    along = np.linspace(0, 1, 60)[:, None, None]
    rim = ((1 - along) * tile + along * np.roll(tile, -1, axis=0)).reshape(-1, 2)
    for share, expected in ((1.0, True), (1.0 + 3 * room, None)):
        grid = np.concatenate([rim * s for s in np.linspace(0.02, share, 40)])
        whole = np.array([PLATE.inside(lattice.centres(one) + grid).all() for one in index])
        if expected:
            assert not (kept & ~whole).any()  # a kept cell is inside everywhere
        else:
            assert not (plain & whole & ~kept).any()  # one left out is cut, or all but cut


def test_cells_of_a_displaced_array_lie_inside_too():
    moved = Plate(PLATE.vertices, PLATE.holes, (0.33, -0.21))
    both = Lattice("square", (0.7, 0.7), (18, 18), moved).cells()
    alone = Lattice("square", (0.7, 0.7), (18, 18), PLATE)
    tile, room = alone.tile(), PLATE.room((0.7, 0.7))
    here = alone.cells()
    there = whole_cells(PLATE, tile, alone.centres(here) + (0.33, -0.21), room)
    assert (both == here[there]).all()
    assert 0 < len(both) < len(here)


@pytest.mark.slow
def test_edges_ahead_of_a_ray_are_where_inside_turns_to_outside():
    rng = np.random.default_rng(1)
    start, way = rng.uniform(-7, 7, (400, 2)), rng.normal(size=(400, 2))
    found = next_crossing(PLATE.edges, start, way, np.zeros(400))
    compiled = [
        called(next_edge)(PLATE.edges, *p, *d, 0.0) for p, d in zip(start.tolist(), way.tolist(), strict=True)
    ]
    assert np.allclose(found, compiled, rtol=1e-12, atol=1e-13)
    ends = np.isfinite(found)
    assert 0.5 < ends.mean() < 1.0
    inside = PLATE.inside(start)
    steps = np.linspace(1e-9, 1 - 1e-9, 200)
    before = start[ends, None] + (steps * found[ends, None])[..., None] * way[ends, None]
    assert (PLATE.inside(before) == inside[ends, None]).all()
    beyond = start[ends] + (found[ends] + 1e-9)[:, None] * way[ends]
    assert (PLATE.inside(beyond) != inside[ends]).all()
    points = rng.uniform(-8, 8, (3000, 2))
    assert ([called(in_plate)(PLATE.edges, *p) for p in points.tolist()] == PLATE.inside(points)).all()
    assert PLATE.edges.shape[1] == EDGE_NUMBERS


def test_the_free_rectangle_is_free_and_no_larger_one_is():
    half = ROUNDED.free_box
    assert half == pytest.approx(
        (23.4, 15.6), rel=1e-6
    )  # the hole at x = 25 of radius 1.6, in the box's proportions
    assert free_width(ROUNDED, 16.7, 19.9) == pytest.approx(2 * (25 + sqrt(25 - 4.9**2)), rel=1e-6)


@pytest.mark.parametrize(
    ("vertices", "words"),
    [
        (((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)), ""),
        (((0, 0, 1.0), (1, 0, 1.0)), ""),
        (((0, 0, 0), (1, 0, 0)), "enclose nothing"),
        (((0, 0, 0), (1, 1, 0), (1, 0, 0), (0, 1, 0)), "0 and 2"),
        (((0, 0, 0), (1, 0, 0), (1, 0, 0), (0, 1, 0)), "no length"),
        (((0, 0, 0), (2, 0, 0), (1, 0, 0), (1, 1, 0)), "0 and 1"),
        (((0, 0, 0), (4, 0, 0), (4, 4, 0), (2, 0, 0), (0, 4, 0)), "meet"),  # a corner upon a side
        (((0, 0, 0), (1, 0, -1.2), (1, 1, 0), (0, 1, -1.2)), "meet"),  # arcs that reach into one another
    ],
)
def test_outlines_that_are_none_are_named(vertices, words):
    found = fault(tuple((float(x), float(y), float(b)) for x, y, b in vertices))
    assert bool(found) == bool(words)
    assert words in found


@pytest.mark.slow
def test_ten_thousand_corners_are_looked_at_in_seconds_and_one_crossing_found():
    turn = 2 * np.pi * np.arange(10_000) / 10_000
    star = np.stack([np.cos(turn), np.sin(turn)], axis=1) * (1 + 0.2 * (np.arange(10_000) % 2))[:, None]
    corners = [(x, y, 0.0) for x, y in star.tolist()]
    assert fault(tuple(corners)) == ""
    corners[5000], corners[5003] = corners[5003], corners[5000]
    assert "meet" in fault(tuple(corners))


def test_the_least_land_beside_a_hole_is_that_of_the_sketch():
    assert least_land(ROUNDED) == pytest.approx(
        5 - 1.6
    )  # to the bottom of the round corner, whose centre the hole has
    two = Plate(plate_of_rectangle(60, 40), (Hole(0, 0, 4), Hole(10, 0, 6), Hole(-20, 12, 3)))
    assert least_land(two) == pytest.approx(5.0)
    assert least_land(Plate(plate_of_circle(9))) == np.inf


def test_turning_an_outline_round_keeps_it():
    back = counter_clockwise(
        tuple((x, y, -b) for (x, y, _), (_, _, b) in zip(L[::-1], [*L[::-1][1:], L[-1]], strict=True))
    )
    assert Plate(tuple((float(x), float(y), float(b)) for x, y, b in back)).area == pytest.approx(
        Plate(PLATE.vertices).area
    )
    assert tan(0.25 * 0.5 * pi) == pytest.approx(plate_of_circle(1.0)[0][2])
