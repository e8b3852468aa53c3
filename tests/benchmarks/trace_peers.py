"""The tracer compared with other tracers, in one run on one core: python tests/benchmarks/trace_peers.py [rays] [--json] [--write].

Same geometry (two biconvex lenses with spherical faces; or their facets), same number of rays, float64 unless a peer
has no such thing. Every measurement alternates with one of this package's own kernel and one of the machine's floor,
turn by turn, processor seconds; ratios are medians of the rounds. A peer that is not installed is left out by name.
--write puts the table into tests/benchmarks/trace.md.
"""

from __future__ import annotations

import json
import os
import platform
import statistics
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from oracle.windows import biconvex
from peer_jobs import (
    FACES,
    Job,
    batoid_job,
    batoid_whole,
    embreex_job,
    facets_of,
    optiland_job,
    optiland_whole,
    trimesh_job,
)
from trace_speed import beam, cpu, floor_loop, kernel

from clacad.mesh import tessellate
from clacad.optics.rays import Rays, TraceResult
from clacad.sheet.face_order import media_of
from clacad.sheet.window import Window

ROUNDS = 5
QUADS = 100
"""Facets along a cell: 20,000 triangles a face."""

TARGETS = {
    "batoid": 13.0,
    "optiland": 17.0,
    "embreex": 8.0,
    "trimesh + embreex": 16.0,
    "surfaces, in-cell, normal incidence": 0.50,
    "array by lattice index, in-field": 0.45,
    "two threads": 0.90,
}


def against(ours: Job, peer: Job, own_rays: int, peer_rays: int) -> tuple[float, float]:
    """How many times the peer's seconds a ray are ours, and the peer's million ray-surfaces a second."""
    ours()
    peer()
    ratios, rates = [], []
    for _ in range(ROUNDS):
        one, other = cpu(ours) / own_rays, cpu(peer) / peer_rays
        ratios.append(other / one)
        rates.append(1e-6 * FACES / other)
    return statistics.median(ratios), statistics.median(rates)


