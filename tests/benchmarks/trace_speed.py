"""Speed of the tracer against the machine's own floor: python tests/benchmarks/trace_speed.py [rays] [--json].

The floor is a compiled loop that does per ray and surface what no tracer can do without, two square roots and two
divisions, and moves six numbers in and out. Everything runs on one thread, turn by turn with the floor, so that a busy
machine slows both; the ratio is the median of the rounds. "kernel" rows write into arrays that exist already, as the
floor does; "trace" rows are the public call, which also allocates the memory of the result.
"""

from __future__ import annotations

import json
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numba
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from oracle.windows import biconvex, slab
from peer_jobs import beam

from clacad.effects.trace import trace
from clacad.mesh import tessellate
from clacad.optics.ledger import Ledger
from clacad.optics.rays import Rays
from clacad.tracing.compiled.chunk import trace_chunk
from clacad.tracing.compiled.packing import pack
from clacad.tracing.compiled.records import Outcome
from clacad.tracing.facets.tiles import lay_out_mesh
from clacad.tracing.layout import lay_out

ROUNDS = 7
SURFACES = 4
TARGETS = {"kernel, in-cell": 0.50, "kernel, anywhere on the array": 0.45}


@numba.njit(error_model="numpy", fastmath={"contract"}, nogil=True)
def floor_loop(rows, out):
    """Two square roots and two divisions a ray and surface, in blocks of 256, on six numbers a ray."""
    for first in range(0, rows.shape[1], 256):
        block = rows[:, first : first + 256].copy()
        a, b, c, d, e, f = block[0], block[1], block[2], block[3], block[4], block[5]
        for _ in range(SURFACES):
            for i in range(block.shape[1]):
                r = np.sqrt(a[i] * a[i] + 1.5)
                t = b[i] / (r + 2.0)
                q = np.sqrt(t * t + r)
                g = c[i] / (q + r)
                a[i] += t * d[i]
                b[i] += t * e[i]
                c[i] += g
                d[i] += g * a[i]
                e[i] -= g * b[i]
                f[i] = g * f[i] + t
        out[:, first : first + 256] = block


def kernel(window, rays: Rays, mesh=None, normals="facet") -> Callable[[], object]:
    """The compiled kernel alone, into arrays that exist already."""
    layout, tiles = (lay_out(window), None) if mesh is None else lay_out_mesh(window, mesh, normals)
    sheet, rows = pack(layout), np.arange(len(rays))
    ledger = Ledger.blank(len(rays), 0)
    out = Outcome(
        ledger.position, ledger.direction, ledger.fate, ledger.optical_path, ledger.cell, ledger.order, ledger.surface,
        ledger.hits, ledger.directions,
    )  # fmt: skip

    def run() -> object:
        return trace_chunk(tiles, sheet, rows, rays.position, rays.direction, out)

    run.ledger = ledger
    return run


def cpu(run: Callable[[], object]) -> float:
    """Processor seconds of one call."""
    start = time.process_time()
    run()
    return time.process_time() - start


def jobs(count: int) -> dict[str, tuple[Callable[[], object], int, int]]:
    """What is measured: call, surfaces a ray, rays."""
    base, tilted, plate = (
        biconvex(count=(200, 200)),
        biconvex(euler=(0.0, 0.1, 0.0), count=(200, 200)),
        slab(),
    )
    hexagonal = biconvex(kind="hexagonal", eta=(-0.5, -0.7), thickness=0.0012, count=(200, 200))
    inner, anywhere = beam(base, count, 0.001, 0.4), beam(base, count, 0.005, 1.0)
    few = beam(base, min(count, 200_000), 0.005, 0.4)
    mesh = tessellate(base, quads=32)
    small = Rays(anywhere.position[:100_000], anywhere.direction[:100_000])
    return {
        "kernel, in-cell": (kernel(base, inner), 4, count),
        "kernel, anywhere on the array": (kernel(base, anywhere), 4, count),
        "kernel, tilted in-cell": (kernel(tilted, beam(tilted, count, 0.001, 0.4)), 4, count),
        "kernel, hexagonal": (kernel(hexagonal, beam(hexagonal, count, 0.005, 1.0)), 4, count),
        "kernel, slab": (kernel(plate, beam(plate, count, 0.005, 0.6)), 2, count),
        "kernel, facets": (kernel(base, few, mesh), 4, len(few)),
        "kernel, facets, vertex normals": (kernel(base, few, mesh, "vertex"), 4, len(few)),
        "trace, in-cell": (lambda: trace(base, inner, path="numba", threads=1), 4, count),
        "trace, anywhere on the array": (lambda: trace(base, anywhere, path="numba", threads=1), 4, count),
        "trace, numpy": (lambda: trace(base, small, path="numpy"), 4, len(small)),
    }


def main() -> int:
    """Measure, print the table or JSON; 1 if a target is missed."""
    numbers = [int(a) for a in sys.argv[1:] if a.isdigit()]
    count = numbers[0] if numbers else 1_000_000
    rows = np.random.default_rng(1).uniform(0.5, 1.0, (6, count))
    out = np.empty_like(rows)
    work = jobs(count)
    floor_loop(rows, out)
    for run, _, _ in work.values():
        run()
    seconds: dict[str, list[float]] = {name: [] for name in work}
    ratios: dict[str, list[float]] = {name: [] for name in work}
    floors = []
    for _ in range(ROUNDS):
        for name, (run, surfaces, rays) in work.items():
            floor = cpu(lambda: floor_loop(rows, out)) / (SURFACES * count)
            one = cpu(run) / (surfaces * rays)
            floors.append(floor)
            seconds[name].append(one)
            ratios[name].append(floor / one)
    table = [
        {
            "what": name,
            "million_ray_surfaces_per_second": 1e-6 / statistics.median(seconds[name]),
            "of_floor": statistics.median(ratios[name]),
            "target": TARGETS.get(name),
        }
        for name in work
    ]
    floor_rate = 1e-6 / statistics.median(floors)
    if "--json" in sys.argv:
        sys.stdout.write(json.dumps({"floor": floor_rate, "rays": count, "rows": table}, indent=1) + "\n")
    else:
        sys.stdout.write(f"floor: {floor_rate:.0f} million ray-surfaces a second on one thread\n")
        for row in table:
            goal = "" if row["target"] is None else f"   target {row['target']:.2f}"
            sys.stdout.write(
                f"{row['what']:34}{row['million_ray_surfaces_per_second']:8.1f} M/s   {row['of_floor']:.2f} of floor{goal}\n"
            )
    return int(any(row["target"] is not None and row["of_floor"] < row["target"] for row in table))


if __name__ == "__main__":
    sys.exit(main())
