"""Laws that vary over the sheet and what they image: against published cases and lens-by-lens rays in 50 digits."""

from __future__ import annotations

import json
from math import inf
from pathlib import Path

import numpy as np
import pytest
from oracle import varying as oracle

from clacad.optics.law import Law
from clacad.optics.law.focusing import (
    Glens,
    SharpPair,
    Superlens,
    VaryingLaw,
    focusing_at,
    imaging,
    imaging_scaled,
    refract_each,
)

DATA = Path(__file__).parents[1] / "data"


def cases(name, keep=lambda case: True):
    return [case for case in json.loads((DATA / name).read_text())["cases"] if keep(case)]


def numbers(case, *names):
    return [float(case[name]) for name in names]


def relative(got, exact):
    return abs(got - exact) / max(abs(exact), 1e-300)


@pytest.mark.parametrize("case", cases("varying_law.json"))
def test_published_directions_by_the_law_of_the_cell_and_by_the_smooth_law(case):
    eta, delta, centre, place = ([float(v) for v in case[k]] for k in ("eta", "delta0", "centre", "position"))
    middle = Law(*eta, *delta, *np.radians(case["euler_deg"]))
    varying = VaryingLaw(middle, tuple(tuple(float(v) for v in row) for row in case["gradient"]))
    d = np.array([[float(v) for v in case["direction"]]])
    cell = varying.law_at(centre)
    assert [cell.delta_x, cell.delta_y] == pytest.approx([float(v) for v in case["delta_cell"]], rel=1e-15)
    for got, exact in (
        (cell.refract(d), case["out_cell"]),
        (varying.refract(d, [place]), case["out_continuous"]),
    ):
        assert np.abs(got[0] - [float(v) for v in exact]).max() <= 1e-13


@pytest.mark.parametrize("case", cases("glens.json", lambda c: "anamorphic" not in c))
def test_published_images_of_a_glens(case):
    eta, kappa, gap, delta = numbers(case, "eta", "kappa", "separation", "delta0")
    x, z = numbers(case, "object_x", "object_z")
    glens, flat = Glens(eta, kappa, gap, delta), Glens(eta, kappa)
    got = {
        "image_distance_from_array_2": glens.image_distance(z), "image_z": gap + glens.image_distance(z),
        "image_x": glens.image_x(x, z), "spot_per_pitch": glens.width(z, 1.0), "magnification": glens.magnification(z),
        "image_z_of_the_zero_thickness_sheet": flat.image_distance(z), "f_image": glens.f_image,
        "f_object": glens.f_object, "nodal_z": glens.nodal_z, "pitch_ratio": 1.0 + kappa * gap / (1.0 - eta),
    }  # fmt: skip
    for name, value in got.items():
        assert value == pytest.approx(float(case[name]), rel=1e-12, abs=1e-40), name


@pytest.mark.parametrize("case", cases("glens.json", lambda c: "anamorphic" in c))
def test_published_sheets_that_image_one_plane_with_two_magnifications(case):
    z, image = numbers(case, "object_z", "image_z")
    for m, eta, kappa in zip(case["magnification"], case["eta"], case["kappa"]):
        assert imaging_scaled(z, image, float(m)) == pytest.approx((float(eta), float(kappa)), rel=1e-12)


@pytest.mark.parametrize("case", cases("gabor.json", lambda c: "focused" not in c))
def test_published_superlenses(case):
    p1, p2, f1, f2 = numbers(case, "p1", "p2", "f1", "f2")
    lens = Superlens((p1, p2), (f1, f2))
    for name in ("eta", "kappa", "f_image", "f_object", "nodal_z", "moire_period", "zone_period", "f_number"):
        assert getattr(lens, name) == pytest.approx(float(case[name]), rel=1e-12), name


@pytest.mark.parametrize("case", cases("gabor.json", lambda c: "focused" in c))
def test_published_sharp_pairs(case):
    f1, f2, p1, z, far = numbers(case, "f1", "f2", "p1", "object_z", "image_distance_from_array_2")
    pair = SharpPair((f1, f2), z, far)
    assert pair.separation == pytest.approx(float(case["separation"]), rel=1e-12)
    assert p1 * pair.pitch_ratio == pytest.approx(float(case["p2"]), rel=1e-12)
    assert pair.magnification == pytest.approx(float(case["magnification"]), rel=1e-12)


F1 = 5.0
HARD = {  # η, κ, s, δ₀; object (x, z)
    "kappa 1e-12: the foci lie at 1e12": ((-1.0, 1e-12, 10.0, 0.0), (4.0, -300.0)),
    "kappa -1e-12, object a metre off": ((-0.25, -1e-12, 10.0, 1e-3), (-7.0, -1000.0)),
    "pitch_2/pitch = 1 + 1e-12": ((-1.0, Superlens((0.5, 0.5 * (1 + 1e-12)), (F1, F1)).kappa, 10.0, 0.0), (4.0, -300.0)),
    "pitch_2/pitch = 1 - 1e-12": ((-1.0, Superlens((0.5, 0.5 * (1 - 1e-12)), (F1, F1)).kappa, 10.0, 0.0), (4.0, -300.0)),
    "object at the nodal point": ((-1.0, 0.005, 10.0, 0.0), (3.0, -400.0)),
    "object an ulp from the nodal point": ((-1.0, 0.005, 10.0, 0.0), (3.0, np.nextafter(-400.0, 0.0))),
    "object 1e-13 before the focus: the image is 1e15 away": ((-1.0, 0.005, 10.0, 0.0), (3.0, -200.0 * (1 + 1e-13))),
    "object an ulp from lens 1's focus": ((-1.0, -0.005, 10.0, 0.0), (1e-9, np.nextafter(-F1, 0.0))),
    "object at 1e9 times the separation": ((-1.0, -0.005, 1e-2, 0.1), (1e3, -1e7)),
    "delta cancels the slope": ((0.5, 0.003, 2.0, 0.05), (-5.0, -100.0)),
}  # fmt: skip


