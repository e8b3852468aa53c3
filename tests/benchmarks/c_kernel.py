"""The exact kernel, and `trace`, against the same arithmetic in C: python tests/benchmarks/c_kernel.py [rounds].

`ellipsoids.c`, compiled here by gcc -O3 -march=native in several ways (WAYS), of which the fastest counts. Turn by turn on one
thread: a busy machine slows both, and the ratio is the median of the rounds. "into arrays" rows write into arrays that exist, "fresh"
ones ask for new arrays at each call, as `trace` does. Directions must agree to 1e-14 or nothing is printed.
"""

from __future__ import annotations

import ctypes
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from oracle.windows import biconvex
from peer_jobs import beam
from trace_speed import kernel

import clacad
from clacad.optics.rays import Rays
from clacad.sheet.window import Window
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.packing import pack
from clacad.tracing.layout import lay_out

FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-shared", "-fPIC")
WAYS = (FLAGS, (*FLAGS, "-mprefer-vector-width=512"), (*FLAGS, "-ffp-contract=off"))

COLUMNS = (
    (3, np.float64),
    (3, np.float64),
    (0, np.uint8),
    (0, np.float64),
    (2, np.int32),
    (2, np.int32),
    (0, np.int32),
)
"""Position, direction, fate, optical path, cell, order, surface."""

Run = Callable[[], object]


def numbers(window: Window) -> tuple[np.ndarray, np.ndarray]:
    """The structs Face (4, 16) and Sheet (9,) of `ellipsoids.c`."""
    sheet = pack(lay_out(window))
    columns = (slot.CX, slot.CY, slot.KX, slot.SIDE, slot.VX, slot.VY, slot.VZ, slot.CLIMB)
    lat, bodies, index = sheet.lattice, sheet.bodies, sheet.indices[0]
    media = np.array([[1.0, index], [index, 1.0]] * 2)
    inner = bodies[:, [slot.MID_X, slot.MID_Y, slot.INNER_X, slot.INNER_Y, slot.INNER_R]]
    inner[:, 4] *= inner[:, 4]
    bounds = np.repeat(inner, 2, axis=0)
    return np.column_stack([sheet.faces[:, columns], media, sheet.faces[:, slot.HIGH], bounds]), np.array(
        [lat[slot.PITCH], lat[slot.ROW], lat[slot.N1], lat[slot.N2], lat[slot.MARGIN],
         *bodies[:, slot.LEVEL], bodies[0, slot.BODY_LOW], sheet.faces[2, slot.LOW]]
    )  # fmt: skip


def compiled(folder: str, flags: tuple[str, ...]) -> Callable[..., None]:
    """`trace` of the C file."""
    place = str(Path(folder) / f"{len(''.join(flags))}.so")
    subprocess.run(
        ["gcc", *flags, "-o", place, str(Path(__file__).with_name("ellipsoids.c")), "-lm"], check=True
    )
    return ctypes.CDLL(place).trace


def columns(count: int) -> list[np.ndarray]:
    """New arrays of a result."""
    return [np.empty((count, wide) if wide else count, dtype=kind) for wide, kind in COLUMNS]


def call(
    function: Callable[..., None], window: Window, rays: Rays
) -> Callable[[list[np.ndarray]], list[np.ndarray]]:
    """Rays from arrays into arrays, by C."""
    faces, sheet = numbers(window)

    def run(out: list[np.ndarray]) -> list[np.ndarray]:
        handed = [ctypes.c_void_p(a.ctypes.data) for a in (faces, sheet, rays.position, rays.direction, *out)]
        function(*handed[:2], ctypes.c_long(len(rays)), *handed[2:])
        return out

    return run


def agree(ours: clacad.TraceResult, theirs: list[np.ndarray]) -> None:
    """Refuse to compare what is not the same job."""
    alive = ours.fate == 0
    assert (theirs[2][alive] == 0).mean() > 0.999
    same = alive & (theirs[2] == 0)
    assert np.abs(ours.direction - theirs[1])[same].max() < 1e-14
    assert np.abs(ours.position - theirs[0])[same].max() < 1e-14
    assert np.abs(ours.optical_path - theirs[3])[same].max() < 1e-14
    assert (ours.cell == theirs[4])[same].all()


def seconds(run: Run, times: int) -> float:
    """Processor seconds of a call."""
    start = time.process_time()
    for _ in range(times):
        run()
    return (time.process_time() - start) / times


def main(rounds: int = 15) -> None:
    """Print the table."""
    window = biconvex(eta=(-0.5, -0.5), count=(200, 200))
    print("| rays | what | ns a ray | C: ns a ray | of C |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        ways = [compiled(folder, flags) for flags in WAYS]
        for count in (10_000, 500_000):
            rays = beam(window, count, 0.005, 0.4)
            inner = [call(way, window, rays) for way in ways]
            kept, own = columns(count), kernel(window, rays)
            tracer = clacad.Tracer(window, path="numba", threads=1)
            for one in inner:
                agree(tracer(rays), one(kept))
            jobs: dict[str, tuple[Run, list[Run]]] = {
                "kernel, into arrays": (own, [lambda one=one, kept=kept: one(kept) for one in inner]),
                "trace, fresh arrays": (
                    lambda rays=rays: clacad.trace(window, rays, path="numba", threads=1),
                    [lambda one=one, count=count: one(columns(count)) for one in inner],
                ),
                "Tracer, fresh arrays": (
                    lambda rays=rays, tracer=tracer: tracer(rays),
                    [lambda one=one, count=count: one(columns(count)) for one in inner],
                ),
            }  # fmt: skip
            times = max(1, 500_000 // count)
            for name, (ours, theirs) in jobs.items():
                turns = [
                    (seconds(ours, times), min(seconds(one, times) for one in theirs)) for _ in range(rounds)
                ]
                best = [1e9 * min(turn[k] for turn in turns) / count for k in (0, 1)]
                ratio = statistics.median(other / mine for mine, other in turns)
                print(f"| {count:,} | {name} | {best[0]:.1f} | {best[1]:.1f} | {ratio:.2f} |", flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
