"""Effects as passes: absent is never written, neutral is absent, and each obeys its own law."""

from __future__ import annotations

import math
import subprocess
import sys
import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path

import mpmath
import numpy as np
import pytest
from often import often

from clacad import Design, load, prescribe
from clacad.base.polygons import clip
from clacad.base.sobol import sobol
from clacad.effects import NAMES, Setting, light_reaching_camera, trace_with
from clacad.effects.engine.effect import inside_plate
from clacad.effects.engine.homogeneous_light import overlap
from clacad.effects.engine.nonsequential import Rules, trace_nonsequential
from clacad.effects.engine.probe_rays import cone
from clacad.effects.trace import trace
from clacad.optics.material.material import Material
from clacad.optics.rays import Fate, Rays
from clacad.optics.sequence import Interface, trace_sequence
from clacad.optics.surface import Quadric
from clacad.optics.surface.fresnel_coefficients import (
    amplitudes,
    coated,
    deviation,
    transmission,
)
from clacad.sheet.cell_places import CellPlacement
from clacad.sheet.face_order import media_of

DESIGNS = Path(__file__).parents[2] / "designs"
COLUMNS = ("position", "direction", "fate", "optical_path", "cell", "order", "surface", "flux")
FORMS = ("paper-a-covered", "slab", "plano", "tilted", "tilted-biconvex")


@cache
def window(name):
    return prescribe(load(str(DESIGNS / f"{name}.toml")))


@cache
def bundle(name, count=2048, field=0.035):
    return cone(window(name), field, count)


def same(a, b, columns=COLUMNS):
    return all(np.array_equal(getattr(a, c), getattr(b, c), equal_nan=True) for c in columns)


# -- absent and neutral ------------------------------------------------------------------------


@pytest.mark.parametrize("rung", ["law", "thin", "surfaces"])
@pytest.mark.parametrize("name", FORMS)
def test_no_effects_is_bit_for_bit_the_bare_trace(name, rung):
    assert same(trace(window(name), bundle(name), rung), trace(window(name), bundle(name), rung, effects=()))


NEUTRAL = [n for n in NAMES if n not in ("fresnel", "reflections", "polarisation", "diffraction", "facets")]


@pytest.mark.parametrize("effect", NEUTRAL)
def test_an_effect_with_nothing_to_do_changes_no_bit(effect):
    """A seamless slab has no wall and no total reflection here; the other settings are neutral by default."""
    bare = trace(window("slab"), bundle("slab"))
    assert not np.isin(bare.fate, (Fate.WALL, Fate.TIR)).any()
    assert same(bare, trace(window("slab"), bundle("slab"), effects=(effect,)))


@pytest.mark.parametrize("effect", ["fresnel", "reflections", "polarisation"])
@pytest.mark.parametrize("rung", ["law", "thin", "surfaces"])
def test_no_light_is_lost_where_the_index_does_not_change(effect, rung):
    matched = indexed(window("slab"), 1.0)
    result = trace(matched, bundle("slab"), rung, effects=(effect,))
    going = result.fate <= Fate.LAND
    assert going.any()
    assert np.allclose(result.flux[going], 1.0, atol=1e-14)


def indexed(sheet, n):
    return replace(sheet, bodies=tuple(replace(b, index=n, material=None) for b in sheet.bodies))


@pytest.mark.daily_share(3)
@pytest.mark.parametrize("effect", [n for n in NAMES if n != "facets"])
@pytest.mark.parametrize("name", ["slab", "tilted-biconvex"])
def test_labels_of_geometry_never_change(effect, name):
    setting = Setting(extinction=1e-6, roughness=5e-9, slope_rms=1e-3, analyser=0.3)
    bare = trace(window(name), bundle(name))
    with_it = trace_with(window(name), bundle(name), "surfaces", (effect,), setting=setting)
    assert same(bare, with_it, ("fate", "cell", "order", "surface"))
    for column in ("position", "direction", "flux", "optical_path"):
        assert np.isfinite(getattr(with_it, column)).all()


def test_blocks_and_wavelengths_do_not_change_what_is_computed(monkeypatch):
    sheet = window("slab")
    rays = bundle("slab")
    many = Rays(rays.position, rays.direction, np.where(np.arange(len(rays)) % 2, 600e-9, 500e-9))
    whole = trace(sheet, many, effects=("fresnel",))
    monkeypatch.setattr("clacad.effects.engine.passes.BLOCK", 100)
    parts = trace(sheet, many, effects=("fresnel",))
    assert same(whole, parts, ("position", "direction", "fate", "flux"))


def test_an_unknown_effect_is_refused_by_name():
    with pytest.raises(ValueError, match="frsnel.*known are ghosts, walls"):
        trace(window("slab"), bundle("slab"), effects=("frsnel",))


def test_effects_that_are_off_are_not_imported():
    code = """
import sys, clacad
from clacad.effects import NAMES
w = clacad.prescribe(clacad.load(sys.argv[1]))
rays = clacad.Rays([[0, 0, -1.0]], [[0, 0, 1.0]])
loaded = lambda: sorted(n for n in NAMES if f"clacad.effects.{n}" in sys.modules)
clacad.trace(w, rays)
print(loaded())
clacad.trace(w, rays, effects=("fresnel",))
print(loaded())
"""
    out = subprocess.run(
        [sys.executable, "-c", code, str(DESIGNS / "slab.toml")], capture_output=True, text=True, check=True
    ).stdout
    assert out.splitlines() == ["[]", "['fresnel']"]


