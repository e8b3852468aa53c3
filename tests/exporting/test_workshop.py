"""Files for the tool as exports write them: read back, judged by the part they make, refused with a reason."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest

import clacad
from clacad.base.types import silent
from clacad.cli import main
from clacad.exporting.compensation import compensation_of
from clacad.formats.maps.raster import read_bmp, read_png
from clacad.formats.maps.tool_path import read_tool
from clacad.judging.delivery import list_files
from clacad.judging.judge_files import judge_files
from clacad.storage.errors import UnreadableFile

WINDOW = str(Path(__file__).parents[2] / "designs" / "window-100mm.toml")

MOULDED = [
    'check.process = "moulding"',
    "process.shrinkage = [0.006, 0.006, 0.006]",
    "lattice.count = [4, 3]",
]
UNEVEN = ['check.process = "moulding"', "process.shrinkage = [0.004, 0.004, 0.02]", "lattice.count = [4, 3]"]


def judged(design, folder) -> dict[str, list]:
    """Checks of a folder's files by file."""
    found: dict[str, list] = {}
    checks, _ = judge_files(design, clacad.prescribe(design), list_files(Path(folder)), None, 1024, silent)
    for check in checks:
        found.setdefault(check.subject, []).append(check)
    return found


def states(checks, kind: str) -> list[str]:
    return [check.state for check in checks if check.id == kind]


@pytest.fixture(scope="module")
def design():
    return clacad.load("window-100mm", MOULDED)


@pytest.fixture(scope="module")
def made(design, tmp_path_factory):
    folder = tmp_path_factory.mktemp("tooling")
    return clacad.export(design, folder, ["insert", "tool", "dose", "wedge"], tool_step=0.05, nose=0.025)


def test_every_file_for_a_tool_is_named_tooling_with_what_it_is_compensated_for(made) -> None:
    for file in made.files:
        if file["format"].startswith("wedge"):
            assert file["role"] == "other"
        else:
            assert file["role"] == "tooling"
            assert file["compensation"]["shrinkage"] == [0.006, 0.006, 0.006]


@pytest.mark.slow
def test_all_of_it_passes_by_the_light_of_the_part_that_it_makes(design, made) -> None:
    found = judged(design, made.folder)
    exact = 0.1662e-3  # radians: what the exact surfaces leave, from `clacad check`
    for file in made.files:
        if "quads" in file:  # a flat facet of side h leans h/R/√6 over its area, and light by n − 1 of it
            facets = 0.5 / file["quads"] / 2.468 / np.sqrt(6.0) * 0.5
        assert not [c for c in found[file["name"]] if c.state == "fail"], file["name"]
        rms = [c.value for c in found[file["name"]] if c.id == "file_law_rms"]
        if rms and file["format"] == "insert-stl":  # its facets are those of the part that it moulds
            assert rms[0] == pytest.approx(np.hypot(exact, facets), rel=0.05), file["name"]
        elif rms:
            assert rms[0] == pytest.approx(exact, rel=0.02), file["name"]
    assert sum(bool(states(checks, "file_law_rms")) for checks in found.values()) == 14


def test_tool_points_under_moulding_are_those_of_the_insert(design, tmp_path) -> None:
    """By hand: concave spheres of R/(1 − s), the centre of the nose on spheres of R/(1 − s) − r, all in reach."""
    told = clacad.export(design, tmp_path, ["tool"], tool_step=0.05, nose=0.2)
    big, pitch = 2.468143364277402 / 0.994, 0.5 / 0.994
    for entry in told.files:
        table = np.concatenate(list(read_tool(told.folder / entry["name"])))
        u, v = (pitch * ((table[:, k] / pitch + half) % 1.0 - 0.5) for k, half in ((0, 0.0), (1, 0.5)))
        assert table[:, 2].min() > 0.0
        assert np.abs(np.linalg.norm([u, v, table[:, 2] - big], axis=0) - big).max() < 1e-12
        along = np.stack([u, v, table[:, 2] - big], axis=1) / -big
        assert np.abs(table[:, 3:6] - along).max() < 1e-12
        assert np.abs(table[:, 6:9] - table[:, :3] - 0.2 * along).max() < 1e-12
        assert table[:, 9].all()
        assert entry["share_not_reached"] == 0.0


