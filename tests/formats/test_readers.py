"""Mesh files: what is written reads back exactly, elsewhere too; what is damaged or hostile is refused."""

from __future__ import annotations

import json
import math
import os
import re
import resource
import struct
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import meshtoys
import mpmath
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from noworker import without_worker

from clacad.base.arrays import welded
from clacad.formats.mesh import threemf
from clacad.formats.mesh.compiled_measure import read_lines
from clacad.formats.mesh.glb import write_glb
from clacad.formats.mesh.measure import crowded_edges, edge_times, measure
from clacad.formats.mesh.ply import read_ply, write_ply
from clacad.formats.mesh.readers import read_mesh
from clacad.formats.mesh.stl import read_stl, stl_bytes, write_stl
from clacad.formats.mesh.threemf import write_threemf
from clacad.formats.placements import Piece
from clacad.storage.errors import FileDisagrees, UnreadableFile

WRITERS = {".3mf": write_threemf, ".ply": write_ply, ".glb": write_glb}
SCALE = 2.5  # mm per design unit, so that a unit lost on the way shows


def write(path: Path) -> Path:
    """The same two bodies in the format the suffix names: one 3 × 2 array and one single block."""
    pieces = [meshtoys.piece("array1", meshtoys.grid(3, 2)), meshtoys.piece("array2")]
    if path.suffix == ".stl":
        centres = meshtoys.grid(3, 2).centres()
        streams = [meshtoys.stream("array1", shift=tuple(c)) for c in centres] + [meshtoys.stream("array2")]
        write_stl(streams, path, SCALE, "toy")
    else:
        WRITERS[path.suffix](pieces, path, SCALE, "toy")
    return path


FORMATS = [".stl", ".3mf", ".ply", ".glb"]


def exact_volume() -> float:
    """Volume of seven faceted blocks in mm³: prisms under the triangles, by their mean height."""
    vertices, triangles = meshtoys.block()
    top = vertices[triangles][(vertices[triangles][..., 2] > 0.2).all(axis=1)]
    a, b = top[:, 1, :2] - top[:, 0, :2], top[:, 2, :2] - top[:, 0, :2]
    area = 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    return float(7 * SCALE**3 * (area * top[..., 2].mean(axis=1)).sum())


