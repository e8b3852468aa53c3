"""Two programs at work in one folder, and clocks that go backwards: one wins whole, the other reports why."""

from __future__ import annotations

import fcntl
import json
import os
import subprocess
import threading
import time
from pathlib import Path

import pytest
from filesonly import only_files
from trust.running import TINY, command, environment

from clacad.design import load
from clacad.exporting.run import export
from clacad.storage.atomic import Stage, file_hash, read_manifest, write_content
from clacad.storage.errors import ExportRefused
from clacad.verification import verify


def entry(stage: Stage, name: str, content: bytes) -> dict[str, object]:
    path = stage.path(name)
    path.write_bytes(content)
    return {"name": name, "sha256": file_hash(path), "bytes": len(content)}


def whole(folder: Path) -> bool:
    """Whether the folder holds exactly what its manifest lists."""
    manifest = read_manifest(folder)
    assert manifest is not None
    listed = {e["name"]: e["sha256"] for e in manifest["files"]}
    there = {p.name: file_hash(p) for p in folder.iterdir() if p.name not in ("manifest.json", "run.json")}
    return listed == there


@pytest.mark.parametrize("overwrite", [False, True])
def test_of_two_exports_the_faster_stands_whole_and_the_other_says_why(
    tmp_path: Path, overwrite: bool
) -> None:
    with Stage(tmp_path, overwrite=overwrite) as slow:
        files = [entry(slow, "slow.stl", b"slow"), entry(slow, "both.stl", b"slow")]
        with Stage(tmp_path, overwrite=overwrite) as fast:
            fast.publish(
                {"format": 1, "files": [entry(fast, "fast.stl", b"fast"), entry(fast, "both.stl", b"fast")]}
            )
        with pytest.raises(ExportRefused, match=r"manifest\.json was written by another program meanwhile"):
            slow.publish({"format": 1, "files": files})
    assert whole(tmp_path)
    assert (tmp_path / "both.stl").read_bytes() == b"fast"
    assert not (tmp_path / "slow.stl").exists()


def test_a_file_that_came_meanwhile_is_not_written_over(tmp_path: Path) -> None:
    with Stage(tmp_path) as stage:
        document = {"format": 1, "files": [entry(stage, "part.stl", b"ours")]}
        (tmp_path / "part.stl").write_bytes(b"theirs")
        with pytest.raises(ExportRefused, match=r"part\.stl was written by another program meanwhile"):
            stage.publish(document)
    assert [p.name for p in tmp_path.iterdir()] == ["part.stl"]
    assert (tmp_path / "part.stl").read_bytes() == b"theirs"


def test_who_asks_while_another_publishes_waits_for_its_manifest(tmp_path: Path) -> None:
    """Files of a publication lie in the folder for a moment before the manifest that lists them."""
    with Stage(tmp_path) as slow:
        lock = os.open(tmp_path, os.O_RDONLY)
        fcntl.flock(lock, fcntl.LOCK_EX)
        (tmp_path / "part.stl").write_bytes(b"fast")

        def finish() -> None:
            time.sleep(0.2)
            listed = {"name": "part.stl", "sha256": file_hash(tmp_path / "part.stl"), "bytes": 4}
            (tmp_path / "manifest.json").write_text(json.dumps({"format": 1, "files": [listed]}))
            os.close(lock)

        other = threading.Thread(target=finish)
        other.start()
        files = [entry(slow, "part.stl", b"slow")]
        other.join()
        with pytest.raises(ExportRefused, match=r"manifest\.json was written by another program meanwhile"):
            slow.publish({"format": 1, "files": files})
    assert (tmp_path / "part.stl").read_bytes() == b"fast"


def test_of_two_that_write_one_file_the_later_says_why(tmp_path: Path) -> None:
    with Stage(tmp_path) as stage:
        stage.path("one.txt").write_bytes(b"later")
        write_content(tmp_path / "one.txt", "sooner")
        with pytest.raises(ExportRefused, match="meanwhile"):
            stage.publish()
    assert (tmp_path / "one.txt").read_bytes() == b"sooner"