def peers(count: int) -> list[dict[str, object]]:
    """One row a peer, its faces alone compared with our kernel alone: how many times slower, how far off its directions."""
    window = biconvex(eta=(-0.5, -0.5), count=(1, 1))
    rays = beam(window, count, 0.02, 0.4)
    mesh = tessellate(window, quads=QUADS)
    faces = facets_of(mesh)
    few = Rays(rays.position[: count // 10], rays.direction[: count // 10])
    smooth, flat = kernel(window, rays), kernel(window, rays, mesh)
    makers = {
        "batoid": (lambda: batoid_job(window, rays), smooth, rays),
        "batoid ": (lambda: batoid_job(window, few), kernel(window, few), few),
        "optiland": (lambda: optiland_job(window, rays), smooth, rays),
        "optiland ": (lambda: optiland_job(window, few), kernel(window, few), few),
        "embreex": (lambda: embreex_job(window, faces, few), flat, few),
        "trimesh + embreex": (lambda: trimesh_job(window, faces, few), flat, few),
    }
    rows: list[dict[str, object]] = []
    for name, (make, ours, theirs) in makers.items():
        try:
            run, directions = make()
        except ImportError as error:
            rows.append({"peer": name.strip(), "left_out": f"not installed ({error.name})"})
            continue
        times, rate = against(ours, run, len(ours.ledger.fate), len(theirs))
        ours()
        apart = np.linalg.norm(directions() - ours.ledger.direction[: len(theirs)], axis=1)
        rows.append(
            {"peer": f"{name.strip()} {version(name.split()[0])}", "rays": len(theirs), "times_slower": times,
             "million_ray_surfaces_per_second": rate, "target": TARGETS.get(name),
             "direction_median": float(np.nanmedian(apart)), "direction_max": float(np.nanmax(apart))}
        )  # fmt: skip
    return rows


def users(count: int) -> list[dict[str, object]]:
    """One row a peer, as a user of each calls it, from arrays to new arrays; points are compared too."""
    from clacad.tracing.trace import trace

    window = biconvex(eta=(-0.5, -0.5), count=(1, 1))
    rows: list[dict[str, object]] = []
    for name, make, number in (
        ("batoid", batoid_whole, count), ("batoid", batoid_whole, count // 10),
        ("optiland", optiland_whole, count), ("optiland", optiland_whole, count // 10),
    ):  # fmt: skip
        rays = beam(window, number, 0.02, 0.4)
        try:
            run, directions, points = make(window, rays)
        except ImportError as error:
            rows.append({"peer": name, "left_out": f"not installed ({error.name})"})
            continue

        def ours(rays: Rays = rays) -> TraceResult:
            return trace(window, rays, path="numba", threads=1)

        times, rate = against(ours, run, number, number)
        found = ours()
        turned = np.linalg.norm(directions() - found.direction, axis=1)
        moved = np.linalg.norm(points() - found.position, axis=1)
        rows.append(
            {"peer": f"{name} {version(name)}", "rays": number, "times_slower": times,
             "million_ray_surfaces_per_second": rate, "direction_max": float(turned.max()),
             "position_max": float(moved.max())}
        )  # fmt: skip
    return rows


def cases(count: int) -> list[dict[str, object]]:
    """Our own rungs against the floor: rays along the normal, over the field, at wide angles."""
    window = biconvex(count=(200, 200))
    mesh = tessellate(window, quads=32)
    rows = np.random.default_rng(1).uniform(0.5, 1.0, (6, count))
    out = np.empty_like(rows)
    made: dict[str, Job] = {}
    for angle, spread in (("normal incidence", 0.001), ("in-field", 0.005), ("wide angle", 0.2)):
        inner, anywhere = beam(window, count, spread, 0.4), beam(window, count, spread, 1.0)
        made[f"surfaces, in-cell, {angle}"] = kernel(window, inner)
        made[f"array by lattice index, {angle}"] = kernel(window, anywhere)
        made[f"mesh, array by lattice index, {angle}"] = kernel(window, anywhere, mesh)
    floor = cpu_of_floor(rows, out)
    table = []
    for name, run in made.items():
        walked = int(run()) / count
        shares, rates = [], []
        for _ in range(ROUNDS):
            base, one = floor() / (FACES * count), cpu(run) / (FACES * count)
            shares.append(base / one)
            rates.append(1e-6 / one)
        table.append(
            {"what": name, "million_ray_surfaces_per_second": statistics.median(rates),
             "of_floor": statistics.median(shares), "walked": walked, "target": TARGETS.get(name)}
        )  # fmt: skip
    return table


def cpu_of_floor(rows: np.ndarray, out: np.ndarray) -> Callable[[], float]:
    """The floor loop, compiled, to be timed."""
    floor_loop(rows, out)
    return lambda: cpu(lambda: floor_loop(rows, out))


def threads(count: int) -> dict[str, float]:
    """Speed-up from one to two threads, of the bare floor loop and of the tracer; wall clock."""
    window = biconvex(count=(200, 200))
    rays = beam(window, count, 0.005, 1.0)
    rows = np.random.default_rng(1).uniform(0.5, 1.0, (6, count))
    out = np.empty_like(rows)
    half = count // 2
    parts = [(rows[:, :half].copy(), out[:, :half].copy()), (rows[:, half:].copy(), out[:, half:].copy())]
    run = {n: trace_with(window, rays, n) for n in (1, 2)}

    def floor(pool_of: int) -> None:
        with ThreadPoolExecutor(pool_of) as pool:
            list(pool.map(lambda part: floor_loop(*part), parts))

    gains: dict[str, list[float]] = {"floor": [], "tracer": []}
    for work in (lambda: floor(2), run[1], run[2]):
        work()
    for _ in range(2 * ROUNDS):
        gains["floor"].append(wall(lambda: floor(1)) / wall(lambda: floor(2)))
        gains["tracer"].append(wall(run[1]) / wall(run[2]))
    floor_gain, own = statistics.median(gains["floor"]), statistics.median(gains["tracer"])
    return {"floor": floor_gain, "tracer": own, "share": own / floor_gain, "target": TARGETS["two threads"]}


def trace_with(window: Window, rays: Rays, number: int) -> Job:
    """The compiled tracer on a given number of threads, into arrays that exist already."""
    from clacad.optics.ledger import Ledger
    from clacad.tracing.compiled.chunk import trace_compiled
    from clacad.tracing.layout import lay_out

    ledger, layout, media = Ledger.blank(len(rays), 0), lay_out(window), media_of(window.bodies)
    return lambda: trace_compiled(layout, rays, ledger, np.arange(len(rays)), media, number)


def wall(run: Job) -> float:
    """Seconds of one call by the clock."""
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def as_table(found: dict) -> str:
    """The result as Markdown."""
    lines = [
        "| what (one core) | M ray-surfaces/s | of the floor | walked | target |", "|---|---:|---:|---:|---:|"
    ]  # fmt: skip
    for row in found["cases"]:
        goal = "" if row["target"] is None else f"{row['target']:.2f}"
        lines.append(
            f"| {row['what']} | {row['million_ray_surfaces_per_second']:.1f} | {row['of_floor']:.2f} | {row['walked']:.2%} | {goal} |"
        )
    lines += ["", "| faces alone | rays | M ray-surfaces/s | times slower than clacad | target | direction off: median, largest (rad) |",
              "|---|---:|---:|---:|---:|---|"]  # fmt: skip
    for row in found["peers"]:
        if "left_out" in row:
            lines.append(f"| {row['peer']} | left out: {row['left_out']} | | | | |")
            continue
        goal = "" if row["target"] is None else f"{row['target']:.0f}"
        lines.append(
            f"| {row['peer']} | {row['rays']:,} | {row['million_ray_surfaces_per_second']:.2f} | {row['times_slower']:.1f} | {goal} | {row['direction_median']:.1e}, {row['direction_max']:.1e} |"
        )
    lines += ["", "| whole trace, arrays to arrays | rays | M ray-surfaces/s | times slower than clacad.trace | off at most: direction (rad), point (m) |",
              "|---|---:|---:|---:|---|"]  # fmt: skip
    for row in found["users"]:
        if "left_out" in row:
            lines.append(f"| {row['peer']} | left out: {row['left_out']} | | | |")
            continue
        lines.append(
            f"| {row['peer']} | {row['rays']:,} | {row['million_ray_surfaces_per_second']:.2f} | {row['times_slower']:.1f} | {row['direction_max']:.1e}, {row['position_max']:.1e} |"
        )
    two = found["threads"]
    lines += ["", f"Two threads: the tracer {two['tracer']:.2f} times as fast as one, the floor loop {two['floor']:.2f}: "
              f"{two['share']:.0%} of it (target {two['target']:.0%})."]  # fmt: skip
    return "\n".join(lines) + "\n"


def write(text: str, part: str) -> None:
    """Replace one benchmark's part of trace.md."""
    path = Path(__file__).with_name("trace.md")
    begin, end = f"<!-- {part} -->\n", f"<!-- end of {part} -->\n"
    old = path.read_text()
    machine = (
        f"Measured on {os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}.\n\n"
    )
    path.write_text(old.split(begin)[0] + begin + machine + text + end + old.split(end)[1])


def main() -> int:
    """Measure and show; 1 if a target is missed."""
    numbers = [int(a) for a in sys.argv[1:] if a.isdigit()]
    count = numbers[0] if numbers else 1_000_000
    found = {
        "rays": count,
        "cases": cases(count),
        "peers": peers(count),
        "users": users(count),
        "threads": threads(count),
    }
    text = as_table(found)
    sys.stdout.write(json.dumps(found, indent=1) + "\n" if "--json" in sys.argv else text)
    if "--write" in sys.argv:
        write(text, "peers")
    reached = [row["of_floor"] >= row["target"] for row in found["cases"] if row["target"] is not None]
    reached += [row["times_slower"] >= row["target"] for row in found["peers"] if row.get("target")]
    return int(not all([*reached, found["threads"]["share"] >= found["threads"]["target"]]))


if __name__ == "__main__":
    sys.exit(main())
