"""What a lit zone does to light: widths and patterns of polygons against FFTs and moments of their pixels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clacad.design import load
from clacad.effects.diffraction import lit_widths
from clacad.optics.aperture import equivalent_widths, first_zeros, pattern
from clacad.prescription.prescribe import prescribe
from clacad.sheet.feasibility import feasibility
from clacad.sheet.vignetting import lit_zone, thin_cells

SQUARE = np.array([(1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)]) / 2


def turned(polygon, degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return polygon @ np.array([[c, s], [-s, c]])


def hexagon(start):
    angle = np.radians(start) + np.arange(6) * np.pi / 3
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def projection(polygon, axis, count=4096):
    """Chord lengths at the middles of `count` strips, by the half planes of the edges."""
    low, high = polygon[:, axis].min(), polygon[:, axis].max()
    at = low + (np.arange(count) + 0.5) * (high - low) / count
    bottom, top = np.full(count, -np.inf), np.full(count, np.inf)
    for a, b in zip(
        polygon, np.roll(polygon, -1, axis=0)
    ):  # counter-clockwise: inside lies left of every edge
        ex, ey = (b - a)[axis], (b - a)[1 - axis]
        if abs(ex) < 1e-15:
            continue
        line = a[1 - axis] + ey * (at - a[axis]) / ex
        lower = (ex > 0) == (axis == 0)
        bottom, top = (np.maximum(bottom, line), top) if lower else (bottom, np.minimum(top, line))
    return at, np.clip(top - bottom, 0.0, None)


POLYGONS = {
    "square": SQUARE, "slit": SQUARE * (0.25, 1.0), "turned by 45": turned(SQUARE, 45.0), "turned by 50": turned(SQUARE, 50.0),
    "turned, squeezed": turned(SQUARE, 50.0) * (0.5, 1.0), "hexagon": hexagon(30.0), "hexagon turned": hexagon(17.0),
}  # fmt: skip


@pytest.mark.parametrize("name", POLYGONS)
@pytest.mark.parametrize("axis", [0, 1])
def test_the_pattern_of_a_polygon_is_the_fft_of_its_chords(name, axis):
    polygon = POLYGONS[name]
    at, chord = projection(polygon, axis)
    step, padded = at[1] - at[0], 2**18
    spectrum = np.abs(np.fft.rfft(chord, padded)) / chord.sum()
    frequency = np.fft.rfftfreq(padded, step)
    extent = np.ptp(polygon[:, axis])
    near = (frequency > 0) & (frequency < 5.0 / extent)
    np.testing.assert_allclose(np.abs(pattern(polygon, axis, frequency[near])), spectrum[near], atol=2e-5)
    # the first minimum of the FFT is the first zero
    inside = spectrum[near]
    dark = np.flatnonzero((inside[1:-1] < inside[:-2]) & (inside[1:-1] <= inside[2:]))[0] + 1
    assert first_zeros(polygon)[axis] == pytest.approx(frequency[near][dark], abs=frequency[1])
    # and the core is that of a slit of the equivalent width: √12 σ of the strips
    middle = (at * chord).sum() / chord.sum()
    sigma = np.sqrt(((at - middle) ** 2 * chord).sum() / chord.sum())
    assert equivalent_widths(polygon)[axis] == pytest.approx(np.sqrt(12.0) * sigma, rel=1e-5)
    core = frequency[near] < 0.15 / extent
    slit = np.abs(np.sinc(np.sqrt(12.0) * sigma * frequency[near][core]))
    np.testing.assert_allclose(inside[core], slit, atol=2e-4)


def test_a_square_turned_has_its_own_side_as_equivalent_width_and_dark_lines_of_its_two_sides():
    for degrees in (0.0, 10.0, 26.57, 45.0, 80.0):
        polygon = turned(SQUARE, degrees)
        assert equivalent_widths(polygon) == pytest.approx([1.0, 1.0])
        # the projection of a parallelogram is two boxes convolved: sinc times sinc
        longer = max(abs(np.cos(np.radians(degrees))), abs(np.sin(np.radians(degrees))))
        assert first_zeros(polygon) == pytest.approx([1.0 / longer] * 2, rel=1e-9)


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), min_size=2, max_size=6))
def test_first_zeros_lie_between_those_of_a_slit_and_of_a_triangle(steps):
    """Any zonogon (sum of segments) is symmetric and convex."""
    steps = np.array([s for s in steps if np.hypot(*s) > 0.1])
    steps = (
        np.where((steps[:, 1:] < 0) | ((steps[:, 1:] == 0) & (steps[:, :1] < 0)), -steps, steps)
        if len(steps)
        else steps
    )
    if len(steps) < 2:
        return
    steps = steps[np.argsort(np.arctan2(steps[:, 1], steps[:, 0]))]
    corners = np.concatenate([np.zeros((1, 2)), np.cumsum(np.concatenate([steps, -steps]), axis=0)[:-1]])
    area = (
        abs(
            sum(
                np.cross(np.append(a, 0), np.append(b, 0))[2]
                for a, b in zip(corners, np.roll(corners, -1, 0))
            )
        )
        / 2
    )
    extent = np.ptp(corners, axis=0)
    if area < 1e-3 or extent.min() < 1e-2:
        return
    found = first_zeros(corners) * extent
    assert (found >= 1.0 - 1e-9).all()
    assert (found <= 2.0 + 1e-9).all()
    for axis in (0, 1):
        nu = first_zeros(corners)[axis]
        assert abs(pattern(corners, axis, nu)[0]) < 1e-9
        assert (pattern(corners, axis, np.linspace(0.01, 0.99, 50) * nu).real > 0.0).all()


def _window(name):
    return prescribe(load(f"designs/{name}.toml"))


def test_the_tilted_sheet_diffracts_as_its_own_cell_does_not_as_the_box_round_it():
    """Square of 0.5 mm, 50 degrees turned, eta = -1/2, -1, f2 = 10/3 and 5 mm, 550 nm."""
    facts = feasibility(_window("tilted"))
    assert [1e3 * a for a in facts.diffraction_blur] == pytest.approx([2.2, 1.1], rel=5e-3)
    assert facts.fresnel_number == pytest.approx(0.125**2 / (550e-6 * 10.0 / 3.0), rel=5e-3)  # 8.52
    # dark where the longer of the two boxes, p|eta| sin 50 wide, is; the tips that lens 2 cuts off: 1 %
    expected = [550e-6 / (0.5 * e * np.sin(np.radians(50.0))) for e in (0.5, 1.0)]
    assert facts.first_zero == pytest.approx(expected, rel=0.012)


@pytest.mark.parametrize("name", ["tilted", "hexagonal", "fig5-phi-45", "paper-a-covered"])
def test_the_effect_and_the_table_take_the_same_width(name):
    window = _window(name)
    cells = thin_cells(window)
    middle = (cells.centre / cells.separation) @ window.thin.rotation[:, :2].T + window.thin.rotation[:, 2]
    widths = lit_widths(cells, middle[None], np.zeros((1, 2), np.int32))[0]
    facts = feasibility(window)
    assert facts.wavelength / window.unit / widths == pytest.approx(facts.diffraction_blur)
    assert widths == pytest.approx(equivalent_widths(lit_zone(cells)))


@pytest.mark.slow
def test_the_lit_zone_of_the_tilted_sheet_gives_the_fft_of_its_pixels():
    """Aperture drawn in pixels as |eta|-scaled and whole cell together, without polygons: the pattern along lens x, y."""
    cells = thin_cells(_window("tilted"))
    turn = np.radians(50.0)
    grid = (np.arange(2048) + 0.5) / 2048 * 0.8 - 0.4
    x, y = np.meshgrid(grid, grid, indexing="ij")

    def inside(u, v):
        a, b = np.cos(turn) * u - np.sin(turn) * v, np.sin(turn) * u + np.cos(turn) * v
        return (np.abs(a) <= 0.25) & (np.abs(b) <= 0.25)

    lit = inside(x, y) & inside(x / -0.5, y / -1.0)
    facts = feasibility(_window("tilted"))
    for axis in (0, 1):
        chord = lit.sum(axis=1 - axis).astype(float)
        nu = np.linspace(0.5, 12.0, 4000)
        seen = np.abs(np.exp(-2j * np.pi * np.outer(nu, grid)) @ chord) / chord.sum()
        dark = nu[np.flatnonzero((seen[1:-1] < seen[:-2]) & (seen[1:-1] <= seen[2:]))[0] + 1]
        assert facts.first_zero[axis] == pytest.approx(550e-6 * dark, rel=4e-3)
    assert cells.part == 1.0
