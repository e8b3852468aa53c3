"""Random valid designs, exported and verified: prints each that fails, and how many did.

    python tests/benchmarks/soak_designs.py                10 designs
    python tests/benchmarks/soak_designs.py -n 500         the soak of a release
    python tests/benchmarks/soak_designs.py --only 17      one of them again, its design file printed
    python tests/benchmarks/soak_designs.py --step         STEP too (about two seconds a design)

A design that the reader or the prescription refuses with a DesignError, or the export by a limit, is no failure:
its sentence is counted. A failure is anything else: another exception, or a file check that does not pass. Checks
of the design itself (its law, its edges) may fail: a random design need not be a good one.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from clacad.design import Design, DesignError
from clacad.export import LimitRefused, export
from clacad.verify import verify

MESHES = ("stl", "3mf", "table")


def draw(number: int) -> dict[str, Any]:
    """The design of a number: every form, lattice and law, a few lenslets."""
    chance = np.random.default_rng(number)
    form = str(chance.choice(["biconvex", "plano", "slab"]))
    eta = [float(s * chance.uniform(0.25, 2.0)) for s in chance.choice([-1.0, -1.0, -1.0, 1.0], size=2)]
    if form == "slab":
        eta = [-abs(e) for e in eta]
    eta = [e if e < 0 or abs(e - 1.0) > 0.2 else 0.5 for e in eta]
    unit = str(chance.choice(["mm", "m", "um"]))
    pitch = float(10.0 ** chance.uniform(-5.0, -2.0)) / {"mm": 1e-3, "m": 1.0, "um": 1e-6}[unit]
    pair: dict[str, Any] = {"form": form, "separation": pitch * float(chance.uniform(8.0, 40.0))}
    pair |= {"material": "PMMA"} if chance.random() < 0.5 else {"index": float(chance.uniform(1.4, 1.8))}
    if form == "biconvex":
        pair["thickness"] = "auto"
    hexagonal = chance.random() < 0.2
    if hexagonal:
        eta = [eta[0], eta[0]]
    lattice: dict[str, Any] = {
        "kind": "hexagonal" if hexagonal else "square", "pitch": pitch, "count": [int(n) for n in chance.integers(1, 5, size=2)],
    }  # fmt: skip
    if chance.random() < 0.25:
        lattice |= {"seam": float(pitch * chance.uniform(0.02, 0.1))}
    law: dict[str, Any] = {"eta": eta}
    if chance.random() < 0.5:
        law["delta"] = [float(d) for d in chance.uniform(-0.02, 0.02, size=2)]
    if chance.random() < 0.4:
        law["euler"] = [
            float(chance.uniform(-180, 180)),
            float(chance.uniform(0, 1)),
            float(chance.uniform(-180, 180)),
        ]
    return {
        "format": 1, "name": f"soak-{number}", "unit": unit, "law": law, "pair": pair,
        "lattice": lattice,
    }  # fmt: skip


def judge(number: int, folder: Path, formats: tuple[str, ...]) -> tuple[str, str]:
    """Export and verify one; "passed", "refused" or "FAILED", and why."""
    try:
        design = Design.from_dict(draw(number))
        export(design, folder, formats=formats, quads=8)
        report = verify(design, folder, rays=4096)
    except (DesignError, LimitRefused) as refusal:
        return "refused", str(refusal).strip().splitlines()[0]
    except Exception as error:  # whatever it is: that it is no refusal is the finding
        return "FAILED", f"{type(error).__name__}: {str(error)[:300]}"
    bad = [c for c in report.checks if c.where == "file" and c.required and c.state in ("fail", "not run")]
    return ("FAILED", "; ".join(f"{c.id}: {c.sentence}" for c in bad)[:300]) if bad else ("passed", "")


def main() -> int:
    """Run the soak; exit 1 if a design fails."""
    parser = argparse.ArgumentParser(description="Export and verify random designs.")
    parser.add_argument("-n", type=int, default=10, help="how many")
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    parser.add_argument("--only", type=int, help="one number")
    parser.add_argument("--step", action="store_true", help="STEP too")
    asked = parser.parse_args()
    numbers = range(asked.first, asked.first + asked.n) if asked.only is None else [asked.only]
    formats = ("step", *MESHES) if asked.step else MESHES
    tally: Counter[str] = Counter()
    began = time.monotonic()
    for number in numbers:
        with tempfile.TemporaryDirectory() as folder:
            verdict, why = judge(number, Path(folder), formats)
        tally[verdict] += 1
        if verdict != "passed":
            sys.stdout.write(f"{number}: {verdict}: {why}\n")
        if asked.only is not None:
            sys.stdout.write(f"{draw(number)}\n")
    counts = ", ".join(f"{count} {verdict}" for verdict, count in sorted(tally.items()))
    sys.stdout.write(f"{len(numbers)} designs: {counts}; {time.monotonic() - began:.0f} s\n")
    return 1 if tally["FAILED"] else 0


if __name__ == "__main__":
    sys.exit(main())
