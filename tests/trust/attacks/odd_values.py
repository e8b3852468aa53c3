"""Every key of a design with every odd value: what the reader, the judge and the forecast make of it.

python tests/trust/attacks/odd_values.py [SHARE [SEED]]      prints counts, processor seconds, and what went wrong
"""

from __future__ import annotations

import copy
import io
import json
import math
import random
import sys
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[3]
if __name__ == "__main__":
    sys.path[:0] = [str(ROOT)]

from clacad.cli import main  # noqa: E402
from clacad.design.sections import ROOT as TOP  # noqa: E402
from clacad.design.sections import SECTIONS  # noqa: E402

BASES: dict[str, dict[str, Any]] = {
    "slab": {
        "format": 1, "name": "tiny", "unit": "mm", "law": {"eta": [-0.5, -1.0], "delta": [0.01, -0.02]},
        "pair": {"form": "slab", "separation": 10.0, "material": "PMMA"}, "lattice": {"pitch": 0.5, "count": [2, 2]},
    },
    "plano": {
        "format": 1, "name": "tiny", "unit": "mm", "law": {"eta": [-0.5, -1.0]},
        "pair": {"form": "plano", "separation": 10.0, "thickness": [1.5, 1.5], "material": "PMMA"},
        "lattice": {"pitch": 0.5, "count": [3, 2]},
    },
    "biconvex": {
        "format": 1, "name": "tiny", "unit": "m", "law": {"eta": [-0.25, -1.0]},
        "pair": {"form": "biconvex", "separation": 0.05, "index": 1.5}, "lattice": {"pitch": 0.005, "count": [2, 2]},
    },
    "tilted": {
        "format": 1, "name": "tiny", "unit": "mm", "law": {"eta": [-0.5, -0.8], "euler": [30, 3, 10]},
        "pair": {"form": "slab", "separation": 10.0, "material": "PMMA"},
        "lattice": {"kind": "hexagonal", "pitch": 0.5, "count": [7, 7], "seam": 0.02, "outline": {"circle": 3.0}},
        "body": {"border": 0.3},
    },
}  # fmt: skip
"""One design of every form, and one with all that makes land."""

NUMBERS: list[Any] = [
    0, -0.0, 5e-324, 1e-300, 1e-30, 1e-12, 1e-7, 1e-3, 0.1, 0.5, 1, 1.5, 2, 10, 89, 90, 100, 1e6, 1e9, 1e12, 1e30, 1e154,
    1.7976931348623157e308, -1, -0.5, -5e-324, -1e308, math.nan, math.inf, -math.inf, 2**31, 2**53 + 1, 2**64, 10**30, 10**400,
    True, False,
]  # fmt: skip
TEXTS: list[Any] = [
    "", "0", "auto", "none", "centred", "-1 mm", "5e-324 mm", "1e308 m", "1e-300 nm", "1 mm", "10 deg", "89 deg", "90 deg",
    "1e-300 deg", "1e308 deg", "0.5 mrad", "50 %", "nan", "inf mm", "1e999 mm", "1 furlong", "\u00b5", "\0", "\x1b[31m", "\u202e",
    "a" * 100_000, "=1+1", "<b>", "slab", "plano", "biconvex", "hexagonal", "opaque", "best", "thin", "biconic", "inside", "moving",
]  # fmt: skip
NESTED: list[Any] = [
    [], [1], [1, 1], [0.5, 0.5], [5e-324, 5e-324], [1e308, 1e308], [1, -1], [0, 0], [1e-300, 1], [1, 1, 1], [0, 89, 0], [0, 45, 90],
    [math.nan, 1], ["1 mm", "2 mm"], [[1, 1], [1, 1]], list(range(100_000)), {}, {"circle": 5e-324}, {"circle": 1e300},
    {"rectangle": [1, 1]}, {"rectangle": [1e-300, 1e300]}, {"width": 1}, {"width": 1e300, "height": 1e300}, {"a": {"b": 1}},
    [{}], [{"code": "CL311", "reason": "x"}], None,
]  # fmt: skip
VALUES = NUMBERS + TEXTS + NESTED
ANSWERS = {0, 1, 2, 3}
PATIENCE = 60.0
"""Processor seconds in which any of these designs is judged."""


@dataclass
class Tally:
    """How designs were answered.

    statuses : counts by command and status
    faults : sentences, each a design and what was wrong with its answer
    seconds : processor seconds
    """

    statuses: Counter[tuple[str, int]] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)
    seconds: float = 0.0

    def __str__(self) -> str:
        counts = ", ".join(
            f"{command} {status}: {n}" for (command, status), n in sorted(self.statuses.items())
        )
        return f"{sum(self.statuses.values())} answers in {self.seconds:.0f} processor seconds ({counts}), {len(self.faults)} faults"


def cases(share: float, seed: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """A share of all designs, drawn with a seed: what each is called, and its keys."""
    chance = random.Random(seed)
    for base, whole in BASES.items():
        for section, keys in (("", TOP), *SECTIONS.items()):
            for key in keys:
                for value in VALUES:
                    if chance.random() < share:
                        data = copy.deepcopy(whole)
                        (data.setdefault(section, {}) if section else data)[key] = value
                        yield f"{base} {section}.{key} = {value!r:.60}", data


def answered(words: list[str]) -> tuple[int, str]:
    """Status of a command, and what is wrong with its answer ("" for nothing)."""
    out, err = io.StringIO(), io.StringIO()
    begun = time.process_time()
    with warnings.catch_warnings(record=True) as warned, redirect_stdout(out), redirect_stderr(err):
        warnings.simplefilter("always")
        status = main(words)
    faults = [
        "no status of a design" if status not in ANSWERS else "",
        "a traceback" if "Traceback" in err.getvalue() else "",
        f"warned: {warned[0].message}" if any(issubclass(w.category, RuntimeWarning) for w in warned) else "",
        "no word" if status and not err.getvalue().strip() and not out.getvalue().strip() else "",
        "a line of 1000 characters" if max(map(len, err.getvalue().splitlines()), default=0) > 1000 else "",
        f"{time.process_time() - begun:.0f} s" if time.process_time() - begun > PATIENCE else "",
    ]
    wrong = ", ".join(filter(None, faults))
    return status, f"{wrong}: {err.getvalue()[:200]}" if wrong else ""


def attack(folder: Path, share: float, seed: int) -> Tally:
    """Judge a share of all designs, and forecast the export of valid ones; files go into a folder."""
    tally, begun = Tally(), time.process_time()
    path = folder / "design.json"
    for name, data in cases(share, seed):
        path.write_text(json.dumps(data))
        dry = [
            "export",
            str(path),
            "-o",
            str(folder / "out"),
            "--dry-run",
            "--format",
            "stl,3mf,table",
            "--quads",
            "4",
        ]
        for words in (["check", str(path)], dry):
            status, wrong = answered(words)
            tally.statuses[words[0], status] += 1
            if wrong:
                tally.faults.append(f"{words[0]} {name}: {wrong}")
            if status >= 2:  # it will not be exported either
                break
    tally.seconds = time.process_time() - begun
    return tally


if __name__ == "__main__":
    import tempfile

    asked = [*sys.argv[1:], *("0.01", "0")[len(sys.argv) - 1 :]]
    with tempfile.TemporaryDirectory() as place:
        found = attack(Path(place), float(asked[0]), int(asked[1]))
    sys.stdout.write("\n".join([*found.faults, str(found)]) + "\n")
