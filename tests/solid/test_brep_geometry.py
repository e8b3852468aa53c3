"""The rational geometry of quadrics: patches, arcs, parameter curves and walls are exact."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from brepwindows import turn
from hypothesis import given, settings
from hypothesis import strategies as st

from clacad.optics.surface import Biconic, Quadric
from clacad.sheet.window import Face, lens_height
from clacad.solid.edge_classes import linked_levels
from clacad.solid.face_pattern import divided_pattern
from clacad.solid.lens_faces import fitted_lens, posed_quadric
from clacad.solid.rational_conics import parameter_curve, posed, quadric_patch, ruled_wall, section_arc

T = np.linspace(0.0, 1.0, 21)

CURVATURE = st.floats(-0.8, 0.8)
ANGLE = st.floats(-180.0, 180.0)


def some_quadric(cx, cy, kappa, side, angles):
    return posed((cx, cy, kappa), side, turn(*angles), np.array([0.1, -0.2, 3.0]))


@given(cx=CURVATURE, cy=CURVATURE, kappa=CURVATURE, side=st.sampled_from([1, -1]), phi=ANGLE, psi=ANGLE,
       theta=st.floats(0.0, 20.0))  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_patch_arc_and_parameter_curve_of_any_quadric_are_one_and_the_same_points(
    cx, cy, kappa, side, phi, theta, psi
):
    quadric = some_quadric(cx, cy, kappa, side, (phi, theta, psi))
    a, b = np.array([-0.3, -0.15]), np.array([0.35, 0.3])
    z = quadric.height(np.array([a[0], b[0]]), np.array([a[1], b[1]]))
    start, end = np.append(a, z[0]), np.append(b, z[1])
    normal = np.array([a[1] - b[1], b[0] - a[0], 0.0])
    arc = section_arc(quadric, start, end, normal)
    points = arc.at(T)
    assert np.abs(quadric.value(points)).max() < 8e-15  # some ulps of the apex height, 3 mm
    assert np.abs((points - start) @ normal).max() < 4e-15
    patch = quadric_patch(quadric, (-1.0, 1.1), (-0.9, 1.2))
    curve = parameter_curve(quadric, arc, (-1.0, 1.1), (-0.9, 1.2)).at(T)
    assert np.abs(patch.at(curve[:, 0], curve[:, 1]) - points).max() < 8e-15


def test_patch_agrees_with_the_surface_module_which_meets_rays_instead():
    face = Face(Quadric(0.7, 0.4, 0.5, -1), (0.03, -0.02, 2.0), turn(20.0, 8.0, -35.0), 0)
    quadric = posed_quadric(face)
    points = quadric_patch(quadric, (-0.3, 0.3), (-0.3, 0.3)).at(*np.random.default_rng(1).random((2, 200)))
    assert np.abs(points[:, 2] - lens_height(face, points[:, 0], points[:, 1])).max() < 2e-15
    assert np.abs(quadric.height(points[:, 0], points[:, 1]) - points[:, 2]).max() < 2e-15


@pytest.mark.parametrize("radius", [1e3, 1e7, 1e12])
def test_arc_of_a_flat_lens_keeps_the_relative_accuracy_of_its_sag(radius):
    quadric = posed((1.0 / radius, 0.5 / radius, 0.7 / radius), 1, np.eye(3), np.zeros(3))
    arc = section_arc(quadric, *(np.array([x, 0.2, quadric.height(np.array([x]), np.array([0.2]))[0]])
                                 for x in (-0.25, 0.25)), np.array([0.0, 1.0, 0.0]))  # fmt: skip
    middle = arc.at(np.array([0.5]))[0]
    with mpmath.workdps(40):
        q = mpmath.mpf(float(middle[0])) ** 2 / radius + mpmath.mpf(0.5) / radius * mpmath.mpf("0.2") ** 2
        c = mpmath.mpf(0.7) / radius
        exact = q / (1 + mpmath.sqrt(1 - c * q))
    assert abs(middle[2] / float(exact) - 1.0) < 1e-14


def test_a_plane_and_a_cylinder_give_straight_arcs():
    for coefficients in ((0.0, 0.0, 0.0), (0.8, 0.0, 0.8)):
        quadric = posed(coefficients, 1, turn(0.0, 5.0, 0.0), np.zeros(3))
        z = quadric.height(np.array([0.2, 0.2]), np.array([-0.25, 0.25]))
        start, end = np.array([0.2, -0.25, z[0]]), np.array([0.2, 0.25, z[1]])
        arc = section_arc(quadric, start, end, np.array([1.0, 0.0, 0.0]))
        assert np.abs(np.cross(arc.at(T) - start, (end - start) / 0.5)).max() < 1e-15


def test_a_ruled_wall_is_vertical_and_ends_in_both_its_arcs():
    quadric = some_quadric(0.7, 0.5, 0.6, 1, (0.0, 0.0, 0.0))
    ends = [np.array([x, 0.2]) for x in (-0.25, 0.25)]
    arcs = []
    for surface in (quadric, quadric.moved(np.array([0.03, 0.0, 0.1]))):
        z = surface.height(np.array([e[0] for e in ends]), np.array([e[1] for e in ends]))
        lifted = [np.append(e, h) for e, h in zip(ends, z)]
        arcs.append(section_arc(surface, *lifted, np.array([0.0, 1.0, 0.0])))
    wall = ruled_wall(*arcs)
    for v, arc in zip((0.0, 1.0), arcs):
        assert np.abs(wall.at(T, np.full_like(T, v)) - arc.at(T)).max() < 1e-15
    inside = wall.at(T, np.full_like(T, 0.3))
    assert np.abs(inside[:, 1] - 0.2).max() < 1e-15


def test_raising_the_degree_of_an_arc_does_not_move_it():
    quadric = some_quadric(0.7, 0.5, 0.6, 1, (10.0, 4.0, 0.0))
    z = quadric.height(np.array([-0.2, 0.2]), np.array([0.1, 0.2]))
    arc = section_arc(
        quadric, np.array([-0.2, 0.1, z[0]]), np.array([0.2, 0.2, z[1]]), np.array([-0.1, 0.4, 0.0])
    )
    assert np.abs(arc.elevated(5).at(T) - arc.at(T)).max() < 1e-14


def test_a_biconic_is_fitted_within_the_error_it_states():
    face = Face(Biconic(0.9, 0.5, -0.4, -0.9, 1), (0.01, 0.0, 1.0), turn(15.0, 3.0, 0.0), 0)
    zone = np.array([(0.25, -0.25), (0.25, 0.25), (-0.25, 0.25), (-0.25, -0.25)])
    lens = fitted_lens(face, zone, 1e-11)
    x, y = np.random.default_rng(2).uniform(-0.25, 0.25, (2, 500))
    assert lens.error <= 1e-11
    assert np.abs(lens.height(x, y) - lens_height(face, x, y)).max() < 2e-11
    arc = lens.arc(zone[0], zone[1])
    curve = lens.parameters(arc).at(T)
    assert np.abs(lens.patch.at(curve[:, 0], curve[:, 1]) - arc.at(T)).max() < 1e-13


def test_a_rim_that_leaves_the_zone_and_comes_back_divides_it_into_one_lens_and_four_corners():
    zone = 0.5 * np.array([(1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)])
    circle = np.diag([1.0, 1.0, -(0.6**2)])
    pattern = divided_pattern(zone, circle, lambda x, y: np.hypot(x, y) < 0.6, "land")
    kinds = [region.kind for region in pattern.regions]
    assert sorted(kinds) == ["land"] * 4 + ["lens"]
    for chain in pattern.chains:
        assert np.abs(np.hypot(*chain.points.T) - 0.6).max() < 1e-15


def test_heights_closer_than_the_merge_height_share_a_vertex_and_a_checkerboard_is_a_saddle():
    heights = np.array([[0.0, 9.0], [1.0, 9.0], [0.4e-6, 9.0], [1.0 + 0.9e-6, 9.0]])
    levels = linked_levels(heights, 1e-6)
    assert len(levels.z) == 3
    assert levels.saddles == 1
    assert levels.place[0][0] == levels.place[2][0]
    assert max(levels.shift) <= 0.5e-6
