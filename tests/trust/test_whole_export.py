"""A whole export: repeated anywhere, judged right afterwards."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
import tempfile
from hashlib import sha256
from pathlib import Path

import pytest
from trust import golden
from trust.running import ROOT, TINY, clacad, command, environment

from clacad.design import Design
from clacad.exporting.run import export
from clacad.verification import verify

ALL = "stl,stl-parts,3mf,ply,glb,sag,tiff,png,xyz,table,mask"


def tiny() -> Design:
    import tomllib

    return Design.from_dict(tomllib.loads(TINY))


@pytest.fixture(scope="session")
def design(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("design") / "tiny.toml"
    path.write_text(TINY)
    return path


def contents(folder: Path) -> dict[str, str]:
    """Hash of every file but the run facts."""
    return {
        p.name: sha256(p.read_bytes()).hexdigest() for p in sorted(folder.iterdir()) if p.name != "run.json"
    }


# -- repeated --------------------------------------------------------------------------------------

CIRCUMSTANCES: dict[str, dict[str, str]] = {
    "hash seed, one thread, far east": {
        "PYTHONHASHSEED": "1", "CLACAD_THREADS": "1", "TZ": "Pacific/Auckland", "LANG": "C", "LC_ALL": "C",
    },
    "other hash seed, two threads, decimal comma": {
        "PYTHONHASHSEED": "4242", "CLACAD_THREADS": "2", "TZ": "America/Caracas", "LANG": "de_DE.UTF-8",
        "LC_ALL": "de_DE.UTF-8", "USER": "somebody", "HOME": "/", "SOURCE_DATE_EPOCH": "1",
    },
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("formats", ["step", ALL], ids=["solid", "all others"])
def test_the_bytes_do_not_depend_on_circumstances(design: Path, tmp_path: Path, formats: str) -> None:
    found = []
    for k, changes in enumerate(CIRCUMSTANCES.values()):
        here = tmp_path / f"folder {k}" / ("ä" * k)
        here.mkdir(parents=True)
        out = here / "out"
        name = os.path.relpath(design, here) if k else design
        target = "out" if k else out
        ended = clacad(
            "export", name, "-o", target, "--format", formats, "--quads", "4", "-q", cwd=here, **changes
        )
        assert ended.status == 0, ended.err
        found.append(contents(out))
    assert found[0] == found[1]
    assert len(found[0]) > (1 if formats == "step" else 20)


@pytest.mark.slow
def test_the_bytes_are_those_recorded_for_these_versions() -> None:
    """After a change that is meant to change bytes: python tests/trust/golden.py --renew."""
    kept, now = golden.record(), golden.versions()
    if kept["versions"] != now:
        other = {name: now[name] for name in now if kept["versions"].get(name) != now[name]}
        pytest.skip(f"recorded under other versions; here {other}")
    assert golden.hashes() == kept["files"]


ANOTHER_USER = """
import os, sys
from clacad.design import load
from clacad.exporting.run import export
source, ours, theirs = sys.argv[1:]
formats = ("stl", "3mf", "glb", "table", "png")
export(load(source), ours, formats=formats, quads=4)
os.mkdir(theirs)
os.chown(theirs, 65534, 65534)
os.setgroups([]), os.setgid(65534), os.setuid(65534)
export(load(source), theirs, formats=formats, quads=4)
"""


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0, reason="only root may become somebody else")
def test_the_bytes_do_not_depend_on_the_user(design: Path) -> None:
    with tempfile.TemporaryDirectory() as folder:  # pytest's own folders are for nobody else
        place = Path(folder)
        place.chmod(0o755)
        source = place / "tiny.toml"
        source.write_bytes(design.read_bytes())
        names = [str(place / name) for name in ("tiny.toml", "ours", "theirs")]
        subprocess.run([sys.executable, "-c", ANOTHER_USER, *names], check=True, env=environment())
        assert (place / "theirs" / "tiny.stl").stat().st_uid == 65534
        assert contents(place / "ours") == contents(place / "theirs")


# -- judged afterwards ------------------------------------------------------------------------------


@pytest.mark.slow
def test_thin_bodies_far_apart_are_0(tmp_path: Path) -> None:
    """float32 moves the far body's plane by half a spacing as a whole: much of a thin body, and no fault."""
    apart = Design.from_dict({
        "format": 1, "name": "apart", "unit": "m", "law": {"eta": [1.3, 1.3], "delta": [-0.02, 0.013]},
        "pair": {"form": "plano", "separation": 0.0525, "index": 1.767}, "lattice": {"pitch": 0.0014, "count": [2, 2]},
    })  # fmt: skip
    export(apart, tmp_path, formats=("stl",), quads=16)
    checks = verify(apart, tmp_path, rays=2048).checks
    assert [c.state for c in checks if c.id == "volume"] == ["pass"]


