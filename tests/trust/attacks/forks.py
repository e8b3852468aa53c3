"""Many commands a minute: everything is imported once, and each command runs in a fork with limits of its own.

Reads one JSON object a line: `words` of the command line, `folder` to run in, `scratch` folder for temporary files,
`said` file for both output streams, `cpu` and `wall` seconds. Answers each with one: `status` (negative: a signal), `cpu`, `wall`.
"""

from __future__ import annotations

import faulthandler
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

PRELOADED = (
    "clacad.cli.app", "numpy", "scipy.optimize", "scipy.spatial", "scipy.spatial.transform", "scipy.special",
    "matplotlib.figure", "matplotlib.backends.backend_agg", "matplotlib.backends.backend_svg", "PIL.Image", "PIL.PngImagePlugin",
    "jinja2", "tree_sitter_toml", "clacad.cli.accuracy_command", "clacad.cli.check_command",
    "clacad.cli.image_command", "clacad.cli.new_command", "clacad.cli.optimise_command", "clacad.cli.render_command",
    "clacad.cli.shape_command", "clacad.cli.stack_command", "clacad.cli.tolerance_command", "clacad.cli.trace_command",
    "clacad.cli.verify_command", "clacad.prescription.prescribe", "clacad.tracing.trace",
    "clacad.imaging.shape", "clacad.verification.run", "clacad.waves.through_sheet", "clacad.exporting.run",
    "clacad.rendering.picture", "clacad.advice", "clacad.optimising",
)  # fmt: skip
"""Modules that most commands import; none compiles kernels or begins a thread."""

MEMORY = 8 << 30
"""Bytes of address space that a command may take."""


class Forks:
    """The process that forks; a context manager whose `run` gives the answer to one command."""

    def __enter__(self) -> Forks:
        from trust.running import environment

        alone = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MPLBACKEND": "agg"}
        self._process = subprocess.Popen(
            [sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment(**alone)
        )  # fmt: skip
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(timeout=60)

    def run(self, request: dict[str, Any]) -> dict[str, Any]:
        """Run one command and wait for it."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        answer: dict[str, Any] = json.loads(self._process.stdout.readline())
        return answer


def _victim(request: dict[str, Any]) -> int:
    """Run the command in this process, a fork; its exit status."""
    os.setsid()
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    said = os.open(request["said"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    os.dup2(said, 1)
    os.dup2(said, 2)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    faulthandler.register(signal.SIGXCPU, file=2, all_threads=False, chain=False)  # where the time went
    resource.setrlimit(resource.RLIMIT_CPU, (request["cpu"], request["cpu"] + 1))
    os.chdir(request["folder"])
    os.environ["TMPDIR"] = tempfile.tempdir = request["scratch"]
    sys.stdin, sys.stdout, sys.stderr = (open(k, "r" if k == 0 else "w", closefd=False, encoding="utf-8") for k in range(3))  # fmt: skip
    from clacad.cli import main

    try:
        status = main(request["words"])
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 1
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    return status


def _answered(request: dict[str, Any]) -> dict[str, Any]:
    began = time.monotonic()
    victim = os.fork()
    if victim == 0:
        status = 99
        try:
            status = _victim(request)
        except BaseException:
            import traceback

            os.write(2, traceback.format_exc().encode())
        os._exit(status)
    signal.signal(signal.SIGALRM, lambda *_: os.kill(victim, signal.SIGKILL))
    signal.alarm(request["wall"])
    _, status, usage = os.wait4(victim, 0)
    signal.alarm(0)
    try:
        os.killpg(victim, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):
        pass
    cpu = usage.ru_utime + usage.ru_stime
    return {"status": os.waitstatus_to_exitcode(status), "cpu": cpu, "wall": time.monotonic() - began,
            "memory": usage.ru_maxrss >> 10}  # fmt: skip


def requests(lines: Iterable[str]) -> Iterator[dict[str, Any]]:
    """Work requested, line by line."""
    yield from map(json.loads, lines)


if __name__ == "__main__":
    sys.path[:0] = [str(Path(__file__).parents[2]), str(Path(__file__).parents[3])]
    from importlib import import_module

    for name in PRELOADED:
        import_module(name)
    assert "numba" not in sys.modules
    for request in requests(sys.stdin):
        answer = _answered(request)
        sys.__stdout__.write(json.dumps(answer) + "\n")  # type: ignore[union-attr]
        sys.__stdout__.flush()  # type: ignore[union-attr]
