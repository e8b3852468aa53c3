"""Accuracy, tolerances and sweeps of non-uniform sheets: on the worst cell, which is named."""

from __future__ import annotations

import numpy as np
import pytest

import clacad
from clacad.sheet.bundle import bundle
from clacad.tracing.worst_cell import tried_cells, worst_cell
from clacad.verification.accuracy.extended_precision import direction_errors
from clacad.verification.accuracy.measure_rungs import TracedRays, exact_rows, reference
from clacad.verification.tolerance import Farm, sweep, tolerance
from clacad.verification.tolerance.study import asked_design, named_design

DESIGN = clacad.Design.from_dict(
    {
        "format": 1, "name": "differing", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
        "pair": {"form": "slab", "separation": 10, "material": "PMMA", "wavelength": 550, "offset": "paraxial"},
        "lattice": {"pitch": 0.5, "count": [9, 9], "aperture": {"point": [-40, 10, -400]}},
        "check": {"field": "0.2 deg", "law_rms": "20 mrad", "law_bias": "20 mrad", "process": "none"},
        "tolerances": {"decentre": "5 um"},
    }
)  # fmt: skip
KINDS = {
    "aimed": DESIGN,
    "other pitch": DESIGN.replace({"lattice.aperture": "centred", "lattice.pitch_2": 0.497}),
    "turned": DESIGN.replace(
        {"lattice.aperture": "centred", "lattice.pitch_2": 0.497, "lattice.rotation_2": "1 deg"}
    ),
    "tilted": DESIGN.replace(
        {
            "lattice.aperture": "centred",
            "law.euler": [30, 3, 10],
            "law.varying": {"gradient": [[-3e-3, 0], [0, -3e-3]]},
        }
    ),
    "varying": DESIGN.replace(
        {"lattice.aperture": "centred", "law.varying": {"f_image": 300}, "pair.offset": "traced"}
    ),
}


def rms(angles):
    return float(np.sqrt(np.mean(angles**2)))


@pytest.mark.ci_cases("aimed", "turned", "varying")
@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_worst_cell_is_that_whose_light_leaves_farthest_from_its_law_by_plain_numpy(kind):
    design = KINDS[kind]
    window = clacad.prescribe(design)
    seen = worst_cell(window, design.check.field)
    errors = {}
    for one in tried_cells(window, design.check.field):
        lit = one.placed(bundle(one.like, 2048, design.check.field))
        result = clacad.trace(window, lit.rays, path="numpy")
        alive = result.fate == clacad.Fate.ALIVE
        asked = one.like.law.refract(lit.rays.direction[alive])
        errors[tuple(one.cell.tolist())] = rms(np.linalg.norm(result.direction[alive] - asked, axis=1))
    assert seen.tried == len(errors)
    assert errors[tuple(seen.cell.tolist())] >= 0.97 * max(errors.values())  # chosen by an eighth of the rays


@pytest.mark.ci_cases("other pitch", "tilted", "varying")
@pytest.mark.slow  # it compiles the kernels of non-uniform sheets; numpy is compared with sixty digits every day
@pytest.mark.parametrize("kind", KINDS)
def test_the_tracer_is_exact_in_fifty_digits_where_cells_differ(kind):
    design = KINDS[kind]
    window = clacad.prescribe(design)
    for one in tried_cells(window, design.check.field)[::30]:
        lit = one.placed(bundle(one.like, 64, design.check.field)).rays
        for path in ("numpy", "numba"):
            result = clacad.trace(window, lit, path=path)
            alive = result.fate == clacad.Fate.ALIVE
            error = direction_errors(
                window, lit.position[alive], lit.direction[alive], result.direction[alive], result.cell[alive],
                result.order[alive],
            )  # fmt: skip
            assert np.nanmax(error) < 3e-13


