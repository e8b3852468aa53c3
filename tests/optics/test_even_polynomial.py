"""Faces with terms of fourth order against 50 digits: sag, normal, where a ray meets them, misses; numpy and compiled."""

from __future__ import annotations

import numpy as np
import pytest
from called_parts import called
from mpmath import mp, mpf
from oracle.polynomial import DIGITS, Shape, crossing

from clacad.optics.surface import Biconic, EvenPolynomial, meet_at, resized
from clacad.tracing.compiled import packing as slot

ULP = 2.0**-52
BOUND = 8.0
"""Stated: ulp of the sum of the terms, over how much the ray grazes."""

SHAPES = {
    "lens": Shape((0.9, 1.2), (-1.0, -1.0), (0.2, 0.4, 0.1)),
    "back of a bent lens": Shape((-0.05, 0.11), (0.0, 0.0), (-0.3, -0.8, -0.6), -1),
    "A4 dominates at the rim": Shape((0.3, 0.3), (0.0, 0.0), (-4.0, -8.0, -4.0)),
    "A4 cancels the base where r = 1/2": Shape((1.0, 1.0), (-1.0, -1.0), (-2.0, -4.0, -2.0)),
    "inflection at r = 0.4": Shape((1.0, 1.0), (-1.0, -1.0), (-0.52, -1.04, -0.52), -1),
    "saddle": Shape((0.8, -0.7), (-2.0, 0.5), (0.3, -0.9, 0.2)),
    "no base": Shape((0.0, 0.0), (0.0, 0.0), (0.7, -0.2, 1.1)),
    "ellipsoid near its rim": Shape((1.0, 0.5), (0.3, 2.0), (0.1, 0.0, 0.1)),
    "all orders": Shape(
        (0.9, 1.2), (-1.0, -1.0), (0.2, 0.4, 0.1), -1, (0.3, -1.1, 0.7, -0.2), (-0.5, 0.9, 1.3, -0.8, 0.6)
    ),
    "A6 and A8 cancel A4 and the base": Shape(
        (1.0, 1.0),
        (-1.0, -1.0),
        (-8.0, -16.0, -8.0),
        1,
        (20.0, 60.0, 60.0, 20.0),
        (3.0, 12.0, 18.0, 12.0, 3.0),
    ),
}


def surface_of(shape):
    return EvenPolynomial(*shape.curvature, *shape.conic, shape.a4, shape.side, shape.a6, shape.a8)


def rays_at(seed, number, slope):
    rng = np.random.default_rng(seed)
    start = np.column_stack([rng.uniform(-0.55, 0.55, (number, 2)), np.zeros(number)])
    direction = np.column_stack([rng.uniform(-slope, slope, (number, 2)), rng.choice([-1.0, 1.0], number)])
    return start, direction / np.linalg.norm(direction, axis=1)[:, None]


def compiled(surface, start, direction):
    """Distances, points, normals and roots of the compiled twin."""
    from clacad.tracing.compiled import face as kernel

    row = np.zeros((1, slot.FACE_NUMBERS))
    row[0, slot.CX], row[0, slot.CY], row[0, slot.SIDE] = (
        surface.curvature_x,
        surface.curvature_y,
        surface.side,
    )
    row[0, slot.BICONIC], row[0, slot.KX], row[0, slot.KY] = slot.POLYNOMIAL, surface.conic_x, surface.conic_y
    row[0, slot.A40 : slot.A08 + 1] = (*surface.a4, *surface.a6, *surface.a8)
    return np.array([called(kernel.meet)(row, 0, *p, *d) for p, d in zip(start, direction)])


@pytest.mark.parametrize("name", SHAPES)
def test_a_ray_meets_the_face_where_fifty_digits_say(name):
    shape = SHAPES[name]
    surface = surface_of(shape)
    start, direction = rays_at(3, 6, 0.3)
    met, point = meet_at(surface, start, direction)
    with mp.workdps(DIGITS):
        for k in range(len(start)):
            exact = crossing(shape, start[k], direction[k], 1.0)
            if exact is None:
                assert np.isnan(met.distance[k]), name
                assert np.isnan(point[k]).all(), name
                continue
            x, y, z = (mpf(p) + exact * mpf(d) for p, d in zip(start[k], direction[k]))
            normal = shape.normal(x, y)
            graze = abs(sum(n * mpf(d) for n, d in zip(normal, direction[k]))) / normal[2]
            room = BOUND * ULP * (shape.terms(x, y) + mpf(5e-324)) / graze
            length = np.linalg.norm(met.gradient[k])
            assert abs(mpf(float(point[k, 2])) - z) <= room, name
            along = -1 if direction[k, 2] < 0 else 1
            steep = 1 / normal[2]
            off = max(abs(mpf(float(g)) - along * n) for g, n in zip(met.gradient[k] / length, normal))
            assert off <= 16 * ULP * steep, name


