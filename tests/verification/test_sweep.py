"""Sweeps: every combination of the values, each as if it had been designed alone, wherever it was computed."""

from __future__ import annotations

import csv
import io
import json
import time

import numpy as np
import pytest

from clacad.cli import main
from clacad.cli.tolerance_command import tolerance_text
from clacad.design import Design
from clacad.prescription.prescribe import prescribe
from clacad.verification.tolerance import Farm, bench, parse_vary, sweep, tolerance, write_sweep
from clacad.verification.tolerance.parameter_sweep import CannotVary
from clacad.verification.tolerance.study_files import study_table, sweep_parquet, sweep_table

SHEET = {
    "format": 1, "name": "sheet", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
    "pair": {"form": "slab", "separation": 10.0, "index": 1.5}, "lattice": {"pitch": 0.5, "count": [9, 9]},
    "tolerances": {"decentre": "2 um", "rotation": "0.05 mrad"},
}  # fmt: skip
DESIGN = Design.from_dict(SHEET)


@pytest.mark.parametrize(("text", "axis"), [
    ("law.eta.0=-0.25:-4:4", ("law.eta.0", (-0.25, -1.5, -2.75, -4.0))),
    ("lattice.count=10:30:3", ("lattice.count", (10, 20, 30))),
    ("pair.separation=5 um:20 um:4", ("pair.separation", ("5.0 um", "10.0 um", "15.0 um", "20.0 um"))),
    ("pair.separation=1:100:3:log", ("pair.separation", (1.0, 10.0, 100.0))),
    ("law.eta.0=0.1:0.5:5", ("law.eta.0", (0.1, 0.2, 0.3, 0.4, 0.5))),
    ("pair.form=slab,plano", ("pair.form", ("slab", "plano"))),
    ("law.eta=[-1,-1],[-0.5,-1]", ("law.eta", ([-1, -1], [-0.5, -1]))),
    ("body.roughness=5 nm,10 nm", ("body.roughness", ("5 nm", "10 nm"))),
])  # fmt: skip
def test_values_are_read_as_written(text, axis):
    key, values = parse_vary(text)
    assert (key, [str(v).replace(".0 um", " um") if isinstance(v, str) else v for v in values]) == (
        axis[0], [str(v).replace(".0 um", " um") if isinstance(v, str) else v for v in axis[1]]
    )  # fmt: skip


@pytest.mark.parametrize("text", ["law.eta.0", "=1:2:3", "law.eta.0=", "a=1:2:0", "a=1 um:2 mm:3", "a=0:2:3:log",
                                  "a=x:y:3"])  # fmt: skip
def test_what_cannot_be_varied_is_said(text):
    with pytest.raises(CannotVary, match="--vary"):
        parse_vary(text)


@pytest.fixture(scope="module")
def table():
    axes = [parse_vary("law.eta.0=-0.5:-1:2"), parse_vary("pair.separation=5,10,1e-3")]
    return sweep(DESIGN, axes, rays=64, farm=Farm(1))


def test_every_combination_is_there_the_last_key_fastest(table):
    assert [(row["law.eta.0"], row["pair.separation"]) for row in table.rows] == [
        (a, b) for a in (-0.5, -1.0) for b in (5, 10, 1e-3)
    ]


def test_a_point_is_the_design_with_those_values(table):
    made = DESIGN.replace({"law.eta.0": -0.5, "pair.separation": 10})
    window = prescribe(made)
    alone = bench(made, window, 64).measured({})
    row = table.rows[1]
    assert all(row[name] == alone[name] for name in ("blur", "law_rms", "throughput", "eta_x"))
    assert row["eta_x"] == pytest.approx(-0.5, rel=2e-3)
    assert row["radius"] == pytest.approx(min(abs(r) for body in window.bodies for face in (body.front, body.back)
                                              for r in [1.0 / face.surface.curvature_x]))  # fmt: skip
    assert row["state"] == "ok"


def test_a_point_that_cannot_be_built_says_why_and_the_others_go_on(table):
    row = table.rows[2]
    assert row["state"] == "error"
    assert "radius" in row["message"]
    assert np.isnan(row["law_rms"])
    assert table.rows[3]["state"] == "ok"


def test_the_longer_the_separation_the_smaller_the_aberration(table):
    assert table.rows[1]["blur"] < 0.3 * table.rows[0]["blur"]  # third power of pitch : separation


def test_csv_reads_back_to_the_same_numbers(table):
    rows = list(csv.DictReader(io.StringIO(sweep_table(table).decode())))
    assert len(rows) == 6
    assert float(rows[1]["law_rms"]) == table.rows[1]["law_rms"]
    assert rows[2]["law_rms"] == ""
    assert list(rows[0]) == table.columns()