@pytest.mark.slow
def test_exports_started_together_leave_one_set_and_every_loser_a_sentence(tmp_path: Path) -> None:
    lines = []
    for n, formats in enumerate(["stl", "table", "ply", "stl,table"]):
        (tmp_path / f"d{n}.toml").write_text(TINY.replace('"tiny"', f'"tiny{n % 2}"'))
        lines.append(["export", f"d{n}.toml", "-o", "out", "--format", formats, "--quads", "4", "-q"])
    running = [
        subprocess.Popen(command(line), cwd=tmp_path, env=environment(), stdout=subprocess.DEVNULL,
                         stderr=subprocess.PIPE, text=True)
        for line in lines
    ]  # fmt: skip
    told = [process.communicate(timeout=120)[1].split("\nLOADED")[0] for process in running]
    statuses = [process.returncode for process in running]
    assert set(statuses) <= {0, 4}
    assert 0 in statuses
    assert all(("meanwhile" in text) == (status == 4) for text, status in zip(told, statuses)), told
    assert whole(tmp_path / "out")
    assert not [p for p in (tmp_path / "out").iterdir() if p.name.startswith(".")]


@pytest.mark.slow
def test_who_reads_while_an_export_writes_is_told_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    only_files(monkeypatch)
    (tmp_path / "t.toml").write_text(TINY)
    design, out = load(tmp_path / "t.toml"), tmp_path / "out"
    export(design, out, formats=("table",))

    def rewritten(*arguments: object, **options: object) -> object:
        judged = judge(*arguments, **options)
        export(design, out, formats=("stl",), quads=4)
        return judged

    import clacad.judging.judge_files as room

    judge = room.judge_files
    monkeypatch.setattr(room, "judge_files", rewritten)
    report = verify(design, out, rays=64)
    told = [c for c in report.checks if c.subject == "manifest.json" and c.id == "integrity"]
    assert [c.state for c in told] == ["fail"]
    assert "judge them again" in told[0].sentence
    assert report.exit_status == 1
    monkeypatch.setattr(room, "judge_files", judge)
    assert not [
        c for c in verify(design, out, rays=64).checks if c.subject == "manifest.json" and c.id == "integrity"
    ]


def test_a_reader_sees_the_old_set_or_the_new_or_that_there_is_none(tmp_path: Path) -> None:
    """The manifest is gone while files change places: nobody takes a mixture for a set."""
    over = threading.Event()
    wrong: list[str] = []

    def watch() -> None:
        while not over.is_set():
            manifest = read_manifest(tmp_path)
            if manifest is None:
                continue
            listed = {e["name"]: e["sha256"] for e in manifest["files"]}
            found = {}
            for name in listed:
                try:
                    found[name] = file_hash(tmp_path / name)
                except OSError:
                    found[name] = "gone"
            if found != listed and read_manifest(tmp_path) == manifest:
                wrong.append(f"{listed} {found}")

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        for n in range(60):
            with Stage(tmp_path) as stage:
                files = [entry(stage, f"{name}.stl", f"{n}".encode() * 1000) for name in "abc"]
                stage.publish({"format": 1, "number": n, "files": files})
    finally:
        over.set()
        watcher.join()
    assert wrong == []


@pytest.mark.slow
def test_a_clock_that_goes_backwards_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Files of the future, a clock of the past: their owner is found by content and by the process that made them."""
    (tmp_path / "t.toml").write_text(TINY)
    design, out = load(tmp_path / "t.toml"), tmp_path / "out"
    export(design, out, formats=("table", "stl"), quads=4)
    before = {p.name: p.read_bytes() for p in out.iterdir() if p.name != "run.json"}
    dead = out / ".clacad-999999999-1-abcdef"
    dead.mkdir()
    (dead / "half").write_text("half")
    for path in (*out.iterdir(), dead / "half", out):
        os.utime(path, (4e9, 4e9))
    backwards = iter(range(10**9, 0, -1000))
    monkeypatch.setattr(time, "time", lambda: float(next(backwards)))
    export(design, out, formats=("table", "stl"), quads=4)
    assert {p.name: p.read_bytes() for p in out.iterdir() if p.name != "run.json"} == before
    assert json.loads((out / "manifest.json").read_text())["files"]
