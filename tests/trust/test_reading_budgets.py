"""Files from elsewhere that take too much: every reader has a budget, and what is over it is refused with status 3."""

from __future__ import annotations

import json
import random
import struct
import zipfile
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from filesonly import only_files
from trust.judging import tiny
from trust.running import TINY
from trust.spoiling import glb

from clacad.base.untrusted_files import BUDGETS
from clacad.exporting.formats.registry import kind_of
from clacad.exporting.run import export
from clacad.formats.mesh.readers import read_mesh
from clacad.storage.errors import OverBudget, UnreadableFile
from clacad.verification import verify

MAPS = ("sag", "tiff", "png", "xyz", "table", "mask", "gds")
READERS = {"tiny.stl": "stl", "ascii.stl": "stl-ascii", "tiny.3mf": "3mf", "tiny.ply": "ply", "ascii.ply": "ply-ascii",
           "tiny.glb": "glb", "tiny.obj": "obj"}  # fmt: skip
OF_MAPS = {"tiff32": "tiff", "tiff16": "tiff", "png16": "png", "xyz-normals": "points", "grid-sag": "grid-sag", "pose-table": "pose-table",
           "surface-table": "surface-table", "height-calibration": "surface-table", "mask-svg": "mask", "mask-dxf": "mask", "gds": "gds"}  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files of the tiny design in every format that is read, the manifest taken away."""
    folder = tmp_path_factory.mktemp("made")
    export(tiny(), folder, formats=("step", "brep", "stl", "3mf", "ply", "glb", *MAPS), quads=2)
    mesh = read_mesh(folder / "tiny.stl")
    corners = np.concatenate(list(mesh.chunks()))
    facets = "".join(
        "facet normal 0 0 1\nouter loop\n" + "".join(f"vertex {x!r} {y!r} {z!r}\n" for x, y, z in facet.tolist())
        + "endloop\nendfacet\n" for facet in corners
    )  # fmt: skip
    (folder / "ascii.stl").write_text(f"solid a\n{facets}endsolid a\n")
    rows = corners.reshape(-1, 3)
    head = f"ply\nformat ascii 1.0\nelement vertex {len(rows)}\nproperty double x\nproperty double y\nproperty double z\n"
    head += f"element face {len(corners)}\nproperty list uchar int vertex_indices\nend_header\n"
    words = "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in rows.tolist())
    words += "".join(f"3 {3 * k} {3 * k + 1} {3 * k + 2}\n" for k in range(len(corners)))
    (folder / "ascii.ply").write_text(head + words)
    lines = [f"v {x!r} {y!r} {z!r}\n" for x, y, z in rows.tolist()]
    (folder / "tiny.obj").write_text(
        "".join([*lines, *(f"f {3 * k + 1} {3 * k + 2} {3 * k + 3}\n" for k in range(len(corners)))])
    )
    (folder / "manifest.json").unlink()
    return folder


@pytest.fixture(autouse=True)
def _only_files(monkeypatch: pytest.MonkeyPatch) -> None:
    only_files(monkeypatch)


def budget(monkeypatch: pytest.MonkeyPatch, reader: str, **changes: Any) -> None:
    """Give one reader another budget."""
    monkeypatch.setattr(
        "clacad.storage.reading.BUDGETS", {**BUDGETS, reader: replace(BUDGETS[reader], **changes)}
    )
    monkeypatch.setattr("clacad.storage.reading.LOOK", 1)


LESS: dict[str, tuple[dict[str, Any], str]] = {
    "bytes": ({"bytes": 20}, "are more than the 20 that are read"),
    "items": ({"items": 3}, "more than 3 "),
    "seconds": ({"seconds": 0.0, "seconds_per_megabyte": 0.0}, "of processor time"),
}


@pytest.mark.ci_cases("tiny.3mf-seconds", "ascii.ply-items", "tiny.glb-bytes", "tiny.obj-seconds")
@pytest.mark.daily_cases(
    "tiny.stl-bytes",
    "tiny.stl-items",
    "tiny.stl-seconds",
    "ascii.stl-bytes",
    "ascii.stl-items",
    "ascii.stl-seconds",
    "tiny.3mf-bytes",
    "tiny.3mf-items",
)
@pytest.mark.parametrize("what", LESS)
@pytest.mark.parametrize("name", READERS)
def test_a_mesh_file_over_its_readers_budget_is_refused_by_what_it_takes(
    made: Path, monkeypatch: pytest.MonkeyPatch, name: str, what: str
) -> None:
    assert read_mesh(made / name).facet_count > 3
    changes, words = LESS[what]
    budget(monkeypatch, READERS[name], **changes)
    with pytest.raises(OverBudget, match=words) as caught:
        list(read_mesh(made / name).chunks())
    assert str(caught.value).startswith(name)
    assert caught.value.exit_status == 3


def of_format(folder: Path, format: str) -> Path:
    kind = kind_of(format)
    return next(path for path in sorted(folder.iterdir()) if path.name.endswith(kind.ends))


@pytest.mark.ci_cases("tiff16", "xyz-normals", "pose-table", "gds")
@pytest.mark.daily_cases("mask-svg", "mask-dxf")
@pytest.mark.parametrize("format", OF_MAPS)
def test_a_map_or_table_over_its_readers_budget_is_a_refusal_and_no_failure(
    made: Path, monkeypatch: pytest.MonkeyPatch, format: str
) -> None:
    if format == "gds":
        pytest.importorskip("gdstk")
    path, reader = of_format(made, format), OF_MAPS[format]
    assert verify(tiny(), path, rays=256).checks
    changes, words = LESS["bytes" if BUDGETS[reader].items is None else "items"]
    budget(monkeypatch, reader, **changes)
    report = verify(tiny(), path, rays=256)
    [readable] = [check for check in report.checks if check.id == "readable"]
    assert readable.state == "fail"
    assert words in readable.sentence
    assert report.exit_status == 3


def test_what_else_is_wrong_with_a_delivery_counts_for_more_than_a_refusal(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "large.ply").write_bytes((made / "tiny.ply").read_bytes())
    budget(monkeypatch, "ply", items=3)
    assert verify(tiny(), tmp_path, rays=256).exit_status == 3
    (tmp_path / "noise.stl").write_bytes(random.Random(0).randbytes(500))
    assert verify(tiny(), tmp_path, rays=256).exit_status == 1


# -- 3MF ---------------------------------------------------------------------------------------------


def model_with(tmp_path: Path, made: Path, old: str, new: str) -> Path:
    """The 3MF file with something in its model replaced, stored as it is."""
    path = tmp_path / "x.3mf"
    with zipfile.ZipFile(made / "tiny.3mf") as archive, zipfile.ZipFile(path, "w") as out:
        for name in archive.namelist():
            text = archive.read(name)
            if name.endswith(".model"):
                assert old.encode() in text
                text = text.replace(old.encode(), new.encode(), 1)
            out.writestr(name, text)
    return path


LONG = "x" * 3_000_000


@pytest.mark.parametrize(("old", "new", "line"), [
    ("<resources>", f"<resources>\n<!--{LONG}-->", r"line [2-9]"), ("<resources>", f'<resources a="{LONG}">', r"line [1-9]"),
    ("<resources>", f"<resources>\n<?{LONG}?>", r"line [2-9]"), ("<resources>", f"<resources><{LONG}/>", r"line [1-9]"),
], ids=["comment", "attribute", "instruction", "name"])  # fmt: skip
def test_one_token_of_megabytes_is_refused_at_its_place(
    tmp_path: Path, made: Path, old: str, new: str, line: str
) -> None:
    """The parser begins a token again with every block: its time would grow as the square of the length."""
    with pytest.raises(UnreadableFile, match=rf"262,144 bytes begins at byte [\d,]+ of its XML, in {line}"):
        read_mesh(model_with(tmp_path, made, old, new))


def test_long_text_between_tags_is_no_token(tmp_path: Path, made: Path) -> None:
    changed = model_with(tmp_path, made, "<resources>", f"<resources>{LONG}")
    assert read_mesh(changed).facet_count == read_mesh(made / "tiny.3mf").facet_count


def test_a_list_of_entries_beyond_a_megabyte_is_refused_before_it_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "x.3mf"
    with zipfile.ZipFile(path, "w") as archive:
        for k in range(25_000):
            archive.writestr(zipfile.ZipInfo(f"a{k}"), b"")
    monkeypatch.setattr(zipfile, "ZipFile", lambda *_: pytest.fail("its entries were listed"))
    with pytest.raises(UnreadableFile, match="list of entries has more than 1,048,576 bytes"):
        read_mesh(path)


# -- small files that request much --------------------------------------------------------------------


def test_a_glb_that_names_one_array_a_thousand_times_is_held_to_the_sum(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    corners = np.zeros((300, 3), "<f4")
    document = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}] * 1000}], "buffers": [{"byteLength": corners.nbytes}],
        "bufferViews": [{"buffer": 0, "byteLength": corners.nbytes}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 300, "type": "VEC3"}],
    }  # fmt: skip
    (tmp_path / "x.glb").write_bytes(glb(document, corners.tobytes()))
    assert read_mesh(tmp_path / "x.glb").facet_count == 100_000
    budget(monkeypatch, "glb", items=299_999)
    with pytest.raises(OverBudget, match="more than 299,999 vertices"):
        read_mesh(tmp_path / "x.glb")


@pytest.mark.parametrize("name", ["x.obj", "ascii.stl", "x.xyz"])
def test_a_line_without_end_is_refused(tmp_path: Path, name: str) -> None:
    from clacad.formats.maps.sag import read_points

    path = tmp_path / name
    path.write_bytes((b"solid " if name == "ascii.stl" else b"# ") + b"x" * 200_000)
    with pytest.raises(UnreadableFile, match="line 1 has more than 65,536 bytes"):
        list(read_points(path)) if name == "x.xyz" else read_mesh(path)


@pytest.mark.parametrize("text", ["", "\n" * 50, "a,b,c\n" + '"' + "x" * 200_000, "\xff\xfe", "a\nface,1,2\n"],
                         ids=["empty", "blank", "one field", "no letters", "short"])  # fmt: skip
def test_a_pose_table_that_is_none_fails_its_checks_and_nothing_else(tmp_path: Path, text: str) -> None:
    path = tmp_path / "x.poses.csv"
    path.write_bytes(text.encode("latin-1"))
    report = verify(tiny(), path, rays=256)
    assert report.exit_status == 1
    assert {c.state for c in report.checks if c.id == "readable"} == {"fail"}


def test_a_step_statement_of_many_blocks_is_begun_anew_a_few_times_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from clacad.formats.step import text_health

    class Counting:
        looked = 0

        def match(self, text: str, at: int) -> Any:
            Counting.looked += len(text) - at
            return pattern.match(text, at)

    pattern = text_health._STATEMENT
    monkeypatch.setattr(text_health, "_STATEMENT", Counting())
    monkeypatch.setattr(text_health, "_CHUNK", 1 << 12)
    text = "ISO-10303-21;\n#1=X(" + "#2," * 400_000 + "#3);\nEND-ISO-10303-21;\n"
    (tmp_path / "x.step").write_text(text)
    assert len(list(text_health.statements(tmp_path / "x.step"))) == 3
    assert Counting.looked < 4 * len(text)


# -- solids: the worker has limits ---------------------------------------------------------------------


@pytest.mark.daily_cases("bytes-tiny.step", "bytes-tiny.brep")
@pytest.mark.parametrize("name", ["tiny.step", "tiny.brep"])
@pytest.mark.parametrize(("changes", "words"), [
    ({"memory": 400_000_000, "memory_per_byte": 0}, "out of memory"),
    ({"bytes": 1000}, "more than the 1,000"),
], ids=["memory", "bytes"])  # fmt: skip
def test_a_solid_that_takes_too_much_fails_readable_with_the_reason(
    made: Path, monkeypatch: pytest.MonkeyPatch, name: str, changes: dict[str, Any], words: str
) -> None:
    budget(monkeypatch, name.rpartition(".")[2], **changes)
    report = verify(tiny(), made / name, rays=256)
    [readable] = [check for check in report.checks if check.id == "readable"]
    assert (readable.state, report.exit_status) == ("fail", 3)
    assert words in readable.sentence


def test_a_workers_limits_grow_with_the_file_and_end_at_what_is_free(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from clacad.exporting.formats import registry as asked
    from clacad.storage import worker as home

    path = tmp_path / "x.step"
    kept = []
    monkeypatch.setattr(home, "Worker", lambda memory, cpu: kept.append((memory, cpu)))
    for size, free in ((0, 1 << 40), (10_000_000, 1 << 40), (10_000_000, 1_000_000_000)):
        path.write_bytes(b"\0" * size)
        monkeypatch.setattr(home, "worker_memory", lambda free=free: free)
        asked.reading_worker(path)
    row = BUDGETS["step"]
    assert kept[0] == (row.memory, row.seconds)
    assert kept[1] == (
        row.memory + 10_000_000 * row.memory_per_byte,
        row.seconds + 10 * row.seconds_per_megabyte,
    )
    assert kept[2][0] == 1_000_000_000


@pytest.mark.slow
def test_a_grey_mask_on_which_its_library_crashes_fails_its_checks(made: Path, tmp_path: Path) -> None:
    """Found among mutants: the library that reads GDSII takes lengths inside records at their word."""
    pytest.importorskip("gdstk")
    good = of_format(made, "gds").read_bytes()
    at = good.index(struct.pack(">H", 0x1003))  # XY: its length counts the corners that follow
    data = good[: at - 2] + struct.pack(">HH", 4, 0x1003) + good[at + 2 + 40 :]
    path = tmp_path / "x.gds"
    path.write_bytes(data)
    report = verify(tiny(), path, rays=256)
    [readable] = [check for check in report.checks if check.id == "readable"]
    assert readable.state == "fail"
    assert report.exit_status in (
        1,
        3,
    )  # it crashes, or wants more memory than there is: what lies behind its array decides


# -- manifests, designs, rays, the doctor --------------------------------------------------------------


def test_a_manifest_over_its_budget_is_refused_and_not_taken_for_none(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "tiny.stl").write_bytes((made / "tiny.stl").read_bytes())
    entry = {"name": "tiny.stl", "format": "stl-binary"}
    (tmp_path / "manifest.json").write_text(json.dumps({"format": 1, "files": [entry] * 5}))
    budget(monkeypatch, "manifest", items=4)
    with pytest.raises(OverBudget, match=r"manifest\.json: more than 4 files"):
        verify(tiny(), tmp_path, rays=256)


def test_a_file_that_a_manifest_lists_again_is_judged_once(made: Path, tmp_path: Path) -> None:
    (tmp_path / "tiny.stl").write_bytes((made / "tiny.stl").read_bytes())
    entry = {"name": "tiny.stl", "format": "stl-binary"}
    (tmp_path / "manifest.json").write_text(json.dumps({"format": 1, "files": [entry] * 50}))
    report = verify(tiny(), tmp_path, rays=256)
    assert len([check for check in report.checks if check.id == "readable"]) == 1
    again = [check for check in report.checks if check.id == "integrity" and "again" in check.sentence]
    assert {check.state for check in again} == {"fail"}


def test_rays_over_their_budget_are_refused_before_a_ray_is_traced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from clacad.cli import main

    (tmp_path / "t.toml").write_text(TINY)
    monkeypatch.chdir(tmp_path)
    np.savez_compressed(
        "r.npz", position=np.zeros((100_000, 3)), direction=np.tile([0.0, 0.0, 1.0], (100_000, 1))
    )
    assert main(["trace", "t.toml", "r.npz", "-o", "out.npz", "--rung", "law", "-q"]) == 0, (
        "well packed, and honest"
    )
    budget(monkeypatch, "rays", items=99_999)
    assert main(["trace", "t.toml", "r.npz", "-o", "out2.npz", "--rung", "law"]) == 3
    assert "more than 99,999 rays" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["check", "render", "effects", "export"])
def test_a_design_or_scene_beyond_16_megabytes_is_refused_by_the_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    from clacad.cli import main

    monkeypatch.chdir(tmp_path)
    with open("big.toml", "wb") as stream:
        stream.truncate((16 << 20) + 1)
    out = {"render": ["-o", "x.png"], "export": ["-o", "x"]}.get(command, [])
    assert main([command, "big.toml", *out]) == 3
    assert "too large" in capsys.readouterr().err


def test_a_design_of_more_lines_and_keys_than_are_read_is_refused_before_it_is_parsed(tmp_path: Path) -> None:
    from clacad.config.mistakes import DesignTooLarge
    from clacad.design import load

    many = 200_001
    for name, text in (
        ("l.toml", "\n" * many),
        ("k.toml", "a={" + "b=1," * many),
        ("k.json", "{" + "a:1," * many),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(DesignTooLarge, match="too many lines and keys for a design"):
            load(tmp_path / name)


def test_one_corner_far_away_is_no_sheet_of_as_many_cells(made: Path, tmp_path: Path) -> None:
    from clacad.verification import CannotRegister

    data = bytearray((made / "tiny.stl").read_bytes())
    data[84 + 12 : 84 + 24] = struct.pack("<3f", 0.0, 3e38, 0.0)
    (tmp_path / "x.stl").write_bytes(data)
    with pytest.raises(CannotRegister):
        verify(tiny(), tmp_path / "x.stl", rays=256)


def test_a_manifest_with_more_cells_than_are_ever_written_is_refused(made: Path, tmp_path: Path) -> None:
    from clacad.storage.errors import LimitRefused

    (tmp_path / "tiny.stl").write_bytes((made / "tiny.stl").read_bytes())
    entry, cells = {"name": "tiny.stl", "format": "stl-binary"}, {"cells_written": [10**9, 10**9]}
    (tmp_path / "manifest.json").write_text(json.dumps({"format": 1, "files": [entry], "window": cells}))
    with pytest.raises(LimitRefused, match="lenslets"):
        verify(tiny(), tmp_path, rays=256)


def test_the_doctor_states_the_budget_of_every_reader(monkeypatch: pytest.MonkeyPatch) -> None:
    from clacad import doctor

    found = {one.name: one for one in doctor._readers()}
    assert set(found) == set(BUDGETS)
    for name, row in BUDGETS.items():
        assert found[name].value == row.bytes
        assert row.items is None or f"{row.items:,} {row.item}" in found[name].sentence
        assert row.seconds is None or f"{row.seconds:g} s of processor time" in found[name].sentence


# -- pictures ------------------------------------------------------------------------------------------


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(width: int, height: int, rows: bytes, *more: bytes) -> bytes:
    """A grey 8-bit PNG file of packed rows."""
    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
    return (
        b"\x89PNG\r\n\x1a\n"
        + head
        + b"".join(more)
        + chunk(b"IDAT", zlib.compress(rows))
        + chunk(b"IEND", b"")
    )


ROWS = (b"\0" + b"\x80" * 40) * 40
PICTURES: dict[str, tuple[bytes, int]] = {
    "bomb.png": (png(60_000, 60_000, b"\0" * 1000), 3),
    "large.png": (png(15_000, 10_000, b"\0" * 1000), 3),
    "text.png": (png(40, 40, ROWS, chunk(b"zTXt", b"a\0\0" + zlib.compress(b"x" * 80_000_000))), 2),
    "words.png": (png(40, 40, ROWS, *[chunk(b"tEXt", b"a\0" + b"x" * 900_000)] * 80), 2),
    "cut.png": (png(4000, 400, (b"\0" + random.Random(0).randbytes(4000)) * 400)[:2000], 2),
    "short.png": (png(40, 40, ROWS[:100]), 2),
    "none.png": (b"\x89PNG\r\n\x1a\n" + b"\0" * 100, 2),
    "figure.eps": (b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 10 10\n%%EndComments\nshowpage\n%%EOF\n", 2),
    "figure.ppm": (b"P6 4 4 255\n" + b"\0" * 48, 2),
    "noise.jpg": (b"\xff\xd8\xff" + random.Random(1).randbytes(3000), 2),
    "empty.png": (b"", 2),
}  # fmt: skip


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_that_is_none_or_too_much_is_answered_by_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    from clacad.cli import main

    (tmp_path / "t.toml").write_text(TINY)
    data, status = PICTURES[name]
    (tmp_path / name).write_bytes(data)
    monkeypatch.chdir(tmp_path)
    line = ["render", "t.toml", name, "--preset", "eye", "--pixels", "16", "-o", "x.png"]
    assert main(line) == status
    said = capsys.readouterr().err
    assert name in said
    assert "Traceback" not in said
    assert not (tmp_path / "x.png").exists()


def test_a_large_picture_is_kept_as_means_of_blocks_of_linear_light(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from PIL import Image

    from clacad.rendering import photographs

    seen = np.random.default_rng(0).integers(0, 256, (31, 47, 3), dtype=np.uint8)
    Image.fromarray(seen).save(tmp_path / "a.png")
    monkeypatch.setattr(photographs, "KEPT", 31 * 47 // 4)
    monkeypatch.setattr(photographs, "_STRIP", 300)
    found = photographs.read_picture(tmp_path / "a.png")
    value = seen / 255.0
    light = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    want = np.array(
        [[light[r : r + 3, c : c + 3].mean(axis=(0, 1)) for c in range(0, 47, 3)] for r in range(0, 31, 3)]
    )
    np.testing.assert_allclose(found, want, rtol=1e-12)


@pytest.mark.slow
def test_a_large_grey_picture_takes_memory_of_what_is_kept(tmp_path: Path) -> None:
    """Peak of a process of its own, beyond that of one which reads a small picture."""
    import subprocess
    import sys

    side = 6000
    (tmp_path / "grey.png").write_bytes(png(side, side, (b"\0" + b"\x80" * side) * side))
    (tmp_path / "small.png").write_bytes(png(40, 40, ROWS))
    code = (
        "import resource,sys; from clacad.rendering.photographs import read_picture; read_picture(sys.argv[1]);"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
    )
    small, large = (
        int(
            subprocess.run(
                [sys.executable, "-c", code, tmp_path / name], capture_output=True, check=True
            ).stdout
        )
        for name in ("small.png", "grey.png")
    )
    assert large - small < 700_000, "kB; its pixels as numbers alone are 864,000"


def test_a_photograph_taken_upright_keeps_its_sides(tmp_path: Path) -> None:
    from PIL import Image

    from clacad.rendering.photographs import picture_size, read_picture

    picture = Image.new("RGB", (30, 20))
    exif = picture.getexif()
    exif[0x0112] = 6
    picture.save(tmp_path / "a.jpg", exif=exif)
    assert picture_size(tmp_path / "a.jpg") == (20, 30)
    assert read_picture(tmp_path / "a.jpg").shape == (30, 20, 3)
