"""The n-th write, flush or rename fails, n = 1, 2, 3 … until success: the old set or the new one, one sentence, status 4."""

from __future__ import annotations

import json
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from trust.running import TINY, clacad, environment, small_disk, talk

FAULTS = textwrap.dedent(
    """
    # Every call that changes a file below one folder is counted; the one of a given number fails as a disk does.
    import builtins, io, json, os, shutil, sys
    from pathlib import Path

    work, cause, rounds = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    out = work / "out"
    count = allowed = 0
    ours = str(work)

    def step(place):
        global count
        if not str(place).startswith(ours):
            return
        count += 1
        if count == allowed:
            raise OSError(cause, os.strerror(cause), str(place))

    def counted(function, where):
        def call(*arguments, **options):
            step(where(arguments))
            return function(*arguments, **options)
        return call

    class File:
        "A file whose writes are counted; numpy and zipfile see a plain Python file."
        def __init__(self, file, place):
            self.__dict__.update(file=file, place=place)
        def write(self, data):
            step(self.place)
            return self.file.write(data)
        def __getattr__(self, name):
            return getattr(self.file, name)
        def __enter__(self):
            return self
        def __exit__(self, *_):
            self.file.close()
        def __iter__(self):
            return iter(self.file)

    plain = io.open
    def opened(file, mode="r", *arguments, **options):
        writes = isinstance(file, (str, Path)) and set(mode) & set("wax+") and str(file).startswith(ours)
        if writes:
            step(file)
        stream = plain(file, mode, *arguments, **options)
        return File(stream, file) if writes else stream

    from clacad.design import Design
    from clacad.exporting.run import ExportError, export
    from clacad.report import write_report
    import tomllib
    TINY = sys.stdin.read()
    design = Design.from_dict(tomllib.loads(TINY))
    formats = ("table", "stl", "3mf")
    folder_of = lambda fd: os.readlink(f"/proc/self/fd/{fd}")
    patched = {
        "fsync": (lambda a: folder_of(a[0])), "replace": (lambda a: a[1]), "link": (lambda a: a[1]), "mkdir": (lambda a: a[0]),
    }
    kept = {name: getattr(os, name) for name in patched}
    export(design, out, formats=formats, quads=2)  # everything is imported and the old set stands
    saved = work.parent / "saved"
    shutil.copytree(out, saved)
    for allowed in range(1, rounds):
        shutil.rmtree(out)
        shutil.copytree(saved, out)
        count = 0
        for name, where in patched.items():
            setattr(os, name, counted(kept[name], where))
        io.open = builtins.open = opened
        status, text = 0, ""
        try:
            export(design, out, formats=formats, quads=3)
        except ExportError as error:
            status, text = error.exit_status, str(error)
        finally:
            io.open = builtins.open = plain
            for name, function in kept.items():
                setattr(os, name, function)
        files = {p.name: p.read_bytes().hex() for p in out.iterdir() if p.name != "run.json" and p.is_file()}
        rest = [p.name for p in out.iterdir() if p.is_dir()]
        print(json.dumps({"n": allowed, "status": status, "text": text, "files": files, "rest": rest, "reached": count >= allowed}), flush=True)
        if count < allowed:
            break
    """
)


