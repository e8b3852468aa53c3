"""The ideal law against two thin lenses in 400 digits, against its own symmetries, against the paper."""

from __future__ import annotations

import itertools
import json
from math import atan, cos, degrees, hypot, inf, nan, pi, radians, sin, tan
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from mpmath import mp, mpf
from oracle import law as oracle

from clacad.optics.law import (
    Law,
    angle_between,
    apparent_map,
    euler_angles,
    image_planes,
    image_point,
    refract_2d,
    rotation,
    rotation_degrees,
    small_angle_2d,
    stretch,
    stretch_on_sheet,
)

ULP = 2.0**-52
SAMPLES = json.loads((Path(__file__).parents[1] / "data" / "law-sample.json").read_text())["cases"]
PAPER = Law(-0.25, -1.0)


def numbers(law: Law) -> tuple[float, ...]:
    return (law.eta_x, law.eta_y, law.delta_x, law.delta_y, law.phi, law.theta, law.psi)


def directions(count: int = 40, spread: float = 0.3, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-spread, spread, (count, 2)), np.ones(count)])


def error_in_ulp(got: np.ndarray, exact: list) -> float:
    with mp.workdps(60):
        return float(mp.sqrt(sum((mpf(float(g)) - e) ** 2 for g, e in zip(got, exact))) / ULP)


# ------------------------------------------------------------------------------- against numbers


@pytest.mark.parametrize("case", SAMPLES, ids=lambda c: f"{c['id']}-{c['group']}")
def test_each_published_case_is_met_to_its_tolerance(case):
    def refract():
        law = Law(*case["eta"], *case["delta"], case["phi"], case["theta"], case["psi"])
        return law.refract([case["d"]])[0]

    if case["status"] == "refused":
        if 0.0 in case["eta"]:
            with pytest.raises(ValueError, match="no lens pair"):
                refract()
        else:
            assert np.isnan(refract()).all()
        return
    for got, text in zip(refract(), case["out"], strict=True):
        exact = mpf(text)
        allowed = 16 * ULP * abs(exact) if case.get("relative") else case["tolerance"]
        assert abs(mpf(float(got)) - exact) <= allowed


@pytest.mark.parametrize("quarter", [pi / 2, pi, 3 * pi / 2, -pi / 2, radians(450)])
def test_a_quarter_turn_keeps_tiny_components_as_well(quarter):
    out = Law(-0.25, -1, phi=quarter).refract([[1e-150, 3e-160, 1]])[0]
    swapped = round(quarter / (pi / 2)) % 2 == 1
    expected = [-1e-150, -12e-160] if swapped else [-4e-150, -3e-160]
    np.testing.assert_allclose(out[:2], expected, rtol=4 * ULP, atol=0)


@pytest.mark.slow
def test_random_laws_of_every_size_agree_with_two_thin_lenses():
    rng = np.random.default_rng(7)
    worst, answered = 0.0, 0
    for _ in range(150):
        eta = rng.choice([-1, 1], 2) * 10 ** rng.uniform(-3, 3, 2)
        law = Law(*eta, *rng.normal(0, 0.3, 2), *rng.uniform(-3, 3, 3) * [1, 0.3, 1])
        d = [*rng.normal(0, 0.3, 2), 1.0]
        exact, got = oracle.refract(numbers(law), d), law.refract([d])[0]
        if isinstance(exact, oracle.Refused):
            assert np.isnan(got).all()
            continue
        answered += 1
        worst = max(worst, error_in_ulp(got, exact) / (1 + oracle.condition(numbers(law), d)))
    assert answered > 50
    assert worst <= 4


# --------------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("law", "d"),
    [
        pytest.param(PAPER, [0, 0, 0], id="zero"),
        pytest.param(PAPER, [nan, 0, 1], id="NaN"),
        pytest.param(PAPER, [0, inf, 1], id="infinite"),
        pytest.param(PAPER, [0.1, 0, -0.9], id="towards -z"),
        pytest.param(PAPER, [1, 0, 0], id="along the sheet"),
        pytest.param(Law(-0.5, -0.5, theta=pi / 4), [0, 0.72, 0.69], id="behind the lens"),
        pytest.param(Law(-0.5, -1.5, 0.05, -0.1, theta=pi / 3), [-0.06, 0.34, 0.94], id="turned back"),
    ],
)
def test_light_the_law_has_no_answer_for_gets_no_direction(law, d):
    assert np.isnan(law.refract([d])).all()
    assert isinstance(oracle.refract(numbers(law), d), oracle.Refused)


def test_a_refused_row_does_not_touch_its_neighbours():
    good = directions(5)
    mixed = good.copy()
    mixed[2] = [0, 0, -1]
    out = PAPER.refract(mixed)
    np.testing.assert_array_equal(out[[0, 1, 3, 4]], PAPER.refract(good)[[0, 1, 3, 4]])
    assert np.isnan(out[2]).all()


