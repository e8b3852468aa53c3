"""Verdict of a set of checks: three states, and never green by accident."""

from __future__ import annotations

import json

import numpy as np
import pytest

from clacad.base.text import plain
from clacad.checks.check import Check, accepted, passed
from clacad.checks.design_kinds import RADIUS
from clacad.checks.light_kinds import ETA
from clacad.design import Design
from clacad.verification import CODES

GOOD = Check("eta", "pass", "fine")


def test_nothing_passes_nothing():
    assert not passed([])


@pytest.mark.parametrize(("state", "required", "expected"), [
    ("pass", True, True), ("warn", True, True), ("fail", True, False), ("fail", False, False),
    ("not run", True, False), ("not run", False, True),
])  # fmt: skip
def test_one_check_decides(state, required, expected):
    assert passed([GOOD, Check("delta", state, "said", required=required)]) is expected


def test_a_number_that_is_missing_is_not_run():
    assert ETA.judge(float("nan"), 0.01, "said").state == "not run"
    assert ETA.not_run("why").value is None


@pytest.mark.parametrize(("value", "relation", "state"), [
    (1.0, "<=", "pass"), (1.0 + 1e-12, "<=", "fail"), (1.0, ">=", "pass"), (1.0 - 1e-12, ">=", "fail"),
])  # fmt: skip
def test_a_limit_itself_passes_and_a_hair_beyond_fails(value, relation, state):
    assert ETA.judge(value, 1.0, "said", relation=relation).state == state


@pytest.mark.parametrize(("value", "relation", "state"), [
    (0.79, "<=", "pass"), (0.81, "<=", "warn"), (1.2, ">=", "warn"), (1.3, ">=", "pass"),
])  # fmt: skip
def test_a_value_near_its_limit_is_a_warning(value, relation, state):
    assert RADIUS.judge(value, 1.0, "said", relation=relation, near=0.8).state == state


def test_a_warning_is_accepted_by_its_code_and_with_its_reason():
    design = Design.from_dict({
        "format": 1, "name": "a", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
        "pair": {"form": "slab", "separation": 10.0, "index": 1.5}, "lattice": {"pitch": 0.5, "count": 4},
        "check": {"allow": [{"code": CODES["fresnel_number"], "reason": "a toy"}]},
    })  # fmt: skip
    warned, failed = Check("fresnel_number", "warn", "low"), Check("fresnel_number", "fail", "lower")
    first, second = accepted([warned, failed], design)
    assert "a toy" in first.sentence
    assert first.state == "warn"
    assert second.sentence == "lower"


def test_json_holds_no_nan_no_infinity_and_no_numpy():
    check = Check(
        "eta",
        "pass",
        "said",
        float("inf"),
        float("nan"),
        detail={"a": np.array([1.0, np.nan]), "b": np.float64(2)},
    )
    text = json.dumps(check.to_dict(), allow_nan=False)
    assert json.loads(text)["detail"] == {"a": [1.0, None], "b": 2.0}
    assert plain((1, np.int64(2))) == [1, 2]


def test_every_code_is_of_one_check_only():
    assert len(set(CODES.values())) == len(CODES)
