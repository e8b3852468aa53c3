"""A file changed after it was written is caught by verify: by its hash, and, where the hash is forged, by what is in it."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from filesonly import only_files
from trust.judging import alone, failed, read, tiny, vouched
from trust.running import TINY
from trust.spoiling import Change, Floats, Ints, changed, document_of, glb, model_changed, obj

from clacad.exporting.run import export
from clacad.prescription.prescribe import prescribe
from clacad.verification import verify

TEXTS = ("stl-parts", "sag", "tiff", "png", "xyz", "table", "mask")
MESHES = ["tiny.stl", "tiny.3mf", "tiny.ply", "tiny.glb", "tiny.obj"]
REPEATED = (
    TINY.replace('"slab"', '"plano"').replace("delta = [0.01, -0.02]", "").replace("-0.5, -1.0", "-0.5, -0.5")
)
"""Cells that are all alike and not displaced: 3MF and GLB hold one, and the positions of the others."""


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Every format the tiny design can have, as bytes, and an OBJ such as a shop sends back."""
    folder = tmp_path_factory.mktemp("made")
    export(tiny(), folder, formats=("step", "stl", "3mf", "ply", "glb", "brep", *TEXTS), quads=6)
    files = {p.name: p.read_bytes() for p in folder.iterdir() if p.name != "run.json"}
    kept: dict[str, Any] = {}

    def keep(vertices: Floats, triangles: Ints) -> tuple[Floats, Ints]:
        kept["obj"] = obj(vertices, triangles)
        return vertices, triangles

    assert changed("tiny.ply", files["tiny.ply"], keep) == files["tiny.ply"]
    files["tiny.obj"] = kept["obj"]
    manifest = json.loads(files["manifest.json"])
    ply = next(e for e in manifest["files"] if e["name"] == "tiny.ply")
    manifest["files"].append(
        ply
        | {
            "name": "tiny.obj",
            "format": "obj",
            "sha256": sha256(kept["obj"]).hexdigest(),
            "bytes": len(kept["obj"]),
        }
    )
    files["manifest.json"] = json.dumps(manifest).encode()
    return files


