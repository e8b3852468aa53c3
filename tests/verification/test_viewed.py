"""What one viewer gets of the whole sheet: a stated viewer is judged, an assumed one is warned of."""

from __future__ import annotations

import json
import re
import tomllib

import pytest

from clacad.checks.check import accepted, passed, wrong
from clacad.cli.entry_point import main
from clacad.design import Design
from clacad.prescription.prescribe import prescribe
from clacad.sheet.feasibility import feasibility
from clacad.verification.design_rules import design_checks
from clacad.verification.light.law_checks import judge_light
from clacad.verification.light.through_window import Lit
from clacad.verification.light.viewed import name_remedies, viewed_check
from clacad.verification.run import judge_window

SHEET = {
    "format": 1, "name": "window", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
    "pair": {"form": "slab", "separation": 10.0, "index": 1.49}, "lattice": {"pitch": 0.5, "count": [40, 40]},
}  # fmt: skip
"""20 mm wide; ideal lenses lose a share |slope| s/p an axis, none on the axis."""


def mean_share(distance, width=20.0, separation=10.0, pitch=0.5):
    """Mean share of the light of an eye on the axis, thin lenses of eta -1: (mean over the width of 1 - |x| s/(D p)) squared.

    The share of a cell is the overlap of two squares of one pitch, `separation` times the slope apart.
    """
    reach = 0.5 * width * separation / (distance * pitch)
    along = 1.0 - 0.5 * reach if reach <= 1.0 else 0.5 / reach
    return along**2


def viewed_of(design):
    window = prescribe(design)
    check, *_ = accepted(viewed_check(Lit(design, window, window, None, None)), design)
    return check


@pytest.mark.parametrize("distance", [250.0, 1000.0, 8000.0])
def test_a_stated_viewer_fails_below_the_limit_and_an_assumed_one_is_warned_of(distance):
    design = Design.from_dict(SHEET).replace({"check.viewer": f"{distance} mm"})
    check, share = viewed_of(design), mean_share(distance)
    assert check.value == pytest.approx(
        share, abs=0.02
    )  # a plain slab is 1 % off its thin lenses; 8192 rays: .004
    assert (check.limit, check.required) == (0.9, True)
    assert check.state == ("pass" if share > 0.9 else "fail")
    assert passed([check]) == (share > 0.9)


def test_an_assumed_viewer_is_a_warning_and_no_more():
    check = viewed_of(Design.from_dict(SHEET))  # 1 m
    assert (check.state, check.limit, check.required) == ("warn", 0.9, False)
    assert check.value == pytest.approx(mean_share(1000.0), abs=0.02)
    aimed = Design.from_dict(SHEET).replace({"lattice.aperture": {"point": [0, 0, -400]}})
    assert viewed_of(aimed).state == "pass"


@pytest.mark.parametrize(("limit", "state"), [(0.5, "pass"), (0.9, "fail")])
def test_the_limit_is_a_key_of_the_design(limit, state):
    design = Design.from_dict(SHEET).replace({"check.viewer": "1 m", "check.viewed": limit})
    check = viewed_of(design)
    assert (check.state, check.limit, str(check.limit_source)) == (state, limit, "design file")


def test_a_failed_share_cannot_be_allowed():
    design = Design.from_dict(SHEET).replace(
        {"check.viewer": "300 mm", "check.allow": [{"code": "CL313", "reason": "nobody looks"}]}
    )
    assert viewed_of(design).state == "fail"


@pytest.mark.parametrize("key", ["viewer", "object"])
def test_the_distance_of_the_viewer_takes_the_unit_of_the_design(key):
    bare, written = (Design.from_dict({**SHEET, "check": {key: value}}) for value in (400, "0.4 m"))
    assert bare == written
    assert bare.sha256 == written.sha256
    assert getattr(bare.check, key) == 400.0


def test_a_design_without_the_key_keeps_its_text():
    design = Design.from_dict({**SHEET, "check": {"viewer": "400 mm"}})
    text = design.canonical_toml()
    assert "viewed" not in text
    assert 'viewer = "400.0 mm"' in text  # as it was written before bare numbers were read: the hash stays
    assert "viewed = 0.8" in design.replace({"check.viewed": 0.8}).canonical_toml()


