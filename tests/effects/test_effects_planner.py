"""The plan: which effects are on and why, what the user may overrule, which rung shows the scene."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from clacad import load, prescribe
from clacad.cli import main
from clacad.effects import NAMES, Setting, declared, plan_effects
from clacad.effects.engine.probe_rays import cone, situation_of_window
from clacad.optics.rays import Rays
from clacad.scene import load_scene

DESIGNS = Path(__file__).parents[2] / "designs"
SCENES = DESIGNS / "scenes"


@cache
def situation(name="slab"):
    return situation_of_window(prescribe(load(str(DESIGNS / f"{name}.toml"))))


def states(plan):
    return {row.effect: row.state for row in plan.rows}


def test_every_effect_has_one_row_and_a_sentence():
    plan = plan_effects(situation())
    assert tuple(row.effect for row in plan.rows) == NAMES
    assert all(row.why and row.cost >= 1.0 for row in plan.rows)
    assert all(row.angle >= 0.0 and 0.0 <= row.radiance for row in plan.rows)


def test_thresholds_decide():
    strict, loose = plan_effects(situation(), (1e-9, 1e-9)), plan_effects(situation(), (1.0, 10.0))
    assert {"ghosts", "fresnel", "reflections", "diffraction"} <= set(strict.names)
    assert loose.names == ()
    assert loose.cost == 1.0
    assert set(loose.names) < set(plan_effects(situation()).names) <= set(strict.names)


def test_force_and_without_overrule_and_are_said_so():
    plan = plan_effects(situation(), force=("scatter",), without=("ghosts",))
    assert states(plan)["scatter"] == "forced"
    assert states(plan)["ghosts"] == "without"
    assert plan.row("ghosts").radiance > 0.05
    assert plan.left_out()[1] >= plan.row("ghosts").radiance
    assert "scatter" in plan.summary()


def test_modes_list_and_none():
    listed = plan_effects(situation(), mode="list", chosen=("fresnel",))
    assert listed.names == ("fresnel",)
    assert states(listed)["ghosts"] == "without"
    assert plan_effects(situation(), mode="none").names == ()


@pytest.mark.parametrize("wrong", [{"force": ("gohsts",)}, {"without": ("x",)}, {"mode": "some"}])
def test_wrong_wishes_are_refused(wrong):
    with pytest.raises(ValueError, match="no effect is called|mode is"):
        plan_effects(situation(), **wrong)


def test_unknown_absorption_is_not_bounded_and_stays_off():
    plan = plan_effects(situation())
    assert states(plan)["absorption"] == "unknown"
    assert "not bounded: absorption" in plan.summary()
    known = plan_effects(replace(situation(), setting=Setting(extinction=1e-5)))
    assert states(known)["absorption"] == "on"


def test_a_polariser_an_opening_and_several_lines_call_for_their_effects():
    setting = Setting(analyser=0.0, aperture=1.0, focus=100.0, wavelengths=(450e-9, 650e-9))
    plan = plan_effects(replace(situation(), setting=setting, near=50.0, far=1e4))
    assert {"polarisation", "depth_of_field", "dispersion"} <= set(plan.names)
    assert plan.wavelengths == setting.wavelengths


def test_more_effects_never_cost_less():
    plan = plan_effects(situation(), mode="none")
    costs = [plan.cost]
    for count in range(1, len(NAMES)):
        costs.append(plan_effects(situation(), mode="list", chosen=NAMES[:count]).cost)
    assert all(a <= b for a, b in zip(costs, costs[1:]))


def test_exact_bounds_are_measured_and_near_the_first_order_ones():
    first, exact = plan_effects(situation()), plan_effects(situation(), exact=True)
    for name in ("ghosts", "fresnel", "diffraction"):
        a, b = first.row(name), exact.row(name)
        assert b.measured
        assert b.angle <= 1.5 * a.angle
        assert b.radiance <= 1.5 * a.radiance
        assert "measured" in b.why


def test_a_design_is_planned_for_by_the_bundle_it_is_judged_with():
    design = load(str(DESIGNS / "slab.toml"))
    plan = plan_effects(design)
    assert plan.angle == design.check.law_rms
    assert plan.rung == "surfaces"


def test_a_plan_is_plain_values_for_metadata():
    plain = plan_effects(situation()).to_dict()
    assert json.loads(json.dumps(plain)) == plain
    assert len(plain["effects"]) == len(NAMES)


def test_probe_rays_cover_the_lattice_evenly():
    """As many probe rays in each half of the cells, square and hexagonal."""
    for name in ("slab", "hexagonal"):
        window = situation(name).window
        rays = cone(window, 1e-9)
        step = -rays.position[:, 2] + 0.0
        point = rays.position + step[:, None] * rays.direction
        _, x, y = window.lattice.locate(point[:, 0], point[:, 1])
        assert np.mean(x > 0) == pytest.approx(0.5, abs=0.02)
        assert np.mean(y > 0) == pytest.approx(0.5, abs=0.02)
        assert np.mean(x * x) == pytest.approx(np.mean(y * y), rel=0.05)


@pytest.mark.parametrize(
    ("scene", "rung", "names"),
    [
        ("effects-narrow", "surfaces", set()),
        ("effects-wide", "surfaces", {"ghosts", "fresnel", "dispersion", "diffraction"}),
        ("effects-unresolved", "law", {"ghosts", "diffraction"}),
    ],
)
def test_shipped_scenes_are_given_what_they_call_for(scene, rung, names):
    plan = plan_effects(load_scene(SCENES / f"{scene}.toml"))
    assert plan.rung == rung
    assert set(plan.names) == names


def test_lenslets_that_a_pixel_resolves_are_traced():
    scene = load_scene(SCENES / "effects-unresolved.toml", ("camera.pixels=[1600,1600]",))
    plan = plan_effects(scene)
    assert plan.rung != "law"
    assert "can be seen" in plan.rung_why


LISTED = [{"wavelength": "486.1 nm", "weight": 1.0}, {"wavelength": "587.6 nm", "weight": 3.0}]


@pytest.mark.parametrize("spectrum", ["rgb", "D65", "visible", "photopic", LISTED])
def test_plan_picture_and_design_have_the_lines_of_one_spectrum(spectrum):
    from clacad.effects.engine.probe_rays import design_setting, situation_of_scene
    from clacad.rendering.camera import lines

    given = json.dumps(spectrum).replace('": ', '" = ')
    scene = load_scene(SCENES / "effects-wide.toml", (f"light.spectrum={given}",))
    situation = situation_of_scene(scene)
    traced = tuple(line.wavelength for line in lines(scene.light, situation.window, True))
    assert situation.wavelengths == traced
    if spectrum not in ("rgb", "D65"):
        design = load(DESIGNS / "slab.toml")
        assert design_setting(design).wavelengths == ()
        assert design_setting(design.replace("light.spectrum", spectrum)).wavelengths == traced
        stated = design.replace("light.spectrum", spectrum).light
        assert stated.spectrum == scene.light.spectrum
        assert stated.lines == dict(zip(traced, situation.setting.weights, strict=True))


def test_rays_without_a_wavelength_take_the_lines_as_often_as_their_weights():
    lines = {450e-9: 1.0, 550e-9: 4.0, 650e-9: 2.5}
    launch = (
        declared("dispersion")
        .effect(situation().window, Setting(wavelengths=tuple(lines), weights=tuple(lines.values())))
        .launch
    )
    for count in (1, 7, 100, 1001):
        waves = launch(situation().window, Rays(np.zeros((count, 3)), np.ones((count, 3)))).wavelength
        many = np.array([(waves == wave).sum() for wave in lines])
        assert np.abs(many - count * np.array(list(lines.values())) / 7.5).max() <= 1.0
    equal = declared("dispersion").effect(situation().window, Setting(wavelengths=tuple(lines))).launch
    waves = equal(situation().window, Rays(np.zeros((6, 3)), np.ones((6, 3)))).wavelength
    assert waves.tolist() == 2 * list(lines)


def test_the_command_prints_the_plan(capsys):
    assert main(["effects", str(SCENES / "effects-narrow.toml")]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in NAMES)
    assert "predicted time" in out
    assert main(["effects", str(DESIGNS / "slab.toml"), "--json", "--force", "scatter"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert {row["effect"]: row["state"] for row in data["effects"]}["scatter"] == "forced"


def test_the_command_refuses_an_unknown_effect_with_status_2(capsys):
    assert main(["effects", str(DESIGNS / "slab.toml"), "--without", "gohsts"]) == 2
    assert "no effect is called 'gohsts'" in capsys.readouterr().err