def test_a_nose_in_the_insert_of_lenses_with_land_stays_off_its_walls(tmp_path) -> None:
    """By hand, on the line through the middle of a pit .45 wide: no centre comes closer to a wall than r."""
    keys = [
        'check.process = "moulding"',
        "process.shrinkage = 0",
        "lattice.count = [3, 3]",
        "lattice.seam = 0.05",
    ]
    told = clacad.export(clacad.load("window-100mm", keys), tmp_path, ["tool"], tool_step=0.01, nose=0.03)
    table = np.concatenate(list(read_tool(told.folder / told.files[0]["name"])))
    x = np.abs((table[:, 0] / 0.5 + 0.5) % 1.0 - 0.5) * 0.5
    line = (np.abs(table[:, 1]) < 0.006) & (np.abs(x - 0.225) > 1e-6)
    edge = 0.195 * 2.468143364277402 / 2.438143364277402  # the lens is touched with the centre at .225 − .03
    assert line.sum() > 100
    assert (table[line, 9] == ((x < edge) | (x > 0.225))[line]).all()
    assert (table[line & (x > 0.225), 2] > 0.02).all()


@pytest.mark.slow
def test_several_files_are_judged_together_where_they_are_of_one_export(made, tmp_path, capsys) -> None:
    names = [one["name"] for one in made.files if one["format"] in ("tool-points", "dose-8")]
    sets = [word for key in MOULDED for word in ("--set", key)]
    files = [str(made.folder / name) for name in names]
    words = ["verify", WINDOW, *sets, "--rays", "1024", "--role", "tooling", "--json", "--files"]
    assert main([*words, *files]) == 0
    told = json.loads(capsys.readouterr().out)
    assert {one["subject"] for one in told["checks"] if one["id"] == "file_law_rms"} == set(names)
    other = tmp_path / "part.stl"
    other.write_bytes(b"")
    assert main([*words, files[0], str(other)]) == 2
    assert "of one export" in capsys.readouterr().err


@pytest.mark.slow
def test_tool_points_of_both_orders_lie_on_the_same_face(tmp_path) -> None:
    design = clacad.load("window-100mm", ['check.process = "none"', *MOULDED[1:]])
    told = clacad.export(design, tmp_path, ["tool"], tool_step=0.05, nose=0.2, tool_order="spiral")
    entry = told.files[0]
    assert entry["order"] == "spiral"
    table = np.concatenate(list(read_tool(told.folder / entry["name"])))
    radius = np.hypot(*table[:, :2].T)
    assert radius[:50].mean() > radius[-50:].mean()  # from the rim to the middle
    growth = 1.0 / 0.994
    big, pitch = 2.468143364277402 * growth, 0.5 * growth
    u, v = ((table[:, k] / pitch + half) % 1.0 - 0.5 for k, half in ((0, 0.0), (1, 0.5)))
    centre = np.stack([u * pitch, v * pitch, table[:, 2] + big], axis=1)
    assert np.abs(np.linalg.norm(centre, axis=1) - big).max() < 1e-12  # spheres, shrinkage compensated
    assert np.abs(table[:, 3:6] * big - centre).max() < 1e-12
    assert np.abs(table[:, 6:9] - table[:, :3] - 0.2 * table[:, 3:6]).max() < 1e-12
    share = 1.0 - table[:, 9].mean()
    assert share == pytest.approx(1.0 - (big / (big + 0.2)) ** 2, abs=0.03)
    assert entry["share_not_reached"] == pytest.approx(1.0 - (big / (big + 0.2)) ** 2, abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("nose", "verdict"), [(0.025, "pass"), (0.4, "fail")])
def test_the_verdict_of_tool_points_is_by_what_the_nose_leaves(tmp_path, nose, verdict) -> None:
    """The points lie on the lens for every nose; of a sphere a nose reaches the share (R/(R + r))² by hand."""
    keys = ['check.process = "diamond-turning"', f'process.nose = "{nose} mm"', "lattice.count = [4, 3]"]
    part = clacad.load("window-100mm", keys)
    told = clacad.export(part, tmp_path, ["tool"], tool_step=0.1)
    for file in told.files:
        checks = judged(part, told.folder)[file["name"]]
        assert states(checks, "shape") == states(checks, "file_law_rms") == ["pass"]
        assert states(checks, "file_throughput") == [verdict]
        [share] = [one.value for one in checks if one.id == "file_throughput"]
        assert share == pytest.approx((2.468143364277402 / (2.468143364277402 + nose)) ** 2, abs=0.012)


@pytest.mark.slow
def test_tool_points_of_lenses_with_land_pass_by_the_light_of_the_part_that_they_make(tmp_path) -> None:
    part = clacad.load("tilted-seam", ["lattice.count = [3, 3]"])
    told = clacad.export(part, tmp_path, ["tool"], tool_step=0.1, nose=0.025)
    for file in told.files:
        assert file["left_at_seams"] > 0.01  # the foot of the step
        checks = judged(part, told.folder)[file["name"]]
        assert states(checks, "file_law_rms") == ["pass"]
        assert not [one for one in checks if one.state == "fail"]


