"""Design rules of each process, compared with numbers computed by hand."""

from __future__ import annotations

from math import asin, atan, cos, degrees, pi, radians, sin, sqrt, tan

import numpy as np
import pytest

from clacad.checks.check import accepted
from clacad.design import Design
from clacad.design.process_profiles import profile, profiles
from clacad.prescription.prescribe import prescribe
from clacad.sheet.feasibility import feasibility
from clacad.sheet.feasibility.convex_extremes import groove, wall
from clacad.verification import CODES, design_checks

RULES = ("tool", "wall", "draft", "slope", "voxel", "layer", "aspect", "undercut")
PROCESSES = [p.name for p in profiles() if p.name != "none"]
# A slab of spherical lenses by hand: n = 1.5, s = 10, eta = -1: f = 5, R = (n − 1) f = 2.5 on both faces; p = 1.
SLAB = {
    "format": 1, "name": "slab", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
    "pair": {"form": "slab", "separation": 10.0, "index": 1.5}, "lattice": {"pitch": 1.0, "count": 4},
}  # fmt: skip
R, P = 2.5, 1.0
CORNER = P / sqrt(2.0)
SAG = R - sqrt(R * R - CORNER**2)
STEEPEST = asin(CORNER / R)


def design(process="diamond-turning", body=None, lattice=None, pair=None, law=None, **check):
    return Design.from_dict(SLAB | {
        "law": SLAB["law"] | (law or {}), "pair": SLAB["pair"] | (pair or {}),
        "lattice": SLAB["lattice"] | (lattice or {}), "body": body or {}, "check": {"process": process} | check,
    })  # fmt: skip


def judged(made):
    window = prescribe(made)
    return {c.id: c for c in design_checks(made, window, feasibility(window))}


def test_a_spherical_array_is_rounded_over_r_over_its_radius():
    """At the end of a border, y = p/2, the slope across it is tan β = (p/2)/√(R² − p²/4 − p²/4): 2 r sin β / p."""
    made = design(tool="0.1 mm")
    beta = atan(0.5 / sqrt(R * R - 0.5))
    assert judged(made)["tool"].value == pytest.approx(2.0 * 0.1 * sin(beta) / P, rel=1e-9)
    assert 2.0 * 0.1 * sin(beta) / P == pytest.approx(0.1 / sqrt(R * R - 0.25))


def test_a_seam_takes_part_of_the_rounding():
    made = design(tool="0.1 mm", lattice={"seam": 0.2})
    window = prescribe(made)
    beta = asin(0.4 / R)  # the lens ends 0.4 from its axis
    want = 2.0 * 0.1 * tan(beta / 2.0) * cos(beta) / P
    # the border's ends are farther out and steeper
    steep = atan(0.4 / sqrt(R * R - 0.4**2 - 0.4**2))
    most = 2.0 * 0.1 * tan(steep / 2.0) * cos(steep) / P
    assert want < groove(window, 0.1).value <= most * (1.0 + 1e-9)


def test_a_hollow_smaller_than_the_tool_cannot_be_cut_at_all():
    made = design(law={"eta": [0.5, 0.5]}, tool="3 mm")
    window = prescribe(made)  # Galilean: f2 = −10, R2 = −5; f1 = 20, R1 = 10
    assert groove(window, 3.0).value < 1.0
    assert groove(window, 5.5).value == 1.0


def test_walls_of_a_tilted_array_are_the_steps_between_neighbours():
    theta = 1.0
    made = design(law={"euler": [0.0, theta, 0.0]})
    window = prescribe(made)
    # a sphere tilted about its apex is that sphere moved aside by R sin θ; neighbours meet it at y = ± p/2
    aside = R * sin(radians(theta))
    step = sqrt(R * R - 0.25 - (0.5 - aside) ** 2) - sqrt(R * R - 0.25 - (0.5 + aside) ** 2)
    found = judged(made)
    assert wall(window, feasibility(window)).value == pytest.approx(step, rel=1e-9)
    assert step == pytest.approx(P * tan(radians(theta)), rel=0.05)
    assert found["wall"].state == "warn"
    assert found["wall"].limit == pytest.approx(1e-3)
    assert found["draft"].value == 0.0
    assert found["draft"].state == "warn"
    assert "mm high" in found["wall"].sentence


def test_the_edge_of_a_seam_is_a_wall_as_deep_as_lens_and_land_are_apart():
    made = design(lattice={"seam": 0.2, "seam_depth": 0.05})
    # the land lies 0.05 below the deepest optical point, the corner (0.4, 0.4); the border's middle is highest
    deepest = R - sqrt(R * R - 2 * 0.4**2)
    highest = R - sqrt(R * R - 0.4**2)
    assert judged(made)["wall"].value == pytest.approx(0.05 + deepest - highest, rel=1e-6)
    assert judged(design(lattice={"seam": 0.2, "seam_depth": 0.4}))["aspect"].value == pytest.approx(
        (0.4 + deepest - highest) / 0.2, rel=1e-6
    )


def test_slope_and_draft_are_those_of_the_corner_of_a_cell():
    found = judged(design())
    assert found["slope"].value == pytest.approx(STEEPEST, rel=1e-9)
    assert found["draft"].value == pytest.approx(pi / 2 - STEEPEST, rel=1e-9)
    assert found["undercut"].value == pytest.approx(cos(STEEPEST), rel=1e-9)
    assert found["slope"].state == found["draft"].state == found["undercut"].state == "pass"


