"""An export with no options but formats passes its own verification, and `check` forecasts its facets."""

from __future__ import annotations

from pathlib import Path

import pytest

import clacad
from clacad.exporting import limits
from clacad.exporting.forecast import outlook
from clacad.exporting.formats.registry import words
from clacad.exporting.request import Request
from clacad.exporting.roles import Role
from clacad.exporting.run import export, forecast_rows
from clacad.prescription.prescribe import prescribe
from clacad.verification import verify

DESIGNS = Path(__file__).parents[2] / "designs"
OF_EVERY_DESIGN = tuple(
    name
    for name in words()
    if not (
        name.startswith("marked")
        or name in ("baffle", "frame", "pins", "coupon", "optiland", "insert", "tool")
    )
)
"""Formats that every design has, without a border, honeycomb, fixture, another program or a nose that reaches all."""


def few(name: str, cells: int = 3) -> clacad.Design:
    return clacad.load(DESIGNS / f"{name}.toml").with_cells((cells, cells))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["slab", pytest.param("paper-a-covered", marks=pytest.mark.slow)])
def test_check_and_export_foresee_the_same_facets_and_light_within_the_limits(name):
    design = clacad.load(DESIGNS / f"{name}.toml")
    rows = {row.format: row for row in forecast_rows(design, Request(("stl", "3mf", "glb")))}
    said = {row["format"]: row["quads"] for row in outlook(prescribe(design), design)}
    assert {one: said[one] for one in ("stl", "3mf")} == {one: rows[one].quads for one in ("stl", "3mf")}
    assert rows["3mf"].prospect.role is rows["glb"].prospect.role is Role.MASTER
    assert rows["3mf"].prospect.law_rms <= 0.95 * design.check.law_rms
    assert rows["3mf"].bytes < 10_000_000


@pytest.mark.slow
def test_a_mesh_without_room_for_a_master_is_a_declared_preview_and_its_delivery_passes(
    tmp_path, monkeypatch
):
    design = few("slab", 2)
    monkeypatch.setattr(limits, "MOST_FACETS", 2 * 4 * 2 * 8 * 8 + 500)  # 8 quads fit, 64 would be needed
    entries = {one["name"]: one for one in export(design, tmp_path, ("step", "stl")).files}
    stl = entries["slab.stl"]
    assert (stl["role"], stl["role_declared"], stl["quads"]) == ("shape-preview", True, 8)
    assert stl["master_quads"] == 64
    assert entries["slab.step"]["role_declared"] is False
    assert verify(design, tmp_path, rays=2000).exit_status == 0


@pytest.mark.slow
def test_facets_that_were_asked_for_leave_the_role_to_the_light(tmp_path):
    rows = forecast_rows(few("slab", 2), Request(("stl",), quads={"stl": 8}))
    assert (rows[0].prospect.role, rows[0].prospect.declared) == (Role.PREVIEW, False)


@pytest.mark.ci_cases("slab", "hexagonal")
@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["slab", "plano", "tilted-biconvex", "galilean", "hexagonal", "paper-a-covered"]
)
def test_a_default_export_in_every_format_passes_its_own_verification(tmp_path, name):
    export(few(name, 2), tmp_path, OF_EVERY_DESIGN)
    report = verify(few(name, 2), tmp_path, rays=2000)
    assert report.exit_status == 0, report.verdict
