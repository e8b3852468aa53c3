"""Cost of six faces compared with two, and of white light compared with one line.

    python tests/benchmarks/plates.py [plates.md]

A slab of ellipsoids has two faces, the starter three-plates-10deg has six; all are conics of revolution, which the
kernels intersect in closed form (biconic faces, those of the slab template, are solved by Newton steps and take five times
as long). Both are traced by compiled code that has run before, with the same rays over cells of the same pitch, in turns
in one run, by processor time, so that a busy machine slows both; the ratio is that of the least times. Targets: verify at
most 2 times per facet, trace at most 3 times per ray. The lines F e d C through `window-100mm`, a million rays, cost at
most 4 times one line, once as calls of their own and once by one pass for all. With a file name the table is written there.
"""

from __future__ import annotations

import os
import statistics
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
from clacad.tracing.trace import SheetTracer

KINDS = {"slab": 2, "three-plates-10deg": 6}
"""Template and its faces."""

ROUND = {"slab": {"pair.surface": "ellipsoid", "pair.wavelength": "546.1 nm"}, "three-plates-10deg": {}}
"""Changes of a template that make all faces conics of revolution."""

CELLS, QUADS, ROUNDS, RAYS = 6, 16, 2, 100_000
VERIFY, TRACE, WHITE = 2.0, 3.0, 4.0
"""Largest ratios."""

LINES = (486.1e-9, 546.1e-9, 587.6e-9, 656.3e-9)
"""F e d C, metres."""


def design_of(kind: str) -> Design:
    """Template of a kind with few cells."""
    made = Design.from_dict(tomllib.loads(template(kind, kind))).with_cells((CELLS, CELLS))
    return made.replace(ROUND[kind])


def spent(work: Callable[[], object]) -> float:
    """Processor seconds of the work, on all cores."""
    before = os.times()
    work()
    after = os.times()
    return after.user - before.user + after.children_user - before.children_user


def facets_of(folder: Path) -> int:
    """Facets in the binary STL files of an export: 50 bytes each after a head of 84."""
    return sum((one.stat().st_size - 84) // 50 for one in folder.glob("*.stl"))


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
    windows = {kind: clacad.prescribe(design_of(kind)) for kind in KINDS}
    assert all(isinstance(face.surface, clacad.Quadric) for one in windows.values() for face in one.faces)
    rays = bundle(windows["slab"], RAYS, 0.005).rays
    starts = {kind: rays.position + [0.0, 0.0, one.z_range[0]] for kind, one in windows.items()}
    for _ in range(3 * ROUNDS):
        for kind, window in windows.items():
            lit = Rays(starts[kind], rays.direction)
            clacad.trace(window, lit, path="numba", threads=1)  # caches and kernels warm
            start = time.process_time()
            clacad.trace(window, lit, path="numba", threads=1)
            least[kind] = min(least[kind], time.process_time() - start)
    return {kind: seconds / RAYS for kind, seconds in least.items()}


def white() -> tuple[float, float]:
    """Median cost of four lines over that of one, traced one by one and at once; one thread, in turns."""
    design = clacad.load("window-100mm").with_cells((20, 20))
    rays = bundle(clacad.prescribe(design), 1_000_000, design.check.field).rays
    tracer = SheetTracer(clacad.prescribe(design), path="numba", threads=1)
    lit = [Rays(rays.position, rays.direction, wave) for wave in LINES]
    works = (
        lambda: tracer(lit[0]),
        lambda: [len(tracer(one)) for one in lit],
        lambda: [None for _ in tracer.in_lines(rays, LINES)],
    )
    seconds = []
    for _ in range(4 * ROUNDS):
        seconds.append([])
        for work in works:
            start = time.process_time()
            work()
            seconds[-1].append(time.process_time() - start)
    one, each, together = zip(*seconds[1:], strict=True)  # the first round loads kernels
    return tuple(statistics.median(a / b for a, b in zip(several, one)) for several in (each, together))


def main(into: str = "") -> int:
    """Measure, print and write; 1 where a ratio is beyond its target."""
    rays, (each, together) = traced(), white()
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
        "",
        f"White light: four lines one by one take {each:.2f} times one line,"
        f" at once {together:.2f} (at most {WHITE:g}).",
    ]
    text = "\n".join(lines) + "\n"
    print(text)
    if into:
        Path(into).write_text(f"{__doc__}\n{text}", encoding="utf-8")
    return int(ratios[0] > VERIFY or ratios[1] > TRACE or together > WHITE)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:2]))