@pytest.mark.slow
def test_lines_joined_by_the_kernel_are_those_of_plain_python(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(5)
    vertices = np.where(rng.random((301, 3)) < 0.1, 0.0, rng.normal(size=(301, 3)))
    vertices *= 10.0 ** rng.integers(-9, 20, size=(301, 1))
    piece = Piece.of("body", vertices, rng.integers(0, 301, size=(700, 3)))
    plain = b"".join(threemf.joined_lines(threemf.mesh_lines(piece, 1, 25.4))).decode()
    monkeypatch.setattr(threemf, "MANY", 64)
    assert b"".join(threemf.joined_lines(threemf.mesh_lines(piece, 1, 25.4))).decode() == plain
    numbers = re.findall(r'"(\d+)"', plain.split("<triangles>")[1])
    assert np.array_equal(np.array(numbers, dtype=int).reshape(-1, 3), piece.whole.triangles)


@pytest.mark.parametrize("suffix", FORMATS)
def test_what_is_written_reads_back_closed_with_its_volume_and_unit(tmp_path: Path, suffix: str) -> None:
    mesh = read_mesh(write(tmp_path / f"toy{suffix}"))
    assert mesh.unit is not None
    found = measure(mesh.chunks())
    assert found.closed
    assert found.facets == mesh.facet_count == 7 * len(meshtoys.block()[1])
    in_mm = (mesh.unit / 1e-3) ** 3
    assert found.volume * in_mm == pytest.approx(
        exact_volume(), rel=3e-7 if suffix in (".stl", ".glb") else 1e-12
    )
    low, high = np.array(found.low) * mesh.unit / 1e-3, np.array(found.high) * mesh.unit / 1e-3
    np.testing.assert_allclose(low, SCALE * np.array([-1.25, -1.0, 0.0]), atol=1e-6)
    np.testing.assert_allclose(high, SCALE * np.array([1.75, 1.0, 0.30]), atol=1e-6)


@pytest.mark.parametrize("suffix", [".3mf", ".ply"])
def test_formats_of_double_precision_keep_every_bit(tmp_path: Path, suffix: str) -> None:
    mesh = read_mesh(write(tmp_path / f"toy{suffix}"))
    vertices, triangles = meshtoys.block()
    placed = (
        vertices[None] + np.concatenate([meshtoys.grid(3, 2).centres(), np.zeros((1, 3))])[:, None]
    ) * SCALE
    got = np.concatenate(list(mesh.chunks()))
    np.testing.assert_allclose(got, placed[:, triangles].reshape(-1, 3, 3), rtol=0, atol=1e-15)


@pytest.mark.parametrize("suffix", [".ply", ".glb"])
def test_vertex_normals_survive(tmp_path: Path, suffix: str) -> None:
    part = read_mesh(write(tmp_path / f"toy{suffix}")).parts[0]
    normals = part.corner_normals(0, 10)
    expected = meshtoys.piece().whole.normals
    assert normals is not None
    assert expected is not None
    np.testing.assert_allclose(normals, expected[meshtoys.block()[1]][:10], atol=1e-7)


def test_two_level_instances_stand_where_flat_ones_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flat = np.concatenate(list(read_mesh(write(tmp_path / "flat.3mf")).chunks()))
    monkeypatch.setattr(threemf, "FLAT_LIMIT", 0)
    deep = np.concatenate(list(read_mesh(write(tmp_path / "deep.3mf")).chunks()))
    np.testing.assert_allclose(np.sort(deep, axis=0), np.sort(flat, axis=0), atol=1e-12)
    assert (tmp_path / "deep.3mf").read_bytes() != (tmp_path / "flat.3mf").read_bytes()


@pytest.mark.daily_cases(".ply")
@pytest.mark.parametrize("suffix", FORMATS)
def test_the_same_mesh_gives_the_same_bytes_in_another_process(tmp_path: Path, suffix: str) -> None:
    ours = write(tmp_path / f"toy{suffix}").read_bytes()
    code = "import sys, pathlib, test_readers; test_readers.write(pathlib.Path(sys.argv[1]))"
    other = tmp_path / "sub" / f"toy{suffix}"
    other.parent.mkdir()
    path = os.pathsep.join([str(Path(__file__).parent), *filter(None, sys.path)])
    env = os.environ | {"PYTHONHASHSEED": "7", "TZ": "Asia/Tokyo", "LANG": "de_DE.UTF-8", "PYTHONPATH": path}
    subprocess.run([sys.executable, "-c", code, str(other)], check=True, env=env, cwd=tmp_path)
    assert other.read_bytes() == ours


# -- independent readers -------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", FORMATS)
def test_trimesh_agrees_on_volume_and_watertightness(tmp_path: Path, suffix: str) -> None:
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("networkx")
    scene = trimesh.load(write(tmp_path / f"toy{suffix}"), process=suffix == ".stl")
    mesh = scene.to_mesh() if hasattr(scene, "to_mesh") else scene
    mesh.merge_vertices(merge_norm=True)
    # Neighbouring blocks touch, so vertices merged across them make edges of four facets: judge the pieces' sum.
    unit = 1000.0 if suffix == ".glb" else 1.0
    assert mesh.volume * unit**3 == pytest.approx(exact_volume(), rel=1e-6)
    assert len(mesh.faces) == 7 * len(meshtoys.block()[1])


def test_lib3mf_reads_ours_without_a_warning(tmp_path: Path) -> None:
    lib3mf = pytest.importorskip("lib3mf")
    wrapper = lib3mf.get_wrapper()
    model = wrapper.CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    reader.ReadFromFile(str(write(tmp_path / "toy.3mf")))
    assert reader.GetWarningCount() == 0
    meshes = model.GetMeshObjects()
    while meshes.MoveNext():
        assert meshes.GetCurrentMeshObject().IsManifoldAndOriented()


def test_manifold_accepts_what_the_stl_holds(tmp_path: Path) -> None:
    manifold3d = pytest.importorskip("manifold3d")
    path = tmp_path / "one.stl"
    write_stl([meshtoys.stream()], path, SCALE, "one")
    corners = np.concatenate(list(read_mesh(path).chunks()))
    vertices, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    solid = manifold3d.Manifold(
        manifold3d.Mesh64(vert_properties=vertices, tri_verts=index.reshape(-1, 3).astype(np.uint64))
    )
    assert solid.status() == manifold3d.Error.NoError
    assert len(solid.decompose()) == 1
    assert solid.volume() == pytest.approx(exact_volume() / 7, rel=1e-6)
    assert crowded_edges(edge_times(welded(corners)[1])) == 0


# -- damage --------------------------------------------------------------------------------------


def stl(tmp_path: Path) -> tuple[Path, bytearray]:
    path = tmp_path / "toy.stl"
    write_stl([meshtoys.stream()], path, SCALE, "toy")
    return path, bytearray(path.read_bytes())


def test_stl_size_is_known_beforehand(tmp_path: Path) -> None:
    path, data = stl(tmp_path)
    assert len(data) == stl_bytes(len(meshtoys.block()[1])) == 84 + 50 * len(meshtoys.block()[1])
    assert data[:5] != b"solid"
    assert b"unit=mm" in data[:80]
    assert path.stat().st_size == len(data)


def test_normals_are_those_of_the_corners_as_written(tmp_path: Path) -> None:
    path, data = stl(tmp_path)
    facets = np.frombuffer(bytes(data[84:]), dtype=[("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")])
    edges = np.cross(
        facets["c"][:, 1].astype(float) - facets["c"][:, 0],
        facets["c"][:, 2].astype(float) - facets["c"][:, 0],
    )
    cosine = (edges * facets["n"]).sum(1) / np.linalg.norm(edges, axis=1)
    np.testing.assert_allclose(cosine, 1.0, atol=1e-6)


def test_a_facet_without_area_has_no_normal_and_no_minus_zero(tmp_path: Path) -> None:
    corners = np.array([[[-0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [4.0, -0.0, 1.0]]])

    class Flat:
        name, facet_count = "flat", 1

        def rows(self) -> Iterator[np.ndarray]:
            yield corners

    write_stl([Flat()], tmp_path / "flat.stl", SCALE, "flat")
    written = np.frombuffer((tmp_path / "flat.stl").read_bytes()[84:-2], dtype="<f4").reshape(4, 3)
    np.testing.assert_array_equal(written, [[0, 0, 0], *(corners[0] * SCALE)])
    assert not np.signbit(written).any()
    assert len(list(read_stl(tmp_path / "flat.stl", checked=True).chunks())) == 1


def test_sums_over_facets_are_the_exact_ones(tmp_path: Path) -> None:
    corners = np.random.default_rng(1).normal(size=(5000, 3, 3)) * 1e3
    found = measure([corners[:1234], corners[1234:]], np.array([1.0, 2.0, 3.0]))
    a, b, c = (corners[:, k] - [1.0, 2.0, 3.0] for k in range(3))
    normal = np.cross(b - a, c - a)
    assert found.volume == pytest.approx(math.fsum((a * normal).sum(axis=1)) / 6.0, rel=1e-15, abs=1e-4)
    assert found.area == pytest.approx(math.fsum(np.linalg.norm(normal, axis=1)) / 2.0, rel=1e-15)
    np.testing.assert_array_equal(
        [found.low, found.high], [corners.min(axis=(0, 1)), corners.max(axis=(0, 1))]
    )
    assert found.facets == 5000
    assert not found.closed


def test_edges_cancel_whatever_the_order_and_chunks_of_the_facets() -> None:
    generator = np.random.default_rng(2)
    corner = generator.normal(size=(4, 3))
    corner[0] = [0.0, -0.0, 1.0]
    tetrahedra = [corner[[[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]] + 5.0 * k for k in range(50)]
    facets = np.concatenate([np.roll(one, k % 3, axis=1) for k, one in enumerate(tetrahedra)])
    facets[0] = facets[0] + 0.0  # −0 in one facet, 0 in another
    shuffled = facets[generator.permutation(len(facets))]
    assert measure(np.array_split(shuffled, 7)).closed
    assert not measure([shuffled[1:]]).closed
    turned = shuffled.copy()
    turned[3] = turned[3, ::-1]
    assert not measure([turned]).closed
    moved = shuffled.copy()
    moved[5, 1, 2] = np.nextafter(moved[5, 1, 2], np.inf)
    assert not measure([moved]).closed


def sound(path: Path) -> bool:
    """Whether the facets agree with their normals and close."""
    try:
        return measure(read_stl(path, checked=True).chunks()).closed
    except (FileDisagrees, UnreadableFile):
        return False


@pytest.mark.parametrize("seed", range(12))
def test_one_flipped_bit_anywhere_in_the_facets_is_seen(tmp_path: Path, seed: int) -> None:
    path, data = stl(tmp_path)
    chance = np.random.default_rng(seed)
    data[84 + int(chance.integers(len(data) - 84))] ^= 1 << int(chance.integers(8))
    path.write_bytes(data)
    assert not sound(path)


def drop(data: bytearray) -> bytearray:
    count = struct.unpack("<I", data[80:84])[0]
    return data[:80] + struct.pack("<I", count - 1) + data[84:-50]


def turn(data: bytearray) -> bytearray:
    return data[:84] + data[84:96] + data[108:120] + data[96:108] + data[120:]


@pytest.mark.parametrize("damage", [drop, turn])
def test_a_facet_left_out_or_turned_over_opens_the_surface(
    tmp_path: Path, damage: Callable[[bytearray], bytearray]
) -> None:
    path, data = stl(tmp_path)
    path.write_bytes(damage(data))
    assert not measure(read_mesh(path).chunks()).closed


@pytest.mark.parametrize("cut", [0, 1, 10, 79, 80, 83, 84, 85, 4000, -1])
def test_a_cut_stl_is_refused(tmp_path: Path, cut: int) -> None:
    path, data = stl(tmp_path)
    path.write_bytes(data[:cut])
    with pytest.raises(UnreadableFile):
        read_mesh(path)


@pytest.mark.ci_cases("0.02-.ply", "0.9-.glb", "0.999-.3mf")
@pytest.mark.daily_cases(
    "0.0-.3mf", "0.0-.ply", "0.0-.glb", "0.02-.3mf", "0.02-.glb", "0.5-.3mf", "0.5-.glb", "0.9-.3mf"
)
@pytest.mark.parametrize("suffix", [".3mf", ".ply", ".glb"])
@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.9, 0.999])
def test_a_cut_file_is_refused(tmp_path: Path, suffix: str, share: float) -> None:
    path = write(tmp_path / f"toy{suffix}")
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(UnreadableFile):
        read_mesh(path)


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_corner_that_is_no_number_is_never_written(tmp_path: Path, suffix: str) -> None:
    bad = meshtoys.piece()
    bad.whole.vertices[3, 1] = np.nan
    path = tmp_path / f"bad{suffix}"
    streams = [meshtoys.Stream("bad", bad.whole.vertices[bad.whole.triangles])]
    with pytest.raises(FileDisagrees, match="finite"):
        write_stl(streams, path, 1.0, "bad") if suffix == ".stl" else WRITERS[suffix]([bad], path, 1.0, "bad")


def test_ascii_stl_reads_as_the_binary_one(tmp_path: Path) -> None:
    path, _ = stl(tmp_path)
    binary = np.concatenate(list(read_mesh(path).chunks()))
    lines = ["solid toy"]
    for facet in binary:
        lines += [
            "facet normal 0 0 0",
            " outer loop",
            *(f"  vertex {x!r} {y!r} {z!r}" for x, y, z in facet.tolist()),
            " endloop",
            "endfacet",
        ]
    path.write_text("\n".join([*lines, "endsolid toy", ""]))
    assert np.array_equal(np.concatenate(list(read_mesh(path).chunks())), binary)
    path.write_text("\n".join(lines[:-3]))
    with pytest.raises(UnreadableFile):
        read_mesh(path)


def test_obj_with_polygons_and_normals_reads_as_triangles(tmp_path: Path) -> None:
    path = tmp_path / "t.obj"
    path.write_text("o box\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3//1 -1//1\n")
    part = read_mesh(path).parts[0]
    assert part.facet_count == 2
    assert part.name == "box"
    assert np.linalg.norm(np.cross(*(np.diff(part.corners(0, 1)[0], axis=0)))) == pytest.approx(1.0)
    path.write_text("v 0 0 0\nf 1 2 3\n")
    with pytest.raises(UnreadableFile):
        read_mesh(path)


# -- hostile archives ----------------------------------------------------------------------------

RELS = (
    '<Relationships><Relationship Target="/3D/3dmodel.model" Id="r" Type="http://x/3dmodel"/></Relationships>'
)
MESH = (
    "<mesh><vertices>" + "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)])
    + "</vertices><triangles>" + "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])
    + "</triangles></mesh>"
)  # fmt: skip


def model(resources: str, build: str = '<item objectid="1"/>', attributes: str = "", before: str = "") -> str:
    return f"{before}<model {attributes}><resources>{resources}</resources><build>{build}</build></model>"


def pack(path: Path, text: str | bytes, extra: dict[str, bytes] | None = None) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("_rels/.rels", RELS)
        archive.writestr("3D/3dmodel.model", text)
        for name, data in (extra or {}).items():
            archive.writestr(name, data)
    return path


GOOD = f'<object id="1">{MESH}</object>'


def test_the_hostile_set_without_its_hostility_is_read(tmp_path: Path) -> None:
    assert measure(read_mesh(pack(tmp_path / "x.3mf", model(GOOD))).chunks()).volume == pytest.approx(1 / 6)


HOSTILE_MODELS = {
    "entity bomb": model(GOOD, before='<!DOCTYPE m [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;&a;">]>'),
    "external entity": model(GOOD, before='<!DOCTYPE m SYSTEM "file:///etc/passwd">'),
    "vertex out of range": model(GOOD.replace('v1="0"', 'v1="77"')),
    "negative vertex": model(GOOD.replace('v1="0"', 'v1="-1"')),
    "not a number": model(GOOD.replace('x="1"', 'x="nan"')),
    "infinite": model(GOOD.replace('x="1"', 'x="1e999"')),
    "words": model(GOOD.replace('x="1"', 'x="one"')),
    "unknown unit": model(GOOD, attributes='unit="furlong"'),
    "required extension": model(GOOD, attributes='requiredextensions="p"'),
    "eats itself": model('<object id="1"><components><component objectid="1"/></components></object>'),
    "unknown object": model('<object id="1"><components><component objectid="9"/></components></object>'),
    "same id twice": model(GOOD + GOOD),
    "nothing built": model(GOOD, build=""),
    "short transform": model(GOOD, build='<item objectid="1" transform="1 0 0"/>'),
    "other part": model(GOOD, build='<item objectid="1" p:path="/3D/other.model"/>'),
    "triangle outside": model('<triangle v1="0" v2="1" v3="2"/>'),
    "deep": "<model>" + "<a>" * 100 + "</a>" * 100 + "</model>",
    "cut": model(GOOD)[:200],
    "empty": "",
    "doubling": model(
        GOOD + "".join(
            f'<object id="{k}"><components><component objectid="{k - 1}"/><component objectid="{k - 1}"/></components></object>'
            for k in range(2, 80)
        ), build='<item objectid="79"/>',
    ),
    "doubling within the depth": model(
        GOOD + "".join(
            f'<object id="{k}"><components>' + f'<component objectid="{k - 1}"/>' * 40 + "</components></object>"
            for k in range(2, 14)
        ), build='<item objectid="13"/>',
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", HOSTILE_MODELS)
def test_a_hostile_model_is_refused(tmp_path: Path, case: str) -> None:
    with pytest.raises(UnreadableFile):
        read_mesh(pack(tmp_path / "x.3mf", HOSTILE_MODELS[case]))


@pytest.mark.parametrize("name", ["../../evil", "/etc/evil", "a/../../evil", "C:evil", "x\\..\\evil"])
def test_an_entry_that_leads_out_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(UnreadableFile, match="leads out"):
        read_mesh(pack(tmp_path / "x.3mf", model(GOOD), {name: b"x"}))


@pytest.mark.slow
def test_a_zip_bomb_is_refused_without_being_inflated(tmp_path: Path) -> None:
    path = pack(tmp_path / "bomb.3mf", b" " * (200 << 20))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(UnreadableFile, match="100 to 1"):
        read_mesh(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000


def test_a_bomb_that_lies_about_its_size_is_refused(tmp_path: Path) -> None:
    path = pack(tmp_path / "liar.3mf", b" " * (8 << 20))
    data = bytearray(path.read_bytes())
    for mark, offset in ((b"PK\x01\x02", 24), (b"PK\x03\x04", 22)):
        at = 0
        while (at := data.find(mark, at)) >= 0:
            if struct.unpack_from("<I", data, at + offset)[0] == 8 << 20:
                struct.pack_into("<I", data, at + offset, 1000)
            at += 4
    path.write_bytes(data)
    with pytest.raises(UnreadableFile):
        read_mesh(path)


def test_too_many_and_encrypted_entries_are_refused(tmp_path: Path) -> None:
    many = pack(tmp_path / "many.3mf", model(GOOD), {f"f{k}": b"" for k in range(1001)})
    with pytest.raises(UnreadableFile, match="entries"):
        read_mesh(many)
    path = pack(tmp_path / "secret.3mf", model(GOOD))
    data = bytearray(path.read_bytes())
    data[data.find(b"PK\x01\x02") + 8] |= 1
    path.write_bytes(data)
    with pytest.raises(UnreadableFile, match="encrypted"):
        read_mesh(path)


# -- hostile GLB and PLY -------------------------------------------------------------------------


def glb_with(tmp_path: Path, change: Callable[[dict[str, object]], object]) -> Path:
    path = write(tmp_path / "x.glb")
    data = path.read_bytes()
    size = struct.unpack("<I", data[12:16])[0]
    document = json.loads(data[20 : 20 + size])
    change(document)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + size :]
    path.write_bytes(
        b"glTF" + struct.pack("<IIII", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A) + text + rest
    )
    return path


GLB_TRICKS: dict[str, Callable[[dict[str, object]], object]] = {
    "huge count": lambda d: d["accessors"][0].update(count=1 << 40),  # type: ignore[index]
    "negative offset": lambda d: d["bufferViews"][0].update(byteOffset=-4),  # type: ignore[index]
    "outside": lambda d: d["bufferViews"][0].update(byteLength=1 << 30, byteOffset=1 << 29),  # type: ignore[index]
    "other file": lambda d: d["buffers"][0].update(uri="file:///etc/passwd"),  # type: ignore[index]
    "cycle": lambda d: d["nodes"][0].update(children=[0]),  # type: ignore[index]
    "no such mesh": lambda d: d["nodes"][-1].update(mesh=99),  # type: ignore[index]
    "no such node": lambda d: d["nodes"][0].update(children=[10**6]),  # type: ignore[index]
    "negative node": lambda d: d["nodes"][0].update(children=[-1]),  # type: ignore[index]
    "required extension": lambda d: d.update(extensionsRequired=["KHR_draco_mesh_compression"]),
    "nan place": lambda d: d["nodes"][1].update(translation=[float("nan"), 0, 0]),  # type: ignore[index]
    "wrong type": lambda d: d.update(nodes="x"),
    "no scene": lambda d: d.pop("scenes"),
    "missing accessor": lambda d: d["meshes"][0]["primitives"][0].update(indices=99),  # type: ignore[index]
}


@pytest.mark.parametrize("trick", GLB_TRICKS)
def test_a_hostile_glb_is_refused(tmp_path: Path, trick: str) -> None:
    with pytest.raises(UnreadableFile):
        read_mesh(glb_with(tmp_path, GLB_TRICKS[trick]))


@pytest.mark.daily_cases(
    "element vertex-element vortex",
    "element face 672-element face 2000000000",
    "property double x-property quadruple x",
    "format binary_little_endian-format binary_middle_endian",
    "end_header-end_hodder",
)
@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"element vertex", b"element vortex"),
        (b"element face 672", b"element face 2000000000"),
        (b"property double x", b"property quadruple x"),
        (b"property list uchar int", b"property list uchar uint8"),
        (b"format binary_little_endian", b"format binary_middle_endian"),
        (b"end_header", b"end_hodder"),
    ],
)
def test_a_ply_whose_header_lies_is_refused(tmp_path: Path, old: bytes, new: bytes) -> None:
    path = write(tmp_path / "x.ply")
    data = path.read_bytes()
    assert old in data
    path.write_bytes(data.replace(old, new))
    with pytest.raises(UnreadableFile):
        read_mesh(path)


