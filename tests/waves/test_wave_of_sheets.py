"""`clacad.wave`: exact surfaces and ideal lenses as waves, compared with their rays and the effect `diffraction`."""

from __future__ import annotations

import json
from math import pi
from pathlib import Path

import numpy as np
import pytest

import clacad
from clacad.cli import main
from clacad.cli.trace_command import wave_text
from clacad.sheet.bundle import bundle
from clacad.storage.errors import BadRequest, LimitRefused
from clacad.tracing.worst_cell import worst_cell
from clacad.waves import wave
from clacad.waves.exit_pupil import brightest, far_field, flatness, marginal, pupil, rays_needed, section

DESIGNS = Path(__file__).parents[2] / "designs"
TEMPLATES = Path(clacad.__file__).parent / "design" / "templates"
AXIS = np.array([0.0, 0.0, 1.0])


def shipped(name: str, **changes) -> clacad.Design:
    return clacad.load(DESIGNS / f"{name}.toml").replace(
        {k.replace("__", "."): v for k, v in changes.items()}
    )


def slow_pair(**changes) -> clacad.Design:
    """A pair of long lenses, so that hardly anything but diffraction is left."""
    return shipped("window-100mm", **{"lattice__pitch": 1.0, "pair__separation": 40.0, **changes})


def sinc_quartile() -> float:
    """Width that holds half of sinc²: from the sine integral."""
    from scipy.optimize import brentq
    from scipy.special import sici

    def within(a: float) -> float:
        x = pi * a
        return 2.0 * (sici(2.0 * x)[0] - np.sin(x) ** 2 / x) / pi

    return 2.0 * brentq(lambda a: within(a) - 0.5, 0.1, 0.5)


def test_a_good_pair_has_the_far_field_of_the_slit_that_is_lit():
    found = wave(slow_pair())
    assert found.exact.strehl == pytest.approx(1.0, abs=0.002)
    for one, slit in zip(found.exact.marginals, found.slit, strict=True):
        assert slit == pytest.approx(550e-9 / 1e-3)
        assert one.width == pytest.approx(0.8859 * slit, rel=0.005)
        assert one.half_energy == pytest.approx(sinc_quartile() * slit, rel=0.01)


def test_the_phase_rises_as_the_rays_lean():
    """Malus and Dupin: rays are perpendicular to wave fronts."""
    window = clacad.prescribe(shipped("paper-a-covered"))
    way = np.array([0.01, 0.004, 1.0]) / np.linalg.norm([0.01, 0.004, 1.0])
    found = pupil(window, way, 550e-9, 128)
    shape = (128, 128)
    alive = found.alive.reshape(shape)
    path = (found.phase * 550e-9 / (2.0 * pi) / window.unit).reshape(shape)
    place, off = found.place.reshape(*shape, 2), found.off.reshape(*shape, 2)
    for axis in (0, 1):
        both = alive.take(range(127), axis) & alive.take(range(1, 128), axis)
        rise = np.diff(path, axis=axis)[both]
        moved = np.diff(place, axis=axis)[both]
        lean = 0.5 * (off.take(range(127), axis) + off.take(range(1, 128), axis))[both]
        expected = (lean * moved).sum(axis=1)
        assert np.abs(rise - expected).max() < 2e-3 * np.abs(expected).max()


def test_of_much_aberration_waves_hold_as_much_light_as_rays_do():
    found = wave(shipped("paper-a-covered"))
    assert found.far_field is found.exact
    assert found.exact.strehl < 0.1
    for one, rays in zip(found.exact.marginals, found.rays.half_energy, strict=True):
        assert one.half_energy == pytest.approx(rays, rel=0.06)


def test_a_small_wave_error_lowers_the_peak_as_its_variance_says():
    window = clacad.prescribe(shipped("window-100mm"))
    found = pupil(window, AXIS, 550e-9, rays_needed(window, AXIS, 550e-9))
    variance = float(found.phase[found.alive].var())
    assert 0.001 < variance < 0.1
    assert far_field(found, 550e-9 / window.unit).strehl == pytest.approx(np.exp(-variance), abs=0.002)


