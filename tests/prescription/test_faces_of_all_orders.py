"""Faces with terms of order 4, 6 and 8, and bent ones: one design on every path, in every file, against 50 digits."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from mpmath import mp, mpf
from oracle import trace as oracle

import clacad
from clacad import Design, Fate, Rays, prescribe, trace
from clacad.exporting.drawing.canvas import allowances
from clacad.exporting.drawing.drawing_tables import faces_table
from clacad.formats.maps.pose_table import check_table, surface_table, write_table_csv, write_table_json
from clacad.formats.sequential.optiland_json import series, terms_needed
from clacad.formats.sequential.stations import stations
from clacad.formats.sequential.zmx import check_zmx, read_zmx, write_zmx
from clacad.sheet.bundle import bundle
from clacad.sheet.feasibility import describe, feasibility
from clacad.sheet.like_cell import interfaces
from clacad.verification.accuracy.extended_precision import direction_errors

GOLDEN = json.loads((Path(__file__).parents[1] / "data" / "optimised.json").read_text())["cases"]

ROUND = {
    "radius": 2.5,
    "conic": -0.5,
    "a4": [0.03, 0.06, 0.03],
    "a6": [-0.2, -0.6, -0.6, -0.2],
    "a8": [0.7, 2.8, 4.2, 2.8, 0.7],
}
SKEW = {
    "radius": [2.4, 2.6],
    "conic": -1.0,
    "a4": [0.02, -0.05, 0.01],
    "a6": [-0.2, 0.6, 0.3, -0.1],
    "a8": [0.7, -1.8, 0.2, 1.1, "5e17 1/m^7"],
}


def slab(first, second, **law):
    """A window with these two faces."""
    return Design.from_dict({
        "format": 1, "name": "orders", "unit": "mm", "law": {"eta": [-1.0, -1.0], **law},
        "pair": {"form": "slab", "separation": 10.0, "index": 1.5, "prescription": "given", "face": [first, second]},
        "lattice": {"pitch": 0.5, "count": [5, 5]},
    })  # fmt: skip


def bent():
    """The golden pair whose four faces have radii and terms of their own."""
    case = next(case for case in GOLDEN if "paraboloid, bending" in case["name"])
    z, faces = [face["vertex_z"] for face in case["faces"]], []
    for face in case["faces"]:
        terms = {(i, j): v for i, j, v in face["polynomial"]}
        faces.append({"radius": [1.0 / c for c in face["curvature"]], "conic": face["conic"], "a4": [terms[2, 0], terms[1, 1], terms[0, 2]]})  # fmt: skip
    return Design.from_dict({
        "format": 1, "name": "bent", "unit": "m", "law": {"eta": case["eta"]},
        "pair": {"form": "biconvex", "separation": case["separation"], "index": 1.5, "prescription": "given",
                 "thickness": [z[1] - z[0], z[3] - z[2]], "face": faces},
        "lattice": {"pitch": case["pitch"], "count": [5, 5]},
    })  # fmt: skip


DESIGNS = {"round": slab(ROUND, ROUND), "skew": slab(SKEW, ROUND), "tilted": slab(SKEW, SKEW, euler=[20.0, 0.4, 0.0]), "bent": bent()}  # fmt: skip


def test_the_text_of_a_design_keeps_every_order_and_its_unit():
    design = DESIGNS["skew"]
    assert design.pair.face[0].a8 == (0.7, -1.8, 0.2, 1.1, pytest.approx(5e-4, rel=1e-15))
    assert Design.from_dict(tomllib.loads(design.canonical_toml())) == design
    with pytest.raises(clacad.DesignError, match=r"mm\^5"):
        slab({**ROUND, "a6": ["3 1/mm^3", 0, 0, 0]}, ROUND)
    with pytest.raises(clacad.DesignError, match="x⁶"):
        slab({**ROUND, "a6": [1, 2, 3]}, ROUND)


@pytest.mark.daily_cases("round")
@pytest.mark.parametrize("name", DESIGNS)
def test_light_through_them_is_that_of_fifty_digits_and_of_the_oracle(name):
    design = DESIGNS[name]
    window = prescribe(design)
    lit = bundle(window, 300, design.check.field)
    seen = trace(window, lit.rays)
    alive = np.flatnonzero((seen.fate == Fate.ALIVE) & (seen.order == 0).all(axis=1))
    rays = (lit.rays.position[alive], lit.rays.direction[alive])
    errors = direction_errors(window, *rays, seen.direction[alive], seen.cell[alive], seen.order[alive])
    assert errors.max() < 4e-15
    home = np.append(window.lattice.centres(np.array([lit.cell]))[0], 0.0)
    faces = []
    for one in interfaces(window):
        s, place = one.surface, {"vertex": tuple(map(float, one.vertex)), "before": one.index_before, "after": one.index_after, "rotation": one.rotation}  # fmt: skip
        faces.append(
            oracle.polynomial(
                s.curvature_x, s.curvature_y, s.conic_x, s.conic_y, s.a4, s.a6, s.a8, s.side, **place
            )
        )
    for k in range(3):
        path = oracle.trace(faces, (rays[0][k] - home).tolist(), rays[1][k].tolist())
        assert np.array(path.directions[-1], dtype=float) == pytest.approx(
            seen.direction[alive[k]], abs=4e-15
        )


@pytest.mark.daily_cases("skew")
@pytest.mark.parametrize("name", ["skew", "tilted"])
def test_both_paths_say_the_same_of_every_ray(name):
    window = prescribe(DESIGNS[name])
    rng = np.random.default_rng(0)
    count = 3000
    start = np.column_stack([rng.uniform(-1.2, 1.2, (count, 2)), np.full(count, -1.0)])
    rays = Rays(start, np.column_stack([rng.uniform(-0.25, 0.25, (count, 2)), np.ones(count)]))
    one, two = (trace(window, rays, path=path, record=True) for path in ("numpy", "numba"))
    assert len(np.unique(one.fate)) >= 2
    for column in ("fate", "cell", "order", "surface"):
        np.testing.assert_array_equal(getattr(one, column), getattr(two, column), column)
    np.testing.assert_allclose(one.direction, two.direction, rtol=0, atol=1e-13)


def test_a_tool_path_programmer_finds_every_coefficient(tmp_path):
    window = prescribe(DESIGNS["tilted"])
    write_table_json(window, tmp_path / "t.json", 1.0)
    count = write_table_csv(window, tmp_path / "t.csv", 1.0)
    check_table(window, tmp_path / "t.json", tmp_path / "t.csv", 1.0, count)
    table = surface_table(window, 1.0)
    assert table["faces"][0]["a6_per_mm5"] == [-0.2, 0.6, 0.3, -0.1]
    assert "a8 ." in table["equations"]["even polynomial"]
    text = (tmp_path / "t.json").read_text()
    (tmp_path / "t.json").write_text(text.replace("0.6,", "0.61,", 1))
    with pytest.raises(clacad.storage.errors.FileDisagrees):
        check_table(window, tmp_path / "t.json", tmp_path / "t.csv", 1.0, count)


@pytest.mark.slow
def test_tables_for_people_show_every_order():
    design = DESIGNS["skew"]
    window = prescribe(design)
    facts = feasibility(window)
    rows = {row.name: row for row in describe(window, facts)}
    assert rows["front, a6: x⁶, x⁴ y², x² y⁴, y⁶"].value == "-0.2, 0.6, 0.3, -0.1"
    assert rows["front, a6: x⁶, x⁴ y², x² y⁴, y⁶"].unit == "1/mm⁵"
    drawn = faces_table(window, allowances(design)).svg()
    assert "x^8, x^6 y^2" in drawn


def test_an_even_asphere_of_eighth_order_is_read_back_from_a_zmx_and_a_skew_one_is_refused(tmp_path):
    window = prescribe(DESIGNS["round"])
    write_zmx(window, tmp_path / "x.zmx")
    check_zmx(window, tmp_path / "x.zmx")
    text = (tmp_path / "x.zmx").read_text()
    assert "PARM 3 -0.2" in text
    assert "PARM 4 0.7" in text
    assert read_zmx(tmp_path / "x.zmx")[0].terms[2] == pytest.approx((0.7, 2.8, 4.2, 2.8, 0.7))
    with pytest.raises(clacad.storage.errors.NotPossible, match="even terms"):
        write_zmx(prescribe(DESIGNS["skew"]), tmp_path / "y.zmx")


def test_a_series_holds_every_order():
    mp.dps = 40
    one = stations(prescribe(DESIGNS["skew"]))[0]
    terms, _ = terms_needed(one)
    table = series(one, terms)
    x, y = mpf("0.2"), mpf("-0.15")
    found = sum(c * x**i * y**j for i, row in enumerate(table) for j, c in enumerate(row) if c)
    face = oracle.polynomial(1 / 2.4, 1 / 2.6, -1, -1, *((*SKEW[o][:4], 5e-4) if o == "a8" else SKEW[o] for o in ("a4", "a6", "a8")))  # fmt: skip
    assert abs(found - oracle.sag(face, x, y)) < mpf(10) ** -15