def test_hits_are_kept_only_when_a_pass_or_the_caller_needs_them(monkeypatch):
    seen = []
    real = trace

    def spy(*args, **options):
        seen.append(options.get("record", False))
        return real(*args, **options)

    monkeypatch.setattr(sys.modules["clacad.tracing.trace"], "trace", spy)
    rays = bundle("slab")
    trace_with(window("slab"), rays, "surfaces", ("scatter",))
    trace_with(window("slab"), rays, "surfaces", ("fresnel",))
    assert seen == [False, True]
    assert trace_with(window("slab"), rays, "surfaces", ("fresnel",)).hits is None
    assert trace_with(window("slab"), rays, "surfaces", ("scatter",), record=True).hits is not None


# -- fresnel -----------------------------------------------------------------------------------


def textbook(angle, n1, n2):
    """Born and Wolf 1.5.2 (21a), from angles, 40 digits: R_s, R_p."""
    with mpmath.workdps(40):
        i = mpmath.mpf(angle)
        t = mpmath.asin(mpmath.mpf(n1) / n2 * mpmath.sin(i))
        if i == 0:
            r = ((mpmath.mpf(n1) - n2) / (mpmath.mpf(n1) + n2)) ** 2
            return float(r), float(r)
        r_s, r_p = -mpmath.sin(i - t) / mpmath.sin(i + t), mpmath.tan(i - t) / mpmath.tan(i + t)
        return float(r_s**2), float(r_p**2)


def through_plane(angle, n1, n2):
    """Directions before and after a plane across z."""
    plane = Interface(Quadric(0, 0, 0), (0, 0, 0), n1, n2)
    before = np.array([[math.sin(angle), 0.0, math.cos(angle)]])
    out = trace_sequence([plane], Rays([[0.0, 0.0, -1.0]], before))
    return before, out.direction


@pytest.mark.parametrize(("n1", "n2"), [(1.0, 1.5), (1.5, 1.0), (1.0, 1.0003), (1.0, 2.4), (1.33, 1.5)])
@pytest.mark.parametrize("share", [0.0, 1e-9, 1e-4, 0.1, 0.5, 0.9, 0.999])
def test_losses_from_the_deviation_are_fresnels_from_the_angles(n1, n2, share):
    limit = math.pi / 2 if n1 < n2 else math.asin(n2 / n1)
    angle = share * limit
    s, p = amplitudes(deviation(*through_plane(angle, n1, n2)), n1, n2)
    expected = textbook(angle, n1, n2)
    # near the critical and the grazing angle 1/cos magnifies the rounding of the directions
    slack = 1e-13 / math.sqrt(1.0 - share)
    assert s[0] ** 2 == pytest.approx(expected[0], abs=slack)
    assert p[0] ** 2 == pytest.approx(expected[1], abs=slack)


@pytest.mark.parametrize("n", [1.2, 1.5, 3.0])
def test_nothing_of_p_is_reflected_at_brewsters_angle(n):
    turn = deviation(*through_plane(math.atan(n), 1.0, n))
    s, p = amplitudes(turn, 1.0, n)
    assert abs(p[0]) < 1e-14
    assert s[0] ** 2 == pytest.approx(((n * n - 1) / (n * n + 1)) ** 2, rel=1e-12)


def test_everything_is_reflected_at_the_critical_angle():
    critical = math.asin(1 / 1.5)
    below = [transmission(deviation(*through_plane(critical * (1 - e), 1.5, 1.0)), 1.5, 1.0)[0] for e in
             (1e-2, 1e-4, 1e-6, 1e-8)]  # fmt: skip
    assert all(a > b for a, b in zip(below, below[1:]))
    assert below[-1] < 1e-3
    # T grows as the square root of the distance from the critical angle
    assert below[1] / below[2] == pytest.approx(10.0, rel=0.05)


def test_an_interface_passes_the_same_share_both_ways():
    before, after = through_plane(0.7, 1.0, 1.6)
    turn = deviation(before, after)
    assert transmission(turn, 1.0, 1.6)[0] == pytest.approx(transmission(turn, 1.6, 1.0)[0], rel=1e-14)


@pytest.mark.parametrize(("name", "faces"), [("paper-a-covered", 4), ("slab", 2), ("plano", 4)])
def test_light_along_the_axis_loses_r0_at_every_face(name, faces):
    sheet = window(name)
    rays = Rays([[0.0, 0.0, sheet.z_range[0] - 1e-3]], [[0.0, 0.0, 1.0]])
    whole = replace(sheet, lattice=sheet.lattice.with_count((1, 1)))
    n = sheet.bodies[0].index
    flux = trace(whole, rays, effects=("fresnel",)).flux[0]
    assert flux == pytest.approx((1 - ((n - 1) / (n + 1)) ** 2) ** faces, rel=1e-9)