@pytest.mark.daily_cases("0.006")
@pytest.mark.parametrize("slope", [0.0, 0.006])
def test_the_effect_diffraction_spreads_ideal_light_as_waves_do(slope):
    """Draws of `diffraction` for rays, compared with waves that know of no ray; Fresnel number 91."""
    design = shipped("window-100mm", lattice__pitch=1.0)
    found = wave(design, (np.arctan(slope), 0.0))
    window = clacad.prescribe(design)
    rays = bundle(window, 1 << 15, 0.0, middle=np.array([slope, 0.0, 1.0])).rays
    seen = clacad.trace(window, rays, rung="thin", effects=("diffraction",), path="numpy")
    obeying = seen.direction[seen.fate == clacad.Fate.ALIVE]
    low, middle, high = np.quantile(obeying[:, :2], (0.25, 0.5, 0.75), axis=0)
    law = design.law.refract(rays.direction[:1])[0]
    for k, one in enumerate(found.thin.marginals):
        assert high[k] - low[k] == pytest.approx(one.half_energy, rel=0.04)
        assert middle[k] - law[k] == pytest.approx(one.middle, abs=0.02 * found.slit[k])


def test_the_effect_diffraction_over_exact_surfaces_spreads_light_as_the_pupil_does_and_a_little_more():
    """Rays add a wave error's slopes to diffraction; an error of a fiftieth of a wave hardly widens the wave's core."""
    found = wave(shipped("window-100mm"))
    window = clacad.prescribe(shipped("window-100mm"))
    rays = bundle(window, 1 << 15, 0.0).rays
    seen = clacad.trace(window, rays, effects=("diffraction",), path="numpy")
    low, high = np.quantile(seen.direction[seen.fate == clacad.Fate.ALIVE, :2], (0.25, 0.75), axis=0)
    for k, one in enumerate(found.exact.marginals):
        assert 0.99 * one.half_energy < high[k] - low[k] < 1.06 * one.half_energy


def test_the_way_that_holds_follows_fresnel_number_and_foci():
    assert wave(slow_pair()).far_field.way == "pupil"
    few = wave(slow_pair(lattice__pitch=0.5))
    assert (few.far_field.way, few.exact) == ("angular spectrum", None)
    assert "Fresnel number 5.68" in few.refused["pupil"]
    virtual = wave(shipped("galilean", lattice__pitch=2.0, pair__separation=20.0))
    assert min(virtual.fresnel) > 10.0
    assert virtual.far_field.way == "angular spectrum"
    assert "virtual" in virtual.refused["pupil"]


def test_turned_cells_are_done_on_a_square_grid():
    """A square lattice under lenses turned by 45 degrees loses as much as one that is not, to a neighbour or two."""
    upright = wave(shipped("window-100mm", lattice__pitch=0.3))
    turned = wave(shipped("window-100mm", lattice__pitch=0.3, law__euler=[45.0, 0.0, 0.0]))
    assert turned.thin_share == pytest.approx(upright.thin_share, rel=0.005)
    assert turned.thin.marginals[0].half_energy == pytest.approx(
        turned.thin.marginals[1].half_energy, rel=1e-3
    )
    assert turned.slit[0] == pytest.approx(upright.slit[0])  # of the width with the same core


@pytest.mark.parametrize(("pitch", "separation", "part"), [
    (1.0, 10, 0.3), *(pytest.param(*one, marks=pytest.mark.slow) for one in [(0.5, 10, 0.3), (1.0, 10, 0.15)])])  # fmt: skip
def test_above_fresnel_number_20_the_exact_surfaces_waves_go_on_the_mean_where_their_rays_go(
    pitch, separation, part
):
    """Ehrenfest: the mean direction of a wave is that of its rays, aberration or none; tails beyond 20 λ/w left out."""
    slope = part * pitch / separation
    found = wave(
        shipped("window-100mm", lattice__pitch=pitch, pair__separation=separation), (np.arctan(slope), 0.0)
    )
    assert min(found.fresnel) > 20.0
    for one, slit, rays in zip(found.exact.marginals, found.slit, found.rays.mean, strict=True):
        core = np.abs(one.off) < 20.0 * slit
        mean = (one.off * one.density)[core].sum() / one.density[core].sum()
        assert mean == pytest.approx(rays, abs=0.02 * slit)