@pytest.mark.slow
def test_check_and_verify_fail_by_exit_status(tmp_path, capsys):
    path = tmp_path / "window.json"
    path.write_text(json.dumps({**SHEET, "check": {"viewer": 400}}), encoding="utf-8")
    assert main(["verify", str(path), "--rays", "4096", "--json"]) == 1
    rows = {c["id"]: c for c in json.loads(capsys.readouterr().out)["checks"]}
    assert (rows["viewed"]["state"], rows["viewed"]["limit"]) == ("fail", 0.9)


OFFSET = {**SHEET, "law": {"eta": [-1.0, -1.0], "delta": [0.25, 0.0]}}
DRILLED = {**SHEET, "body": {"border": 6.0, "holes": [{"diameter": 3.0, "corners": 3.0}]}}
IMAGING = {**SHEET, "law": {"eta": [-1.0, -1.0], "varying": {"f_image": 300.0}}}
NAMED = re.compile(r"(lattice\.aperture|pair\.field_lens) = (\{.*?\}|true)|a viewer at ([\d.]+) mm")


BULGING = {
    **SHEET, "pair": {"form": "biconvex", "separation": 6.0, "index": 1.5}, "lattice": {"pitch": 0.8, "count": [50, 50]},
}  # fmt: skip
"""A field lens gives the eye all of its light, and its edge loses more than a field lens may."""


def failing(design):
    window = prescribe(design)
    checks, _ = judge_window(design.replace({"check.viewed": 0.01}), window, feasibility(window), 8192)
    return {(check.id, check.subject) for check in wrong(checks)}


def remedies(design):
    """Keys and values that the check names."""
    window = prescribe(design)
    light, _ = judge_light(design, window, 8192)
    rules = design_checks(design, window, feasibility(window))
    check = next(c for c in name_remedies([*light, *rules], design, window) if c.id == "viewed")
    assert check.state == "fail"
    found = {}
    for key, value, distance in NAMED.findall(check.sentence):
        if distance:
            found["check.viewer"] = float(distance)
        else:
            found[key] = tomllib.loads(f"value = {value}")["value"]
    return found, check.sentence


@pytest.mark.ci_cases("with holes", "imaging")
@pytest.mark.daily_cases("offset")
@pytest.mark.parametrize(
    ("data", "named"),
    [
        (SHEET, {"lattice.aperture", "pair.field_lens", "check.viewer"}),
        (DRILLED, None),
        (OFFSET, None),
        (IMAGING, None),
        (BULGING, set()),
    ],
    ids=["plain", "with holes", "offset", "imaging", "bulging"],
)
def test_what_the_check_names_is_built_reaches_the_limit_and_makes_no_other_check_fail(data, named):
    design = Design.from_dict(data).replace({"check.viewer": 400})
    found, sentence = remedies(design)
    assert named is None or set(found) == named, sentence
    for key, value in found.items():
        changed = design.replace({key: value})
        assert viewed_of(changed).state == "pass", (key, value)
        assert failing(changed) <= failing(design), (key, value)
    if not found:
        assert "neither aimed cells nor a field lens" in sentence


def test_where_no_change_reaches_the_limit_the_check_says_so():
    """Tilted lenses: light along the sheet's normal misses the partner however far the eye is, and the eye is near."""
    design = Design.from_dict({**SHEET, "check": {"viewer": 90}}).replace({"law.euler": [0, 5, 0]})
    found, sentence = remedies(design)
    assert not found, sentence
    assert "neither aimed cells nor a field lens nor a viewer farther away mends it alone" in sentence


@pytest.mark.slow
@pytest.mark.parametrize("command", ["check", "verify"])
def test_the_share_is_on_the_second_line(command, tmp_path, capsys):
    path = tmp_path / "window.json"
    path.write_text(json.dumps({**SHEET, "check": {"viewer": 400}}), encoding="utf-8")
    rays = ["--rays", "4096"] if command == "verify" else []
    assert main([command, str(path), "--all", *rays]) == 1
    first, second, *_ = capsys.readouterr().out.splitlines()
    assert first == "window"
    share = re.fullmatch(
        r"  ([\d.]+) % of the light of the eye of check\.viewer at \(0, 0, -400\) mm obeys the law over the whole sheet "
        r"\(limit 90 %: FAILS\)", second,
    )  # fmt: skip
    assert float(share[1]) == pytest.approx(100.0 * mean_share(400.0), abs=2.0)
