"""One call writes a design's files: each read back and compared with the design, published as one set."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import textwrap
import time
import tracemalloc
from collections.abc import Iterator
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clacad
from clacad.design import Design
from clacad.exporting.run import (
    ExportIncomplete,
    ExportRefused,
    FileDisagrees,
    LimitRefused,
    UnknownFormat,
    export,
)
from clacad.exporting.tessellations import Tessellation
from clacad.formats.mesh.compare_triangles import Promise, compare_mesh
from clacad.formats.mesh.file_mesh import CHUNK, FileMesh, Part
from clacad.formats.mesh.readers import read_mesh
from clacad.formats.mesh.stl import write_stl
from clacad.prescription.prescribe import prescribe
from clacad.sheet.volume_and_extent import body_volume
from clacad.sheet.window import lens_height
from clacad.storage.atomic import MANIFEST
from clacad.verification import verify

DESIGNS = Path(__file__).parents[2] / "designs"
MESHES = ("stl", "3mf", "ply", "glb")
FORMS = [
    "paper-a-covered.toml", "paper-base.toml", "tilted.toml", "tilted-seam.toml", "tilted-biconvex.toml",
    "plano.toml", "galilean.toml", "fig5-phi-45.toml",
]  # fmt: skip
CELLS = (4, 3)


def design(name: str = "paper-a-covered.toml", *overrides: str) -> Design:
    return clacad.load(DESIGNS / name, overrides=list(overrides))


def leftovers(folder: Path) -> list[str]:
    return [p.name for p in folder.iterdir() if p.name.startswith(".clacad-")] if folder.exists() else []


# -- what comes out ------------------------------------------------------------------------------


@pytest.mark.ci_cases("tilted-seam.toml", "plano.toml", "galilean.toml")
@pytest.mark.daily_cases("paper-a-covered.toml")
@pytest.mark.parametrize("name", FORMS)
def test_every_mesh_format_of_every_form_agrees_with_its_design(tmp_path: Path, name: str) -> None:
    manifest = export(design(name), tmp_path, formats=MESHES, quads=6, cells=CELLS)
    assert {e["format"] for e in manifest.files} == {"stl-binary", "3mf", "ply", "glb"}
    for entry in manifest.files:
        assert {"closed", "shape", "volume"} <= set(entry["checks"])
        data = (tmp_path / entry["name"]).read_bytes()
        assert (len(data), sha256(data).hexdigest()) == (entry["bytes"], entry["sha256"])
        assert entry["volume"] == pytest.approx(entry["volume_exact"], rel=0.05)


@pytest.mark.slow
def test_a_hexagonal_disc_is_exported(tmp_path: Path) -> None:
    manifest = export(design("hexagonal.toml"), tmp_path, formats=("stl", "3mf"), quads=4)
    assert all("closed" in e["checks"] for e in manifest.files)


@pytest.mark.slow
def test_the_exact_solids_come_out_with_the_integral_as_their_volume(tmp_path: Path) -> None:
    manifest = export(design(), tmp_path, formats=("step",), cells=(2, 2))
    entry = manifest.files[0]
    assert {"closed", "shape", "volume"} <= set(entry["checks"])
    assert entry["volume"] == pytest.approx(entry["volume_exact"], rel=1e-9)


@pytest.mark.slow
def test_the_manifest_says_what_was_written_and_nothing_about_the_machine(tmp_path: Path) -> None:
    made = design()
    manifest = export(made, tmp_path / "out", formats=("stl", "table"), quads=4, cells=CELLS)
    text = (tmp_path / "out" / MANIFEST).read_text()
    found: dict[str, Any] = json.loads(text)
    assert found == manifest.document
    assert text == json.dumps(found, sort_keys=True, indent=1, ensure_ascii=False) + "\n"
    assert found["format"] == 1
    assert found["design"] == {"name": made.name, "sha256": made.sha256, "toml": made.toml}
    window = found["window"]
    assert window["cells_written"] == list(CELLS)
    assert window["count"] == [200, 200]
    assert window["handedness"] == "right"
    assert window["pieces"] == [1, 1]
    assert window["pitch"] == [5.0, 5.0]
    stl = next(e for e in found["files"] if e["format"] == "stl-binary")
    assert stl["bodies"] == ["array1", "array2"]
    assert stl["float"] == "f32"
    assert stl["pose"] == "sheet frame"
    for secret in (
        str(tmp_path),
        os.uname().nodename,
        str(time.localtime().tm_year),
        os.environ.get("USER", "?!"),
    ):
        assert secret not in text
    assert json.loads((tmp_path / "out" / "run.json").read_text())["seconds"]["stl"] > 0


@pytest.mark.slow
def test_metres_become_millimetres_on_the_way_out(tmp_path: Path) -> None:
    """The paper's design is in metres, its files in millimetres, GLB in metres again."""
    manifest = export(design(), tmp_path, formats=MESHES, quads=4, cells=CELLS)
    for entry in manifest.files:
        mesh = read_mesh(tmp_path / entry["name"])
        low, high = mesh.box()
        assert mesh.unit is not None
        np.testing.assert_allclose((high - low)[:2] * mesh.unit, [0.020, 0.015], rtol=1e-6)


