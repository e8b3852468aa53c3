"""Uniform sheets in coherent light, the report on it, and on the light that diffraction takes."""

from __future__ import annotations

from math import sqrt
from pathlib import Path

import numpy as np
import pytest

import clacad
from clacad.sheet.feasibility import feasibility
from clacad.sheet.vignetting import order_steps
from clacad.verification import design_checks, verify

DESIGNS = Path(__file__).parents[2] / "designs"


@pytest.mark.parametrize(("name", "step"), [("window-100mm", 1.0), ("hexagonal", 2.0 / sqrt(3.0))])
def test_orders_are_where_all_cells_are_in_phase(name, step):
    """Summed cell by cell: a row of brightest directions at whole multiples of the step, none between."""
    lattice = clacad.prescribe(clacad.load(DESIGNS / f"{name}.toml")).lattice.with_count((24, 24))
    wavelength, pitch = 0.55e-3, lattice.pitch[0]
    steps = order_steps(lattice, wavelength)
    assert steps == pytest.approx([step * wavelength / pitch] * 2)
    places = lattice.centres(lattice.cells())
    vectors = np.array([lattice.offset(1, 0), lattice.offset(0, 1)])
    along = np.linalg.inv(vectors)[:, 0]  # of the reciprocal lattice
    asked = np.linspace(-1.5, 1.5, 601)
    turns = np.outer(asked * steps[0] / wavelength, places @ (along / np.linalg.norm(along)))
    light = np.abs(np.exp(2j * np.pi * turns).mean(axis=1)) ** 2
    assert asked[light > 0.99] == pytest.approx([-1.0, 0.0, 1.0], abs=0.003)
    assert light[np.abs(np.abs(asked) - 0.5) < 0.2].max() < 0.02


def test_only_a_design_in_coherent_light_is_told_how_near_the_law_orders_come():
    design = clacad.load(DESIGNS / "window-100mm.toml")
    coherent = design.replace("light.coherent", True)
    window = clacad.prescribe(design)
    facts = feasibility(window)
    assert not [c for c in design_checks(design, window, facts) if c.id == "orders"]
    (said,) = (c for c in design_checks(coherent, window, facts) if c.id == "orders")
    assert (said.code, said.state, said.value) == ("CL320", "pass", pytest.approx(0.55e-3))
    strict = coherent.replace("check.law_rms", "0.5 mrad")
    (said,) = (c for c in design_checks(strict, window, facts) if c.id == "orders")
    assert (said.state, said.required) == ("warn", False)
    assert "±0.55 mrad only" in said.sentence


def test_light_is_part_of_a_design_only_where_it_is_said():
    design = clacad.load(DESIGNS / "window-100mm.toml")
    assert design.replace("light.coherent", False).sha256 == design.sha256
    coherent = design.replace("light.coherent", True)
    assert "[light]\ncoherent = true" in coherent.canonical_toml()
    assert coherent.sha256 != design.sha256
    assert clacad.Design.from_dict(coherent.to_dict()) == coherent


@pytest.mark.slow
def test_throughput_says_what_diffraction_may_take_besides_and_judges_as_it_did():
    found = verify(clacad.load(DESIGNS / "window-100mm.toml"), rays=1024)
    (said,) = (c for c in found.checks if c.id == "throughput")
    kept = (1.0 - 0.164 / sqrt(22.7272727)) ** 2
    assert said.detail["diffraction_keeps"] == pytest.approx(kept, rel=1e-6)
    assert f"waves may leave {kept:.3f} of that" in said.sentence
    assert said.state == "pass"
    wide = verify(clacad.load(DESIGNS / "paper-a-covered.toml", ["pair.wavelength=10"]), rays=1024)
    (said,) = (c for c in wide.checks if c.id == "throughput")
    assert "waves" not in said.sentence
