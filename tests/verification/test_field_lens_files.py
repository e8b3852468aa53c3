"""Files of sheets with a field lens: masters that pass, and files of slightly other ones that light tells apart."""

from __future__ import annotations

from pathlib import Path

import pytest

import clacad
from clacad import load

DESIGNS = Path(__file__).parents[2] / "designs"


def sheet(name, cells=3, **keys):
    """A shipped design of few cells with a field lens and keys changed, a.b written a__b."""
    changes = {key.replace("__", "."): value for key, value in keys.items()}
    few = {"pair.field_lens": True, "lattice.count": [cells, cells]}
    return load(DESIGNS / f"{name}.toml").replace(few | changes)


def failing(report):
    return {check.id for check in report.checks if check.state == "fail"}


def test_two_plates_are_written_and_judged_as_masters(tmp_path):
    design = sheet("window-100mm")
    made = clacad.export(design, tmp_path, formats=["step", "sag"])
    assert made
    report = clacad.verify(design, files=tmp_path)
    assert failing(report) == set()
    assert {verdict.word for verdict in report.verdicts} == {"passed as optical master"}
    solids = next(
        check for check in report.checks if check.id == "readable" and check.subject.endswith(".step")
    )
    assert "2 solids" in solids.sentence


@pytest.mark.slow
@pytest.mark.parametrize(
    "design",
    [
        sheet("paper-a-covered"),
        sheet("window-100mm", law__eta=[-0.5, -0.5], law__delta=[0.01, 0.03], check__process="none"),
        sheet("paper-a-covered", law__eta=[-1.0, -1.0], law__euler=[0.0, 3.0, 0.0]),
    ],
    ids=["biconvex", "offset", "tilted"],
)
def test_three_bodies_are_written_and_judged_as_masters(tmp_path, design):
    clacad.export(design, tmp_path, formats=["step"])
    report = clacad.verify(design, files=tmp_path, rays=4096)
    assert [verdict.word for verdict in report.verdicts] == ["passed as optical master"]
    assert not [check for check in report.checks if check.state == "fail" and check.subject.endswith(".step")]


@pytest.mark.slow
@pytest.mark.parametrize(
    "other",
    [
        {"pair.field_lens": False},
        {"pair.field": {"gap": 0.5}},
        {"law.eta": [-1.05, -1.05]},
    ],
    ids=["no field lens", "a wide gap", "another law"],
)
def test_light_tells_the_file_of_another_sheet(tmp_path, other):
    design = sheet("window-100mm")
    clacad.export(design.replace(other), tmp_path, formats=["step"])
    report = clacad.verify(design, files=next(tmp_path.glob("*.step")), rays=4096)
    assert failing(report)
