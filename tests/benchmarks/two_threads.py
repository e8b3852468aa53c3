"""How much two threads are worth, by what processors were given: python tests/benchmarks/two_threads.py [rays].

On a shared machine wall clocks depend on the neighbours. Here a call is made on one thread, C processor seconds, and on two: M of
the thread that calls and W of those that trace. On two free cores that takes M + W/2, C/(M + W/2) times as fast as on one; what
threads cost each other, in memory and locks, is in W. The least of several rounds, in turns.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from oracle.windows import biconvex
from peer_jobs import beam
from viewscenes import view_scene

import clacad
from clacad.optics.rays import Rays
from clacad.sheet.window import Window

ROUNDS = 5
On = Callable[[int], object]


def calls(count: int) -> dict[str, On]:
    """Calls, by name, on a given number of threads."""
    window = biconvex(count=(200, 200))
    rays = beam(window, count, 0.02, 1.0)
    mesh = clacad.tessellate(window, quads=16)
    scene = view_scene("base", 1320, "surfaces")
    smooth = scene.replace("camera.samples", 16)
    wide = Rays(rays.position, rays.direction + np.array([0.2, 0.1, 0.0]))

    def traced(which: Rays, **words: object) -> On:
        return lambda threads: clacad.trace(window, which, threads=threads, path="numba", **words)

    def summed(window: Window) -> On:
        return lambda threads: clacad.Tracer(window, path="numba", threads=threads).sums(rays)

    return {
        "trace, exact surfaces": traced(rays),
        "trace, exact surfaces, at a wide angle": traced(wide),
        "trace, thin": traced(rays, rung="thin"),
        "trace, facets": traced(rays, rung="mesh", mesh=mesh),
        "sums": summed(window),
        "render, 1320 x 1320, a ray a pixel": lambda threads: clacad.render(scene, threads=threads),
        "render, 1320 x 1320, 16 rays a pixel": lambda threads: clacad.render(smooth, threads=threads),
    }


def spent(run: On, threads: int) -> tuple[float, float, float]:
    """Processor seconds of all threads and of the one that calls, and wall clock."""
    every, own, wall = time.process_time(), time.thread_time(), time.perf_counter()
    run(threads)
    return time.process_time() - every, time.thread_time() - own, time.perf_counter() - wall


def main() -> None:
    """Print the table."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    print(
        "| call | one thread, processor s | two: calling s | tracing s | times as fast on free cores | by this clock |"
    )
    print("|---|---|---|---|---|---|")
    for name, run in calls(count).items():
        for threads in (1, 2):
            run(threads)
        pairs = [(spent(run, 1), spent(run, 2)) for _ in range(ROUNDS)]
        one = min(first[0] for first, _ in pairs)
        every, own, _ = min(second for _, second in pairs)
        wall = min(first[2] for first, _ in pairs) / min(second[2] for _, second in pairs)
        gain = one / (own + 0.5 * (every - own))
        print(f"| {name} | {one:.3f} | {own:.3f} | {every - own:.3f} | {gain:.2f} | {wall:.2f} |", flush=True)


if __name__ == "__main__":
    main()
