"""Ctrl-C and SIGTERM at any time: status 130, one sentence, nothing left; how soon is in tests/benchmarks/interruption.md."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from trust.running import environment

from clacad.cli.entry_point import SENTENCE, InterruptHandler

HANG = 120.0
"""Seconds after which an interrupted command counts as hung: many times what any takes on a busy machine."""

PROGRAM = """
{before}
from clacad.__main__ import main
main()
"""


def started(arguments: Sequence[object], before: str = "pass", **changes: str) -> subprocess.Popen[str]:
    """The program, its error stream a pipe; `before` is executed first in its process."""
    line = [sys.executable, "-c", PROGRAM.format(before=before), *map(str, arguments)]
    return subprocess.Popen(
        line, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=environment(**changes)
    )


def until(running: subprocess.Popen[str], word: str) -> None:
    """Read the error stream up to a line that holds the word."""
    assert running.stderr is not None
    assert any(word in line for line in running.stderr), f"it ended before it said {word}"


def interrupted(running: subprocess.Popen[str], *numbers: int) -> str:
    """Send signals; the command ends by them, prints one sentence and shows no traceback. Returns its output."""
    assert running.poll() is None, "it ended by itself: make the work longer"
    for number in numbers:
        running.send_signal(number)
    _, said = running.communicate(timeout=HANG)
    assert (running.returncode, said.count(SENTENCE)) == (130, 1), said
    assert "Traceback" not in said
    assert "internal error" not in said
    assert '"event": "error"' not in said
    return said


@pytest.mark.daily_cases("2-stl-forecast")
@pytest.mark.parametrize(
    ("number", "formats", "stage"),
    [
        (signal.SIGINT, "step", "write tiny.step"),
        (signal.SIGTERM, "step", "write tiny.step"),
        (signal.SIGINT, "stl", "forecast"),
    ],
)
def test_an_interrupted_export_is_130_and_leaves_nothing(
    design: Path, tmp_path: Path, number: int, formats: str, stage: str
) -> None:
    """Work of many seconds, so that it is not over before the signal comes, however late this process gets its turn."""
    out = tmp_path / "out"
    running = started(["export", design, "-o", out, "--format", formats, "--cells", "60x60", "-v"])
    until(running, f'"{stage}"')
    interrupted(running, number)
    assert not out.exists() or not list(out.iterdir())


@pytest.mark.daily_cases("accuracy")
@pytest.mark.parametrize(("number", "what"), [
    (signal.SIGINT, "verify"), (signal.SIGTERM, "trace"), (signal.SIGINT, "accuracy"), (signal.SIGTERM, "accuracy"),
], ids=["verify", "trace", "accuracy", "accuracy, ended"])  # fmt: skip
def test_every_long_command_can_be_interrupted_and_leaves_nothing(
    design: Path, tmp_path: Path, number: int, what: str
) -> None:
    """Also while kernels are compiled, which takes seconds and hears nothing: there is no cache here."""
    rays, out, cache = tmp_path / "rays.npz", tmp_path / "out", tmp_path / "cache"
    if what == "trace":
        grid = np.random.default_rng(0).uniform(-0.4, 0.4, (2_000_000, 3)) * [1, 1, 0] - [0, 0, 1]
        np.savez(rays, position=grid, direction=np.tile([0.0, 0.0, 1.0], (len(grid), 1)))
    arguments: dict[str, list[object]] = {
        "verify": ["verify", design, "-o", out], "trace": ["trace", design, rays, "-o", out / "traced.npz"],
        "accuracy": ["accuracy", design, "-o", out / "plot.svg", "--rays", "20000"],
    }  # fmt: skip
    running = started([*arguments[what], "-v"], NUMBA_CACHE_DIR=str(cache))
    until(running, '"start"' if what == "trace" else '"stage"')
    time.sleep(1.5)
    interrupted(running, number)
    assert not out.exists() or not list(out.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("times", [4, pytest.param(60, marks=pytest.mark.long)])
def test_signals_at_any_instant_are_heard_or_come_too_late(design: Path, tmp_path: Path, times: int) -> None:
    """While modules are loaded, the work is done, and the process ends; now and then twice, as by an impatient hand."""
    chance = np.random.default_rng(times)
    for turn in range(times):
        out = tmp_path / f"out {turn}"
        running = started(["export", design, "-o", out, "--format", "stl,table", "--quads", "8", "-v"])
        until(running, '"start"')
        time.sleep(chance.uniform(0.0, 1.2))
        numbers = [signal.SIGINT, signal.SIGTERM][: 1 + turn % 2]
        for number in numbers:
            running.send_signal(number)
        _, said = running.communicate(timeout=HANG)
        assert "Traceback" not in said
        # nobody listens any more to a process that has printed its last word: the system ends what is left
        late = [-number for number in numbers] if '"event": "end"' in said else []
        if running.returncode in (0, *late):
            assert SENTENCE not in said
            assert (out / "manifest.json").exists()
        else:
            assert (running.returncode, said.count(SENTENCE)) == (130, 1), said
            assert not out.exists() or not list(out.iterdir()) or (out / "manifest.json").exists()


# -- what libraries make of it ---------------------------------------------------------------------

WORK = """
import sys, time
import clacad.sheet.feasibility
def wait():
    sys.stderr.write("ready\\n")
    time.sleep(600)
