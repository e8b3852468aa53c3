"""Waves through ideal lenses with rims: golden cases of another program, laws of loss, the grid that is needed."""

from __future__ import annotations

import json
from math import sqrt
from pathlib import Path

import numpy as np
import pytest

from clacad.waves.exit_pupil import Marginal, marginal
from clacad.waves.lens_planes import (
    Emerging,
    Grid,
    LensPlane,
    chief_ray,
    grid_for,
    propagate,
    telescope,
)

CASES = json.loads((Path(__file__).parents[1] / "data/wave.json").read_text())["cases"]
GREEN = 550e-9


def slit(width: float) -> np.ndarray:
    return np.array([[-0.5 * width], [0.5 * width]])


def pair(pitch: float, eta: float, separation: float, *, field_lens: bool = False) -> list[LensPlane]:
    first = separation / (1.0 - eta)
    return telescope(
        ((first,), (-eta * first,)), (0.0,), (0.0,), separation, slit(pitch), field_lens=field_lens
    )


def pitch_of(fresnel: float, separation: float = 0.01) -> float:
    """Pitch of a pair with eta = -1 and this Fresnel number, (p/2)²/(λ s/2)."""
    return 2.0 * sqrt(fresnel * GREEN * 0.5 * separation)


def seen(wave: Emerging, width: float) -> Marginal:
    return marginal(wave.field, 0, wave.spacing, GREEN, width)


@pytest.mark.parametrize("case", CASES, ids=lambda c: f"{c['fresnel_number']:.3g} at {c['slope']:.2g}")
def test_shares_and_half_maxima_are_those_of_another_wave_program(case):
    pitch, eta, slope = case["pitch"], case["eta"], case["slope"]
    planes = pair(pitch, eta, case["separation"], field_lens=case["field_lens"])
    wave = propagate(planes, (slope,), case["wavelength"])
    assert wave.share == pytest.approx(case["partner_share"], rel=0.01)
    width = pitch * min(1.0, abs(eta))
    far = marginal(wave.field, 0, wave.spacing, case["wavelength"], width)
    scale = case["wavelength"] / width
    assert far.width / scale == pytest.approx(case["fwhm_in_lambda_over_w"], rel=0.01)
    # that program's lenses are stigmatic phases, these bend by slopes: they differ by (x/f)³/2, coma of the one off its axis
    law = chief_ray(planes, (slope,))[1][0]
    assert law == pytest.approx(slope / eta, rel=1e-12)
    for found, asked in zip(far.half_maximum, case["half_maximum_slopes"], strict=True):
        assert law + found == pytest.approx(asked, rel=0.01)


@pytest.mark.parametrize("fresnel", [1.82, 5.7, 9.1, 22.7, 91.0, 182.0])
def test_what_neighbours_take_of_a_beam_that_fills_its_cell_is_0164_over_the_root_of_the_fresnel_number(
    fresnel,
):
    share = propagate(pair(pitch_of(fresnel), -1.0, 0.01), (0.0,), GREEN).share
    assert 1.0 - share == pytest.approx(0.164 / sqrt(fresnel), rel=0.1)


@pytest.mark.parametrize("fresnel", [22.7, 60.0, 182.0])
@pytest.mark.parametrize("part", [0.0, 0.15, 0.3])
def test_above_fresnel_number_20_waves_and_rays_leave_in_the_same_direction(fresnel, part):
    pitch = pitch_of(fresnel)
    far = seen(propagate(pair(pitch, -1.0, 0.01), (part * pitch / 0.01,), GREEN), pitch)
    assert abs(far.middle) < 0.02 * GREEN / pitch


@pytest.mark.parametrize(
    ("fresnel", "asked"), [(22.7, 0.009), (9.1, 0.020), (5.7, 0.047), (1.818, 0.074), (0.91, 0.11)]
)
def test_off_the_middle_of_the_field_the_brightest_direction_leaves_the_law_as_another_program_found(
    fresnel, asked
):
    """At three tenths of p/s, in λ/w; where seven tenths of the cell are lit the core is that much wider."""
    pitch = pitch_of(fresnel)
    wave = propagate(pair(pitch, -1.0, 0.01), (0.3 * pitch / 0.01,), GREEN)
    far = seen(wave, 32.0 * pitch)  # finely, to find the peak
    assert far.off[int(np.argmax(far.density))] / (GREEN / pitch) == pytest.approx(asked, abs=0.005)
    if fresnel > 5.0:
        assert far.width == pytest.approx(1.26 * GREEN / pitch, rel=0.02)


