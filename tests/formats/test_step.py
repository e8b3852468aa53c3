"""STEP files: what is written is what was designed, as two readers that did not write it find."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from brepwindows import SWEEPS, biconvex, column_volume, one_body

import clacad
from clacad.exporting.formats.step import step_bytes
from clacad.formats.step import text_health
from clacad.formats.step.step_files import read_step, step_text_length, write_step
from clacad.formats.step.text_health import StepScan, scan_step
from clacad.sheet.lattice import Circle, Rectangle
from clacad.storage.errors import UnreadableFile

DESIGNS = Path(__file__).parents[2] / "designs"
TILTED = {"euler": (20.0, 3.0, 0.0)}


def total_volume(window):
    return sum(column_volume(window, body) for body in window.bodies)


@pytest.mark.daily_cases("instanced-AP242-True")
@pytest.mark.parametrize(
    ("mode", "schema", "pcurves"),
    [
        ("fused", "AP242", True),
        ("fused", "AP214", False),
        ("instanced", "AP242", True),
        ("instanced", "AP214", False),
    ],
)
def test_a_written_file_reads_back_as_the_designed_solids(tmp_path, mode, schema, pcurves):
    window = biconvex(**TILTED)
    path = tmp_path / "x.step"
    facts = write_step(window, path, mode=mode, schema=schema, pcurves=pcurves)
    read = read_step(path, window)
    assert read["schema"].startswith({"AP242": "AP242", "AP214": "AUTOMOTIVE"}[schema])
    assert read["millimetres"]
    assert read["dangling"] == 0
    assert read["open_edges"] == 0
    assert read["valid"]
    assert facts["solids"] == read["solids"] == read["kernel_solids"] == (2 if mode == "fused" else 18)
    assert facts["faces"] == read["faces"] == read["kernel_faces"]
    assert read["volume"] == pytest.approx(total_volume(window), rel=1e-10 if pcurves else 1e-8)
    pitch = window.lattice.pitch[0]
    assert read["lens_error"] <= 1e-9 * pitch
    assert read["patch_error"] <= 1e-9 * pitch
    assert read["lens_slope_error"] <= 1e-6
    assert read["lens_faces"] == 36


@pytest.mark.daily_cases("{'eta': (0.5, 0.3), 'thickness': 0.3}")
@pytest.mark.parametrize("case", [
    {"kind": "hexagonal", "euler": (10.0, 2.0, 0.0)},
    {"euler": (45.0, 0.0, 0.0)},
    {"thickness": 0.14, "web": 0.03, "euler": (30.0, 4.0, 0.0), "delta": (0.05, 0.02)},
    {"seam": 0.05, "web": 0.03, "thickness": 0.06, "outline": Circle(3.0)},
    {"web": 0.03, "thickness": 0.06, "outline": Rectangle(1.5, 1.9)},
    {"eta": (0.5, 0.3), "thickness": 0.3},
], ids=str)  # fmt: skip
def test_fused_and_instanced_files_hold_the_same_volume_and_the_same_lenses(tmp_path, case):
    window = biconvex(**case)
    volumes = []
    for mode in ("fused", "instanced"):
        path = tmp_path / f"{mode}.step"
        facts = write_step(window, path, mode=mode)
        read = read_step(path, window)
        assert read["valid"]
        assert (facts["solids"], facts["faces"]) == (read["kernel_solids"], read["kernel_faces"])
        assert max(read["lens_error"], read["patch_error"]) <= 1e-9 * window.lattice.pitch[0]
        volumes.append(read["volume"])
    assert volumes[0] == pytest.approx(volumes[1], rel=1e-10)


@pytest.mark.daily_cases("slab")
@pytest.mark.parametrize("name", ["tilted", "tilted-seam", "plano", "slab"])
def test_slabs_with_displaced_arrays_and_plane_backs_read_back(tmp_path, name):
    window = clacad.prescribe(clacad.load(str(DESIGNS / f"{name}.toml"))).with_cells((3, 2))
    volumes = []
    for mode in ("fused", "instanced"):
        path = tmp_path / f"{mode}.step"
        write_step(window, path, mode=mode)
        read = read_step(path, window)
        assert read["valid"]
        assert read["open_edges"] == 0
        assert (
            max(read["lens_error"], read["patch_error"]) <= 1e-9 * window.lattice.pitch[0] * window.unit * 1e3
        )
        volumes.append(read["volume"])
    assert volumes[0] == pytest.approx(volumes[1], rel=1e-10)


@pytest.mark.parametrize("mode", ["fused", "instanced"])
def test_gmsh_finds_the_same_solids_faces_and_volume(tmp_path, mode):
    gmsh = pytest.importorskip("gmsh")
    window = biconvex(euler=(45.0, 1.0, 0.0), count=(2, 2))
    path = tmp_path / "x.step"
    facts = write_step(window, path, mode=mode)
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        solids = [tag for dim, tag in gmsh.model.occ.importShapes(str(path)) if dim == 3]
        volume = sum(gmsh.model.occ.getMass(3, tag) for tag in solids)
        gmsh.model.occ.synchronize()
        faces = len(gmsh.model.getEntities(2))
    finally:
        gmsh.finalize()
    assert len(solids) == facts["solids"]
    assert faces == facts["faces"]
    assert volume == pytest.approx(total_volume(window), rel=1e-7)


@pytest.mark.ci_cases("1e-09", "2.598526445218819e-05", "0.6752339686501552")
@pytest.mark.daily_cases("2.9619362959451737e-08")
@pytest.mark.parametrize("angle", np.geomspace(1e-9, 20.0, 8).tolist())
def test_steps_of_any_height_survive_writing_and_reading(tmp_path, angle):
    window = one_body(biconvex(euler=(33.0, angle, 0.0), thickness=0.25, count=(2, 2)), 1)
    facts = write_step(window, tmp_path / "x.step", mode="fused")
    read = read_step(tmp_path / "x.step")
    assert read["valid"]
    assert (read["kernel_solids"], read["kernel_faces"]) == (1, facts["faces"])


@pytest.mark.parametrize("family", SWEEPS)
@pytest.mark.long
def test_sweep_of_sixty_four_angles_survives_writing_and_reading(tmp_path, family):
    for angle in np.geomspace(1e-9, 20.0, 64):
        window = one_body(biconvex(thickness=0.25, count=(2, 3), **SWEEPS[family](float(angle))), 1)
        facts = write_step(window, tmp_path / "x.step", mode="fused")
        read = read_step(tmp_path / "x.step")
        assert read["valid"], angle
        assert (read["kernel_solids"], read["kernel_faces"]) == (1, facts["faces"]), angle


def test_names_and_colours_are_in_the_file(tmp_path):
    from dataclasses import replace

    window = replace(biconvex(web=0.03, thickness=0.06), name="Müller's window \\ 1")
    write_step(window, tmp_path / "x.step", mode="fused")
    scan = scan_step(tmp_path / "x.step")
    assert {"array1", "array2"} <= set(scan.names)
    assert (0.25, 0.25, 0.28) in scan.colours  # land, to be found and painted
    from OCP.collections import Sequence_TDF_Label
    from OCP.STEPCAFControl import STEPCAFControl_Reader
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDataStd import TDataStd_Name
    from OCP.TDocStd import TDocStd_Document
    from OCP.XCAFDoc import XCAFDoc_DocumentTool

    document = TDocStd_Document(TCollection_ExtendedString("x"))
    reader = STEPCAFControl_Reader()
    reader.ReadFile(str(tmp_path / "x.step"))
    reader.Transfer(document)
    labels = Sequence_TDF_Label()
    XCAFDoc_DocumentTool.ShapeTool_s(document.Main()).GetFreeShapes(labels)
    name = TDataStd_Name()
    assert labels.Value(1).FindAttribute(TDataStd_Name.GetID_s(), name)
    assert name.Get().ToExtString() == "Müller's window \\ 1"


@pytest.mark.slow
def test_the_same_window_gives_the_same_bytes_in_any_process(tmp_path):
    script = (
        "import sys; sys.path[:0] = sys.argv[2:]\n"
        "from brepwindows import biconvex\n"
        "from clacad.formats.step.step_files import write_step\n"
        "window = biconvex(euler=(20.0, 3.0, 0.0), web=0.03, thickness=0.06)\n"
        "for mode in ('fused', 'instanced'):\n"
        "    write_step(window, sys.argv[1] + mode, mode=mode)\n"
    )
    for seed, zone in (("0", "UTC"), ("1", "Asia/Tokyo")):
        environment = {**os.environ, "PYTHONHASHSEED": seed, "TZ": zone}
        paths = [str(Path(__file__).parents[1]), str(Path(clacad.__file__).parents[1])]
        command = [sys.executable, "-c", script, str(tmp_path / f"{seed}-"), *paths]
        subprocess.run(command, check=True, env=environment)
    for mode in ("fused", "instanced"):
        assert (tmp_path / f"0-{mode}").read_bytes() == (tmp_path / f"1-{mode}").read_bytes()


def test_writing_loads_no_kernel(tmp_path):
    script = (
        "import sys; sys.path[:0] = sys.argv[2:]\n"
        "from brepwindows import biconvex\n"
        "from clacad.formats.step.step_files import write_step\n"
        "write_step(biconvex(), sys.argv[1])\n"
        "assert not {'OCP', 'build123d'} & set(sys.modules)\n"
    )
    paths = [str(Path(__file__).parents[1]), str(Path(clacad.__file__).parents[1])]
    subprocess.run([sys.executable, "-c", script, str(tmp_path / "x.step"), *paths], check=True)


def test_damaged_files_are_refused_or_found_out(tmp_path):
    window = biconvex(**TILTED)
    path = tmp_path / "x.step"
    write_step(window, path)
    text = path.read_text()
    for name, damaged in {
        "cut": text[: len(text) // 2],
        "cut at a line": text[: text.index("\n", len(text) // 2) + 1],
        "hello": "hello",
        "empty": "",
        "no faces": text[: text.index("DATA;") + 6] + "ENDSEC;\nEND-ISO-10303-21;\n",
    }.items():
        (tmp_path / name).write_text(damaged)
        with pytest.raises(UnreadableFile):
            read_step(tmp_path / name)
    missing = re.sub(r"#\d+=ADVANCED_FACE\('lens'.*\n", "", text, count=1)
    (tmp_path / "dropped.step").write_text(missing)
    assert read_step(tmp_path / "dropped.step", kernel=False)["dangling"] == 1
    flipped = text.replace(",.F.);", ",.T.);", 1)
    (tmp_path / "flipped.step").write_text(flipped)
    assert read_step(tmp_path / "flipped.step", kernel=False)["open_edges"] > 0


def test_a_loop_that_its_face_takes_the_other_way_round_is_counted_the_other_way_round(tmp_path):
    """Loops that other writers store reversed are read by the flag at the bound."""
    path, turned = tmp_path / "x.step", tmp_path / "turned.step"
    write_step(biconvex(**TILTED), path)
    text = path.read_text()
    bound = re.search(r"(=FACE_(?:OUTER_)?BOUND\('',#(\d+)),\.T\.\)", text)
    flagged = text.replace(bound[0], bound[1] + ",.F.)")
    turned.write_text(flagged)
    edges = re.findall(r"#\d+", re.search(rf"#{bound[2]}=EDGE_LOOP\('',(.*)\);", text)[1])
    assert scan_step(turned).open_edges == len(edges)
    other = {".T.": ".F.", ".F.": ".T."}
    for edge in edges:
        flagged = re.sub(
            rf"({edge}=ORIENTED_EDGE\(.*),(\.[TF]\.)\)", lambda m: f"{m[1]},{other[m[2]]})", flagged
        )
    turned.write_text(flagged)
    assert scan_step(turned).open_edges == scan_step(path).open_edges == 0


@pytest.mark.ci_cases("as written", "digits", "turned edge")
@pytest.mark.daily_cases("broken lines", "lost")
@pytest.mark.parametrize("change", [
    lambda text: text,
    lambda text: text.replace("',(", "' ,\n ( ").replace(",#", ", #").replace("=", " = "),
    lambda text: text.replace("'lens'", "'it''s #12; (1., .F.'").replace("'wall'", "''"),
    lambda text: text.replace(".5,", ".5000000000000000001,").replace("(0.,", "(+0.E+00,").replace(",-0.", ",-0.0e-9"),
    lambda text: re.sub(r"(=FACE_OUTER_BOUND\('',#\d+),\.T\.\)", r"\1,.F.)", text, count=1),
    lambda text: re.sub(r"(=ORIENTED_EDGE.*)\.T\.", r"\1.F.", text, count=1),
    lambda text: re.sub(r"\n#\d+=(VERTEX_POINT|EDGE_CURVE).*;", "", text, count=1),
], ids=["as written", "broken lines", "strings", "digits", "turned loop", "turned edge", "lost"])  # fmt: skip
def test_a_large_file_is_scanned_as_a_small_one(tmp_path, monkeypatch, change):
    """Frequent entities of large files are read by compiled code; all that is found is the same, bit by bit."""
    path = tmp_path / "x.step"
    write_step(biconvex(**TILTED), path)
    path.write_text(change(path.read_text()))
    alone = scan_step(path)
    monkeypatch.setattr(text_health, "LARGE", 0)
    monkeypatch.setattr(text_health, "_CHUNK", 1 << 14)
    whole = scan_step(path)
    names = [one.name for one in fields(StepScan) if one.name not in ("parts", "points", "frames")]
    np.testing.assert_array_equal(whole.frames, alone.frames)
    assert [getattr(whole, name) for name in names] == [getattr(alone, name) for name in names]
    for ours, theirs in ((whole.points.lookup(), alone.points.lookup()), (whole.groups[0], alone.groups[0])):
        for kept, expected in zip(vars(ours).values(), vars(theirs).values(), strict=True):
            np.testing.assert_array_equal(kept, expected)


def test_a_file_of_another_radius_is_as_far_from_the_design_as_its_sag(tmp_path):
    window, other = biconvex(eta=(-0.25, -1.0)), biconvex(eta=(-0.255, -1.0))
    write_step(other, tmp_path / "x.step")
    read = read_step(tmp_path / "x.step", window)
    assert read["valid"]
    assert read["lens_error"] > 1e-4 * window.lattice.pitch[0]
    assert read["patch_error"] > 1e-4 * window.lattice.pitch[0]


@pytest.mark.daily_cases("instanced")
@pytest.mark.parametrize("mode", ["fused", "instanced"])
def test_the_forecast_is_right_within_a_tenth(tmp_path, mode):
    for case in ({"euler": (20.0, 3.0, 0.0)}, {"kind": "hexagonal"}):
        window = biconvex(count=(12, 9), **case)
        facts = write_step(window, tmp_path / "x.step", mode=mode)
        assert step_bytes(window, mode) == pytest.approx(facts["bytes"], rel=0.1)
        assert step_text_length(window, mode) == facts["bytes"]


def test_forty_thousand_instanced_cells_take_less_than_a_megabyte(tmp_path):
    window = biconvex(count=(200, 200), euler=(20.0, 1.0, 0.0))
    facts = write_step(window, tmp_path / "x.step", mode="instanced")
    assert facts["bytes"] < 1_000_000
    assert facts["solids"] == 80_000
    scan = scan_step(tmp_path / "x.step")
    assert (scan.solids, scan.faces) == (80_000, facts["faces"])


def test_unknown_choices_are_named():
    with pytest.raises(ValueError, match="auto, fused or instanced"):
        write_step(biconvex(), "x", mode="melted")
    with pytest.raises(ValueError, match="AP242, AP214"):
        write_step(biconvex(), os.devnull, schema="AP203")
