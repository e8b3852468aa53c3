"""At a final name there is the old file or the complete new one, regardless of what happens in between."""

from __future__ import annotations

import json
import os
import random
import signal
import stat
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

import pytest

from clacad.storage import atomic
from clacad.storage.atomic import (
    MANIFEST,
    Stage,
    file_hash,
    read_manifest,
    require_folder,
    safe_name,
    sweep,
    write_file,
)
from clacad.storage.errors import CannotWrite, ExportRefused

BODY = {"a.bin": b"a" * 300_000, "b.bin": b"b" * 200_000}


def listing(stage: Stage, files: dict[str, bytes]) -> dict[str, object]:
    entries = []
    for name, data in files.items():
        stage.path(name).write_bytes(data)
        entries.append({"name": name, "bytes": len(data), "sha256": sha256(data).hexdigest()})
    return {"format": 1, "files": entries}


def export(folder: Path, files: dict[str, bytes], overwrite: bool = False) -> None:
    with Stage(folder, overwrite=overwrite) as stage:
        stage.publish(listing(stage, files))


def leftovers(folder: Path) -> list[str]:
    return [p.name for p in folder.iterdir() if p.name.startswith(".clacad-")]


def test_published_files_are_complete_and_the_manifest_vouches_for_them(tmp_path: Path) -> None:
    export(tmp_path / "new" / "out", BODY)
    out = tmp_path / "new" / "out"
    assert {p.name: p.read_bytes() for p in out.iterdir() if p.name != MANIFEST} == BODY
    manifest = read_manifest(out)
    assert manifest is not None
    assert all(file_hash(out / e["name"]) == e["sha256"] for e in manifest["files"])
    assert not leftovers(out)


def test_nothing_is_published_when_the_work_fails_midway(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), Stage(tmp_path) as stage:  # noqa: PT012
        stage.path("a.bin").write_bytes(b"half")
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


def test_an_owned_file_may_be_replaced_and_a_strangers_file_may_not(tmp_path: Path) -> None:
    export(tmp_path, BODY)
    export(tmp_path, {"a.bin": b"second"})
    assert (tmp_path / "a.bin").read_bytes() == b"second"
    assert not (tmp_path / "b.bin").exists(), "a product of the earlier export would mislead"

    (tmp_path / "b.bin").write_bytes(b"the user's own")
    with pytest.raises(ExportRefused, match="b.bin"):
        export(tmp_path, BODY)
    assert (tmp_path / "b.bin").read_bytes() == b"the user's own"
    assert (tmp_path / "a.bin").read_bytes() == b"second"
    export(tmp_path, BODY, overwrite=True)
    assert (tmp_path / "b.bin").read_bytes() == BODY["b.bin"]


def test_an_owned_file_that_was_edited_is_the_users(tmp_path: Path) -> None:
    export(tmp_path, BODY)
    (tmp_path / "a.bin").write_bytes(b"x" * len(BODY["a.bin"]))
    with pytest.raises(ExportRefused):
        export(tmp_path, BODY)
    export(tmp_path, {"b.bin": b"1"})
    assert (tmp_path / "a.bin").exists(), "an edited file is never removed"


def test_a_foreign_manifest_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / MANIFEST).write_text('{"short_name": "a web application"}')
    with pytest.raises(ExportRefused, match=MANIFEST):
        export(tmp_path, BODY)


def test_a_folder_in_the_way_is_said_and_left(tmp_path: Path) -> None:
    (tmp_path / "a.bin").mkdir()
    with pytest.raises(CannotWrite, match="folder"):
        export(tmp_path, BODY, overwrite=True)
    assert (tmp_path / "a.bin").is_dir()
    (tmp_path / "file").write_text("x")
    with pytest.raises(CannotWrite, match="folder is needed"):
        export(tmp_path / "file", BODY)


