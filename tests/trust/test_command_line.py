"""The command line as other programs meet it: statuses, sentences, JSON, and nothing left behind."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from trust.running import HEAVY, JUDGES, TINY, clacad, command, environment, small_disk, talk

import clacad as package

RAYS = 128


# -- statuses --------------------------------------------------------------------------------------


def test_a_bad_design_is_2_with_its_place(design: Path, tmp_path: Path) -> None:
    design.write_text(TINY.replace("-0.5, -1.0", "0.0, -1.0").replace("pitch = 0.5", "pich = 0.5"))
    ended = clacad("export", design, "-o", tmp_path / "out")
    assert (ended.status, ended.out) == (2, "")
    for line in (7, 16):
        assert f"tiny.toml:{line}:" in ended.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("arguments", [
    ["export", "DESIGN"], ["export", "missing.toml", "-o", "out"], ["exprt"], ["check", "DESIGN", "--set", "law.eta"],
    ["export", "DESIGN", "-o", "out", "--format", "stp"], ["export", "DESIGN", "-o", "out", "--cells", "0x3"],
    ["check", "."],
], ids=lambda a: " ".join(a))  # fmt: skip
def test_a_call_that_cannot_be_understood_is_2(
    design: Path, arguments: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from clacad.cli import main

    monkeypatch.chdir(design.parent)
    assert main([design.name if word == "DESIGN" else word for word in arguments]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.strip()
    assert "Traceback" not in told.err
    assert [p.name for p in design.parent.iterdir()] == [design.name]


@pytest.mark.ci_cases(
    "export DESIGN -o OUT-1e18",
    "export DESIGN -o OUT --format baffle,table,mask-1e18",
    "check DESIGN --json-1e18",
    "verify DESIGN-1e18",
    "effects DESIGN-1e18",
    "tolerance DESIGN-1e18",
)
@pytest.mark.daily_cases("trace DESIGN RAYS -o OUT/o.npz-1e18")
@pytest.mark.parametrize(
    "count",
    ["1000000000,1000000000", pytest.param("31623,31623", marks=pytest.mark.long)],
    ids=["1e18", "1e9"],
)
@pytest.mark.parametrize("line", [
    "export DESIGN -o OUT", "export DESIGN -o OUT --dry-run", "export DESIGN -o OUT --format baffle,table,mask", "check DESIGN",
    "check DESIGN --json", "verify DESIGN", "verify DESIGN -o OUT", "accuracy DESIGN", "effects DESIGN", "explore DESIGN -o OUT/p.html",
    "wave DESIGN", "wave DESIGN -o OUT/w.png --dry-run",
    "stack DESIGN DESIGN --gap 1 -o OUT",
    "tolerance DESIGN", "sweep DESIGN --vary law.eta.0=-0.25:-4:3",
    "trace DESIGN RAYS -o OUT/o.npz", "trace DESIGN RAYS -o OUT/o.npz --rung mesh",
])  # fmt: skip
def test_too_many_lenslets_are_3_before_anything_is_loaded_that_could_build_or_trace_them(
    design: Path, tmp_path: Path, count: str, line: str
) -> None:
    """With the number and two ways out, in little memory; how soon is in tests/benchmarks/refusal.md."""
    import numpy as np

    out, rays = tmp_path / "out", tmp_path / "rays.npz"
    np.savez(rays, position=[[0.0, 0.0, -1.0]] * 3, direction=[[0.0, 0.0, 1.0]] * 3)
    words = [word.replace("OUT", str(out)).replace("RAYS", str(rays)) for word in line.split()]
    guard = "resource.setrlimit(resource.RLIMIT_AS, (2 << 30, 2 << 30))"
    ended = clacad(
        *(design if word == "DESIGN" else word for word in words),
        "--set",
        f"lattice.count=[{count}]",
        before=guard,
    )
    assert ended.status == 3
    assert ended.out == "" or words[0] == "check"
    (sentence,) = talk(ended)
    assert "1.00e+18 lenslets" in sentence or "1,000,014,129 lenslets" in sentence
    assert "use lattice.count up to [" in sentence
    assert ", or export a part with cells=(" in sentence
    assert not ended.packages & HEAVY
    assert words[0] == "check" or ended.parts <= JUDGES
    assert not ended.parts & {"effects", "rendering", "report"}
    assert (
        words[0] == "check" or "tracing" not in ended.parts
    )  # it traces one cell, regardless of their number
    never = tuple(
        f"clacad.{part}" for part in ("solid.describe", "verification.tolerance", "verification.accuracy")
    )
    assert not {name for name in ended.modules if name.startswith(never)}
    assert not out.exists()
    if "--json" in words:
        rows = json.loads(ended.out)["forecast"]
        assert all("lenslets" in row["refused"] for row in rows)


@pytest.mark.slow
def test_a_file_in_the_way_is_4_and_stays(design: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "tiny.stl").write_text("precious")
    ended = clacad("export", design, "-o", tmp_path / "out", "--format", "stl", "--quads", "2")
    assert ended.status == 4
    assert len(talk(ended)) == 1
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["tiny.stl"]
    assert (tmp_path / "out" / "tiny.stl").read_text() == "precious"


@pytest.mark.daily_cases("/dev/null/out")
@pytest.mark.parametrize("place", ["/dev/null", "/dev/null/out", "FILE"])
def test_a_folder_that_cannot_be_one_is_4(design: Path, place: str) -> None:
    ended = clacad("export", design, "-o", design if place == "FILE" else place, "--format", "table")
    assert ended.status == 4
    assert len(talk(ended)) == 1
    assert design.read_text() == TINY


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes into read-only folders")
def test_a_read_only_folder_is_4(design: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir(mode=0o500)
    ended = clacad("export", design, "-o", out, "--format", "table")
    assert ended.status == 4
    assert len(talk(ended)) == 1


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    with small_disk(tmp_path / "disk", 256) as place:
        yield place


@pytest.mark.slow
def test_a_full_disk_is_4_and_what_fits_is_published(design: Path, disk: Path) -> None:
    """The forecast refuses what cannot fit; a disk that others filled meanwhile is found by the write."""
    ballast = disk / "ballast"
    ballast.write_bytes(b"\0" * 120_000)
    blind = "from clacad.exporting import limits as f; f.free_disk = lambda folder: 1 << 40"
    ended = clacad("export", design, "-o", disk / "out", "--format", "ply,xyz", "--quads", "4", before=blind)
    assert ended.status == 4
    assert "no space left" in ended.err
    files = {p.name for p in (disk / "out").iterdir()}
    listed = {e["name"] for e in json.loads((disk / "out" / "manifest.json").read_text())["files"]}
    assert listed == {"tiny.ply"}
    assert files == listed | {"manifest.json", "run.json"}
    seen = clacad("export", design, "-o", disk / "out", "--format", "xyz", "--quads", "16")
    assert seen.status == 3
    assert "disk" in seen.err or "free" in seen.err


@pytest.mark.slow
@pytest.mark.parametrize("limit", [500, 3_000, 30_000])
def test_a_file_size_limit_is_4_whatever_file_meets_it(design: Path, tmp_path: Path, limit: int) -> None:
    out = tmp_path / "out"
    ended = clacad(
        "export", design, "-o", out, "--format", "table,stl,xyz", "--quads", "4",
        before=f"resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))",
    )  # fmt: skip
    assert ended.status == 4
    assert "file too large" in ended.err
    files = {p.name: p.stat().st_size for p in out.iterdir()} if out.exists() else {}
    if files:
        listed = {e["name"]: e["bytes"] for e in json.loads((out / "manifest.json").read_text())["files"]}
        assert set(files) == set(listed) | {"manifest.json", "run.json"}
        assert all(files[name] == size for name, size in listed.items())


CRASH = """
from clacad.storage.worker import Worker
run = Worker.run
Worker.run = lambda self, function, *a, **k: run(self, "worker_tricks:{trick}", timeout={timeout})
"""


@pytest.mark.ci_cases("segfault-segmentation fault", "hang-did not finish", "garbage-nonsense")
@pytest.mark.slow
@pytest.mark.parametrize(
    ("trick", "words"),
    [
        ("segfault", "segmentation fault"), ("abort", "an abort"), ("hang", "did not finish"), ("garbage", "nonsense"),
        ("leave", "without a result"),
    ],
)  # fmt: skip
def test_a_crash_of_the_kernel_is_70_in_one_sentence_and_the_other_files_are_written(
    design: Path, tmp_path: Path, trick: str, words: str
) -> None:
    out = tmp_path / "out"
    ended = clacad(
        "export",
        design,
        "-o",
        out,
        "-q",
        "--format",
        "step,stl",
        "--quads",
        "2",
        # those that end by themselves need longer than that to load the kernel, on a busy machine
        before=CRASH.format(trick=trick, timeout=3 if trick == "hang" else 100),
    )
    assert ended.status == 70
    assert ended.out == ""
    (sentence,) = talk(ended)
    assert words in sentence
    assert sentence.startswith("clacad: step: ")
    assert {p.name for p in out.iterdir()} == {"tiny.stl", "manifest.json", "run.json"}


@pytest.mark.slow
def test_a_kernel_without_memory_is_70_in_one_sentence_and_the_other_files_are_written(
    design: Path, tmp_path: Path
) -> None:
    """The real export of a solid, in a worker that may have less than the kernel needs to begin."""
    out = tmp_path / "out"
    starved = "from clacad.storage import worker; worker.worker_memory = lambda: 600_000_000"
    ended = clacad("export", design, "-o", out, "-q", "--format", "step,stl", "--quads", "2", before=starved)
    assert (ended.status, ended.out) == (70, "")
    (sentence,) = talk(ended)
    assert "limit 0.6 GB" in sentence or "out of memory" in sentence
    assert {p.name for p in out.iterdir()} == {"tiny.stl", "manifest.json", "run.json"}


@pytest.mark.slow
@pytest.mark.parametrize(("body", "form", "words"), [
    ("frame", "slab", "one slab"), ("baffle", "plano", "no baffle"),
])  # fmt: skip
def test_a_format_that_the_design_cannot_have_is_said_before_any_is_written(
    tmp_path: Path, body: str, form: str, words: str
) -> None:
    design, out = tmp_path / "tiny.toml", tmp_path / "out"
    design.write_text(TINY.replace('"slab"', f'"{form}"').replace("delta = [0.01, -0.02]", ""))
    ended = clacad("export", design, "-o", out, "-q", "--format", f"{body},table")
    assert ended.status == 2
    (sentence,) = talk(ended)
    assert words in sentence
    assert not out.exists()


@pytest.mark.slow
def test_a_mistake_of_our_own_is_70_and_v_tells_where(design: Path) -> None:
    broken = "import clacad.sheet.feasibility as f; f.describe = lambda *a: {}['lost']"
    plain = clacad("check", "--all", design, before=broken)
    assert plain.status == 70
    assert plain.err.startswith("internal error: KeyError")
    logged = clacad("check", design, "--json", "-v", before=broken)
    assert logged.status == 70
    events = {line["event"]: line for line in map(json.loads, filter(_is_log, talk(logged)))}
    assert [name for name in events if name != "stage"] == ["start", "error", "end"]
    assert any("check_command.py" in line for line in events["error"]["traceback"])
    assert events["end"]["status"] == 70


def _no_json(word: str) -> None:
    pytest.fail(f"{word} is no JSON")


def _is_log(line: str) -> bool:
    return line.startswith("{")


# -- what is printed -------------------------------------------------------------------------------


@pytest.mark.slow
def test_json_is_all_there_is_on_stdout_and_the_log_is_json_on_stderr(design: Path, tmp_path: Path) -> None:
    import numpy as np

    rays = tmp_path / "rays.npz"
    np.savez(rays, position=[[0.0, 0.0, -1.0]] * 3, direction=[[0.0, 0.0, 1.0]] * 3)
    out = tmp_path / "out"
    for arguments, statuses in (
        (["export", design, "-o", out, "--format", "stl", "--quads", "4", "-v"], {0}),
        (["export", design, "-o", out, "--format", "stl,step,xyz", "--dry-run"], {0}),
        (["check", design], {0}),
        (["trace", design, rays, "-o", tmp_path / "traced.npz", "--rung", "law"], {0}),
        (["verify", design, "--rays", RAYS], {0, 1}),
        (["new", tmp_path / "fresh"], {0}),
        (["schema"], {0}),
        (["accuracy", "--hard"], {0}),
        (["doctor", tmp_path], {0, 1}),
        (["effects", design], {0}),
    ):
        ended = clacad(*arguments, "--json")
        assert ended.status in statuses, ended.err
        json.loads(ended.out, parse_constant=_no_json)
        if "-v" in arguments:
            events = [json.loads(line) for line in talk(ended)]
            assert [events[0]["event"], events[-1]["event"]] == ["start", "end"]
            assert {"stage", "file"} <= {e["event"] for e in events}
            assert all(a["t"] <= b["t"] for a, b in zip(events, events[1:]))
            entry = next(e for e in events if e["event"] == "file")
            assert (out / entry["name"]).stat().st_size == entry["bytes"]


@pytest.mark.slow
def test_quiet_says_nothing_when_all_is_well(design: Path, tmp_path: Path) -> None:
    ended = clacad("export", design, "-o", tmp_path / "out", "--format", "table", "-q")
    assert (ended.status, ended.out, ended.err.strip()) == (0, "", "")


def test_a_reader_that_goes_away_is_no_error(design: Path) -> None:
    running = subprocess.Popen(
        command(["schema"]), stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment()
    )
    assert running.stdout is not None
    running.stdout.close()
    assert running.stderr is not None
    assert b"Traceback" not in running.stderr.read()
    assert running.wait(timeout=120) == 0
    running.stderr.close()


@pytest.mark.slow
def test_doctor_finds_this_installation_sound_and_leaves_no_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from clacad.cli import main

    assert main(["doctor", str(tmp_path), "--json"]) == 0
    found = {f["name"]: f for f in json.loads(capsys.readouterr().out)["findings"]}
    assert found["clacad"]["value"] == package.__version__
    assert {"numpy", "numba", "build123d", "CAD kernel", "free", "writing", "kernels", "threads"} <= set(
        found
    )
    assert found["writing"]["value"] > 0
    assert list(tmp_path.iterdir()) == []


def test_doctor_names_what_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from clacad import doctor

    there = doctor._installed
    monkeypatch.setattr(doctor, "_occ", lambda: iter(()))
    monkeypatch.setattr(
        doctor, "_installed", lambda name: {"numba": None, "gdstk": None, "numpy": "1.26.4"}.get(name, there(name))
    )  # fmt: skip
    monkeypatch.setenv("CLACAD_THREADS", "many")
    findings = {f.name: f for f in doctor.examine(tmp_path / "nowhere")}
    states = {name: findings[name].state for name in ("numba", "gdstk", "numpy", "threads", "folder")}
    assert states == {
        "numba": "fail",
        "gdstk": "absent",
        "numpy": "fail",
        "threads": "fail",
        "folder": "fail",
    }
    assert "pip install" in findings["numba"].sentence
    assert not doctor.sound(tuple(findings.values()))