@pytest.mark.parametrize("side", [-1, 1])
def test_the_forward_hemisphere_of_the_lens_ends_where_the_axis_says(side):
    law = Law(-0.5, -0.5, theta=radians(30))  # the axis leans 30 degrees to -y
    to_the_edge = radians(60) + side * 1e-9  # from z towards +y
    out = law.refract([[0, sin(to_the_edge), cos(to_the_edge)]])
    if side > 0:
        assert np.isnan(out).all()
    else:
        assert (
            isinstance(oracle.refract(numbers(law), [0, sin(to_the_edge), cos(to_the_edge)]), oracle.Refused)
            == np.isnan(out).all()
        )


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"eta_x": 0.0, "eta_y": 1}, "eta_x = 0"),
        ({"eta_x": 1, "eta_y": -0.0}, "eta_y = 0"),
        ({"eta_x": nan, "eta_y": 1}, "not a finite number"),
        ({"eta_x": 1, "eta_y": 1, "delta_x": inf}, "delta_x = inf"),
        ({"eta_x": 1, "eta_y": 1, "theta": nan}, "theta = nan"),
        ({"eta_x": 1, "eta_y": 1, "axes": "zxz"}, "Euler convention"),
    ],
)
def test_what_is_no_law_is_refused_with_a_sentence(arguments, says):
    with pytest.raises(ValueError, match=says):
        Law(**arguments)


def test_eta_one_with_an_offset_is_a_law():
    assert Law(1, 1, 0.1, 0).refract([[0.1, 0, 1]])[0] == pytest.approx([0, 0, 1], abs=1e-16)


def test_directions_must_have_three_components():
    with pytest.raises(ValueError, match="last dimension must be 3"):
        PAPER.refract([[1.0, 2.0]])


def test_one_direction_and_many_give_the_same_bits():
    many = directions(20_000, 0.4)  # more than one block
    law = Law(-0.25, -1, 0.02, 0.01, 0.3, 0.1, 0.2)
    out = law.refract(many)
    for i in (0, 8191, 8192, 19_999):
        np.testing.assert_array_equal(law.refract(many[i]), out[i])


# -------------------------------------------------------------------------------------- symmetries

angles = st.floats(-3.0, 3.0)
tilts = st.floats(-0.4, 0.4)
etas = st.tuples(st.sampled_from([-1.0, 1.0]), st.floats(0.1, 8.0)).map(lambda p: p[0] * p[1])
deltas = st.floats(-0.3, 0.3)
laws = st.builds(Law, etas, etas, deltas, deltas, angles, tilts, angles, st.sampled_from(["fixed", "moving"]))
slopes = st.floats(-0.3, 0.3)
rays = st.tuples(slopes, slopes).map(lambda t: np.array([[t[0], t[1], 1.0]]))

FLIP_X, FLIP_Y, FLIP_Z = np.diag([-1.0, 1, 1]), np.diag([1.0, -1, 1]), np.diag([1.0, 1, -1])


def stretch_of(law: Law) -> float:
    """A bound of how much the law and its inverse stretch rounding errors."""
    values = np.linalg.svd(law.matrix(), compute_uv=False)
    return float(values[0] / values[-1])


@given(laws, rays)
def test_the_inverse_sheet_undoes_the_sheet(law, d):
    out = law.refract(d)
    assume(np.isfinite(out).all())
    back = law.inverse().refract(out)
    assert angle_between(back, d)[0] <= 1e-15 * stretch_of(law) ** 2


@given(laws, rays)
def test_light_sent_back_through_the_same_sheet_returns_the_way_it_came(law, d):
    out = law.refract(d)
    assume(np.isfinite(out).all())
    back = law.reversed().refract(-out @ FLIP_Z) @ FLIP_Z
    assert angle_between(back, -d)[0] <= 1e-15 * stretch_of(law) ** 2


@given(laws, rays, st.floats(1e-100, 1e100))
def test_the_length_of_a_direction_does_not_matter(law, d, length):
    out = law.refract(d)
    scaled = law.refract(d * length)
    np.testing.assert_array_equal(np.isnan(out), np.isnan(scaled))
    if np.isfinite(out).all():
        assert angle_between(out, scaled)[0] <= 1e-14 * stretch_of(law)


def turned_by(law: Law, d_phi: float = 0.0, d_psi: float = 0.0) -> Law:
    if law.axes == "moving":
        d_phi, d_psi = d_psi, d_phi
    return Law(
        law.eta_x, law.eta_y, law.delta_x, law.delta_y, law.phi + d_phi, law.theta, law.psi + d_psi, law.axes
    )