def test_a_symbolic_link_is_replaced_and_never_followed(tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.write_bytes(b"precious")
    out = tmp_path / "out"
    out.mkdir()
    (out / "a.bin").symlink_to(elsewhere)
    with pytest.raises(ExportRefused, match="symbolic link"):
        export(out, BODY)
    export(out, BODY, overwrite=True)
    assert elsewhere.read_bytes() == b"precious"
    assert not (out / "a.bin").is_symlink()


@pytest.mark.parametrize("name", ["../x", "/etc/x", "a/b", ".hidden", "", "x\0y", "a" * 300, "..", "-rf"])
def test_no_name_leads_out_of_the_folder(tmp_path: Path, name: str) -> None:
    with Stage(tmp_path) as stage, pytest.raises(CannotWrite):
        stage.path(name)


@pytest.mark.parametrize(
    "name", ["../../etc/passwd", "<script>", "", "...", "ö", "a b", "x" * 500, "con\n", "-rf", "_"]
)
def test_any_design_name_becomes_a_plain_file_name(tmp_path: Path, name: str) -> None:
    with Stage(tmp_path) as stage:
        assert stage.path(safe_name(name) + ".stl").parent.parent == tmp_path.resolve()


def test_a_full_disk_is_a_sentence(tmp_path: Path) -> None:
    def fill(path: Path) -> None:
        raise OSError(28, "No space left on device", str(path))

    with pytest.raises(CannotWrite, match="no space left") as caught:
        write_file(tmp_path / "x.bin", fill)
    assert ".clacad-" not in str(caught.value)
    assert caught.value.exit_status == 4
    assert list(tmp_path.iterdir()) == []


def test_a_failing_check_leaves_the_old_file(tmp_path: Path) -> None:
    target = tmp_path / "x.bin"
    target.write_bytes(b"old")

    def distrust(path: Path) -> None:
        assert path.read_bytes() == b"new"
        raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        write_file(target, lambda p: p.write_bytes(b"new") and None, overwrite=True, check=distrust)
    assert target.read_bytes() == b"old"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_folder_is_a_sentence(tmp_path: Path) -> None:
    tmp_path.chmod(stat.S_IRUSR | stat.S_IXUSR)
    try:
        with pytest.raises(CannotWrite, match="permission denied"):
            export(tmp_path, BODY)
    finally:
        tmp_path.chmod(stat.S_IRWXU)


def test_folders_of_dead_processes_are_swept_and_those_of_living_ones_are_not(tmp_path: Path) -> None:
    dead = subprocess.run(
        [sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, check=True
    )
    stale = tmp_path / f".clacad-{int(dead.stdout)}-1-abc123"
    recycled = tmp_path / f".clacad-{os.getpid()}-1-abc123"  # our id, but another start time
    for folder in (stale, recycled):
        folder.mkdir()
        (folder / "half.stl").write_bytes(b"half")
    with Stage(tmp_path) as other:
        sweep(tmp_path)
        assert leftovers(tmp_path) == [other.path("x").parent.name]


def test_killed_while_it_looks_whether_a_folder_can_be_written_it_leaves_what_the_next_one_removes(
    tmp_path: Path,
) -> None:
    dies = (
        "import os, signal, sys; from pathlib import Path; from clacad.storage.atomic import require_folder\n"
        "Path.rmdir = lambda self: os.kill(os.getpid(), signal.SIGKILL)\nrequire_folder(sys.argv[1])"
    )
    for look_again in (
        lambda: require_folder(tmp_path / "out"),
        lambda: Stage(tmp_path).__enter__().__exit__(),
    ):
        assert (
            subprocess.run([sys.executable, "-c", dies, str(tmp_path / "out")]).returncode == -signal.SIGKILL
        )
        assert len(leftovers(tmp_path)) == 1
        look_again()
        assert not leftovers(tmp_path)


def test_two_exports_into_one_folder_at_once_do_not_mix(tmp_path: Path) -> None:
    first, second = {"a.bin": b"1", "b.bin": b"11"}, {"a.bin": b"2", "b.bin": b"22"}
    with Stage(tmp_path) as one, Stage(tmp_path) as two:
        one_manifest, two_manifest = listing(one, first), listing(two, second)
        two.publish(two_manifest)
        with pytest.raises(ExportRefused, match="written by another program meanwhile"):
            one.publish(one_manifest)
    assert {n: (tmp_path / n).read_bytes() for n in second} == second
    assert json.loads((tmp_path / MANIFEST).read_text())["files"] == two_manifest["files"]


VICTIM = textwrap.dedent(
    """
    import sys, time
    from hashlib import sha256
    from pathlib import Path
    from clacad.storage.atomic import Stage
    out, digit = Path(sys.argv[1]), sys.argv[2].encode()
    while True:
        with Stage(out) as stage:
            entries = []
            for name in ("a.bin", "b.bin", "c.bin"):
                data = digit * 400_000
                stage.path(name).write_bytes(data)
                entries.append({"name": name, "bytes": len(data), "sha256": sha256(data).hexdigest()})
            stage.publish({"format": 1, "files": entries})
        print(end=".", flush=True)
    """
)


@pytest.mark.parametrize("times", [8, pytest.param(200, marks=pytest.mark.long)])
def test_kill_9_at_any_instant_leaves_no_half_file(tmp_path: Path, times: int) -> None:
    chance = random.Random(0)
    for n in range(times):
        digit = str(n % 10)
        victim = subprocess.Popen(
            [sys.executable, "-c", VICTIM, str(tmp_path), digit], stdout=subprocess.PIPE
        )
        assert victim.stdout is not None
        victim.stdout.read(1)  # it is under way: from here on any instant will do
        time.sleep(chance.uniform(0.0, 0.04))
        victim.send_signal(signal.SIGKILL)
        victim.communicate()
        for name in ("a.bin", "b.bin", "c.bin"):
            if (tmp_path / name).exists():
                data = (tmp_path / name).read_bytes()
                assert len(data) == 400_000
                assert len(set(data)) == 1
        manifest = read_manifest(tmp_path)
        if manifest is not None:
            assert all(file_hash(tmp_path / e["name"]) == e["sha256"] for e in manifest["files"])
    with Stage(tmp_path):
        pass
    assert not leftovers(tmp_path)
    manifest = read_manifest(tmp_path)
    assert manifest is not None
    assert all(file_hash(tmp_path / e["name"]) == e["sha256"] for e in manifest["files"])


LIMITED = textwrap.dedent(
    """
    import resource, sys
    from pathlib import Path
    from clacad.storage.atomic import Stage
    from clacad.storage.errors import CannotWrite
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]),) * 2)
    from hashlib import sha256
    try:
        with Stage(Path(sys.argv[1])) as stage:
            entries = []
            for n in range(1, 5):
                data = b"n" * 1000 * n
                with stage.path(f"{n}.bin").open("wb") as f:
                    f.write(data)
                entries.append({"name": f"{n}.bin", "bytes": len(data), "sha256": sha256(data).hexdigest()})
            stage.publish({"format": 1, "files": entries})
    except (CannotWrite, OSError) as error:
        sys.exit(4)
    """
)


@pytest.mark.slow
def test_whichever_write_fails_the_folder_holds_the_old_set_or_the_new(tmp_path: Path) -> None:
    export(tmp_path, {"1.bin": b"old"})
    for limit in range(500, 5001, 500):
        done = subprocess.run([sys.executable, "-c", LIMITED, str(tmp_path), str(limit)], capture_output=True)
        now = {p.name: len(p.read_bytes()) for p in tmp_path.iterdir() if p.name != MANIFEST}
        if done.returncode == 0:
            assert now == {f"{n}.bin": 1000 * n for n in range(1, 5)}
            return
        assert done.returncode == 4
        assert now == {"1.bin": 3}
    raise AssertionError("no limit was wide enough")


# -- sets of files without a manifest, and temporary folders ---------------------------------------


def _killed(work: Callable[[], object]) -> None:
    """Do something in a fork that ends without another word, as a killed process does."""
    child = os.fork()
    if child == 0:
        try:
            work()
        finally:
            os._exit(9)
    assert os.waitpid(child, 0)[1] != 0


@pytest.mark.parametrize("moves", [0, 1, 2, 3])
def test_a_set_killed_between_its_files_is_finished_by_the_next_writer(tmp_path: Path, moves: int) -> None:
    """Number of the three files that had changed places; before the first the set was complete, so that it counts."""
    names = ("a.csv", "b.png", "c.toml")
    atomic.write_set(tmp_path, dict.fromkeys(names, "old"))

    def work() -> None:
        real, done = os.replace, 0

        def replace(old: Path, new: Path) -> None:
            nonlocal done
            if Path(new).name in names:
                if done == moves:
                    os._exit(9)
                done += 1
            real(old, new)

        os.replace = replace
        atomic.write_set(tmp_path, dict.fromkeys(names, "new"), overwrite=True)

    _killed(work)
    assert sorted((tmp_path / name).read_text() for name in names) == sorted(
        ["new"] * moves + ["old"] * (3 - moves)
    )
    atomic.write_content(tmp_path / "another", "")
    assert {(tmp_path / name).read_text() for name in names} == {"new"}
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*names, "another"])


