"""The command line in a process of its own: what it printed, its status, and the processor time it took."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

TESTS = Path(__file__).parents[1]
ROOT = TESTS.parent

TINY = """
format = 1
name = "tiny"
unit = "mm"

[law]
eta = [-0.5, -1.0]
delta = [0.01, -0.02]

[pair]
form = "slab"
separation = 10.0
material = "PMMA"

[lattice]
pitch = 0.5
count = [2, 2]
"""

DRIVER = """
import resource, sys
{before}
from clacad.cli import main
status = main(sys.argv[1:])
used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
sys.stdout.flush()
sys.stderr.write("\\nCPU %.3f" % sum(u.ru_utime + u.ru_stime for u in used))
sys.exit(status)
"""


@dataclass(frozen=True)
class Ended:
    """A command that ended."""

    status: int
    out: str
    err: str
    cpu: float


def environment(**changes: str) -> dict[str, str]:
    """Where the package and the tests' helpers are found, whatever the current folder."""
    path = os.pathsep.join([str(TESTS / "offline"), str(ROOT), str(TESTS)])
    return os.environ | {"PYTHONPATH": path} | changes


def command(arguments: Sequence[object], before: str = "pass") -> list[str]:
    return [sys.executable, "-c", DRIVER.format(before=before), *map(str, arguments)]


def clacad(*arguments: object, before: str = "pass", cwd: Path | None = None, **changes: str) -> Ended:
    """Run one command; `before` is executed first in its process."""
    done = subprocess.run(
        command(arguments, before), capture_output=True, text=True, cwd=cwd, env=environment(**changes), timeout=120
    )  # fmt: skip
    err, _, cpu = done.stderr.rpartition("\nCPU ")
    ended = Ended(done.returncode, done.stdout, err if cpu else done.stderr, float(cpu or "nan"))
    assert not any(line.startswith("Traceback") for line in talk(ended)), ended.err
    return ended


def talk(ended: Ended) -> list[str]:
    """Lines of the error stream."""
    return [line for line in ended.err.splitlines() if line.strip()]