@pytest.fixture
def no_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    without_worker(monkeypatch)


@pytest.mark.usefixtures("no_worker")
@pytest.mark.parametrize("suffix", FORMATS)
@settings(
    max_examples=25,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
    derandomize=True,
)
@given(
    spots=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), min_size=1, max_size=8),
    cut=st.floats(0.5, 1.0),
)
def test_mangled_bytes_give_a_mesh_or_a_refusal_and_nothing_else(
    tmp_path: Path, suffix: str, spots: list[tuple[float, int]], cut: float
) -> None:
    path = write(tmp_path / f"toy{suffix}")
    data = bytearray(path.read_bytes())
    for where, value in spots:
        data[int(where * (len(data) - 1))] = value
    path.write_bytes(data[: int(cut * len(data))])
    try:
        mesh = read_mesh(path)
    except UnreadableFile:
        return
    for corners in mesh.chunks():
        assert np.isfinite(corners).all()


@pytest.mark.slow
@pytest.mark.parametrize("encoding", ["binary", "ascii"])
def test_numbers_that_others_write_beside_a_face_are_skipped(tmp_path, encoding):
    trimesh = pytest.importorskip("trimesh")
    box = trimesh.creation.box()
    box.face_attributes["stl"] = np.arange(len(box.faces), dtype=np.uint16)
    path = tmp_path / "box.ply"
    path.write_bytes(trimesh.exchange.ply.export_ply(box, encoding=encoding, include_attributes=True))
    assert b"property ushort stl" in path.read_bytes()
    (part,) = read_ply(path).parts
    np.testing.assert_array_equal(part.triangles, box.faces)
    np.testing.assert_allclose(part.vertices, box.vertices, atol=1e-7)