def test_thin_lenses_lose_what_the_exact_ones_do_near_the_axis():
    for name in ("paper-a-covered", "slab", "plano"):
        flux = {}
        for rung in ("law", "thin", "surfaces"):
            result = trace(window(name), bundle(name), rung, effects=("fresnel",))
            flux[rung] = result.flux[result.fate == Fate.ALIVE].mean()
        assert flux["thin"] == pytest.approx(flux["surfaces"], abs=2e-3)
        assert flux["law"] == pytest.approx(flux["surfaces"], abs=2e-3)


def test_a_quarter_wave_layer_reflects_nothing_of_its_own_colour_at_normal_incidence():
    none = np.zeros(1)
    assert max(r[0] for r in coated(none, 1.0, 1.5, 1.0)) < 1e-30
    blue, red = coated(none, 1.0, 1.5, 550 / 450)[0][0], coated(none, 1.0, 1.5, 550 / 700)[0][0]
    bare = amplitudes(none, 1.0, 1.5)[0][0] ** 2
    assert 0 < red < bare
    assert 0 < blue < bare
    # at half the wavelength it is a half-wave layer: as if it were not there
    assert coated(none, 1.0, 1.5, 2.0)[0][0] == pytest.approx(bare, rel=1e-12)


def test_a_coated_sheet_loses_less_than_a_bare_one():
    bare = trace_with(window("slab"), bundle("slab"), "surfaces", ("fresnel",))
    coat = trace_with(window("slab"), bundle("slab"), "surfaces", ("fresnel",),
                      setting=Setting(coating="quarter-wave"))  # fmt: skip
    alive = bare.fate == Fate.ALIVE
    assert (coat.flux[alive] > 0.999).all()
    assert (bare.flux[alive] < 0.93).all()


# -- absorption --------------------------------------------------------------------------------


def test_light_falls_exponentially_with_the_length_inside_the_material():
    sheet, rays = window("slab"), bundle("slab")
    k, wave = 2e-6, 550e-9
    result = trace_with(sheet, rays, "surfaces", ("absorption",), record=True, setting=Setting(extinction=k))
    inside = np.linalg.norm(result.hits[1] - result.hits[0], axis=1) * sheet.unit
    alive = result.fate <= Fate.GHOST
    assert np.allclose(np.log(result.flux[alive]), -4 * math.pi * k / wave * inside[alive], rtol=1e-10)


def test_twice_the_absorption_squares_what_is_left():
    once, twice = (
        trace_with(
            window("plano"), bundle("plano"), "surfaces", ("absorption",), setting=Setting(extinction=k)
        )
        for k in (1e-6, 2e-6)
    )
    assert np.allclose(once.flux**2, twice.flux, rtol=1e-12)


def test_thin_lenses_absorb_what_the_exact_ones_do_on_average():
    for name in ("paper-a-covered", "slab", "plano"):
        wave = window(name).wavelength
        # the paper's metre-sized sheet needs less extinction for the same loss
        k = 0.1 * wave / (4 * math.pi) / (window(name).unit * 5 * max(window(name).lattice.pitch))
        means = []
        for rung in ("thin", "surfaces"):
            result = trace_with(
                window(name), bundle(name), rung, ("absorption",), setting=Setting(extinction=k)
            )
            means.append(1.0 - result.flux[result.fate == Fate.ALIVE].mean())
        assert means[0] == pytest.approx(means[1], rel=0.05)


def test_absorption_outside_the_data_is_an_error():
    known = Material("toy", "cauchy", (1.5, 0.0, -2.0), (400e-9, 700e-9), "made up",
                     extinction=((500e-9, 1e-7), (600e-9, 1e-7)), extinction_source="made up")  # fmt: skip
    sheet = window("slab")
    sheet = replace(sheet, bodies=tuple(replace(b, material=known) for b in sheet.bodies))
    rays = bundle("slab")
    trace(sheet, rays, effects=("absorption",))
    late = Rays(rays.position, rays.direction, np.full(len(rays), 650e-9))
    with pytest.raises(ValueError, match="absorption of toy is known from 500 to 600 nm only"):
        trace(sheet, late, effects=("absorption",))


# -- dispersion --------------------------------------------------------------------------------


def test_dispersion_of_a_constant_index_is_nothing():
    sheet = indexed(window("slab"), 1.5)
    bare = trace(sheet, bundle("slab"))
    lines = Setting(wavelengths=(450e-9, 650e-9))
    assert same(bare, trace_with(sheet, bundle("slab"), "surfaces", ("dispersion",), setting=lines))


def test_each_line_is_traced_with_its_own_index():
    from clacad.light.measure import measure
    from clacad.sheet.bundle import RequestedLaw, of_rays

    glass = Material("toy", "cauchy", (1.48, 0.005, -2.0), (400e-9, 700e-9), "made up")
    sheet = window("slab")
    sheet = replace(sheet, bodies=tuple(replace(b, material=glass) for b in sheet.bodies))
    rays = bundle("slab")
    lines = (450e-9, 650e-9)
    light = measure(lambda lit: trace(sheet, lit.rays), of_rays(rays), RequestedLaw(sheet.law), lines)
    for wave, line in zip(lines, light.lines, strict=True):
        expected = trace(indexed(sheet, glass.index(wave)), rays)
        assert same(line.seen, expected, ("direction", "fate", "position"))


# -- diffraction -------------------------------------------------------------------------------