@pytest.mark.parametrize("name", SHAPES)
def test_sag_and_normal_agree_with_fifty_digits(name):
    shape = SHAPES[name]
    surface = surface_of(shape)
    points = np.random.default_rng(5).uniform(-0.5, 0.5, (20, 2))
    with mp.workdps(DIGITS):
        for x, y in points:
            exact = shape.height(mpf(x), mpf(y))
            assert abs(mpf(float(surface.sag(x, y))) - exact) <= 4 * ULP * shape.terms(mpf(x), mpf(y))
            off = max(
                abs(mpf(float(g)) - n) for g, n in zip(surface.normal(x, y), shape.normal(mpf(x), mpf(y)))
            )
            assert off <= 16 * ULP


def test_where_base_and_terms_cancel_the_height_is_zero_to_rounding_of_the_terms():
    surface = surface_of(SHAPES["A4 cancels the base where r = 1/2"])
    x, y = np.array([0.5, 0.3, 0.0]), np.array([0.0, 0.4, -0.5])
    assert np.abs(surface.sag(x, y)).max() <= 4 * ULP * 0.125
    met, point = meet_at(surface, np.column_stack([x, y, [-1.0] * 3]), np.array([[0.0, 0.0, 1.0]] * 3))
    assert np.abs(point[:, 2]).max() <= 4 * ULP * 0.125
    assert np.abs(met.distance - 1.0).max() <= 4 * ULP


@pytest.mark.parametrize(
    "slope", [10.0, pytest.param(100.0, marks=pytest.mark.slow), pytest.param(1e4, marks=pytest.mark.slow)]
)
def test_a_grazing_ray_meets_the_face_or_is_lost_but_never_somewhere_else(slope):
    """Many crossings are possible: what is returned lies on the face, on its real part, in the ray's own sense."""
    for name, shape in SHAPES.items():
        surface = surface_of(shape)
        start, direction = rays_at(11, 60, slope)
        start = start - 0.2 * direction
        met, point = meet_at(surface, start, direction)
        good = np.isfinite(met.distance)
        assert (np.isfinite(point).all(axis=1) == good).all()
        assert np.isnan(met.root[~good]).all()
        with mp.workdps(DIGITS):
            for k in np.flatnonzero(good):
                x, y, z = (mpf(float(v)) for v in point[k])
                height = shape.height(x, y)
                assert height is not None, name
                normal = shape.normal(x, y)
                reached = abs(met.distance[k]) + 1.0  # rounding of a place that far along the ray
                assert abs(z - height) * normal[2] <= 8 * ULP * (shape.terms(x, y) + reached), name
                along = -1 if direction[k, 2] < 0 else 1
                assert along * sum(n * mpf(d) for n, d in zip(normal, direction[k])) >= -1e-7, name


def test_a_root_beyond_the_real_rim_is_a_miss():
    """The polynomial goes on where the ellipsoid under it has ended: no such point belongs to the face."""
    surface = EvenPolynomial(1.0, 1.0, 0.0, 0.0, (0.3, 0.6, 0.3))
    start = np.array([[1.001, 0.0, 0.0], [0.0, 1.2, -3.0], [0.8, 0.8, 0.0], [1.0 + 1e-9, 0.0, -1.0]])
    direction = np.array([[0.0, 0.0, 1.0]] * 4)
    met, point = meet_at(surface, start, direction)
    assert np.isnan(met.distance).all()
    assert np.isnan(point).all()
    assert np.isnan(met.gradient).all()
    assert np.isnan(surface.sag(1.001, 0.0))


def test_a_ray_over_the_rim_of_the_real_base_meets_the_face_before_or_after_it():
    """It starts over no real height and comes in from the side."""
    shape = Shape((1.0, 1.0), (0.0, 0.0), (0.1, 0.2, 0.1))
    start, direction = np.array([[-1.4, 0.1, -0.2]]), np.array([[0.8, 0.0, 0.6]])
    with mp.workdps(DIGITS):
        exact = crossing(shape, start[0], direction[0], 3.0)
    met, _ = meet_at(surface_of(shape), start, direction)
    assert exact is not None
    assert float(exact) == pytest.approx(met.distance[0], rel=1e-14)


@pytest.mark.parametrize("field", range(4))
def test_a_number_that_is_not_finite_never_comes_out_as_a_place(field):
    start, direction = np.array([[0.1, 0.1, -1.0]]), np.array([[0.0, 0.1, 1.0]])
    (start if field < 2 else direction)[0, field % 2 + (field == 1)] = (np.nan, np.inf)[field % 2]
    met, point = meet_at(surface_of(SHAPES["lens"]), start, direction)
    assert np.isnan(met.distance).all()
    assert np.isnan(point).all()


