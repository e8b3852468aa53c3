"""The files of a stack: what an independent reader finds in them, and that a changed one fails."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import clacad
from clacad.checks.check import Check, passed
from clacad.cli import main
from clacad.sheet.stack import stacked
from clacad.stacking import stack
from clacad.stacking.assembly import StackAssembly
from clacad.stacking.judge_stack import judge_stack
from clacad.storage.atomic import Stage
from clacad.storage.errors import ExportRefused
from clacad.storage.worker import Worker

ROOT = Path(__file__).parents[2]
FILE = ROOT / "designs" / "window-100mm.toml"
DESIGN = clacad.load(FILE)
OTHER = DESIGN.replace("law.eta", [-0.5, -0.5])
CELLS = (6, 6)
SMALL = ("--cells", "6x6", "--rays", "256")
FIELD = 0.004
"""Light of the checks keeps to few cells of the second sheet."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two sheets that differ, as one assembly."""
    out = tmp_path_factory.mktemp("stack")
    stack([DESIGN, OTHER], 20.0, out, cells=CELLS, rays=256, quads=4, field=FIELD)
    return out


def judged(folder: Path, gap: float = 20.0, eta: float = -0.5) -> list[Check]:
    """Checks of files against a stack with a given gap and eta."""
    designs = [one.with_cells(CELLS) for one in (DESIGN, DESIGN.replace("law.eta", [eta, eta]))]
    standing = stacked([clacad.prescribe(one) for one in designs], [gap])
    return judge_stack(standing, designs, folder, FIELD, lambda *_: None)


def command(*words: object) -> int:
    return main([str(word) for word in words])


def test_the_cad_kernel_finds_every_sheet_in_its_place_and_a_repeated_one_once(tmp_path: Path) -> None:
    """Solids, heights, and the number of prototypes, read by OCC directly."""
    from clacad.formats.step.read_back import read_step
    from clacad.formats.step.step_files import write_step_stack

    window, other = (clacad.prescribe(one.with_cells((2, 2))) for one in (DESIGN, OTHER))
    write_step_stack(
        [("a", window, 0.0), ("b", window, 30.0), ("c", other, 50.0)], "three", tmp_path / "s.step"
    )
    found = read_step(tmp_path / "s.step")
    assert found["kernel_solids"] == 3
    assert found["valid"]
    assert found["holds"]["prototypes"] == 2
    (low, high), exact = (
        found["box"],
        [(w.z_range[0] + z, w.z_range[1] + z) for w, z in ((window, 0.0), (other, 50.0))],
    )
    assert low[2] == pytest.approx(exact[0][0], abs=0.1)  # the kernel boxes the poles of a patch
    assert high[2] == pytest.approx(exact[1][1], abs=0.1)
    text = (tmp_path / "s.step").read_text(encoding="ascii")
    assert all(f"NEXT_ASSEMBLY_USAGE_OCCURRENCE('{name}'" in text for name in "abc")


@pytest.mark.slow
def test_a_stranger_reads_the_glb_with_every_sheet_where_it_stands(made: Path) -> None:
    """trimesh, which knows nothing of this program: corners' heights in metres."""
    import trimesh

    scene = trimesh.load(made / "stack.glb")
    low, high = scene.bounds
    manifest = json.loads((made / "manifest.json").read_text(encoding="utf-8"))
    spans = [one["span"] for one in manifest["stack"]["sheets"]]
    assert low[2] * 1e3 == pytest.approx(spans[0][0], abs=0.05)
    assert high[2] * 1e3 == pytest.approx(spans[1][1], abs=0.05)
    heights = sorted(
        {round(float(t[2, 3]) * 1e3, 6) for t in (scene.graph.get(n)[0] for n in scene.graph.nodes_geometry)}
    )
    assert heights == pytest.approx([one["z"] for one in manifest["stack"]["sheets"]], abs=1e-5)


@pytest.mark.slow
def test_what_was_written_passes_as_masters_and_light_goes_through_all_of_it(made: Path) -> None:
    checks = judged(made)
    assert passed(checks), [(c.id, c.subject, c.sentence) for c in checks if c.state not in ("pass", "warn")]
    light = next(c for c in checks if c.id == "stack_light")
    assert light.value is not None
    assert float(light.value) < 1e-10
    assert {c.subject for c in checks if c.id == "file_law_rms"} == {
        f"stack.step sheet {name}" for name in "ab"
    }