def test_draws_follow_the_fraunhofer_pattern_of_a_slit():
    from clacad.effects.diffraction import sinc_squared

    x = sinc_squared((np.arange(200_000) + 0.5) / 200_000)
    edges = np.array([-3 * np.pi, -2 * np.pi, -np.pi, -1.0, 0.0, 0.5, 1.0, 2.0, np.pi, 2 * np.pi, 3 * np.pi])
    for low, high in zip(edges, edges[1:]):
        with mpmath.workdps(20):
            share = (
                mpmath.quad(lambda v: (mpmath.sin(v) / v) ** 2 if v else mpmath.mpf(1), [low, high])
                / mpmath.pi
            )
        assert np.mean((x >= low) & (x < high)) == pytest.approx(float(share), abs=1e-4)
    # far out the share beyond X is 1/(π X)
    assert np.mean(np.abs(x) > 300.0) == pytest.approx(1 / (math.pi * 300.0), rel=0.02)


def test_a_centred_beam_spreads_by_the_wavelength_over_the_lit_width():
    """Along the field's middle all of lens 1's image fits lens 2: the slit is pitch times |m| wide, 1 at most."""
    sheet = window("paper-a-covered")
    rays = cone(sheet, 1e-9, 16384)
    bare, spread = trace(sheet, rays), trace(sheet, rays, effects=("diffraction",))
    alive = bare.fate == Fate.ALIVE
    wave = sheet.wavelength / sheet.unit
    for axis, width in ((0, 0.25 * 0.005), (1, 0.005)):
        change = (spread.direction - bare.direction)[alive, axis] * math.pi * width / wave
        # half of sinc² lies within ±1.1654, and 90.28 % in the main lobe
        assert np.mean(np.abs(change) < math.pi) == pytest.approx(0.9028, abs=0.01)


@pytest.mark.parametrize("effect", ["diffraction"])
def test_diffraction_vanishes_with_the_wavelength(effect):
    sheet, rays = window("slab"), bundle("slab")
    bare = trace(sheet, rays)
    turned = []
    for wave in (550e-9, 5.5e-9, 5.5e-11):
        part = Rays(rays.position, rays.direction, np.full(len(rays), wave))
        turned.append(np.sqrt(np.mean((trace(indexed(sheet, sheet.bodies[0].index), part, effects=(effect,)).direction
                                       - bare.direction) ** 2)))  # fmt: skip
    assert turned[0] > 3 * turned[1] > 9 * turned[2]
    assert turned[2] < 1e-4


def test_draws_are_the_same_every_time_and_independent_of_one_another():
    from clacad.effects.engine.effect import normal, uniform

    rays = bundle("slab")
    a, b = uniform(rays, 2, 0, 1), uniform(rays, 2, 0, 2)
    assert np.array_equal(a, uniform(rays, 2, 0, 1))
    assert not np.array_equal(a, uniform(rays, 2, 1, 1))
    assert a.min() > 0
    assert a.max() < 1
    columns = np.column_stack([a, b, uniform(rays, 2, 5, 1)])
    correlation = np.corrcoef(columns.T) - np.eye(6)
    assert np.abs(correlation).max() < 5 / math.sqrt(len(rays))
    same_ray = Rays(np.zeros((20000, 3)), np.tile([0.0, 0.0, 1.0], (20000, 1)))
    g = normal(same_ray, 1, 0, 3)
    assert np.allclose(g.mean(axis=0), 0.0, atol=0.03)
    assert np.allclose(g.std(axis=0), 1.0, atol=0.03)


# -- scatter -----------------------------------------------------------------------------------


def test_direct_light_and_haze_sum_to_one_and_follow_the_face_count():
    from clacad.effects.scatter import haze

    for name, faces in (("slab", 2), ("plano", 4)):
        sheet = window(name)
        n, sigma, wave = sheet.bodies[0].index, 20e-9, 550e-9
        single = (2 * math.pi * (n - 1) * sigma / wave) ** 2
        lost = haze(sheet, sigma, wave)
        assert 1 - lost == pytest.approx(math.exp(-single) ** faces, rel=1e-12)
        out = trace_with(sheet, bundle(name), "surfaces", ("scatter",), setting=Setting(roughness=sigma))
        assert np.allclose(out.flux[out.fate <= Fate.LAND], 1 - lost, rtol=1e-12)
        # to first order a face scatters its total integrated scatter
        assert haze(sheet, 1e-10, wave) == pytest.approx(faces * single * (1e-10 / sigma) ** 2, rel=1e-4)


def test_slope_errors_blur_as_traced_through_tilted_surfaces():
    """Independent route: the faces of a pair are tilted one by one and the exit slopes compared."""
    sheet = window("slab")
    sigma = 1e-3
    from clacad.effects.scatter import blur
    from clacad.sheet.vignetting import focal_ratio

    rays = cone(sheet, 1e-9, 8192)
    bare = trace(sheet, rays)
    out = trace_with(sheet, rays, "surfaces", ("scatter",), setting=Setting(slope_rms=sigma))
    alive = bare.fate == Fate.ALIVE
    change = (out.direction - bare.direction)[alive]
    expected = blur(sheet, sigma)
    assert change[:, 0].std() == pytest.approx(expected[0], rel=0.05)
    assert change[:, 1].std() == pytest.approx(expected[1], rel=0.05)
    # one face of the slab tilted by σ, the other as it is: the turn of the central ray, added in quadrature
    turns = []
    for tilted in (0, 1):
        seq = []
        for face, body_face in enumerate((sheet.bodies[0].front, sheet.bodies[0].back)):
            c, s = math.cos(sigma), math.sin(sigma)
            turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) if face == tilted else None
            n = sheet.bodies[0].index
            seq.append(
                Interface(body_face.surface, body_face.vertex, *((1, n) if face == 0 else (n, 1)), turn)
            )
        central = trace_sequence(seq, Rays([[0, 0, -1e-3]], [[0, 0, 1.0]]))
        turns.append(central.direction[0, 0])
    assert focal_ratio(sheet.thin)[0] != 1
    assert math.hypot(*turns) == pytest.approx(expected[0], rel=0.02)


