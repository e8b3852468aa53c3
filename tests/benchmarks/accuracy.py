"""What accuracy costs in time, for two shipped designs: writes accuracy.md and the picture in exports/showcase.

python tests/benchmarks/accuracy.py [--rays 100000]
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import clacad
from clacad.cli.accuracy_command import accuracy_text
from clacad.verification.accuracy.accuracy_plot import plot_png
from clacad.verification.accuracy.accuracy_table import AccuracyTable

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
DESIGNS = ("paper-a-covered", "paper-c")
PICTURE = ROOT / "exports" / "showcase" / "accuracy.png"
TARGETS = (5e-2, 5e-4, 5e-7)

HEAD = """# What accuracy costs in time

Made by `python tests/benchmarks/accuracy.py` on {cores} shared x86-64 cores, kernels compiled beforehand; seconds are
processor seconds of the trace alone, best of 3. The same rays go up every rung and setting. Read ratios: rates of
another machine differ, errors do not. `clacad accuracy DESIGN -o plot.png` makes the same for any design.

* **The exact surfaces are the cheapest and the most accurate**: no facet grid is as fast, none as good. A mesh is
  traced to judge a file, not to save time.
* **Facets are of first order, interpolated exact normals of second**: doubling the grid halves the one and quarters
  the other. At 4 quads a cell side vertex normals beat the facets of 128.
* **Finer facets stop paying** where the numbers of the file turn them by more than they err. With lenslets of half a
  millimetre 50 mm from the origin (paper-c) that is at about 40 quads a cell side: the rows of 64 and 128 quads in
  float32 are *worse* than that of 32. The table below gives the optimum and the floor of every export format, forecast
  and traced. A mesh in double precision keeps the mesher's heights, which are steps of float32 at the sheet's greatest
  height, so its facets have nearly the same floor; vertex normals hardly feel it.

![error against seconds, and where it stops paying](../../exports/showcase/accuracy.png)
"""


def section(table: AccuracyTable) -> str:
    """Table of one design, and what targets choose."""
    chosen = []
    for target in TARGETS:
        row = table.cheapest(target)
        meshes = [r for r in table.rows if r.rung == "mesh" and r.model_rms <= target and r.disagree <= 0.01]
        mesh = min(meshes, key=lambda r: r.seconds_per_ray, default=None)
        of_meshes = "none" if mesh is None else mesh.setting
        chosen.append(f"* {1e3 * target:g} mrad: {row.rung} {row.setting}; among meshes: {of_meshes}")
    return "\n".join(
        [f"## {table.design}\n", "```", accuracy_text(table), "```\n", "Cheapest within", "", *chosen, ""]
    )


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--rays", type=int, default=100_000)
    rays = parser.parse_args().rays
    warm = clacad.load(ROOT / "designs" / "slab.toml")
    clacad.accuracy(warm, rays=200, quads=(4,))  # compiles what is not compiled yet
    parts = [HEAD.format(cores=len(os.sched_getaffinity(0)))]
    for name in DESIGNS:
        table = clacad.accuracy(clacad.load(ROOT / "designs" / f"{name}.toml"), rays=rays)
        parts.append(section(table))
        PICTURE.write_bytes(plot_png(table))  # the last one shows both lines crossing
    (HERE / "accuracy.md").write_text("\n".join(parts), encoding="utf-8")


if __name__ == "__main__":
    main()
