"""Random valid designs, exported and verified: prints each that fails, and keeps count in a record.

    python tests/benchmarks/soak_designs.py                      10 designs
    python tests/benchmarks/soak_designs.py -n 500 --record      the soak of a release, into tests/trust/soak.json
    python tests/benchmarks/soak_designs.py --again --record     those of the record that failed, once more
    python tests/benchmarks/soak_designs.py --only 17            one of them again, its design printed

With `--record` it goes on where the record ends, so it can be run in pieces (`--seconds 600`). A design that the
reader or the prescription refuses with a DesignError, or the export by a limit, is not valid: its code is counted,
it does not count towards `-n`. A failure is anything else: another exception, or a check of a file that does not
pass. Checks of the design itself (its law, its edges) may fail: a random design need not be a good one.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import json
import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from clacad import __version__
from clacad.checks.file_kinds import CONVERGENCE
from clacad.design import Design, DesignError
from clacad.exporting.run import LimitRefused, export
from clacad.verification import verify

RECORD = Path(__file__).parents[1] / "trust" / "soak.json"
INDEXED = ("3mf", "ply", "glb")
FULL_EVERY = 8
"""One design in this many is written as exact solids too (the kernel takes seconds) and judged by every check;
the others by the checks of files and of the traced light, without the curves and the convergence of the design."""
METRES = {"mm": 1e-3, "m": 1.0, "um": 1e-6, "in": 0.0254}


def draw(number: int) -> dict[str, Any]:
    """The design of a number: every form, recipe, lattice and law, few lenslets."""
    chance = np.random.default_rng(number)
    form = str(chance.choice(["biconvex", "plano", "slab"]))
    hexagonal = chance.random() < 0.2
    unit = str(chance.choice(list(METRES)))
    pitch = float(10.0 ** chance.uniform(-5.0, -2.0)) / METRES[unit]
    law: dict[str, Any] = {"eta": _eta(chance, form, hexagonal)}
    if chance.random() < 0.5:
        law["delta"] = [float(d) for d in chance.uniform(-0.02, 0.02, size=2)]
    if chance.random() < 0.4:
        law["euler"] = [float(a) for a in chance.uniform([-180.0, 0.0, -180.0], [180.0, 1.0, 180.0])]
    pair: dict[str, Any] = {"form": form, "separation": pitch * float(chance.uniform(8.0, 40.0))}
    pair |= {"material": "PMMA"} if chance.random() < 0.5 else {"index": float(chance.uniform(1.4, 1.8))}
    if chance.random() < 0.2:
        pair["confocal"] = str(chance.choice(["exact", "thin"]))
    if form == "biconvex":
        pair["thickness"] = "auto"
    if form == "plano" and chance.random() < 0.3:
        pair["curved"] = "inside"
    count = [int(n) for n in chance.integers(1, 5, size=2)]
    lattice: dict[str, Any] = {"kind": "hexagonal" if hexagonal else "square", "pitch": pitch, "count": count}
    if not hexagonal and chance.random() < 0.25:
        lattice |= {"kind": "rectangular", "pitch": [pitch, pitch * float(chance.uniform(0.6, 1.6))]}
    if chance.random() < 0.25:
        lattice["seam"] = float(pitch * chance.uniform(0.02, 0.1))
    if chance.random() < 0.1:
        lattice |= {"count": [7, 7], "outline": {"circle": 5.0 * pitch}}
    design = {
        "format": 1,
        "name": f"soak-{number}",
        "unit": unit,
        "law": law,
        "pair": pair,
        "lattice": lattice,
    }
    if chance.random() < 0.2:
        design["body"] = {"border": float(pitch * chance.uniform(0.2, 1.5))}
    return design


def _eta(chance: np.random.Generator, form: str, hexagonal: bool) -> list[float]:
    """Kepler pairs mostly; a slab has no others, and a hexagonal lattice takes round lenses."""
    eta = [float(s * chance.uniform(0.25, 2.0)) for s in chance.choice([-1.0, -1.0, -1.0, 1.0], size=2)]
    eta = [e if e < 0 or abs(e - 1.0) > 0.2 else 0.5 for e in eta]
    eta = [-abs(e) for e in eta] if form == "slab" else eta
    return [eta[0], eta[0]] if hexagonal else eta


def formats_of(number: int) -> tuple[str, ...]:
    """Triangles in two formats, the table, and now and then the exact solids."""
    return ("stl", INDEXED[number % 3], "table", *(("step",) if number % FULL_EVERY == 0 else ()))


@contextlib.contextmanager
def without_curves() -> Iterator[None]:
    """Leave out the checks of `verify` that trace the design many more times and do not depend on the files."""
    run = importlib.import_module("clacad.verification.run")
    nothing = (None, CONVERGENCE.not_run("left out", required=False))
    convergence = importlib.import_module("clacad.verification.light.facet_convergence")
    with (
        mock.patch.object(run, "meridians", return_value=()),
        mock.patch.object(convergence, "judge_convergence", return_value=nothing),
    ):
        yield


def judge(number: int, folder: Path) -> tuple[str, str]:
    """Export and verify one; "passed", "refused" or "failed", and why."""
    try:
        design = Design.from_dict(draw(number))
        export(design, folder, formats=formats_of(number), quads=8)
        with contextlib.nullcontext() if number % FULL_EVERY == 0 else without_curves():
            report = verify(
                design, folder, rays=16384, role={"stl": "preview", INDEXED[number % 3]: "preview"}
            )
    except LimitRefused as refusal:
        return "refused", str(refusal).strip().splitlines()[0]
    except DesignError as refusal:
        codes = sorted(set(re.findall(r"CL\d{3}", str(refusal)))) or ["no code"]
        return "refused", ", ".join(codes)
    except Exception as error:  # any exception that is no refusal is a finding
        return "failed", f"{type(error).__name__}: {str(error)[:300]}"
    bad = [c for c in report.checks if c.where == "file" and c.required and c.state in ("fail", "not run")]
    return ("failed", "; ".join(f"{c.id}: {c.sentence}" for c in bad)[:400]) if bad else ("passed", "")


@dataclass
class Tally:
    """What a soak has found so far; `next` is the number of the design to come."""

    next: int = 0
    passed: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    failed: dict[str, str] = field(default_factory=dict)
    formats: Counter[str] = field(default_factory=Counter)
    processor_seconds: float = 0.0

    @property
    def valid(self) -> int:
        return self.passed + len(self.failed)

    def add(self, verdict: str, why: str, seconds: float) -> None:
        """Count one design."""
        if verdict == "refused":
            self.refused[why] += 1
        else:
            self.formats.update(formats_of(self.next))
            self.passed += verdict == "passed"
        if verdict == "failed":
            self.failed[str(self.next)] = why
        self.next += 1
        self.processor_seconds += seconds

    def again(self, number: int, verdict: str, why: str) -> None:
        """Count one that failed as it is judged now."""
        del self.failed[str(number)]
        if verdict == "refused":
            self.refused[why] += 1
            self.formats.subtract(formats_of(number))
        elif verdict == "failed":
            self.failed[str(number)] = why
        self.passed += verdict == "passed"

    def text(self) -> str:
        """The record."""
        document = vars(self) | {"clacad": __version__, "valid": self.valid}
        document["processor_seconds"] = round(self.processor_seconds, 1)
        return json.dumps(document, indent=1, sort_keys=True) + "\n"

    @staticmethod
    def read(path: Path) -> Tally:
        """A record again; a new one where there is none."""
        if not path.exists():
            return Tally()
        kept = json.loads(path.read_text())
        return Tally(
            kept["next"], kept["passed"], Counter(kept["refused"]), kept["failed"], Counter(kept["formats"]),
            kept["processor_seconds"],
        )  # fmt: skip


def _used() -> float:
    import resource

    each = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in each)


def soak(tally: Tally, valid: int, seconds: float, record: Path | None) -> None:
    """Continue until the given number of valid designs was judged, or the seconds are over."""
    end = time.monotonic() + seconds
    while tally.valid < valid and time.monotonic() < end:
        began = _used()
        with tempfile.TemporaryDirectory() as folder:
            verdict, why = judge(tally.next, Path(folder))
        if verdict == "failed":
            sys.stdout.write(f"{tally.next}: {verdict}: {why}\n")
            sys.stdout.flush()
        tally.add(verdict, why, _used() - began)
        if record is not None:
            record.write_text(tally.text())


def recheck(tally: Tally) -> None:
    """Judge the failed ones of a record again."""
    for number in [int(key) for key in tally.failed]:
        with tempfile.TemporaryDirectory() as folder:
            verdict, why = judge(number, Path(folder))
        sys.stdout.write(f"{number}: {verdict} {why}\n")
        tally.again(number, verdict, why)


def main() -> int:
    """Run the soak; exit 1 if a design fails."""
    parser = argparse.ArgumentParser(description="Export and verify random designs.")
    parser.add_argument("-n", type=int, default=10, help="how many valid designs")
    parser.add_argument(
        "--record", type=Path, nargs="?", const=RECORD, help="keep count here, go on from there"
    )
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after this time")
    parser.add_argument("--again", action="store_true", help="judge the failed ones of the record again")
    parser.add_argument("--only", type=int, help="one number")
    asked = parser.parse_args()
    if asked.only is not None:
        with tempfile.TemporaryDirectory() as folder:
            verdict, why = judge(asked.only, Path(folder))
        sys.stdout.write(f"{draw(asked.only)}\n{verdict} {why}\n")
        return int(verdict == "failed")
    tally = Tally() if asked.record is None else Tally.read(asked.record)
    if asked.again:
        recheck(tally)
    else:
        soak(tally, asked.n, asked.seconds, asked.record)
    if asked.record is not None:
        asked.record.write_text(tally.text())
    sys.stdout.write(tally.text())
    return 1 if tally.failed else 0


if __name__ == "__main__":
    sys.exit(main())