# -- polarisation ------------------------------------------------------------------------------


def test_malus_law_between_polariser_and_analyser():
    sheet, rays = indexed(window("slab"), 1.0), bundle("slab")
    for angle in (0.0, 0.4, math.pi / 4, 1.2, math.pi / 2):
        setting = Setting(polariser=0.3, analyser=0.3 + angle)
        out = trace_with(sheet, rays, "surfaces", ("polarisation",), setting=setting)
        assert np.allclose(out.flux[out.fate <= Fate.GHOST], 0.5 * math.cos(angle) ** 2, atol=2e-3)


def test_without_polarisers_a_single_interface_gives_fresnels_mean():
    from clacad.effects.polarisation import analysed, cross_face, passed

    before, after = through_plane(0.9, 1.0, 1.5)
    setting = Setting()
    fields = [cross_face(f, before, after, 1.0, 1.5) for f in analysed(setting, before)]
    expected = 1 - 0.5 * sum(textbook(0.9, 1.0, 1.5))
    assert passed(setting, fields, after)[0] == pytest.approx(expected, rel=1e-12)
    for field in fields:
        assert abs(float((field @ after.T)[0, 0])) < 1e-15


def test_rows_that_did_not_cross_disturb_no_others():
    """Rows that did not cross keep their directions, also such as no face could send on."""
    from clacad.effects.polarisation import cross_face

    before, after = through_plane(0.3, 1.5, 1.0)
    alone = cross_face(np.array([[0.0, 1.0, 0.0]]), before, after, 1.5, 1.0)
    anywhere = np.random.default_rng(3).normal(size=(500, 2, 3))
    anywhere /= np.linalg.norm(anywhere, axis=2)[:, :, None]
    field = np.tile([0.0, 1.0, 0.0], (501, 1))
    before, after = (np.vstack([one, anywhere[:, k]]) for k, one in enumerate((before, after)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.array_equal(cross_face(field, before, after, 1.5, 1.0)[:1], alone)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, 1.0])
def test_s_and_p_light_are_carried_by_their_own_coefficients(angle):
    from clacad.effects.polarisation import cross_face

    before, after = through_plane(angle, 1.0, 1.5)
    r_s, r_p = textbook(angle, 1.0, 1.5)
    s = np.array([[0.0, 1.0, 0.0]])
    p = np.cross(s, before)
    assert (cross_face(s, before, after, 1.0, 1.5) ** 2).sum() == pytest.approx(1 - r_s, rel=1e-12)
    assert (cross_face(p, before, after, 1.0, 1.5) ** 2).sum() == pytest.approx(1 - r_p, rel=1e-12)


def test_polarised_light_takes_the_same_share_both_ways():
    from clacad.effects.polarisation import cross_face

    rng = np.random.default_rng(7)
    before, after = through_plane(0.8, 1.0, 1.5)
    for _ in range(10):
        e = np.cross(before, rng.normal(size=3))
        f = np.cross(after, rng.normal(size=3))
        there = (cross_face(e, before, after, 1.0, 1.5) * f).sum()
        back = (cross_face(f, -after, -before, 1.5, 1.0) * e).sum()
        assert there == pytest.approx(back, rel=1e-12)


def test_unpolarised_light_through_the_sheet_agrees_with_fresnel_to_second_order():
    plain = trace(window("slab"), bundle("slab"), effects=("fresnel",))
    own = trace(window("slab"), bundle("slab"), effects=("polarisation",))
    assert np.abs(plain.flux - own.flux).max() < 1e-4


# -- depth of field ----------------------------------------------------------------------------


def test_the_sharp_plane_stays_sharp_and_the_opening_is_filled_evenly():
    from clacad.effects.depth_of_field import effect

    n = 20000
    rays = Rays(np.zeros((n, 3)), np.tile([0.1, -0.05, 1.0], (n, 1)))
    setting = Setting(aperture=0.02, focus=3.0)
    moved = effect(window("slab"), setting).launch(window("slab"), rays)
    sharp = moved.position + (3.0 - moved.position[:, 2:]) / moved.direction[:, 2:] * moved.direction
    assert np.abs(sharp - [0.3, -0.15, 3.0]).max() < 1e-14
    radius = np.hypot(*moved.position[:, :2].T)
    assert radius.max() <= 0.01
    # étendue: as many starts in the inner half of the area as in the outer
    assert np.mean(radius < 0.01 / math.sqrt(2)) == pytest.approx(0.5, abs=0.015)
    assert np.array_equal(
        effect(window("slab"), Setting()).launch(window("slab"), rays).position, rays.position
    )