@given(laws)
def test_known_parameter_sets_mean_the_same_law(law):
    half = turned_by(law, pi)
    assert law.same_as(
        Law(law.eta_x, law.eta_y, -law.delta_x, -law.delta_y, half.phi, law.theta, half.psi, law.axes)
    )
    quarter = turned_by(law, pi / 2)
    assert law.same_as(
        Law(law.eta_y, law.eta_x, law.delta_y, -law.delta_x, quarter.phi, law.theta, quarter.psi, law.axes)
    )
    over = turned_by(law, pi, pi)
    assert law.same_as(
        Law(law.eta_x, law.eta_y, law.delta_x, law.delta_y, over.phi, -law.theta, over.psi, law.axes)
    )
    swapped = "moving" if law.axes == "fixed" else "fixed"
    assert law.same_as(
        Law(law.eta_x, law.eta_y, law.delta_x, law.delta_y, law.psi, law.theta, law.phi, swapped)
    )


@given(laws)
def test_the_canonical_parameters_are_the_same_law_and_stay(law):
    canonical = law.canonical()
    assert canonical.same_as(law)
    assert canonical.canonical() == canonical
    assert canonical.axes == "fixed"
    assert canonical.theta >= 0
    assert -pi / 4 < canonical.phi <= pi / 4 + 2e-9


def test_canonical_parameters_of_the_paper_are_its_own():
    for law in (PAPER, Law(-2, -1), Law(-0.25, -1, 0.005, 0.01, pi / 4, radians(0.5), pi / 2)):
        assert law.canonical() == law


def test_only_phi_plus_psi_matters_where_the_axis_stands_upright():
    assert Law(-0.25, -1, 0.1, 0, 0.2, 0, 0.5).canonical().phi == pytest.approx(0.7, abs=1e-15)
    assert Law(-0.25, -1, 0.1, 0, 0.2, 0, 0.5).same_as(Law(-0.25, -1, 0.1, 0, 0.7, 0, 0))


@given(laws, rays)
def test_the_mirror_image_of_the_sheet_is_the_law_with_the_mirrored_parameters(law, d):
    flipped_x = Law(law.eta_x, law.eta_y, -law.delta_x, law.delta_y, -law.phi, law.theta, -law.psi, law.axes)
    flipped_y = Law(law.eta_x, law.eta_y, law.delta_x, -law.delta_y, -law.phi, -law.theta, -law.psi, law.axes)
    for mirror, image in ((FLIP_X, flipped_x), (FLIP_Y, flipped_y)):
        np.testing.assert_allclose(
            image.refract(d @ mirror) @ mirror, law.refract(d), atol=1e-14 * stretch_of(law)
        )


@given(laws, rays, angles)
def test_turning_the_sheet_turns_everything(law, d, by):
    c, s = cos(by), sin(by)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    out, turned = law.refract(d), turned_by(law, d_psi=by).refract(d @ turn.T)
    np.testing.assert_allclose(turned, out @ turn.T, atol=1e-13 * stretch_of(law))


@given(laws)
def test_the_undeviated_direction_is_not_turned(law):
    assume(abs(law.eta_x - 1) > 0.05 and abs(law.eta_y - 1) > 0.05)
    d = law.undeviated()
    out = law.refract([d])
    assume(np.isfinite(out).all())
    assert angle_between(out[0], d) <= 1e-14 * stretch_of(law)


def test_a_prism_has_no_undeviated_direction():
    with pytest.raises(ValueError, match="turns every direction"):
        Law(1, -1, 0.1, 0).undeviated()


@given(laws, rays, rays, rays)
def test_directions_in_one_plane_stay_in_one_plane(law, a, b, c):
    middle = a + 0.3 * b
    out = law.refract(np.vstack([a, b, middle]))
    assume(np.isfinite(out).all())
    assert abs(np.linalg.det(out)) <= 1e-13 * stretch_of(law)
    del c


@given(laws)
def test_the_determinant_of_the_matrix_is_one_over_both_etas(law):
    assert np.linalg.det(law.matrix()) == pytest.approx(1 / (law.eta_x * law.eta_y), rel=1e-10)


@given(laws, rays)
def test_light_is_bent_as_the_matrix_says(law, d):
    out = law.refract(d)
    assume(np.isfinite(out).all())
    assert angle_between(out, d @ law.matrix().T)[0] <= 1e-14 * stretch_of(law)


def test_a_law_without_a_turn_is_exactly_the_identity_in_its_rotation():
    assert np.array_equal(Law(-0.25, -1).rotation, np.eye(3))
    d = directions()
    np.testing.assert_allclose(
        Law(1, 1, phi=0.3, theta=0.2).refract(d), d / np.linalg.norm(d, axis=1)[:, None], atol=1e-15
    )