@pytest.mark.slow
def test_accuracy_has_the_sheet_itself_beside_one_of_equal_cells_like_its_worst():
    table = clacad.accuracy(DESIGN, rays=2000, quads=(4, 8))
    own = [row for row in table.rows if row.own_cells]
    assert [row.rung for row in own] == ["law", "thin", "surfaces", *["mesh"] * 4]
    assert all(row.setting.startswith("cells that differ") and row.seconds > 0.0 for row in own)
    facets = {
        (row.quads, row.normals): row
        for row in table.rows
        if row.rung == "mesh" and not row.own_cells and row.float == "f64"
    }
    for row in own[3:]:
        assert row.model_rms == pytest.approx(facets[row.quads, row.normals].model_rms, rel=0.1)
        assert row.disagree < facets[row.quads, row.normals].disagree + 0.01
        assert (
            row.triangles < 25 * 4 * 2 * (row.quads + 4) ** 2
        )  # the cells that light meets, and those about them
    assert own[2].model_rms < 1e-12
    equal = {row.rung: row for row in table.rows if not row.own_cells and row.rung in ("law", "thin")}
    for row in own[:2]:
        assert row.model_rms == pytest.approx(equal[row.rung].model_rms, rel=0.02)
    assert "this sheet is not uniform" in table.notes[0]
    assert table.cheapest(1e-9).own_cells
    document = table.to_dict()
    assert [row.get("own_cells", False) for row in document["rows"]][:4] == [True, True, True, True]
    with pytest.raises(ValueError, match="no setting is within"):
        table.cheapest(1e-20)


@pytest.mark.slow
def test_rows_of_the_sheet_itself_are_measured_on_the_rays_given():
    window = clacad.prescribe(DESIGN)
    seen = worst_cell(window, DESIGN.check.field)
    i, j = seen.cell.tolist()
    lit = seen.placed(bundle(seen.like, 256, DESIGN.check.field)).rays
    ladder = TracedRays.raised(window, lit, (i, j))
    law, thin, surfaces = exact_rows(ladder, reference(ladder))
    assert law.rays == thin.rays == surfaces.rays == 256
    assert law.law_rms < 1e-14
    assert thin.law_rms < 1e-12
    assert surfaces.law_rms == pytest.approx(law.model_rms, rel=0.1)


@pytest.mark.slow
def test_a_study_of_tolerances_is_of_the_worst_cell_and_names_it():
    study = tolerance(DESIGN, samples=4, rays=64, farm=Farm(1))
    seen = worst_cell(clacad.prescribe(DESIGN), DESIGN.check.field)
    assert study.cell == tuple(seen.cell.tolist())
    assert study.tried == seen.tried
    lit = seen.placed(bundle(seen.like, 4096, DESIGN.check.field)).rays
    result = clacad.trace(seen.window, lit, path="numpy")
    alive = result.fate == clacad.Fate.ALIVE
    error = np.linalg.norm(result.direction[alive] - seen.like.law.refract(lit.direction[alive]), axis=1)
    assert study.nominal["law_rms"] == pytest.approx(rms(error), rel=0.15)
    assert study.nominal["throughput"] == pytest.approx(alive.mean(), abs=0.03)
    same = tolerance(DESIGN.replace({"lattice.aperture": "centred"}), samples=1, rays=64, farm=Farm(1))
    assert same.cell is None
    # lens 2 moved aside by 5 um turns light by 5 um over its focal length, more where it is met off its vertex
    focal = seen.window.thin.focal_length[1][0]
    assert same.change("image_shift").max() == pytest.approx(5e-3 / focal, rel=0.01)
    assert study.change("image_shift").max() > 1.1 * same.change("image_shift").max()


@pytest.mark.slow
def test_a_sweep_names_the_worst_cell_of_each_point():
    found = sweep(DESIGN, [("lattice.aperture", ("centred", {"point": [-40, 10, -400]}))], 64, Farm(1))
    centred, aimed = found.rows
    assert centred["message"] == ""
    assert aimed["message"].startswith("light through cell (")
    assert aimed["law_rms"] > centred["law_rms"]


def test_a_design_with_a_table_reaches_those_who_work_on_its_study(tmp_path):
    rows = "i,j,delta_x,delta_y\n" + "".join(f"{i},{j},{1e-4 * i},0\n" for i in range(9) for j in range(9))
    (tmp_path / "cells.csv").write_text(rows)
    text = DESIGN.replace({"lattice.aperture": "centred"}).canonical_toml()
    (tmp_path / "design.toml").write_text(text.replace("[law]\n", '[law]\nvarying = {table = "cells.csv"}\n'))
    design = clacad.load(tmp_path / "design.toml")
    handed = named_design(design)
    assert asked_design(handed) == design
    assert clacad.prescribe(asked_design(handed)).law_at((3, 1)).delta_x == pytest.approx(3e-4)
    assert "path" not in named_design(DESIGN)
