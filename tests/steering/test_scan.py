"""Scans of plates that move: an independent tracer's slopes and spreads, paraxial matrices, energy of the diffraction orders."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from clacad import Scan, prescribe, steer
from clacad.base.types import silent
from clacad.cli.entry_point import main
from clacad.design import Design, load, template
from clacad.prescription.face_matrices import matrices
from clacad.report.scan_files import csv_text, page
from clacad.sheet.bundle import bundle
from clacad.sheet.moved_plates import CannotMove, moved_plates, paraxial_exit
from clacad.sheet.volume_and_extent import whole_extent
from clacad.verification.tolerance import telescopelet
from clacad.waves import exit_pupil

DATA = Path(__file__).parents[1] / "data"
GOLDEN = json.loads((DATA / "scanner.json").read_text())
MOVES = {"scanner-f5": None, "scanner-f2": {2: 0.5, 3: 1.0}}


def starter(kind: str) -> Design:
    return Design.from_dict(tomllib.loads(template(kind, kind))).with_cells((12, 12))


@pytest.mark.daily_cases("x-axis-scanner-f5")
@pytest.mark.parametrize("kind", MOVES)
@pytest.mark.parametrize(
    ("axis", "rows"), [("x", "axis"), pytest.param("xy", "diagonal", marks=pytest.mark.slow)]
)
def test_slope_spread_and_share_are_those_of_an_independent_tracer(kind, axis, rows):
    golden = GOLDEN[kind][rows]
    own = DATA / f"{kind}.toml"  # faces of the reference, where the starter has others
    design = load(own).with_cells((12, 12)) if own.exists() else starter(kind)
    found = steer(design, golden[-1]["travel"], axis, MOVES[kind], waves=False, progress=silent)
    for one, want in zip(found.positions[len(golden) - 1 :], golden, strict=True):
        assert one.travel == pytest.approx(want["travel"], abs=1e-15)
        assert one.slopes[0] == pytest.approx(want["slope"], abs=1e-4)
        assert 1e3 * one.spread == pytest.approx(want["spread_mrad"], rel=0.01)
        assert one.share == pytest.approx(want["share"], abs=0.004)


@pytest.mark.parametrize(
    ("kind", "slope", "limit"), [("scanner-f5", 0.0983, 0.54e-3), ("scanner-f2", 0.245, 1.9e-3)]
)
def test_scanners_reach_their_figures_over_the_whole_travel(kind, slope, limit):
    found = steer(starter(kind), 0.04925, "y", MOVES[kind], positions=11, waves=False, progress=silent)
    assert found.positions[-1].slopes[1] >= slope
    assert found.worst_spread <= limit
    assert found.least_share >= 0.96
    assert all(abs(width - 1.0) <= 0.05 for one in found.positions for width in one.exit_beams)
    assert found.cross_talk < 1e-5
    assert found.nonlinearity < 5e-6  # the rest of three odd terms, and a bundle that is not quite symmetric
    travel = np.array([one.travel for one in found.positions])
    fit = sum(c * travel ** (2 * k + 1) for k, c in enumerate(found.odd_terms))
    assert np.abs(fit - [one.slopes[1] for one in found.positions]).max() < 1e-5


@pytest.mark.slow
def test_positions_beyond_the_cell_are_left_out_of_the_curve_and_a_travel_of_none_is_refused(
    capsys, tmp_path
):
    """Reference: the scan of the lit positions alone."""
    design = starter("scanner-f5")
    whole, part = (
        steer(design, t, positions=n, waves=False, progress=silent) for t, n in ((0.08, 5), (0.04, 3))
    )
    assert [one.travel for one in whole.lit] == [one.travel for one in part.positions]
    assert whole.odd_terms == pytest.approx(part.odd_terms)
    assert (whole.least_share, whole.worst_spread) == (0.0, part.worst_spread)
    with pytest.raises(CannotMove, match="try 0.05 mm, half a pitch"):
        steer(design, 50.0, waves=False, progress=silent)
    (tmp_path / "s.toml").write_text(template("s", "scanner-f5"))
    assert main(["steer", str(tmp_path / "s.toml"), "--travel", "80 um"]) == 0
    told = capsys.readouterr().out
    assert "at 4 of the positions" in told
    assert "nan" not in told


def test_the_paraxial_slope_is_that_of_matrices_and_the_limit_of_traced_light():
    design = starter("scanner-f5")
    window, move = prescribe(design), np.array([1e-4, -2e-4, 0.0])
    moved = moved_plates(window, {2: move})
    second = matrices(design.pair, 2)[0]
    found = paraxial_exit(moved, np.zeros(2), np.zeros(2))[1]
    assert found == pytest.approx(-second[1, 0] * move[:2], rel=1e-12)
    assert paraxial_exit(window, np.zeros(2), np.array([0.01, -0.02]))[1] == pytest.approx(
        matrices(design.pair)[0][1, 1] * np.array([0.01, -0.02]), rel=1e-12
    )
    assert [face.vertex[2] for face in moved_plates(window, {2: np.array([0, 0, 0.01])}).faces] == (
        pytest.approx([face.vertex[2] + 0.01 * (k > 1) for k, face in enumerate(window.faces)])
    )


def test_efficiencies_of_all_orders_add_up_to_the_light_of_the_cells_own_partner():
    window = prescribe(starter("scanner-f5"))
    normal, wave = np.array([0.0, 0.0, 1.0]), 532e-9
    pupil = exit_pupil.pupil(window, normal, wave, 64)
    step = wave / window.unit / 0.1
    orders = [np.array([i, j]) * step for i in range(-8, 9) for j in range(-8, 9)]
    found = [exit_pupil.order_efficiency(pupil, window, normal, 532e-6, one) for one in orders]
    assert sum(found) == pytest.approx(pupil.alive.mean(), rel=0.01)
    here = found[len(orders) // 2]
    assert here == max(found) > 0.9
    peak = exit_pupil.order_efficiency(pupil, window, normal, 532e-6)
    assert peak == pytest.approx(here, rel=1e-3)  # at rest the light is on an order


def test_orders_of_oblique_light_through_a_wide_form_add_up_to_its_share():
    window = prescribe(starter("three-plates-10deg"))
    angle, length = np.radians(9.0), 546.1e-6
    light = np.array([np.sin(angle), 0.0, np.cos(angle)])
    pupil = exit_pupil.pupil(window, light, 546.1e-9, 96)
    toward = window.law.refract(light[None])[0]
    steps = [(i, j) for i in range(-7, 8) for j in range(-7, 8)]
    found = [
        exit_pupil.order_efficiency(pupil, window, toward, length, toward[:2] + np.array(one) * length / 0.5)
        for one in steps
    ]
    assert sum(found) == pytest.approx(pupil.alive.mean(), rel=0.02)
    peak = exit_pupil.order_efficiency(pupil, window, toward, length)
    assert max(found) <= peak * (1.0 + 1e-6)
    assert 0.7 < peak < pupil.alive.mean()


@pytest.mark.parametrize(
    ("kind", "words", "says"),
    [
        ("scanner-f5", {"move": {3: 1.0}}, "plates 1 to 2"),
        ("scanner-f5", {"axis": "w"}, "it is one of x, y, xy, z"),
        ("three-plates-10deg", {}, "plates 2 and 3 carry lenses of one array"),
        ("slab", {}, "nothing moves"),
    ],
)
def test_what_cannot_move_is_refused_with_the_reason(kind, words, says):
    with pytest.raises(CannotMove, match=says):
        steer(starter(kind), 0.01, positions=2, progress=silent, **words)


def test_travel_along_the_normal_focuses():
    found = steer(starter("scanner-f5"), 0.005, "z", positions=3, waves=False, progress=silent)
    power = [one.power for one in found.positions]
    assert power[0] < power[1] < 0.0 < power[2]
    # a lens of focal length 1/C, C of each array, moved by dz changes the power by C1 C2 dz
    first, second = (matrices(starter("scanner-f5").pair, array)[0][1, 0] for array in (1, 2))
    assert power[2] - power[0] == pytest.approx(1e3 * first * second * 0.01, rel=0.05)


def test_wobble_is_that_of_tolerances_of_tilt_and_at_the_rim_that_of_a_plate_that_rose():
    design = starter("scanner-f5").with_cells((100, 100))
    tilt = 1e-3
    found = steer(design, Scan(0.04, positions=2, tilt=tilt), rays=64, waves=False, progress=silent)
    window = moved_plates(prescribe(design), {2: np.array([-0.04, 0.0, 0.0])})
    rays = bundle(window.with_cells((1, 1)), 512, 0.0, middle=np.array([0.0, 0.0, 1.0])).rays

    def change(axis, error, place):
        ways = [telescopelet(window, e, place).send(rays).direction for e in ({}, {f"tilt.{axis}": error})]
        kept = np.isfinite(ways[0][:, 0]) & np.isfinite(ways[1][:, 0])
        means = [(way[kept, :2] / way[kept, 2:]).mean(axis=0) for way in ways]
        return np.linalg.norm(means[1] - means[0])

    middle = max(change(axis, way * tilt, np.zeros(2)) for axis in "xy" for way in (-1.0, 1.0))
    assert found.positions[0].wobble == pytest.approx(middle, rel=1e-6)
    assert found.wobble[0] == max(one.wobble for one in found.positions)
    x0, x1, y0, y1 = whole_extent(window)
    rims = {"x": (0.0, 0.5 * (y1 - y0)), "y": (0.5 * (x1 - x0), 0.0)}
    ends = [
        change(axis, way * tilt, side * np.array(place))
        for axis, place in rims.items()
        for way in (-1.0, 1.0)
        for side in (-1.0, 1.0)
    ]
    assert found.positions[0].wobble_at_rim == pytest.approx(max(ends), rel=1e-3)
    assert np.isnan(steer(design, 0.04, positions=2, rays=64, waves=False, progress=silent).wobble[0])


@pytest.mark.slow
def test_files_and_json_hold_the_numbers_of_the_scan(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("own.toml").write_text(template("own", "scanner-f5"))
    words = ["steer", "own.toml", "--travel", "±10 um", "--positions", "3", "--rays", "256", "--no-waves"]
    assert main([*words, "-o", "scan.csv", "--json", "-q"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["move"] == {"plate2": 1.0}
    assert [one["travel"] for one in told["positions"]] == pytest.approx([-0.01, 0.0, 0.01])
    first = told["positions"][0]
    assert {"travel", "slope", "spread", "share", "exit_beam_over_pitch", "orders"} <= first.keys()
    assert {"order", "share", "slope"} == first["orders"][0].keys()
    head, *lines = (tmp_path / "scan.csv").read_text().splitlines()
    row = dict(zip(head.split(","), lines[0].split(","), strict=True))
    assert float(row["slope"]) == first["slope"]
    assert row["efficiency"] == ""
    found = steer(load("own.toml"), 0.01, positions=3, rays=256, waves=False, progress=silent)
    assert csv_text(found) == (tmp_path / "scan.csv").read_text()
    text = page(load("own.toml"), found)
    assert not re.search(r"(src|href)=.(?!data:|#)", text)
    assert text == page(load("own.toml"), found)
    tilted = ["--tilt", "0.1 mrad", "--json", "-q"]
    assert main([*words[:3], "10 um", "--positions", "2", "--rays", "64", "--no-waves", *tilted]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["tilt"] == pytest.approx(1e-4)
    assert 0.0 < told["wobble"] < 1e-3
    focus = [*words[:2], "--travel", "5 um", "--axis", "z", "--positions", "2", "--rays", "64", "--no-waves"]
    assert main(focus) == 0
    shown = capsys.readouterr().out
    assert re.search(r"convergence -3\d\.\d+ to 7\.\d+ 1/m", shown)
    assert "cross-talk" not in shown
    assert main([*words, "--move", "plate=2"]) == 2
    assert main([*words[:3], "nothing"]) == 2
    assert main([*words, "-o", "scan.pdf"]) == 2