def attempts(tmp_path: Path, cause: int) -> Iterator[dict[str, Any]]:
    """One after the other, the n-th change of a file fails; the last line is the export that succeeds."""
    work = tmp_path / "work"
    work.mkdir()
    command = [sys.executable, "-c", FAULTS, str(work), str(cause), "400"]
    done = subprocess.run(command, input=TINY, capture_output=True, text=True, env=environment(), timeout=600)
    assert done.returncode == 0, done.stderr
    yield from map(json.loads, done.stdout.splitlines())


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="places of flushed files are read from /proc")
@pytest.mark.parametrize(
    "cause", [pytest.param(c, marks=pytest.mark.long) for c in (28, 5)], ids=["disk full", "disk broken"]
)
def test_whichever_write_flush_or_rename_fails_the_set_is_the_old_or_the_new(
    tmp_path: Path, cause: int
) -> None:
    rows = list(attempts(tmp_path, cause))
    assert len(rows) > 40
    final = rows[-1]
    assert final["status"] == 0
    assert not final["reached"]
    old = {p.name: p.read_bytes().hex() for p in (tmp_path / "saved").iterdir() if p.name != "run.json"}
    new = final["files"]
    assert set(old) == set(new)
    assert old != new
    words = {28: "no space left on device", 5: "input/output error"}[cause]
    whole = 0
    for row in rows[:-1]:
        n, files = row["n"], row["files"]
        assert not row["rest"], (n, "a private folder is left")
        if row["status"] == 0:  # a flush of the folder after the last rename, which has happened
            assert files == new, n
            continue
        assert row["status"] == 4, (n, row)
        assert words in row["text"]
        assert "\n" not in row["text"]
        assert ".clacad-" not in row["text"]
        if files == old:
            whole += 1
            continue
        # one format failed, the others were published: each file is the old or the new, and the manifest knows which
        listed = json.loads(bytes.fromhex(files["manifest.json"]))["files"]
        assert {e["name"] for e in listed} | {"manifest.json"} == set(files), n
        for entry in listed:
            assert files[entry["name"]] in (old[entry["name"]], new[entry["name"]]), n
            assert sha256(bytes.fromhex(files[entry["name"]])).hexdigest() == entry["sha256"], n
    assert whole > 10


# -- by the system's own limits ----------------------------------------------------------------------


def consistent(out: Path) -> set[str]:
    """Names of the files the manifest vouches for; nothing else may be there."""
    if not out.exists() or not list(out.iterdir()):
        return set()
    listed = json.loads((out / "manifest.json").read_text())["files"]
    for entry in listed:
        assert sha256((out / entry["name"]).read_bytes()).hexdigest() == entry["sha256"]
    names = {entry["name"] for entry in listed}
    assert {p.name for p in out.iterdir()} <= names | {"manifest.json", "run.json"}
    return names


def judged(ended: Any, out: Path) -> None:
    """Zero, or status 4 with one sentence that names the cause."""
    assert ended.status in (0, 4), ended.err
    if ended.status == 4:
        (sentence,) = talk(ended)
        assert any(
            word in sentence
            for word in ("file too large", "no space left", "cannot be written", "cannot write")
        )
        assert ".clacad-" not in sentence
    consistent(out)


@pytest.mark.slow
@pytest.mark.parametrize("formats", ["stl,table", pytest.param("step,stl", marks=pytest.mark.long)])
def test_a_file_size_limit_is_raised_until_all_is_written(design: Path, tmp_path: Path, formats: str) -> None:
    """The system's limit meets the worker's files as well as ours; each higher limit lets one more through."""
    out, statuses = tmp_path / "out", []
    limits = [600, 3000, 9000, 200_000]
    for limit in limits if formats == "stl,table" else [1000, 20_000, 40_000, 60_000, 200_000]:
        guard = f"resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))"
        ended = clacad("export", design, "-o", out, "--format", formats, "--quads", "2", "-q", before=guard)
        judged(ended, out)
        statuses.append(ended.status)
    assert statuses[0] == 4
    assert statuses[-1] == 0
    assert sorted(statuses, reverse=True) == statuses
    assert len(consistent(out)) >= 2


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 400 kB."""
    with small_disk(tmp_path / "disk", 400) as place:
        yield place


@pytest.mark.slow
def test_a_small_disk_is_emptied_page_by_page_until_all_is_written(design: Path, disk: Path) -> None:
    """Others have filled the disk; each time they leave a little more room."""
    out, ballast, statuses = disk / "out", disk / "ballast", []
    blind = "from clacad.exporting import limits as f; f.free_disk = lambda folder: 1 << 40"
    for room in (0, 12, 28, 200):
        ballast.write_bytes(b"")
        held = (
            400 - room - sum(-(-p.stat().st_size // 4096) * 4 for p in out.iterdir())
            if out.exists()
            else 400 - room
        )
        with ballast.open("wb") as stream:
            try:
                stream.write(b"\0" * (held * 1024))
            except OSError:
                pass  # the disk keeps some pages for itself: it is full, as it must be
        ended = clacad(
            "export", design, "-o", out, "--format", "stl,table", "--quads", "2", "-q", before=blind
        )
        judged(ended, out)
        statuses.append(ended.status)
    assert statuses[0] == 4
    assert statuses[-1] == 0
    assert not [p.name for p in out.iterdir() if p.name.startswith(".clacad-")]
