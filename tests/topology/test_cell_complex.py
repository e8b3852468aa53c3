"""The cell complex: every crossing found, counts in closed form, the same borders from both sides."""

from __future__ import annotations

from functools import partial
from itertools import pairwise

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from meshwindows import FORMS, joints_of, pieces_and_holes, window

from clacad.base.sign_changes import sign_changes
from clacad.mesh import mesh_body
from clacad.mesh.integer_heights import VOID
from clacad.sheet.feasibility import body_facts
from clacad.sheet.lattice import Lattice
from clacad.sheet.pattern import node_cells
from clacad.sheet.window import column, lens_height, optical_tile
from clacad.solid.solids import layers
from clacad.solid.wall_segments import column_of_side
from clacad.topology.build_complex import cell_complex, cluster, saddle_count, trace_zero
from clacad.topology.complex_parts import BorderCurve, runs_round, solid_strips

# -- roots -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("gap", [0.3, 1e-3, 1e-6])
def test_two_crossings_in_one_sampling_interval_are_both_found(gap):
    found = sign_changes(lambda t: 1e-9 * (t - 0.4) * (t - 0.4 - gap), noise=1e-26)
    np.testing.assert_allclose(found, [0.4, 0.4 + gap], rtol=0, atol=1e-10)


def test_a_zero_at_a_sample_is_a_crossing_and_a_touch_is_none():
    assert sign_changes(lambda t: t - 0.5, 1e-18) == pytest.approx([0.5], abs=1e-15)
    assert len(sign_changes(lambda t: (t - 0.5) ** 2, 1e-18)) == 0


def test_identical_profiles_and_zeros_at_the_ends_are_no_crossings():
    assert len(sign_changes(lambda t: 0.0 * t, 1e-18)) == 0
    assert len(sign_changes(lambda t: t * (t - 1.0), 1e-18)) == 0


def test_a_function_that_ends_inside_is_searched_up_to_its_end():
    def ends(t):
        with np.errstate(invalid="ignore"):
            return np.sqrt(t - 0.3) - 0.2

    assert sign_changes(ends, 1e-16) == pytest.approx([0.34], abs=1e-12)


@given(st.lists(st.floats(0.01, 0.99), min_size=1, max_size=5, unique=True))
@settings(max_examples=40, deadline=None)
def test_the_roots_of_a_product_are_its_factors(roots):
    roots = sorted(roots)
    if len(roots) > 1 and min(np.diff(roots)) < 1e-3:
        return
    found = sign_changes(lambda t: np.prod([t - r for r in roots], axis=0), 1e-18)
    np.testing.assert_allclose(found, roots, rtol=0, atol=1e-7)


# -- crossings against 40 digits -----------------------------------------------------------------------


def _height(face, x, y):
    """Height of a quadric face above (x, y) by the plain quadratic formula in 40 digits."""
    s = face.surface
    turn = mpmath.matrix(face.rotation.tolist())
    rel = [mpmath.mpf(x) - face.vertex[0], mpmath.mpf(y) - face.vertex[1], mpmath.mpf(0)]
    p = [sum(turn[j, i] * rel[j] for j in range(3)) for i in range(3)]
    d = [turn[2, i] for i in range(3)]
    c = [mpmath.mpf(v) for v in (s.curvature_x, s.curvature_y, s.kappa)]
    a2 = sum(c[i] * d[i] ** 2 for i in range(3))
    a1 = 2 * sum(c[i] * d[i] * p[i] for i in range(3)) - 2 * s.side * d[2]
    a0 = sum(c[i] * p[i] ** 2 for i in range(3)) - 2 * s.side * p[2]
    root = mpmath.sqrt(a1 * a1 - 4 * a2 * a0)
    both = [(-a1 + root) / (2 * a2), (-a1 - root) / (2 * a2)]
    return face.vertex[2] + min(both, key=abs)


def steps_of(cells, border):
    """Left minus right height of front and back, (2, n) each, on every stretch between breaks of a border."""
    a, b = np.array(border.start), np.array(border.end)
    for start, stop in pairwise([0.0, *border.breaks.tolist(), 1.0]):
        t = start + (stop - start) * np.linspace(0.01, 0.99, 23)
        left = a + t[:, None] * (b - a)
        right = left - np.array(cells.window.lattice.offset(*border.step))
        yield np.array(column(cells.window, cells.body, *left.T)) - np.array(
            column(cells.window, cells.body, *right.T)
        )


def _apart(border, offset, face, t):
    """Left minus right height at t on a border."""
    x = border.start[0] + t * (border.end[0] - border.start[0])
    y = border.start[1] + t * (border.end[1] - border.start[1])
    return _height(face, x, y) - _height(face, x - offset[0], y - offset[1])