def test_dose_maps_of_all_bits_hold_the_same_depths(made) -> None:
    stem = made.folder / "window-100mm.sheet-front"
    eight, bmp, fine = (
        read_png(Path(f"{stem}.dose8.png")),
        read_bmp(Path(f"{stem}.dose8.bmp")),
        read_png(Path(f"{stem}.dose16.png")),
    )
    assert (eight == bmp).all()
    assert np.abs(fine / 257.0 - eight).max() <= 0.5 + 1e-9
    from PIL import Image

    for name, wanted in (
        (f"{stem}.dose8.png", eight),
        (f"{stem}.dose8.bmp", bmp),
        (f"{stem}.dose16.png", fine),
    ):
        with Image.open(name) as picture:  # another reader finds the same
            assert (np.asarray(picture).astype(int) == wanted).all()
    assert eight.min() == 0
    assert 240 <= eight.max() <= 255  # the corners of cells lie half a pixel off


# -- wrong files -----------------------------------------------------------------------------------------


def stl_points(data: bytes) -> np.ndarray:
    return np.frombuffer(
        data, dtype=np.dtype([("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")]), offset=84
    )


def with_corners(data: bytes, change) -> bytes:
    """A binary STL with its corners changed; `change` of determinant below 0 turns the facets over."""
    table = stl_points(data).copy()
    corners = table["c"].astype(float) @ change.T
    table["c"] = corners if np.linalg.det(change) > 0 else corners[:, ::-1]
    table["n"] = 0.0
    return data[:80] + struct.pack("<I", len(table)) + table.tobytes()


WRONG = [
    (np.diag([1.0, -1.0, -1.0]), "it is not turned"),
    pytest.param(
        np.diag([1.0, 1.0, -1.0]), "it is not turned", marks=pytest.mark.slow
    ),  # square cells look alike mirrored: the same for both
    (np.eye(3) * 0.994, "not compensated for the shrinkage"),
    pytest.param(np.eye(3) * 0.994**2, "scaled by 1 - s", marks=pytest.mark.slow),
    pytest.param(np.diag([0.994, -0.994, -0.994]), "it is not turned", marks=pytest.mark.slow),
]


@pytest.mark.ci_cases(
    "change0-it is not turned", "change2-not compensated for the shrinkage", "change3-scaled by 1 - s"
)
@pytest.mark.slow
@pytest.mark.parametrize(("change", "reason"), WRONG)
def test_a_wrong_insert_fails_with_the_reason(design, made, tmp_path, change, reason) -> None:
    name = "window-100mm.sheet-back.insert.stl"
    (tmp_path / name).write_bytes(with_corners((made.folder / name).read_bytes(), change))
    manifest = json.loads((made.folder / "manifest.json").read_text())
    manifest["files"] = [one for one in manifest["files"] if one["name"] == name]
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    [shape] = [c for c in judged(design, tmp_path)[name] if c.id == "shape"]
    assert shape.state == "fail"
    assert reason in shape.sentence


@pytest.mark.slow
def test_an_insert_of_another_shrinkage_fails_by_its_light_and_its_shape(design, made, tmp_path) -> None:
    other = clacad.load("window-100mm", [*MOULDED[:1], "process.shrinkage = [0, 0, 0.05]", MOULDED[2]])
    found = judged(other, made.folder)["window-100mm.sheet-front.insert.step"]
    assert states(found, "shape") == ["fail"]
    assert states(found, "file_law_rms") == ["fail"]  # 5 % of height: 3.35 mrad where .165 is designed
    [rms] = [c.value for c in found if c.id == "file_law_rms"]
    assert 1.2e-3 < rms < 3.6e-3  # one face alone


# -- compensated files of the part -----------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("process", [MOULDED, UNEVEN], ids=["even", "uneven"])
def test_compensated_files_pass_and_plain_ones_named_tooling_fail(process, tmp_path) -> None:
    part = clacad.load("window-100mm", process)
    sent = clacad.export(part, tmp_path / "sent", ["step", "stl"], quads=16, compensate=True)
    assert {one["role"] for one in sent.files} == {"tooling"}
    found = judged(part, sent.folder)
    assert states(found["window-100mm.step"], "shape") == ["pass"]
    assert not [c for c in found["window-100mm.step"] if c.state == "fail"]
    assert states(found["window-100mm.stl"], "shape") == ["pass"]
    plain = clacad.export(part, tmp_path / "plain", ["step"])
    manifest = json.loads((plain.folder / "manifest.json").read_text())
    manifest["files"][0]["role"] = "tooling"
    (plain.folder / "manifest.json").write_text(json.dumps(manifest))
    [shape] = [c for c in judged(part, plain.folder)["window-100mm.step"] if c.id == "shape"]
    assert shape.state == "fail"
    assert "not compensated for the process" in shape.sentence