PLY_HEAD = (
    "ply\nformat {} 1.0\ncomment TextureFile /etc/passwd\nelement vertex 5\nproperty float x\nproperty uchar red\n"
    "property double y\nproperty float z\nelement face 2\nproperty short first\nproperty list uchar uint vertex_index\n"
    "property float u\nend_header\n"
)
PLY_POINTS = [(0, 9, 0, 0), (2, 9, 0, 0), (2, 9, 3, 0), (0, 9, 3, 0), (1, 9, 4, 0)]
PLY_FACES = [[0, 1, 2, 3], [3, 2, 4]]


def ply_text(faces: list[list[int]]) -> str:
    rows = [" ".join(map(str, point)) for point in PLY_POINTS]
    return "\n".join([*rows, *(f"-1 {len(f)} {' '.join(map(str, f))} 0.5" for f in faces), ""])


@pytest.mark.usefixtures("no_worker")
@pytest.mark.parametrize("order", "<>")
def test_a_binary_ply_of_either_byte_order_and_of_polygons_is_read(tmp_path, order):
    path = tmp_path / "x.ply"
    head = PLY_HEAD.format("binary_little_endian" if order == "<" else "binary_big_endian").encode()
    rows = b"".join(struct.pack(order + "fBdf", *point) for point in PLY_POINTS)
    quads = [[0, 1, 2, 3], [3, 2, 4, 0]]
    path.write_bytes(head + rows + b"".join(struct.pack(order + "hB4If", -1, 4, *f, 0.5) for f in quads))
    (part,) = read_ply(path).parts
    np.testing.assert_array_equal(part.vertices, np.array(PLY_POINTS, float)[:, [0, 2, 3]])
    np.testing.assert_array_equal(part.triangles, [[0, 1, 2], [3, 2, 4], [2, 3, 0], [4, 0, 3]])
    path.write_bytes(
        head + rows + b"".join(struct.pack(f"{order}hB{len(f)}If", -1, len(f), *f, 0.5) for f in PLY_FACES)
    )
    with pytest.raises(UnreadableFile, match=r"^x\.ply: "):
        read_ply(path)  # rows of different lengths cannot be distinguished


