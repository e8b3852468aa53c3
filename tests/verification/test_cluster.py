"""Studies on a cluster that loses its scheduler, its workers, or one of them: no computed result is lost."""

from __future__ import annotations

import json
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from trust.running import environment

from clacad.design import Design
from clacad.verification.tolerance import Farm, farm, parse_vary, sweep, tolerance
from clacad.verification.tolerance.farm import WorkersLost

SHEET = """
format = 1
name = "sheet"
unit = "mm"

[law]
eta = [-1.0, -1.0]

[pair]
form = "slab"
separation = 10.0
index = 1.5

[lattice]
pitch = 0.5
count = [9, 9]

[tolerances]
decentre = "2 um"
rotation = "0.05 mrad"
"""
STUDIES = {
    "sweep": ("--vary", "law.eta.0=-0.5:-1:6", "--vary", "pair.separation=5:10:5", "--rays", "1024"),
    "tolerances": ("--samples", "48", "--rays", "1024"),
}
COMMANDS = {"sweep": "sweep", "tolerances": "tolerance"}


@dataclass
class Cluster:
    """A scheduler and its workers, each a process of its own."""

    folder: Path
    processes: list[subprocess.Popen[bytes]]

    @property
    def file(self) -> Path:
        return self.folder / "scheduler.json"

    @property
    def address(self) -> str:
        return str(json.loads(self.file.read_text())["address"])

    def answers(self) -> bool:
        return self.file.exists() and self.file.read_text().rstrip().endswith("}")

    def begin(self, *arguments: str) -> None:
        place = ("--scheduler-file", str(self.file), "--no-dashboard")
        with open(self.folder / f"{len(self.processes)}.log", "wb") as log:
            self.processes.append(
                subprocess.Popen(
                    [sys.executable, "-m", "dask", *arguments, *place],
                    stdout=log,
                    stderr=log,
                    env=environment(),
                    cwd=self.folder,
                )
            )

    def workers(self, count: int) -> None:
        for _ in range(count):
            self.begin("worker", "--nthreads", "1", "--no-nanny")

    def kill(self, *which: int) -> None:
        for number in which:
            self.processes[number].kill()
            self.processes[number].wait()


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    pytest.importorskip("distributed", reason="the package distributed is not installed")
    made = Cluster(tmp_path, [])
    made.begin("scheduler", "--host", "127.0.0.1", "--port", "0")
    try:
        until(made.answers)
        yield made
    finally:
        made.kill(*range(len(made.processes)))


def until(true) -> None:
    """Wait for something that a process of ours is about to do."""
    for _ in range(2400):
        if true():
            return
        time.sleep(0.05)
    pytest.fail("waited for two minutes in vain")


def command(study: str, out: Path, *where: str) -> list[str]:
    path = out.parent / "sheet.toml"
    path.write_text(SHEET)
    return [
        sys.executable, "-m", "clacad", COMMANDS[study], str(path), *STUDIES[study], "-q", "-o", str(out), *where,
    ]  # fmt: skip


def records(path: Path) -> int:
    return path.read_bytes().count(b"\n") - 1 if path.exists() else 0


def begun(study: str, cluster: Cluster, out: Path) -> subprocess.Popen[str]:
    """A study on the cluster, some of whose results are kept already."""
    process = subprocess.Popen(
        command(study, out, "--scheduler", cluster.address),
        stderr=subprocess.PIPE,
        text=True,
        env=environment(),
    )
    until(lambda: records(out / f"{study}.checkpoint") >= 6 or process.poll() is not None)
    assert process.poll() is None
    return process


def tables(out: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(out.iterdir())}


def unbroken(study: str, out: Path) -> dict[str, bytes]:
    subprocess.run(command(study, out, "--workers", "1"), check=True, env=environment(), timeout=240)
    return tables(out)


@pytest.mark.long
@pytest.mark.parametrize("study", STUDIES)
def test_a_lost_scheduler_is_one_sentence_and_the_study_goes_on_without_it(cluster, study, tmp_path):
    cluster.workers(1)
    out = tmp_path / "out"
    process = begun(study, cluster, out)
    cluster.kill(0, 1)
    _, told = process.communicate(timeout=240)
    kept = records(out / f"{study}.checkpoint")
    assert process.returncode == 4, told
    assert told.count("\n") == 1
    assert f"the scheduler at {cluster.address} was lost" in told
    assert f"{kept} of " in told
    assert f"kept in {out / study}.checkpoint: the same command goes on" in told
    before = (out / f"{study}.checkpoint").read_bytes()
    whole = unbroken(study, tmp_path / "whole")
    assert whole[f"{study}.checkpoint"].startswith(before)
    assert unbroken(study, out) == whole


@pytest.mark.long
def test_one_worker_of_two_killed_midway_costs_nothing(cluster, tmp_path):
    cluster.workers(2)
    out = tmp_path / "out"
    process = begun("sweep", cluster, out)
    cluster.kill(1)
    _, told = process.communicate(timeout=240)
    assert (process.returncode, told) == (0, "")
    assert tables(out) == unbroken("sweep", tmp_path / "whole")


@pytest.mark.long
def test_a_scheduler_without_workers_is_said_and_not_waited_for(cluster, monkeypatch):
    monkeypatch.setattr(farm, "PATIENCE", 1.0)
    design = Design.from_dict(tomllib.loads(SHEET))
    there = Farm(scheduler=cluster.address)
    for study in (
        lambda: tolerance(design, samples=2, farm=there),
        lambda: sweep(design, [parse_vary("pair.index=1.4,1.5")], farm=there),
    ):
        with pytest.raises(WorkersLost, match=r"had no worker for 1 s; 0 of \d+ results .* with -o DIR"):
            study()


class Dying(Farm):
    """Delivers two pieces and is gone."""

    def run(self, work, study, pieces):
        yield from (work(study, piece) for piece in pieces[:2])
        raise WorkersLost("a worker process died")


@pytest.mark.slow
def test_what_was_delivered_before_the_workers_were_lost_is_kept_and_said(tmp_path):
    design = Design.from_dict(tomllib.loads(SHEET))
    axes, kept = [parse_vary("pair.index=1.4:1.6:5")], tmp_path / "sweep.checkpoint"
    with pytest.raises(
        WorkersLost, match=f"a worker process died; 2 of 5 results are kept in {kept}"
    ) as raised:
        sweep(design, axes, rays=64, farm=Dying(), checkpoint=kept)
    assert raised.value.exit_status == 4
    made = []
    found = sweep(
        design, axes, rays=64, farm=Farm(1), checkpoint=kept, progress=lambda _, done: made.append(done)
    )
    assert made == [3 / 5, 4 / 5, 1.0]
    assert found.rows == sweep(design, axes, rays=64, farm=Farm(1)).rows
