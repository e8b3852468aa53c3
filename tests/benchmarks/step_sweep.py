"""Steps of any height between lenslets: every tilt from 1e-9 to 20 degrees, built, written, read back.

`python tests/benchmarks/step_sweep.py --into tests/benchmarks/step.md` writes the table.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(Path(__file__).parent)]

from brepwindows import SWEEPS, biconvex, one_body  # noqa: E402
from step_table import replace_between  # noqa: E402

MARKS = ("<!-- sweep -->", "<!-- end of sweep -->")
HEAD = ("| family | tilts or turns | valid as built | valid as read back | same faces | pieces merged | largest shift, nm |\n"
        "|---|---|---|---|---|---|---|\n")  # fmt: skip


def swept(family: str, number: int, pcurves: bool) -> str:
    """One line of the table: a family at `number` angles, lens 2 of the pair, 2 × 3 cells."""
    from clacad.brep import describe_body
    from clacad.brep.kernel import KernelWriter, is_valid
    from clacad.export.step import read_step, write_step

    built = read = same = merged = 0
    shift = 0.0
    for angle in np.geomspace(1e-9, 20.0, number):
        window = one_body(biconvex(thickness=0.25, count=(2, 3), **SWEEPS[family](float(angle))), 1)
        writer = KernelWriter()
        shells = describe_body(window, window.bodies[0], writer)
        built += all(is_valid(writer.solid(faces)) for faces in shells.pieces())
        with tempfile.TemporaryDirectory() as folder:
            facts = write_step(window, Path(folder) / "x.step", mode="fused", pcurves=pcurves)
            found = read_step(Path(folder) / "x.step")
        read += bool(found["valid"])
        same += (found["kernel_solids"], found["kernel_faces"]) == (facts["solids"], facts["faces"])
        merged += facts["merged_steps"]
        shift = max(shift, facts["largest_shift"])
    name = family if pcurves else f"{family}, no parameter curves"
    return f"| {name} | {number} | {built} | {read} | {same} | {merged} | {1e6 * shift:.2g} |\n"


def main() -> None:
    """Print the table, or write it into a file between its marks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--number", type=int, default=64, help="angles per family")
    parser.add_argument("--families", nargs="+", default=list(SWEEPS))
    parser.add_argument("--both", action="store_true", help="also without parameter curves")
    parser.add_argument("--into", type=Path, help="Markdown file whose table is replaced")
    options = parser.parse_args()
    text = HEAD
    sys.stdout.write(HEAD)
    for pcurves in (True, False) if options.both else (True,):
        for family in options.families:
            line = swept(family, options.number, pcurves)
            text += line
            sys.stdout.write(line)
            sys.stdout.flush()
    if options.into:
        replace_between(options.into, MARKS, text)


if __name__ == "__main__":
    main()