@pytest.fixture(scope="session")
def others(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The formats that a slab cannot have, and repeated cells."""
    folder = tmp_path_factory.mktemp("others")
    export(read(REPEATED), folder, formats=("pov", "3mf", "glb"), quads=6)
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.name != "run.json"}


@pytest.fixture(autouse=True)
def _only_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """What does not depend on files is judged elsewhere: here it is done once."""
    only_files(monkeypatch)


# -- by the hash: every format -----------------------------------------------------------------------


def listed(files: dict[str, bytes]) -> list[dict[str, Any]]:
    return list(json.loads(files["manifest.json"])["files"])


def damages(data: bytes) -> list[bytes]:
    """A bit flipped at both ends and at places in between, the end cut off, nothing left, one byte more."""
    places = {0, len(data) - 1, *np.random.default_rng(len(data)).integers(len(data), size=6).tolist()}
    flipped = [data[:at] + bytes([data[at] ^ (1 << at % 8)]) + data[at + 1 :] for at in sorted(places)]
    return [*flipped, data[:-1], data[: len(data) // 2], b"", data + b"\0"]


def hold_by_hash(files: dict[str, bytes], folder: Path) -> set[str]:
    """Damage every file of an export; each must fail. Returns their formats."""
    from clacad.judging.delivery import integrity, list_files

    for entry in listed(files):
        for spoilt in damages(files[entry["name"]]):
            (folder / "manifest.json").write_text(json.dumps({"format": 1, "files": [entry]}))
            (folder / entry["name"]).write_bytes(spoilt)
            (subject,) = list_files(folder).hashed().subjects
            assert integrity(subject).state == "fail", entry["name"]
    return {entry["format"] for entry in listed(files)}


@pytest.mark.slow
def test_any_bit_or_cut_of_any_format_fails_by_its_hash(
    made: dict[str, bytes], others: dict[str, bytes], tmp_path: Path
) -> None:
    assert hold_by_hash(made, tmp_path) | hold_by_hash(others, tmp_path) == {
        "step", "stl-binary", "3mf", "ply", "glb", "obj", "brep", "pov", "grid-sag", "tiff32", "tiff16", "png16",
        "height-calibration", "xyz-normals", "surface-table", "pose-table", "mask-svg", "mask-dxf",
    }  # fmt: skip


@pytest.mark.long
def test_any_bit_or_cut_of_the_modelled_fixtures_fails_by_its_hash(tmp_path: Path) -> None:
    body = {"border": 1.0, "frame": {"width": 1.0}, "baffle": True, "baffle_wall": 0.05}
    export(read(REPEATED, body=body), tmp_path / "made", formats=("baffle", "frame", "coupon"))
    files = {p.name: p.read_bytes() for p in (tmp_path / "made").iterdir()}
    assert hold_by_hash(files, tmp_path) == {"step", "stl-binary"}


@pytest.mark.daily_cases("tiny.3mf")
@pytest.mark.parametrize("name", ["tiny.poses.csv", "tiny.sheet-back.u16.png", "tiny.brep", "tiny.3mf"])
def test_a_failing_hash_fails_the_whole_report(made: dict[str, bytes], tmp_path: Path, name: str) -> None:
    folder = vouched(tmp_path, made, name, made[name])
    assert not failed(folder)
    data = bytearray(made[name])
    data[len(data) // 2] ^= 4
    (folder / name).write_bytes(data)
    assert "integrity" in failed(folder)


# -- by what is in it: meshes ------------------------------------------------------------------------


def _dropped(vertices: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    return vertices, np.delete(triangles, 5, axis=0)


def _doubled(vertices: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    return vertices, np.concatenate([triangles[:-1], triangles[:1]])


def _turned(vertices: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    triangles[3] = triangles[3, ::-1].copy()
    return vertices, triangles


def _inside_out(vertices: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    return vertices, triangles[:, ::-1].copy()


def _in_inches(vertices: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    return vertices * 25.4, triangles


def _mirrored(vertices: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    return vertices * [-1.0, 1.0, 1.0], triangles[:, ::-1].copy()


def _back_cell(vertices: Floats) -> tuple[Any, Floats]:
    """Vertices of lens 2 of the first cell, and the middle of that cell, millimetres."""
    window = prescribe(tiny())
    half = 0.5 * window.lattice.pitch[0]
    middle = window.lattice.centres(np.array([0, 0])) + np.asarray(window.shifts[1])
    back = vertices[:, 2] > 0.5 * vertices[:, 2].max()
    return back & (np.abs(vertices[:, :2] - middle).max(axis=1) < half * (1.0 - 1e-3)), middle


def _lenses_exchanged(vertices: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    """Lens 1 in the place of lens 2 in one cell: the relief of the front, upside down, inside a cell of the back."""
    inside, _ = _back_cell(vertices)
    shift = np.asarray(prescribe(tiny()).shifts[1])
    front = np.unique(vertices[vertices[:, 2] < 0.5 * vertices[:, 2].max()], axis=0)
    wanted = vertices[inside, None, :2] - shift
    nearest = np.argmin(((wanted - front[None, :, :2]) ** 2).sum(axis=-1), axis=1)
    vertices[inside, 2] = vertices[:, 2].max() - (front[nearest, 2] - front[:, 2].min())
    return vertices, triangles


def _radius_changed(vertices: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    """The radius of one lenslet is less by 5 %: inside its cell heights grow so much from its border up."""
    inside, _ = _back_cell(vertices)
    lowest = vertices[inside, 2].min()
    vertices[inside, 2] = lowest + 1.05 * (vertices[inside, 2] - lowest)
    return vertices, triangles


CHANGES: dict[str, Change] = {
    "facet dropped": _dropped, "facet doubled": _doubled, "facet turned over": _turned, "all turned over": _inside_out,
    "x 25.4": _in_inches, "mirrored": _mirrored, "lenslets exchanged": _lenses_exchanged, "radius changed": _radius_changed,
}  # fmt: skip


@pytest.mark.ci_cases("tiny.3mf", "tiny.glb", "tiny.step")
@pytest.mark.daily_cases("tiny.stl")
@pytest.mark.parametrize("name", [*MESHES, "tiny.step"])
def test_unchanged_files_pass_with_a_manifest_and_without(
    made: dict[str, bytes], tmp_path: Path, name: str
) -> None:
    (tmp_path / "alone").mkdir()
    assert not failed(vouched(tmp_path, made, name, made[name]))
    assert not failed(alone(tmp_path / "alone", name, made[name]))


MORE = ("facet doubled", "mirrored")


@pytest.mark.ci_cases(
    "tiny.stl-facet dropped",
    "tiny.stl-x 25.4",
    "tiny.3mf-facet turned over",
    "tiny.3mf-lenslets exchanged",
    "tiny.ply-radius changed",
    "tiny.glb-all turned over",
)
@pytest.mark.daily_cases("tiny.glb-facet turned over", "tiny.3mf-x 25.4")
@pytest.mark.parametrize(
    "what", [pytest.param(w, marks=pytest.mark.long) if w in MORE else w for w in CHANGES]
)
@pytest.mark.parametrize("name", [*MESHES[:-1], pytest.param("tiny.obj", marks=pytest.mark.long)])
def test_a_changed_mesh_is_caught_with_a_manifest_that_vouches_for_it_and_without_any(
    made: dict[str, bytes], tmp_path: Path, name: str, what: str
) -> None:
    data = changed(name, made[name], CHANGES[what])
    assert data != made[name]
    (tmp_path / "alone").mkdir()
    assert failed(vouched(tmp_path, made, name, data))
    file = alone(tmp_path / "alone", name, data)
    if what == "x 25.4" and name in ("tiny.stl", "tiny.ply", "tiny.obj"):
        # a file whose format has no unit may be in any; an odd unit is reported
        readable = next(c for c in verify(tiny(), file, rays=2048).checks if c.id == "readable")
        assert readable.state == "warn"
        assert "25.4 times as large" in readable.sentence
    else:
        assert failed(file)


def _glb_scaled(data: bytes) -> bytes:
    document, binary = document_of(data)
    document["nodes"][0]["scale"] = [0.0254] * 3
    return glb(document, binary)


@pytest.mark.parametrize(("name", "change"), [
    ("tiny.3mf", lambda data: model_changed(data, lambda text: text.replace('unit="millimeter"', 'unit="inch"'))),
    ("tiny.glb", _glb_scaled),
], ids=["3mf", "glb"])  # fmt: skip
def test_another_unit_in_the_file_itself_is_caught(
    made: dict[str, bytes], tmp_path: Path, name: str, change: Callable[[bytes], bytes]
) -> None:
    data = change(made[name])
    assert data != made[name]
    (tmp_path / "alone").mkdir()
    if name.endswith(
        ".3mf"
    ):  # with a manifest that is forged too, the file's own word is what a slicer goes by
        assert "scale" in failed(vouched(tmp_path, made, name, data))
    assert failed(vouched(tmp_path, made, name, data))
    assert failed(alone(tmp_path / "alone", name, data))


# -- repeated cells: the places can be wrong too ------------------------------------------------------


def _nodes_changed(data: bytes, change: Callable[[list[Any]], Any]) -> bytes:
    document, binary = document_of(data)
    change([node for node in document["nodes"] if "translation" in node])
    return glb(document, binary)


def _moved_node(nodes: list[Any]) -> None:
    nodes[0]["translation"][0] += 0.03


def _doubled_node(nodes: list[Any]) -> None:
    nodes[1]["translation"] = list(nodes[0]["translation"])


def _other_mesh(nodes: list[Any]) -> None:
    first = next(n for n in nodes if n["mesh"] == 0)
    second = next(n for n in nodes if n["mesh"] == 1 and n["translation"] != first["translation"])
    first["mesh"], second["mesh"] = 1, 0


def _places_changed(change: Callable[[re.Match[str]], str], times: int = 1) -> Callable[[bytes], bytes]:
    pattern = r'<component objectid="(\d+)" transform="1 0 0 0 1 0 0 0 1 (\S+) (\S+) (\S+)"/>\n'

    def changed_model(text: str) -> str:
        found, count = re.subn(pattern, change, text, count=times)
        assert count == times
        return found

    return lambda data: model_changed(data, changed_model)


PLACES: dict[str, tuple[str, Callable[[bytes], bytes]]] = {
    "glb: lenslet moved": ("tiny.glb", lambda data: _nodes_changed(data, _moved_node)),
    "glb: lenslet twice": ("tiny.glb", lambda data: _nodes_changed(data, _doubled_node)),
    "glb: lenslets of both arrays exchanged": ("tiny.glb", lambda data: _nodes_changed(data, _other_mesh)),
    "3mf: lenslet left out": ("tiny.3mf", _places_changed(lambda m: "")),
    "3mf: lenslet twice": ("tiny.3mf", _places_changed(lambda m: m[0] * 2)),
    "3mf: lenslet moved": ("tiny.3mf", _places_changed(lambda m: m[0].replace(m[2], repr(float(m[2]) + 0.03), 1))),
}  # fmt: skip


@pytest.mark.ci_cases("glb: lenslet moved", "glb: lenslets of both arrays exchanged", "3mf: lenslet left out")
@pytest.mark.slow
@pytest.mark.parametrize("what", PLACES)
def test_a_lenslet_in_a_wrong_place_is_caught(others: dict[str, bytes], tmp_path: Path, what: str) -> None:
    name, change = PLACES[what]
    data, design = others[name], read(REPEATED)
    files = {"manifest.json": others["manifest.json"]}
    (tmp_path / "good").mkdir()
    assert not failed(vouched(tmp_path / "good", files, name, data), design)
    spoilt = change(data)
    assert spoilt != data
    assert failed(vouched(tmp_path, files, name, spoilt), design)


# -- by what is in it: solids ------------------------------------------------------------------------


def _patches(text: str) -> list[str]:
    """Grids of poles of the rational patches, as written."""
    return re.findall(r"B_SPLINE_SURFACE\(2,2,(\(\(.*?\)\)),\.UNSPECIFIED", text)


def _pole_lifted(text: str) -> str:
    """A smaller radius: the middle pole of one patch lies 1e-4 of a pitch too high."""
    name = _patches(text)[0].split(",")[4].strip("()")
    line = next(line for line in text.splitlines() if line.startswith(f"{name}=CARTESIAN_POINT"))
    x, y, z = line.split("(('")[-1].rpartition("(")[2].rstrip(");").split(",")
    return text.replace(line, f"{name}=CARTESIAN_POINT('',({x},{y},{float(z) - 5e-5!r}));")


def _patches_exchanged(text: str) -> str:
    one, *rest = _patches(text)
    return text.replace(one, "@").replace(rest[1], one).replace("@", rest[1])


def _face_left_out(text: str) -> str:
    return re.sub(r"(CLOSED_SHELL\('[^']*',\()#\d+,", r"\1", text, count=1)


def _face_turned(text: str) -> str:
    lens = re.search(r"ADVANCED_FACE\('lens',\(#\d+\),#\d+,\.([TF])\.\)", text)
    assert lens is not None
    other = {"T": "F", "F": "T"}[lens[1]]
    return text.replace(lens[0], f"{lens[0][:-4]}.{other}.)")


def _all_in_inches(text: str) -> str:
    def grown(found: re.Match[str]) -> str:
        return found[1] + ",".join(repr(25.4 * float(v)) for v in found[2].split(",")) + ")"

    return re.sub(r"(=CARTESIAN_POINT\('[^']*',\()([^,()]+,[^,()]+,[^,()]+)\)", grown, text)


@pytest.mark.ci_cases("radius changed", "face dropped")
@pytest.mark.slow
@pytest.mark.parametrize("change", [
    pytest.param(_pole_lifted, id="radius changed"),
    pytest.param(_patches_exchanged, id="lenslets exchanged"),
    pytest.param(_face_left_out, id="face dropped"),
    pytest.param(_face_turned, id="face turned over", marks=pytest.mark.long),
    pytest.param(_all_in_inches, id="x 25.4"),
    pytest.param(lambda text: text.replace(".MILLI.,.METRE.", "$,.METRE."), id="x 1000", marks=pytest.mark.long),
    pytest.param(lambda text: text[: len(text) // 2], id="cut", marks=pytest.mark.long),
    pytest.param(lambda text: text.replace("=MANIFOLD_SOLID_BREP(", "=MANIFOLD_SOLID_BREB("), id="letter flipped", marks=pytest.mark.long),
])  # fmt: skip
def test_a_changed_solid_is_caught_with_a_manifest_that_vouches_for_it(
    made: dict[str, bytes], tmp_path: Path, change: Callable[[str], str]
) -> None:
    text = made["tiny.step"].decode()
    spoilt = change(text)
    assert spoilt != text
    assert failed(vouched(tmp_path, made, "tiny.step", spoilt.encode()))
