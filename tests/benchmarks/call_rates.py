"""One call as its user makes it, in a process of its own: what the first one takes, and what later ones take.

    python tests/benchmarks/call_rates.py ROW        one line of JSON; calls.py runs it, in this tree or in another

`calls.py` holds it to one core. A row that names a peer traces the same rays through the same faces by that peer's public calls,
from arrays to arrays; where it is not installed the row records that. Rays are made, designs read and meshes cut beforehand.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import numpy as np

TESTS = Path(__file__).parents[1]
sys.path[:0] = [str(TESTS), str(TESTS / "benchmarks")]

Job = Callable[[], object]

MOST, LONG = 9, 6.0
"""Calls after the first two, and processor seconds after which no more are made."""


def window(cells: int = 200):
    """Two biconvex lenses with spherical faces."""
    from oracle.windows import biconvex

    return biconvex(eta=(-0.5, -0.5), count=(cells, cells))


def light(cells: int, count: int):
    """Rays over the field, on the middle part of every cell."""
    from peer_jobs import beam

    return beam(window(cells), count, 0.02, 0.4)


def exact(count: int, rung: str = "surfaces") -> Job:
    """`clacad.trace` without options."""
    import clacad

    sheet, rays = window(), light(200, count)
    return lambda: clacad.trace(sheet, rays, rung)


def asked(count: int) -> Job:
    """`clacad.trace` with the path named: compiled."""
    import clacad

    sheet, rays = window(), light(200, count)
    return lambda: clacad.trace(sheet, rays, path="numba")


def summed(count: int) -> Job:
    """Sums alone: rays by fate, rms and worst angle to the law, mean direction, step of a fit."""
    import clacad

    tracer, rays = clacad.Tracer(window(), path="numba"), light(200, count)
    return lambda: tracer.sums(rays)


def rows_and_sums(count: int) -> Job:
    """The same numbers but the fit's, from the rows."""
    import clacad
    from clacad.optics.law import angle_between

    sheet, rays = window(), light(200, count)

    def run() -> object:
        result = clacad.trace(sheet, rays, path="numba")
        alive = result.fate == 0
        angle = angle_between(result.direction[alive], sheet.law.refract(rays.direction[alive]))
        return np.sqrt(np.mean(angle**2)), angle.max(), result.direction[alive].mean(axis=0), result.counts()

    return run


def grown(power: int) -> Job:
    """Rays all over a sheet of 10^power cells, prepared again at each call."""
    import clacad
    from clacad.optics.rays import Rays

    side = round(10 ** (power / 2))
    sheet = window(side)
    rng = np.random.default_rng(3)
    cell = rng.integers(0, side, (300_000, 2))
    place = sheet.lattice.centres(cell) + 0.4 * sheet.lattice.pitch[0] * rng.uniform(-0.5, 0.5, (300_000, 2))
    direction = np.column_stack([rng.uniform(-0.005, 0.005, (300_000, 2)), np.ones(300_000)])
    rays = Rays(np.column_stack([place, np.zeros(300_000)]) - 0.02 * direction, direction)
    return lambda: clacad.trace(sheet, rays, path="numba")


def facets(count: int) -> Job:
    """Rung mesh, one cell of 100 quads."""
    import clacad

    sheet, rays = window(1), light(1, count)
    mesh = clacad.tessellate(sheet, quads=100)
    return lambda: clacad.trace(sheet, rays, rung="mesh", mesh=mesh)


def from_file(count: int, kind: str) -> Job:
    """6 × 6 cells of 32 quads, in memory or as an STL file."""
    import clacad

    sheet, rays = window(6), light(6, count)
    mesh = clacad.tessellate(sheet, quads=32)
    if kind == "memory":
        return lambda: clacad.trace(sheet, rays, rung="mesh", mesh=mesh)
    from clacad.formats.mesh.stl import FACET

    corners = np.concatenate([rows for body in mesh.bodies for rows in body.rows()])
    record = np.zeros(len(corners), dtype=FACET)
    record["corners"] = corners
    path = Path(tempfile.mkdtemp()) / "sheet.stl"
    path.write_bytes(b"\0" * 80 + np.uint32(len(corners)).tobytes() + record.tobytes())
    return lambda: clacad.trace(sheet, rays, rung="mesh", mesh=path)