@pytest.mark.slow
def test_each_body_can_have_a_file_of_its_own(tmp_path: Path) -> None:
    manifest = export(design(), tmp_path, formats=("stl-parts",), quads=4, cells=CELLS)
    assert [e["bodies"] for e in manifest.files] == [["array1"], ["array2"]]
    for entry, body in zip(manifest.files, clacad.prescribe(design().with_cells(CELLS)).bodies):
        integral = body_volume(clacad.prescribe(design().with_cells(CELLS)), body)
        assert integral is not None
        assert entry["volume_exact"] == pytest.approx(integral.value * 1e9, rel=1e-9)


@pytest.mark.slow
def test_a_stranger_reads_every_mesh_with_the_volume_of_the_design(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("networkx")
    manifest = export(design("tilted-seam.toml"), tmp_path, formats=MESHES, quads=6, cells=CELLS)
    for entry in manifest.files:
        scene = trimesh.load(tmp_path / entry["name"])
        mesh = scene.to_mesh() if hasattr(scene, "to_mesh") else scene
        mesh.merge_vertices(merge_norm=True)
        assert mesh.volume == pytest.approx(entry["volume"], rel=1e-6)
        assert mesh.is_watertight


@pytest.mark.slow
def test_manifold_and_lib3mf_accept_what_is_written(tmp_path: Path) -> None:
    manifold3d = pytest.importorskip("manifold3d")
    lib3mf = pytest.importorskip("lib3mf")
    export(design("tilted-seam.toml"), tmp_path, formats=("stl", "3mf"), quads=6, cells=CELLS)
    corners = np.concatenate(list(read_mesh(tmp_path / "tilted-seam.stl").chunks()))
    vertices, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    solid = manifold3d.Manifold(
        manifold3d.Mesh64(vert_properties=vertices, tri_verts=index.reshape(-1, 3).astype(np.uint64))
    )
    assert solid.status() == manifold3d.Error.NoError
    assert len(solid.decompose()) == 1
    assert solid.genus() == 0
    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.ReadFromFile(str(tmp_path / "tilted-seam.3mf"))
    assert reader.GetWarningCount() == 0
    meshes = model.GetMeshObjects()
    while meshes.MoveNext():
        assert meshes.GetCurrentMeshObject().IsManifoldAndOriented()


CORNERED = """
format = 1
name = "cornered"
unit = "mm"
[law]
eta = [-1.2, -0.8]
[pair]
form = "biconvex"
separation = 10.0
thickness = "auto"
web = 0.1
material = "PMMA"
[lattice]
kind = "rectangular"
pitch = [0.6, 0.4]
count = [2, 2]
"""


def cornered(folder: Path) -> Design:
    """Lenses whose heights are rounded to steps of a millionth of their pitch, with slivers at the corners of the cells."""
    path = folder / "cornered.toml"
    path.write_text(CORNERED, encoding="utf-8")
    return clacad.load(path)


@pytest.mark.parametrize("instanced", [True, False])
def test_every_vertex_has_the_normal_of_its_lens_its_land_or_its_wall(
    tmp_path: Path, instanced: bool
) -> None:
    window = prescribe(cornered(tmp_path)).with_cells((1, 1))
    h = 1e-6
    for body, piece in zip(
        window.bodies, Tessellation(window, 32).pieces(instanced, normals=True), strict=True
    ):
        vertices, normals, _ = piece.whole
        assert normals is not None
        level = np.abs(normals[:, 2])
        lens = (level > 1e-9) & (level < 1.0 - 1e-9)
        assert lens.sum() > 2 * 31**2  # inner vertices of both faces
        (x, y, _), normal = vertices[lens].T, normals[lens]
        for face, mine in ((body.front, normal[:, 2] < 0.0), (body.back, normal[:, 2] > 0.0)):
            steps = [lens_height(face, x + i * h, y + j * h) for i, j in ((1, 0), (-1, 0), (0, 1), (0, -1))]
            slope = np.stack([steps[0] - steps[1], steps[2] - steps[3]], axis=1) / (2.0 * h)
            seen = -normal[mine, :2] / normal[mine, 2:]
            # differences: 2e-15 mm of height over 2e-6 mm
            np.testing.assert_allclose(seen, slope[mine], atol=1e-8)


# -- sameness --------------------------------------------------------------------------------------

EXPORT = textwrap.dedent(
    """
    import sys, clacad
    from clacad.exporting.run import export
    design = clacad.load(sys.argv[1])
    export(design, sys.argv[2], formats=sys.argv[3].split(","), quads=4, cells=(3, 2))
    """
)


def run(code: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
    env = os.environ | {"PYTHONPATH": path} | environment
    return subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, env=env)


@pytest.mark.slow
def test_same_design_and_options_give_the_same_bytes_in_every_format(tmp_path: Path) -> None:
    formats = "step,stl,stl-parts,3mf,ply,glb,sag,tiff,png,xyz,table,mask"
    source = str(DESIGNS / "tilted-seam.toml")
    first = run(EXPORT, source, str(tmp_path / "a"), formats, PYTHONHASHSEED="0", TZ="UTC")
    second = run(EXPORT, source, str(tmp_path / "b b"), formats, PYTHONHASHSEED="1", TZ="Asia/Tokyo", LC_ALL="de_DE.UTF-8",
                 OMP_NUM_THREADS="1")  # fmt: skip
    assert (first.returncode, second.returncode) == (0, 0), first.stderr + second.stderr
    one, two = (
        {p.name: p.read_bytes() for p in (tmp_path / d).iterdir() if p.name != "run.json"}
        for d in ("a", "b b")
    )
    assert one == two


@pytest.mark.slow
def test_writing_again_changes_nothing_and_other_formats_join_the_set(tmp_path: Path) -> None:
    made = design()
    first = export(made, tmp_path, formats=("stl",), quads=4, cells=CELLS)
    stamp = (tmp_path / "paper-a-covered.stl").read_bytes()
    export(made, tmp_path, formats=("stl",), quads=4, cells=CELLS)
    assert (tmp_path / "paper-a-covered.stl").read_bytes() == stamp
    both = export(made, tmp_path, formats=("table",), cells=CELLS)
    assert {e["name"] for e in first.files} < {e["name"] for e in both.files}
    other = export(
        design("paper-a-covered.toml", "law.eta=[-0.5,-1]"), tmp_path, formats=("table",), cells=CELLS
    )
    assert "stl-binary" not in {e["format"] for e in other.files}
    assert not (tmp_path / "paper-a-covered.stl").exists(), "a part of another design would mislead"


@pytest.mark.slow
def test_a_file_that_is_not_ours_is_refused_before_any_work(tmp_path: Path) -> None:
    (tmp_path / "paper-a-covered.stl").write_text("precious")
    with pytest.raises(ExportRefused, match="paper-a-covered.stl"):
        export(design(), tmp_path, formats=("stl",), quads=4, cells=CELLS)
    assert [p.name for p in tmp_path.iterdir()] == ["paper-a-covered.stl"]
    export(design(), tmp_path, formats=("stl",), quads=4, cells=CELLS, overwrite=True)


# -- limits ----------------------------------------------------------------------------------------


@pytest.fixture
def _no_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """All costly steps fail: surfaces, meshes, the worker, the folder."""
    run = import_module("clacad.exporting.run")

    def worked(*_: object, **__: object) -> None:
        pytest.fail("work was begun")

    for name in ("_prescribed", "Meshes", "Worker", "Stage", "forecast"):
        monkeypatch.setattr(run, name, worked)


@pytest.mark.usefixtures("_no_work")
@pytest.mark.parametrize("count", ["31623,31623", "1000000000,1000000000", "1,1000000000000000000"])
def test_a_design_of_too_many_lenslets_is_refused_before_any_work(tmp_path: Path, count: str) -> None:
    made = design("paper-a-covered.toml", f"lattice.count=[{count}]")
    for formats in (("stl",), ("step",), ("3mf", "table"), ("mask",)):
        with pytest.raises(LimitRefused, match=r"lenslets.*use .* or ") as caught:
            export(made, tmp_path / "out", formats=formats)
        assert caught.value.exit_status == 3
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("_no_work")
def test_too_fine_a_mesh_is_refused_with_the_number_and_two_ways_out(tmp_path: Path) -> None:
    with pytest.raises(LimitRefused, match=r"facets.*quads=\d+ or cells=\(\d+, \d+\)") as caught:
        export(design(), tmp_path, formats=("stl",), quads=64)
    assert "655,360,000 facets" in str(caught.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_an_unreachable_slope_error_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LimitRefused, match="facets"):
        export(design(), tmp_path, formats=("stl",), slope_error=1e-3)


@pytest.mark.slow
def test_a_slope_error_is_met(tmp_path: Path) -> None:
    manifest = export(design(), tmp_path, formats=("stl",), slope_error=0.02, cells=(2, 2))
    assert 0.01 < manifest.files[0]["slope_error_rms"] <= 0.02


@pytest.mark.long
def test_a_default_mesh_has_the_coarsest_grid_that_keeps_well_within_the_limit(tmp_path: Path) -> None:
    """Light through the file itself: .95 of the limit is met by the grid that is chosen, and not by half of it."""
    part = design().with_cells((2, 2))
    quads = export(part, tmp_path / "default", formats=("stl",)).files[0]["quads"]
    export(part, tmp_path / "half", formats=("stl",), quads=quads // 2)
    rms = [
        next(one.value for one in verify(part, tmp_path / name, rays=2000).checks if one.id == "file_law_rms")
        for name in ("default", "half")
    ]
    assert rms[0] <= 0.95 * part.check.law_rms < rms[1]


MAPS = ("table", "mask", "xyz", "png", "tiff", "sag")
FORECAST = [
    ("tilted-seam.toml", (10, 9), ("step", *MESHES, *MAPS)), ("paper-a-covered.toml", (9, 11), (*MESHES, *MAPS, "pov")),
    ("plano.toml", (7, 6), (*MESHES, *MAPS)), ("slab.toml", (10, 5), (*MESHES, *MAPS)),
    ("hexagonal.toml", (8, 8), (*MESHES, *MAPS)), ("tilted-biconvex.toml", (6, 9), MESHES),
]  # fmt: skip


@pytest.mark.daily_cases("slab.toml")
@pytest.mark.parametrize(("name", "cells", "formats"), [
    pytest.param(*row, id=row[0], marks=() if row[0] in ("slab.toml", "plano.toml") else pytest.mark.long) for row in FORECAST
])  # fmt: skip
def test_forecasts_hold(tmp_path: Path, name: str, cells: tuple[int, int], formats: tuple[str, ...]) -> None:
    """Facets and STL bytes exactly, the rest within 20 %."""
    manifest = export(design(name), tmp_path, formats=formats, quads=8, cells=cells)
    sizes: dict[str, int] = {}
    facets: dict[str, int] = {}
    word = {"stl-binary": "stl", "tiff32": "tiff", "tiff16": "tiff", "png16": "png", "xyz-normals": "xyz", "grid-sag": "sag",
            "surface-table": "table", "pose-table": "table", "mask-svg": "mask", "mask-dxf": "mask"}  # fmt: skip
    for entry in manifest.files:
        kind = word.get(entry["format"], entry["format"])
        sizes[kind] = sizes.get(kind, 0) + entry["bytes"]
        facets[kind] = facets.get(kind, 0) + entry.get("triangles", 0)
    rows = {row["format"]: row for row in manifest.run["forecast"]}
    assert set(rows) == set(formats)
    for kind, row in rows.items():
        if row["facets"] is not None:
            assert row["facets"] == facets[kind], kind
        if row["exact"]:
            assert row["bytes"] == sizes[kind], kind
        else:
            assert row["bytes"] == pytest.approx(sizes[kind], rel=0.2), kind
    assert rows["stl"]["exact"]
    assert rows["stl"]["bytes"] == 84 + 50 * facets["stl"]


@pytest.mark.parametrize("formats", [("stp",), (), ("stl", "exe")])
def test_an_unknown_format_is_named(tmp_path: Path, formats: tuple[str, ...]) -> None:
    with pytest.raises(UnknownFormat, match="allowed: step, stl") as caught:
        export(design(), tmp_path, formats=formats)
    assert caught.value.exit_status == 2


# -- a file that is not the design is caught ---------------------------------------------------------


@pytest.fixture(scope="module")
def good() -> tuple[Any, Any, Promise]:
    """Corners of a good mesh, its window and its promise."""
    window = clacad.prescribe(design("tilted-seam.toml").with_cells(CELLS))
    tessellation = Tessellation(window, 6)
    corners = np.concatenate([rows for body in tessellation.mesh.bodies for rows in body.rows()])
    return corners, window, tessellation.promise(instanced=False, single=False)


def held(corners: Any, window: Any, promise: Promise) -> None:
    volume = body_volume(window, window.bodies[0])
    compare_mesh(FileMesh("test", (Part("", soup=corners),), window.unit), window, promise, "x.stl", volume)


def test_the_good_mesh_passes(good: tuple[Any, Any, Promise]) -> None:
    held(*good)


def test_reading_back_a_stream_takes_memory_for_a_chunk_of_it_whatever_its_size(tmp_path: Path) -> None:
    """Few facets were welded, which took more than a hundred times the bytes of their corners; many were not."""
    window = clacad.prescribe(design("paper-a-covered.toml").with_cells((30, 30)))
    tessellation = Tessellation(window, 8)
    promise = tessellation.promise(instanced=False, single=True)
    write_stl(tessellation.mesh.bodies, tmp_path / "x.stl", window.unit * 1e3, "x")
    mesh = read_mesh(tmp_path / "x.stl")
    compare_mesh(mesh, window, promise, "x.stl")
    tracemalloc.start()
    try:
        compare_mesh(mesh, window, promise, "x.stl")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert promise.facets > 2 * CHUNK
    assert peak < 8 * CHUNK * 72  # corners of a facet: 72 bytes


def mutations() -> Iterator[tuple[str, Any]]:
    yield "a facet dropped", lambda c: c[1:]
    yield "a facet doubled", lambda c: np.concatenate([c, c[:1]])
    yield "a facet turned over", lambda c: np.concatenate([c[:1, ::-1], c[1:]])
    yield "all turned over", lambda c: c[:, ::-1]
    yield "inches", lambda c: c * 25.4
    yield "millimetres as metres", lambda c: c * 1000.0
    yield "shrunk by 0.2 %", lambda c: c * 0.998
    yield "moved along z", lambda c: c + [0.0, 0.0, 1e-3]
    yield "moved by a tenth of a pitch", lambda c: c + [0.05, 0.0, 0.0]
    yield "mirrored", lambda c: (c * [-1.0, 1.0, 1.0])[:, ::-1]
    yield "turned by 90 degrees", lambda c: np.stack([-c[..., 1], c[..., 0], c[..., 2]], axis=-1)
    yield "turned by 180 degrees", lambda c: c * [-1.0, -1.0, 1.0]
    yield "light from behind", lambda c: c * [1.0, -1.0, -1.0] + [0.0, 0.0, c[..., 2].max() + c[..., 2].min()]


@pytest.mark.parametrize(("what", "change"), list(mutations()), ids=lambda v: v if isinstance(v, str) else "")
def test_a_mesh_that_is_not_the_design_is_caught(
    good: tuple[Any, Any, Promise], what: str, change: Any
) -> None:
    corners, window, promise = good
    with pytest.raises(FileDisagrees):
        held(np.ascontiguousarray(change(corners)), window, promise)


@pytest.mark.parametrize("override", ["law.eta=[-0.735,-0.735]", "law.delta=[0.02,0]", "law.euler=[1,2,0]"])
def test_the_mesh_of_another_design_is_caught(good: tuple[Any, Any, Promise], override: str) -> None:
    corners, _, promise = good
    key = override.split("=")[0]
    other = clacad.prescribe(design("tilted-seam.toml", override).with_cells(CELLS))
    assert key
    with pytest.raises(FileDisagrees):
        held(corners, other, promise)


@pytest.mark.slow
def test_one_format_that_fails_does_not_stop_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from clacad.formats.mesh import threemf

    def broken(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(threemf, "write_threemf", broken)
    with pytest.raises(ExportIncomplete, match="3mf.*no space left") as caught:
        export(design(), tmp_path, formats=("stl", "3mf", "table"), quads=4, cells=CELLS)
    assert caught.value.exit_status == 4
    assert {e["format"] for e in caught.value.manifest.files} == {"stl-binary", "surface-table", "pose-table"}
    assert not (tmp_path / "paper-a-covered.3mf").exists()
    assert not leftovers(tmp_path)


# -- faults ----------------------------------------------------------------------------------------

LIMITED = textwrap.dedent(
    """
    import resource, sys, clacad
    from clacad.exporting.run import export, ExportError
    design = clacad.load(sys.argv[1])
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[3]),) * 2)
    try:
        export(design, sys.argv[2], formats=("stl", "ply", "table"), quads=2, cells=(2, 2))
    except ExportError as error:
        print(error)
        sys.exit(error.exit_status)
    """
)


@pytest.mark.slow
def test_whichever_write_fails_only_complete_files_appear(tmp_path: Path) -> None:
    statuses = []
    for limit in (100, 2_000, 4_500, 7_000, 12_000, 40_000):
        out = tmp_path / str(limit)
        done = run(LIMITED, str(DESIGNS / "paper-a-covered.toml"), str(out), str(limit))
        statuses.append(done.returncode)
        assert done.returncode in (0, 4), done.stderr
        assert "Traceback" not in done.stderr
        assert not leftovers(out)
        files = {p.name for p in out.iterdir()}
        if MANIFEST in files:
            listed = json.loads((out / MANIFEST).read_text())["files"]
            assert files == {e["name"] for e in listed} | {MANIFEST, "run.json"}
            assert all((out / e["name"]).stat().st_size == e["bytes"] for e in listed)
        else:
            assert not files
    assert statuses[0] == 4
    assert statuses[-1] == 0


SLOW = textwrap.dedent(
    """
    import os, sys, threading, clacad
    from clacad.exporting.run import export
    design = clacad.load(sys.argv[1])

    def told(name, done):
        "At a stage that was named the process is sent its signal a moment later, however busy the machine is."
        print(name, flush=True)
        if name in sys.argv[3:]:
            threading.Timer(0.05, os.kill, (os.getpid(), int(sys.argv.pop()))).start()
            sys.argv.pop()

    try:
        export(design, sys.argv[2], formats=("step", "stl", "3mf"), quads=16, cells=(10, 10), progress=told)
    except KeyboardInterrupt:
        sys.exit(130)
    """
)


def started(out: Path, *signalled: str) -> subprocess.Popen[str]:
    """An export of some seconds; `signalled`: a stage, and the number of the signal that comes in it."""
    path = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
    command = [sys.executable, "-c", SLOW, str(DESIGNS / "tilted-seam.toml"), str(out), *signalled]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ | {"PYTHONPATH": path})


@pytest.mark.daily_cases("forecast-15")
@pytest.mark.parametrize(
    ("stage", "number"),
    [
        ("forecast", signal.SIGTERM),
        ("write tilted-seam.step", signal.SIGTERM),
        ("read back tilted-seam.step", signal.SIGINT),
        ("write tilted-seam.stl", signal.SIGINT),
    ],
)
def test_an_interrupted_export_ends_and_leaves_nothing(tmp_path: Path, stage: str, number: int) -> None:
    caller = started(tmp_path / "out", stage, str(int(number)))
    said, _ = caller.communicate(timeout=200)
    assert caller.returncode == 130
    assert stage in said.splitlines()
    assert not (tmp_path / "out").exists() or list((tmp_path / "out").iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("times", [3, pytest.param(200, marks=pytest.mark.long)])
def test_a_killed_export_leaves_no_half_file_and_the_next_one_cleans_up(tmp_path: Path, times: int) -> None:
    chance = np.random.default_rng(0)
    for _ in range(times):
        caller = started(tmp_path)
        assert caller.stdout is not None
        caller.stdout.readline()
        time.sleep(float(chance.uniform(0.0, 3.0)))
        caller.kill()
        caller.communicate()
        present = {p.name for p in tmp_path.iterdir() if not p.name.startswith(".clacad-")}
        if MANIFEST in present:
            for entry in json.loads((tmp_path / MANIFEST).read_text())["files"]:
                assert sha256((tmp_path / entry["name"]).read_bytes()).hexdigest() == entry["sha256"]
        else:
            assert present <= {"tilted-seam.step", "tilted-seam.stl", "tilted-seam.3mf", "run.json"}
    export(design("tilted-seam.toml"), tmp_path, formats=("stl",), quads=4, cells=CELLS, overwrite=True)
    assert not leftovers(tmp_path)


AUDITED = textwrap.dedent(
    """
    import os, sys, clacad
    from pathlib import Path
    out = os.path.realpath(sys.argv[2])
    os.makedirs(out, exist_ok=True)
    bad = []
    def hook(event, args):
        if event.startswith("socket."):
            bad.append((event, str(args)[:100]))
        if event in ("os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.truncate", "os.link", "os.symlink") :
            paths = [a for a in args if isinstance(a, str)]
        elif event == "open" and isinstance(args[0], str) and (
            (isinstance(args[1], str) and set(args[1]) & set("wax+")) or (isinstance(args[2], int) and args[2] & (os.O_WRONLY | os.O_RDWR))
        ):
            paths = [args[0]]
        else:
            return
        for path in paths:
            if isinstance(args[-1], int) and args[-1] >= 0 and event in ("os.remove", "os.rmdir", "os.mkdir"):
                path = os.path.join(os.readlink(f"/proc/self/fd/{args[-1]}"), path)  # relative to an open folder
            full = os.path.realpath(path)
            if not full.startswith(out) and "__pycache__" not in full and full != "/dev/null":
                bad.append((event, full))
    design = clacad.load(sys.argv[1])
    sys.addaudithook(hook)
    from clacad.exporting.run import export
    export(design, out, formats=sys.argv[3].split(","), quads=4, cells=(2, 2))
    print(bad)
    sys.exit(bool(bad))
    """
)


@pytest.mark.slow
def test_nothing_is_written_outside_the_folder_and_no_socket_is_opened(tmp_path: Path) -> None:
    formats = "step,stl,stl-parts,3mf,ply,glb,sag,tiff,png,xyz,table,mask"
    done = run(AUDITED, str(DESIGNS / "tilted-seam.toml"), str(tmp_path / "out"), formats)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_a_mesh_export_loads_no_kernel(tmp_path: Path) -> None:
    code = EXPORT + "print(*sys.modules)"
    done = run(code, str(DESIGNS / "paper-a-covered.toml"), str(tmp_path), "stl,3mf,table")
    assert done.returncode == 0, done.stderr
    assert not {"OCP", "build123d", "trimesh", "matplotlib"} & {m.split(".")[0] for m in done.stdout.split()}
