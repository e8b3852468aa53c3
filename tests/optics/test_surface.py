"""Sag, normal, meeting and refraction against 60-digit arithmetic, closed forms and invariants."""

from __future__ import annotations

import numpy as np
import pytest
from hard.measure import relative, surface_of
from hard.sags import SAGS
from hypothesis import given, settings
from hypothesis import strategies as st
from mpmath import mp, mpf
from oracle import trace as oracle

from clacad.base.pairs import two_product, two_sum
from clacad.optics.surface import (
    Biconic,
    Quadric,
    as_quadric,
    conic_constants,
    gradient,
    meet,
    meet_at,
    normal,
    principal_radii,
    refract,
    sag,
)
from clacad.optics.surface.fresnel_coefficients import amplitudes, deviation

ULP = 2.0**-52

curvature = st.floats(-1.0, 1.0).map(lambda c: c if abs(c) > 1e-12 else 0.0)
conic = st.one_of(st.floats(-3.0, 3.0), st.sampled_from([-1.0, -1.0 + 1e-12, -1.0 - 1e-12, 0.0]))
side = st.sampled_from([1, -1])
quadrics = st.builds(Quadric, curvature, curvature, curvature, side)
biconics = st.builds(Biconic, curvature, curvature, conic, conic, side)
lateral = st.floats(-0.4, 0.4)
slopes = st.floats(-0.4, 0.4)


def as_face(surface):
    """The same surface for the oracle."""
    if isinstance(surface, Quadric):
        return oracle.quadric(surface.curvature_x, surface.curvature_y, surface.kappa, surface.side)
    return oracle.biconic(
        surface.curvature_x, surface.curvature_y, surface.conic_x, surface.conic_y, surface.side
    )


def relative_ulp(value, exact):
    """Error in units of 2**-52 of the exact value."""
    with mp.workdps(60):
        return float(abs(mpf(float(value)) - exact) / abs(exact)) / ULP if exact else abs(value) / ULP


@pytest.mark.parametrize("case", SAGS, ids=lambda s: s.name)
def test_sag_keeps_its_relative_accuracy(case):
    with mp.workdps(450):
        exact = oracle.sag(case.face, case.x, case.y)
    assert relative(surface_of(case.face).sag(case.x, case.y), exact) <= 3


@pytest.mark.parametrize("case", [s for s in SAGS if s.name != "on the equator"], ids=lambda s: s.name)
def test_the_normal_is_square_to_the_surface(case):
    with mp.workdps(500):
        in_x, in_y = oracle.slope(case.face, case.x, case.y)
        length = mp.sqrt(1 + in_x**2 + in_y**2)
        exact = [-in_x / length, -in_y / length, 1 / length]
    got = surface_of(case.face).normal(case.x, case.y)
    with mp.workdps(80):
        assert max(float(abs(mpf(float(u)) - v)) for u, v in zip(got, exact)) <= 4 * ULP


@given(st.one_of(quadrics, biconics), lateral, lateral)
@settings(max_examples=150, deadline=None)
def test_sag_agrees_with_sixty_digits_anywhere_on_any_surface(surface, x, y):
    with mp.workdps(60):
        exact = oracle.sag(as_face(surface), x, y)
    assert exact is not None
    # below 1e-290 the products themselves underflow
    assert abs(float(exact)) < 1e-290 or relative_ulp(surface.sag(x, y), exact) <= 4


def test_beyond_the_equator_there_is_no_surface():
    sphere = Quadric(1, 1, 1)
    assert np.isnan(sphere.sag(np.nextafter(1.0, 2.0), 0.0))
    assert np.isnan(sphere.normal(0.8, 0.61)).all()
    assert sphere.sag(1.0, 0.0) == 1.0
    assert np.isfinite(Quadric(1, 1, -1).sag(1e6, 1e6))  # a hyperboloid has no equator


