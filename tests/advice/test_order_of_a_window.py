"""The window that a shop orders: round, in a flange with holes, moulded, for an eye at 400 mm."""

from __future__ import annotations

from math import pi

import pytest

import clacad
from clacad.advice.candidate import Variant, built
from clacad.advice.judged import judge
from clacad.advice.lens_shape import LensShapes, Work
from clacad.advice.wish import read_wish
from clacad.sheet.volume_and_extent import body_volume

WISH = read_wish(
    {"eta": -1, "circle": "100 mm", "flange": "6 mm", "holes": 4, "viewing": "400 mm", "process": "moulding"}
)
LENSES = Variant("plano", "outside", -0.869, eye="field lens")


@pytest.mark.slow
def test_a_moulded_window_with_field_lenses_in_a_plate_with_holes_serves_its_eye():
    judged = judge(built(WISH, LENSES, 0.47, 8.1, "window"))
    assert judged.passes
    assert not judged.warning
    share = next(check.value for check in judged.checks if check.id == "viewed")
    assert share >= 0.95


def test_the_search_tries_field_lenses_with_half_the_conic_that_oblique_light_needs_without_them():
    tried = [one for one, _ in LensShapes(WISH, 0.47, (), [], Work(1000)).variants()]
    alone = {one.conic for one in tried if (one.form, one.curved, one.eye) == ("plano", "outside", "")}
    served = {
        one.conic for one in tried if (one.form, one.curved, one.eye) == ("plano", "outside", "field lens")
    }
    assert LENSES in tried
    assert served == {None if conic is None else round(0.5 * conic, 3) for conic in alone}


def test_holes_are_cut_through_the_field_lenses_as_through_the_plates():
    design = built(
        read_wish({"eta": -1, "circle": 8, "flange": 6, "holes": 4, "viewing": 400}), LENSES, 0.47, 8.1, "w"
    )
    plain = design.replace({"body.holes": []})
    windows = [clacad.prescribe(plain), clacad.prescribe(design)]
    for whole, cut in zip(*(one.bodies for one in windows), strict=True):
        low, top = (face.vertex[2] if face.land is None else face.land for face in (cut.front, cut.back))
        high = top - low
        apart = body_volume(windows[0], whole).value - body_volume(windows[1], cut).value
        assert apart == pytest.approx(4 * pi * 1.5**2 * high, rel=1e-9), cut.name
