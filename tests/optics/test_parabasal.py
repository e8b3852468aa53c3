"""Parabasal rays: the power they show is the lensmaker's, regardless of the lens's orientation."""

from __future__ import annotations

import numpy as np
import pytest

from clacad.optics.law import rotation
from clacad.optics.sequence import STEP, Interface, parabasal
from clacad.optics.surface import Quadric

R, T, N = 3.0, 0.4, 1.5


def lens(turn):
    """Biconvex lens of two spheres about the origin."""
    along = turn[:, 2]
    front, back = Quadric(1 / R, 1 / R, 1 / R, 1), Quadric(1 / R, 1 / R, 1 / R, -1)
    return [Interface(front, -0.5 * T * along, 1.0, N, turn), Interface(back, 0.5 * T * along, N, 1.0, turn)]


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (0.3, 0.2, -0.7)])
def test_the_power_of_a_thick_lens_is_the_lensmakers(angles):
    turn = rotation(*angles)
    found = parabasal(lens(turn), turn, np.zeros(3), STEP)
    power = (N - 1) * (2 / R - (N - 1) * T / (N * R * R))
    np.testing.assert_allclose(found.slopes, -power * np.eye(2), rtol=0, atol=1e-11)
    np.testing.assert_allclose(found.cosines, found.slopes, rtol=0, atol=1e-11)  # light leaves along the axis
    np.testing.assert_allclose(found.direction, turn[:, 2], rtol=0, atol=1e-15)


def test_light_that_is_totally_reflected_has_no_power():
    steep = Interface(Quadric(0.0, 0.0, 0.0), (0.0, 0.0, 0.0), N, 1.0, rotation(0.0, 1.0, 0.0))
    found = parabasal([steep], np.eye(3), np.zeros(3), 0.01)
    assert np.isnan(found.direction).all()
    assert np.isnan(found.slopes).all()
