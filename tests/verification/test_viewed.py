"""What one viewer gets of the whole sheet: a stated viewer is judged, an assumed one is warned of."""

from __future__ import annotations

import json

import pytest

from clacad.advice import judge
from clacad.cli.entry_point import main
from clacad.design import Design
from clacad.verification import verify

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
    return next(check for check in judge(design).checks if check.id == "viewed")


@pytest.mark.parametrize("distance", [250.0, 1000.0, 8000.0])
def test_a_stated_viewer_fails_below_the_limit_and_an_assumed_one_is_warned_of(distance):
    design = Design.from_dict(SHEET).replace({"check.viewer": f"{distance} mm"})
    check, share = viewed_of(design), mean_share(distance)
    assert check.value == pytest.approx(
        share, abs=0.02
    )  # a plain slab is 1 % off its thin lenses; 8192 rays: .004
    assert (check.limit, check.required) == (0.9, True)
    assert check.state == ("pass" if share > 0.9 else "fail")
    assert verify(design, rays=4096).passed == (share > 0.9)


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


def test_check_and_verify_fail_by_exit_status(tmp_path, capsys):
    path = tmp_path / "window.json"
    path.write_text(json.dumps({**SHEET, "check": {"viewer": 400}}), encoding="utf-8")
    assert main(["verify", str(path), "--rays", "4096", "--json"]) == 1
    rows = {c["id"]: c for c in json.loads(capsys.readouterr().out)["checks"]}
    assert (rows["viewed"]["state"], rows["viewed"]["limit"]) == ("fail", 0.9)
