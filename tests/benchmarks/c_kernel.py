"""The exact kernel, and `trace`, against the same arithmetic in C: python tests/benchmarks/c_kernel.py [rounds].

`ellipsoids.c`, compiled here by gcc -O3 -march=native in several ways (WAYS), of which the fastest counts: every operation rounded as
written, as ours are, so that the same rays give the same bits on any machine; and, apart, with multiplies and adds fused (FUSING),
which is another result. Turn by turn on one thread: a busy machine slows all, and ratios are medians of the rounds. "into arrays"
rows write into arrays that exist, "fresh" ones allocate new arrays at each call, as `trace` does. Directions must agree to 1e-14 or
nothing is printed.
"""

from __future__ import annotations

import ctypes
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from oracle.windows import biconvex
from peer_jobs import beam

import clacad
from clacad.optics.ledger import Ledger
from clacad.optics.rays import Rays
from clacad.sheet.window import Window
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.chunk import piece, trace_chunk
from clacad.tracing.compiled.packing import pack
from clacad.tracing.compiled.threads import CHUNK, in_arrays
from clacad.tracing.layout import lay_out

FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-shared", "-fPIC")
WIDE = "-mprefer-vector-width=512"
WAYS = tuple((*FLAGS, "-ffp-contract=off", *width) for width in ((), (WIDE,)))
FUSING = tuple((*FLAGS, "-ffp-contract=fast", *width) for width in ((), (WIDE,)))

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
    lat, bodies, index = sheet.lattice, sheet.bodies, sheet.media[1]
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
    place = str(Path(folder) / f"{abs(hash(flags))}.so")
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


def into_arrays(window: Window, rays: Rays) -> Run:
    """Our kernel alone, into arrays that exist already, in pieces as `trace` has them."""
    sheet, whole = pack(lay_out(window)), in_arrays(rays, Ledger.blank(len(rays), 0))
    pieces = [piece(range(k, min(k + CHUNK, len(rays))), *whole) for k in range(0, len(rays), CHUNK)]
    return lambda: [trace_chunk(None, sheet, rows, *columns) for rows, columns in pieces]


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
    print(
        "| rays | what | ns a ray | C: ns a ray | of C | C, fused: ns a ray | of it |\n|---|---|---|---|---|---|---|"
    )
    with tempfile.TemporaryDirectory() as folder:
        ways = [[compiled(folder, flags) for flags in each] for each in (WAYS, FUSING)]
        for count in (10_000, 500_000):
            rays = beam(window, count, 0.005, 0.4)
            kept, tracer = columns(count), clacad.Tracer(window, path="numba", threads=1)
            inner = [[call(way, window, rays) for way in each] for each in ways]
            for one in (*inner[0], *inner[1]):
                agree(tracer(rays), one(kept))
            theirs = [[partial(one, kept) for one in each] for each in inner]
            fresh = [[partial(_fresh, one, count) for one in each] for each in inner]
            jobs: dict[str, tuple[Run, list[list[Run]]]] = {
                "kernel, into arrays": (into_arrays(window, rays), theirs),
                "trace, fresh arrays": (partial(clacad.trace, window, rays, path="numba", threads=1), fresh),
                "Tracer, fresh arrays": (partial(tracer, rays), fresh),
            }
            for name, (ours, each) in jobs.items():
                turns = [_turn(ours, each, max(1, 500_000 // count)) for _ in range(rounds)]
                best = [1e9 * min(turn[k] for turn in turns) / count for k in range(3)]
                plain, fused = (statistics.median(turn[k] / turn[0] for turn in turns) for k in (1, 2))
                row = f"{best[0]:.1f} | {best[1]:.1f} | {plain:.2f} | {best[2]:.1f} | {fused:.2f}"
                print(f"| {count:,} | {name} | {row} |", flush=True)


def _fresh(one: Callable[[list[np.ndarray]], object], count: int) -> object:
    return one(columns(count))


def _turn(ours: Run, theirs: list[list[Run]], times: int) -> list[float]:
    """Seconds of our call, and of the fastest of each kind of theirs."""
    return [seconds(ours, times), *(min(seconds(one, times) for one in each) for each in theirs)]


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
