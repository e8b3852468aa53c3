"""Bodies that cannot be solids: refused with a code and a way out; those that merely look hopeless are built as specified."""

from __future__ import annotations

import os
import pickle
import re
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import meshwindows
import pytest

import clacad
from clacad.design import DesignError
from clacad.exporting.run import export
from clacad.formats.step.step_files import read_step, write_step
from clacad.mesh import tessellate
from clacad.storage.errors import NotPossible
from clacad.topology.complex_parts import CODES, CannotBuild

BASE = {
    "format": 1,
    "name": "hopeless",
    "unit": "mm",
    "law": {"eta": [-0.5, -1.0], "euler": [0.0, 0.0, 0.0]},
    "pair": {"form": "biconvex", "separation": 10.0, "index": 1.5, "thickness": "auto"},
    "lattice": {"pitch": 0.5, "count": [2, 2]},
}


def design(**changes):
    made = deepcopy(BASE)
    for key, value in changes.items():
        section, name = key.split("__")
        made[section][name] = value
    return clacad.Design.from_dict(made)


REFUSED = {
    "rim out of its web": (
        {"law__euler": [0.0, 5.0, 0.0], "pair__thickness": 0.008, "pair__web": 0.001},
        "CL131",
        r"a web of at least 0\.0348\d* mm",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_a_rim_that_has_no_edge_is_refused_with_code_and_way_out(name):
    changes, code, words = REFUSED[name]
    with pytest.raises(CannotBuild, match=words) as caught:
        write_step(clacad.prescribe(design(**changes)), os.devnull)
    assert caught.value.code == code
    assert str(caught.value).startswith(f"{code}: ")
    assert code in CODES


def test_the_way_out_that_the_message_names_is_one(tmp_path: Path):
    changes = {"law__euler": [0.0, 5.0, 0.0], "pair__thickness": 0.008}
    with pytest.raises(CannotBuild) as caught:
        write_step(clacad.prescribe(design(**changes, pair__web=0.001)), os.devnull)
    web = float(re.search(r"at least ([0-9.]+) mm", str(caught.value)).group(1))
    window = clacad.prescribe(design(**changes, pair__web=1.001 * web))
    write_step(window, tmp_path / "x.step")
    assert read_step(tmp_path / "x.step")["valid"]


PLANO = {"pair__form": "plano", "lattice__seam": 0.05, "pair__thickness": 0.004}
WAYS_OUT = {
    "thickness": {"pair__thickness": [0.028, 0.036]},
    "seam_depth": {"pair__thickness": 0.027, "lattice__seam_depth": 0.001},
    "no seam": {"lattice__seam": 0.0},
}


def test_land_behind_a_plane_face_is_refused_by_solids_and_meshes_with_the_thickness_that_holds_it():
    window = clacad.prescribe(design(**PLANO))
    for make in (lambda w: write_step(w, os.devnull), lambda w: tessellate(w, quads=4)):
        with pytest.raises(CannotBuild, match=r"thickness of more than 0\.027\d* design units") as caught:
            make(window)
        assert caught.value.code == "CL134"


@pytest.mark.parametrize("name", WAYS_OUT)
def test_every_way_out_of_land_behind_a_plane_face_is_one(name, tmp_path: Path):
    window = clacad.prescribe(design(**(PLANO | WAYS_OUT[name])))
    write_step(window.with_cells((1, 1)), tmp_path / "x.step")
    assert read_step(tmp_path / "x.step")["valid"]
    tessellate(window, quads=6)


def test_displaced_arrays_without_an_outline_are_refused_and_a_border_is_the_way_out(tmp_path: Path):
    sheet = meshwindows.window(**meshwindows.FORMS["slab, displaced in y"])
    with pytest.raises(CannotBuild, match=r"CL134: .*give body\.border a width"):
        write_step(replace(sheet, outline=None), tmp_path / "y.step", "fused")
    write_step(sheet, tmp_path / "x.step", "fused")  # with the outline that a border gives
    assert read_step(tmp_path / "x.step")["valid"]


def test_the_bevels_that_a_refusal_names_are_made():
    sheet = meshwindows.window(**meshwindows.FORMS["saddle at every corner"])
    with pytest.raises(CannotBuild, match="CL135") as caught:
        tessellate(sheet, quads=4, saddle_bevel=1.0)
    least, most = re.search(r"takes ([0-9.e-]+) .* to ([0-9.e-]+) ", str(caught.value)).groups()
    for width in (1.01 * float(least), 0.999 * float(most)):
        assert tessellate(sheet, quads=16, saddle_bevel=width).bodies[0].bevel_volume > 0.0


def test_a_refusal_crosses_processes_and_is_bad_input_of_the_command_line():
    error = CannotBuild("CL131", "no rim")
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.code, again.exit_status) == ("CL131: no rim", "CL131", 2)
    assert isinstance(error, ValueError)


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"law__euler": [0.0, 60.0, 0.0]}, "CL120"),
        ({"pair__separation": 0.5}, "CL120"),
        ({"pair__separation": 0.8, "pair__thickness": 0.3}, "CL120"),
        ({"lattice__pitch": 5e-5, "pair__separation": 1e-3}, "CL115"),
    ],
    ids=["undercut", "ends inside its cell", "ends inside its cell, thick", "pitch below 0.1 um"],
)
def test_designs_without_a_solid_are_design_errors_before_any_geometry(changes, code):
    with pytest.raises(DesignError) as caught:
        clacad.prescribe(design(**changes))
    assert code in str(caught.value)


@pytest.mark.slow
def test_lenslets_that_disconnect_the_body_are_written_as_the_pieces_they_are(tmp_path: Path):
    manifest = export(design(pair__thickness=0.004), tmp_path / "x", ("step", "stl"), quads=8)
    by_format = {entry["format"]: entry for entry in manifest.files}
    assert by_format["step"]["solids"] == 8
    assert manifest.document["window"]["pieces"] == [4, 4]
    # each is two caps of an ellipsoid: their volume is checked against the integral when the file is read back
    assert "volume" in by_format["step"]["checks"]
    assert by_format["stl-binary"]["checks"] == ["closed", "volume", "shape"]


@pytest.mark.slow
def test_a_sag_below_the_kernels_tolerance_is_an_exact_solid_and_no_mesh_where_float32_ends(tmp_path: Path):
    far = design(pair__separation=1e6)  # sag 3e-8 mm; lens 2 is 1 km off, where doubles are 0.1 nm apart
    manifest = export(far, tmp_path / "x", ("step",))
    entry = manifest.files[0]
    assert entry["solids"] == 2
    assert "volume" in entry["checks"]
    assert entry["volume"] == pytest.approx(entry["volume_exact"], rel=1e-6)
    with pytest.raises(CannotBuild, match="CL137: heights near z"):
        tessellate(clacad.prescribe(far), quads=4)
    flat = design(pair__separation=1e4, pair__form="slab")
    tessellate(clacad.prescribe(flat), quads=4)


def test_what_one_format_cannot_be_is_refused_before_the_others_are_written(tmp_path: Path):
    with pytest.raises(NotPossible, match="no border to engrave"):
        export(design(), tmp_path / "x", ("table", "marked"))
    assert not (tmp_path / "x").exists()