def test_without_terms_it_is_the_biconic():
    start, direction = rays_at(7, 200, 0.4)
    plain = meet_at(Biconic(0.9, 0.7, -0.4, 0.3, -1), start, direction)
    terms = meet_at(EvenPolynomial(0.9, 0.7, -0.4, 0.3, (0.0, 0.0, 0.0), -1), start, direction)
    np.testing.assert_allclose(plain[1], terms[1], rtol=0, atol=1e-15)
    np.testing.assert_allclose(plain[0].gradient, terms[0].gradient, rtol=0, atol=1e-15)


def test_a_face_of_another_size_has_the_same_shape():
    surface = surface_of(SHAPES["all orders"])
    x, y = np.random.default_rng(1).uniform(-0.4, 0.4, (2, 50))
    for size in (1000.0, 0.025):
        np.testing.assert_allclose(
            resized(surface, size).sag(size * x, size * y), size * surface.sag(x, y), rtol=1e-13
        )


def test_what_is_no_surface_is_refused():
    with pytest.raises(ValueError, match="not finite"):
        EvenPolynomial(1.0, 1.0, 0.0, 0.0, (0.0, float("nan"), 0.0))
    with pytest.raises(ValueError, match="side"):
        EvenPolynomial(1.0, 1.0, 0.0, 0.0, (0.0, 0.0, 0.0), 0)


@pytest.mark.slow
@pytest.mark.parametrize("slope", [0.3, 10.0, 1e4])
def test_the_compiled_twin_meets_the_face_where_numpy_does(slope):
    for name, shape in SHAPES.items():
        start, direction = rays_at(13, 200, slope)
        start = start - 0.2 * direction
        met, point = meet_at(surface_of(shape), start, direction)
        twin = compiled(surface_of(shape), start, direction)
        np.testing.assert_array_equal(np.isnan(met.distance), np.isnan(twin[:, 0]), name)
        good = np.isfinite(met.distance)
        np.testing.assert_allclose(twin[good, 1:4], point[good], rtol=0, atol=1e-9 if slope > 1.0 else 1e-15)
        np.testing.assert_allclose(twin[good, 0], met.distance[good], rtol=1e-9, atol=1e-15)


@pytest.mark.slow
def test_the_compiled_twin_misses_where_the_base_has_ended():
    surface = EvenPolynomial(1.0, 1.0, 0.0, 0.0, (0.3, 0.6, 0.3))
    start = np.array([[1.001, 0.0, 0.0], [0.0, 1.2, -3.0], [0.8, 0.8, 0.0], [1.0 + 1e-9, 0.0, -1.0]])
    assert np.isnan(compiled(surface, start, np.array([[0.0, 0.0, 1.0]] * 4))).all()


@pytest.mark.daily_cases("2")
@pytest.mark.parametrize(
    "seed", [*range(3), *(pytest.param(k, marks=pytest.mark.long) for k in range(3, 30))]
)
def test_random_faces_of_all_orders_are_met_where_fifty_digits_say(seed):
    """A fixed tenth by default. Slopes stay below 1 and rays are steeper: there is one crossing."""
    rng = np.random.default_rng(seed)
    for _ in range(8):
        conic = tuple(rng.choice([-1.0, rng.uniform(-3.0, 1.0)], 2))
        terms = [tuple(scale * rng.uniform(-1.0, 1.0, n)) for scale, n in ((0.15, 3), (0.2, 4), (0.3, 5))]
        shape = Shape(tuple(rng.uniform(-0.8, 0.8, 2)), conic, terms[0], int(rng.choice([-1, 1])), *terms[1:])
        start, direction = rays_at(seed, 3, 0.3)
        met, point = meet_at(surface_of(shape), start, direction)
        with mp.workdps(DIGITS):
            for k in range(3):
                exact = crossing(shape, start[k], direction[k], 1.0)
                x, y, z = (mpf(p) + exact * mpf(d) for p, d in zip(start[k], direction[k]))
                normal = shape.normal(x, y)
                graze = abs(sum(n * mpf(d) for n, d in zip(normal, direction[k]))) / normal[2]
                room = BOUND * ULP * (shape.terms(x, y) + mpf(5e-324)) / graze
                assert abs(mpf(float(point[k, 2])) - z) <= room
                along, length = -1 if direction[k, 2] < 0 else 1, np.linalg.norm(met.gradient[k])
                off = max(abs(mpf(float(g)) - along * n) for g, n in zip(met.gradient[k] / length, normal))
                assert off <= 16 * ULP / normal[2]