# ------------------------------------------------------------------------------------- orientation


@pytest.mark.parametrize("turns", list(itertools.product(range(-3, 5), (0, 1, 2), range(-1, 3))))
def test_quarter_turns_are_exact_in_degrees_and_in_radians(turns):
    in_degrees = rotation_degrees(*(90.0 * t for t in turns))
    assert set(np.abs(in_degrees).ravel()) <= {0.0, 1.0}
    np.testing.assert_array_equal(in_degrees, rotation(*(radians(90.0 * t) for t in turns)))


@given(angles, angles, angles, st.sampled_from(["fixed", "moving"]))
def test_the_rotation_is_one_turn_after_the_other(phi, theta, psi, axes):
    expected = np.array([[float(x) for x in v] for v in oracle.lens_frame(phi, theta, psi, axes)]).T
    np.testing.assert_allclose(rotation(phi, theta, psi, axes), expected, atol=4e-16)
    np.testing.assert_allclose(
        rotation_degrees(degrees(phi), degrees(theta), degrees(psi), axes), expected, atol=3e-15
    )


def test_the_optical_axis_leans_to_minus_y_for_positive_theta():
    np.testing.assert_allclose(Law(-1, -1, theta=0.1).optical_axis, [0, -sin(0.1), cos(0.1)], atol=1e-16)


@given(angles, st.floats(1e-6, 3.0), angles)
def test_euler_angles_return_their_rotation(phi, theta, psi):
    r = rotation(phi, theta, psi)
    np.testing.assert_allclose(rotation(*euler_angles(r)), r, atol=1e-14)


def test_an_unknown_convention_is_refused():
    with pytest.raises(ValueError, match="zyz"):
        rotation(0, 0, 0, "zyz")  # type: ignore[arg-type]


# ------------------------------------------------------------------------------------- composition


@given(etas, etas, deltas, deltas, etas, etas, deltas, deltas, angles, tilts, angles, rays)
def test_two_sheets_of_one_orientation_are_one_sheet(a, b, c, d, e, f, g, h, phi, theta, psi, ray):
    first, second = Law(a, b, c, d, phi, theta, psi), Law(e, f, g, h, phi, theta, psi)
    through_both = second.refract(first.refract(ray))
    assume(np.isfinite(through_both).all())
    one = first.then(second)
    assert (one.phi, one.theta, one.psi) == (phi, theta, psi)
    assert angle_between(one.refract(ray), through_both)[0] <= 1e-14 * stretch_of(first) * stretch_of(second)


@settings(max_examples=50)
@given(laws, etas, deltas, deltas, angles, rays)
def test_a_round_sheet_on_the_same_axis_composes_with_any(law, eta, delta_x, delta_y, phi, ray):
    fixed = law.canonical()
    other = Law(eta, eta, delta_x, delta_y, phi, fixed.theta, fixed.psi)
    one = fixed.then(other)
    np.testing.assert_allclose(
        one.matrix() / np.linalg.norm(one.matrix()),
        other.matrix() @ fixed.matrix() / np.linalg.norm(other.matrix() @ fixed.matrix()),
        atol=1e-11 * stretch_of(law),
    )


def test_two_upright_sheets_of_different_phi_are_no_law_and_the_error_says_so():
    with pytest.raises(ValueError, match="principal axes do not agree"):
        PAPER.then(Law(-0.25, -1, phi=0.3))


def test_sheets_without_a_common_axis_are_no_law_and_the_error_says_so():
    with pytest.raises(ValueError, match=r"no common optical axis.*17\.2 degrees"):
        Law(-0.25, -1, 0.1, 0.05, 0.2, 0.1, 0.1).then(Law(-2, -3, 0.1, 0.2, 0.5, 0.4, 0.1))


def test_a_sheet_and_its_inverse_make_a_pane_of_glass():
    law = Law(-0.25, -1, 0.1, 0.2, 0.3, 0.1, 0.2)
    assert law.then(law.inverse()).same_as(Law(1, 1))
    assert law.then(Law(1, 1, theta=0.3)).same_as(law)


def test_two_half_turns_are_nothing():
    half_turn = Law(-1, -1)
    assert half_turn.then(half_turn) == Law(1, 1)


# --------------------------------------------------------------------------------------------- fit


@settings(max_examples=30, deadline=None)
@given(laws)
def test_the_fit_with_held_axes_returns_the_law_that_made_the_rays(law):
    d = directions(100)
    out = law.refract(d)
    assume(np.isfinite(out).all(axis=1).sum() > 50)
    fit = Law.fit(d, out, axes=law)
    assert fit.law.same_as(law, 1e-12)
    assert (fit.law.eta_x, fit.law.eta_y) == pytest.approx(
        (law.eta_x, law.eta_y), rel=1e-12 * stretch_of(law)
    )
    assert (fit.law.phi, fit.law.theta, fit.law.psi, fit.law.axes) == (law.phi, law.theta, law.psi, law.axes)
    assert fit.free == ("eta_x", "eta_y", "delta_x", "delta_y")
    assert fit.rank == 4
    assert fit.rms <= 1e-15


