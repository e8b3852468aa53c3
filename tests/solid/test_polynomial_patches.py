"""Faces with terms of fourth order in STEP: exact where they are polynomials of degree 4, else fitted and reported as fitted."""

from __future__ import annotations

import numpy as np
import pytest
from mpmath import mp, mpf
from oracle.polynomial import Shape

from clacad.optics.surface import EvenPolynomial
from clacad.sheet.window import Face
from clacad.solid.lens_faces import fitted_lens, scaled_face
from clacad.solid.repeated_cell import FIT

PITCH = 5.0
ZONE = np.array([[-2.5, -2.5], [2.5, -2.5], [2.5, 2.5], [-2.5, 2.5]])
CURVATURE, TERMS = (0.0525, 0.0749), (2.678e-6, 2.0547e-5, 8.549e-6)


A6, A8 = (1.3e-9, -4.0e-9, 2.0e-9, 0.7e-9), (1.1e-12, 2.0e-12, -3.0e-12, 0.0, 4.0e-13)
HIGHER = {4: ((0.0,) * 4, (0.0,) * 5), 6: (A6, (0.0,) * 5), 8: (A6, A8)}


@pytest.mark.parametrize("degree", HIGHER)
@pytest.mark.parametrize("side", [1, -1])
def test_on_a_paraboloid_the_patch_is_the_face_to_the_last_bits(side, degree):
    """Though a patch of degree 4 would be within the tolerance of a fit."""
    a6, a8 = HIGHER[degree]
    face = Face(EvenPolynomial(*CURVATURE, -1.0, -1.0, TERMS, side, a6, a8), (0.0, 0.0, 0.0), array=0)
    lens = fitted_lens(face, ZONE, FIT * PITCH)
    shape = Shape(CURVATURE, (-1.0, -1.0), TERMS, side, a6, a8)
    assert lens.poles.shape == (degree + 1, degree + 1)
    assert lens.error <= 1e-15 * PITCH
    points = np.random.default_rng(0).uniform(-2.5, 2.5, (60, 2))
    with mp.workdps(40):
        for (x, y), z in zip(points, lens.height(points[:, 0], points[:, 1]), strict=True):
            assert abs(mpf(float(z)) - shape.height(mpf(x), mpf(y))) <= mpf(1e-15) * PITCH


def test_on_another_conic_its_fit_is_within_a_billionth_of_the_pitch_and_stated():
    face = Face(EvenPolynomial(*CURVATURE, 0.3, -2.0, TERMS, 1), (0.1, 0.0, 0.0), array=0)
    lens = fitted_lens(face, ZONE, FIT * PITCH)
    assert len(lens.poles) > 5
    points = np.random.default_rng(1).uniform(-2.5, 2.5, (60, 2))
    shape = Shape(CURVATURE, (0.3, -2.0), TERMS)
    with mp.workdps(40):
        off = [
            abs(mpf(float(z)) - shape.height(mpf(x) - mpf(0.1), mpf(y)))
            for (x, y), z in zip(points, lens.height(points[:, 0], points[:, 1]), strict=True)
        ]
    assert max(off) <= 1e-9 * PITCH
    assert max(off) <= 2.0 * lens.error + 1e-15


def test_a_face_in_another_unit_is_scaled_with_its_terms():
    metres = Face(
        EvenPolynomial(52.5, 74.9, -1.0, -1.0, (2678.0, 20547.0, 8549.0), 1), (0.0, 0.0, 1e-3), array=0
    )
    in_mm = scaled_face(metres, 1000.0)
    assert in_mm.vertex == (0.0, 0.0, 1.0)
    x, y = np.random.default_rng(2).uniform(-2.5e-3, 2.5e-3, (2, 40))
    np.testing.assert_allclose(
        in_mm.surface.sag(1e3 * x, 1e3 * y), 1e3 * metres.surface.sag(x, y), rtol=1e-13
    )