def test_a_field_lens_brings_the_rim_of_lens_1_to_that_of_lens_2():
    pitch = pitch_of(22.7272727)
    without, with_it = (
        propagate(pair(pitch, -1.0, 0.01, field_lens=one), (0.0,), GREEN) for one in (False, True)
    )
    assert without.share == pytest.approx(0.966, abs=0.001)
    assert with_it.share == pytest.approx(0.997, abs=0.001)
    assert seen(with_it, pitch).width == pytest.approx(0.888 * GREEN / pitch, rel=0.005)


def test_a_field_lens_needs_a_real_focus_in_every_axis():
    with pytest.raises(ValueError, match="eta below 0"):
        pair(5e-4, 0.5, 0.01, field_lens=True)
    focal = ((0.005, 0.004), (0.005, 0.006))
    zone = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * 2.5e-4
    with pytest.raises(ValueError, match="different depths"):
        telescope(focal, (0.0, 0.0), (0.0, 0.0), 0.01, zone, field_lens=True)


@pytest.mark.parametrize(("fresnel", "wide"), [(0.5, 1.0), (3.0, 1.0), (12.0, 0.6)])
def test_without_lenses_a_slit_casts_the_shadow_of_fresnel_s_integrals(fresnel, wide):
    """Share of the light of one slit in another behind it, to many digits: ½ |C + iS|² between the edges."""
    import mpmath

    pitch, distance = 5e-4, 5e-4**2 / (4.0 * fresnel * GREEN)
    second = LensPlane(distance, (0.0,), (0.0,), slit(wide * pitch))
    share = propagate([LensPlane(0.0, (0.0,), (0.0,), slit(pitch)), second], (0.0,), GREEN).share
    scale = mpmath.sqrt(mpmath.mpf(2) / (GREEN * distance))

    def intensity(x):
        near, far = scale * (-0.5 * pitch - x), scale * (0.5 * pitch - x)
        real = mpmath.fresnelc(far) - mpmath.fresnelc(near)
        return (real**2 + (mpmath.fresnels(far) - mpmath.fresnels(near)) ** 2) / 2

    places = mpmath.linspace(0, wide * pitch / 2, 9)
    asked = 2 * mpmath.quad(intensity, places) / pitch
    assert share == pytest.approx(float(asked), abs=1e-3)


def test_light_that_no_second_rim_stops_is_all_there():
    first, last = pair(pitch_of(5.0), -1.0, 0.01)
    open_ = LensPlane(last.distance, (0.0,), last.vertex, 8.0 * last.stop)
    assert propagate([first, open_], (0.0,), GREEN).share == pytest.approx(1.0, abs=0.005)


def test_square_cells_on_a_square_grid_give_the_product_of_their_axes():
    pitch, slope = pitch_of(4.0), (0.2 * pitch_of(4.0) / 0.01, 0.0)
    zone = 0.5 * pitch * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    both = propagate(telescope(((5e-3,) * 2,) * 2, (0.0,) * 2, (0.0,) * 2, 0.01, zone), slope, GREEN)
    axes = [propagate(pair(pitch, -1.0, 0.01), (t,), GREEN) for t in slope]
    assert both.share == pytest.approx(axes[0].share * axes[1].share, rel=0.003)
    for k, one in enumerate(axes):
        far = marginal(both.field, k, both.spacing, GREEN, pitch)
        assert far.half_energy == pytest.approx(seen(one, pitch).half_energy, rel=0.01)


@pytest.mark.parametrize("eta", [-4.0, -1.0, -0.25, 0.5, 2.0])
def test_the_grid_asked_for_is_fine_and_wide_enough(eta):
    planes, slope = pair(2.2e-4, eta, 0.01), (0.3 * 2.2e-4 / 0.01,)
    grid = grid_for(planes, slope, GREEN)
    usual = propagate(planes, slope, GREEN)
    finer = propagate(planes, slope, GREEN, Grid(8 * grid.points, 0.5 * grid.spacing))
    assert usual.share == pytest.approx(finer.share, abs=5e-4)