@pytest.mark.slow
def test_an_ascii_ply_of_triangles_and_polygons_is_read(tmp_path):
    path = tmp_path / "x.ply"
    path.write_text(PLY_HEAD.format("ascii") + ply_text(PLY_FACES))
    (part,) = read_ply(path).parts
    corners = np.array(PLY_POINTS, float)[:, [0, 2, 3]][part.triangles]
    areas = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    np.testing.assert_allclose(np.sort(areas), [1.0, 3.0, 3.0])


@pytest.mark.usefixtures("no_worker")
@pytest.mark.parametrize(("old", "new"), [
    ("2 9 3 0", "2 9 3 nan"), ("2 9 3 0", "2 9 3"), ("2 9 3 0", "2 9 3 0 0"), ("2 9 3 0", "2 9 three 0"),
    ("0 1 2 3", "0 1 2 5"), ("0 1 2 3", "0 1 2 -1"), ("0 1 2 3", "0 1 2 1e30"), ("-1 3", "-1 2"), ("-1 3", "-1 4"),
    ("4 0.5", "4 0.5 1"),
])  # fmt: skip
def test_an_ascii_ply_that_trimesh_would_take_is_refused_by_its_name(tmp_path, old, new):
    path = tmp_path / "x.ply"
    text = ply_text(PLY_FACES)
    assert old in text
    path.write_text(PLY_HEAD.format("ascii") + text.replace(old, new))
    with pytest.raises(UnreadableFile, match=r"^x\.ply: "):
        read_ply(path)