def test_parquet_holds_the_same_table(table):
    parquet = pytest.importorskip("pyarrow.parquet", reason="the package pyarrow is not installed")
    found = parquet.read_table(io.BytesIO(sweep_parquet(table))).to_pylist()
    assert found[1]["law_rms"] == table.rows[1]["law_rms"]
    assert found[2]["state"] == "error"


@pytest.mark.slow
@pytest.mark.parametrize("texts", [
    ["law.eta.0=-0.5,-1", "law.delta.0=0:0.01:2"],
    pytest.param(["law.eta.0=-0.5:-1:2"], marks=pytest.mark.long),
    pytest.param(["law.eta.0=-0.5,-1", "law.delta.0=0,0.01", "pair.index=1.5"], marks=pytest.mark.long),
])  # fmt: skip
def test_tables_and_pictures_have_the_same_bytes_every_time(tmp_path, texts):
    axes = [parse_vary(text) for text in texts]
    kept = tmp_path / "sweep.checkpoint"
    first = sweep(DESIGN, axes, rays=64, farm=Farm(1), checkpoint=kept)
    again = sweep(DESIGN, axes, rays=64, checkpoint=kept)  # nothing left to do
    one = [p.read_bytes() for p in write_sweep(first, tmp_path / "a")]
    assert one == [p.read_bytes() for p in write_sweep(again, tmp_path / "b")]
    assert one[1].startswith(b"\x89PNG")


def _orders_by_thin_rays(eta, delta, slope, s, pitch, n=400):
    """Shares of the orders of one meridian, and mean exit slope of order 0, by rays through ideal thin lenses."""
    first, second = s / (1.0 - eta), -eta * s / (1.0 - eta)
    x = ((np.arange(n) + 0.5) / n - 0.5) * pitch
    inside = slope - x / first
    arrives = x + s * inside - delta * first  # from the middle of lens 2, which is decentred by delta f1
    order = np.rint(arrives / pitch).astype(int)
    exits = inside - (arrives - order * pitch) / second
    return {int(k): float((order == k).mean()) for k in np.unique(order)}, float(exits[order == 0].mean())


@pytest.mark.parametrize("incident", [(0.0, 0.0), (0.012, -0.004), None])
def test_the_beam_of_a_sweep_has_the_orders_and_the_exit_slope_of_thin_rays(incident):
    n, eta, delta, s, pitch = 400, (-0.9, -0.8), (0.02, 0.01), 10.0, 0.5
    design = DESIGN.replace({"law.eta": list(eta), "pair.separation": s})
    row = sweep(design, [("law.delta", (list(delta),))], rays=64, farm=Farm(1), incident=incident).rows[0]
    beam = [d / (1.0 - e) for e, d in zip(eta, delta, strict=True)] if incident is None else incident
    meridians = [_orders_by_thin_rays(e, d, t, s, pitch, n) for e, d, t in zip(eta, delta, beam, strict=True)]
    expected = {
        f"{i},{j}": a * b for i, a in meridians[0][0].items() for j, b in meridians[1][0].items()
    }  # fmt: skip
    assert row["orders"] == pytest.approx(
        expected, abs=2.0 / n
    )  # an edge lies within half a ray, twice, in x and y
    assert row["partner_share"] == row["orders"]["0,0"]
    assert row["ghost_share"] == pytest.approx(1.0 - row["partner_share"], abs=1e-12)
    slopes = [row["beam_exit_x"], row["beam_exit_y"]]
    assert slopes == pytest.approx(
        [exit_slope for _, exit_slope in meridians], abs=1e-3
    )  # a 40th of the cone of a lens