def test_sag_and_normal_broadcast_and_leave_their_input_alone():
    x, y = np.linspace(-0.1, 0.1, 5), np.zeros((3, 1))
    before = x.copy()
    assert sag(Quadric(1, 1, 1), x, y).shape == (3, 5)
    assert normal(Quadric(1, 0, 1), x, y).shape == (3, 5, 3)
    assert np.array_equal(gradient(Quadric(0, 0, 0), x, y), np.broadcast_to([0.0, 0.0, 1.0], (3, 5, 3)))
    assert np.array_equal(x, before)


@given(quadrics, lateral, lateral)
@settings(max_examples=60, deadline=None)
def test_the_four_sign_changes_together_are_the_same_surface(surface, x, y):
    cx, cy, kappa = surface.curvature_x, surface.curvature_y, surface.kappa
    assert surface.sag(x, y) == Quadric(-cx, -cy, -kappa, -surface.side).sag(x, y)


@given(st.one_of(quadrics, biconics), lateral, lateral, slopes, slopes, side, st.floats(-2, 2))
@settings(max_examples=150, deadline=None)
def test_a_ray_through_a_point_of_the_surface_meets_it_there(surface, x, y, u, v, onward, back):
    point = np.array([[x, y, float(surface.sag(x, y))]])
    direction = onward * np.array([[u, v, 1.0]]) / np.sqrt(1 + u * u + v * v)
    met, there = meet_at(surface, point - back * direction, direction)
    cosine = (direction * surface.normal(x, y)).sum() * onward
    if cosine > 0.2:  # else another crossing may be the one in the ray's sense
        assert np.abs(there - point).max() <= 8 * ULP * (1 + abs(back)) / cosine
        assert abs(met.distance[0] - back) <= 16 * ULP * (1 + abs(back)) / cosine
        assert met.root[0] == pytest.approx((direction * met.gradient).sum(), abs=4 * ULP)


def test_the_start_may_be_the_apex():
    for surface in (Quadric(1, 2, 3), Quadric(0, 0, 0), Biconic(1, 2, -1, 0.5), Quadric(-1, 2, 0)):
        met = meet(surface, np.zeros((1, 3)), np.array([[0.6, 0.0, 0.8]]))
        assert met.distance[0] == 0
        assert np.array_equal(met.gradient, [[0.0, 0.0, 1.0]])