def work(*_):
{work}
clacad.sheet.feasibility.describe = work
"""


@pytest.mark.daily_cases("another error")
@pytest.mark.parametrize("work", [
    "wait()", "exec('wait()', globals())", "try: wait()\n    except BaseException: raise OSError(28, 'full')",
    "try: wait()\n    except BaseException: sys.exit(7)", "try: wait()\n    except BaseException: time.sleep(600)",
    "class Deaf:\n        def __del__(self): wait()\n    Deaf()\n    time.sleep(600)",
], ids=["plain", "in executed text", "another error", "an exit", "swallowed", "cannot be raised"])  # fmt: skip
def test_whatever_a_library_makes_of_an_interruption_it_is_one(design: Path, work: str) -> None:
    running = started(["check", "--all", design], before=WORK.format(work=f"    {work}"))
    until(running, "ready")
    interrupted(running, signal.SIGINT)


@pytest.mark.slow
def test_a_second_signal_does_not_break_off_the_cleaning_up(design: Path) -> None:
    work = "    try: wait()\n    finally:\n        time.sleep(0.05)\n        sys.stderr.write('cleaned\\n')"
    # before kernels are loaded: once they are, a signal ends the process without an exception
    early = WORK.replace("sheet.feasibility.describe", "prescription.prescribe.prescribe")
    running = started(
        ["check", design],
        before=early.replace("sheet.feasibility", "prescription.prescribe").format(work=work),
    )
    until(running, "ready")
    assert "cleaned" in interrupted(running, signal.SIGINT, signal.SIGINT, signal.SIGTERM)


@pytest.mark.slow
def test_an_ignored_signal_stays_ignored(design: Path) -> None:
    """As under nohup."""
    work = "import signal; signal.signal(signal.SIGHUP, signal.SIG_IGN)\n" + WORK.format(
        work="    sys.stderr.write('ready\\n')\n    time.sleep(0.5)\n    sys.stderr.write('went on\\n')\n    return []"
    )
    running = started(["check", "--all", design], before=work)
    until(running, "ready")
    running.send_signal(signal.SIGHUP)
    _, said = running.communicate(timeout=HANG)
    assert "went on" in said
    assert SENTENCE not in said


def test_the_sentence_is_said_once_whoever_comes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "numba", raising=False)  # with it the process would be ended at once
    handler, said = InterruptHandler(), []
    with pytest.raises(KeyboardInterrupt):
        handler.handle(signal.SIGINT, None)
    handler.handle(signal.SIGINT, None)
    threads = [threading.Thread(target=handler.tell, args=(said.append,)) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert said == [SENTENCE]


@pytest.mark.slow
def test_the_loading_of_a_module_is_not_unwound(design: Path, tmp_path: Path) -> None:
    """Compiled code at load time need not expect an exception: the process ends at once, cleaned up, from below it."""
    (tmp_path / "slowly.py").write_text("import sys, time\nsys.stderr.write('ready\\n')\ntime.sleep(600)\n")
    work = f"""
import sys
sys.path.insert(0, {str(tmp_path)!r})
import clacad.sheet.feasibility
def work(*_):
    try:
        import slowly
    except BaseException:
        sys.stderr.write("unwound\\n")
        raise
clacad.sheet.feasibility.describe = work
"""
    running = started(["check", "--all", design], before=work)
    until(running, "ready")
    assert "unwound" not in interrupted(running, signal.SIGINT)
