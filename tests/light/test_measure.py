"""Light of a bundle: several wavelengths and temperatures against closed forms, weights, and the numbers of dark light."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import clacad
from clacad.design import Design
from clacad.effects import dispersion
from clacad.effects.engine.effect import Setting, Situation
from clacad.light.compare import Comparison, angles, change_with_shift
from clacad.light.measure import deviation, measure, measure_each
from clacad.optics.law import angle_between, difference_of_laws
from clacad.optics.material.catalogue import find
from clacad.optics.rays import Fate
from clacad.prescription.prescribe import prescribe
from clacad.sheet.bundle import RequestedLaw, bundle, field_points
from clacad.tracing.trace import trace
from clacad.tracing.worst_cell import measure_light, worst_cell

F, E, D, C = 486.1e-9, 546.1e-9, 587.6e-9, 656.3e-9
SEPARATION = 10.0
FIELD = 0.0175


def slab(*eta, **changes):
    return Design.from_dict({
        "format": 1, "name": "slab", "unit": "mm", "law": {"eta": list(eta)},
        "pair": {"form": "slab", "separation": SEPARATION, "material": "PMMA"} | changes,
        "lattice": {"pitch": 0.5, "count": [5, 5]},
    })  # fmt: skip


def light_of(window, field=FIELD, wavelengths=(), temperatures=(), rays=4096):
    return measure_light(window, field, wavelengths, temperatures, rays)


def change_of_slopes(one, other):
    """Change of the exit slopes (k, 2) of the rays ALIVE in both, and where and with which slope they came."""
    both = one.alive & other.alive
    slopes = [light.direction[both, :2] / light.direction[both, 2:] for light in (one, other)]
    into = one.lit.rays.direction[both]
    return slopes[1] - slopes[0], one.lit.points[both], into[:, :2] / into[:, 2:]


def by_closed_form(eta, n0, n, place, slope):
    """ε (1 − η)/η (t − x/f1) with ε = (n − n0)/(n (n − 1)), f1 = s/(1 − η), along each axis."""
    epsilon, eta = (n - n0) / (n * (n - 1.0)), np.array(eta)
    return epsilon * (1.0 - eta) / eta * (slope - place * (1.0 - eta) / SEPARATION)


@pytest.mark.parametrize("eta", [(-1.0, -1.0), (0.5, -1.0)])
@pytest.mark.parametrize("line", [F, C])
def test_a_slab_in_light_of_another_line_changes_slopes_as_the_closed_form(eta, line):
    window = prescribe(slab(*eta))
    light = light_of(window, wavelengths=[line])
    (one,) = light.lines
    found, place, slope = change_of_slopes(light_of(window), one)
    n0, n = window.bodies[0].index, window.bodies[0].index_at(line)
    expected = by_closed_form(eta, n0, n, place, slope)
    assert np.sqrt(np.mean(expected**2)) > 1e-5
    assert np.sqrt(np.mean((found - expected) ** 2)) < 0.03 * np.sqrt(np.mean(expected**2))


@pytest.mark.parametrize("kelvin", [-20.0, 20.0])
def test_a_slab_at_another_temperature_changes_slopes_as_the_closed_form(kelvin):
    window, eta = prescribe(slab(-1.0, -1.0)), (-1.0, -1.0)
    (one,) = light_of(window, temperatures=[kelvin]).lines
    found, place, slope = change_of_slopes(light_of(window), one)
    n0 = window.bodies[0].index
    expected = by_closed_form(eta, n0, n0 + kelvin * find("PMMA").thermal.dn_dt[0], place, slope)
    assert np.sqrt(np.mean((found - expected) ** 2)) < 0.03 * np.sqrt(np.mean(expected**2))


def test_white_light_has_the_error_of_the_closed_form_in_quadrature_with_that_of_the_design():
    """The total of a line is √(e0² + 2⟨e0 e1⟩ + e1²); white light is the mean square of its lines."""
    window, eta = prescribe(slab(-1.0, -1.0)), (-1.0, -1.0)
    plain, white = light_of(window), light_of(window, wavelengths=[F, E, D, C])
    squares = []
    for wave in (F, E, D, C):
        _, place, slope = change_of_slopes(plain, plain)
        n0, n = window.bodies[0].index, window.bodies[0].index_at(wave)
        error = (plain.direction - plain.expected)[plain.alive, :2] + by_closed_form(eta, n0, n, place, slope)
        squares.append(np.mean((error**2).sum(axis=1)))
    assert white.rms == pytest.approx(np.sqrt(np.mean(squares)), rel=0.02)
    assert white.rms > plain.rms


def test_white_light_and_all_temperatures_are_every_pair_of_them():
    window = prescribe(slab(-1.0, -1.0))
    light = light_of(window, wavelengths={F: 1.0, C: 3.0}, temperatures={0.0: 2.0, 20.0: 1.0}, rays=512)
    assert len(light.lines) == 4
    weights = [light.weight[k * 512] for k in range(4)]
    assert weights == [2.0, 6.0, 1.0, 3.0]
    rms = np.array([line.rms for line in light.lines])
    known = np.array([line.known.sum() for line in light.lines])
    assert light.rms == pytest.approx(np.sqrt(np.average(rms**2, weights=weights * known)), rel=1e-12)
    assert light.share == pytest.approx(
        np.average([line.share for line in light.lines], weights=weights), rel=1e-12
    )
    assert light.worst == max(line.worst for line in light.lines)
    alone = light_of(window, wavelengths=[C], temperatures=[20.0], rays=512).lines[0]
    assert alone.rms == light.lines[3].rms


def test_a_weight_of_two_is_the_line_twice():
    window = prescribe(slab(-0.5, -1.0))
    once = light_of(window, wavelengths={F: 2.0, C: 1.0}, rays=1024)
    twice = light_of(window, wavelengths=[F, F, C], rays=1024)
    for name in ("rms", "share", "spread", "bias", "worst"):
        assert getattr(once, name) == pytest.approx(getattr(twice, name), rel=1e-12), name
    assert difference_of_laws(once.fitted, twice.fitted) == pytest.approx((0.0, 0.0), abs=1e-12)


def test_the_law_of_several_lines_is_fitted_to_all_their_light():
    window = prescribe(slab(-0.5, -1.0))
    light = light_of(window, 0.002, wavelengths=[F, C])
    direct = clacad.Law.fit(
        light.lit.rays.direction[light.alive], light.direction[light.alive], axes=window.law
    ).law
    assert light.fit is None
    assert max(difference_of_laws(light.fitted, direct)) < 1e-4  # a few rays at borders live in one line only
    assert max(difference_of_laws(light.lines[0].fitted, light.lines[1].fitted)) > 1e-3


def test_of_one_state_nothing_is_weighted():
    window = prescribe(slab(-1.0, -1.0))
    plain, same = light_of(window), light_of(window, temperatures=[0.0])
    assert plain.weight is None
    assert plain.lines == ()
    assert same.rms == pytest.approx(plain.rms, rel=1e-12)
    assert (same.seen.direction == plain.seen.direction).all()


@pytest.mark.parametrize("weight", [0.0, -1.0, np.nan, np.inf])
def test_weights_are_positive_numbers(weight):
    with pytest.raises(ValueError, match="positive"):
        light_of(prescribe(slab(-1.0, -1.0)), wavelengths={F: 1.0, C: weight}, rays=64)


def test_what_has_no_temperature_is_refused():
    window = prescribe(slab(-1.0, -1.0))
    lit = bundle(window, 64, FIELD)
    with pytest.raises(TypeError, match="no temperature"):
        measure(lambda one: trace(window, one.rays), lit, RequestedLaw.of(window), temperatures=[20.0])
    plain = prescribe(Design.from_dict({
        "format": 1, "name": "n", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
        "pair": {"form": "slab", "separation": 10.0, "index": 1.5}, "lattice": {"pitch": 0.5, "count": [3, 3]},
    }))  # fmt: skip
    with pytest.raises(ValueError, match="temperature"):
        light_of(plain, temperatures=[20.0], rays=64)


def test_the_numbers_are_those_of_the_rays():
    window = prescribe(slab(-0.5, -1.0))
    lit = bundle(window, 2048, FIELD)
    seen = trace(window, lit.rays)
    light = measure(lambda one: trace(window, one.rays), lit, RequestedLaw.of(window))
    alive = seen.fate == Fate.ALIVE
    out = seen.direction[alive]
    error = angle_between(out, window.law.refract(lit.rays.direction[alive]))
    assert light.rms == np.sqrt(np.mean(error**2))
    assert light.worst == error.max()
    assert light.share == alive.mean()
    assert light.seen.counts() == seen.counts()
    assert light.spread == np.sqrt(np.mean(angle_between(out, out.mean(axis=0)) ** 2))
    dark = replace(light, fewest=int(alive.sum()) + 1)
    assert dark.dark
    assert np.isnan([dark.rms, dark.worst, dark.bias, dark.spread]).all()
    assert dark.fit is None
    assert dark.fitted is None
    assert dark.share == light.share


def test_bundles_sent_together_have_the_light_of_each_alone():
    window = prescribe(slab(-0.5, -1.0))
    beams = [bundle(window, 300, 0.0, middle=way) for way in field_points(window, FIELD)]
    law, path = RequestedLaw.of(window), "numpy"
    each = measure_each(lambda one: trace(window, one.rays, path=path), beams, law)
    for beam, light in zip(beams, each, strict=True):
        alone = measure(lambda one: trace(window, one.rays, path=path), beam, law)
        assert (light.seen.direction == alone.seen.direction).all()
        assert light.bias == alone.bias
        assert deviation(light).shape == (alone.alive.sum(), 2)


def test_the_focus_of_the_same_light_is_nothing():
    window = prescribe(slab(-0.5, -1.0))
    light = light_of(window, rays=1024)
    same = Comparison(light, light)
    assert same.focus(window) == pytest.approx([0.0, 0.0], abs=1e-12)
    change = change_with_shift(window, light.lit.cell, light.lit.rays)
    assert (same.focus(window, change) == same.focus(window)).all()
    assert difference_of_laws(*same.laws) == (0.0, 0.0)


def test_dispersion_of_a_picture_is_the_light_of_its_lines():
    """The effect sends its probe rays through `measure`; its number is the largest change among its lines."""
    window = prescribe(slab(-1.0, -1.0))
    rays = bundle(window, 256, FIELD).rays
    base = trace(window, rays, path="size")
    largest = [
        np.quantile(
            angles(
                base, trace(window, clacad.Rays(rays.position, rays.direction, wave), path="size"), Fate.GHOST
            ),
            0.99,
        )
        for wave in (F, C)
    ]
    situation = Situation(window, Setting(wavelengths=(F, C)), rays, 1e-4, 0.01)
    assert dispersion.measured(situation) == (max(largest), 0.0)


def test_a_heated_cell_is_that_of_a_heated_sheet():
    window = prescribe(slab(-1.0, -1.0))
    cell = worst_cell(window, FIELD).heated(20.0)
    change = 20.0 * find("PMMA").thermal.dn_dt[0]
    body = cell.window.bodies[0]
    assert body.index == pytest.approx(window.bodies[0].index + change, abs=1e-15)
    assert body.index_at(F) == pytest.approx(window.bodies[0].index_at(F) + change, abs=1e-15)
    assert body.heated(-20.0).index == pytest.approx(window.bodies[0].index, abs=1e-15)