# -- ghosts on the homogeneous sheet -----------------------------------------------------------


@pytest.mark.parametrize("name", ["slab", "paper-a-covered", "fig5-phi-45", "hexagonal"])
def test_homogeneous_light_is_what_thin_lenslets_pass_order_by_order(name):
    """Shares and slopes of every ghost order: closed form against counting rays through ideal lenslets."""
    sheet = window(name)
    slope = 0.6 * np.array(sheet.lattice.pitch) / sheet.thin.separation
    u = cone(sheet, 1e-12, 8192)
    rays = Rays(u.position, np.tile([slope[0], slope[1], 1.0], (len(u), 1)))
    thin = trace(sheet, rays, "thin")
    passing = thin.fate <= Fate.GHOST
    # a pair of thick lenses as built is afocal; as two thin ones it need not be, and each order is a little blurred
    afocal = np.sum(sheet.thin.focal_length, axis=0) / sheet.thin.separation
    blur = 1e-6 + np.abs(afocal - 1.0).max()
    light, _ = light_reaching_camera(sheet, Rays(rays.position[:1], rays.direction[:1]), "law", ("ghosts",))
    assert light.flux.sum() == pytest.approx(1.0, abs=2e-3)
    for order in {tuple(o) for o in thin.order[passing].tolist()}:
        rows = passing & (thin.order == order).all(axis=1)
        share = rows.mean()
        if share < 0.01:
            continue
        mean = thin.direction[rows].mean(axis=0)
        mean /= np.linalg.norm(mean)
        near = np.argmin(np.linalg.norm(light.direction - mean, axis=1))
        assert np.linalg.norm(light.direction[near] - mean) < blur
        assert light.flux[near] == pytest.approx(share, abs=6e-3 + blur)


@pytest.mark.parametrize("turn", [0.0, 0.3])
def test_what_two_zones_share_is_the_area_of_the_clipped_polygon(turn):
    """Rectangles along the axes and turned ones, near and far apart, against corner-by-corner clipping."""
    c, s = math.cos(turn), math.sin(turn)
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) @ np.array([[c, s], [-s, c]])
    moved, fixed = square * [0.3, 0.8], square * [0.5, 0.5]
    shift = np.concatenate([2.0 * sobol(200, 2) - 1.0, [[0.0, 0.0], [3.0, 0.0], [0.0, -3.0], [0.8, 0.0]]])
    area = overlap(moved, fixed, shift)
    assert np.count_nonzero(area == 0.0) > 2
    for found, one in zip(area, shift, strict=True):
        x, y = clip(moved + one, fixed).T
        expected = 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
        assert found == pytest.approx(expected, abs=1e-14)


def test_off_ghosts_are_black_on_ghosts_carry_what_they_carry():
    sheet, rays = window("slab"), bundle("slab")
    dark, result = light_reaching_camera(sheet, rays, "surfaces")
    light, _ = light_reaching_camera(sheet, rays, "surfaces", ("ghosts",))
    ghosts = np.flatnonzero(result.fate == Fate.GHOST)
    assert len(ghosts)
    assert np.array_equal(np.setdiff1d(light.parent, dark.parent), ghosts)
    assert light.flux.sum() - dark.flux.sum() == len(ghosts)


# -- light followed ----------------------------------------------------------------------------


@pytest.mark.parametrize("name", [*FORMS, "hexagonal", "galilean"])
def test_the_straight_path_followed_is_the_trace(name):
    sheet, rays = window(name), bundle(name)
    result = trace(sheet, rays)
    met = np.flatnonzero(result.fate < Fate.MISSED)
    out = trace_nonsequential(sheet, rays, met, Rules(media=media_of(sheet.bodies)))
    going = np.flatnonzero(result.fate <= Fate.LAND)
    assert np.array_equal(np.sort(out.parent), going)
    turn = np.argsort(out.parent)
    assert np.abs(out.direction[turn] - result.direction[going]).max() < 1e-12
    assert np.abs(out.position[turn] - result.position[going]).max() < 1e-10 * max(sheet.lattice.pitch)
    assert np.allclose(out.optical_path[turn], result.optical_path[going], rtol=1e-12)
    assert out.share["wall"].sum() == (result.fate == Fate.WALL).sum()


@pytest.mark.daily_cases(
    "slab-0",
    "slab-1",
    "tilted-biconvex-0",
    "tilted-biconvex-1",
    "tilted-biconvex-3",
    "tilted-seam-0",
    "tilted-seam-1",
)
@pytest.mark.parametrize("order", [0, 1, 3])
@pytest.mark.parametrize(
    "name", often([*FORMS, "tilted-seam", "hexagonal"], "slab", "tilted-biconvex", "tilted-seam")
)
def test_shares_of_all_paths_sum_to_one_without_noise(name, order):
    sheet, rays = window(name), bundle(name, 512)
    met = np.flatnonzero(trace(sheet, rays).fate < Fate.MISSED)
    rules = Rules(walls=True, total=True, losses=True, order=order,
                  media=media_of(sheet.bodies),
                  attenuation=tuple(0.01 / max(sheet.lattice.pitch) for _ in sheet.bodies))  # fmt: skip
    out = trace_nonsequential(sheet, rays, met, rules)
    total = sum(out.share.values())[met]
    assert np.abs(total - 1.0).max() < 1e-12
    assert out.share["absorbed"].sum() > 0
    assert np.isfinite(out.position).all()
    assert np.abs(np.linalg.norm(out.direction, axis=1) - 1).max() < 1e-12
    assert np.array_equal(out.direction[:, 2] < 0, out.front)