@pytest.mark.slow
def test_sheets_of_two_and_of_three_bodies_stand_in_one_assembly(tmp_path: Path) -> None:
    """Two plates of one eta, and three bodies of two: ten faces in a row, by the CAD kernel's own rays."""
    keys = {"pair.field_lens": True, "check.process": "none"}
    designs = [DESIGN.replace(keys), DESIGN.replace(keys | {"law.eta": [-0.5, -1.0]})]
    made = stack(designs, 20.0, tmp_path, cells=(4, 4), rays=256, quads=4, field=FIELD)
    assert [len(one.window.bodies) for one in made.stack.sheets] == [2, 3]
    small = [one.with_cells((4, 4)) for one in designs]
    checks = judge_stack(made.stack, small, tmp_path, FIELD, lambda *_: None)
    assert passed(checks), [(c.id, c.subject, c.sentence) for c in checks if c.state not in ("pass", "warn")]
    light = next(c for c in checks if c.id == "stack_light")
    assert "10 faces" in light.sentence
    assert light.value is not None
    assert float(light.value) < 1e-10


UNEVEN = [
    {"law.varying.f_image": 200},
    {"lattice.aperture": {"point": [0, 0, -400]}, "law.varying.f_image": -300, "pair.field_lens": True},
]


@pytest.mark.slow
def test_sheets_whose_cells_differ_are_one_assembly_of_both_formats(tmp_path: Path) -> None:
    designs = [DESIGN.replace({"check.process": "none", "lattice.count": [4, 4], **keys}) for keys in UNEVEN]
    made = stack(designs, 20.0, tmp_path, rays=256, quads=4, field=FIELD)
    checks = judge_stack(made.stack, designs, tmp_path, FIELD, lambda *_: None)
    assert passed(checks), [(c.id, c.subject, c.sentence) for c in checks if c.state not in ("pass", "warn")]
    assert {c.subject for c in checks if c.id == "shape"} >= {
        "stack.glb",
        "stack.step sheet a",
        "stack.step sheet b",
    }


def test_glb_of_sheets_whose_cells_differ_is_forecast_and_holds_each_sheet_in_its_place(
    tmp_path: Path,
) -> None:
    from clacad.stacking.make_stack import StackRequest, rows

    window = clacad.prescribe(DESIGN.replace({"check.process": "none", "lattice.count": [4, 4], **UNEVEN[0]}))
    placed = stacked([window, window], [20.0])
    with Stage(tmp_path, overwrite=False) as stage:
        job = StackAssembly(placed, stage, Worker(), 4, "auto", lambda *_: None)
        (record,) = job.records(("glb",))  # compares what it writes with both sheets
    assert record.facts["triangles"] > 2 * 2 * 16 * 2 * 16
    (row,) = rows(placed, StackRequest((20.0,), ("glb",), quads=4))
    assert row.bytes == pytest.approx(record.bytes, rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gap", "eta"), [(20.001, -0.5), (20.0, -0.51)], ids=["a micrometre farther", "another eta"]
)
def test_a_stack_that_was_not_asked_for_fails(made: Path, gap: float, eta: float) -> None:
    checks = judged(made, gap, eta)
    assert not passed(checks)
    assert "shape" in {c.id for c in checks if c.state == "fail"}