@pytest.mark.parametrize("failing", ["a.csv", "b.png", "c.toml"])
def test_a_set_of_which_one_file_cannot_be_moved_leaves_all_as_they_were(
    tmp_path: Path, failing: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ("a.csv", "b.png", "c.toml")
    atomic.write_set(tmp_path, dict.fromkeys(names, "old"))
    real = os.replace

    def full(old: Path, new: Path) -> None:
        if Path(new).name == failing and Path(old).name == failing:
            raise OSError(28, "No space left on device")
        real(old, new)

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(CannotWrite, match="no space left"):
        atomic.write_set(tmp_path, dict.fromkeys(names, "new"), overwrite=True)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == dict.fromkeys(names, "old")


def test_a_temporary_folder_of_a_killed_process_is_removed_by_the_next_and_never_published(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(atomic.tempfile, "gettempdir", lambda: str(tmp_path))

    def work() -> None:
        with atomic.scratch_folder() as folder:
            (folder / "precious").write_text("half")
            (folder / "sealed-set").touch()
            os._exit(9)

    _killed(work)
    assert len(list(tmp_path.iterdir())) == 1
    with atomic.scratch_folder() as folder:
        assert list(tmp_path.iterdir()) == [folder]
        with atomic.scratch_folder() as another:
            assert folder.is_dir() and another.is_dir(), "one that is in use stays"  # noqa: PT018
    assert not list(tmp_path.iterdir())
