"""Sequential traces: the sample file, named hard cases against 60 digits, fates, and laws of optics."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hard.measure import FATE_OF, assert_whole, error, interfaces, rotation
from hard.rays import GLASS, oq, pair, turned
from hypothesis import given, settings
from hypothesis import strategies as st
from mpmath import mpf

from clacad.optics.rays import NO_CELL, Fate, Rays
from clacad.optics.sequence import Interface, trace_sequence
from clacad.optics.surface import Biconic, Quadric

ULP = 2.0**-52

SAMPLE = json.loads((Path(__file__).parents[1] / "data" / "trace-sample.json").read_text())["cases"]


@pytest.mark.parametrize("case", SAMPLE, ids=[f"{c['id']} {c['group']}" for c in SAMPLE])
def test_the_sample_traces_are_met_within_their_tolerance(case):
    turn = rotation(*case["euler"]) if "euler" in case else None
    seq = []
    for one in case["interfaces"]:
        shape = dict(one["surface"])
        kind = {"Quadric": Quadric, "Biconic": Biconic}[shape.pop("kind")]
        seq.append(Interface(kind(**shape), one["vertex"], one["index_before"], one["index_after"], turn))
    result = trace_sequence(seq, Rays([case["start"]], [case["direction"]]), record=True)
    assert_whole(result, 1)
    assert result.fate[0] == FATE_OF[case["status"]]
    if case["status"] == "missed":
        assert result.position[0].tolist() == case["start"]
        return
    for k, exact in enumerate(case["directions"]):
        assert error(result.directions[k, 0], exact) <= case["tolerance"]
    for k, exact in enumerate(case["hits"]):
        gone = [float(mpf(v) - mpf(u)) for v, u in zip(exact, case["start"])]
        near = case["tolerance"] * np.linalg.norm(gone)  # of the path, not of far coordinates
        spacing = np.spacing(np.abs(np.array(exact, dtype=float)).max())
        assert error(result.hits[k, 0], exact) <= near + spacing
    path = case["optical_path"][-1]
    assert error(result.optical_path, [path]) <= case["tolerance"] * abs(float(path)) + 16 * ULP * 0.02


@pytest.mark.parametrize("turn", [None, (0.3, 0.2, -0.7)], ids=["upright", "tilted"])
@pytest.mark.parametrize("power", [10, 20, 30, 38])
def test_the_distance_of_the_source_costs_nothing(power, turn):
    # everything in binary fractions, so that both starts lie on the very same line
    near, ray = np.array([0.25, 0.75, -1.0]), np.array([[0.25, -0.5, 1.0]])
    seq = interfaces([oq(1.0, 0.5, 0.7, vertex=(0.25, 0.5, 0.0), euler=turn)])
    one = trace_sequence(seq, Rays([near], ray))
    far = trace_sequence(seq, Rays([near - 2.0**power * ray[0]], ray))
    assert one.fate[0] == far.fate[0] == Fate.ALIVE
    np.testing.assert_allclose(far.direction, one.direction, rtol=0, atol=2 * ULP)
    np.testing.assert_allclose(far.position, one.position, rtol=0, atol=2 * ULP)
    assert far.optical_path[0] == pytest.approx(
        one.optical_path[0] + 2.0**power * np.linalg.norm(ray), rel=2 * ULP
    )


def test_rows_that_cannot_be_traced_are_invalid_and_kept_as_given():
    start = [[0, 0, -1], [np.nan, 0, -1], [0, 0, -1], [0, 0, -1], [0, 0, -1]]
    ray = [[0, 0, 1], [0, 0, 1], [0, 0, 0], [0, np.inf, 1], [0, 0, 2]]
    rays = Rays(start, ray, wavelength=[5e-7, 5e-7, 5e-7, 5e-7, np.nan])
    result = trace_sequence(interfaces([oq(1, 1, 1)]), rays, record=True)
    assert result.fate.tolist() == [Fate.ALIVE] + 4 * [Fate.INVALID]
    assert result.fate.dtype == np.uint8
    assert np.array_equal(result.direction[2:], np.array(ray, dtype=float)[2:])
    assert np.isnan(result.position[1, 0])
    assert_whole(result, 5)


def test_a_result_row_says_where_the_ray_ended():
    # glass between a plane and a back of radius 1, whose critical height is 2/3
    faces = [oq(0, 0, 0), oq(1, 1, 1, -1, vertex=(0, 0, 1), **GLASS)]
    start = [[0.3, 0, -1], [0.7, 0, -1], [1.5, 0, -1], [0, 0, 0.5]]
    rays = Rays(start, [[0, 0, 3.0]] * 4)
    result = trace_sequence(interfaces(faces), rays, record=True)
    assert result.fate.tolist() == [Fate.ALIVE, Fate.TIR, Fate.MISSED, Fate.MISSED]
    assert result.surface.tolist() == [1, 1, 0, NO_CELL]
    assert (result.cell == NO_CELL).all()
    assert (result.order == NO_CELL).all()
    assert result.cell.shape == (4, 2)
    assert (result.flux == 1).all()
    assert result.direction[2].tolist() == [0, 0, 3]  # missed: as launched
    assert result.position[2].tolist() == [1.5, 0, -1]
    assert result.optical_path[2] == 0
    assert np.array_equal(result.direction[1], result.directions[0, 1])  # ended: the direction before
    assert np.array_equal(result.position[:2], result.hits[-1, :2])
    assert result.hits.shape == result.directions.shape == (2, 4, 3)
    assert result.counts() == {**{f.name: 0 for f in Fate}, "ALIVE": 1, "TIR": 1, "MISSED": 2}
    assert trace_sequence(interfaces(faces), rays).hits is None


def test_light_outside_an_aperture_is_vignetted():
    plane = Quadric(0, 0, 0)
    turn = rotation(np.pi / 2, 0, 0)
    start = [[0.9, 0, -1], [1.0, 0, -1], [0.8, 0.4, -1], [0, 0.51, -1], [0.9, 0.49, -1]]
    rays = Rays(start, [[0, 0, 1]] * 5)

    def fates(kind, half_x, half_y, rotation=None):
        return trace_sequence(
            [Interface(plane, (0, 0, 0), 1.0, 1.5, rotation, (kind, half_x, half_y))], rays
        ).fate

    out, on = Fate.VIGNETTED, Fate.ALIVE
    assert fates("rectangle", 1.0, 0.5).tolist() == [on, on, on, out, on]
    assert fates("ellipse", 1.0, 0.5).tolist() == [on, on, out, out, out]
    # turned by 90 degrees the aperture's x lies along the sheet's y
    assert fates("rectangle", 0.5, 1.1, turn).tolist() == [on, on, on, out, on]


def test_light_that_leaves_downwards_is_backward():
    faces = [oq(-1, -1, -1, before=1.0, after=1.0, euler=(0.0, 0.0, 0.0))]
    result = trace_sequence(interfaces(faces), Rays([[0, 0, 1], [0, 0, -1]], [[0, 0, -1], [0, 0, 1]]))
    assert result.fate.tolist() == [Fate.BACKWARD, Fate.ALIVE]


def test_faces_that_touch_are_crossed_without_a_gap():
    rng = np.random.default_rng(0)
    start = np.column_stack([rng.uniform(-0.3, 0.3, (500, 2)), np.full(500, -1.0)])
    rays = Rays(start, np.column_stack([rng.uniform(-0.2, 0.2, (500, 2)), np.ones(500)]))
    turn = rotation(0.3, 0.1, 0.5)
    for pose in (None, turn):
        cemented = [
            Interface(Quadric(1, 0.5, 0.7), (0.1, 0.2, 0.05), n1, n2, pose)
            for n1, n2 in ((1.0, 1.5), (1.5, 1.6), (1.6, 1.6))
        ]
        assert trace_sequence(cemented, rays).counts()["ALIVE"] == 500


def test_one_ray_is_traced_as_among_many():
    rng = np.random.default_rng(1)
    rays = Rays(
        np.column_stack([rng.uniform(-2e-3, 2e-3, (300, 2)), np.full(300, -0.01)]),
        np.column_stack([rng.uniform(-0.05, 0.05, (300, 2)), np.ones(300)]),
    )
    seq = interfaces(turned(pair(), 0.3, 0.01, -0.2))
    together = trace_sequence(seq, rays)
    for i in range(0, 300, 23):
        alone = trace_sequence(seq, Rays(rays.position[i : i + 1], rays.direction[i : i + 1]))
        assert np.array_equal(alone.direction[0], together.direction[i])
        assert np.array_equal(alone.position[0], together.position[i])
        assert alone.fate[0] == together.fate[i]


def test_a_direction_that_is_unit_to_rounding_is_not_rounded_again():
    rng = np.random.default_rng(2)
    ray = rng.normal(size=(2000, 3))
    ray[:, 2] = np.abs(ray[:, 2]) + 0.1
    ray /= np.linalg.norm(ray, axis=1)[:, None]
    window = [Interface(Quadric(0, 0, 0), (0, 0, 0), 1.0, 1.0)]
    assert np.array_equal(trace_sequence(window, Rays(-ray, ray)).direction, ray)


def test_inputs_are_left_alone_and_nothing_is_required_to_arrive():
    start, ray = np.array([[0.0, 0.0, -1.0]]), np.array([[0.0, 0.0, 2.0]])
    rays = Rays(start, ray)
    trace_sequence(interfaces(pair()), rays)
    assert rays.direction[0, 2] == 2.0
    assert start[0, 2] == -1.0
    empty = trace_sequence(interfaces(pair()), Rays(np.zeros((0, 3)), np.zeros((0, 3))), record=True)
    assert_whole(empty, 0)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ({"vertex": (0, 0)}, "vertex"),
        ({"index_after": 0.0}, "index_after"),
        ({"rotation": np.diag([1, 1, -1.0])}, "proper"),
        ({"rotation": np.eye(2)}, "rotation"),
        ({"aperture": ("circle", 1, 1)}, "aperture"),
        ({"aperture": ("ellipse", 1, 0)}, "aperture"),
    ],
)
def test_an_interface_that_cannot_be_is_refused_by_name(arguments, word):
    good = {"surface": Quadric(1, 1, 1), "vertex": (0, 0, 0), "index_before": 1.0, "index_after": 1.5}
    with pytest.raises(ValueError, match=word):
        Interface(**{**good, **arguments})


def test_shapes_that_are_no_rays_are_refused():
    with pytest.raises(ValueError, match=r"position has shape \(2,\)"):
        Rays([0, 0], [[0, 0, 1]])
    with pytest.raises(ValueError, match="2 positions but 1 directions"):
        Rays([[0, 0, 0]] * 2, [[0, 0, 1]])
    with pytest.raises(ValueError, match="wavelength"):
        Rays([[0, 0, 0]], [[0, 0, 1]], [5e-7, 6e-7])
    with pytest.raises(ValueError, match="no surface"):
        trace_sequence([], Rays([[0, 0, 0]], [[0, 0, 1]]))


curvature = st.floats(0.0, 60.0)
index = st.floats(1.05, 2.0)
small = st.floats(-1.5e-3, 1.5e-3)
slope = st.floats(-0.05, 0.05)


@st.composite
def systems(draw):
    """A biconvex or biconcave lens with independent faces, turned and shifted."""
    n, sign = draw(index), draw(st.sampled_from([1, -1]))
    faces = []
    for k, s in enumerate((1, -1)):
        cx, cy, kappa = (sign * draw(curvature) for _ in range(3))
        place = {"vertex": (draw(small), draw(small), k * 2e-3), "before": (1.0, n)[k], "after": (n, 1.0)[k]}
        turn = rotation(draw(st.floats(-3, 3)), draw(st.floats(-0.05, 0.05)), draw(st.floats(-3, 3)))
        faces.append(oq(cx, cy, kappa, s, rotation=turn, **place))
    return faces


@given(systems(), small, small, slope, slope)
@settings(max_examples=60, deadline=None)
def test_light_sent_back_retraces_its_path(faces, x, y, u, v):
    seq = interfaces(faces)
    there = trace_sequence(seq, Rays([[x, y, -0.01]], [[u, v, 1.0]]))
    if there.fate[0] != Fate.ALIVE:
        return
    # the system turned by half a turn about x, so that the light coming back runs towards +z again
    half = np.diag([1.0, -1.0, -1.0])
    back = [
        Interface(
            Quadric(i.surface.curvature_x, i.surface.curvature_y, i.surface.kappa, -i.surface.side),
            half @ np.array(i.vertex),
            i.index_after,
            i.index_before,
            half @ i.rotation @ half,
        )
        for i in reversed(seq)
    ]
    start = there.position + 0.02 * there.direction
    home = trace_sequence(back, Rays(start @ half, -there.direction @ half))
    assert home.fate[0] == Fate.ALIVE
    sent = np.array([u, v, 1.0]) / np.sqrt(u * u + v * v + 1)
    np.testing.assert_allclose(-home.direction[0] @ half, sent, rtol=0, atol=1e-13)
    off_line = np.cross(home.position[0] @ half - np.array([x, y, -0.01]), sent)
    assert np.abs(off_line).max() < 1e-15


@given(systems(), small, small, slope, slope, st.integers(-40, 40))
@settings(max_examples=60, deadline=None)
def test_a_change_of_unit_by_a_power_of_two_changes_no_bit(faces, x, y, u, v, power):
    scale = 2.0**power
    scaled = [
        replace(f, shape=tuple(c / scale for c in f.shape[:3]) + f.shape[3:], vertex=tuple(np.array(f.vertex) * scale))
        for f in faces
    ]  # fmt: skip
    start, ray = np.array([[x, y, -0.01]]), [[u, v, 1.0]]
    one = trace_sequence(interfaces(faces), Rays(start, ray), record=True)
    other = trace_sequence(interfaces(scaled), Rays(start * scale, ray), record=True)
    assert np.array_equal(one.fate, other.fate)
    assert np.array_equal(one.direction, other.direction)
    assert np.array_equal(one.hits * scale, other.hits)
    assert np.array_equal(one.optical_path * scale, other.optical_path)


@given(st.lists(st.floats(-60, 60), min_size=3, max_size=3), small, small, slope, slope)
@settings(max_examples=60, deadline=None)
def test_a_quarter_turn_of_everything_turns_the_answer(shape, x, y, u, v):
    cx, cy, kappa = shape
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    start, ray = np.array([[x, y, -0.01]]), np.array([[u, v, 1.0]])
    one = trace_sequence(interfaces([oq(cx, cy, kappa)]), Rays(start, ray))
    rays = Rays(start @ quarter.T, ray @ quarter.T)
    swapped = trace_sequence(interfaces([oq(cy, cx, kappa)]), rays)
    turned_face = trace_sequence([Interface(Quadric(cx, cy, kappa), (0, 0, 0), 1.0, 1.5, quarter)], rays)
    for other in (swapped, turned_face):
        assert other.fate[0] == one.fate[0]
        if one.fate[0] == Fate.ALIVE:
            np.testing.assert_allclose(other.direction, one.direction @ quarter.T, rtol=0, atol=2 * ULP)


@given(systems(), small, small, slope, slope, st.integers(-(10**6), 10**6))
@settings(max_examples=60, deadline=None)
def test_a_lens_a_million_places_away_refracts_the_same_to_the_last_bit(faces, x, y, u, v, cell):
    # pitch and coordinates on a grid of 2**-40, so that sheet coordinates themselves are exact
    snap = lambda p: np.round(np.asarray(p) * 2.0**30) / 2.0**30  # noqa: E731
    shift = np.array([cell * 2.0**-8, -cell * 2.0**-8, 0.0])
    near = [replace(f, vertex=tuple(snap(f.vertex))) for f in faces]
    far = [replace(f, vertex=tuple(snap(f.vertex) + shift)) for f in faces]
    start, ray = snap([[x, y, -0.01]]), [[u, v, 1.0]]
    one = trace_sequence(interfaces(near), Rays(start, ray))
    other = trace_sequence(interfaces(far), Rays(start + shift, ray))
    assert np.array_equal(one.fate, other.fate)
    if one.fate[0] == Fate.ALIVE:
        assert np.array_equal(one.direction, other.direction)
        assert np.array_equal(one.optical_path, other.optical_path)


@given(systems(), small, small, slope, slope)
@settings(max_examples=40, deadline=None)
def test_etendue_is_conserved(faces, x, y, u, v):
    """The map (x, y, n L, n M) -> the same behind the lens has determinant 1 (Liouville)."""
    seq, step = interfaces(faces), 1e-5
    p, q = u / np.sqrt(1 + u * u + v * v), v / np.sqrt(1 + u * u + v * v)
    # x, y at 1e-2 of the momenta's size: all four columns are of order one
    centre, sizes = np.array([x, y, p, q]), np.array([1e-2, 1e-2, 1.0, 1.0])
    rows = np.concatenate([centre + step * np.diag(sizes), centre - step * np.diag(sizes)])
    start = np.column_stack([rows[:, :2], np.full(8, -0.01)])
    ray = np.column_stack([rows[:, 2:], np.sqrt(1 - (rows[:, 2:] ** 2).sum(axis=1))])
    out = trace_sequence(seq, Rays(start, ray))
    if (out.fate != Fate.ALIVE).any():
        return
    plane = out.position + ((0.01 - out.position[:, 2]) / out.direction[:, 2])[:, None] * out.direction
    image = np.column_stack([plane[:, :2], out.direction[:, :2]]) / sizes
    jacobian = (image[:4] - image[4:]) / (2 * step)
    assert np.linalg.det(jacobian) == pytest.approx(1, abs=1e-6)


@given(systems(), small, small, slope, slope)
@settings(max_examples=40, deadline=None)
def test_the_path_is_stationary_between_its_ends(faces, x, y, u, v):
    """Fermat: moving the point on a face along the face changes the optical path only in second order."""
    seq = interfaces(faces)
    result = trace_sequence(seq, Rays([[x, y, -0.01]], [[u, v, 1.0]]), record=True)
    if result.fate[0] != Fate.ALIVE:
        return
    first, second = result.hits[:, 0]
    start, n = np.array([x, y, -0.01]), seq[0].index_after
    for axis in (0, 1):
        lengths = []
        for step in (1e-7, -1e-7):
            local = seq[0].rotation.T @ (first - seq[0].vertex)
            local[axis] += step
            local[2] = seq[0].surface.sag(local[0], local[1])
            moved = seq[0].rotation @ local + seq[0].vertex
            lengths.append(np.linalg.norm(moved - start) + n * np.linalg.norm(second - moved))
        assert abs(lengths[0] - lengths[1]) / 2e-7 < 1e-8