def test_a_compensated_sheet_shrinks_to_the_part_and_sinks_to_its_lenses() -> None:
    part = clacad.load("window-100mm", [*UNEVEN, 'process.sink = "0.5 um"'])
    window = clacad.prescribe(part)
    sent = compensation_of(part).window(window)
    x, y = np.random.default_rng(7).uniform(-0.249, 0.249, (2, 400))
    grown = 1.0 / 0.996
    for before, after in zip(window.faces, sent.faces, strict=True):
        out = -before.side
        half = 0.25 * grown
        dish = 0.5e-3 * (1.0 - (x * grown / half) ** 2) * (1.0 - (y * grown / half) ** 2)
        height = after.vertex[2] + after.surface.sag(x * grown, y * grown)
        made = (height - out * dish) * 0.98
        assert np.abs(made - before.vertex[2] - before.surface.sag(x, y)).max() < 1e-10


# -- bad input -------------------------------------------------------------------------------------------

BAD = [
    ("", "it is empty"),
    ("level,depht_um\n0,0\n1,1\n", "column 'depht_um'; did you mean depth_um"),
    ("level,depth_um\n0,0\n16,2\n32,1.5\n", "line 4: depth 1.5 um after 2 um"),
    ("level,depth_um\n0,0\n16,2\n16,3\n", "line 4: level 16 after 16"),
    ("level,depth_um\n0,0\n70000,2\n", "line 3: level 70000"),
    ("level,depth_um\n0,0\n1.5,2\n", "line 3: level 1.5"),
    ("level,depth_um\n0,0\n1,two\n", "line 3: '1,two' is not 2 finite numbers"),
    ("level,depth_um\n0,0\n", "1 levels"),
    ("level,depth_um\n0,0\n255,nan\n", "is not 2 finite numbers"),
    ("level,depth_um\n0,0\n255,20\n", "25.4539 um deep"),
]


@pytest.mark.parametrize(("text", "words"), BAD)
def test_a_calibration_that_cannot_be_used_is_refused_with_its_line(tmp_path, capsys, text, words) -> None:
    table = tmp_path / "dose.csv"
    table.write_text(text)
    out = tmp_path / "out"
    export = ["export", WINDOW, "-o", str(out), "--format", "dose", "--cells", "3x3"]
    status = main([*export, "--calibration", str(table)])
    assert status in (1, 2)
    assert words in " ".join(capsys.readouterr().err.split())
    assert not (out / "manifest.json").exists()


def test_a_calibration_larger_than_is_read_is_refused_unread(tmp_path) -> None:
    from clacad.formats.maps.dose import read_calibration

    table = tmp_path / "dose.csv"
    with table.open("wb") as stream:
        stream.truncate(1 << 30)
    with pytest.raises(UnreadableFile, match="more than"):
        read_calibration(table)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--format", "tool"], "no radius of the nose"),
        (["--format", "tool", "--nose", "0"], "a length > 0"),
        (["--format", "tool", "--nose", "25 um", "--tool-order", "zigzag"], "raster"),
        (["--format", "insert", "--set", "process.shrinkage=1.2"], "0.5"),
        (["--format", "step", "--role", "step=tooling"], "--compensate"),
    ],
)
def test_bad_options_of_tooling_are_refused(tmp_path, capsys, more, words) -> None:
    status = main(["export", WINDOW, "-o", str(tmp_path / "out"), "--cells", "2x2",
                   "--set", 'check.process="none"', *more])  # fmt: skip
    assert status == 2
    assert words in " ".join(capsys.readouterr().err.split())


def test_tool_files_that_are_damaged_are_named(tmp_path) -> None:
    path = tmp_path / "a.tool.csv"
    for text, words in (
        ("", "column ''"),
        ("x,y,z,nx,ny,nz,cx,cy,cz,speed\n", "column 'speed'"),
        ("x,y,z,nx,ny,nz,cx,cy,cz,reachable\n", "no points"),
        ("x,y,z,nx,ny,nz,cx,cy,cz,reachable\n1,2,3\n", "finite numbers"),
        ("x,y,z,nx,ny,nz,cx,cy,cz,reachable\n1,2,3,0,0,1,1,2,nan,1\n", "finite numbers"),
    ):
        path.write_text(text)
        with pytest.raises(UnreadableFile, match=words):
            list(read_tool(path))