def test_voxel_and_layer_by_hand():
    found = judged(design("sla"))
    assert found["voxel"].value == pytest.approx(P / 20)
    assert found["voxel"].limit == pytest.approx(0.05)
    assert found["voxel"].state == "pass"  # 20 voxels across, exactly enough
    assert found["layer"].value == pytest.approx(SAG / 20, rel=1e-9)
    assert found["layer"].state == "warn"  # four layers of 25 um in 0.1 mm
    assert "4.08 layers" in found["layer"].sentence
    assert judged(design("sla", lattice={"seam": 0.06}))["voxel"].value == pytest.approx(0.03)
    walls = design(
        "sla", pair={"form": "biconvex", "thickness": "auto"}, body={"baffle": True, "baffle_wall": 0.08}
    )
    assert judged(walls)["voxel"].value == pytest.approx(0.04)


def test_aspect_of_a_lens_and_of_a_baffle():
    assert judged(design())["aspect"].value == pytest.approx(SAG / P, rel=1e-9)
    walls = design(
        "sla", pair={"form": "biconvex", "thickness": "auto"}, body={"baffle": True, "baffle_wall": 0.08}
    )
    facts = feasibility(prescribe(walls))
    found = judged(walls)["aspect"]
    assert found.value == pytest.approx(facts.clearance / 0.08)
    assert found.state == "warn"
    assert "baffle" in found.sentence


EXPECTED = {
    "diamond-turning": {"tool", "wall", "draft", "slope", "aspect", "undercut"},
    "two-photon": {"voxel", "layer", "aspect"},
    "greyscale": {"wall", "draft", "slope", "voxel", "layer", "aspect", "undercut"},
    "moulding": {"tool", "wall", "draft", "slope", "aspect", "undercut"},
    "sla": {"voxel", "layer", "aspect"},
}


@pytest.mark.parametrize("process", PROCESSES)
def test_a_process_has_its_own_rules_with_its_own_numbers_and_says_where_they_come_from(process):
    found = judged(design(process))
    assert set(RULES) & set(found) == EXPECTED[process]
    rules = profile(process)
    for name in EXPECTED[process] - {"tool", "undercut"}:
        scale = 1.0 if name in ("draft", "slope", "aspect") else 1e3
        assert found[name].limit == pytest.approx(getattr(rules, name) * scale)
        assert rules.source in found[name].source
    if "tool" in found:
        assert found["tool"].value == pytest.approx(rules.tool * 1e3 / sqrt(R * R - P * P / 4.0), rel=1e-9)


@pytest.mark.parametrize(("process", "rule", "change"), [
    ("diamond-turning", "tool", {"tool": "0.3 mm"}), ("diamond-turning", "slope", {"slope": "16 deg"}),
    ("diamond-turning", "draft", {"draft": "74 deg"}), ("diamond-turning", "aspect", {"aspect": 0.1}),
    ("moulding", "slope", {"slope": "16 deg"}), ("moulding", "tool", {"tool": "0.3 mm"}),
    ("greyscale", "layer", {"layer": "6 um"}), ("greyscale", "voxel", {"voxel": "51 um"}),
    ("two-photon", "layer", {"layer": "6 um"}), ("two-photon", "aspect", {"aspect": 0.1}),
    ("sla", "voxel", {"voxel": "51 um"}), ("none", "slope", {"slope": "16 deg"}),
])  # fmt: skip
def test_a_limit_of_the_design_itself_goes_before_the_profiles(process, rule, change):
    assert degrees(STEEPEST) == pytest.approx(16.43, abs=0.01)
    found = judged(design(process, **change))[rule]
    assert found.state == "warn"
    assert found.code == CODES[rule]
    assert "design" in found.source


def test_geometry_only_has_no_process_rules():
    assert not set(RULES) & set(judged(design("none")))


def test_an_allowed_warning_says_so_with_its_reason_once():
    made = design("sla", allow=[{"code": CODES["layer"], "reason": "a demonstrator to look at"}])
    window = prescribe(made)
    checks = design_checks(made, window, feasibility(window))
    twice = accepted(checks, made)
    found = next(c for c in twice if c.id == "layer")
    assert found.state == "warn"
    assert found.detail["accepted"] == "a demonstrator to look at"
    assert found.sentence.count("a demonstrator to look at") == 1
    assert not [c for c in twice if c.id == "allowance"]


@pytest.mark.parametrize(("code", "words"), [
    (CODES["slope"], "can go"), ("CL999", "no check"),
])  # fmt: skip
def test_an_allowance_that_does_nothing_is_a_notice(code, words):
    made = design("diamond-turning", allow=[{"code": code, "reason": "just in case"}])
    notices = [c for c in design_checks(made, *_built(made)) if c.id == "allowance"]
    assert len(notices) == 1
    assert words in notices[0].sentence
    assert notices[0].state == "warn"
    assert not notices[0].required


def test_a_failure_cannot_be_allowed():
    made = design("none", cover=1.0, edge="100 mm", allow=[{"code": CODES["edge"], "reason": "no"}])
    notices = [c for c in design_checks(made, *_built(made)) if c.id == "allowance"]
    assert "only warnings" in notices[0].sentence


def _built(made):
    window = prescribe(made)
    return window, feasibility(window)


def test_an_allowance_of_a_check_that_was_not_looked_at_is_left_alone():
    made = design("none", allow=[{"code": CODES["closed"], "reason": "a scan"}])
    assert not [c for c in design_checks(made, *_built(made)) if c.id == "allowance"]
    assert np.isfinite(SAG)
