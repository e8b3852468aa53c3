"""An asked error chooses: facets for a file, rays and a verdict for a verification, a rung for a picture."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import clacad
from clacad.cli import main
from clacad.rendering.picture_target import within_target
from clacad.scene import load_scene
from clacad.verification.accuracy.accuracy_table import TargetOutOfReach
from clacad.verification.accuracy.file_floors import Floor
from clacad.verification.checks import Check
from clacad.verification.error_target import rays_for, target_checks

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
    )  # within what was asked, and twice beyond what the law allows: a shape that nobody declared
    assert json.loads(text)["word"] == "shape only"
    # the same files are not within half of it
    light = [
        Check("faithful_rms", "pass", "", c["value"], where="file", subject=c["subject"]) for c in checks
    ]
    assert all(
        c.state == "fail" and "not within the 3 mrad asked" in c.sentence for c in target_checks(light, 3e-3)
    )


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


def test_a_picture_through_facets_takes_the_coarsest_within_its_target():
    scene = load_scene(SCENE).replace({"sheet.rung": "mesh"})
    coarse, fine = (within_target(scene, target).sheet.quads for target in (4e-2, 1e-2))
    assert coarse < fine
    with pytest.raises(TargetOutOfReach, match="use"):
        within_target(scene, 1e-6)
