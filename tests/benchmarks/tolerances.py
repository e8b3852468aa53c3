"""Tolerance studies of some designs: what dominates, what a sheet costs, how linear it is; writes tolerances.md."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

import clacad
from clacad.verification.tolerance import MEASURES, Farm, tolerance

HERE = Path(__file__).parent
STATED = {
    "decentre": "5 um", "rotation": "0.1 mrad", "thickness": "20 um", "tilt": "0.1 mrad", "radius": 0.005,
    "index": 0.0005, "roughness": "10 nm",
}  # fmt: skip
DESIGNS = ("window-100mm", "plano", "galilean", "hexagonal", "tilted-biconvex")
LINEAR = ("shift_x", "shift_y", "power_xx", "power_yy", "slip_yx")


def study(name: str, samples: int) -> tuple[str, str]:
    """One row of each table."""
    design = clacad.load(HERE.parents[1] / "designs" / f"{name}.toml")
    stated = STATED | ({} if design.pair.form == "slab" else {"separation": "20 um"})
    design = design.replace({"tolerances": stated})
    start = time.process_time()
    found = tolerance(design, samples=samples, farm=Farm(1))
    made = 1 + 4 * len(found.parameters) + samples
    cost = 1e3 * (time.process_time() - start) / made
    cells = []
    for measure, factor in (
        ("image_shift", 1e3),
        ("moire_rate", 1e6),
        ("residual_power", 1.0),
        ("blur", 1e3),
    ):
        first, change, share = found.ranking(measure)[0]
        cells.append(f"{first} {factor * change:.3g} ({100 * share:.0f} %)")
    share, low, high = found.yields()
    row = (
        f"| {name} | "
        + " | ".join(cells)
        + f" | {100 * share:.0f} ({100 * low:.0f}–{100 * high:.0f}) | {cost:.0f} |"
    )
    off = []
    for measure in LINEAR:
        at = list(MEASURES).index(measure)
        traced = found.column(measure) - found.nominal[measure]
        linear = found.errors @ found.slopes[:, at]
        scale = float(np.sqrt(np.mean(traced**2)))
        off.append(f"{float(np.sqrt(np.mean((traced - linear) ** 2))) / scale:.1e}" if scale > 0.0 else "–")
    return row, f"| {name} | " + " | ".join(off) + " |"


def main(samples: int = 100) -> None:
    """Make both tables."""
    rows = [study(name, samples) for name in DESIGNS]
    text = [
        "# Tolerance studies", "",
        f"Made by `python tests/benchmarks/tolerances.py {samples}` on a shared machine of two cores, x86-64. Tolerances:",
        ", ".join(f"{k} {v}" for k, v in STATED.items()) + "; separation 20 um where there is one. First contributor of",
        "each measure, its change over the tolerance alone and its share; yield against each design's own limits with its",
        f"95 % interval ({samples} sheets, seed 0); CPU time of a sheet in one process.", "",
        "| design | image shift / mrad | slip / 1e-6 | residual power / D | blur / mrad | yield / % | ms a sheet |",
        "|--|--|--|--|--|--|--|", *(row for row, _ in rows), "",
        "Traced against linear: rms of (traced − sensitivities · errors) over the rms of traced, sheet by sheet.", "",
        f"| design | {' | '.join(LINEAR)} |", "|--|" + "--|" * len(LINEAR), *(row for _, row in rows), "",
        "For tolerances a hundred times smaller the difference is below 5e-3 of the largest (a default test). A run that is",
        "killed twenty times and resumed has the bytes of an unbroken one, and a Dask cluster finds the same tables",
        "(`pytest -m long tests/verification/test_tolerance.py tests/verification/test_sweep.py`).", "",
    ]  # fmt: skip
    (HERE / "tolerances.md").write_text("\n".join(text), encoding="utf-8")
    print("\n".join(text))


if __name__ == "__main__":
    main(*(int(n) for n in sys.argv[1:2]))