# -- alone -----------------------------------------------------------------------------------------


def test_no_test_can_reach_another_machine() -> None:
    with pytest.raises(Exception, match="look-up"):
        socket.create_connection(("example.org", 80), timeout=1)
    with socket.socket() as plain, pytest.raises(Exception, match="connect"):
        plain.connect(("192.0.2.1", 80))


TALKATIVE = """
import socket, sys
from clacad.storage.worker import Worker
try:
    socket.create_connection(("192.0.2.1", 80), 1)
except RuntimeError as refusal:
    print(refusal)
if sys.argv[1:]:
    with Worker() as worker:
        worker.run("worker_tricks:talk")
"""


def test_no_process_that_a_test_starts_can_reach_another_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor the processes those start; and who swallows the refusal is found in the log."""
    log = tmp_path / "tried"
    monkeypatch.setenv("CLACAD_NETWORK_LOG", str(log))
    line = [sys.executable, "-c", TALKATIVE]
    child = subprocess.run(line, capture_output=True, text=True, env=environment())
    assert "tests talk to no other machine" in child.stdout
    assert len(log.read_text().splitlines()) == 1
    family = subprocess.run([*line, "and a worker"], capture_output=True, text=True, env=environment())
    assert "tests talk to no other machine" in family.stderr
    assert len(log.read_text().splitlines()) == 3


@pytest.mark.parametrize(
    "own", [{"PYTHONPATH": str(ROOT)}, {"PYTHONPATH": ""}, {}], ids=["another", "none", "unsaid"]
)
def test_a_process_whose_environment_a_test_makes_by_hand_is_watched_too(
    tmp_path: Path, own: dict[str, str]
) -> None:
    log = tmp_path / "tried"
    made = own | {"CLACAD_NETWORK_LOG": str(log)}
    line = [sys.executable, "-c", TALKATIVE]
    child = subprocess.run(line, capture_output=True, text=True, env=made, cwd=ROOT)
    assert "tests talk to no other machine" in child.stdout
    assert len(log.read_text().splitlines()) == 1


@pytest.mark.long
def test_the_main_job_runs_where_there_is_no_network_at_all(design: Path, tmp_path: Path) -> None:
    """In a network of its own, which has not even a loop."""
    apart = ["unshare", "--net", "--"]
    if shutil.which("unshare") is None or subprocess.run([*apart, "true"], capture_output=True).returncode:
        pytest.skip("a network of one's own needs unshare and the right to use it")
    for words in (["check", design], ["export", design, "-o", tmp_path / "out", "--format", "step,stl", "--quads", "4"],
                  ["verify", design, "--files", tmp_path / "out", "--rays", 1024], ["doctor", tmp_path]):  # fmt: skip
        done = subprocess.run(
            [*apart, *command([*words, "-q"])], capture_output=True, text=True, env=environment()
        )
        assert done.returncode in ((0, 1) if words[0] in ("verify", "doctor") else (0,)), done.stderr
        assert "Traceback" not in done.stderr
