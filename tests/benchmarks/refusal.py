"""Processor seconds of `--help`, `check` and each refusal, compared with a floor measured in turn: writes refusal.md.

    python tests/benchmarks/refusal.py --into tests/benchmarks/refusal.md

Every row is the program itself, started five times; the fastest counts. The floor, `python -c "import numpy"`, is
measured in turn with it, so the ratio means the same on a fast and on a slow machine, and while others use the machine.
Bytecode is cached, as after an installation.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[2]
DESIGN = str(ROOT / "designs" / "slab.toml")
MANY = ("--set", "lattice.count=[1000000000,1000000000]")
TURNS = 5
FLOOR = (sys.executable, "-c", "import numpy")


def rows(place: Path) -> list[tuple[str, tuple[str, ...], int]]:
    """What is typed, its arguments, its status."""
    rays, out = str(place / "rays.npz"), str(place / "out")
    refused: list[tuple[str, tuple[str, ...], int]] = [
        (" ".join(["clacad", *said, "of 1e18 lenslets"]), (*words, *MANY), 3)
        for said, words in (
            (("check",), ("check", DESIGN)),
            (("export",), ("export", DESIGN, "-o", out)),
            (("export --dry-run",), ("export", DESIGN, "-o", out, "--dry-run")),
            (("verify",), ("verify", DESIGN)),
            (("accuracy",), ("accuracy", DESIGN)),
            (("effects",), ("effects", DESIGN)),
            (("tolerance",), ("tolerance", DESIGN)),
            (("sweep",), ("sweep", DESIGN, "--vary", "law.eta.0=-0.25:-4:3")),
            (("trace",), ("trace", DESIGN, rays, "-o", out)),
        )
    ]
    fine = (
        "export",
        str(ROOT / "designs" / "window-100mm.toml"),
        "-o",
        out,
        "--format",
        "stl",
        "--quads",
        "64",
    )
    return [
        ("clacad --version", ("--version",), 0), ("clacad --help", ("--help",), 0), ("clacad check", ("check", DESIGN), 0),
        *refused, ("clacad export of 6e8 facets", fine, 3),
        ("clacad check of a file with mistakes", ("check", DESIGN, "--set", "lattice.pich=1"), 2),
    ]  # fmt: skip


def seconds(command: Sequence[str], status: int) -> float:
    """Processor seconds of a program and its children."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "CLACAD_CACHE_DIR": ""}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    quiet = subprocess.DEVNULL
    running = subprocess.Popen(command, stdout=quiet, stderr=quiet, env=environment, cwd=ROOT)
    _, ended, used = os.wait4(running.pid, 0)
    running.returncode = os.waitstatus_to_exitcode(ended)
    if running.returncode != status:
        raise SystemExit(f"{' '.join(command)} ended with {running.returncode}, not {status}")
    return used.ru_utime + used.ru_stime


def measured(arguments: Sequence[str], status: int) -> tuple[float, float]:
    """Fastest of the program and of the floor, in turns."""
    command = (sys.executable, "-m", "clacad", *arguments)
    pairs = [(seconds(command, status), seconds(FLOOR, 0)) for _ in range(TURNS)]
    return min(p for p, _ in pairs), min(f for _, f in pairs)


def table() -> str:
    """The result as a Markdown table."""
    with tempfile.TemporaryDirectory() as folder:
        lines = ["| typed | processor seconds | floor | ratio |", "|---|---|---|---|"]
        for title, arguments, status in rows(Path(folder)):
            took, floor = measured(arguments, status)
            lines.append(f"| {title} | {took:.2f} | {floor:.2f} | {took / floor:.1f} |")
            print(lines[-1], flush=True)
    return "\n".join(lines) + "\n"


HEAD = """# How soon the program answers, and refuses

    python tests/benchmarks/refusal.py --into tests/benchmarks/refusal.md

Processor seconds (user and system) of the program started anew, the fastest of {turns}; the floor is `python -c "import
numpy"`, measured in turn with each row. Shared x86-64 machine of {cores} cores, Python {python}. That nothing is begun
which could build or trace, and that memory stays below 2 GB, is tested (`tests/trust/test_command_line.py`); seconds are
only measured, here.

<!-- table -->

"""


def main() -> None:
    """Measure, print, and write if requested."""
    parser = argparse.ArgumentParser(description="Processor seconds of answers and refusals.")
    parser.add_argument("--into", type=Path, help="write the page here")
    into = parser.parse_args().into
    found = table()
    if into is not None:
        python = ".".join(map(str, sys.version_info[:3]))
        into.write_text(
            HEAD.format(turns=TURNS, cores=os.cpu_count(), python=python) + found, encoding="utf-8"
        )


if __name__ == "__main__":
    main()
