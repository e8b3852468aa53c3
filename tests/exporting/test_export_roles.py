"""Roles of files, facets a format, and the light forecast through them: against numbers measured elsewhere."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import clacad
from clacad.exporting.forecast import forecast
from clacad.exporting.light_forecast import POWERS, Grader, LightLimits
from clacad.exporting.quads_and_roles import Sizes, asked_quads, asked_roles
from clacad.exporting.request import Request
from clacad.exporting.run import BadRequest, LimitRefused, export, forecast_rows
from clacad.exporting.tessellations import Meshes, weld
from clacad.mesh import tessellate

DESIGNS = Path(__file__).parents[2] / "designs"

# Light through facets, mrad rms from the law at 4, 8, 16, 32, 64 quads a cell side: traced through the triangles of
# the files themselves by a program of its own.
MEASURED = {
    "paper-a-covered": (2.65, (54.4, 27.3, 13.8, 7.0, 4.1)),
    "window-100mm": (0.17, (14.0, 7.2, 3.6, 1.8, 0.92)),
    "galilean": (0.02, (7.0, 3.6, 1.8, 0.88)),
    "slab": (0.61, (27.4, 14.0, 7.0, 3.5, 1.9)),
}


def design_of(name: str, cells: tuple[int, int] | None = None) -> clacad.Design:
    design = clacad.load(DESIGNS / f"{name}.toml")
    return design if cells is None else design.with_cells(cells)


def grader_of(name: str) -> Grader:
    design = design_of(name)
    return Grader.of(Meshes(clacad.prescribe(design)), design)


def small(name: str = "small") -> clacad.Design:
    return clacad.Design.from_dict(
        {"format": 1, "name": name, "unit": "mm", "law": {"eta": [-0.5, -1.0]},
         "pair": {"form": "slab", "separation": 10.0, "material": "PMMA"},
         "lattice": {"kind": "square", "pitch": 0.5, "count": [3, 3]}}
    )  # fmt: skip


def command(*words: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "clacad", *map(str, words)], capture_output=True, text=True, check=False
    )


# -- forecast of light -----------------------------------------------------------------------------


@pytest.mark.daily_cases("slab")
@pytest.mark.parametrize("name", MEASURED)
def test_light_through_coarse_and_fine_facets_is_forecast_as_measured(name):
    grader, (exact, rows) = grader_of(name), MEASURED[name]
    assert 1e3 * grader.exact == pytest.approx(exact, rel=0.03, abs=0.006)
    for quads, measured in zip((4, 8, 16, 32, 64), rows, strict=False):
        rounded = 0.5 * 10.0 ** (np.floor(np.log10(measured)) - 1)  # two or three digits were written down
        assert 1e3 * grader.grade(quads).rms == pytest.approx(measured, rel=0.03, abs=rounded), quads


@pytest.mark.slow
@pytest.mark.parametrize(("name", "grids"), [("tilted", (4, 16)), ("galilean", (64,))])
def test_light_through_facets_is_forecast_as_the_kernels_of_rung_mesh_trace_the_sheet(name, grids):
    design = design_of(name, (5, 5))
    window = clacad.prescribe(design)
    lit = clacad.sheet.bundle.bundle(window, 8192, design.check.field)
    asked = design.law.refract(lit.rays.direction)
    grader = Grader.of(Meshes(window), design)
    for quads in grids:
        seen = clacad.trace(window, lit.rays, rung="mesh", mesh=tessellate(window, quads=quads))
        alive = seen.fate == clacad.Fate.ALIVE
        cosine = np.clip((seen.direction[alive] * asked[alive]).sum(axis=1), -1.0, 1.0)
        assert grader.grade(quads).rms == pytest.approx(
            float(np.sqrt(np.mean(np.arccos(cosine) ** 2))), rel=0.02
        )


@pytest.mark.slow
def test_the_formula_tells_fine_grids_from_coarse_ones():
    """Rms angular error of the facets: 2.99 mrad measured at 128 quads, 2.75 at 256, from 1.38 · 128/256 and 2.65 of the exact surfaces."""
    grader = grader_of("paper-a-covered")
    assert 1e3 * grader.law_rms(128) == pytest.approx(2.99, rel=0.04)
    assert 1e3 * grader.law_rms(256) == pytest.approx(2.75, rel=0.03)
    assert grader.foreseen() == 256


@pytest.mark.slow
def test_heights_in_steps_make_fine_facets_worse_and_the_formula_knows():
    """paper-b is 90 mm thick in cells of 10 µm: its float32 heights turn facets of 64 quads and more."""
    grader = grader_of("paper-b")
    assert grader.law_rms(1024) > grader.grade(64).rms > grader.grade(32).rms
    assert grader.foreseen() in (16, 32)


@pytest.mark.daily_cases("0.01-8")
@pytest.mark.parametrize(("limit", "expected"), [(2e-2, 4), (1e-2, 8), (3e-3, 32), (1e-9, None)])
def test_the_smallest_power_of_two_within_95_percent_is_taken(limit, expected):
    """k/m with k = 63.7 mrad: 15.9 at 4, 8.0 at 8, 4.1 at 16, 2.1 at 32 quads, with .25 of the exact surfaces in addition."""
    design = design_of("tilted")
    grader = Grader(Meshes(clacad.prescribe(design)), LightLimits(limit), design.check.field)
    assert grader.foreseen() == expected
    assert grader.least(64) == expected


@pytest.mark.slow
def test_a_design_whose_exact_surfaces_miss_the_law_has_no_master_mesh():
    design = design_of("paper-a-covered", (2, 2)).replace({"check.law_rms": "2 mrad"})
    rows = forecast_rows(design, Request(("3mf",), quads={"3mf": "auto"}))
    assert rows[0].prospect is not None
    entry = rows[0].prospect.entry()
    assert entry["role"] == "shape-preview"
    assert entry["master_quads"] is None
    assert entry["master_bytes"] is None


# -- auto -------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_auto_gives_the_paper_s_sheet_256_quads_in_a_3mf_that_is_small_and_its_stl_the_finest_that_fits():
    design = design_of("paper-a-covered")
    rows = {
        r.format: r
        for r in forecast_rows(design, Request(("3mf", "stl"), quads={"3mf": "auto", "stl": "auto"}))
    }
    assert rows["3mf"].quads == 256
    assert rows["3mf"].bytes < 10e6
    assert rows["3mf"].prospect.role == "optical-master"
    assert 1e3 * rows["3mf"].prospect.law_rms == pytest.approx(2.75, rel=0.03)
    assert rows["3mf"].stored == 4 * (2 * 256**2) + 2 * 4 * (
        2 * 256
    )  # four lens faces, and the walls of two columns
    assert rows["3mf"].facets == 40_000 * rows["3mf"].stored
    stl = rows["stl"]
    assert stl.quads == 8  # 16 quads are 4 · 16² · 2 · 40 000 = 82 M facets, more than 50 M
    assert stl.prospect.role == "shape-preview"
    assert stl.prospect.master_quads == 256
    assert stl.prospect.master_bytes == pytest.approx(50 * 8 * 256**2 * 40_000, rel=0.02)


def test_auto_gives_the_window_64_quads():
    rows = forecast_rows(
        design_of("window-100mm"), Request(("3mf", "glb"), quads={"3mf": "auto", "glb": "auto"})
    )
    assert [row.quads for row in rows] == [64, 64]
    assert all(row.prospect.role == "optical-master" and row.bytes < 5e6 for row in rows)


@pytest.mark.slow
def test_auto_keeps_every_limit_of_light_not_the_rms_alone():
    """Galilean at 16 quads: 1.8 mrad of 3, but the pair is .0033 of its separation out of focus, of .002.

    Both as the checks of files measure them, with their own rays, through the facets of the sheet.
    """
    from clacad.judging.file_light import measure_light

    design = design_of("galilean", (5, 5))
    window = clacad.prescribe(design)
    (row,) = forecast_rows(design, Request(("3mf",), quads={"3mf": "auto"}))
    assert row.quads == 32
    found = {}
    for quads in (16, 32):
        mesh = tessellate(window, quads=quads)
        light = measure_light(
            design,
            window,
            lambda lit, mesh=mesh: clacad.trace(window, lit.rays, rung="mesh", mesh=mesh),
            65536,
        )
        found[quads] = (
            light.light.rms <= design.check.law_rms,
            np.abs(light.shift).max() <= design.check.confocality,
        )
    assert found == {16: (True, False), 32: (True, True)}


def test_auto_chooses_from_powers_of_two_only():
    assert all(quads & (quads - 1) == 0 for quads in POWERS)
    assert (POWERS[0], POWERS[-1]) == (4, 1024)


# -- requests ---------------------------------------------------------------------------------------


def test_one_value_holds_for_all_meshes_and_a_mapping_for_those_it_names():
    assert asked_quads(4, ("step", "stl", "3mf")) == {"stl": 4, "3mf": 4}
    assert asked_quads("auto", ("glb",)) == {"glb": "auto"}
    assert asked_quads({"3mf": "auto"}, ("step", "stl", "3mf")) == {"3mf": "auto"}
    assert asked_roles("preview", ("step", "stl", "frame")) == dict.fromkeys(("step", "stl"), "shape-preview")
    assert asked_roles({"stl": "master"}, ("step", "stl")) == {"stl": "optical-master"}


@pytest.mark.parametrize(
    ("quads", "words"),
    [
        ("atuo", "did you mean auto"), (0, "above 0"), (True, "whole number"), (2.5, "whole number"),
        ({"stll": 4}, "did you mean stl"), ({"3mf": 4}, "not exported"), ({"step": 4}, "no facets"),
        ({"stl": "fine"}, "fine"),
    ],
)  # fmt: skip
def test_quads_that_cannot_be_understood_are_one_sentence(tmp_path, quads, words):
    with pytest.raises(BadRequest, match=words) as caught:
        export(small(), tmp_path / "out", ("step", "stl"), quads=quads)
    assert caught.value.exit_status == 2
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("role", "words"),
    [
        ("prevew", "did you mean preview"), ("scan", "measured"), ({"stl": "other"}, "master, preview"),
        ({"sl": "preview"}, "did you mean stl"), ({"glb": "preview"}, "not exported"), ({"frame": "master"}, "no light"),
    ],
)  # fmt: skip
def test_roles_that_cannot_be_understood_are_one_sentence(tmp_path, role, words):
    with pytest.raises(BadRequest, match=words):
        export(small(), tmp_path / "out", ("stl", "frame"), role=role)


@pytest.mark.daily_cases("words1-named twice", "words0-did you mean stl")
@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--quads", "3mf=auto,stll=4"), "did you mean stl"), (("--quads", "3mf=4,3mf=8"), "named twice"),
        (("--quads", "3mf=4,8"), "FORMAT=VALUE"), (("--quads", "-3"), "whole number"), (("--role", "3mf=print"), "print"),
        (("--quads", "glb=4"), "not exported"), (("--target", "1 mrad", "--quads", "3mf=8"), "--target"),
    ],
)  # fmt: skip
def test_the_command_refuses_what_it_does_not_understand_with_status_2(tmp_path, words, sentence):
    done = command(
        "export",
        DESIGNS / "slab.toml",
        "-o",
        tmp_path / "out",
        "--format",
        "3mf,stl",
        "--cells",
        "2x2",
        *words,
    )
    assert done.returncode == 2
    assert sentence in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


# -- manifest ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_every_file_says_its_role_and_meshes_what_light_does(tmp_path):
    design = small()
    manifest = export(
        design, tmp_path, ("step", "stl", "3mf", "table", "tiff"), quads={"stl": 4, "3mf": "auto"}
    )
    entries = {entry["name"]: entry for entry in manifest.files}
    assert all(entry["role_declared"] is False for entry in entries.values())
    stl, threemf = entries["small.stl"], entries["small.3mf"]
    assert stl["role"] == "shape-preview"
    assert stl["forecast_law_rms"] > design.check.law_rms
    assert stl["master_quads"] == threemf["quads"]
    assert stl["master_bytes"] == pytest.approx(84 + 50 * (threemf["triangles_stored"] * 9), rel=0.1)
    assert threemf["role"] == "optical-master"
    assert threemf["forecast_law_rms"] <= 0.95 * design.check.law_rms
    assert "master_quads" not in threemf
    assert threemf["triangles"] == 9 * threemf["triangles_stored"]
    exact = [entry for entry in entries.values() if entry["format"] not in ("stl-binary", "3mf")]
    assert len(exact) >= 6
    assert all(entry["role"] == "optical-master" and "forecast_law_rms" not in entry for entry in exact)
    assert manifest.document["options"]["quads"] == {"stl": 4, "3mf": "auto"}
    assert "role" not in manifest.document["options"]


@pytest.mark.slow
def test_declared_roles_stand_in_the_manifest_and_are_carried_over(tmp_path):
    export(small(), tmp_path, ("stl",), quads=8, role={"stl": "preview"})
    before = json.loads((tmp_path / "manifest.json").read_text())
    assert before["options"]["role"] == {"stl": "shape-preview"}
    export(small(), tmp_path, ("table",))
    after = json.loads((tmp_path / "manifest.json").read_text())
    kept = {entry["name"]: entry for entry in after["files"]}["small.stl"]
    assert kept == before["files"][0]
    assert (kept["role"], kept["role_declared"]) == ("shape-preview", True)
    assert {"forecast_law_rms", "master_quads", "master_bytes"} <= kept.keys()


@pytest.mark.slow
def test_a_declared_preview_of_which_nothing_else_is_said_is_coarse_while_masters_meet_the_slope_error(
    tmp_path,
):
    request = Request(("stl", "3mf"), slope_error=5e-3, role=asked_roles({"stl": "preview"}, ("stl", "3mf")))
    quads = {row.format: row.quads for row in forecast_rows(small(), request)}
    assert quads["stl"] == 4
    assert quads["3mf"] > 16


def test_a_frame_is_neither_master_nor_preview(tmp_path):
    found = forecast_rows(small(), Request(("frame", "pins", "coupon", "baffle", "pov", "brep", "marked")))
    roles = {row.format: str(row.prospect.role) for row in found}
    assert roles == dict.fromkeys(("frame", "pins", "coupon", "baffle", "pov"), "other") | dict.fromkeys(
        ("brep", "marked"), "optical-master"
    )


@pytest.mark.slow
def test_a_coarse_mesh_may_be_declared_a_master_and_the_command_warns(tmp_path):
    words = (
        "export",
        DESIGNS / "slab.toml",
        "-o",
        tmp_path / "out",
        "--format",
        "stl",
        "--cells",
        "2x2",
        "--quads",
        "4",
    )
    done = command(*words, "--role", "master", "-q")
    assert done.returncode == 0, done.stderr
    warnings = [line for line in done.stderr.splitlines() if "warning" in line]
    assert len(warnings) == 1
    assert "27." in warnings[0]
    assert "limit 3" in warnings[0]
    entry = json.loads((tmp_path / "out" / "manifest.json").read_text())["files"][0]
    assert (entry["role"], entry["role_declared"], entry["role_overstated"]) == ("optical-master", True, True)


@pytest.mark.slow
def test_the_command_prints_role_forecast_and_what_a_master_needs(tmp_path):
    words = ("export", DESIGNS / "slab.toml", "-o", tmp_path / "out", "--format", "stl,3mf", "--cells", "3x3",
             "--quads", "stl=4,3mf=auto", "--role", "stl=preview")  # fmt: skip
    told, done = command(*words, "--dry-run", "--all"), command(*words, "--all")
    assert (told.returncode, done.returncode) == (0, 0)
    assert not told.stderr.strip() or "warning" not in told.stderr
    for text in (told.stdout, done.stdout):
        assert "shape preview (declared); light through it misses the law by 27." in text
        assert "a master needs 64 quads a cell side" in text
        assert "optical master; light through it misses the law by 1.86 mrad rms (limit 3)" in text
        assert "facets stored" in text


# -- sizes and limits -------------------------------------------------------------------------------


@pytest.mark.ci_cases("8-hexagonal-cells2", "32-paper-a-covered-cells0", "32-slab-cells1")
@pytest.mark.daily_cases("8-slab-cells1")
@pytest.mark.parametrize(
    ("name", "cells"), [("paper-a-covered", (12, 9)), ("slab", (20, 20)), ("hexagonal", (6, 6))]
)
@pytest.mark.parametrize("quads", [8, 32])
def test_bytes_of_3mf_and_glb_are_forecast_within_a_fifth(tmp_path, name, cells, quads):
    design = design_of(name, cells)
    rows = forecast(Meshes(clacad.prescribe(design)), ("3mf", "glb"), quads)
    manifest = export(design, tmp_path, ("3mf", "glb"), quads=quads)
    for row in rows:
        assert row.bytes == pytest.approx(manifest.path(row.format).stat().st_size, rel=0.2), row.format


@pytest.mark.slow
def test_bytes_of_a_glb_whose_cells_are_one_node_are_forecast(tmp_path):
    design = design_of("slab", (90, 90))
    (row,) = forecast(Meshes(clacad.prescribe(design)), ("glb",), 2, Request(gpu_instancing=True))
    manifest = export(design, tmp_path, ("glb",), quads=2, gpu_instancing=True)
    assert row.bytes == pytest.approx(manifest.path("glb").stat().st_size, rel=0.05)


@pytest.mark.slow
def test_bytes_of_a_whole_sheet_of_repeated_cells_are_forecast_within_a_fifth(tmp_path):
    from clacad.formats.mesh.glb import write_glb
    from clacad.formats.mesh.threemf import write_threemf

    window = clacad.prescribe(design_of("window-100mm"))
    meshes = Meshes(window)
    rows = {row.format: row for row in forecast(meshes, ("3mf", "glb"), 64)}
    for kind, write in (("3mf", write_threemf), ("glb", write_glb)):
        write(
            meshes.at(64).pieces(True, normals=kind == "glb"), tmp_path / kind, window.unit / 1e-3, "window"
        )
        size = (tmp_path / kind).stat().st_size
        assert rows[kind].bytes == pytest.approx(size, rel=0.2), kind
        assert Sizes(meshes).bytes(kind, 64) == pytest.approx(size, rel=0.2), kind


@pytest.mark.slow
def test_bytes_of_a_master_that_was_not_meshed_follow_from_a_coarser_one(tmp_path):
    """Sizes from 16 quads represent 32, compared with the files of 32; 0.6 % of the facets are where land and outline meet."""
    design = design_of("tilted", (4, 4))
    sizes = Sizes(Meshes(clacad.prescribe(design)))
    manifest = export(design, tmp_path, ("stl", "3mf", "ply", "glb"), quads=32)
    for name in ("3mf", "ply", "glb"):
        assert sizes.bytes(name, 32) == pytest.approx(manifest.path(name).stat().st_size, rel=0.2), name
    assert sizes.bytes("stl", 32) == pytest.approx(manifest.path("stl-binary").stat().st_size, rel=0.01)


@pytest.mark.daily_cases("slab-cells0-stl-256", "slab-cells2-ply-128")
@pytest.mark.parametrize(
    ("name", "cells", "format", "quads"),
    [("slab", (40, 40), "stl", 256), ("slab", (3, 3), "stl", 8), ("slab", (300, 300), "ply", 128)],
)
def test_a_dry_run_accepts_what_an_export_accepts(tmp_path, name, cells, format, quads):
    request = Request((format,), quads={format: quads}, cells=cells)
    verdicts = []
    for attempt in (
        lambda: forecast_rows(design_of(name), request, tmp_path / "out"),
        lambda: export(design_of(name), tmp_path / "out", (format,), quads=quads, cells=cells),
    ):
        try:
            attempt()
        except LimitRefused as refusal:
            verdicts.append(str(refusal))
        else:
            verdicts.append("accepted")
    assert verdicts[0] == verdicts[1]
    assert (verdicts[0] == "accepted") == (quads == 8)


def test_rows_that_share_a_hash_but_differ_are_not_welded():
    """Corners and normals bit by bit, against the rows sorted as tuples."""
    rng = np.random.default_rng(5)
    corners = rng.integers(0, 3, (4000, 3, 3)).astype(np.float64)
    normals = rng.integers(-1, 2, (4000, 3, 3)).astype(np.float64)
    window = clacad.prescribe(small())
    piece = weld(window.bodies[0], corners, normals)
    rows = [tuple(row) for row in np.concatenate([corners, normals], axis=2).reshape(-1, 6).tolist()]
    order = list(dict.fromkeys((*(v + 0.0 for v in row),) for row in rows))
    vertices, smooth, triangles = piece.whole
    assert smooth is not None
    found = [tuple(row) for row in np.concatenate([vertices, smooth], axis=1).tolist()]
    assert found == order
    assert [found[k] for k in triangles.ravel()] == rows


@pytest.mark.slow
def test_the_convergence_check_says_from_how_many_quads_a_mesh_is_a_master_and_how_large_it_is():
    from clacad.verification.light.facet_convergence import converge, convergence_check

    design = design_of("slab")
    check = convergence_check(converge(design, clacad.prescribe(design), lambda *_: None, quads=(4, 8)))
    masters = check.to_dict()["detail"]["masters"]
    assert {name: one["quads"] for name, one in masters.items()} == dict.fromkeys(
        ("3mf", "glb", "stl", "ply"), 64
    )
    assert masters["stl"]["bytes"] == pytest.approx(1.3e9, rel=0.05)  # as measured elsewhere
    assert (masters["stl"]["fits"], masters["3mf"]["fits"], masters["ply"]["fits"]) == (True, True, False)
    assert "from 64 quads a side: 3mf" in check.sentence