@pytest.mark.parametrize("euler", [(45, 0, 0), (30, 1, 0), (10, 0.3, 40), (70, 4, -20)])
def test_crossings_are_those_of_the_surfaces_in_40_digits(euler):
    sheet = window(euler=euler)
    body = sheet.bodies[1]
    borders = cell_complex(sheet, body, merge=1e-12).tilings[0].borders
    with mpmath.workdps(40):
        for border in borders:
            every = []
            for face in (body.front, body.back):
                apart = partial(_apart, border, sheet.lattice.offset(*border.step), face)
                samples = [mpmath.mpf(n) / 60 + mpmath.mpf("1e-7") for n in range(60)]
                signs = [mpmath.sign(apart(t)) for t in samples]
                every += [
                    (mpmath.findroot(apart, (a, b), solver="anderson", tol=1e-45), apart)
                    for a, b, sa, sb in zip(samples[:-1], samples[1:], signs[:-1], signs[1:])
                    if sa != sb
                ]
            assert len(border.breaks) == len({round(float(exact), 12) for exact, _ in every})
            for exact, apart in every:
                slope = abs(float(mpmath.diff(apart, exact)))
                near = min(abs(found - float(exact)) for found in border.breaks.tolist())
                assert near <= 1e-15 + 2e-16 * 0.05 * 16 / slope


# -- borders and nodes -------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_the_corners_named_at_a_node_coincide_and_go_round_once(kind):
    lattice = Lattice(kind, (0.7, 0.7), (3, 3))
    for cells in node_cells(lattice):
        where = [lattice.tile()[corner] + lattice.offset(*step) for step, corner in cells]
        np.testing.assert_allclose(where, [where[0]] * len(where), atol=1e-15)
        around = [np.arctan2(*(lattice.offset(*step) - where[0])[::-1]) for step, _ in cells]
        turns = np.diff([*around, around[0]]) % (2 * np.pi)
        assert turns.sum() == pytest.approx(2 * np.pi)


@pytest.mark.parametrize("name", FORMS)
def test_breaks_of_a_border_rise_and_are_among_its_roots(name):
    sheet = window(**FORMS[name])
    for body in sheet.bodies:
        for tiling in cell_complex(sheet, body).tilings:
            for border in tiling.borders:
                assert (np.diff([0.0, *border.breaks, 1.0]) > 0.0).all()
                assert set(border.breaks.tolist()) <= set(border.roots.tolist())


@pytest.mark.parametrize(
    "name", ["tilted about both axes, offset", "saddle at every corner", "turned web", "hexagonal"]
)
def test_no_step_changes_its_sign_between_breaks(name):
    sheet = window(**FORMS[name])
    for body in sheet.bodies:
        cells = cell_complex(sheet, body)
        for border in cells.tilings[0].borders:
            for step in steps_of(cells, border):
                for d in step:
                    assert (
                        np.isnan(d).all()
                        or (np.abs(d) <= cells.merge).all()
                        or abs(np.sign(d).sum()) == len(d)
                    )


def test_flat_equal_neighbours_share_every_border():
    sheet = window()
    for body in sheet.bodies:
        for border in cell_complex(sheet, body).tilings[0].borders:
            assert len(border.breaks) == 0
            assert all((np.abs(d) <= 1e-6).all() for d in steps_of(cell_complex(sheet, body), border))


def test_turning_an_anamorphic_lens_makes_every_inner_corner_a_saddle():
    sheet = window(euler=(45, 0, 0), count=(7, 5))
    cells = cell_complex(sheet, sheet.bodies[0])
    assert saddle_count(cells) == 2 * 6 * 4
    for border in cells.tilings[0].borders:
        np.testing.assert_allclose(border.breaks, [0.5], atol=1e-12)
        before, after = (np.sign(step) for step in steps_of(cells, border))
        assert (before == -after).all()


def test_hexagons_have_no_saddles():
    sheet = window(kind="hexagonal", euler=(45, 2, 10))
    assert saddle_count(cell_complex(sheet, sheet.bodies[1])) == 0


@given(
    st.lists(st.one_of(st.floats(-5, 5), st.just(float("nan"))), min_size=1, max_size=8),
    st.floats(1e-3, 2.0),
)
@settings(max_examples=100, deadline=None)
def test_heights_closer_than_the_merge_height_become_one_and_keep_their_order(heights, merge):
    z = np.array(heights)
    merged = cluster(z, merge)
    for a in range(len(z)):
        for b in range(len(z)):
            if np.isfinite(z[a]) and np.isfinite(z[b]):
                if abs(z[a] - z[b]) <= merge:
                    assert merged[a] == merged[b]
                if z[a] < z[b]:
                    assert merged[a] <= merged[b]
    assert np.array_equal(np.isnan(z), np.isnan(merged))


