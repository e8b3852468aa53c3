"""kill -9 at any instant of an export or a report: no partial file at a final name, nothing left after the next run."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from trust.running import TINY, clacad, command, environment

KILLED = textwrap.dedent(
    """
    # Everything is imported once; each victim is a fork that exports and reports until it is killed at its instant.
    import json, os, signal, sys, time, tomllib
    from pathlib import Path
    from types import SimpleNamespace
    import numpy as np

    out, times, seed, what = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), sys.argv[4]
    from clacad.design import Design
    from clacad.exporting.run import export
    import clacad.exporting.run, clacad.report.content, clacad.report.report_files
    from clacad.report import write_report

    design = Design.from_dict(tomllib.loads(os.environ["TINY"]))

    class Made:
        "A report's content: its numbers and its page are long, so that an instant may fall among their writing."
        evidence = SimpleNamespace(ladder=SimpleNamespace(measured=list))
        def __init__(self, turn):
            self.turn = turn

    def numbers(made):
        return {"checks": [], "verdict": "", "sha256": "", "turn": made.turn, "rows": [made.turn] * 200_000}

    def page(made, mark, *_):
        return f"{mark}<html>{made.turn} " + 4_000_000 * "x" + f" {made.turn}</html>"

    clacad.report.content.numbers = numbers
    clacad.report.report_files.page = page

    forecast, forecasts = clacad.exporting.run.with_prospects, {}

    def forecast_once(*asked):
        "What light will do, which takes nine tenths of an export and writes nothing: worked out once for each mesh."
        key = tuple(row.quads for row in asked[2])
        if key not in forecasts:
            forecasts[key] = forecast(*asked)
        return forecasts[key]

    clacad.exporting.run.with_prospects = forecast_once

    def work(turn):
        clacad.report.content.content = lambda *_: Made(turn)
        if what != "report":
            export(design, out, formats=("stl", "table", "3mf"), quads=2 + turn % 2)
        if what != "export":
            write_report(None, out)

    def staged():
        return {p.name for p in out.iterdir() if p.name.startswith(".clacad-")}

    for turn in range(2):
        work(turn)
    began = time.perf_counter()
    work(1)
    span = time.perf_counter() - began
    chance = np.random.default_rng(seed)
    for turn, instant in enumerate(chance.uniform(0.0, 1.3 * span, times)):
        before, began = staged(), time.perf_counter()
        victim = os.fork()
        if victim == 0:
            try:
                while True:
                    work(turn)
            except BaseException as error:
                print(json.dumps({"error": f"{type(error).__name__}: {error}"}), flush=True)
            os._exit(1)
        if turn % 2:  # every other one among the writing, which is short beside the work before it
            instant = chance.uniform(0.0, 0.02)
            while time.perf_counter() - began < 60.0:
                if staged() - before:
                    time.sleep(float(instant))
                    os.kill(victim, signal.SIGSTOP)  # a busy machine may let it finish meanwhile: look once it stands still
                    os.waitid(os.P_PID, victim, os.WSTOPPED | os.WEXITED | os.WNOWAIT)
                    if staged() - before:
                        break
                    os.kill(victim, signal.SIGCONT)
                time.sleep(0.0005)
        else:
            time.sleep(float(instant))
        os.kill(victim, signal.SIGKILL)
        os.waitpid(victim, 0)
        print(json.dumps({"killed": turn, "stale": bool(staged() - before)}), flush=True)
        sys.stdin.readline()
    work(2)
    """
)


def whole(out: Path) -> None:
    """Nothing at a final name is partial: the manifest's files are those it lists, a page ends as it begins."""
    names = {p.name for p in out.iterdir() if not p.name.startswith(".clacad-")}
    if "manifest.json" in names:
        for entry in json.loads((out / "manifest.json").read_text())["files"]:
            assert sha256((out / entry["name"]).read_bytes()).hexdigest() == entry["sha256"]
    if "report.html" in names:
        page = (out / "report.html").read_text()
        assert page.partition("<html>")[2].split()[0] + "</html>" == page.split()[-1]
    for name in names & {"report.json", "run.json"}:
        assert json.loads((out / name).read_text())


THREE_BODIES = TINY.replace("separation", "field_lens = true\nseparation")
"""A field lens on a plate of its own, for the foci of x and y lie apart."""


