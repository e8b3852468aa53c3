"""The command line in a process of its own: what it printed, its status, and what it had to load; small disks."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

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

HEAVY = {
    "OCP",
    "build123d",
    "numba",
    "scipy",
    "matplotlib",
    "trimesh",
    "manifold3d",
    "PIL",
    "jinja2",
}
"""Packages that cost seconds, or that work with rays, meshes and solids."""

JUDGES = {"base", "cli", "config", "design", "exporting", "optics", "storage"}
"""Parts of the package that read a design and count the work it requests; none can build or trace anything."""

DRIVER = """
import resource, sys
{before}
from clacad.cli import main
status = main(sys.argv[1:])
sys.stdout.flush()
sys.stderr.write("\\nLOADED " + " ".join(sys.modules))
sys.exit(status)
"""


@dataclass(frozen=True)
class Ended:
    """A command that ended."""

    status: int
    out: str
    err: str
    modules: frozenset[str]

    @property
    def packages(self) -> set[str]:
        """Top-level names of what was loaded."""
        return {name.partition(".")[0] for name in self.modules}

    @property
    def parts(self) -> set[str]:
        """Parts of the package that were loaded."""
        return {name.split(".")[1] for name in self.modules if name.startswith("clacad.")}


def environment(**changes: str) -> dict[str, str]:
    """Environment in which the package and the tests' helpers are found, regardless of the current folder."""
    path = os.pathsep.join([str(TESTS / "offline"), str(ROOT), str(TESTS)])
    return os.environ | {"PYTHONPATH": path} | changes


def command(arguments: Sequence[object], before: str = "pass") -> list[str]:
    return [sys.executable, "-c", DRIVER.format(before=before), *map(str, arguments)]


def clacad(*arguments: object, before: str = "pass", cwd: Path | None = None, **changes: str) -> Ended:
    """Run one command; `before` is executed first in its process."""
    done = subprocess.run(
        command(arguments, before), capture_output=True, text=True, cwd=cwd, env=environment(**changes), timeout=120
    )  # fmt: skip
    err, mark, loaded = done.stderr.rpartition("\nLOADED ")
    ended = Ended(
        done.returncode, done.stdout, err if mark else done.stderr, frozenset(loaded.split() if mark else ())
    )
    assert not any(line.startswith("Traceback") for line in talk(ended)), ended.err
    return ended


STAGE = re.compile(r"\.\.\.(  ?\((of all|longer than).*\))?$")


def talk(ended: Ended) -> list[str]:
    """Lines of the error stream, but the stages that a busy machine takes more than a second for, with what is left of them."""
    return [line for line in ended.err.splitlines() if line.strip() and not STAGE.search(line)]


@contextmanager
def small_disk(place: Path, kilobytes: int) -> Iterator[Path]:
    """A disk of its own, of a given size in kB, at a folder that is made; skips the test where none can be mounted."""
    place.mkdir()
    made = os.geteuid() == 0 and shutil.which("mount") is not None and subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "tmpfs", place], capture_output=True).returncode == 0  # fmt: skip
    if not made:
        pytest.skip("mounting a small disk needs root and the right to mount")
    try:
        yield place
    finally:
        subprocess.run(["umount", "-l", place], check=True)