@pytest.mark.slow
def test_with_the_field_lens_that_is_built_the_share_to_the_partner_rises_from_966_to_997_an_axis(capsys):
    """At Fresnel number 22.7; the figures are another program's."""
    shares = []
    for more in ([], ["--set", "pair.field_lens=true"]):
        assert main(["wave", str(DESIGNS / "window-100mm.toml"), *more, "--json"]) == 0
        told = json.loads(capsys.readouterr().out)
        assert min(told["fresnel_number"]) == pytest.approx(22.7, abs=0.05)
        assert told["field_lens"] == bool(more)
        shares.append(np.sqrt(told["thin"]["share"]))  # two axes alike
        assert told["way"] == "pupil"
        assert told["share"] == pytest.approx(
            told["rays"]["share"] * told["thin"]["share"] / told["thin_share_of_rays"]
        )
    assert shares == pytest.approx([0.966, 0.997], abs=0.001)


def test_a_field_lens_keeps_light_of_slopes_that_else_go_to_neighbours():
    angle = (np.arctan(0.02), 0.0)
    without, with_it = (wave(shipped("window-100mm"), angle, field_lens=one) for one in (False, True))
    assert without.thin_share < 0.6
    assert with_it.thin_share > 0.98
    assert with_it.far_field.way == "angular spectrum"
    with pytest.raises(BadRequest, match="eta below 0"):
        wave(shipped("galilean"), field_lens=True)


def aimed(**changes) -> clacad.Design:
    return shipped(
        "window-100mm", lattice__count=[61, 61], lattice__aperture={"point": [0, 0, -400]}, **changes
    )


@pytest.mark.slow
def test_where_cells_differ_the_light_is_that_of_the_cell_the_sheet_is_judged_by(capsys):
    """An aimed sheet: its own rays sent through the whole sheet, in the direction in which that cell looks at the eye."""
    design = aimed()
    found = wave(design)
    seen = worst_cell(clacad.prescribe(design), design.check.field)
    assert (found.cell, found.tried) == (tuple(seen.cell.tolist()), seen.tried)
    i, j = found.cell
    place = 0.5 * (np.array([i, j]) - 30.0)
    assert max(abs(i - 30), abs(j - 30)) >= 25, "the worst stands near the rim"
    assert found.slope == pytest.approx(place / 400.0, rel=1e-6)  # from the eye to the middle of its cell 1
    # other points of the same cell, by another path through the tracer
    points = 0.5 * (np.random.default_rng(5).random((4096, 2)) - 0.5) + place
    way = np.array([*found.slope, 1.0])
    rays = clacad.Rays(np.column_stack([points, np.zeros(4096)]) - 3.0 * way, np.broadcast_to(way, (4096, 3)))
    result = clacad.trace(seen.window, rays)
    alive = (result.fate == clacad.Fate.ALIVE) & (result.cell == found.cell).all(axis=1)
    assert alive.mean() == pytest.approx(found.rays.share, abs=0.02)
    off = (result.direction - design.law.refract(way[None, :]))[alive, :2]
    assert np.sqrt((off**2).sum(axis=1).mean()) == pytest.approx(found.rays.rms, rel=0.05)
    assert off.mean(axis=0) == pytest.approx(found.rays.mean, abs=2e-5)
    assert main(["wave", str(DESIGNS / "window-100mm.toml"), "--set", "lattice.count=[61,61]",
                 "--set", "lattice.aperture={point=[0,0,-400]}", "-q", "--json"]) == 0  # fmt: skip
    assert json.loads(capsys.readouterr().out)["cell"] == [i, j]


def test_a_narrower_array_2_lets_through_what_its_own_rims_do():
    """A beam 0.5 wide meets rims 0.4 apart; with η = −1 lens 2 is in the shadow a slit casts at the separation (Collins)."""
    from scipy.special import fresnel

    found = wave(shipped("window-100mm", lattice__pitch_2=0.4, lattice__count=[5, 5]))
    assert found.cell is not None
    assert found.thin_share_of_rays == pytest.approx(0.8**2, rel=1e-9)
    scale = np.sqrt(2.0 / (0.55e-3 * 10.0))
    x = (np.arange(4000) + 0.5) / 4000 * 0.4 - 0.2
    (s1, c1), (s2, c2) = fresnel(scale * (-0.25 - x)), fresnel(scale * (0.25 - x))
    shadow = 0.5 * ((c2 - c1) ** 2 + (s2 - s1) ** 2)
    assert found.thin_share == pytest.approx((shadow.mean() * 0.8) ** 2, rel=2e-3)
    assert found.slit == pytest.approx([550e-9 / 0.4e-3] * 2)
    assert found.fresnel == pytest.approx([(0.2e-3) ** 2 / (550e-9 * 5e-3)] * 2)