@pytest.mark.ci_cases("a sheet turned about", "cut short")
@pytest.mark.slow
@pytest.mark.parametrize(
    "what", ["a sheet turned about", "a sheet gone", "a sheet moved across", "cut short"]
)
def test_a_changed_assembly_fails_without_any_manifest(made: Path, tmp_path: Path, what: str) -> None:
    text = (made / "stack.step").read_text(encoding="ascii")
    lines = text.split("\n")
    uses = [k for k, line in enumerate(lines) if "NEXT_ASSEMBLY_USAGE_OCCURRENCE('b'" in line]
    assert len(uses) == 1
    move = next(k for k in range(uses[0], uses[0] + 6) if "ITEM_DEFINED_TRANSFORMATION" in lines[k])
    axis = lines[move].rsplit("#", 1)[1].rstrip(");")
    if what == "cut short":
        lines = lines[: len(lines) // 2]
    elif what == "a sheet gone":
        del lines[uses[0] : uses[0] + 5]
    else:
        placement = next(k for k, line in enumerate(lines) if line.startswith(f"#{axis}="))
        parts = lines[placement].split("#")
        point = next(k for k, line in enumerate(lines) if line.startswith(f"#{parts[2].rstrip(',')}="))
        if what == "a sheet moved across":
            lines[point] = lines[point].replace("(0.,0.,", "(0.01,0.,")
        else:
            up = next(k for k, line in enumerate(lines) if "DIRECTION('',(0.,0.,1.))" in line)
            lines.insert(up + 1, "#999999=DIRECTION('',(0.,0.,-1.));")
            parts[3] = "999999,"
            lines[placement + 1] = "#".join(parts)
    (tmp_path / "stack.step").write_text("\n".join(lines), encoding="ascii")
    assert not passed(judged(tmp_path / "stack.step"))


@pytest.mark.slow
def test_same_sheets_same_bytes(made: Path, tmp_path: Path) -> None:
    stack([DESIGN, OTHER], 20.0, tmp_path, cells=CELLS, rays=256, quads=4, field=FIELD)
    for name in ("stack.step", "stack.glb", "stack.json", "manifest.json"):
        assert (tmp_path / name).read_bytes() == (made / name).read_bytes(), name


# --- the command ------------------------------------------------------------------------------------------


def test_the_share_is_said_first_and_json_holds_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    assert command("stack", FILE, FILE, "--gap", "100 mm", "--field", "20 mrad", "--rays", 4096) == 0
    told = capsys.readouterr().out
    assert told.startswith("share of the light that obeys all 2 laws: 4")
    assert "acts as -100 mm of space" in told
    assert command("stack", FILE, FILE, "--gap", "10 cm", "--field", "20 mrad", "--rays", 4096, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["light"][2]["meridians"][0]["acts_as_space"] == pytest.approx(-100.0)
    assert found["light"][2]["rung"] == "surfaces"
    assert f"{100 * found['share']:.3g} %" in told.split("\n")[0]


def test_overrides_are_of_one_sheet_by_its_letter_or_of_all(capsys: pytest.CaptureFixture[str]) -> None:
    line = ("stack", FILE, FILE, "--gap", "100", "--rays", 256, "--json", "--set", "b.law.eta=[-0.5,-0.5]")
    assert command(*line, "--set", "lattice.count=[30,30]") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["light"][2]["meridians"][0]["determinant"] == pytest.approx(2.0)
    assert command("stack", FILE, FILE, "--gap", "100", "--set", "c.law.eta=[-1,-1]") == 2
    assert "there is no sheet c; sheets are a to b" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (("--gap", "nan"), 2, "--gap nan: is not a finite number"), (("--gap=-3",), 2, "--gap -3: is out of range"),
        (("--gap", "4 deg"), 2, "--gap 4 deg"), ((), 2, "0 gaps for 2 sheets"), (("--gap", "1,2"), 2, "2 gaps for 2 sheets"),
        (("--gap", "1", "--format", "stl"), 2, "a stack is not written as 'stl'"),
        (("--gap", "1", "--object", "0"), 2, "the object is 0 before the stack"),
        (("--gap", "1", "--set", "lattice.count=[1000000000,1000000000]"), 3, "lenslets"),
        (("--gap", "1", "--files", "nowhere"), 2, "there is no STEP or GLB file of a stack"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_one_sentence(
    words: tuple[str, ...], status: int, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command("stack", FILE, FILE, *words, "--rays", 256) == status
    told = capsys.readouterr()
    assert said in told.err
    assert told.out == ""
    assert "Traceback" not in told.err


def test_a_forecast_writes_nothing_and_refuses_what_the_real_thing_would(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert command("stack", FILE, FILE, "--gap", "5", "-o", out, "--dry-run", "--json", *SMALL) == 0
    found = json.loads(capsys.readouterr().out)
    assert {row["format"] for row in found["files"]} == {"step", "glb"}
    assert [one["id"] for one in found["sheets"]] == ["a", "b"]
    assert not out.exists()
    (tmp_path / "file").write_text("x")
    assert command("stack", FILE, FILE, "--gap", "5", "-o", tmp_path / "file", "--dry-run", *SMALL) == 4


@pytest.mark.slow
def test_forecast_bytes_are_those_that_are_written(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The STEP text is drawn up for the forecast; a sheet that appears twice counts once."""
    line = (
        "stack",
        FILE,
        FILE,
        FILE,
        "--gap",
        "20,5",
        "--set",
        "c.law.eta=[-0.5,-0.5]",
        "--cells",
        "6x6",
        "--quads",
        4,
    )
    assert command(*line, "--dry-run", "--json") == 0
    rows = {row["format"]: row["bytes"] for row in json.loads(capsys.readouterr().out)["files"]}
    for name, frame in (
        ("step", 3000),
        ("glb", 4000),
    ):  # what every file has once is counted for every sheet that differs
        assert rows[name] == pytest.approx((made / f"stack.{name}").stat().st_size, rel=0.05, abs=frame)


@pytest.mark.parametrize("dry", [(), ("--dry-run",)], ids=["written", "forecast"])
def test_a_sheet_that_cannot_be_a_solid_is_refused_before_anything_is_written(
    tmp_path: Path, dry: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    tilted, out = ROOT / "designs" / "tilted-biconvex.toml", tmp_path / "out"
    changes = (
        "pair.web=0.0002",
        "pair.thickness=0.02",
        "law.euler=[20,1,0]",
        "lattice.seam=0",
        "lattice.count=[2,2]",
    )
    words = [word for change in changes for word in ("--set", f"b.{change}")]
    assert command("stack", FILE, tilted, "--gap", 1, "-o", out, *SMALL, *words, *dry) == 2
    assert "CL131: the rim of the tilted lens sticks out of its web" in capsys.readouterr().err
    assert not out.exists()


def test_a_foreign_file_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "stack.step").write_text("precious")
    with pytest.raises(ExportRefused):
        stack([DESIGN, DESIGN], [1.0], tmp_path, cells=(4, 4), rays=64, quads=2)
    assert (tmp_path / "stack.step").read_text() == "precious"
    assert [one.name for one in tmp_path.iterdir()] == ["stack.step"]


def test_the_sheets_of_a_scene_are_a_stack(capsys: pytest.CaptureFixture[str]) -> None:
    scene = ROOT / "designs" / "scenes" / "negative-space.toml"
    assert command("stack", scene, "--rays", 256, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["gaps"] == pytest.approx([100.0], rel=1e-12)
    assert [one["id"] for one in found["sheets"]] == ["a", "b"]
    assert command("stack", scene, "--gap", "3") == 2
    assert "a scene file lists its sheets" in capsys.readouterr().err


@pytest.mark.slow
def test_a_stack_that_is_told_to_end_leaves_nothing(tmp_path: Path) -> None:
    out = tmp_path / "out"
    line = [
        sys.executable,
        "-P",
        "-m",
        "clacad",
        "stack",
        str(FILE),
        str(FILE),
        "--gap",
        "20",
        "-o",
        str(out),
        "--cells",
        "40x40",
    ]
    for number in range(4):
        running = subprocess.Popen(line, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL)
        time.sleep(1.0 + 1.7 * number)
        running.send_signal((signal.SIGINT, signal.SIGKILL)[number % 2])
        running.communicate(timeout=120)
        names = (
            {one.name for one in out.iterdir() if not one.name.startswith(".clacad-")}
            if out.exists()
            else set()
        )
        assert names in (set(), {"stack.step", "stack.glb", "stack.json", "manifest.json"})
    shutil.rmtree(out, ignore_errors=True)
    assert stack([DESIGN, DESIGN], 20.0, out, cells=(3, 3), rays=64, quads=2).manifest is not None
    assert not [one for one in out.iterdir() if one.name.startswith(".clacad-")]
