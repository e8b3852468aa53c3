"""A whole export: killed at any instant, repeated anywhere, and changed afterwards."""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trust.running import TINY, clacad, command, environment

from clacad.design import Design
from clacad.export import ExportError, export
from clacad.prescription import prescribe
from clacad.verify import CannotRegister, verify

ALL = "stl,stl-parts,3mf,ply,glb,sag,tiff,png,xyz,table,mask"


def tiny() -> Design:
    import tomllib

    return Design.from_dict(tomllib.loads(TINY))


@pytest.fixture(scope="session")
def design(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("design") / "tiny.toml"
    path.write_text(TINY)
    return path


def contents(folder: Path) -> dict[str, str]:
    """Hash of every file but the run facts."""
    return {
        p.name: sha256(p.read_bytes()).hexdigest() for p in sorted(folder.iterdir()) if p.name != "run.json"
    }


# -- killed ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("times", [5, pytest.param(200, marks=[pytest.mark.long, pytest.mark.timeout(1800)])])
def test_kill_9_at_any_instant_leaves_no_partial_file_and_the_next_run_no_trace(
    design: Path, tmp_path: Path, times: int
) -> None:
    """Commands of different formats, killed at random instants of their run, all into one folder."""
    chance = np.random.default_rng(times)
    out = tmp_path / "out"
    formats = ("step,stl", "3mf,table,xyz", "stl,ply,glb,mask")
    for turn in range(times):
        arguments = ["export", design, "-o", out, "--format", formats[turn % 3], "--quads", "8", "-q"]
        running = subprocess.Popen(command(arguments), stderr=subprocess.DEVNULL, env=environment())
        time.sleep(float(chance.uniform(0.2, 2.5)))
        running.kill()
        running.wait()
        if not out.exists():
            continue
        present = {p.name for p in out.iterdir() if not p.name.startswith(".clacad-")}
        if "manifest.json" in present:
            for entry in json.loads((out / "manifest.json").read_text())["files"]:
                assert sha256((out / entry["name"]).read_bytes()).hexdigest() == entry["sha256"]
    assert clacad("export", design, "-o", out, "--format", "stl", "--quads", "4", "--overwrite").status == 0
    assert not [p.name for p in out.iterdir() if p.name.startswith(".clacad-")]
    found = contents(out)
    for entry in json.loads((out / "manifest.json").read_text())["files"]:
        assert found.pop(entry["name"]) == entry["sha256"]
    assert set(found) == {"manifest.json"}


# -- repeated --------------------------------------------------------------------------------------

CIRCUMSTANCES: dict[str, dict[str, str]] = {
    "hash seed, one thread, far east": {
        "PYTHONHASHSEED": "1", "CLACAD_THREADS": "1", "TZ": "Pacific/Auckland", "LANG": "C", "LC_ALL": "C",
    },
    "other hash seed, two threads, decimal comma": {
        "PYTHONHASHSEED": "4242", "CLACAD_THREADS": "2", "TZ": "America/Caracas", "LANG": "de_DE.UTF-8",
        "LC_ALL": "de_DE.UTF-8", "USER": "somebody", "HOME": "/", "SOURCE_DATE_EPOCH": "1",
    },
}  # fmt: skip


@pytest.mark.parametrize("formats", ["step", ALL], ids=["solid", "all others"])
def test_the_bytes_do_not_depend_on_circumstances(design: Path, tmp_path: Path, formats: str) -> None:
    found = []
    for k, changes in enumerate(CIRCUMSTANCES.values()):
        here = tmp_path / f"folder {k}" / ("ä" * k)
        here.mkdir(parents=True)
        out = here / "out"
        name = os.path.relpath(design, here) if k else design
        target = "out" if k else out
        ended = clacad(
            "export", name, "-o", target, "--format", formats, "--quads", "4", "-q", cwd=here, **changes
        )
        assert ended.status == 0, ended.err
        found.append(contents(out))
    assert found[0] == found[1]
    assert len(found[0]) > (1 if formats == "step" else 20)


# -- changed afterwards ----------------------------------------------------------------------------


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Every format of the tiny design, as bytes."""
    folder = tmp_path_factory.mktemp("made")
    export(tiny(), folder, formats=("step", *ALL.split(",")), quads=6)
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.name != "run.json"}


@pytest.fixture(autouse=True)
def _only_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """What does not depend on files is judged elsewhere: here it is done once."""
    import importlib

    from clacad.verify.checks import not_run

    run = importlib.import_module("clacad.verify.run")
    nothing = (None, not_run("convergence", "left out", required=False))
    monkeypatch.setattr(run, "_convergence", lambda *_: nothing)
    for name in ("judge_window", "meridians"):
        monkeypatch.setattr(run, name, _once(name, getattr(run, name)))


_SEEN: dict[str, Any] = {}


def _once(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
    def call(*arguments: Any) -> Any:
        if name not in _SEEN:
            _SEEN[name] = function(*arguments)
        return _SEEN[name]

    return call


def status(files: Path) -> int:
    """What `clacad verify` would answer."""
    try:
        return verify(tiny(), files, rays=2048).exit_status
    except (CannotRegister, ExportError) as error:
        return int(error.exit_status)


FORMATS = [
    "tiny.stl", "tiny.3mf", "tiny.ply", "tiny.glb", "tiny.step", "tiny.surfaces.json", "tiny.poses.csv", "tiny.png.json",
    "tiny.sheet-back.u16.png", "tiny.sheet-back.f32.tiff", "tiny.sheet-back.u16.tiff", "tiny.sheet-front.xyz",
    "tiny.sheet-front.mask.svg", "tiny.sheet-front.mask.dxf", "tiny.sheet-front.cell.dat",
]  # fmt: skip


def test_every_format_is_among_those_changed(made: dict[str, bytes]) -> None:
    assert set(FORMATS) <= set(made)
    kinds = {e["format"] for e in json.loads(made["manifest.json"])["files"]}
    changed = {e["format"] for e in json.loads(made["manifest.json"])["files"] if e["name"] in FORMATS}
    assert changed == kinds


@pytest.mark.parametrize("name", FORMATS)
def test_a_flipped_bit_and_a_cut_of_any_format_are_1(
    made: dict[str, bytes], tmp_path: Path, name: str
) -> None:
    """The manifest vouches for the bytes: it is enough to hold them against it."""
    from clacad.verify.files import find_files

    data = made[name]
    at = int(np.random.default_rng(len(data)).integers(len(data)))
    for spoilt in (data[:at] + bytes([data[at] ^ 16]) + data[at + 1 :], data[:-7], b""):
        # the others stay out of this folder: what is judged is this file
        manifest = json.loads(made["manifest.json"])
        manifest["files"] = [e for e in manifest["files"] if e["name"] == name]
        (tmp_path / "manifest.json").write_text(json.dumps(manifest))
        (tmp_path / name).write_bytes(spoilt)
        assert find_files(tmp_path)
        assert status(tmp_path) == 1


def _soup(data: bytes) -> Any:
    return np.frombuffer(data[84:], dtype=[("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")]).copy()


def _stl(head: bytes, rows: Any) -> bytes:
    return head[:80] + len(rows).to_bytes(4, "little") + rows.tobytes()


def _exchanged(rows: Any) -> Any:
    """Lens 1 in the place of lens 2 in one cell: the relief of the front, upside down, inside a cell of the back."""
    window = prescribe(tiny())
    half = 0.5 * window.lattice.pitch[0]
    corners = rows["c"].reshape(-1, 3)
    back = corners[:, 2] > 0.5 * sum(window.z_range)
    front = np.unique(corners[~back], axis=0)
    middle = window.lattice.centres(np.array([0, 0])) + np.asarray(window.shifts[1])
    inside = back & (np.abs(corners[:, :2] - middle).max(axis=1) < half * (1 - 1e-3))
    wanted = corners[inside, None, :2] - np.asarray(window.shifts[1])
    nearest = np.argmin(((wanted - front[None, :, :2]) ** 2).sum(axis=-1), axis=1)
    corners[inside, 2] = corners[:, 2].max() - (front[nearest, 2] - front[:, 2].min())
    rows["c"] = corners.reshape(-1, 3, 3)
    return rows


def meshes() -> Iterator[Any]:
    def scaled(rows: Any) -> Any:
        rows["c"] *= 25.4
        return rows

    def turned(rows: Any) -> Any:
        rows["c"][3] = rows["c"][3, ::-1].copy()
        return rows

    def inside_out(rows: Any) -> Any:
        rows["c"] = rows["c"][:, ::-1].copy()
        return rows

    yield pytest.param(scaled, id="x 25.4")
    yield pytest.param(lambda rows: np.delete(rows, 5), id="facet dropped")
    yield pytest.param(turned, id="facet turned over")
    yield pytest.param(inside_out, id="all turned over")
    yield pytest.param(_exchanged, id="lenslets exchanged")


def vouched(folder: Path, made: dict[str, bytes], name: str, data: bytes) -> Path:
    """The changed file in a folder whose manifest vouches for it: only what is in it can tell."""
    manifest = json.loads(made["manifest.json"])
    entry = next(e for e in manifest["files"] if e["name"] == name)
    manifest["files"] = [entry | {"sha256": sha256(data).hexdigest(), "bytes": len(data)}]
    (folder / "manifest.json").write_text(json.dumps(manifest))
    (folder / name).write_bytes(data)
    return folder


@pytest.mark.parametrize("name", ["tiny.stl", "tiny.3mf", "tiny.ply", "tiny.glb", "tiny.step"])
def test_unchanged_files_are_0(made: dict[str, bytes], tmp_path: Path, name: str) -> None:
    assert status(vouched(tmp_path, made, name, made[name])) == 0


def failed(files: Path) -> set[str]:
    """Checks that fail; "register" where the file is not even recognised as this design's."""
    try:
        return {check.id for check in verify(tiny(), files, rays=2048).checks if check.state == "fail"}
    except CannotRegister:
        return {"register"}


@pytest.mark.parametrize("change", list(meshes()))
def test_a_changed_mesh_with_a_manifest_that_vouches_for_it_is_1(
    made: dict[str, bytes], tmp_path: Path, change: Callable[[Any], Any]
) -> None:
    data = made["tiny.stl"]
    changed = _stl(data, change(_soup(data)))
    assert changed != data
    assert failed(vouched(tmp_path, made, "tiny.stl", changed))


def _patches(text: str) -> list[str]:
    """Grids of poles of the rational patches, as written."""
    return re.findall(r"B_SPLINE_SURFACE\(2,2,(\(\(.*?\)\)),\.UNSPECIFIED", text)


def _pole_lifted(text: str) -> str:
    """A smaller radius: the middle pole of one patch stands 1e-4 of a pitch too high."""
    name = _patches(text)[0].split(",")[4].strip("()")
    line = next(line for line in text.splitlines() if line.startswith(f"{name}=CARTESIAN_POINT"))
    x, y, z = line.split("(('")[-1].rpartition("(")[2].rstrip(");").split(",")
    return text.replace(line, f"{name}=CARTESIAN_POINT('',({x},{y},{float(z) - 5e-5!r}));")


def _patches_exchanged(text: str) -> str:
    one, *others = _patches(text)
    return text.replace(one, "@").replace(others[1], one).replace("@", others[1])


def _face_left_out(text: str) -> str:
    return re.sub(r"(CLOSED_SHELL\('[^']*',\()#\d+,", r"\1", text, count=1)


@pytest.mark.parametrize("change", [
    pytest.param(_pole_lifted, id="radius changed"),
    pytest.param(_patches_exchanged, id="lenslets exchanged"),
    pytest.param(_face_left_out, id="face dropped"),
    pytest.param(lambda text: text.replace(".MILLI.,.METRE.", "$,.METRE."), id="x 1000"),
])  # fmt: skip
def test_a_changed_solid_with_a_manifest_that_vouches_for_it_is_1(
    made: dict[str, bytes], tmp_path: Path, change: Callable[[str], str]
) -> None:
    text = made["tiny.step"].decode()
    changed = change(text)
    assert changed != text
    assert failed(vouched(tmp_path, made, "tiny.step", changed.encode()))


def test_thin_bodies_far_apart_are_0(tmp_path: Path) -> None:
    """float32 moves the far body's plane by half a spacing as a whole: much of a thin body, and no fault."""
    apart = Design.from_dict({
        "format": 1, "name": "apart", "unit": "m", "law": {"eta": [1.3, 1.3], "delta": [-0.02, 0.013]},
        "pair": {"form": "plano", "separation": 0.0525, "index": 1.767}, "lattice": {"pitch": 0.0014, "count": [2, 2]},
    })  # fmt: skip
    export(apart, tmp_path, formats=("stl",), quads=16)
    checks = verify(apart, tmp_path, rays=2048).checks
    assert [c.state for c in checks if c.id == "volume"] == ["pass"]


# -- alone -----------------------------------------------------------------------------------------


def test_no_test_can_reach_another_machine() -> None:
    with pytest.raises(Exception, match="look-up"):
        socket.create_connection(("example.org", 80), timeout=1)
    with socket.socket() as plain, pytest.raises(Exception, match="connect"):
        plain.connect(("192.0.2.1", 80))
