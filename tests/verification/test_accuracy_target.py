"""A requested error chooses: facets for a file, rays and a verdict for a verification, a rung for a picture."""

from __future__ import annotations

import json
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import clacad
from clacad.checks.check import Check
from clacad.cli import main
from clacad.rendering.picture_cost import within_target
from clacad.scene import load_scene
from clacad.verification.accuracy.accuracy_table import AccuracyTable, TargetOutOfReach
from clacad.verification.accuracy.choose_setting import files_within
from clacad.verification.accuracy.file_floors import Floor
from clacad.verification.run import rays_for, target_checks

DESIGNS = Path(__file__).parents[2] / "designs"
SLAB = str(DESIGNS / "slab.toml")
SCENE = DESIGNS / "scenes" / "effects-wide.toml"


def answered(capsys, *arguments):
    status = main([str(a) for a in arguments])
    told = capsys.readouterr()
    return status, told.out, told.err


@given(
    st.floats(1e-4, 10.0), st.floats(1e-9, 1e-5), st.floats(1.0001, 1e3), st.sampled_from(["facet", "vertex"])
)
def test_the_grid_named_is_within_the_target_and_the_next_coarser_is_not(a, b, above, normals):
    floor = Floor(
        "any", normals, "f32", "", a, b, None, None, b if normals == "vertex" else np.sqrt(2 * a * b)
    )
    target = above * floor.floor
    quads = floor.quads_for(target)
    best = np.sqrt(a / b)
    if normals == "facet" and quads > best:  # the optimum lies between two whole numbers
        assert floor.error(best) <= target
        return
    assert floor.error(quads) <= target * (1 + 1e-9)
    assert quads == 1 or floor.error(quads - 1) > target * (1 - 1e-9)
    assert floor.quads_for(0.999 * floor.floor) is None


@pytest.mark.long
def test_a_file_exported_for_a_target_is_found_within_it_by_verification(tmp_path, capsys):
    # verification gathers the file's own triangles and traces them by another search
    out = tmp_path / "x"
    asked = ("--cells", "3x3", "--target", "6 mrad")
    status, _, err = answered(capsys, "export", SLAB, "-o", out, "--format", "stl,ply", *asked)
    assert status == 0
    assert "target 6 mrad: stl, ply: " in err
    quads = {entry["quads"] for entry in json.loads((out / "manifest.json").read_text())["files"]}
    status, text, _ = answered(capsys, "verify", SLAB, "--files", out, "--target", "6 mrad", "--json")
    checks = [c for c in json.loads(text)["checks"] if c["id"] == "file_target"]
    assert len(checks) == 2
    assert all(c["state"] == "pass" and 4e-3 < c["value"] <= 6e-3 for c in checks)
    assert len(quads) == 1
    assert (
        status == 1
    )  # within the requested error, and twice beyond the law's limit: a shape that nobody declared
    assert json.loads(text)["word"] == "shape only"
    # the same files are not within half of it
    light = [
        Check("faithful_rms", "pass", "", c["value"], where="file", subject=c["subject"]) for c in checks
    ]
    assert all(
        c.state == "fail" and "not within the 3 mrad requested" in c.sentence
        for c in target_checks(light, 3e-3)
    )


@pytest.mark.slow
@pytest.mark.parametrize("command", ["export", "verify"])
def test_below_the_floor_one_sentence_names_it_and_what_is_not(tmp_path, capsys, command):
    where = ("-o", tmp_path / "x", "--format", "stl")
    if command == "verify":
        assert answered(capsys, "export", SLAB, *where, "--cells", "2x2", "--quads", "4", "-q")[0] == 0
        where = ("--files", tmp_path / "x" / "slab.stl")
    status, out, err = answered(capsys, command, SLAB, *where, "--cells", "2x2", "--target", "0.001 mrad")
    assert (status, out) == (3, "")
    (sentence,) = [line for line in err.splitlines() if line.startswith("clacad:")]
    assert sentence.startswith("clacad: stl: 0.001 mrad is below its floor of ")
    assert "use step, whose faces are exact, or ply read by its vertex normals (" in sentence


