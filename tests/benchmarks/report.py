"""Processor seconds of whole reports: writes report.md.

    python tests/benchmarks/report.py --into tests/benchmarks/report.md

Each row is `clacad verify DESIGN -o DIR` in a process of its own, its rays at their default, after a first run that has
compiled the kernels. The floor, a million Mersenne numbers sorted by numpy twenty times, is measured right before, so that
ratios mean the same on another machine.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROMISED = {"window-100mm": 60.0, "paper-base": 20.0}
FLOOR = (
    sys.executable,
    "-c",
    "import numpy as n\nfor k in range(20): n.sort(n.random.RandomState(k).random_sample(10**6))",
)


def run(command: list[str] | tuple[str, ...]) -> tuple[float, float]:
    """Processor and wall-clock seconds of a program."""
    began = time.monotonic()
    running = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)}
    )  # fmt: skip
    _, status, used = os.wait4(running.pid, 0)
    running.returncode = os.waitstatus_to_exitcode(status)
    if running.returncode not in (0, 1):
        raise SystemExit(f"{' '.join(command)} ended with {running.returncode}")
    return used.ru_utime + used.ru_stime, time.monotonic() - began


HEAD = """# What a whole report costs

    python tests/benchmarks/report.py --into tests/benchmarks/report.md

`clacad verify DESIGN -o DIR` with its default rays, kernels compiled before; processor seconds of all threads, and the
wall clock beside them. Shared x86-64 machine of {cores} cores, others at work on it (load {load:.0f}): on a machine of one's
own the wall clock is between the processor seconds and half of them. The floor sorts twenty million numbers with numpy.

| design | lenslets an array | processor s | promised s | wall s | floor s | ratio | page, bytes |
|---|---|---|---|---|---|---|---|
"""


def main() -> None:
    """Measure, print, and write if requested."""
    parser = argparse.ArgumentParser(description="Processor seconds of reports.")
    parser.add_argument("--into", type=Path, help="write the page here")
    into, lines = parser.parse_args().into, []
    from clacad import load

    with tempfile.TemporaryDirectory() as folder:
        run(
            (
                sys.executable,
                "-m",
                "clacad",
                "verify",
                "designs/slab.toml",
                "-o",
                f"{folder}/first",
                "--rays",
                "2048",
            )
        )
        for name, promised in PROMISED.items():
            floor, _ = run(FLOOR)
            out = Path(folder) / name
            took, wall = run(
                (sys.executable, "-m", "clacad", "verify", f"designs/{name}.toml", "-o", str(out))
            )
            n1, n2 = load(ROOT / "designs" / f"{name}.toml").lattice.count
            size = (out / "report.html").stat().st_size
            lines.append(
                f"| {name} | {n1} × {n2} | {took:.1f} | {promised:g} | {wall:.1f} | {floor:.2f} | {took / floor:.1f} | {size:,} |"
            )
            print(lines[-1], flush=True)
    if into is not None:
        into.write_text(
            HEAD.format(cores=os.cpu_count(), load=os.getloadavg()[0]) + "\n".join(lines) + "\n",
            encoding="utf-8",
        )


if __name__ == "__main__":
    main()
