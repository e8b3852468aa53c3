"""Forecast seconds of `accuracy` are those it takes: of one machine's sheets by what another took there."""

from __future__ import annotations

from pathlib import Path

import pytest

import clacad
from clacad.base.machine_rates import Rates, processor_seconds
from clacad.verification.accuracy.accuracy_table import TASK, accuracy_seconds

DESIGNS = Path(__file__).parents[2] / "designs"
WINDOW = clacad.load(DESIGNS / "window-100mm.toml").replace(
    {"lattice.count": [9, 9], "check.process": "none"}
)
SHEETS = {
    "two bodies": clacad.load(DESIGNS / "plano.toml"),
    "turned lenses": clacad.load(DESIGNS / "fig8.toml"),
    "aimed": WINDOW.replace({"lattice.aperture": {"point": [-40, 10, -400]}}),
    "a glens": WINDOW.replace({"law.varying": {"f_image": 300}, "pair.offset": "traced"}),
    "arrays aside of each other": WINDOW.replace({"law.delta": [0.01, 0.02]}),
}
RAYS, QUADS = 2000, (4, 8, 16, 32)


def measured(design):
    """Seconds of the model, and of the table when all it loads and compiles is there."""
    clacad.accuracy(design, rays=64, quads=(4,))
    began = processor_seconds()
    clacad.accuracy(design, rays=RAYS, quads=QUADS)
    return accuracy_seconds(RAYS, clacad.prescribe(design), QUADS), processor_seconds() - began


@pytest.fixture(scope="module")
def known():
    """Rates known to a machine that has measured one uniform sheet."""
    return Rates(None, {TASK: (measured(WINDOW),)})


@pytest.mark.parametrize("name", [
    pytest.param(name, marks=pytest.mark.slow if name == "aimed" else pytest.mark.long) for name in SHEETS
])  # fmt: skip
@pytest.mark.timeout(900)
def test_the_forecast_of_accuracy_holds_for_sheets_of_other_kinds_than_those_seen(name, known):
    modelled, took = measured(SHEETS[name])
    span = known.span(TASK, modelled)
    assert span.low <= took <= span.high, f"{span}, and it took {took:.1f} s"


def test_more_of_anything_is_forecast_to_take_longer_and_cells_that_differ_longest():
    window, aimed, glens = (clacad.prescribe(one) for one in (WINDOW, SHEETS["aimed"], SHEETS["a glens"]))
    for one in (window, aimed, glens):
        assert accuracy_seconds(8000, one, (4, 8)) > accuracy_seconds(4000, one, (4, 8))
        assert accuracy_seconds(4000, one, (4, 8, 16)) > accuracy_seconds(4000, one, (4, 8))
    seconds = [accuracy_seconds(100_000, one) for one in (window, glens, aimed)]
    assert seconds == sorted(seconds)
    # facets of non-uniform sheets are walked one by one, those of uniform ones looked up: tens of seconds, not minutes
    assert 15.0 < seconds[1] < 60.0 < seconds[2] < 120.0