@pytest.mark.parametrize("target", ["fast", "5 mm", "0 mrad", "-1 mrad", "nan", ""])
@pytest.mark.parametrize("command", [
    ("export", SLAB, "-o", "never", "--format", "stl"), ("verify", SLAB), ("accuracy", SLAB),
    ("render", str(SCENE), "-o", "never.png"),
], ids=lambda c: c[0])  # fmt: skip
def test_a_target_that_is_no_angle_is_refused_before_any_work(capsys, command, target, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, out, err = answered(capsys, *command, "--target", target)
    assert (status, out) == (2, "")
    assert "--target" in err
    assert "angle" in err
    assert not list(tmp_path.iterdir())


def test_what_contradicts_a_target_is_refused(capsys, tmp_path):
    common = ("export", SLAB, "-o", tmp_path / "x", "--target", "5 mrad")
    assert answered(capsys, *common, "--format", "stl", "--quads", "8")[0] == 2
    assert answered(capsys, *common, "--format", "stl", "--normals", "vertex")[0] == 3
    assert answered(capsys, *common, "--format", "stl", "--normals", "both")[0] == 2
    assert not (tmp_path / "x").exists()


def test_a_target_on_more_lenslets_than_are_written_is_refused_as_without(capsys, tmp_path):
    status, _, err = answered(
        capsys, "export", SLAB, "-o", tmp_path / "x", "--format", "stl", "--target", "5 mrad",
        "--set", "lattice.count=[1000000000,1000000000]",
    )  # fmt: skip
    assert status == 3
    assert "1.00e+18 lenslets" in err


def test_fewer_rays_do_for_a_coarser_target():
    counts = [rays_for(target, 3e-3) for target in (5e-3, 5e-4, 5e-5, 5e-9)]
    assert counts == sorted(counts)
    assert counts[0] < counts[2]
    # the mean of n independent errors has spread/sqrt(n) of them, here a tenth of the target at most
    assert 3e-3 / np.sqrt(counts[2]) <= 0.1 * 5e-5


def test_a_picture_takes_the_cheapest_rung_within_its_target():
    scene = load_scene(SCENE).replace({"sheet.rung": "auto"})
    from clacad.rendering.sheet_passage import plan_passage

    window = clacad.prescribe(scene.design())
    rungs = [plan_passage(within_target(scene, target), window).rung for target in (1.0, 1e-9)]
    assert rungs[1] == "surfaces"
    assert within_target(scene, 1e-9).effects.angle == pytest.approx(1e-9)


def test_a_rung_that_is_not_within_the_target_is_refused_with_its_error():
    scene = load_scene(SCENE).replace({"sheet.rung": "thin"})
    with pytest.raises(TargetOutOfReach, match="rung thin is .* use rung surfaces"):
        within_target(scene, 1e-9)


@pytest.mark.slow
def test_a_picture_through_facets_takes_the_coarsest_within_its_target():
    scene = load_scene(SCENE).replace({"sheet.rung": "mesh"})
    coarse, fine = (within_target(scene, target).sheet.quads for target in (4e-2, 1e-2))
    assert coarse < fine
    with pytest.raises(TargetOutOfReach, match="use"):
        within_target(scene, 1e-6)


def hand_made_floors(a: float) -> list[Floor]:
    """Facets of m quads a cell side that err by a/m radians; rounding that does not count."""
    kinds = (("stl, stl-parts", "facet"), ("glb", "facet"), ("3mf, ply", "facet"), ("ply", "vertex"))
    return [Floor(names, normals, "f64", "", a, 1e-12, 1e6, None, 1e-9) for names, normals in kinds]


def test_the_cheapest_file_is_one_that_can_be_written_not_a_rung():
    design = clacad.load(DESIGNS / "window-100mm.toml", ["lattice.count=[40, 40]"])
    window = clacad.prescribe(design)
    found = files_within(design, window, hand_made_floors(0.05), 2e-3)
    assert {one.format for one in found} >= {"3mf", "step", "stl"}
    assert [one.bytes for one in found] == sorted(one.bytes for one in found)
    by = {one.format: one for one in found}
    assert by["stl"].quads == np.ceil(0.05 / (0.95 * 2e-3))  # by hand
    assert by["stl"].options == "--format stl --quads 27"
    assert all(one.error <= 2e-3 for one in found)
    # finer than facets are ever made: only the exact faces are left, and they have an end, too
    assert [one.format for one in files_within(design, window, hand_made_floors(0.05), 1e-8)] == ["step"]
    with pytest.raises(TargetOutOfReach, match="no file is within"):
        files_within(design, window, hand_made_floors(0.05), 1e-15)


@pytest.mark.slow
def test_the_cheapest_file_is_the_smallest_of_those_written(tmp_path):
    design = clacad.load(DESIGNS / "window-100mm.toml", ["lattice.count=[6, 6]"])
    found = files_within(design, clacad.prescribe(design), hand_made_floors(0.05), 4e-3)
    sizes = []
    for one in found:
        written = clacad.export(design, tmp_path / one.format, (one.format,), quads=one.quads)
        sizes.append(written.files[0]["bytes"])
        assert one.bytes == pytest.approx(sizes[-1], rel=0.25)
    assert len(found) == 5
    assert sizes[0] == min(sizes)


def test_the_command_names_the_file_and_how_to_write_it(capsys, monkeypatch):
    # the measured table has tests of its own
    made = AccuracyTable(
        "x", (), {"rms": 0.0, "max": 0.0, "digits": 50, "rays": 1}, tuple(hand_made_floors(0.05))
    )
    monkeypatch.setattr(
        import_module("clacad.verification.accuracy.accuracy_table"), "accuracy", lambda *_a, **_k: made
    )
    status, out, _ = answered(capsys, "accuracy", SLAB, "--target", "2 mrad")
    assert status == 0
    assert "cheapest file within 2 mrad: 3mf (27 quads a cell side, " in out
    pasted = " ".join(out.replace(" \\\n", " ").split())
    assert f"clacad export {SLAB} -o DIR --format 3mf --quads 27" in pasted
    assert "also within it: step (exact faces)" in out