# -- walls -------------------------------------------------------------------------------------------

LEVELS = st.tuples(st.integers(0, 6), st.integers(0, 6)).map(sorted)


@given(LEVELS, LEVELS)
def test_a_strip_between_two_curves_is_solid_where_its_middle_lies_in_the_column(left, right):
    heights = sorted({*left, *right})
    curves = [
        [BorderCurve(c, z == column[0]) for c, column in enumerate((left, right)) if z in column and column[0] < column[1]]
        for z in heights
    ]  # fmt: skip
    middles = [0.5 * (a + b) for a, b in zip(heights[:-1], heights[1:])]
    expected = [(left[0] < z < left[1], right[0] < z < right[1]) for z in middles]
    assert solid_strips(curves) == expected


@given(st.lists(st.booleans(), min_size=1, max_size=9))
def test_runs_round_a_line_are_numbered_by_where_they_begin(solid):
    runs = runs_round(solid)
    assert [run >= 0 for run in runs] == solid
    starts = [n for n in range(len(solid)) if solid[n] and not solid[n - 1]]
    assert [runs[n] for n in starts] == list(range(len(starts)))
    assert all(runs[n] == runs[n - 1] for n in range(len(solid)) if solid[n] and solid[n - 1])


@pytest.mark.parametrize(
    "name", ["saddle at every corner", "tilted about both axes, offset", "hexagonal", "border and web"]
)
def test_levels_of_a_node_in_millimetres_and_in_whole_steps_are_those_of_the_columns(name):
    sheet = window(**FORMS[name])
    lattice, tile = sheet.lattice, sheet.lattice.tile()
    for body in sheet.bodies:
        mesh = mesh_body(sheet, body, 4)
        (layer,) = layers(sheet, body)
        for cells in node_cells(lattice):
            corners = [corner for _, corner in cells]
            exact = np.stack(column(sheet, body, *tile[corners].T), axis=1)
            solid = [[layer.cell.faces[f].height(column_of_side(layer.cell, c, np.zeros(2), False).kind(f, 0.0),
                      *tile[[c]].T * 1e3)[0] for f in (0, 1)] for c in corners]  # fmt: skip
            np.testing.assert_allclose(np.array(solid), exact * 1e3, rtol=0, atol=1e-11)
            template = mesh.tiled[0].maker
            for corner, heights in zip(corners, exact):
                levels = [template.border_levels(corner, 0, f)[0] for f in (0, 1)]
                np.testing.assert_allclose(np.array(levels) * mesh.step, heights, rtol=0, atol=4 * mesh.step)


# -- pieces, holes -----------------------------------------------------------------------------------


def counted(sheet):
    return [pieces_and_holes(cell_complex(sheet, body)) for body in sheet.bodies]


def test_the_papers_second_array_is_200_strips_as_stated():
    assert counted(window(thickness=0.0005, count=(200, 200))) == [(1, 0), (200, 0)]


def test_tilting_the_papers_sheet_further_leaves_single_cells():
    assert counted(window(thickness=0.0005, count=(200, 200), euler=(0, 3.2, 0)))[1] == (40_000, 0)


def test_equal_round_lenses_that_miss_the_corners_leave_a_pinhole_at_every_inner_node():
    assert counted(window(thickness=0.0005, eta=(-1, -1), count=(200, 200))) == [(1, 39_601)] * 2


@pytest.mark.parametrize("name", [name for name in FORMS if name != "tilted about both axes, offset"])
def test_borders_sampled_and_borders_by_their_roots_give_the_same_pieces_and_holes(name):
    sheet = window(**FORMS[name])
    assert counted(sheet) == [(f.pieces, f.holes) for f in (body_facts(sheet, body) for body in sheet.bodies)]


def test_air_of_both_sides_that_meets_in_a_line_is_a_hole_of_the_mesh_but_none_of_the_body():
    sheet = window(**FORMS["tilted about both axes, offset"])
    assert counted(sheet) == [(1, 4), (1, 0)]
    assert [body_facts(sheet, body).holes for body in sheet.bodies] == [0, 0]


