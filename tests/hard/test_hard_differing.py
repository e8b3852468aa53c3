"""Sheets whose cells differ on their hard list: numpy and the compiled kernel against 60 digits, ray by ray."""

from __future__ import annotations

import numpy as np
import pytest
from hard.differing import CASES, FAR, window_of
from hard.measure import error, off
from mpmath import mp, mpf
from oracle import sheet as oracle

from clacad import Rays, trace
from clacad.optics.rays import Fate
from clacad.sheet.vignetting import aperture_slopes

WINDOWS = {}


def window_for(case):
    """One window a sheet, however many cases have it."""
    key = repr(case.changes)
    if key not in WINDOWS:
        WINDOWS[key] = window_of(case.changes)
    return WINDOWS[key]


def ray_of(case, window):
    """Start and direction: at a place of the cell of array 1, with a slope beyond the middle of its field."""
    if isinstance(case.off, str):
        return beside_border(case, window)
    return sent(case, window, case.off)


def sent(case, window, place):
    index = np.array(case.cell)
    slope = aperture_slopes(window, index[None])[0] + np.array(case.slope)
    below = window.z_range[0] - 0.25
    start = window.centres(0, index) + np.array(place) + below * slope
    return np.array([*start, below]), np.array([*slope, 1.0])


def beside_border(case, window):
    """A ray that meets lens 2 within a last bit of its start beside a border: on which side, sixty digits say."""
    low, high = -0.2, 0.2

    def met(x):
        return oracle.trace(window, *sent(case, window, (x, 0.03))).cells[-1]

    first = met(low)
    assert first != met(high), "no border is met"
    while (middle := 0.5 * (low + high)) not in (low, high):
        low, high = (middle, high) if met(middle) == first else (low, middle)
    return sent(case, window, (low - 4e-15 if case.off == "below" else high + 4e-15, 0.03))


def marks(case):
    """Sheets of 4·10⁸ cells take seconds to make."""
    return [pytest.mark.slow] if dict(case.changes).get("lattice.count") == FAR else []


@pytest.mark.parametrize("path", ["numpy", pytest.param("numba", marks=pytest.mark.slow)])
@pytest.mark.parametrize("case", [pytest.param(case, id=case.name, marks=marks(case)) for case in CASES])
def test_a_ray_through_cells_that_differ_goes_where_sixty_digits_say(case, path):
    window = window_for(case)
    assert not window.uniform
    start, direction = ray_of(case, window)
    exact = oracle.trace(window, start, direction)
    result = trace(window, Rays([start], [direction]), path=path)
    assert Fate(result.fate[0]).name == exact.fate, case.why
    assert tuple(result.cell[0]) == exact.cells[0] == case.cell, case.why
    assert tuple(result.cell[0] + result.order[0]) == exact.cells[-1], case.why
    condition = max(1.0, float(oracle.condition(window, start, direction)))
    assert off(result.direction[0], exact.direction) <= 4 * condition, case.why
    with mp.workdps(60):
        far = max(1.0, float(np.abs(start).max()))
        assert error(result.position[0], exact.position) <= 8 * 2.0**-52 * far * condition, case.why
        assert abs(mpf(float(result.optical_path[0])) - exact.optical_path) <= 8 * 2.0**-52 * condition * 100
