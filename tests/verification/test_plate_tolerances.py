"""Errors of listed plates, each a contributor: plates that move together, gaps as a design has them, a compensator."""

from __future__ import annotations

import tomllib
from dataclasses import replace

import numpy as np
import pytest

from clacad import prescribe, tolerance, trace_sequence
from clacad.base.types import silent
from clacad.design import Design, template
from clacad.optics.rays import Fate
from clacad.verification.tolerance.farm import Farm
from clacad.verification.tolerance.light_measures import bench
from clacad.verification.tolerance.misaligned import as_made, parameters, telescopelet
from clacad.verification.tolerance.study import NoTolerances


@pytest.fixture(scope="module")
def design() -> Design:
    found = Design.from_dict(tomllib.loads(template("three", "three-plates-10deg"))).with_cells((12, 12))
    return found.replace(
        {"tolerances.decentre": "1 um", "tolerances.separation": "3 um", "tolerances.tilt": "1 mrad"}
    )


def test_every_plate_and_gap_is_a_contributor(design):
    names = [one.name for one in parameters(design, prescribe(design))]
    assert {"gap.1", "gap.2", "tilt.3.x", "tilt.3.y", "tilt.x", "tilt.y"} < set(names)
    assert {f"decentre.{plate}.{axis}" for plate in (1, 2, 3) for axis in "xy"} < set(names)
    assert "separation" not in names


def test_plates_that_move_alike_change_nothing_and_one_alone_adds_to_the_error(design):
    table = bench(design, prescribe(design), rays=64)
    together = table.measured({f"decentre.{plate}.x": 2e-3 for plate in (1, 2, 3)})
    assert together["image_shift"] < 1e-12
    assert together["law_rms"] == pytest.approx(table.measured({})["law_rms"], rel=1e-9)
    # a plate near the focus displaces light on array 2 as much as it bends it: the image stays, the error grows
    alone = table.measured({"decentre.3.x": 2e-3})
    assert alone["image_shift"] < 1e-4 < alone["law_rms"] - together["law_rms"]
    assert table.measured({"decentre.1.x": 2e-3})["image_shift"] > 5e-4
    assert table.measured({"tilt.3.y": 5e-3})["law_rms"] > 1.01 * together["law_rms"]


def test_a_wrong_gap_is_that_of_a_design_with_its_faces_farther_back(design):
    window = prescribe(design)
    faces = tuple(
        replace(face, z=face.z and face.z + 0.002 * (k > 1)) for k, face in enumerate(design.pair.face)
    )
    farther = prescribe(replace(design, pair=replace(design.pair, face=faces)))
    made = as_made(window, {"gap.1": 0.002})
    for one, two in zip(made.faces, farther.faces, strict=True):
        assert one.vertex == pytest.approx(two.vertex, abs=1e-12)


def test_light_through_cells_as_made_is_that_of_the_single_surfaces_in_turn(design):
    """Reference: the trace of one sequence of surfaces in numpy."""
    window = prescribe(design)
    errors = {"tilt.3.x": 4e-3, "decentre.2.y": 2e-3, "gap.1": 3e-3, "rotation": 1e-3}
    places = np.array([[0.0, 0.0], [2.75, -2.75]])
    lit = bench(design, window, rays=64).bundles["cone"].rays
    which = np.repeat([0, 1], len(lit))
    start, way = (np.tile(one, (2, 1)) for one in (lit.position, lit.direction))
    found, good = telescopelet(window, errors, places).through(start, way, which)
    for number, place in enumerate(places):
        one = telescopelet(window, errors, place)
        free = trace_sequence(one.seq, lit)
        alive = free.fate == Fate.ALIVE
        mine = found[which == number]
        assert np.array_equal(np.isfinite(mine[:, 0]), alive)
        assert mine[alive] == pytest.approx(free.direction[alive], abs=1e-13)
        assert np.array_equal(good[which == number], one.send(lit).fate == Fate.ALIVE)
    assert not np.array_equal(found[which == 0], found[which == 1])


def test_an_opaque_line_takes_its_share_of_the_light_of_a_sheet_as_made(design):
    lined = design.replace({"lattice.line": {"face": 1, "width": 0.05}})
    with_line, plain = (bench(one, prescribe(one), 256).measured({}) for one in (lined, design))
    assert with_line["throughput"] == pytest.approx(0.81, abs=4e-3)  # the rest hardly strays
    assert with_line["law_rms"] < plain["law_rms"]
    table = bench(design, prescribe(design), 64)
    assert table.law_rms({"gap.1": 1e-3}) == table.measured({"gap.1": 1e-3})["law_rms"]


@pytest.mark.slow
def test_a_compensator_takes_back_what_it_can(design):
    wrong = design.replace({"tolerances.decentre": "0 um", "tolerances.tilt": "0 mrad"})
    free = tolerance(wrong, 4, 0, 64, Farm(1), progress=silent)
    held = tolerance(wrong.replace("tolerances.compensator", "gap.1"), 4, 0, 64, Farm(1), progress=silent)
    assert (held.column("law_rms") <= free.column("law_rms") + 1e-15).all()
    assert held.column("law_rms").max() < 0.97 * free.column("law_rms").max()
    with pytest.raises(NoTolerances, match=r"it is one of gap\.1, gap\.2"):
        tolerance(wrong.replace("tolerances.compensator", "focus"), 0, progress=silent)
