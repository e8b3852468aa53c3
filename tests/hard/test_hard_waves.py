"""Waves at the sampling limit: what is computed steps by a quarter turn at most, what is not is refused with the grid needed."""

from __future__ import annotations

from math import radians, sqrt, tan
from pathlib import Path

import numpy as np
import pytest
from hard.waves import WAVES

import clacad
from clacad.cli import main
from clacad.storage.errors import LimitRefused
from clacad.waves.lens_planes import ROOM, grid_for, telescope
from clacad.waves.through_sheet import outlook, situation

DESIGNS = Path(__file__).parents[2] / "designs"
QUARTER = 0.5 * np.pi
ROUNDING = 1.34
"""Three binary digits, and a point more across a cell, by which the grid may be larger than what is needed."""


def grid_of(case, wavelength):
    """What the case needs."""
    zero = (0.0,) * len(case.eta)
    planes = telescope(case.focal, zero, zero, case.separation, case.zone, field_lens=case.field_lens)
    return grid_for(planes, case.slope, wavelength)


def by_hand(case, wavelength):
    """Points a side: the wave of every lens about the chief ray, drawn in steps of a quarter turn; no code in common."""
    f1, f2 = (np.array(one) for one in case.focal)
    corner, s = np.abs(case.zone).max(axis=0), case.separation
    chief = s * np.array(case.slope)
    size = np.ptp(case.zone, axis=0).max()
    steep = [corner / np.abs(f1), (corner + np.abs(chief)) / np.abs(f2)]
    reach = [corner, corner + np.abs(chief), corner * np.abs(1.0 - s / f1)]
    if case.field_lens:
        steep.append((corner + np.abs(f1 * case.slope)) * (1.0 / f1 + 1.0 / f2))
    # phase π x²/(λ f): 2π x/(λ f) a length
    step = min(QUARTER * wavelength / (2.0 * np.pi * np.max(one)) for one in steep if np.max(one) > 0.0)
    return max(size / step, (256, 128)[len(case.eta) - 1]) * ROOM[len(case.eta) - 1] * np.max(reach) / size


@pytest.mark.parametrize("case", WAVES, ids=lambda case: case.name)
def test_the_last_grid_suffices_and_the_next_is_refused_with_what_it_needs(case):
    most = 4096 if len(case.eta) == 2 else 4096**2
    low, high = 1e-9, 1.0  # wavelengths refused and computed, mm
    while high / low > 1.0 + 1e-9:
        middle = sqrt(low * high)
        try:
            grid_of(case, middle)
            high = middle
        except LimitRefused:
            low = middle
    points = grid_of(case, high).points
    assert 0.7 * most < points <= most
    assert by_hand(case, high) <= points * (1.0 + 1e-9)
    assert points <= ROUNDING * by_hand(case, high)
    with pytest.raises(LimitRefused, match="phase steps of a quarter turn") as refused:
        grid_of(case, low)
    words = str(refused.value)
    needed = int(words.partition("grid of ")[2].split()[0])
    assert most < needed <= ROUNDING * by_hand(case, low)
    assert f"{most} x {most} are" in words if len(case.eta) == 2 else f"{most} are" in words


TURNED = ("law.eta=[0.5,0.5]", "law.euler=[45,0,0]", "lattice.pitch=2")


@pytest.mark.parametrize(("name", "words", "says"), [
    ("window-100mm", [word for key in TURNED for word in ("--set", key)], "20480 x 20480 points"),
    ("paper-a-covered", ["--wavelength", "10 nm"], "16384 x 16384 rays"),
])  # fmt: skip
def test_a_design_beyond_the_limit_is_told_which_grid_it_needs_before_any_work(
    tmp_path, capsys, name, words, says
):
    for more in (["--dry-run"], ["-o", str(tmp_path / "x.png")], ["--json"]):
        assert main(["wave", str(DESIGNS / f"{name}.toml"), *words, *more]) == 3
        told = capsys.readouterr()
        assert f" {says} (phase steps of a quarter turn), and " in told.err
        assert told.out == ""
    assert list(tmp_path.iterdir()) == []


def test_light_that_passes_over_many_cells_inside_a_thick_leaning_slab_is_forecast_or_refused() -> None:
    """A slab of 90 m leans by 1°: light along its lenses passes over some 900 cells of 5 mm; of 1 km over 10 000."""
    design = clacad.load(DESIGNS / "tilted.toml", ["lattice.pitch=5mm", "pair.separation=9e4mm"])
    found = outlook(situation(design, (0.0, 0.0), None))
    over = clacad.prescribe(design).z_range[1] * tan(radians(1.0)) / 5.0
    steps = found["rays"] ** 2 * over
    assert 5e-8 * steps < found["seconds"] < 1.0 + 2e-7 * steps
    with pytest.raises(LimitRefused, match="passes over 1.06e\\+04 cells inside the sheet"):
        clacad.wave(design.replace({"pair.separation": 1e6}))