@pytest.mark.slow
def test_a_beam_along_the_normal_misses_the_partner_of_offset_lenses_that_a_field_follows(tmp_path, capsys):
    path = tmp_path / "sheet.json"
    path.write_text(json.dumps(SHEET | {"law": {"eta": [-0.9, -1.0], "delta": [0.02, 0.0]}}))
    command = ["sweep", str(path), "--vary", "pair.index=1.5", "--rays", "64", "--workers", "1"]
    rows = []
    for more in ([], ["--incident", "0,0"]):
        assert main([*command, *more, "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        rows.append(found["rows"][0])
    assert found["incident"] == [0.0, 0.0]
    assert rows[0]["partner_share"] == pytest.approx(1.0)
    offset = 0.02 * 10.0 / 1.9  # of lens 2: the copy of lens 1, 0.9 of a pitch wide, lies that far aside
    assert rows[1]["partner_share"] == pytest.approx((0.5 * 0.5 + 0.45 * 0.5 - offset) / (0.9 * 0.5))
    assert rows[1]["throughput"] < rows[0]["throughput"]
    assert main([*command, "--incident", "0,0", "-o", str(tmp_path / "out")]) == 0
    assert "--incident" in capsys.readouterr().out
    assert "partner_share,ghost_share,orders" in (tmp_path / "out" / "sweep.csv").read_text()


@pytest.mark.parametrize("text", ["1", "0,0,0", "a,b", "nan,0", "0,6", ""])
def test_a_beam_that_is_no_direction_is_refused(tmp_path, capsys, text):
    path = tmp_path / "sheet.json"
    path.write_text(json.dumps(SHEET))
    assert main(["sweep", str(path), "--vary", "pair.index=1.5", "--incident", text]) == 2
    assert f"--incident {text}" in capsys.readouterr().err


def test_nothing_to_vary_and_one_key_twice_are_refused():
    for axes in ([], [("pair.index", (1.5,)), ("pair.index", (1.6,))]):
        with pytest.raises(CannotVary):
            sweep(DESIGN, axes)


@pytest.mark.slow
def test_the_command_writes_the_table_and_prints_it(tmp_path, capsys):
    path = tmp_path / "sheet.json"
    path.write_text(json.dumps(SHEET))
    command = ["sweep", str(path), "--vary", "law.eta.0=-0.5:-1:2", "-o", str(tmp_path / "out"), "--rays", "64",
               "--workers", "1"]  # fmt: skip
    assert main([*command, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [row["law.eta.0"] for row in found["rows"]] == [-0.5, -1.0]
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"sweep.csv", "sweep.png", "sweep.checkpoint"}
    assert main(command) == 0  # done already: the same again
    assert "law rms" in capsys.readouterr().out
    other = ["sweep", str(path), "--vary", "law.eta.0=-0.5:-2:2", "-o", str(tmp_path / "out"), "--rays", "64"]
    assert main(other) == 3
    assert "--overwrite" in capsys.readouterr().err
    assert main(["sweep", str(path), "--vary", "law.nothing=1,2", "--rays", "64", "--workers", "1"]) == 2


@pytest.mark.slow
def test_the_tolerance_command_prints_contributors_and_yield(tmp_path, capsys):
    path = tmp_path / "sheet.json"
    path.write_text(json.dumps(SHEET))
    command = ["tolerance", str(path), "--samples", "3", "--rays", "64", "--workers", "1"]
    assert main(command) == 0
    text = capsys.readouterr().out
    assert "decentre.1.x" in text
    assert "yield" in text
    assert main([*command, "--json", "--seed", "4"]) == 0
    assert json.loads(capsys.readouterr().out)["seed"] == 4
    bare = tmp_path / "bare.json"
    bare.write_text(json.dumps({k: v for k, v in SHEET.items() if k != "tolerances"}))
    assert main(["tolerance", str(bare)]) == 2


@pytest.mark.long
def test_a_local_cluster_finds_the_same_tables(table):
    distributed = pytest.importorskip("distributed", reason="the package distributed is not installed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        time.sleep(0.5)
        farm = Farm(scheduler=cluster.scheduler_address)
        axes = [parse_vary("law.eta.0=-0.5:-1:2"), parse_vary("pair.separation=5,10,1e-3")]
        found = sweep(DESIGN, axes, rays=64, farm=farm)
        study = tolerance(DESIGN, samples=12, rays=64, farm=farm)
    assert sweep_table(found) == sweep_table(table)
    here = tolerance(DESIGN, samples=12, rays=64, farm=Farm(1))
    assert study_table(study) == study_table(here)


def test_tolerances_and_limits_that_are_angles_are_printed_in_mrad():
    from clacad.verification.tolerance.light_measures import MEASURES
    from clacad.verification.tolerance.misaligned import Parameter
    from clacad.verification.tolerance.study import Limit, Study

    nothing = np.zeros((1, len(MEASURES)))
    study = Study(
        "sheet", "0" * 64, 1e-3, (Parameter("tilt.x", "tilt", 0.001, "rad"), Parameter("decentre.1.x", "decentre", 0.01, "mm")),
        (Limit("law_rms", "<=", 0.003, "check.law_rms"), Limit("eta_error", "<=", 0.01, "check.eta")), "normal", 0, 64, dict.fromkeys(MEASURES, 0.0),
        np.zeros((2, 2, len(MEASURES))), np.zeros((2, len(MEASURES))), np.zeros((1, 2)), nothing,
    )  # fmt: skip
    rows = [line.split() for line in tolerance_text(study).splitlines()]
    assert ["tilt.x", "1", "mrad"] in rows
    assert ["decentre.1.x", "0.01", "mm"] in rows
    assert ["law_rms", "<=", "3", "mrad", "0", "check.law_rms"] in rows
    assert ["eta_error", "<=", "0.01", "0", "check.eta"] in rows