@settings(max_examples=30, deadline=None)
@given(laws)
def test_the_free_fit_returns_the_law_that_made_the_rays(law):
    d = directions(200)
    out = law.refract(d)
    assume(np.isfinite(out).all(axis=1).sum() > 100)
    fit = Law.fit(d, out)
    assert fit.rms <= 1e-12
    assert fit.law.same_as(law, 1e-9)
    assert len(fit.free) == 7


def test_the_free_fit_says_what_the_rays_do_not_tell():
    d = directions(200)
    upright = Law.fit(d, Law(-2, -1, 0.1, 0.05, 0.3).refract(d))
    assert upright.rank == 6
    assert upright.undetermined == ("phi", "psi")
    assert upright.law.phi == pytest.approx(0.3, abs=1e-12)
    round_lens = Law.fit(d, Law(-1, -1, theta=0.2).refract(d))
    assert "phi" in round_lens.undetermined
    tilted = Law.fit(d, Law(-2, -1, 0.1, 0.05, 0.3, 0.2, 0.1).refract(d))
    assert tilted.rank == 7
    assert tilted.undetermined == ()


def test_from_a_narrow_bundle_tilt_and_offset_can_hardly_be_told_apart():
    law = Law(-0.25, -1, 0.01, 0.02, 0.1, 0.05, 0.2)
    rng = np.random.default_rng(3)

    def doubt(spread: float) -> float:
        d = directions(500, spread)
        out = law.refract(d)
        return Law.fit(d, out + rng.normal(0, 1e-9, out.shape)).sigma["theta"]

    assert doubt(1e-3) > 1e3 * doubt(0.1)


def test_the_covariance_is_the_scatter_of_repeated_fits():
    law, noise = Law(-0.25, -1, 0.01, 0.02, 0.1, 0.05, 0.2), 1e-4
    rng = np.random.default_rng(4)
    d = directions(300)
    fits = [Law.fit(d, law.refract(d) + rng.normal(0, noise, d.shape), axes=law) for _ in range(200)]
    found = np.array([numbers(f.law)[:4] for f in fits])
    expected = np.sqrt(np.mean([np.diag(f.covariance)[:4] for f in fits], axis=0))
    np.testing.assert_allclose(found.std(axis=0), expected, rtol=0.2)
    np.testing.assert_allclose(found.mean(axis=0), numbers(law)[:4], atol=4 * expected.max())
    assert np.mean([f.rms for f in fits]) == pytest.approx(noise * 2**0.5, rel=0.05)


def test_the_fit_leaves_out_rays_that_were_lost_and_knows_its_bundle():
    d = directions(50)
    out = PAPER.refract(d)
    out[::5] = nan
    fit = Law.fit(d * 3.0, out, axes=PAPER, aperture=0.005)
    assert fit.rays == 40
    assert fit.aperture == 0.005
    assert 0.2 < fit.field < 0.5
    assert fit.law.same_as(PAPER)


def test_the_fit_refuses_too_few_rays_and_a_blind_axis():
    with pytest.raises(ValueError, match="at least 4"):
        Law.fit(directions(3), directions(3))
    d = directions(20)
    blind = np.column_stack([np.zeros(20), d[:, 1], np.ones(20)])
    with pytest.raises(ValueError, match="eta is infinite"):
        Law.fit(d, blind, axes=PAPER)
    with pytest.raises(ValueError, match=r"must be \(n, 3\)"):
        Law.fit(directions(5), directions(6), axes=PAPER)


# ------------------------------------------------------------------------------------------ angles


@pytest.mark.parametrize("size", [1e-200, 1e-30, 1e-16, 1e-12, 1e-8, 1e-3, 1.0, 3.0])
@pytest.mark.parametrize("length", [1e-150, 1.0, 3e120])
def test_the_angle_keeps_its_relative_accuracy_at_every_size(size, length):
    a = np.array([0.0, 0.0, 1.0])
    b = length * np.array([sin(size), 0.0, cos(size)])
    exact = oracle.angle(a, b)
    assert abs(mpf(float(angle_between(a, b))) - exact) <= 4 * ULP * exact


@given(slopes, slopes, st.floats(-1e-12, 1e-12), st.floats(-1e-12, 1e-12))
def test_the_angle_between_neighbours_is_that_of_the_oracle(x, y, dx, dy):
    a, b = [x, y, 1.0], [3 * (x + dx), 3 * (y + dy), 3.0]
    exact = oracle.angle(a, b)
    assert abs(mpf(float(angle_between(a, b))) - exact) <= 8 * ULP * exact + mpf(10) ** -300