def picture(pixels: int) -> Job:
    """`clacad.render`, exact surfaces, one ray a pixel."""
    from viewscenes import view_scene

    import clacad

    scene = view_scene("base", pixels, "surfaces")
    return lambda: clacad.render(scene)


def whole(maker: str, count: int) -> Job:
    """A peer's whole trace, from arrays to new arrays."""
    import peer_jobs

    run: Job = getattr(peer_jobs, maker)(window(1), light(1, count))[0]
    return run


def through_facets(maker: str, count: int) -> Job:
    """A peer's rays through the facets of one cell of 100 quads."""
    import peer_jobs

    import clacad

    sheet = window(1)
    parts = peer_jobs.facets_of(clacad.tessellate(sheet, quads=100))
    run: Job = getattr(peer_jobs, maker)(sheet, parts, light(1, count))[0]
    return run


ROWS: dict[str, tuple[Callable[[], Job], int, str]] = {
    **{f"trace, {n:,} rays": (lambda n=n: exact(n), n, "") for n in (1_000, 10_000, 100_000, 500_000, 1_000_000)},
    "trace compiled, 10,000 rays": (lambda: asked(10_000), 10_000, ""),
    "trace law, 1,000,000 rays": (lambda: exact(1_000_000, "law"), 1_000_000, ""),
    "trace thin, 1,000,000 rays": (lambda: exact(1_000_000, "thin"), 1_000_000, ""),
    "trace mesh of 100 quads, 10,000 rays": (lambda: facets(10_000), 10_000, ""),
    "trace mesh 6 x 6 in memory, 10,000 rays": (lambda: from_file(10_000, "memory"), 10_000, ""),
    "trace the same as an STL file, 10,000 rays": (lambda: from_file(10_000, "file"), 10_000, ""),
    "sums, 500,000 rays": (lambda: summed(500_000), 500_000, ""),
    "sums from rows, 500,000 rays": (lambda: rows_and_sums(500_000), 500_000, ""),
    "render, 1320 x 1320": (lambda: picture(1320), 1320 * 1320, ""),
    **{f"trace, sheet of 10^{p} cells": (lambda p=p: grown(p), 300_000, "") for p in (2, 4, 6, 8)},
    "batoid, 10,000 rays": (lambda: whole("batoid_whole", 10_000), 10_000, "batoid"),
    "batoid, 500,000 rays": (lambda: whole("batoid_whole", 500_000), 500_000, "batoid"),
    "optiland, 10,000 rays": (lambda: whole("optiland_whole", 10_000), 10_000, "optiland"),
    "optiland, 500,000 rays": (lambda: whole("optiland_whole", 500_000), 500_000, "optiland"),
    "mitsuba, 500,000 rays": (lambda: whole("mitsuba_whole", 500_000), 500_000, "mitsuba"),
    "raysect, 1,000 rays": (lambda: whole("raysect_whole", 1_000), 1_000, "raysect"),
    "embreex, 100 quads, 10,000 rays": (lambda: through_facets("embreex_job", 10_000), 10_000, "embreex"),
    "trimesh + embreex, 100 quads, 10,000 rays": (lambda: through_facets("trimesh_job", 10_000), 10_000, "trimesh"),
}  # fmt: skip
"""Name → what is prepared and gives the call, its rays, and the peer's package; "" for this one."""


def timed(run: Job) -> tuple[float, float]:
    """Processor seconds and wall clock of a call."""
    processor, wall = time.process_time(), time.perf_counter()
    run()
    return time.process_time() - processor, time.perf_counter() - wall


def measured(name: str) -> dict[str, object]:
    """The first call, the second, and the best of those after it; seconds (processor, wall clock)."""
    make, rays, package = ROWS[name]
    try:
        run = make()
    except ImportError as error:
        return {"row": name, "left_out": f"not installed ({error.name})"}
    calls = [timed(run), timed(run)]
    while len(calls) < MOST + 2 and sum(one for one, _ in calls[2:]) < LONG:
        calls.append(timed(run))
    best = min(calls[2:])
    told = f"{package} {version(package)}" if package else ""
    return {"row": name, "rays": rays, "first": calls[0], "second": calls[1], "best": best, "peer": told}


if __name__ == "__main__":
    print(json.dumps(measured(sys.argv[1])))