@pytest.mark.daily_cases(
    "{'thickness': 0.0005}", "{'kind': 'hexagonal', 'thickness': 0.0003, 'count': (5, 4)}"
)
@pytest.mark.parametrize(
    "keys",
    [
        {"thickness": 0.0005},
        {"thickness": 0.0006, "euler": (10, 5, 20)},
        {"thickness": 0.0005, "outline": {"circle": 0.04}, "count": (9, 9)},
        {"kind": "hexagonal", "thickness": 0.0003, "count": (5, 4)},
        {"kind": "hexagonal", "thickness": 0.00042, "count": (5, 4), "euler": (0, 2, 0)},
    ],
    ids=str,
)
def test_pieces_are_those_of_columns_sampled_along_their_borders(keys):
    sheet = window(**{"count": (5, 4), **keys})
    lattice = sheet.lattice
    kept = {tuple(c) for c in lattice.cells().tolist()}
    t = (np.arange(400) + 0.5) / 400
    for body in sheet.bodies:
        tile, joined = lattice.tile(), []
        for k in range(len(tile) // 2):
            x, y = (tile[k] + t[:, None] * (tile[k + 1] - tile[k])).T
            ox, oy = lattice.offset(*lattice.steps[k])
            (f1, b1), (f2, b2) = column(sheet, body, x, y), column(sheet, body, x - ox, y - oy)
            if (np.minimum(b1, b2) - np.maximum(f1, f2) > 0).any():
                joined.append(lattice.steps[k])
        left, number = set(kept), 0
        while left:
            number += 1
            stack = [left.pop()]
            while stack:
                i, j = stack.pop()
                for di, dj in joined:
                    for cell in ((i + di, j + dj), (i - di, j - dj)):
                        if cell in left:
                            left.remove(cell)
                            stack.append(cell)
        assert pieces_and_holes(cell_complex(sheet, body))[0] == number


def test_a_web_makes_one_piece_without_holes():
    sheet = window(**FORMS["turned web"])
    assert counted(sheet) == [(1, 0)] * 2


# -- rims ----------------------------------------------------------------------------------------------


def traced_rim(sheet, body):
    """Curves in which front and back of a body meet inside a cell, and the gap between them."""

    def gap(x, y):
        return lens_height(body.back, x, y) - lens_height(body.front, x, y)

    noise = 32.0 * np.finfo(float).eps * max(map(abs, sheet.z_range))  # a rim that touches a corner is none
    return trace_zero(lambda x, y: gap(x, y) + noise, optical_tile(sheet)), gap


def test_rims_lie_on_both_surfaces_and_end_where_the_joint_ends():
    sheet = window(thickness=0.0005)
    body = sheet.bodies[1]
    curves, gap = traced_rim(sheet, body)
    assert len(curves) == 2
    cells = cell_complex(sheet, body)
    ((start, stop),) = joints_of(cells, cells.tilings[0].borders[1])
    ends = np.array([curve.points[n] for curve in curves for n in (0, -1)])
    np.testing.assert_allclose(np.abs(ends[:, 1]), 0.0025, rtol=0, atol=1e-18)
    np.testing.assert_allclose(np.sort(0.5 - ends[:, 0] / 0.005), [start, start, stop, stop], atol=1e-9)
    x, y = np.concatenate([curve.points for curve in curves]).T
    np.testing.assert_allclose(gap(x, y), 0.0, atol=2e-15)


@pytest.mark.parametrize("name", ["strips", "hexagonal, strips", "loose cells that touch"])
def test_a_mesh_is_cut_along_the_rims_that_are_traced(name):
    sheet = window(**FORMS[name])
    body = sheet.bodies[1]
    curves, gap = traced_rim(sheet, body)
    tile = mesh_body(sheet, body, 12).tiled[0].maker.tile
    outside = (tile.part == VOID).any(axis=1)
    rim = np.intersect1d(tile.plan.triangles[outside], tile.plan.triangles[~outside])
    on = tile.plan.xy[rim]
    assert len(curves) > 0
    assert np.abs(gap(*on.T)).max() <= 8 * tile.step
    quad = np.hypot(*np.diff(tile.plan.xy[tile.plan.sides[0]], axis=0).T).max()
    for point in np.concatenate([curve.points for curve in curves]):
        assert np.hypot(*(on - point).T).min() < 1.5 * quad


def test_a_lens_inside_its_cell_has_one_round_rim():
    sheet = window(eta=(-1, -1), thickness=0.0002)
    (curve,), _ = traced_rim(sheet, sheet.bodies[0])
    assert curve.closed
    radius = np.hypot(*curve.points.T)
    sphere = 1.0 / sheet.bodies[0].front.surface.curvature_x
    np.testing.assert_allclose(radius, np.sqrt(sphere**2 - (sphere - 0.0001) ** 2), rtol=1e-9)


def test_displaced_faces_without_an_outline_are_refused():
    from dataclasses import replace

    sheet = replace(window(**FORMS["slab, displaced in y"]), outline=None)
    with pytest.raises(ValueError, match="outline"):
        cell_complex(sheet, sheet.bodies[0])
