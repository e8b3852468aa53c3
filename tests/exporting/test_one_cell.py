"""Files of one chosen cell of a non-uniform sheet: its lens, its light, the manifest, and the comparison with it."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest

import clacad
from clacad.design import Design
from clacad.storage.errors import BadRequest

AIMED = Design.from_dict(
    {
        "format": 1, "name": "aimed-pair", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
        "pair": {"form": "plano", "separation": 10, "material": "PMMA", "wavelength": 550, "offset": "traced", "thickness": [1.5, 1.5]},
        "lattice": {"pitch": 0.5, "count": [9, 7], "aperture": {"point": [3, -2, -150]}},
        "body": {"border": 4}, "check": {"process": "none"},
    }
)  # fmt: skip
CELL = (1, 5)
NAME = "aimed-pair"


def _sphere(path):
    """Centre (x, y) and radius of the sphere through the nodes of a grid of sags, mm."""
    lines = path.read_text().splitlines()
    nx, ny, dx, dy = (float(word) for word in lines[0].split()[:4])
    sag = np.array([float(line.split()[0]) for line in lines[1:]])
    x = np.tile((np.arange(nx) - 0.5 * (nx - 1)) * dx, int(ny))
    y = np.repeat((0.5 * (ny - 1) - np.arange(ny)) * dy, int(nx))
    terms = np.column_stack([2.0 * x, 2.0 * y, 2.0 * sag, np.ones_like(x)])
    (x0, y0, z0, k), *_ = np.linalg.lstsq(terms, x * x + y * y + sag * sag, rcond=None)
    return np.array([x0, y0]), np.sqrt(k + x0 * x0 + y0 * y0 + z0 * z0)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    out = tmp_path_factory.mktemp("cell")
    clacad.export(AIMED, out, formats=("sag", "zmx", "table"), cell=CELL)
    return out


def test_the_sag_of_a_cell_is_that_of_its_own_lens_where_the_table_has_it(made):
    with (made / f"{NAME}.poses.csv").open() as stream:
        row = next(
            one
            for one in csv.DictReader(stream)
            if one["face"] == "array2-back" and (int(one["i"]), int(one["j"])) == CELL
        )
    apex = np.array([float(row["apex_x_mm"]), float(row["apex_y_mm"])])
    own_1 = np.array([0.5 * (CELL[0] - 4), 0.5 * (CELL[1] - 3)])
    eye = np.array([3.0, -2.0])
    own_2 = own_1 + (own_1 - eye) * 10.0 / 150.0  # where the ray from the eye meets lens 2, nearly
    centre, radius = _sphere(made / f"{NAME}.array2-back.cell.dat")
    window = clacad.prescribe(AIMED)
    cell_2 = window.centres(1, np.array(CELL))
    assert cell_2 == pytest.approx(own_2, abs=0.02)
    assert cell_2 + centre == pytest.approx(apex, abs=1e-9)
    assert np.hypot(*centre) > 0.1  # far from the middle lens, which a uniform sheet would have
    assert radius == pytest.approx(10.0 * 0.5 * (window.bodies[1].index - 1.0), rel=1e-9)


def test_light_through_the_prescription_of_a_cell_leaves_as_through_that_cell_of_the_sheet(made):
    from clacad.formats.sequential.stations import traced
    from clacad.formats.sequential.zmx import read_zmx
    from clacad.optics.rays import Fate, Rays

    window = clacad.prescribe(AIMED)
    own = window.centres(0, np.array(CELL))
    towards = np.array([*(own - [3.0, -2.0]), 150.0])
    offsets = np.array([[x, y, -1.0] for x in (-0.1, 0.0, 0.1) for y in (-0.1, 0.0, 0.1)])
    direction = np.tile(towards / np.linalg.norm(towards), (len(offsets), 1))
    sheet = clacad.trace(window, Rays(offsets + [*own, 0.0], direction), path="numpy")
    assert (sheet.fate == Fate.ALIVE).all()
    low = window.z_range[0]
    alone = traced(read_zmx(made / f"{NAME}.zmx"), offsets - [0.0, 0.0, low], direction)
    assert np.abs(alone - sheet.direction).max() < 1e-12


def test_the_manifest_names_the_cell_and_verification_compares_with_it(made, tmp_path):
    from clacad.base.types import silent
    from clacad.judging.delivery import list_files
    from clacad.judging.judge_files import judge_files

    window = clacad.prescribe(AIMED)
    manifest = json.loads((made / "manifest.json").read_text())
    kinds = {one["format"]: one.get("cell") for one in manifest["files"]}
    assert kinds["grid-sag"] == kinds["zmx"] == list(CELL)
    assert kinds["pose-table"] is None
    assert manifest["options"]["cell"] == list(CELL)
    for name in (f"{NAME}.array2-back.cell.dat", f"{NAME}.zmx"):
        (tmp_path / name).write_bytes((made / name).read_bytes())
    for cell, state in ((list(CELL), "pass"), ([1, 4], "fail"), ([9, 0], "fail")):
        told = [one | {"cell": cell} for one in manifest["files"] if (tmp_path / one["name"]).exists()]
        (tmp_path / "manifest.json").write_text(json.dumps(manifest | {"files": told}))
        checks, _ = judge_files(AIMED, window, list_files(tmp_path), None, 256, silent)
        states = {(check.id, check.subject.split(".")[-1]): check.state for check in checks if check.subject}
        assert states["readable", "zmx"] == states["readable", "dat"] == state
        if state == "pass":
            light = next(check for check in checks if check.id == "file_law_rms")
            assert light.state == "pass"
            assert "in cell (1, 5)" in light.sentence
            assert any("no file holds array1 or array2" in check.sentence for check in checks)


@pytest.mark.parametrize(
    ("cell", "said"),
    [
        ((9, 3), "row 3 .* 0,3 to 8,3"),
        ((2, 7), "rows j = 0 to 6"),
        ((2, -1), "rows j = 0"),
        ((10**30, 2), "row 2"),
    ],
)
def test_a_cell_that_the_sheet_lacks_is_refused_with_the_range(tmp_path, cell, said):
    with pytest.raises(BadRequest, match=said):
        clacad.export(AIMED, tmp_path / "out", formats=("sag",), cell=cell)
    assert not (tmp_path / "out").exists()


def test_a_cell_is_asked_for_where_one_is_needed_and_refused_where_none_is(tmp_path):
    from clacad.sheet.need_window import CellsDiffer

    with pytest.raises(CellsDiffer, match="--cell 4,3 takes one cell"):
        clacad.export(AIMED, tmp_path, formats=("zmx",))
    with pytest.raises(BadRequest, match="cell: it applies to sag, coupon, zmx"):
        clacad.export(AIMED, tmp_path, formats=("stl",), cell=CELL)


def test_of_a_uniform_sheet_every_cell_has_the_same_file_and_the_manifest_says_so(tmp_path):
    plain = Design.from_dict({**AIMED.to_dict(), "lattice": {"pitch": 0.5, "count": [3, 3]}, "name": "plain"})
    clacad.export(plain, tmp_path / "a", formats=("sag", "zmx"))
    said = clacad.export(plain, tmp_path / "b", formats=("sag", "zmx"), cell=(2, 0))
    for entry in said.files:
        assert (tmp_path / "a" / entry["name"]).read_bytes() == (tmp_path / "b" / entry["name"]).read_bytes()
        assert entry["cell"] == [2, 0]
        assert entry["uniform"] is True
