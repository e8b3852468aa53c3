"""Numbers as text: what rounding leaves of 0 is 0, and a printed limit is never contradicted by its rounding."""

from __future__ import annotations

import operator
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from clacad.base.text import digits, shown
from clacad.checks.check import DEFAULT, Check
from clacad.checks.design_kinds import EDGE, GRAPH, SAG
from clacad.cli.tables import checks_text
from clacad.design import load
from clacad.prescription.prescribe import prescribe
from clacad.report.content import row
from clacad.report.rows import FabricationLine
from clacad.sheet.feasibility import describe, feasibility
from clacad.verification.design_rules import design_checks
from clacad.verification.light.law_checks import confocality_check
from clacad.verification.light.through_window import Lit

ROOT = Path(__file__).parents[2]

SENSE = {"<=": operator.le, "<": operator.lt, ">=": operator.ge, ">": operator.gt}
NUMBERS = st.floats(allow_nan=False, allow_infinity=False, width=64)


@settings(max_examples=400, deadline=None)
@given(
    NUMBERS, NUMBERS, st.sampled_from(sorted(SENSE)), st.sampled_from(["", "rad", "mm"]), st.integers(-4, 4)
)
@example(0.0999999999, 0.1, ">=", "", 0)
@example(0.1, 0.1, ">=", "rad", 1)
@example(0.003, 0.003, "<=", "rad", -1)
def test_printed_numbers_stand_to_one_another_as_the_numbers_do(value, other, relation, unit, steps):
    near = value
    for _ in range(abs(steps)):
        near = __import__("math").nextafter(near, float("inf") if steps > 0 else float("-inf"))
    for limit in (other, near, value * (1.0 + 1e-7)):
        if limit in (float("inf"), float("-inf")) or abs(limit) > 1e300 or abs(value) > 1e300:
            continue
        text = shown(value, limit, relation, unit)
        said = SENSE[relation](Fraction(text.value), Fraction(text.limit))
        assert said == SENSE[relation](Fraction(value), Fraction(limit))
        assert text.unit == ("mrad" if unit == "rad" else unit)


@settings(max_examples=200, deadline=None)
@given(
    st.floats(1e-9, 1e6), st.floats(-1e-3, 1e-3), st.sampled_from(["<=", ">="]), st.sampled_from(["", "rad"])
)
def test_no_line_of_a_table_says_fail_where_its_numbers_hold(limit, off, relation, unit):
    check = GRAPH.judge(limit * (1.0 + off**3), limit, "x", relation=relation, unit=unit)
    page = row(check)
    signs = {"≤": "<=", "≥": ">="}
    sign, printed = page["limit"].split()
    assert SENSE[signs[sign]](Fraction(page["value"]), Fraction(printed)) == (check.state == "pass")
    state, _, value, sense, printed, *_ = checks_text([check]).split()
    assert SENSE[sense](Fraction(value), Fraction(printed)) == (state == "ok")


def test_a_short_number_stays_short():
    assert shown(0.00265, 0.003, "<=", "rad") == ("2.65", "3", "mrad", "")
    assert shown(0.09999999, 0.1, ">=") == ("0.09999999", "0.1", "", "")
    assert shown("3 pieces", "1 piece", "=") == ("3 pieces", "1 piece", "", "")
    assert shown(None, 0.5) == ("–", "0.5", "", "")
    assert shown(1.0, float("inf")) == ("1", "no limit", "", "")


@pytest.mark.parametrize("left", [-1.11e-16, 2.2e-16, -0.0, 0.0, 3e-17])
def test_what_rounding_leaves_of_zero_is_zero_wherever_a_design_is_shown(left):
    assert digits(left) == "0"
    assert FabricationLine("lens 1", "conic constant x, y", (left, left), "").text == "0"


def test_the_conic_constant_of_a_sphere_prints_as_zero():
    """Made as 1 − κ/c², so that the spheres of this slab have K = −1.1e-16 and 2.2e-16."""
    found = []
    for eta in (-0.3, -0.5, -0.6, -0.7, -1.3, -1.7):
        design = load("designs/slab.toml").replace({"law.eta": [eta, eta]})
        window = prescribe(design)
        facts = feasibility(window)
        found += [k for lens in facts.lenses for k in lens.conic]
        shown_ = [r.value for r in describe(window, facts) if r.name.startswith("conic")]
        assert shown_ == ["0, 0", "0, 0"]
    assert any(k != 0.0 for k in found), "no design here shows the rounding any more"


def test_a_warning_near_its_limit_says_so():
    check = SAG.judge(0.9, 1.0, "height", near=0.8)
    assert check.state == "warn"
    assert "90 % of the limit" in check.sentence
    assert Check("sag", "warn", "x", 0.9, 1.0).state == "warn"


def test_a_failure_within_its_limit_says_that_the_limit_is_not_why():
    check = Check("pose", "fail", "it fits only turned", 2.7e-5, 1.75e-3, unit="mm")
    assert "(kept; it failed for what the text says)" in checks_text([check])
    assert "(kept; it failed for what the text says)" in row(check)["limit"]
    assert "kept" not in checks_text([Check("pose", "fail", "off", 2.7e-3, 1.75e-3)])


def test_a_gap_of_nothing_is_not_told_that_nothing_would_do():
    """Where the limit is 0 a value of 0 fails: the line must not read 0 >= 0."""
    from clacad.verification.design_rules import _at_least

    built = SimpleNamespace(limit=lambda kind: (0.0, DEFAULT), design=SimpleNamespace(unit="mm"))
    check = _at_least(built, EDGE, 0.0, "least thickness")
    assert (check.state, check.relation) == ("fail", ">")
    assert "FAIL" in checks_text([check])
    assert ">= 0" not in checks_text([check])
    assert _at_least(built, EDGE, 0.1, "least thickness").state == "pass"


@pytest.mark.parametrize(
    ("value", "limit", "relation", "unit", "text"),
    [
        (2.2e-16, 0.002, "<=", "of separation", "0"), (-2.2e-16, 0.002, "<=", "", "0"), (1e-16, 3e-3, "<=", "rad", "0"),
        (3.7e-10, 5e-10, "<=", "mm", "3.7e-10"), (2.2e-16, 0.002, ">=", "", "0"), (2.2e-16, 0.0, "<=", "", "2.2e-16"),
        (2e-16, -1.0, ">", "", "0"),
    ],
)  # fmt: skip
def test_what_is_nothing_beside_its_limit_is_shown_as_0(value, limit, relation, unit, text):
    assert shown(value, limit, relation, unit).value == text


def test_no_rounding_is_told_of_a_sheet_that_is_confocal():
    design = load(ROOT / "designs" / "slab.toml")
    window = prescribe(design)
    checks = [
        *design_checks(design, window, feasibility(window)),
        *confocality_check(Lit(design, window, window, None, None)),
    ]
    told = checks_text([check for check in checks if check.id in ("residual", "confocality")])
    assert "along the axis ray the recipe leaves 0 mrad" in told
    assert "would have to move by 0 of the distance" in told
    assert "e-1" not in told


def test_an_infinite_limit_is_printed_as_no_limit_without_a_sense_or_unit():
    check = SAG.judge(0.2, float("inf"), "x", unit="mm")
    assert row(check)["limit"] == "no limit"
    assert checks_text([check]).split() == ["ok", "sag", "0.2", "no", "limit", "x"]