def test_reflections_of_a_plane_plate_are_the_airy_series():
    """A slab of two plane faces: shares (1−r)², r, (1−r)² r, (1−r)² r² …, in closed form."""
    sheet = window("slab")
    body = sheet.bodies[0]
    flat = replace(body, front=replace(body.front, surface=Quadric(0, 0, 0)),
                   back=replace(body.back, surface=Quadric(0, 0, 0, -1)))  # fmt: skip
    plate = replace(sheet, bodies=(flat,), placements=(CellPlacement(), CellPlacement()))
    angle = 0.3
    rays = Rays([[0.01, 0.013, -1.0]], [[math.sin(angle), 0.0, math.cos(angle)]])
    out = trace_nonsequential(
        plate, rays, np.array([0]), Rules(losses=True, order=2, media=(1.0, body.index, 1.0))
    )
    r = np.mean(textbook(angle, 1.0, body.index))
    expected = {0: (1 - r) ** 2, 1: r + (1 - r) ** 2 * r, 2: (1 - r) ** 2 * r * r}
    for bounces, share in expected.items():
        # unpolarised shares are multiplied, as the model states
        assert out.flux[out.bounces == bounces].sum() == pytest.approx(share, rel=1e-9)
    assert np.allclose(out.direction[~out.front], rays.direction, atol=1e-12)
    assert np.allclose(out.direction[out.front], rays.direction * [1, 1, -1], atol=1e-12)


@pytest.mark.parametrize(("name", "faces"), [("slab", 2), ("paper-a-covered", 4), ("plano", 4)])
def test_reflected_shares_agree_with_the_first_order_count(name, faces):
    sheet, rays = window(name), cone(window(name), math.radians(0.05), 512)
    light, result = light_reaching_camera(
        sheet, rays, "surfaces", ("ghosts", "walls", "tir_paths", "reflections")
    )
    n = sheet.bodies[0].index
    r0 = ((n - 1) / (n + 1)) ** 2
    back = light.direction[:, 2] < 0
    straight = result.flux[result.fate <= Fate.GHOST].sum()
    front = light.flux[back].sum() / len(rays)
    forward = (light.flux[~back].sum() - straight) / len(rays)
    assert front == pytest.approx(faces * r0 * (1 - r0) ** (faces - 1), rel=0.06)
    assert forward == pytest.approx(faces * (faces - 1) / 2 * r0**2 * (1 - r0) ** faces, rel=0.2)


def test_light_at_walls_goes_on_or_ends_but_never_twice():
    sheet, rays = window("tilted-biconvex"), bundle("tilted-biconvex", 8192, math.radians(6))
    bare = trace(sheet, rays)
    walls = bare.fate == Fate.WALL
    assert walls.sum() > 20
    out = trace(sheet, rays, effects=("walls",))
    assert same(bare, out, ("fate", "cell", "order"))
    assert np.array_equal(out.flux[~walls], bare.flux[~walls])
    assert set(np.unique(out.flux[walls])) <= {0.0, 1.0}
    assert (out.flux[walls] == 1.0).mean() > 0.1
    more = trace(sheet, rays, effects=("walls", "tir_paths"))
    assert more.flux[walls].sum() > out.flux[walls].sum()
    on = walls & (out.flux == 1.0)
    assert (np.abs(out.direction[on] - bare.direction[on]).max(axis=1) > 1e-6).any()


@pytest.mark.slow
def test_total_reflection_loses_no_light():
    """Steep light into a slab: what TIR held back comes out somewhere, or is counted as cut."""
    sheet = window("slab")
    rays = cone(sheet, math.radians(60), 4096)
    bare = trace(sheet, rays)
    caught = np.flatnonzero(bare.fate == Fate.TIR)
    assert len(caught) > 50
    rules = Rules(walls=True, total=True, media=media_of(sheet.bodies))
    out = trace_nonsequential(sheet, rays, caught, rules)
    total = sum(out.share.values())[caught]
    assert np.abs(total - 1.0).max() < 1e-12
    assert out.share["total"].sum() == 0.0
    flux = trace(sheet, rays, effects=("tir_paths",)).flux
    assert flux[caught].sum() <= len(caught)
    assert np.array_equal(np.delete(flux, caught), np.ones(len(rays) - len(caught)))


def test_a_plate_stands_for_a_lens_on_the_homogeneous_sheet():
    axis = np.array([0.0, 0.0, 1.0])
    ray = np.array([[0.6, 0.0, 0.8]])
    inside = inside_plate(ray, axis, 1.5)
    assert inside[0, 0] == pytest.approx(0.6 / 1.5, rel=1e-15)
    assert np.linalg.norm(inside) == pytest.approx(1.0, rel=1e-15)


