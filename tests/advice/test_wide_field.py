"""Wishes for wide fields: the Petzval number from thin lenses, forms that are hopeless, scaled and searched starters."""

from __future__ import annotations

import re
from math import radians, tan

import pytest

from clacad import design_for, prescribe
from clacad.advice import wide_field
from clacad.advice.proposal import NoSuchSheet
from clacad.advice.wide_field import FORMS, is_wide, petzval_error, petzval_number, scaled_keys
from clacad.advice.wish import read_wish
from clacad.base.types import silent
from clacad.design import Design, load

WORDS = {"eta": -1, "width": 6, "pitch": 0.5, "process": "none", "field": "10 deg"}


def test_the_petzval_number_of_a_slab_and_of_its_field_lens_is_that_of_their_powers():
    """Every face adds its power over both indices: two faces of power 1/f each, and those of the field lens."""
    design = load("slab", ["lattice.count = [3, 3]"])
    window = prescribe(design)
    n = window.bodies[0].index
    radii = [1.0 / face.surface.curvature_x for face in window.faces]
    assert petzval_number(window) == pytest.approx(sum((n - 1.0) / n / abs(r) for r in radii), rel=1e-12)
    other = prescribe(design.replace({"pair.field_lens": True}))
    assert petzval_number(other) > 1.4 * petzval_number(window)


def test_the_error_by_the_petzval_number_keeps_when_all_lengths_grow():
    found = []
    for pitch in (0.5, 1.0):
        wish = read_wish(WORDS | {"pitch": pitch, "error": "1 mrad"})
        window = prescribe(Design.from_dict(scaled_keys(wish, "three-plates-10deg", "scaled")))
        found.append((petzval_error(window, wish.field), petzval_number(window) * pitch))
    assert found[0] == pytest.approx(found[1], rel=1e-9)
    assert found[0][0] == pytest.approx(0.059 * found[0][1] * tan(radians(10.0)) ** 2, rel=1e-9)


@pytest.mark.slow
def test_the_form_with_fewest_plates_that_is_not_hopeless_is_chosen_and_the_others_are_named():
    easy = design_for(WORDS | {"error": "2 mrad"}, progress=silent)
    assert len(prescribe(easy.design).bodies) == 2
    fine = design_for(WORDS | {"error": "1 mrad"}, progress=silent)
    assert len(prescribe(fine.design).bodies) == 3
    assert any("two-plates" in one and "hopeless" in one for one in fine.forms)
    assert fine.judged.passes
    rms = next(check.value for check in fine.judged.checks if check.id == "law_rms")
    assert rms < 0.64e-3
    assert Design.from_dict(fine.design.given) == fine.design
    assert "hopeless" in fine.text
    with pytest.raises(NoSuchSheet, match="hopeless") as refusal:
        design_for(WORDS | {"error": "0.2 mrad"}, progress=silent)
    assert all(form in str(refusal.value) for form in FORMS)


@pytest.mark.slow
def test_the_error_that_a_refusal_calls_possible_is_possible(monkeypatch):
    monkeypatch.setattr(wide_field, "FREE", ())  # starters as they are
    wish = WORDS | {"field": "15 deg", "error": "3 mrad"}
    with pytest.raises(NoSuchSheet) as refusal:
        design_for(wish, progress=silent)
    (named,) = re.findall(r"error < (\S+ mrad) comes true: three-plates-15deg", str(refusal.value))
    assert design_for(wish | {"error": named}, progress=silent).judged.passes


@pytest.mark.slow
def test_a_scaled_starter_that_misses_the_wish_is_searched(monkeypatch):
    monkeypatch.setattr(wide_field, "FREE", wide_field.FREE[:1])
    found = design_for(WORDS | {"eta": -0.9, "error": "1.9 mrad"}, progress=silent)
    text = " ".join(found.forms)
    assert "scaled to the wish" in text
    assert "searched" in text
    assert found.judged.passes
    assert found.design.law_spec.eta == (-0.9, -0.9)


def test_only_wishes_for_wide_fields_take_this_way():
    assert is_wide(read_wish(WORDS))
    for words in (
        {"field": "2 deg"},
        {"eta": 0.5},
        {"form": "slab"},
        {"delta": [0.01, 0]},
        {"white": "1 mrad"},
    ):
        assert not is_wide(read_wish(WORDS | words))
