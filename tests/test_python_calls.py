"""The package as it is called from Python: one ray or many, the call that works named, objects described in a line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from oracle.windows import biconvex, slab

import clacad
from clacad.checks.check import Check
from clacad.verification.verification_report import Report

DESIGN = clacad.load(Path(__file__).parents[1] / "designs" / "window-100mm.toml", ["lattice.count=[3, 3]"])
ORIGIN, DIRECTION = (0.0, 0.0, -0.01), (0.01, 0.0, 1.0)


def test_the_names_listed_are_the_public_ones():
    assert dir(clacad) == sorted([*clacad.__all__, "__version__"])
    record = (Path(__file__).parent / "data" / "public_api.txt").read_text(encoding="utf-8").splitlines()
    named = {
        line.partition("(")[0].partition(":")[0].split(".")[1] for line in record if line[:7] == "clacad."
    }
    assert set(clacad.__all__) <= named


@pytest.mark.parametrize("rung", ["law", "thin", "surfaces", "mesh"])
def test_one_ray_is_traced_as_it_is_among_many(rung):
    window = biconvex(count=(3, 3))
    many = clacad.Rays(np.array([ORIGIN, [0.1, 0.0, -0.01]]), np.array([DIRECTION, [0.0, 0.0, 1.0]]))
    among = clacad.trace(window, many, rung, path="numpy")
    pair = clacad.trace(window, (ORIGIN, DIRECTION), rung, path="numpy")
    alone = clacad.Tracer(window, rung, path="numpy")(clacad.Rays(ORIGIN, DIRECTION))
    assert len(pair) == len(alone) == 1
    for one in (pair, alone):
        assert one.fate[0] == among.fate[0]
        assert one.direction[0].tobytes() == among.direction[0].tobytes()


def test_one_ray_passes_a_sequence_of_surfaces():
    plate = [
        clacad.Interface(clacad.Quadric(0, 0, 0), (0, 0, z), *n) for z, n in ((0, (1, 1.5)), (1, (1.5, 1)))
    ]
    result = clacad.trace_sequence(plate, (ORIGIN, DIRECTION))
    np.testing.assert_allclose(result.direction, [np.divide(DIRECTION, np.hypot(1, 0.01))], atol=1e-16)


def test_one_start_or_one_direction_is_that_of_all():
    starts = np.random.default_rng(0).uniform(-1, 1, (5, 3))
    beam = clacad.Rays(starts, DIRECTION, 5.5e-7)
    assert beam.position is starts
    np.testing.assert_array_equal(beam.direction, np.tile(DIRECTION, (5, 1)))
    np.testing.assert_array_equal(beam.wavelength, np.full(5, 5.5e-7))
    np.testing.assert_array_equal(clacad.Rays(ORIGIN, starts).position, np.tile(ORIGIN, (5, 1)))
    assert len(clacad.Rays(ORIGIN, np.empty((0, 3)))) == 0
    with pytest.raises(ValueError, match="1 positions but 5 directions"):
        clacad.Rays([ORIGIN], starts)
    with pytest.raises(ValueError, match=r"shape \(2,\)"):
        clacad.Rays((0.0, 1.0), DIRECTION)


@pytest.mark.parametrize(
    "rays", [[ORIGIN, DIRECTION], (np.zeros((2, 3)), np.ones((2, 3))), np.zeros((2, 3)), None]
)
def test_what_is_no_rays_is_told_what_rays_are(rays):
    with pytest.raises(TypeError, match=r"clacad.Rays\(positions, directions\) or one ray"):
        clacad.trace(slab(count=(3, 3)), rays)


@pytest.mark.parametrize("given", [DESIGN, "designs/window-100mm.toml"])
def test_what_takes_a_window_names_the_call_that_gives_one(given):
    inside = "design" if given is DESIGN else "clacad.load(path)"
    for verb, rest in (
        (clacad.trace, (clacad.Rays(ORIGIN, DIRECTION),)),
        (clacad.tessellate, ()),
        (clacad.solids, ()),
    ):
        with pytest.raises(TypeError) as said:
            verb(given, *rest)
        assert f"clacad.{verb.__name__}(clacad.prescribe({inside})" in str(said.value)


def test_objects_are_told_in_a_short_line():
    window = clacad.prescribe(DESIGN)
    told = [DESIGN, window, clacad.tessellate(window, quads=4), clacad.Rays(ORIGIN, DIRECTION),
            clacad.trace(window, (ORIGIN, DIRECTION)), clacad.plan_effects(window)]  # fmt: skip
    for one in told:
        assert repr(one).startswith(type(one).__name__ + "(")
        assert len(repr(one)) < 120
    assert repr(DESIGN) == "Design('window-100mm', slab, eta -1 -1, separation 10 mm, 3 x 3 cells)"
    assert repr(window) == "Window('window-100mm', slab, 3 x 3 square cells of 0.5 mm, 1 body)"
    assert repr(told[4]) == "TraceResult(1 ALIVE)"


def test_a_report_is_told_in_a_short_table(monkeypatch):
    monkeypatch.setattr(Report, "verdict", lambda _self: "failed: law_rms")
    report = object.__new__(Report)
    checks = (Check("law_rms", "fail", "too much"), Check("law_bias", "pass", "well within"))
    for name, value in (("design", DESIGN), ("checks", checks), ("verdicts", ())):
        report.__dict__[name] = value
    assert repr(report).splitlines() == [
        "window-100mm",
        "  pass  1 check",
        "  fail  law_rms  too much",
        "failed: law_rms",
    ]
