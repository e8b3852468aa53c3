"""Steps of any height between lenslets: every tilt from 1e-9 to 20 degrees, built, written, read back.

`python tests/benchmarks/step_sweep.py --both --into tests/benchmarks/step.md` writes the table: seven families whose
cells touch, and six with land (seams, webs, rims in webs, a border), each with and without parameter curves.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(Path(__file__).parent)]

from brepwindows import SWEEPS, biconvex  # noqa: E402
from meshwindows import window as sheet  # noqa: E402
from step_table import replace_between  # noqa: E402

from clacad.sheet.window import Window  # noqa: E402

MARKS = ("<!-- sweep -->", "<!-- end of sweep -->")
HEAD = ("| family | parameter curves | tilts or turns | valid as built | valid as read back | same faces "
        "| walls | of them ruled | pieces merged | largest shift, nm |\n|---|---|---|---|---|---|---|---|---|---|\n")  # fmt: skip

ISLANDS: dict[str, Any] = {"pitch": 5e-4, "seam": 4e-5}
WITH_LAND: dict[str, Callable[[float], dict[str, Any]]] = {
    "seam and web": lambda angle: {**ISLANDS, "web": 2e-5, "euler": (33.0, angle, 0.0)},
    "seam and web, turn": lambda angle: {**ISLANDS, "web": 2e-5, "euler": (angle, 0.0, 0.0)},
    "hexagonal, seam and web": lambda angle: {
        **ISLANDS, "web": 2e-5, "euler": (20.0, angle, 0.0), "kind": "hexagonal",
    },
    "seam, plano": lambda angle: {**ISLANDS, "form": "plano", "euler": (33.0, angle, 0.0)},
    "rims in a web": lambda angle: {"pitch": 5e-4, "thickness": 6e-5, "web": 3e-5, "euler": (33.0, angle, 0.0)},
    "border": lambda angle: {"pitch": 5e-4, "border": 2e-4, "web": 2e-5, "euler": (33.0, angle, 0.0)},
}  # fmt: skip


def member(family: str, angle: float) -> Window:
    """Lens 2 of the pair, 2 × 3 cells (2 × 2 with land)."""
    if family in WITH_LAND:
        pair = sheet(count=(2, 2), **WITH_LAND[family](angle))
    else:
        pair = biconvex(thickness=0.25, count=(2, 3), **SWEEPS[family](angle))
    return replace(pair, bodies=pair.bodies[1:])


def swept(family: str, number: int, pcurves: bool) -> str:
    """One line of the table: a family at `number` angles."""
    from clacad.formats.step.step_files import read_step, write_step
    from clacad.solid.occ_writer import OccWriter, is_valid
    from clacad.solid.solids import describe_body

    built = read = same = walls = ruled = merged = 0
    shift = 0.0
    for angle in np.geomspace(1e-9, 20.0, number):
        window = member(family, float(angle))
        writer = OccWriter()
        shells = describe_body(window, window.bodies[0], writer)
        built += all(is_valid(writer.solid(faces)) for faces in shells.pieces())
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "x.step"
            facts = write_step(window, path, mode="fused", pcurves=pcurves)
            found = read_step(path)
            text = path.read_text()
        read += bool(found["valid"])
        same += (found["kernel_solids"], found["kernel_faces"]) == (facts["solids"], facts["faces"])
        walls += sum(text.count(f"ADVANCED_FACE('{role}'") for role in ("wall", "side"))
        ruled += text.count("B_SPLINE_SURFACE(2,1,")
        merged += facts["merged_steps"]
        shift = max(shift, facts["largest_shift"])
    return (f"| {family} | {'written' if pcurves else 'left out'} | {number} | {built} | {read} | {same} | {walls} | {ruled} "
            f"| {merged} | {1e6 * shift:.2g} |\n")  # fmt: skip


def main() -> None:
    """Print the table, or write it into a file between its marks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--number", type=int, default=64, help="angles per family")
    parser.add_argument("--families", nargs="+", default=[*SWEEPS, *WITH_LAND])
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