# -- compiled passes ---------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", ["paper-a-covered", "tilted-biconvex", "hexagonal"])
@pytest.mark.parametrize("wave", [None, pytest.param(486e-9, marks=pytest.mark.long)])
def test_compiled_passes_say_what_the_numpy_ones_say(name, wave):
    sheet, rays = window(name), bundle(name)
    if wave is not None:
        rays = Rays(rays.position, rays.direction, np.full(len(rays), wave))
    for setting in (Setting(extinction=1e-6), Setting(extinction=1e-6, analyser=0.4, polariser=1.0),
                    Setting(polariser=0.2), Setting(coating="quarter-wave", roughness=5e-9, slope_rms=1e-4)):  # fmt: skip
        for effects in (("fresnel", "absorption"), ("polarisation",), ("reflections", "walls", "tir_paths"),
                        ("diffraction", "scatter")):  # fmt: skip
            plain, fast = (
                trace_with(sheet, rays, "surfaces", effects, setting=setting, path=path)
                for path in ("numpy", "numba")
            )
            assert same(plain, fast, ("fate", "cell", "order", "surface"))
            going = plain.fate <= Fate.WALL
            assert np.allclose(plain.flux[going], fast.flux[going], rtol=0, atol=1e-11)
            # both tracers agree to rounding, but draws depend on the rays alone
            assert np.abs(plain.direction - fast.direction).max() < 1e-10


@pytest.mark.long
def test_blocks_written_in_place_by_several_threads_are_the_blocks_traced_one_by_one(monkeypatch):
    sheet, rays = window("slab"), bundle("slab")
    monkeypatch.setattr("clacad.effects.engine.passes.BLOCK", 300)
    one, two = (
        trace_with(sheet, rays, "surfaces", ("fresnel",), record=True, path="numba", threads=n)
        for n in (1, 2)
    )
    assert same(one, two)
    assert np.array_equal(one.hits, two.hits)
    assert np.array_equal(one.directions, two.directions)


@pytest.mark.ci_cases("setting0-paper-a-covered", "setting0-hexagonal", "setting1-slab")
@pytest.mark.slow
@pytest.mark.parametrize("name", ["slab", "paper-a-covered", "plano", "hexagonal", "galilean"])
@pytest.mark.parametrize("setting", [Setting(), Setting(coating="quarter-wave", extinction=1e-7)])
def test_compiled_split_paths_carry_the_light_of_the_walked_ones(name, setting):
    """The walk knows everything; the compiled paths end at steps and edges, a few per cent of their own light."""
    sheet, rays = window(name), bundle(name, 1024, 0.01745)
    effects = ("ghosts", "reflections", "absorption")
    walked, _ = light_reaching_camera(sheet, rays, "surfaces", effects, setting, path="numpy")
    quick, result = light_reaching_camera(sheet, rays, "surfaces", effects, setting, path="numba")
    straight = result.flux[result.fate <= Fate.LAND].sum()
    front = [light.flux[light.direction[:, 2] < 0].sum() for light in (walked, quick)]
    forward = [light.flux[light.direction[:, 2] > 0].sum() - straight for light in (walked, quick)]
    assert front[1] == pytest.approx(front[0], rel=0.01)
    assert 0.85 * forward[0] <= forward[1] <= 1.001 * forward[0] + 1e-12 * straight
    assert np.abs(np.linalg.norm(quick.direction, axis=1) - 1).max() < 1e-12
    spread = [(light.flux[:, None] * light.direction[:, :2] ** 2).sum(axis=0) for light in (walked, quick)]
    assert spread[1] == pytest.approx(spread[0], rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    "lattice",
    [{"kind": "square", "count": [3, 3]}, {"kind": "square", "count": [5, 5], "outline": {"circle": 2.6}},
     {"kind": "hexagonal", "count": [5, 5], "outline": {"circle": 2.6}}],
    ids=["square", "round", "round, hexagonal"],
)  # fmt: skip
def test_compiled_split_paths_meet_the_flat_border_of_a_sheet_where_the_walked_ones_do(lattice):
    """Lenslets were met beyond the last ones, at heights of a lens where the sheet is flat."""
    design = Design.from_dict({
        "format": 1, "name": "bordered", "unit": "mm", "law": {"eta": [-0.25, -1.0]},
        "pair": {"form": "slab", "separation": 10.0, "index": 1.49},
        "lattice": {"pitch": 0.5, **lattice}, "body": {"border": 1.0},
    })  # fmt: skip
    sheet, points = prescribe(design), sobol(2048, 4)
    start = np.column_stack([1.48 * points[:, :2] - 0.74, np.full(len(points), sheet.z_range[0] - 0.01)])
    rays = Rays(start, np.column_stack([0.16 * points[:, 2:] - 0.08, np.ones(len(points))]))
    walked, quick = (
        light_reaching_camera(sheet, rays, "surfaces", ("ghosts", "reflections"), Setting(), path=path)[0]
        for path in ("numpy", "numba")
    )
    assert quick.flux.sum() == pytest.approx(walked.flux.sum(), rel=1e-3)
    strange = 0
    for row, parent in enumerate(quick.parent):
        apart = np.abs(walked.position[walked.parent == parent] - quick.position[row]).max(axis=1)
        strange += not (apart < 1e-9).any()
    # steps between hexagons, which the compiled paths do not see
    assert strange <= (0.002 * len(quick) if lattice["kind"] == "hexagonal" else 0)
