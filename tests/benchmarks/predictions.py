"""Verdicts of `verify` forecast by `check`, compared with `verify`: random designs, and the STEP made from each as a master.

    python tests/benchmarks/predictions.py -n 200               the designs alone
    python tests/benchmarks/predictions.py -n 200 --step        those of the record, their STEP masters, too
    python tests/benchmarks/predictions.py --table              writes predictions.md from the record

Designs are those of `soak_designs.py`, by number. It goes on where the record (`predictions.json`) ends, so it can be run in
pieces (`--seconds 600`). What the reader or the prescription refuses both refuse: it is counted, and no more. A verdict is
near where a check that decides it lies within 5 % of its limit; elsewhere the two must not differ, or it exits with 1.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from soak_designs import draw, without_curves

from clacad.advice import judge
from clacad.checks.check import Check, wrong
from clacad.design import Design, DesignError
from clacad.exporting.run import ExportError, export
from clacad.topology.complex_parts import CannotBuild
from clacad.verification import verify

RECORD = Path(__file__).with_name("predictions.json")
TABLE = RECORD.with_suffix(".md")
BAND = 0.05
"""Part of a limit within which a forecast check may differ from the verified one."""


def compare(number: int) -> dict[str, Any]:
    """Both verdicts of a design, and how far what they measure is apart."""
    try:
        design = Design.from_dict(draw(number))
        began = time.process_time()
        judged = judge(design)
        seconds = time.process_time() - began
    except DesignError as refusal:
        return {"refused": str(refusal).split("\n")[0][:120]}
    began = time.process_time()
    with without_curves():
        report = verify(design)
    mine, theirs = ({(c.id, c.subject): c for c in checks} for checks in (judged.checks, report.checks))
    apart = max((_apart(mine[key], theirs[key]) for key in mine), default=("", 0.0), key=lambda one: one[1])
    return {
        "check": judged.passes, "verify": report.passed, "states": [key[0] for key in mine if mine[key].state != theirs[key].state],
        "near": near(mine.values(), theirs.values()), "apart": apart, "fails": sorted({c.id for c in wrong(report.checks)}),
        "seconds": [round(seconds, 3), round(time.process_time() - began, 3)],
    }  # fmt: skip


def _apart(mine: Check, theirs: Check) -> tuple[str, float]:
    """Name of a check and how far its two values are apart, in parts of its limit."""
    a, b, limit = mine.value, theirs.value, theirs.limit
    if not (isinstance(a, float) and isinstance(b, float) and isinstance(limit, float)) or not limit:
        return mine.id, 0.0
    return mine.id, abs(a - b) / abs(limit) if abs(limit) != float("inf") else 0.0


def near(*several: Any) -> bool:
    """Whether a check that decides between the verdicts lies within the band about its limit."""
    tables = [{(c.id, c.subject): c for c in checks} for checks in several]
    decide = [key for key in tables[0] if len({bool(wrong([table[key]])) for table in tables}) == 2]
    return bool(decide) and all(any(_within(table[key]) for table in tables) for key in decide)


def _within(check: Check) -> bool:
    if not (isinstance(check.value, float) and isinstance(check.limit, float)):
        return False
    return abs(check.value - check.limit) <= BAND * abs(check.limit)


def of_step(number: int, predicted: Sequence[str]) -> dict[str, Any]:
    """Verdict of `verify` on the STEP made from a design."""
    design = Design.from_dict(draw(number))
    with tempfile.TemporaryDirectory() as folder:
        try:
            export(design, folder, formats=("step",), role="master")
        except (ExportError, CannotBuild, DesignError) as refusal:
            return {"step": "refused", "why": str(refusal).split("\n")[0][:200]}
        with without_curves():
            report = verify(design, folder)
    bad = wrong(report.checks)
    new = [c for c in bad if c.id.removeprefix("file_") not in predicted]
    return {
        "step": report.word,
        "passed": report.passed,
        "fails": sorted({c.id for c in bad}),
        "near_step": all(map(_within, new)),
    }


def run(record: dict[str, Any], valid: int, seconds: float, *, step: bool) -> None:
    """Continue until the given number of valid designs was compared, or the seconds are over."""
    end, number = time.monotonic() + seconds, 0
    while sum("check" in row for row in list(record.values())[:number]) < valid and time.monotonic() < end:
        row = record.setdefault(str(number), {}) or compare(number)
        if step and "check" in row and "step" not in row:
            row |= of_step(number, row["fails"])
        record[str(number)] = row
        number += 1
        RECORD.write_text(json.dumps(record, indent=1) + "\n")


def differing(record: dict[str, Any]) -> list[str]:
    """Numbers of the designs whose verdicts differ though nothing is near."""
    found = []
    for number, row in record.items():
        if "check" not in row:
            continue
        design = row["check"] != row["verify"] and not row["near"]
        master = "passed" in row and row["passed"] != row["check"] and not (row["near"] or row["near_step"])
        found += [number] if design or master else []
    return found


def table(record: dict[str, Any]) -> str:
    """The record as predictions.md."""
    rows = [row for row in record.values() if "check" in row]
    masters = [row for row in rows if "passed" in row]
    seconds = [sum(row["seconds"][k] for row in rows) / len(rows) for k in (0, 1)]
    apart: dict[str, float] = {}
    for row in rows:
        name, far = row["apart"]
        apart[name] = max(far, apart.get(name, 0.0))
    lines = [
        "# Verdicts of check against those of verify", "", "    " + "python tests/benchmarks/predictions.py -n 200 --step", "",
        "Random designs of `soak_designs.py`; check sends 8192 rays over the field and 1024 at each of nine field points, where verify",
        "sends 65536 and 4096.", "", "| | |", "|---|---:|",
        f"| designs judged by both | {len(rows)} |", f"| refused by both | {len(record) - len(rows)} |",
        f"| of those judged, verify fails | {sum(not row['verify'] for row in rows)} |",
        f"| verdicts that differ | {sum(row['check'] != row['verify'] for row in rows)} |",
        f"| … where no check that decides is within {BAND:.0%} of its limit | "
        f"{sum(row['check'] != row['verify'] and not row['near'] for row in rows)} |",
        f"| single checks of another state | {sum(len(row['states']) for row in rows)} |",
        f"| STEP masters verified | {len(masters)} |",
        f"| … whose verdict differs from check's | {sum(row['passed'] != row['check'] for row in masters)} |",
        f"| … outside the band | {len([n for n in differing(record) if 'passed' in record[n]])} |",
        f"| STEP refused by export | {sum(row.get('step') == 'refused' for row in rows)} |",
        f"| processor seconds a design, check / verify without curves | {seconds[0]:.2f} / {seconds[1]:.2f} |",
        "", "Farthest apart of what the two measure, in parts of the limit, the farthest check of each design:", "",
        "| check | at most |", "|---|---:|",
        *(f"| {name} | {far:.2g} |" for name, far in sorted(apart.items(), key=lambda one: -one[1])),
    ]  # fmt: skip
    for number in differing(record):
        lines += ["", f"Design {number} differs: check {record[number]['check']}, STEP {record[number].get('step')}; fails: "
                  f"{', '.join(record[number]['fails'])}."]  # fmt: skip
    return "\n".join(lines) + "\n"


def main() -> int:
    """Compare; exit 1 if a verdict differs outside the band."""
    parser = argparse.ArgumentParser(description="Verdicts of check against verdicts of verify.")
    parser.add_argument("-n", type=int, default=20, help="how many valid designs")
    parser.add_argument("--step", action="store_true", help="their STEP masters, too")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after this time")
    parser.add_argument("--table", action="store_true", help="write predictions.md and compare nothing")
    asked = parser.parse_args()
    record = json.loads(RECORD.read_text()) if RECORD.exists() else {}
    if not asked.table:
        run(record, asked.n, asked.seconds, step=asked.step)
    if asked.table:
        TABLE.write_text(table(record))
    bad = differing(record)
    sys.stdout.write(f"{sum('check' in row for row in record.values())} designs, differing: {bad}\n")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
