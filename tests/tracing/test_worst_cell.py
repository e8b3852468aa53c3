"""The cell by which a non-uniform sheet is judged is the worst of all its cells, not of a sample alone."""

from __future__ import annotations

import numpy as np
import pytest

from clacad.design import load
from clacad.optics.law import angle_between
from clacad.optics.rays import Fate
from clacad.prescription.prescribe import prescribe
from clacad.sheet.bundle import bundle
from clacad.sheet.like_cell import like_cell
from clacad.sheet.representative_cells import representative_cells
from clacad.tracing.worst_cell import SeenCell, tried_cells, worst_cell

TEXT = """format = 1
name = "table"
unit = "mm"
[law]
eta = [-0.5, -0.5]
euler = [0, 4, 0]
varying = {table = "cells.csv"}
[pair]
form = "slab"
separation = 10
index = 1.5
[lattice]
pitch = 0.5
count = [12, 12]
"""


@pytest.fixture(scope="module")
def design(tmp_path_factory):
    """Tilted lenses with an offset of its own, at random, in each of 144 cells."""
    folder, rng = tmp_path_factory.mktemp("table"), np.random.default_rng(4)
    rows = [
        f"{i},{j},{x!r},{y!r}"
        for i in range(12)
        for j in range(12)
        for x, y in [rng.uniform(-0.02, 0.02, 2).tolist()]
    ]
    (folder / "cells.csv").write_text("\n".join(["i,j,delta_x,delta_y", *rows, ""]))
    (folder / "table.toml").write_text(TEXT)
    return load(folder / "table.toml")


@pytest.mark.slow
def test_the_worst_cell_is_that_of_all_cells_of_the_sheet(design):
    window, field = prescribe(design), design.check.field
    errors = {}
    for cell in window.lattice.cells():
        one = SeenCell(window, like_cell(window, cell, widest=False), cell)
        lit = bundle(one.like, 512, field)
        seen = one.send(lit)
        alive = seen.fate == Fate.ALIVE
        off = angle_between(seen.direction[alive], one.like.law.refract(lit.rays.direction[alive]))
        errors[tuple(cell.tolist())] = float(np.sqrt(np.mean(off**2)))
    found = errors[tuple(worst_cell(window, field).cell.tolist())]
    assert found >= 0.99 * max(errors.values())
    sample = max(errors[tuple(cell)] for cell in representative_cells(window, "sample").tolist())
    assert sample < 0.97 * max(errors.values())  # 64 of 144 cells miss it


def test_an_even_sample_stays_among_the_cells_that_are_tried(design):
    window = prescribe(design)
    tried = {tuple(one.cell.tolist()) for one in tried_cells(window, design.check.field)}
    assert {tuple(cell) for cell in representative_cells(window, "sample").tolist()} <= tried
