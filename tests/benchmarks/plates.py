"""Cost of six faces compared with two: verify of a master per facet, and the trace per ray.

    python tests/benchmarks/plates.py [plates.md]

A slab has two faces, the starter three-plates-10deg has six. Both are measured in turns in one run, by processor time,
so that a busy machine slows both; the ratio is that of the least times. Targets: verify at most 2 times per facet, trace
at most 3 times per ray. With a file name the table is written there.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable
from pathlib import Path

import clacad
from clacad.base.types import silent
from clacad.design import Design, template
from clacad.optics.rays import Rays
from clacad.sheet.bundle import bundle

KINDS = {"slab": 2, "three-plates-10deg": 6}
"""Template and its faces."""

CELLS, QUADS, ROUNDS, RAYS = 6, 16, 2, 100_000
VERIFY, TRACE = 2.0, 3.0
"""Largest ratios."""


def design_of(kind: str) -> Design:
    """Template of a kind with few cells."""
    return Design.from_dict(tomllib.loads(template(kind, kind))).with_cells((CELLS, CELLS))


def spent(work: Callable[[], object]) -> float:
    """Processor seconds of the work, on all cores."""
    before = os.times()
    work()
    after = os.times()
    return after.user - before.user + after.children_user - before.children_user


def facets_of(folder: Path) -> int:
    """Facets in the files of an export."""
    files = json.loads((folder / "manifest.json").read_text())["files"]
    return sum(one.get("facets") or one.get("facts", {}).get("facets", 0) for one in files)


def verified(folder: Path) -> dict[str, tuple[float, int]]:
    """Least seconds of verify and facets of each kind."""
    folders = {}
    for kind in KINDS:
        folders[kind] = folder / kind
        clacad.export(design_of(kind), folders[kind], formats=("stl",), quads=QUADS)
    least = dict.fromkeys(KINDS, float("inf"))
    for _ in range(ROUNDS):
        for kind in KINDS:
            design, files = design_of(kind), folders[kind]
            both = spent(
                lambda design=design, files=files: clacad.verify(design, files, rays=4096, progress=silent)
            )
            alone = spent(lambda design=design: clacad.verify(design, rays=4096, progress=silent))
            least[kind] = min(least[kind], both - alone)
    return {kind: (least[kind], facets_of(folders[kind])) for kind in KINDS}


def traced() -> dict[str, float]:
    """Least seconds a ray of each kind, one thread of compiled code, light along the normal."""
    least = dict.fromkeys(KINDS, float("inf"))
    lit: dict[str, tuple[clacad.Window, Rays]] = {}
    for kind in KINDS:
        window = clacad.prescribe(design_of(kind))
        lit[kind] = window, bundle(window, RAYS, 0.02).rays
        clacad.trace(*lit[kind], path="numba", threads=1)
    for _ in range(3 * ROUNDS):
        for kind in KINDS:
            start = time.process_time()
            clacad.trace(*lit[kind], path="numba", threads=1)
            least[kind] = min(least[kind], time.process_time() - start)
    return {kind: seconds / RAYS for kind, seconds in least.items()}


def main(into: str = "") -> int:
    """Measure, print and write; 1 where a ratio is beyond its target."""
    rays = traced()
    print(rays)
    with tempfile.TemporaryDirectory() as folder:
        files = verified(Path(folder))
    few, many = KINDS
    per_facet = {kind: seconds / facets for kind, (seconds, facets) in files.items()}
    ratios = (per_facet[many] / per_facet[few], rays[many] / rays[few])
    lines = [
        "| design | faces | facets | verify of files, s | µs a facet | trace, ns a ray |",
        "|---|---|---|---|---|---|",
        *(
            f"| {kind} | {faces} | {files[kind][1]:,} | {files[kind][0]:.2f} | {1e6 * per_facet[kind]:.2f} |"
            f" {1e9 * rays[kind]:.0f} |"
            for kind, faces in KINDS.items()
        ),
        f"| ratio | 3 | {files[many][1] / files[few][1]:.2f} | {files[many][0] / files[few][0]:.2f} |"
        f" {ratios[0]:.2f} (at most {VERIFY:g}) | {ratios[1]:.2f} (at most {TRACE:g}) |",
    ]
    text = "\n".join(lines) + "\n"
    print(text)
    if into:
        Path(into).write_text(f"{__doc__}\n{text}", encoding="utf-8")
    return int(ratios[0] > VERIFY or ratios[1] > TRACE)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:2]))