def test_only_the_half_with_the_apex_is_met():
    sphere = Quadric(1, 1, 1)
    start = np.array([[2.0, 0.0, 1.5], [0.0, 0.0, 1.9], [0.5, 0.0, -1.0], [1.5, 0.0, -1.0]])
    ray = np.array([[-1.0, 0.0, 0.01], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
    distance = meet(sphere, start, ray).distance
    assert np.isnan(distance[[0, 3]]).all()
    assert distance[1] == -1.9  # behind, and reported as such
    assert distance[2] == pytest.approx(2 - np.sqrt(0.75), abs=2 * ULP)


@pytest.mark.parametrize("seed", range(6))
def test_a_nearly_tangent_ray_is_told_from_a_miss_to_the_last_bit(seed):
    rng, sphere, centre = np.random.default_rng(seed), Quadric(1, 1, 1), np.array([0.0, 0.0, 1.0])
    direction = np.append(rng.uniform(-1, 1, 2), rng.uniform(0.2, 0.9))
    below = direction * direction[2] - centre * (direction @ direction)
    below += 0.5 * np.cross(direction, centre)
    touching = centre + below / np.linalg.norm(below)  # on the sphere, square to the ray
    truth, got = [], []
    for step in range(-40, 41):
        start = touching - rng.uniform(0.5, 3) * direction + below * step * 2.0**-53
        with mp.workdps(60):
            d, p = [mpf(v) for v in direction], [mpf(v) for v in start]
            p[2] -= 1
            truth.append(oracle.dot(d, p) ** 2 - oracle.dot(d, d) * (oracle.dot(p, p) - 1) > 0)
        got.append(bool(np.isfinite(meet(sphere, start[None], direction[None]).root[0])))
    assert got == truth
    assert 10 < sum(truth) < 71  # both sides of tangency were seen


@given(
    st.one_of(quadrics, biconics),
    lateral,
    lateral,
    slopes,
    slopes,
    st.floats(1.0, 2.0),
    st.floats(1.0, 2.0),
)
@settings(max_examples=150, deadline=None)
def test_refraction_keeps_the_tangential_momentum(surface, x, y, u, v, n1, n2):
    start = np.array([[x, y, -2.0]])
    ray = np.array([[u, v, 1.0]]) / np.sqrt(1 + u * u + v * v)
    met = meet(surface, start, ray)
    out, q = refract(ray, met.gradient, met.root, n1, n2)
    if np.isfinite(out).all():
        size = np.linalg.norm(met.gradient)
        change = n1 * np.cross(ray, met.gradient) - n2 * np.cross(out, met.gradient)
        assert np.abs(change).max() <= 16 * ULP * size  # each component on its own
        tolerance = 16 * ULP * max(1.0, size / q[0])  # near critical the cosine amplifies
        assert abs(np.linalg.norm(out) - 1) <= tolerance
        assert abs(q[0] - (out * met.gradient).sum()) <= tolerance * size


def test_equal_indices_change_nothing_at_any_incidence():
    for tilt in (0.0, 0.5, 1 - 1e-9, 1.0):
        ray = np.array([[tilt, 0.0, np.sqrt(1 - tilt * tilt)]])
        out, _ = refract(ray, np.array([[0.0, 0.0, 1.0]]), ray[:, 2], 1.5, 1.5)
        assert np.array_equal(out, ray)


@pytest.mark.parametrize("step", [1e-6, 1e-10, -1e-13])
def test_a_small_index_step_bends_by_its_own_size_to_every_digit(step):
    # axial ray on a slope of 1/2: its x component after the surface is the bending alone
    n2, normal_there, ray = 1 + step, np.array([[-0.5, 0.0, 1.0]]), np.array([[0.0, 0.0, 1.0]])
    out, _ = refract(ray, normal_there, np.array([1.0]), 1.0, n2)
    with mp.workdps(60):
        length2, mu = mpf(5) / 4, 1 / mpf(n2)
        sine2 = 1 - 1 / length2
        bend = mp.sqrt(1 - mu**2 * sine2) / mp.sqrt(length2) - mu / length2
        exact = -bend / 2
    assert relative_ulp(out[0, 0], exact) <= 4


def test_indices_may_differ_from_ray_to_ray():
    ray = np.array([[0.6, 0.0, 0.8]] * 2)
    up = np.array([[0.0, 0.0, 1.0]] * 2)
    both, _ = refract(ray, up, ray[:, 2], 1.0, np.array([1.5, 1.6]))
    for row, index in enumerate((1.5, 1.6)):
        assert np.array_equal(both[row], refract(ray[:1], up[:1], ray[:1, 2], 1.0, index)[0][0])


@given(st.floats(0.02, 1.0), st.floats(1.0, 2.5), st.floats(1.0, 2.5))
@settings(max_examples=60, deadline=None)
def test_reflected_and_transmitted_power_add_to_one(cosine, n1, n2):
    ray = np.array([[np.sqrt(1 - cosine**2), 0.0, cosine]])
    out, q = refract(ray, np.array([[0.0, 0.0, 1.0]]), ray[:, 2], n1, n2)
    if np.isfinite(q).all():
        r_s, r_p = amplitudes(deviation(ray, out), n1, n2)
        cos_in, cos_out = ray[0, 2], out[0, 2]
        t_s = 2 * n1 * cos_in / (n1 * cos_in + n2 * cos_out)
        t_p = 2 * n1 * cos_in / (n2 * cos_in + n1 * cos_out)
        flux = n2 * cos_out / (n1 * cos_in)
        assert r_s[0] ** 2 + flux * t_s**2 == pytest.approx(1, abs=1e-13)
        assert r_p[0] ** 2 + flux * t_p**2 == pytest.approx(1, abs=1e-13)


def test_at_brewsters_angle_nothing_parallel_is_reflected():
    angle = np.arctan(1.5)
    ray = np.array([[np.sin(angle), 0.0, np.cos(angle)]])
    out, _ = refract(ray, np.array([[0.0, 0.0, 1.0]]), ray[:, 2], 1.0, 1.5)
    assert abs(amplitudes(deviation(ray, out), 1.0, 1.5)[1][0]) < 1e-15


@given(curvature, curvature, st.floats(-2, 2), side, lateral, lateral, slopes, slopes)
@settings(max_examples=100, deadline=None)
def test_a_biconic_whose_meridians_agree_is_the_quadric(cx, cy, kappa, s, x, y, u, v):
    if min(abs(cx), abs(cy)) < 1e-3:
        return
    biconic = Biconic(cx, cy, kappa / cx - 1, kappa / cy - 1, s)
    quadric = Quadric(cx, cy, kappa, s)
    start, ray = np.array([[x, y, -0.5]]), np.array([[u, v, 1.0]]) / np.sqrt(1 + u * u + v * v)
    one, other = meet(biconic, start, ray), meet(quadric, start, ray)
    if other.root[0] > 0.1 and other.gradient[0, 2] > 0.1:
        # 1 + K = κ/c is rounded at the size of K, so κ is only known to 1e-16 of 1 + |κ|
        assert abs(one.distance - other.distance) <= 1e-13
        assert np.abs(one.gradient - other.gradient).max() <= 1e-13


def test_as_quadric_knows_which_biconics_are_quadrics():
    assert as_quadric(Biconic(2.0, 0.5, -0.5, 1.0, -1)) == Quadric(2.0, 0.5, 1.0, -1)
    assert as_quadric(Biconic(0.0, 0.5, 7.0, 1.0)) == Quadric(0.0, 0.5, 1.0)
    assert as_quadric(Biconic(2.0, 0.0, 0.5, 9.0)) == Quadric(2.0, 0.0, 3.0)
    with pytest.raises(ValueError, match=r"\(1 \+ K_x\) cx"):
        as_quadric(Biconic(2.0, 0.5, -4 / 9, -4 / 9))


def test_radii_and_conic_constants_read_back():
    paper = Quadric(25.0, 40.0, np.sqrt(1000.0))
    assert principal_radii(paper) == (0.04, 0.025)
    assert conic_constants(paper) == pytest.approx((np.sqrt(1.6) - 1, np.sqrt(0.625) - 1), rel=1e-14)
    assert principal_radii(Quadric(1.0, 0.0, 1.0)) == (1.0, np.inf)
    assert conic_constants(Quadric(1.0, 0.0, 1.0)) == (0.0, None)
    assert conic_constants(Biconic(1.0, 2.0, -0.4, -0.5)) == (-0.4, -0.5)


@pytest.mark.parametrize("n", [1.3, 1.5, 4.0])
def test_the_conic_of_minus_one_over_n_squared_focuses_an_axial_beam(n):
    lens = Biconic(1.0, 1.0, -1 / n**2, -1 / n**2)
    x = np.array([-0.6, -0.2, 1e-3, 0.4])
    start = np.stack([x, 0.5 * x, np.full(4, -1.0)], axis=-1)
    ray = np.broadcast_to([0.0, 0.0, 1.0], (4, 3))
    met, point = meet_at(lens, start, ray)
    out, _ = refract(ray, met.gradient, met.root, 1.0, n)
    crossing = point[:, 2] - point[:, 0] * out[:, 2] / out[:, 0]
    assert crossing == pytest.approx(n / (n - 1), rel=1e-12)


@pytest.mark.parametrize("bad", [(np.inf, 1, 1, 1), (1, np.nan, 1, 1), (1, 1, 1, 0), (1, 1, 1, 2)])
def test_what_is_no_surface_is_refused(bad):
    with pytest.raises(ValueError, match="Quadric"):
        Quadric(*bad)


@given(st.floats(-1e100, 1e100), st.floats(-1e100, 1e100))
@settings(max_examples=200, deadline=None)
def test_sums_and_products_lose_nothing(a, b):
    with mp.workdps(700):
        high, low = two_sum(a, b)
        assert mpf(float(high)) + mpf(float(low)) == mpf(a) + mpf(b)
        if abs(a * b) > 1e-250:
            high, low = two_product(a, b)
            assert mpf(float(high)) + mpf(float(low)) == mpf(a) * mpf(b)