def test_no_angle_is_given_for_what_is_no_direction():
    out = angle_between([[0, 0, 0], [nan, 0, 1], [inf, 0, 1], [0, 0, 2]], [0, 0, 1])
    assert np.isnan(out[:3]).all()
    assert out[3] == 0.0


# ------------------------------------------------------------------ the paper: equations and figures


@pytest.mark.parametrize(
    ("f1", "f2", "d"), [(2.0, 3.0, 0.0), (2.0, -1.0, 0.1), (1.5, 1.5, 0.2), (-1.0, 3.0, 0.1)]
)
@pytest.mark.parametrize("theta", [0.0, 0.1])
def test_the_planar_law_is_what_two_lenses_sharing_a_focal_plane_do(f1, f2, d, theta):
    alpha = np.linspace(-0.2, 0.2, 9)
    crossing = f1 * np.tan(alpha - theta)  # E1: where parallel rays meet in the common focal plane
    behind = np.arctan((d - crossing) / f2) + theta  # E2: from there through the centre of lens 2
    got = refract_2d(alpha, eta=-f2 / f1, delta=d / f1, theta=theta)  # E4, E5
    np.testing.assert_allclose(got, behind, atol=1e-15)
    np.testing.assert_allclose(crossing, d - f2 * np.tan(got - theta), atol=1e-14)  # E3


def test_each_meridian_has_its_own_focal_length_and_offset():
    separation, eta, delta = 0.05, (-0.25, -1.0), (0.005, 0.01)
    for e, d, f1, f2, offset in zip(eta, delta, (0.04, 0.025), (0.01, 0.025), (2e-4, 2.5e-4)):  # E7, E8
        assert (separation / (1 - e), -e * separation / (1 - e)) == pytest.approx((f1, f2), rel=1e-15)
        slope = 0.013
        expected = (offset - f1 * slope) / f2
        out = Law(e, e, d, 0).refract([[slope, 0, 1]])[0]
        assert out[0] / out[2] == pytest.approx(expected, rel=1e-13)


def test_the_planar_law_is_the_spatial_one_in_the_x_z_plane():
    eta, delta, theta = -0.4, 0.05, 0.15
    alpha = np.linspace(-0.4, 0.4, 11)
    law = Law(eta, 2.0, delta, 0.0, -pi / 2, theta, pi / 2)
    out = law.refract(np.column_stack([np.sin(alpha), np.zeros(11), np.cos(alpha)]))
    # Turning by −90° and back leaves the lens's own x axis in the x–z plane.
    np.testing.assert_allclose(out[:, 1], 0.0, atol=1e-16)
    np.testing.assert_allclose(
        np.arctan2(out[:, 0], out[:, 2]), refract_2d(alpha, eta, delta, theta), atol=1e-15
    )


@pytest.mark.parametrize(("eta", "delta", "theta"), [(-0.25, 1.0, 1.0), (-1.0, -0.5, 1.0), (2.0, 1.0, -2.0)])
def test_the_small_angle_law_is_wrong_by_the_third_power(eta, delta, theta):
    def error(size: float) -> float:
        exact = refract_2d(size, eta, delta * size, theta * size)
        return abs(float(small_angle_2d(size, eta, delta * size, theta * size) - exact))

    for size in (1e-1, 1e-2, 1e-3):  # E9, E10
        assert error(size) < 200 * size**3
    assert error(1e-2) == pytest.approx(1e-3 * error(1e-1), rel=0.5)


@pytest.mark.parametrize(("tilt", "exact", "linear"), [(0.5, 0.0174551, 0.0174533), (5, 0.1763, 0.1745)])
def test_a_tilt_acts_like_an_offset(tilt, exact, linear):
    theta = radians(tilt)
    slope = tan(float(refract_2d(0.0, -1.0, 0.0, theta)))  # of light that came along the sheet's normal
    assert slope == pytest.approx(exact, rel=0, abs=5e-5 if tilt == 5 else 5e-8)
    assert 2 * theta == pytest.approx(linear, rel=0, abs=5e-5 if tilt == 5 else 5e-8)
    assert float(small_angle_2d(0.0, -1.0, 0.0, theta)) == pytest.approx(2 * theta, rel=1e-15)


def test_the_planar_law_refuses_what_the_spatial_one_refuses():
    assert np.isnan(refract_2d([pi / 2, 1.6, -1.6, nan], -1.0)).all()
    assert np.isnan(refract_2d(1.0, -1.0, 0.0, -0.8))  # beyond the lens's hemisphere
    assert np.isnan(refract_2d(0.5, 0.01, 0.0, 0.3))  # turned back
    with pytest.raises(ValueError, match="eta must be finite and not 0"):
        refract_2d(0.1, 0.0)
    with pytest.raises(ValueError, match="eta must be finite"):
        small_angle_2d(0.1, nan)


