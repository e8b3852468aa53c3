"""Files of sheets whose cells differ: judged by light through their own faces and triangles, mutants found out."""

from dataclasses import replace

import numpy as np
import pytest

import clacad
from clacad.formats.mesh.readers import read_mesh
from clacad.formats.mesh.stl import write_stl
from clacad.formats.step.step_files import write_step
from clacad.mesh import tessellate
from clacad.sheet.need_window import CellsDiffer
from clacad.verification.files.inspection import Inspection
from clacad.verification.files.mesh_file import judge_mesh

DESIGN = clacad.Design.from_dict(
    {
        "format": 1, "name": "aimed", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
        "pair": {"form": "slab", "separation": 10, "material": "PMMA", "surface": "biconic", "conic": [-0.7, -0.7]},
        "lattice": {"pitch": 0.5, "count": [3, 3], "aperture": {"point": [-40, 10, -400]}},
        "check": {"field": "0.1 deg", "law_rms": "1 mrad", "law_bias": "1 mrad"},
    }
)  # fmt: skip


def checks_of(report):
    return {check.id: check for check in report.checks if check.subject.endswith(".step")}


def one_vertex_moved(window):
    """Lens 2 of cell (2, 0) stands a fiftieth of the pitch from its place."""
    body = window.bodies[0]
    table = body.back.change.table.copy()
    table[2, 0] += (0.01, 0.0)
    back = replace(body.back, change=replace(body.back.change, table=table))
    return replace(window, bodies=(replace(body, back=back),))


def wrong_pitch(window):
    """Array 2, its lenses with it, was made to the pitch of array 1."""
    first, second = window.placements
    return replace(window, placements=(first, replace(second, pitch=window.lattice.pitch)))


def aimed_elsewhere(window):
    """The sheet of a viewer 6 mm beside."""
    return clacad.prescribe(DESIGN.replace("lattice.aperture", {"point": [-46, 10, -400]}))


def test_a_step_file_of_cells_that_differ_is_a_master_and_says_of_how_many(tmp_path):
    manifest = clacad.export(DESIGN, tmp_path / "out", formats=("step",))
    entry = next(one for one in manifest.files if one["format"] == "step")
    assert entry["solids"] == 1
    assert entry["mode"] == "fused"
    report = clacad.verify(DESIGN, files=tmp_path / "out", rays=4096)
    assert report.word.startswith("passed"), [c.sentence for c in report.checks if c.state == "fail"]
    found = checks_of(report)
    assert found["file_law_rms"].detail["cells"]
    assert len(found["file_law_rms"].detail["by_cell"]) == 9
    assert found["volume"].value < 1e-8


@pytest.mark.parametrize("spoil", [one_vertex_moved, wrong_pitch, aimed_elsewhere])
def test_light_finds_out_a_sheet_that_was_made_otherwise(spoil, tmp_path):
    made = spoil(clacad.prescribe(DESIGN))
    path = tmp_path / "mutant.step"
    write_step(made, path)
    report = clacad.verify(DESIGN, files=path, rays=4096)
    light = [
        check for check in report.checks
        if check.id in ("file_law_rms", "file_law_bias", "file_throughput", "file_law_delta") and check.state == "fail"
    ]  # fmt: skip
    assert light, [(c.id, c.state, c.sentence) for c in report.checks if c.id.startswith("file_")]


def test_formats_of_equal_cells_are_refused_by_one_code_before_any_work(tmp_path):
    with pytest.raises(CellsDiffer, match="CL139.*step"):
        clacad.export(DESIGN, tmp_path / "out", formats=("gds",))
    assert not (tmp_path / "out").exists()


def test_the_heights_of_the_steps_between_neighbours_are_named_and_fail_a_diamond_tool():
    from clacad.advice import judge

    checks = {c.id: c for c in judge(DESIGN.replace("check.process", "diamond-turning")).rules}
    wall = checks["wall"]
    assert wall.state == "fail"
    apart = (
        np.hypot(40, 10) / 400 * 10 * 0.5 / 2.468
    )  # p |vertex offset| / R2, both meridians at the worst border
    assert 0.5 * apart < wall.value < 1.3 * apart
    assert f"{wall.value:.4g} mm high" in wall.sentence


QUADS = 16
LIGHT = {
    "file_law_bias", "file_law_delta", "file_confocality", "faithful_rms", "faithful_eta", "faithful_delta"
}  # fmt: skip
"""What 16 facets a side do not make fail: the law's rms is theirs, 4 mrad."""


def judged(spoil, path):
    """Checks of an STL file of the spoilt sheet, held against the design."""
    made = spoil(clacad.prescribe(DESIGN))
    write_stl(tessellate(made, quads=QUADS).bodies, path, 1.0, "mutant")
    asked = Inspection(DESIGN, path.name, 2048)
    checks, _ = judge_mesh(asked, clacad.prescribe(DESIGN), read_mesh(path), 1.0)
    return {check.id: check for check in checks}


@pytest.mark.slow
def test_light_through_the_triangles_of_cells_that_differ_is_that_of_the_design(tmp_path):
    found = judged(lambda window: window, tmp_path / "sheet.stl")
    for name in (*LIGHT, "closed", "pieces", "volume", "shape", "scale", "file_throughput"):
        assert found[name].state == "pass", found[name].sentence
    assert len(found["faithful_rms"].detail["cells"]) == 9


@pytest.mark.slow
@pytest.mark.parametrize("spoil", [one_vertex_moved, wrong_pitch, aimed_elsewhere])
def test_light_through_triangles_finds_out_a_sheet_that_was_made_otherwise(spoil, tmp_path):
    found = judged(spoil, tmp_path / "mutant.stl")
    assert [name for name in LIGHT if found[name].state == "fail"], {k: c.state for k, c in found.items()}