def test_light_that_no_part_of_obeys_the_law_is_refused_with_the_field():
    with pytest.raises(BadRequest, match="the field ends 50 and 50 mrad"):
        wave(shipped("window-100mm"), (np.arctan(0.051), 0.0))


def test_rays_beyond_what_is_computed_are_refused_with_what_is_needed():
    with pytest.raises(LimitRefused, match=r"needs \d+ x \d+ rays"):
        wave(shipped("paper-a-covered"), wavelength=1e-8)


def test_widths_of_a_turned_square_are_told_of_both_kinds_as_closed_forms_have_them():
    """A square of side p turned by 45°: its chords are w(y) = 2 (a − |y|), a = p/√2.

    Through the peak light goes as sinc⁴(a ν); summed over the other axis as ∫ w² sinc²(w ν) dy.
    """
    side, pitch, wave = 400, 0.5, 5.5e-4
    a = pitch / np.sqrt(2.0)
    spacing = 2.0 * a / side
    x = (np.arange(side) + 0.5) * spacing - a
    field = (np.abs(x)[:, None] + np.abs(x)[None, :] <= a).astype(np.complex128)
    light, turns = brightest(field)
    assert light == pytest.approx(field.sum().real ** 2, rel=1e-12)
    summed = marginal(field, 0, spacing, wave, 2.0 * a).width
    through = section(field, 0, turns, spacing, wave, 2.0 * a).width

    nu = np.linspace(0.0, 2.0 / a, 20001)
    y = (np.arange(2000) + 0.5) / 2000 * a
    chords = 2.0 * (a - y)
    by_sum = np.array([(chords**2 * np.sinc(chords * v) ** 2).mean() for v in nu[:8000]])
    assert through == pytest.approx(2.0 * wave * nu[np.argmax(np.sinc(a * nu) ** 4 < 0.5)], rel=3e-3)
    assert summed == pytest.approx(2.0 * wave * nu[np.argmax(by_sum < 0.5 * by_sum[0])], rel=3e-3)


@pytest.mark.parametrize(
    "change", [{"law.eta": [-1.2, -0.8]}, {"law.eta": [-0.5, -0.5]}, {"lattice.pitch": 0.2}]
)
def test_a_strehl_ratio_is_one_at_most_and_says_of_which_light(change):
    """Ideal lenses: the light that met the partner against the same light with a flat wave front."""
    found = wave(clacad.load(DESIGNS / "window-100mm.toml").replace(change))
    ratios = [far.strehl for far in (found.exact, found.thin) if far is not None]
    assert ratios
    assert all(0.5 < ratio <= 1.0 for ratio in ratios)
    assert found.to_dict()["thin"]["fwhm_through_peak"] == pytest.approx(found.to_dict()["thin"]["fwhm"])
    text = wave_text(found)
    assert (
        "Strehl ratio: peak over that of the light that meets the partner, were its wave front flat" in text
    )
    assert "summed over the other axis" in text
    assert "through the peak" in text


def test_rounding_brings_no_strehl_ratio_above_one():
    """The slab to start from: light through its exact faces has a flat wave front to 4e-16."""
    found = wave(clacad.load(TEMPLATES / "slab.toml"))
    assert found.exact is not None
    assert 1.0 - 1e-9 < found.exact.strehl <= 1.0


def test_a_flat_wave_has_a_strehl_ratio_of_one_and_noise_less():
    rng = np.random.default_rng(3)
    amplitude = rng.uniform(0.1, 1.0, (32, 48))
    assert flatness(amplitude.astype(np.complex128)) == pytest.approx(1.0, rel=1e-12)
    assert flatness(np.full((3, 3), 0.1 + 0j)) == 1.0  # by rounding alone 2e-16 more
    tilted = amplitude * np.exp(0.7j * np.arange(48))
    assert flatness(tilted) == pytest.approx(1.0, rel=2e-3)
    assert flatness(amplitude * np.exp(2j * np.pi * rng.random((32, 48)))) < 0.1
