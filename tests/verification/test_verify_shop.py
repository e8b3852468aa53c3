"""Is the file the shop sent back still the design? Files written by another program, true and not."""

from __future__ import annotations

import json

import numpy as np
import pytest

import clacad
from clacad.cli import main
from clacad.formats.mesh.readers import read_mesh
from clacad.judging.delivery import Inspection
from clacad.judging.mesh_file import judge_mesh
from clacad.mesh import tessellate

trimesh = pytest.importorskip("trimesh")
FORMATS = ("obj", "stl", "3mf", "ply")
DESIGN = "designs/slab.toml"


def sent_back(path, change=None, cells=(3, 3), quads=8):
    """Write the part with another library, in millimetres; `change` works on its vertices."""
    window = clacad.prescribe(clacad.load(DESIGN).with_cells(cells))
    (body,) = tessellate(window, quads=quads).bodies
    vertices = body.vertices * window.unit * 1e3
    if change is not None:
        vertices = change(vertices)
    part = trimesh.Trimesh(vertices, body.triangles, process=False)
    part.export(path)
    return path


def judged(path):
    design = clacad.load(DESIGN)
    window = clacad.prescribe(design.with_cells((3, 3)))
    factor = 1e-3 / window.unit
    found, _ = judge_mesh(Inspection(design, path.name, 16384), window, read_mesh(path), factor)
    return {check.id: check for check in found}


@pytest.mark.daily_cases("obj")
@pytest.mark.parametrize("format", FORMATS)
def test_a_true_file_of_any_format_is_the_design(tmp_path, format):
    checks = judged(sent_back(tmp_path / f"part.{format}"))
    for name in ("closed", "volume", "shape", "faithful_rms", "faithful_eta", "faithful_delta", "scale"):
        assert checks[name].state == "pass", checks[name].sentence


@pytest.mark.daily_cases("stl")
@pytest.mark.parametrize("format", FORMATS)
def test_a_part_whose_lenses_were_made_ten_per_cent_flatter_is_not(tmp_path, format):
    def flatter(vertices):
        low, high = vertices[:, 2].min(), vertices[:, 2].max()
        front = vertices[:, 2] < 0.5 * (low + high)
        made = vertices.copy()
        made[front, 2] = low + 0.9 * (made[front, 2] - low)
        return made

    checks = judged(sent_back(tmp_path / f"part.{format}", flatter))
    assert checks["shape"].state == "fail"
    assert "fail" in (checks["faithful_eta"].state, checks["volume"].state)


def test_a_part_with_one_lenslet_missing_its_curve_is_not(tmp_path):
    def blunted(vertices):
        made = vertices.copy()
        low = made[:, 2].min()
        middle = np.hypot(*made[:, :2].T) < 0.4 * np.ptp(made[:, 0]) / 3
        made[middle & (made[:, 2] < made[:, 2].mean()), 2] = low
        return made

    checks = judged(sent_back(tmp_path / "part.stl", blunted))
    assert checks["shape"].state == "fail"


@pytest.mark.long
def test_the_command_line_judges_a_file_of_another_program(tmp_path, capsys):
    path = sent_back(tmp_path / "part.obj")
    status = main(
        ["verify", DESIGN, "--files", str(path), "--cells", "3x3", "--role", "preview", "--json", "-q"]
    )
    report = json.loads(capsys.readouterr().out)
    assert (status, report["passed"]) == (0, True)
    assert report["files"][0]["format"] == "obj"
