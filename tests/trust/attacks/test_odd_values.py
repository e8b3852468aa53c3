"""Any value of a key of a design gives one of the answers a design has."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from trust.attacks.odd_values import BASES, VALUES, Tally, answered, attack, cases

from clacad.design import Design
from clacad.design.sections import ROOT, SECTIONS
from clacad.exporting.forecast import outlook
from clacad.prescription.prescribe import prescribe


def judged(tally: Tally, capsys: pytest.CaptureFixture[str]) -> None:
    with capsys.disabled():
        print(f"\n{tally}")  # noqa: T201
    assert tally.faults == []


@pytest.mark.slow
def test_a_few_of_the_odd_values_are_answered(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    judged(attack(tmp_path, 0.002, 0), capsys)


@pytest.mark.long
def test_a_hundredth_of_the_odd_values_is_answered(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    judged(attack(tmp_path, 0.01, 1), capsys)


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_a_tenth_of_the_odd_values_is_answered(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    judged(attack(tmp_path, 0.1, 2), capsys)


@pytest.mark.slow
def test_every_key_of_every_form_is_among_them() -> None:
    keys = len(ROOT) + sum(map(len, SECTIONS.values()))
    assert sum(1 for _ in cases(2.0, 0)) == len(BASES) * keys * len(VALUES)
    assert [name for name, _ in cases(0.01, 0)] == [name for name, _ in cases(0.01, 0)]


def test_the_forecast_of_no_form_is_negative() -> None:
    """Facets of fine grids follow from those of coarse ones, which may count more steps of a rim than cells."""
    for data in BASES.values():
        rows = {row["format"]: row for row in outlook(prescribe(Design.from_dict(data)))}
        assert all(row["bytes"] > 0 and min(row["seconds"]) > 0.0 for row in rows.values())
        assert min(rows[name]["facets"] for name in ("stl", "3mf")) > 0


FORMER = {
    "theta = 89": ("slab", {"law": {"euler": [0, 89, 0]}}, 1),
    "a slab whose cells stand far aside": ("slab", {"lattice": {"aperture": [0.5, 0.5]}}, 1),
    "a plano pair whose cells stand far aside": ("plano", {"lattice": {"aperture": [0.5, 0.5]}}, 1),
    "a hexagonal sheet whose cells stand far aside": ("tilted", {"lattice": {"aperture": [0.5, 0.5]}}, 2),
    "the least separation of all": ("slab", {"pair": {"separation": 5e-324}}, 2),
    "the least separation of all, between plano lenses": ("plano", {"pair": {"separation": 5e-324}}, 2),
    "the least depth of all": ("slab", {"pair": {"depth": 5e-324}}, 2),
    "the least depth of all, with a unit": ("slab", {"pair": {"depth": "5e-324 mm"}}, 2),
    "a length beyond every number": ("slab", {"body": {"roughness": "1e308 m"}}, 2),
    "an angle beyond every number": ("slab", {"check": {"field": "1e308 deg"}}, 2),
    "an outline of one cell in the middle, where none is": (
        "slab",
        {"lattice": {"outline": {"circle": 0.75}}},
        2,
    ),
    "an outline that holds no cell whole in both arrays": (
        "tilted",
        {"lattice": {"outline": {"circle": 1.5}}},
        2,
    ),
    "cells without end round an outline": ("tilted", {"lattice": {"count": 2**53 + 1}}, 2),
    "a thousand rows and columns round an outline": ("tilted", {"lattice": {"count": 1000}}, 0),
    "lenses a thousand kilometres apart": ("tilted", {"pair": {"separation": 1e9}}, 2),
}
"""Designs that were once answered by an internal error, or not within minutes; what they are answered by."""


SEARCHED = (
    "theta = 89", "a slab whose cells stand far aside", "a plano pair whose cells stand far aside", "a thousand rows and columns round an outline",
)  # fmt: skip
"""Those of which `check` tries what would mend them until its time is up."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.long) if name in SEARCHED else name for name in FORMER]
)
def test_what_was_an_internal_error_once_is_a_sentence(name: str, tmp_path: Path) -> None:
    base, changes, status = FORMER[name]
    data = {key: dict(value) if isinstance(value, dict) else value for key, value in BASES[base].items()}
    for section, keys in changes.items():
        data.setdefault(section, {}).update(keys)
    path = tmp_path / "design.json"
    path.write_text(json.dumps(data))
    assert answered(["check", str(path)]) == (status, "")
