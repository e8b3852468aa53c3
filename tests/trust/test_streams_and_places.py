"""Any object in place of the files, streams and folders of a command: its own answer, at once."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from trust.running import TINY, clacad, environment, talk

from clacad.base.untrusted_files import read_regular
from clacad.cli import main
from clacad.storage.atomic import read_manifest
from clacad.storage.errors import OverBudget

PATIENCE = 120.0
"""Seconds after which a command that waits for a pipe counts as waiting forever."""


@contextmanager
def nobody_waits_for(pipe: Path) -> Iterator[None]:
    """Fail, and let the block go on, if something in it waits for the other end of a pipe."""
    over, waited = threading.Event(), []

    def watch() -> None:
        if not over.wait(PATIENCE):
            waited.append(True)
            os.close(os.open(pipe, os.O_RDWR))

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    yield
    over.set()
    watcher.join()
    assert not waited


@pytest.mark.parametrize("line", [
    "check pipe.toml", "export pipe.toml -o out", "effects pipe.toml", "verify pipe.toml", "trace pipe.toml rays.npz -o x.npz",
    "trace t.toml pipe.toml -o x.npz", "render pipe.toml -o x.png", "accuracy pipe.toml", "tolerance pipe.toml",
    "verify t.toml --files pipe.toml",
])  # fmt: skip
def test_a_pipe_in_place_of_a_file_is_refused_at_once(
    tmp_path: Path, line: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe.toml")
    Path("t.toml").write_text(TINY)
    with nobody_waits_for(tmp_path / "pipe.toml"):
        assert main(line.split()) == 2
    assert "pipe" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "kind"), [("/dev/zero", "device"), ("/dev/null", "device"), (".", "folder")]
)
def test_a_device_or_a_folder_is_named_as_such(
    name: str, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", name]) == 2
    assert f"it is a {kind}, not a file" in capsys.readouterr().err


def _pipe(path: Path) -> None:
    os.mkfifo(path)


def _device(path: Path) -> None:
    path.symlink_to("/dev/zero")


@pytest.mark.parametrize("put", [_pipe, Path.mkdir, _device])
def test_what_is_no_file_is_no_manifest_to_read_and_none_to_write_over(
    tmp_path: Path, put: Callable[[Path], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "out"
    out.mkdir()
    put(out / "manifest.json")
    (tmp_path / "t.toml").write_text(TINY)
    with nobody_waits_for(out / "manifest.json"):
        assert main(["verify", "t.toml", "--files", "out"]) == 2
        assert main(["export", "t.toml", "-o", "out", "--format", "table"]) == 4
    assert [p.name for p in out.iterdir()] == ["manifest.json"]


def test_a_design_of_more_than_a_megabyte_is_refused_unread(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "large.toml"
    path.write_text(TINY.replace('"tiny"', f'"{"a" * 10_000_000}"'))
    monkeypatch.setattr("tomllib.loads", lambda text: pytest.fail("it was parsed"))
    assert main(["check", str(path)]) == 3
    assert "too large for a design" in capsys.readouterr().err
    with pytest.raises(OSError, match="more than 1000 bytes"):
        read_regular(path, 1000)


@pytest.mark.slow
def test_a_design_of_just_under_a_megabyte_is_read(tmp_path: Path) -> None:
    path = tmp_path / "long.toml"
    path.write_text(TINY + "#" * (2**20 - len(TINY)))
    assert main(["check", str(path), "-q"]) == 0


def test_a_manifest_is_read_up_to_a_size_only(tmp_path: Path) -> None:
    text = json.dumps({"format": 1, "files": [], "more": "a" * (17 << 20)})
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(OverBudget):
        read_manifest(tmp_path)


# -- streams ------------------------------------------------------------------------------------------


def shell(words: str, streams: str, folder: Path, **changes: str) -> subprocess.CompletedProcess[str]:
    """Run the program with its streams put elsewhere."""
    (folder / "t.toml").write_text(TINY)
    return subprocess.run(
        ["sh", "-c", f"'{sys.executable}' -m clacad {words} {streams}"], cwd=folder, env=environment(**changes),
        capture_output=True, encoding="latin-1", timeout=120,
    )  # fmt: skip


@pytest.mark.ci_cases(">&-", "<&- >&- 2>&-")
@pytest.mark.slow
@pytest.mark.parametrize("line", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_a_closed_stream_changes_no_status(tmp_path: Path, line: str) -> None:
    assert shell("check t.toml", line, tmp_path).returncode == 0


@pytest.mark.slow
def test_what_is_printed_into_a_closed_stream_ends_up_in_no_file(tmp_path: Path) -> None:
    assert shell("export t.toml -o out --format stl,table", "<&- >&- 2>&-", tmp_path).returncode == 0
    assert clacad("export", "t.toml", "-o", "plain", "--format", "stl,table", cwd=tmp_path).status == 0
    for name in ("tiny.stl", "tiny.poses.csv", "tiny.surfaces.json", "manifest.json"):
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "plain" / name).read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("changes", [
    {"PYTHONIOENCODING": "ascii"}, pytest.param({"PYTHONIOENCODING": "latin-1"}, marks=pytest.mark.long),
    {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
], ids=str)  # fmt: skip
def test_a_stream_that_lacks_letters_changes_no_status(tmp_path: Path, changes: dict[str, str]) -> None:
    done = shell("check t.toml", "", tmp_path, **changes)
    assert (done.returncode, "verify will pass" in done.stdout) == (0, True), done.stderr
    done = clacad("check", "t.toml", "--json", cwd=tmp_path, **changes)
    assert json.loads(done.out) == json.loads(clacad("check", "t.toml", "--json", cwd=tmp_path).out)


@pytest.mark.slow
def test_a_full_disk_behind_the_output_is_4_in_one_sentence(tmp_path: Path) -> None:
    done = shell("check --all t.toml", "> /dev/full", tmp_path)
    assert done.returncode == 4
    assert done.stderr.strip() == "clacad: no space left on device"


# -- places -------------------------------------------------------------------------------------------

NO_CACHE = """
import numba.core.caching as caching
def refuse(self): raise OSError(30, "Read-only file system")
caching._CacheLocator.ensure_cache_path = refuse
import clacad.explain.look_up as look_up
explain = look_up.explain
def compiling(*arguments, **options):
    from clacad.base.compiled import entry
    one, other = entry(lambda x: x), entry(lambda x: 2 * x)
    assert one(1.0) + other(1.0) == 3.0
    return explain(*arguments, **options)
look_up.explain = compiling
"""


@pytest.mark.slow
def test_where_no_compiled_kernel_can_be_kept_the_work_is_done_and_that_is_said_once(tmp_path: Path) -> None:
    done = clacad("explain", "eta", before=NO_CACHE, cwd=tmp_path)
    assert done.status == 0
    (sentence,) = talk(done)
    assert sentence.startswith("clacad: compiled kernels cannot be kept")


@pytest.mark.slow
def test_nobody_s_home_is_needed(tmp_path: Path) -> None:
    (tmp_path / "t.toml").write_text(TINY)
    gone = "import os; [os.environ.pop(name, None) for name in ('HOME', 'XDG_CACHE_HOME', 'CLACAD_CACHE_DIR')]\n" \
           "import pwd; pwd.getpwuid = lambda uid: {}[uid]"  # fmt: skip
    for line in ("check t.toml", "export t.toml -o out --format stl --dry-run", "doctor ."):
        done = clacad(*line.split(), before=gone, cwd=tmp_path)
        assert done.status == 0, done.err