@pytest.mark.parametrize("name", HARD)
def test_hard_images_are_those_of_rays_lens_by_lens_in_fifty_digits(name):
    sheet, (x, z) = HARD[name]
    glens, (along, across) = Glens(*sheet), oracle.image(sheet, (x, z))
    assert relative(glens.image_distance(z), along) <= 2.0**-52
    assert relative(glens.image_x(x, z), across) <= 2.0**-52
    assert relative(glens.width(z, 0.5), oracle.width(sheet, (x, z), 0.5)) <= 2.0**-52


@pytest.mark.parametrize(
    "z", [-500.0, np.nextafter(-10.0, -20.0), np.nextafter(-10.0, 0.0), -10.0 * (1 + 1e-9), -1e12]
)
def test_every_ray_of_every_sharp_pair_meets_at_the_image_also_next_to_the_focus_of_lens_1(z):
    pair = SharpPair((10.0, 2.5), z, -400.0)
    separation, ratio = oracle.sharp((10.0, 2.5), z, -400.0)
    assert relative(pair.separation, separation) <= 2.0**-52
    assert relative(pair.pitch_ratio, ratio) <= 2.0**-52
    for along, across in oracle.sharp_crossings(
        (10, 2.5), (1, ratio), separation, (3, z), (0, 1, -7), (0, 0.3, -0.4)
    ):
        assert relative(-400.0, along) <= 1e-25
        assert relative(pair.magnification * 3, across) <= 2.0**-51


def test_a_sheet_made_for_two_planes_images_one_to_the_other():
    for z, image, m, gap in (
        (-300.0, 400.0, -2.0, 10.0),
        (-300.0, -50.0, 0.5, 2.0),
        (-1e3, 250.0, -0.25, 0.0),
    ):
        eta, kappa = imaging_scaled(z, image, m, gap)
        assert Glens(eta, kappa, gap).image_distance(z) == pytest.approx(image, rel=1e-13)
        assert Glens(eta, kappa, gap).magnification(z) == pytest.approx(m, rel=1e-12)
    kappa = imaging(-1.0, -300.0, 124.0, 10.0)
    assert kappa == pytest.approx(-0.005, rel=1e-14)
    assert imaging(-1.0, -inf, 200.0, 10.0) == focusing_at(-1.0, 200.0) == -0.005
    assert focusing_at(-1.0, inf) == 0.0
    assert Glens(-1.0, imaging(-1.0, -300.0, inf, 10.0), 10.0).f_object == pytest.approx(-300.0, rel=1e-15)


def test_parallel_light_is_the_limit_of_far_points():
    glens, far = Glens(-0.25, -0.005, 10.0, 0.01), -1e14
    assert glens.image_distance(-inf) == glens.f_image == pytest.approx(glens.image_distance(far), rel=1e-11)
    assert glens.width(-inf, 0.5) == 0.125


def test_rays_with_offsets_of_their_own_leave_as_by_the_law_of_each_to_the_last_bit():
    rng = np.random.default_rng(3)
    middle = Law(-0.25, -1.0, 0.01, -0.02, 0.3, 0.1, -0.2)
    d = np.column_stack([rng.uniform(-0.2, 0.2, (50, 2)), np.ones(50)])
    deltas = rng.uniform(-0.3, 0.3, (50, 2)) * 10.0 ** rng.integers(-12, 3, (50, 1))
    deltas[::7, 0] = 0.0
    each = [Law(-0.25, -1.0, *delta, 0.3, 0.1, -0.2).refract(one) for delta, one in zip(deltas, d)]
    assert np.array_equal(refract_each(middle, deltas, d), each, equal_nan=True)


@pytest.mark.parametrize("gradient", [((1e-12, 0.0), (0.0, -1e-12)), ((0.0, 0.004), (-0.004, 0.0)), ((0.3, -0.1), (7.0, 1e-9))])  # fmt: skip
def test_the_smooth_law_keeps_its_digits_where_the_offset_cancels(gradient):
    delta, place = (0.3, -0.1), (-(2.0**-3) / 3 - 1e-13, 17.3)
    (kx, ky), slopes = gradient[0], (0.01, -0.02)
    delta = (-(kx * place[0] + ky * place[1]), delta[1])  # all but the rounding of the offset cancels
    varying = VaryingLaw(Law(-0.5, -1.0, *delta), gradient)
    out = varying.refract([[*slopes, 1.0]], [place])[0]
    exact = oracle.law_slopes((-0.5, -1.0), delta, gradient, place, slopes)
    for k in range(2):
        assert relative(out[k] / out[2], exact[k]) <= 1e-15