def seen_on_sheet(law: Law, z: float, camera: float = 20.0, **kwargs: float) -> np.ndarray:
    """Where on the sheet an object on the camera's axis appears."""
    a, m = apparent_map(law, z, camera, **kwargs)
    return -np.linalg.solve(m, a)


STRETCHES = [  # z, s_x, s_y, m_x, m_y for eta = (-1/4, -1), D = 20
    (1, 1.25, 1.0526, 1.3125, 1.1053),
    (4, 5, 1.25, 6, 1.5),
    (4.9, 50, 1.3245, 62.25, 1.649),
    (5.1, -50, 1.3423, -62.75, 1.6846),
    (8, -1.6667, 1.6667, -2.3333, 2.3333),
    (10, -1, 2, -1.5, 3),
    (15, -0.5, 4, -0.875, 7),
    (19, -0.3571, 20, -0.6964, 39),
    (21, -0.3125, -20, -0.6406, -41),
    (38, -0.1515, -1.1111, -0.4394, -3.2222),
    (60, -0.0909, -0.5, -0.3636, -2),
]


@pytest.mark.parametrize("row", STRETCHES, ids=lambda r: f"z_k = {r[0]}")
def test_the_knight_is_stretched_as_the_paper_shows(row):
    z, *expected = row
    got = [*stretch_on_sheet(PAPER, z, 20.0), *stretch(PAPER, z, 20.0)]
    np.testing.assert_allclose(got, expected, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(1 / np.diag(apparent_map(PAPER, z, 20.0)[1]), got[:2], rtol=1e-12)


def test_the_stretch_diverges_at_five_and_twenty_and_changes_sign_there():
    for axis, pole in ((0, 5.0), (1, 20.0)):
        assert np.isinf(stretch(PAPER, pole, 20.0)[axis])
        before, behind = (stretch(PAPER, pole + step, 20.0)[axis] for step in (-1e-12, 1e-12))
        assert before > 1e11
        assert behind < -1e11
    averaged = [np.linalg.det(apparent_map(PAPER, z, 20.0, turned_at=0.05)[1]) for z in (5.0625, 20.10)]
    np.testing.assert_allclose(averaged, 0, atol=1e-12)


def test_an_object_before_the_sheet_is_seen_undistorted():
    a, m = apparent_map(PAPER, -2.0, 20.0)
    np.testing.assert_array_equal(a, 0)
    np.testing.assert_allclose(m, 0.9 * np.eye(2))


def test_the_apparent_map_is_where_rays_from_the_camera_arrive():
    law, z, camera = Law(-0.25, -1, 0.005, 0.01, 0.7), 10.0, 20.0
    on_sheet = np.array([[0.3, -0.2], [0.0, 0.1]])
    out = law.refract(np.column_stack([on_sheet, np.full(2, camera)]))
    arrived = on_sheet + z * out[:, :2] / out[:, 2:]
    a, m = apparent_map(law, z, camera)
    np.testing.assert_allclose(a + on_sheet @ m.T, arrived, atol=1e-14)


def test_offsets_shift_the_view_as_figure_4_says():
    np.testing.assert_allclose(seen_on_sheet(Law(-0.25, -1, 0.005, 0.01), 10), [0.2, -0.2], rtol=1e-12)


def test_tilting_shifts_the_view_sideways_as_figure_6_says():
    half, one = (seen_on_sheet(Law(-0.25, -1, 0, 0, pi / 4, radians(t)), 10) for t in (0.5, 1.0))
    np.testing.assert_allclose(half, [-0.3927, -0.0437], atol=3e-4)
    np.testing.assert_allclose(one, 2 * half, rtol=2e-3, atol=2e-3)
    at_s = seen_on_sheet(Law(-0.25, -1, 0, 0, pi / 4, radians(0.5)), 10, turned_at=0.05)
    np.testing.assert_allclose(at_s, [-0.3918, -0.0479], atol=3e-4)
    moving = seen_on_sheet(Law(-0.25, -1, 0, 0, pi / 4, radians(0.5), 0, "moving"), 10)
    np.testing.assert_allclose(moving, [-0.2470, 0.2470], atol=3e-4)


def test_the_claim_that_theta_is_like_delta_x_at_phi_zero_fails_as_printed():
    shift = seen_on_sheet(Law(-0.25, -1, theta=radians(0.5)), 10)
    np.testing.assert_allclose(shift, [0, 0.349], atol=3e-4)


def test_the_view_of_figure_7_goes_round_once_as_psi_goes_round_once():
    def centre(psi: float, axes: str = "fixed") -> np.ndarray:
        return seen_on_sheet(Law(-0.25, -1, 0, 0, pi / 4, radians(0.5), psi, axes), 10)  # type: ignore[arg-type]

    radii = [hypot(*centre(radians(p))) for p in range(0, 360, 15)]
    np.testing.assert_allclose(radii, 0.395, atol=5e-4)
    np.testing.assert_allclose(centre(pi / 2), [0.0437, -0.3927], atol=3e-4)
    np.testing.assert_allclose(centre(pi), [0.3927, 0.0437], atol=3e-4)
    np.testing.assert_allclose(centre(2 * pi), centre(0), atol=1e-12)
    np.testing.assert_allclose(centre(pi / 2, "moving"), [0.309, -0.309], atol=1e-3)
    np.testing.assert_allclose(centre(pi, "moving"), centre(0, "moving"), atol=3e-4)


@pytest.mark.parametrize(
    ("z", "x", "y"),
    [(3, -0.195, 0.133), (8, 0.175, -0.407), (10, 0.044, -0.393), (15, -0.361, -0.688), (38, 0.494, 0.243), (60, 0.381, 0.143), (1e9, 0.284, 0.065)],
)  # fmt: skip
def test_the_piece_of_figure_8_appears_where_the_closed_form_says(z, x, y):
    law = Law(-0.25, -1, 0, 0, pi / 4, radians(0.5), pi / 2)
    np.testing.assert_allclose(seen_on_sheet(law, z), [x, y], atol=2e-3)


def test_the_knight_of_figure_5_turns_twice_as_fast_as_the_lenses_and_the_horizon_seesaws():
    def stretched(phi: float, z: float) -> np.ndarray:
        return np.linalg.inv(apparent_map(Law(-0.25, -1, phi=phi), z, 20.0)[1])

    def winding(z: float) -> float:
        x = np.array([stretched(p, z) @ [1, 0] for p in np.linspace(0, pi, 181)])
        return degrees(np.unwrap(np.arctan2(x[:, 1], x[:, 0]))[-1] - np.arctan2(x[0, 1], x[0, 0]))

    assert abs(winding(10)) == pytest.approx(360, abs=1e-6)
    assert winding(3) == pytest.approx(0, abs=1e-6)
    assert winding(30) == pytest.approx(0, abs=1e-6)
    horizon = [stretched(p, 1e9) @ [1, 0] for p in np.linspace(0, pi, 20001)]
    slope = [atan(h[1] / h[0]) for h in horizon]
    assert degrees(max(slope)) == pytest.approx(36.87, abs=0.01)


def test_images_lie_where_rays_of_one_point_cross():
    law, point = Law(-0.4, -1.5, 0.05, -0.02), np.array([0.3, -0.1, 7.0])
    position, plane = image_point(law, point)
    # Rays from the camera's side that end in the point, followed backwards to where they cross.
    for axis in (0, 1):
        start = np.array([-0.5, 0.4])
        slope_out = (point[axis] - start) / point[2]
        eta, delta = (law.eta_x, law.eta_y)[axis], (law.delta_x, law.delta_y)[axis]
        slope_in = eta * slope_out + delta
        crossing = -(start[1] - start[0]) / (slope_in[1] - slope_in[0])
        assert plane[axis] == pytest.approx(crossing, rel=1e-12)
        assert position[axis] == pytest.approx(start[0] + slope_in[0] * crossing, rel=1e-12)
    np.testing.assert_allclose(np.sort(plane), image_planes(law, 7.0), rtol=1e-12)
    np.testing.assert_allclose(image_point(law, [0, 0, -2.0])[1], [0.8, 3.0], rtol=1e-15)
    np.testing.assert_allclose(image_planes(law, -2.0), [0.8, 3.0], rtol=1e-12)
    with pytest.raises(ValueError, match="tilted sheet"):
        image_point(Law(-1, -1, theta=0.1), point)


def test_some_tilted_sheets_have_no_line_images():
    rng = np.random.default_rng(0)
    none = [
        law
        for law in (
            Law(*rng.uniform(-2, 2, 2), *rng.uniform(-1, 1, 2), *rng.uniform(-1, 1, 3)) for _ in range(3000)
        )
        if np.isnan(image_planes(law, 1.0)).all()
    ]
    assert none
    for law in none[:5]:
        plane = np.array([[0.0, 0, 1], [1e-6, 0, 1], [0, 1e-6, 1]]) @ law.matrix().T
        t = plane[:, :2] / plane[:, 2:]
        turn = (t[1:] - t[0]).T / 1e-6
        assert (turn[0, 0] - turn[1, 1]) ** 2 + 4 * turn[0, 1] * turn[1, 0] < 1e-4
