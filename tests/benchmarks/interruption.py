"""Seconds from Ctrl-C to the end of the program, at random instants of its commands: writes interruption.md.

    python tests/benchmarks/interruption.py -n 40 --into tests/benchmarks/interruption.md

Each run is the program itself with a kernel cache that is empty, so that instants fall into compilation too. Every
third run receives two signals. Counted: runs that did not end with status 130 and exactly one sentence (and had not ended by
themselves), and files left behind.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

ROOT = Path(__file__).parents[2]
DESIGN = str(ROOT / "designs" / "slab.toml")
SENTENCE = "clacad: interrupted\n"
COMMANDS = {
    "check": (("check", DESIGN), 0.4),
    "export, STEP and STL": (("export", DESIGN, "-o", "OUT", "--cells", "3x3"), 4.0),
    "verify with its report": (("verify", DESIGN, "-o", "OUT"), 8.0),
    "accuracy": (("accuracy", DESIGN, "-o", "OUT/plot.svg", "--rays", "20000"), 9.0),
    "render": (("render", str(ROOT / "designs" / "scenes" / "fig1b.toml"), "-o", "OUT/x.png"), 6.0),
}


def once(words: tuple[str, ...], instant: float, twice: bool, number: int) -> tuple[float, str, int]:
    """Seconds to the end, what it was ("interrupted", "over" or "wrong"), files left."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        line = [sys.executable, "-m", "clacad", *(w.replace("OUT", str(out)) for w in words), "-v"]
        cache = {"NUMBA_CACHE_DIR": f"{folder}/cache", "CLACAD_CACHE_DIR": "", "PYTHONPATH": str(ROOT)}
        running = subprocess.Popen(
            line,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | cache,
            cwd=ROOT,
        )
        assert running.stderr is not None
        running.stderr.readline()  # the program's own first word
        time.sleep(instant)
        over = running.poll() is not None
        began = time.monotonic()
        running.send_signal(number)
        if twice:
            time.sleep(0.02)
            running.send_signal(signal.SIGINT)
        _, said = running.communicate()
        took = time.monotonic() - began
        good = running.returncode == 130 and said.count(SENTENCE) == 1 and "Traceback" not in said
        done = running.returncode in (0, 1) and SENTENCE not in said
        left = len(list(out.iterdir())) if good and out.exists() else 0
        return took, "over" if over or done else "interrupted" if good else "wrong", left


HEAD = """# How soon an interruption ends a command

    python tests/benchmarks/interruption.py -n {count} --into tests/benchmarks/interruption.md

Wall-clock seconds from the signal (SIGINT and SIGTERM in turn) to the end of the process, at instants drawn evenly over
the run, from the program's first word on: before that the interpreter itself is starting, and a signal ends it as it ends
any Python. Kernels are compiled in each run. Shared x86-64 machine of {cores} cores, others at work on it (load {load:.0f}). Promised is one
second on a machine of one's own; the tests ask only that it ends, in one sentence, with nothing left.

| command | interrupted | median s | 95 % s | greatest s | over before | other status or sentence | files left |
|---|---|---|---|---|---|---|---|
"""


def main() -> None:
    """Measure, print, and write if requested."""
    parser = argparse.ArgumentParser(description="Seconds from a signal to the end.")
    parser.add_argument("-n", type=int, default=40, help="runs of each command")
    parser.add_argument("--into", type=Path, help="write the page here")
    asked = parser.parse_args()
    chance, lines = random.Random(1), []
    for title, (words, length) in COMMANDS.items():
        found = [
            once(words, chance.uniform(0.0, length), turn % 3 == 2, (signal.SIGINT, signal.SIGTERM)[turn % 2])
            for turn in range(asked.n)
        ]
        times = sorted(took for took, what, _ in found if what == "interrupted") or [float("nan")]
        count = {word: sum(what == word for _, what, _ in found) for word in ("interrupted", "over", "wrong")}
        late = times[min(len(times) - 1, int(0.95 * len(times)))]
        lines.append(
            f"| {title} | {count['interrupted']} | {median(times):.2f} | {late:.2f} | {times[-1]:.2f} | {count['over']} "
            f"| {count['wrong']} | {sum(left for _, _, left in found)} |"
        )
        print(lines[-1], flush=True)
    if asked.into is not None:
        head = HEAD.format(count=asked.n, cores=os.cpu_count(), load=os.getloadavg()[0])
        asked.into.write_text(head + "\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
