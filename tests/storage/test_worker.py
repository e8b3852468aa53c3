"""A crash, hang or exit of native code in the worker process: the caller gets an error message and keeps running."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from clacad.storage.errors import CannotWrite, LimitRefused, WorkerDied
from clacad.storage.worker import Worker

TESTS = str(Path(__file__).parents[1])


@pytest.fixture
def worker() -> Iterator[Worker]:
    with Worker() as one:
        yield one


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    state = Path(f"/proc/{pid}/stat")
    return not (state.exists() and state.read_text().rpartition(")")[2].split()[0] == "Z")


def gone_soon(pid: int) -> bool:
    """Within what a busy machine may take to carry out a kill; it takes milliseconds."""
    end = time.monotonic() + 120.0
    while alive(pid):
        if time.monotonic() > end:
            return False
        time.sleep(0.01)
    return True


def test_a_result_and_its_stages_come_back_and_the_child_is_used_again(worker: Worker) -> None:
    stages: list[tuple[str, float]] = []
    assert worker.run("worker_tricks:add", 1.5, 2.5, progress=lambda *s: stages.append(s)) == 4.0
    assert stages == [("adding", 0.5)]
    first = worker.pid
    assert worker.run("worker_tricks:total", np.arange(10.0)) == 45.0
    assert worker.pid == first


def test_what_the_child_prints_cannot_forge_a_result(worker: Worker) -> None:
    assert worker.run("worker_tricks:chatter") == "true"


@pytest.mark.parametrize(
    ("trick", "sentence"),
    [
        ("segfault", r"segmentation fault.*stage: kernel"),
        ("abort", "an abort"),
        ("leave", "status 0 without a result"),
        ("garbage", "nonsense"),
        ("fail", "KeyError"),
    ],
)
def test_a_death_is_one_sentence_and_the_next_call_works(worker: Worker, trick: str, sentence: str) -> None:
    with pytest.raises(WorkerDied, match=sentence) as caught:
        worker.run(f"worker_tricks:{trick}")
    assert caught.value.exit_status == 70
    assert "\n" not in str(caught.value)
    assert worker.run("worker_tricks:add", 1, 1) == 2


@pytest.mark.slow
def test_a_hanging_child_is_ended_at_the_time_limit(worker: Worker) -> None:
    worker.start()
    pid = worker.pid
    assert pid is not None
    with pytest.raises(WorkerDied, match="did not finish within 1.5 s"):
        worker.run("worker_tricks:hang", timeout=1.5)
    assert gone_soon(pid)


@pytest.mark.slow
def test_running_out_of_memory_names_the_limit() -> None:
    with Worker(memory=1_500_000_000) as worker, pytest.raises(WorkerDied, match=r"out of memory"):
        worker.run("worker_tricks:eat")


@pytest.mark.slow
@pytest.mark.parametrize(
    "trick", [pytest.param("mesh_with_the_kernel", marks=pytest.mark.long), "sphere_of_the_mesh_kernel"]
)
def test_real_kernels_that_want_more_than_1_5_gb_end_in_a_sentence(trick: str) -> None:
    """They crash, abort or raise as they like: seen were segmentation faults and std::bad_alloc."""
    with Worker(memory=1_500_000_000) as worker:
        with pytest.raises(WorkerDied, match=r"limit 1\.5 GB|out of memory") as caught:
            worker.run(f"worker_tricks:{trick}", timeout=120)
        assert caught.value.exit_status == 70
        assert "\n" not in str(caught.value)
        assert worker.run("worker_tricks:add", 1, 1) == 2


@pytest.mark.slow
def test_running_out_of_processor_time_names_the_limit() -> None:
    with Worker(cpu=1) as worker, pytest.raises(WorkerDied, match=r"1 s of processor time"):
        worker.run("worker_tricks:spin")


def test_errors_of_our_own_keep_their_kind(worker: Worker) -> None:
    with pytest.raises(LimitRefused, match="too many"):
        worker.run("worker_tricks:refuse")
    with pytest.raises(CannotWrite, match="no space left"):
        worker.run("worker_tricks:cannot")


@pytest.mark.slow
def test_a_kernel_that_hears_nothing_is_ended_without_its_answer() -> None:
    """The parent waits on a pipe, so its own end needs no answer from the kernel."""
    pids: list[int | None] = []
    with Worker(preload=["OCP.BRepMesh", "OCP.BRepPrimAPI"]) as worker:
        worker.run("worker_tricks:add", 1, 1)  # the kernel is loaded: the 8 s are those of the meshing
        with pytest.raises(WorkerDied, match=r"did not finish within 8 s.*meshing"):
            worker.run(
                "worker_tricks:stuck_in_the_kernel", timeout=8, progress=lambda *_: pids.append(worker.pid)
            )
        assert worker.pid is None
    assert pids
    assert not any(pid is None or alive(pid) for pid in pids)


CALLER = textwrap.dedent(
    """
    import sys
    from clacad.storage.worker import Worker, ended_by_signals
    try:
        with ended_by_signals(), Worker() as worker:
            worker.run("worker_tricks:hang_with_child", progress=lambda name, _: print(name, worker.pid, flush=True))
    except KeyboardInterrupt:
        sys.exit(130)
    """
)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_signal_ends_the_child_and_what_it_started(number: int) -> None:
    caller = subprocess.Popen(
        [sys.executable, "-c", CALLER],
        stdout=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": _path()},
        text=True,
    )
    assert caller.stdout is not None
    _, grandchild, child = caller.stdout.readline().split()
    caller.send_signal(number)
    assert gone_soon(int(child))
    if number != signal.SIGKILL:  # nobody is left to end the grandchild of a killed parent
        assert caller.wait(timeout=120) == 130
        assert gone_soon(int(grandchild))
    else:
        os.kill(int(grandchild), signal.SIGKILL)
        caller.wait()
    caller.stdout.close()


DROPPED = textwrap.dedent(
    """
    import os, signal, sys, time, weakref
    from clacad.storage.worker import ended_by_signals

    class Thing:
        pass

    def told(_):
        print("dropped", flush=True)
        os.kill(os.getpid(), int(sys.argv[1]))
        time.sleep(0.001)

    try:
        with ended_by_signals():
            thing = Thing()
            watched = weakref.ref(thing, told)
            del thing
            time.sleep(600)
    except KeyboardInterrupt:
        sys.exit(130)
    """
)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_that_comes_where_python_drops_exceptions_still_ends_the_block(number: int) -> None:
    """Otherwise it sleeps until long after the time limit."""
    done = subprocess.run(
        [sys.executable, "-c", DROPPED, str(int(number))],
        capture_output=True,
        env=os.environ | {"PYTHONPATH": _path()},
        text=True,
        timeout=120,
        check=False,
    )
    assert done.stdout == "dropped\n"
    assert (done.returncode, done.stderr) == (130, "")


def _path() -> str:
    return os.pathsep.join(entry for entry in sys.path if entry)


def test_the_parent_loads_nothing_heavy() -> None:
    code = "import clacad.storage.worker, clacad.storage.atomic, sys; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONPATH": _path()},
    ).stdout.split()
    assert not {"numpy", "OCP", "multiprocessing", "pydantic"} & set(loaded)
