"""Files of a sheet whose cells have an η of their own: a STEP file's faces traced here in plain numpy, and one cell made wrong."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from imaging.test_written_glens import met, patches, refracted
from sheet.test_cells_of_own_eta import WIDELY, design

import clacad
from clacad.exporting.step_record import write
from clacad.report.rows import fabrication

STEEP = 0.006
"""Slope of the light sent through each cell, either way."""


def sent(found, centre, index, slope):
    """Mean slope behind two patches of parallel light over the middle of a cell."""
    first, second = found
    rng = np.random.default_rng(3)
    half = rng.uniform(0.0, 0.08, (64, 2))
    local = np.concatenate([half * sign for sign in ((1, 1), (-1, 1), (1, -1), (-1, -1))])
    way = np.tile(np.array([*slope, 1.0]) / np.linalg.norm([*slope, 1.0]), (256, 1))
    start = np.column_stack([centre + local, np.zeros(256)]) - 2.0 * way / way[:, 2:]
    at, normal, inside = met(first, start, way)
    assert inside.all()
    way = refracted(way, normal, 1 / index)
    at, normal, inside = met(second, at, way)
    assert inside.all()
    way = refracted(way, normal, index)
    return (way[:, :2] / way[:, 2:]).mean(axis=0)


@pytest.mark.slow
def test_light_through_each_cell_of_the_written_step_leaves_by_the_eta_of_its_row(tmp_path):
    made = design(tmp_path, lattice__count=[5, 4])
    window = clacad.prescribe(made)
    write(window, str(tmp_path / "sheet.step"), "fused")
    found = [p for p in patches(tmp_path / "sheet.step") if min(p.shape[:2]) > 2]  # steps are ruled
    assert len(found) == 2 * 20
    middles = np.array([0.5 * (p[0, 0] + p[-1, -1]) for p in found])
    rows = [line.split(",") for line in (tmp_path / "cells.csv").read_text().splitlines()[1:]]
    sides = [np.flatnonzero((middles[:, 2] > 5.0) == back) for back in (False, True)]
    for i, j, delta_x, delta_y, eta in ([int(r[0]), int(r[1]), *map(float, r[2:])] for r in rows):
        centre = (np.array([i, j]) - (2.0, 1.5)) * 0.5
        pair = [
            found[side[int(np.argmin(((middles[side, :2] - centre) ** 2).sum(axis=1)))]] for side in sides
        ]
        up, down = (
            sent(pair, centre, window.bodies[0].index, slope) for slope in ((STEEP, STEEP), (-STEEP, -STEEP))
        )
        assert 2.0 * STEEP / (up - down) == pytest.approx([eta, eta], rel=5e-3)
        assert -eta * (up + down) / 2.0 == pytest.approx([delta_x, delta_y], abs=3e-5)


@pytest.mark.slow
def test_a_file_is_judged_by_the_eta_of_each_cell_and_one_cell_that_is_two_percent_off_fails_it(tmp_path):
    folders = [tmp_path / name for name in ("right", "wrong")]
    for folder in folders:
        folder.mkdir()
    right = design(folders[0], lattice__count=[4, 3])
    wrong = design(
        folders[1], lambda i, j: WIDELY(i, j) * (1.02 if (i, j) == (2, 1) else 1.0), lattice__count=[4, 3]
    )
    for made, folder in ((right, folders[0]), (wrong, folders[1])):
        clacad.export(made, folder / "out", formats=("step",))
    good = clacad.verify(right, files=folders[0] / "out")
    assert good.passed
    (least,) = (
        line.value for line in fabrication(good) if (line.about, line.name) == ("smallest", "apex radius")
    )
    radius = (
        0.5 * (good.window.bodies[0].index - 1.0) * 10.0 / 1.5
    )  # lens 2 of the cell of the least |η|, wherever the worst is
    assert least == (pytest.approx(radius, rel=1e-12),)
    strange = tmp_path / "strange"
    strange.mkdir()
    shutil.copy(folders[1] / "out" / "own-eta.step", strange)
    judged = clacad.verify(right, files=strange)
    failed = {check.id for check in judged.checks if check.state == "fail"}
    assert {"shape", "faithful_rms"} <= failed  # where its faces lie, and what they make of light