@pytest.mark.slow
@pytest.mark.parametrize(("what", "times", "design"), [
    ("both", 12, TINY), pytest.param("export", 12, THREE_BODIES, marks=pytest.mark.slow),
    pytest.param("export", 100, TINY, marks=pytest.mark.long), pytest.param("report", 100, TINY, marks=pytest.mark.long),
])  # fmt: skip
def test_kill_9_at_any_instant_leaves_no_partial_file_and_the_next_run_no_trace(
    tmp_path: Path, what: str, times: int, design: str
) -> None:
    out = tmp_path / "out"
    running = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(out), str(times), "9", what], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        text=True, env=environment(TINY=design),
    )  # fmt: skip
    assert running.stdin is not None
    assert running.stdout is not None
    stale = 0
    for line in running.stdout:
        told = json.loads(line)
        assert "killed" in told, told
        stale += told["stale"]
        whole(out)
        running.stdin.write("\n")
        running.stdin.flush()
    running.stdin.close()
    running.stdout.close()
    assert running.wait(timeout=120) == 0
    assert stale > times / 4, "most instants fell among the writing"
    whole(out)
    assert not [p.name for p in out.iterdir() if p.name.startswith(".clacad-")]


@pytest.mark.slow
@pytest.mark.parametrize("times", [3, pytest.param(60, marks=[pytest.mark.long, pytest.mark.timeout(900)])])
def test_whole_commands_killed_at_any_instant(tmp_path: Path, times: int) -> None:
    """Commands of different formats, the kernel's among them, from their start to their end, all into one folder."""
    design, out = tmp_path / "tiny.toml", tmp_path / "out"
    design.write_text(TINY)
    chance = np.random.default_rng(times)
    formats = ("step,stl", "3mf,table,xyz", "stl,ply,glb,mask")
    for turn in range(times):
        arguments = ["export", design, "-o", out, "--format", formats[turn % 3], "--quads", "8", "-q"]
        running = subprocess.Popen(command(arguments), stderr=subprocess.DEVNULL, env=environment())
        time.sleep(float(chance.uniform(0.2, 2.5)))
        running.kill()
        running.wait()
        if out.exists():
            whole(out)
    assert clacad("export", design, "-o", out, "--format", "stl", "--quads", "4", "--overwrite").status == 0
    assert not [p.name for p in out.iterdir() if p.name.startswith(".clacad-")]
    listed = json.loads((out / "manifest.json").read_text())["files"]
    assert {p.name for p in out.iterdir()} == {e["name"] for e in listed} | {"manifest.json", "run.json"}
    whole(out)


def private(out: Path) -> list[Path]:
    """Folders of reports that are being written, or were when they were killed."""
    return list(out.glob(".clacad-*")) if out.exists() else []


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_a_whole_report_killed_at_any_instant(design: Path, tmp_path: Path) -> None:
    """The command itself, nothing of it replaced.

    Every other kill falls among the writing, which takes milliseconds; half of the time an older report is there.
    Equal designs give equal pages: one that is there is whole.
    """
    out, names = tmp_path / "out", {"report.html", "report.json", "run.json"}
    line = command(["verify", design, "-o", out, "--rays", "256", "-q"])
    began = time.monotonic()
    assert subprocess.run(line, capture_output=True, env=environment()).returncode in (0, 1)
    span = time.monotonic() - began
    kept = {name: (out / name).read_bytes() for name in names - {"run.json"}}
    chance, stale = np.random.default_rng(20), 0
    for turn in range(20):
        if turn % 4 < 2:
            shutil.rmtree(out, ignore_errors=True)
        before = set(private(out))
        running = subprocess.Popen(
            line, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL, env=environment()
        )
        if turn % 2:
            while running.poll() is None and not set(private(out)) - before:
                time.sleep(0.0005)
            running.send_signal(
                signal.SIGSTOP
            )  # half of them right there, whenever this process gets its turn
            if turn % 4 == 1:
                running.send_signal(signal.SIGCONT)
                time.sleep(float(chance.uniform(0.0, 0.015)))
        else:
            time.sleep(float(chance.uniform(0.0, span)))
        running.kill()
        running.wait()
        stale += bool(set(private(out)) - before)
        present = {p.name for p in out.iterdir()} - {p.name for p in private(out)} if out.exists() else set()
        assert present <= names
        for name in present & set(kept):
            assert (out / name).read_bytes() == kept[name]
        if "run.json" in present:
            assert json.loads((out / "run.json").read_text())
    assert stale > 2, "hardly a kill fell among the writing"
    assert clacad("verify", design, "-o", out, "--rays", "256", "-q").status in (0, 1)
    assert {p.name for p in out.iterdir()} == names
