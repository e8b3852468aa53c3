"""The figure of a non-uniform sheet: drawn only for such sheets, the same every time, naming the worst cell."""

from __future__ import annotations

import re
from types import SimpleNamespace

import pytest

import clacad
from clacad.checks.light_kinds import LAW_RMS
from clacad.report.plots import varying


@pytest.mark.slow
def test_a_sheet_of_differing_cells_is_drawn_with_its_worst_cell_and_one_of_equal_cells_is_not():
    asked = clacad.Design.from_dict({
        "format": 1, "name": "g", "unit": "mm", "law": {"eta": [-1.0, -1.0], "varying": {"f_image": 200}},
        "pair": {"form": "slab", "separation": 10.0, "material": "PMMA", "surface": "biconic"},
        "lattice": {"pitch": 0.5, "count": [20, 12], "outline": {"circle": 5}},
    })  # fmt: skip
    check = SimpleNamespace(kind=LAW_RMS, id=LAW_RMS.id, where="surfaces", detail={"cell": [2, 5]})
    report = SimpleNamespace(design=asked, checks=[check])
    window = clacad.prescribe(asked)
    drawn = varying(report, window)
    assert drawn == varying(report, window)
    assert drawn.startswith("<svg role=")
    assert "cell (2, 5) by law_rms" in re.sub(r"\s+", " ", drawn)
    assert drawn.count("<image") >= 3
    plain = clacad.Design.from_dict({**asked.to_dict(), "law": {"eta": [-1.0, -1.0]}})
    assert varying(SimpleNamespace(design=plain, checks=[]), clacad.prescribe(plain)) == ""
