"""What a notebook shows of designs, windows and reports."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import clacad

DESIGNS = Path(__file__).parents[2] / "designs"


@pytest.mark.slow
def test_a_picture_shows_the_law_and_what_was_traced():
    design = clacad.load(DESIGNS / "window-100mm.toml")
    window = clacad.prescribe(design)
    left, right = clacad.plot(window).axes
    law, traced = right.lines[0], right.lines[1]
    assert law.get_ydata() == pytest.approx(-law.get_xdata(), abs=1e-12)  # eta = -1
    seen = np.isfinite(traced.get_ydata())
    assert np.abs(traced.get_ydata() + traced.get_xdata())[seen].max() < 1e-3
    low, high = window.z_range
    drawn = np.concatenate([line.get_xdata() for line in left.lines])
    assert drawn.min() < low
    assert drawn.max() > high  # rays from before the sheet to behind it
    twin = design.plot().axes[1].lines[1]
    assert np.array_equal(twin.get_ydata(), traced.get_ydata(), equal_nan=True)


@pytest.mark.daily_cases("window-100mm")
@pytest.mark.parametrize("name", ["window-100mm", "tilted-biconvex"])
def test_html_is_well_formed_escapes_names_and_is_the_same_every_time(name):
    design = replace(clacad.load(DESIGNS / f"{name}.toml"), name="<b>&")
    html = design._repr_html_()
    ElementTree.fromstring(html)
    assert "<b>" not in html
    assert "&lt;b&gt;&amp;" in html
    assert html == clacad.as_html(design)


def test_a_design_that_cannot_be_built_says_why_instead():
    design = clacad.load(DESIGNS / "window-100mm.toml").replace("pair.separation", 1)
    assert "less than half the diagonal of its cell" in design._repr_html_()
    with pytest.raises(clacad.DesignError):
        design.plot()


@pytest.mark.slow
def test_a_report_shows_the_curves_that_it_holds():
    report = clacad.verify(clacad.load(DESIGNS / "window-100mm.toml"), rays=1024)
    (_, right) = report.plot().axes
    assert np.array_equal(right.lines[3].get_ydata(), report.curves[1].mean, equal_nan=True)
    ElementTree.fromstring(report._repr_html_())


def test_other_things_are_not_drawn():
    with pytest.raises(TypeError, match="neither a Design"):
        clacad.plot(3)
