"""Verdicts of the mutation bench against what is optically right: writes verdicts.md.

    python tests/benchmarks/verdicts.py --into tests/benchmarks/verdicts.md [--meshes]

The cases are those of tests/trust/bench. `--meshes` adds every sheet at 4 … 256 quads a cell, which takes half an hour.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests"))

from filesonly import only_files  # noqa: E402
from trust.bench import meshes, sheets  # noqa: E402
from trust.bench.cases import Kits, Outcome, every_case, judged  # noqa: E402

KINDS = ("false pass", "false fail", "wrong word", "no warning", "right")


def cpu() -> float:
    """Processor seconds of this process and of those it started and waited for, s."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def bench(home: Path) -> list[Outcome]:
    """Every case, judged."""
    kits, found = Kits(home / "kits"), []
    for number, case in enumerate(every_case()):
        found.append(judged(case, kits, home / str(number)))
        print(found[-1], flush=True)
    return found


def by_right(found: list[Outcome]) -> list[str]:
    """Lines of the table of counts."""
    lines = ["| right | cases | " + " | ".join(KINDS[:-1]) + " |", "|---" * (len(KINDS) + 1) + "|"]
    for right in sorted({o.right for o in found}):
        rows = [o for o in found if o.right == right]
        kinds = Counter(o.kind for o in rows)
        lines.append(f"| {right} | {len(rows)} | " + " | ".join(str(kinds[k]) for k in KINDS[:-1]) + " |")
    kinds = Counter(o.kind for o in found)
    return [*lines, f"| all | {len(found)} | " + " | ".join(str(kinds[k]) for k in KINDS[:-1]) + " |"]


def of_meshes(home: Path) -> list[str]:
    """Lines of the table of sheets and quads: mrad rms to the law by the independent trace."""
    lines = [
        "| sheet | " + " | ".join(f"{q} quads" for q in meshes.QUADS) + " |",
        "|---" * (len(meshes.QUADS) + 1) + "|",
    ]
    wrong = out = 0
    for name in sheets.EVERY:
        cells = []
        for quads in meshes.QUADS:
            row = meshes.judged(sheets.sheet(name), quads, home / "made")
            print(name, row, flush=True)
            mark = "left out" if row.left_out else row.worst if row.used > 1.0 else "master"
            wrong, out = wrong + (not row.agrees), out + row.left_out
            cells.append(f"{1e3 * row.rms:.3g}, {mark}" + ("" if row.agrees else f" **said {row.word}**"))
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return [f"{len(sheets.EVERY) * len(meshes.QUADS)} meshes, {wrong} wrong, {out} left out.", "", *lines]


def main() -> None:
    """Run and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--into", type=Path, required=True)
    parser.add_argument("--meshes", action="store_true")
    asked = parser.parse_args()
    only_files(pytest.MonkeyPatch())
    began, wall = cpu(), time.monotonic()
    with tempfile.TemporaryDirectory() as place:
        found = bench(Path(place))
        used, passed = cpu() - began, time.monotonic() - wall
        wrong = [f"* {o}" for o in found if o.kind != "right"]
        text = [
            "# Verdicts against what is optically right", "",
            f"Made by `python tests/benchmarks/verdicts.py`. {len(found)} cases: {used:.0f} CPU seconds, {passed:.0f} s on a "
            "machine shared with other work, of which judging the files is "
            f"{sum(o.seconds for o in found):.0f} CPU seconds of the process itself.", "",
            *by_right(found), "", *wrong, "",
        ]  # fmt: skip
        if asked.meshes:
            text += [
                "## Meshes", "",
                "Bare STL judged as a master; mrad rms to the law by the independent trace of its triangles, and what keeps "
                "it from being a master.", "", *of_meshes(Path(place)), "",
            ]  # fmt: skip
    asked.into.write_text("\n".join(text))


if __name__ == "__main__":
    main()