@pytest.mark.slow
def test_lines_read_by_the_kernel_are_numbers_as_python_reads_them() -> None:
    """Shortest texts of doubles of many sizes, and 18 digits next to the middle between two doubles."""
    rng = np.random.default_rng(8)
    values = rng.normal(size=6000) * 10.0 ** rng.integers(-5, 16, size=6000)
    words = [*map(repr, values.tolist()), "0.0", "-0.0", "5e-05", "12", "-7.25e+2", "0.000000000000000000001"]
    with mpmath.workdps(60):
        for value in np.abs(values[:1000]).tolist():
            middle = mpmath.mpf(value) + (mpmath.mpf(np.nextafter(value, np.inf)) - mpmath.mpf(value)) / 2
            words += [mpmath.nstr(middle, digits, min_fixed=-9, max_fixed=19) for digits in (17, 18)]
    words += ["1.0"] * (-len(words) % 3)
    lines = [words[n : n + 3] for n in range(0, len(words), 3)]
    marks, ends = threemf._marks(threemf.VERTEX)
    read = 0
    for line in lines:
        text = b"".join(a + b.encode() for a, b in zip(threemf.VERTEX, [*line, ""], strict=True))
        found = np.empty((1, 3))
        count, behind = read_lines(np.frombuffer(text, dtype=np.uint8), marks, ends, False, found)
        assert (count, behind) in ((1, len(text)), (0, 0))
        if count:
            read += 1
            assert found[0].tolist() == [float(word) for word in line]
            assert np.signbit(found[0]).tolist() == [word.startswith("-") for word in line]
    assert read > 0.95 * len(lines)
    for text in (
        b'<vertex x="1" y="2" z="3" />\n',
        b'<vertex x="1." y="2" z="3',
        b'<vertex x="" y="2" z="3"/>\n',
    ):
        found = np.empty((1, 3))
        assert read_lines(np.frombuffer(text, dtype=np.uint8), marks, ends, False, found) == (0, 0)
