"""One process that exports and verifies for hours, as a service would: memory, threads, handles and folders stay as they were."""

from __future__ import annotations

import gc
import importlib
import os
import tempfile
import threading
from dataclasses import dataclass
from pathlib import Path

import pytest
from trust.judging import read
from trust.running import TINY

from clacad.checks.file_kinds import CONVERGENCE
from clacad.design import Design
from clacad.exporting.run import export
from clacad.verification import verify

FORMATS = (
    ("stl", "table"),
    ("3mf",),
    ("ply", "glb"),
    ("xyz", "mask"),
    ("tiff", "sag"),
    ("step",),
    ("stl", "3mf"),
    ("brep",),
)
WARM = 16
"""Rounds until every format was written and read twice: what is loaded and kept once is there."""
ROOM = 30_000_000
"""Bytes of resident memory that may come and go: freed memory is not all given back to the system."""


@dataclass(frozen=True)
class State:
    """What a process holds."""

    memory: int
    threads: int
    handles: int
    folders: int

    @classmethod
    def now(cls) -> State:
        gc.collect()
        memory = int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
        return cls(
            memory,
            len(os.listdir("/proc/self/task")),
            len(os.listdir("/proc/self/fd")),
            len(os.listdir(tempfile.gettempdir())),
        )


def round_of(number: int, folder: Path) -> None:
    """One design, none like another, exported and verified."""
    changed = TINY.replace("pitch = 0.5", f"pitch = {0.5 + 1e-4 * number}")
    design: Design = read(changed)
    export(design, folder, formats=FORMATS[number % len(FORMATS)], quads=2)
    report = verify(design, folder, rays=256, role="preview")
    assert len(report.files) >= 1
    assert not [c for c in report.checks if c.id in ("integrity", "readable") and c.state == "fail"]


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="what a process holds is read from /proc")
@pytest.mark.parametrize("rounds", [
    pytest.param(20, marks=pytest.mark.long), pytest.param(200, marks=[pytest.mark.long, pytest.mark.timeout(3600)]),
])  # fmt: skip
def test_a_process_that_goes_on_holds_no_more_than_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rounds: int
) -> None:
    """The study of refinement is left out: it makes, of the design alone, the meshes that the export makes."""
    convergence = importlib.import_module("clacad.verification.light.facet_convergence")
    monkeypatch.setattr(
        convergence, "judge_convergence", lambda *_: (None, CONVERGENCE.not_run("left out", required=False))
    )
    (tmp_path / "scratch").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "scratch"))
    threads = {thread.name for thread in threading.enumerate()}
    states: list[State] = []
    for number in range(rounds):
        round_of(number, tmp_path / f"out {number % 3}")
        if number >= WARM - 1:
            states.append(State.now())
    for name in ("memory", "threads", "handles", "folders"):
        print(name, [getattr(state, name) for state in states[:: max(1, len(states) // 10)]])  # noqa: T201
    begin, end = states[0], states[-1]
    assert {thread.name for thread in threading.enumerate()} == threads
    assert (end.threads, end.handles, end.folders) == (begin.threads, begin.handles, 0)
    late = sorted(state.memory for state in states[-max(1, len(states) // 4) :])
    assert late[len(late) // 2] < begin.memory + ROOM
    assert not list(tmp_path.glob("out */.clacad-*"))
