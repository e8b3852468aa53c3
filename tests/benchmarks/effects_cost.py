"""Time of each effect over the bare trace, printed as a table: python tests/benchmarks/effects_cost.py [rays].

CPU seconds of one thread, median of interleaved rounds: the bare trace and the effect run turn by turn, so that a busy
machine slows both. "off" runs `trace(..., effects=())` against the kernel called without looking for effects.
"""

from __future__ import annotations

import math
import statistics
import sys
import time
from pathlib import Path

import numpy as np

from clacad import load, prescribe
from clacad.effects import Setting, light_reaching_camera, trace_with
from clacad.effects.engine.probe_rays import cone
from clacad.effects.trace import trace
from clacad.optics.rays import Rays

DESIGN = Path(__file__).parents[2] / "designs" / "paper-a-covered.toml"
ROUNDS = 5
SETTING = Setting(extinction=1e-9, roughness=5e-9, slope_rms=1e-4, analyser=0.3, polariser=0.5)
LIMITS = {"off": 1.03, "fresnel": 1.3, "absorption": 1.5, "dispersion": 1.1, "polarisation": 2.2}


def factors(count: int, path: str) -> dict[str, float]:
    """Cost factor of each effect on one path of the tracer."""
    window = prescribe(load(str(DESIGN)))
    rays = cone(window, math.radians(0.5), count)
    waves = Rays(rays.position, rays.direction, np.full(len(rays), 500e-9))
    options = {"threads": 1, "path": path}

    def with_(name: str) -> object:
        return trace_with(window, rays, "surfaces", (name,), setting=SETTING, **options)

    jobs = {
        "off": lambda: trace(window, rays, effects=(), **options),
        "dispersion": lambda: trace(window, waves, **options),
        **{name: (lambda name=name: with_(name)) for name in
           ("ghosts", "walls", "fresnel", "absorption", "tir_paths", "diffraction", "scatter", "polarisation")},
        "fresnel + absorption": lambda: trace_with(window, rays, "surfaces", ("fresnel", "absorption"),
                                                   setting=SETTING, **options),
        "reflections": lambda: light_reaching_camera(window, rays, "surfaces", ("reflections",), SETTING, **options),
    }  # fmt: skip
    return {name: ratio(lambda: trace(window, rays, **options), job) for name, job in jobs.items()}


def ratio(bare, job) -> float:
    """Median over the rounds of the job's CPU time over the bare trace's next to it."""
    seconds(bare), seconds(job)
    return statistics.median(seconds(job) / seconds(bare) for _ in range(ROUNDS))


def seconds(job) -> float:
    start = time.process_time()
    job()
    return time.process_time() - start


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 200_000
    numba, numpy = factors(count, "numba"), factors(count // 8, "numpy")
    print(f"{'effect':22}{'numba':>8}{'numpy':>8}   limit")
    for name in numba:
        limit = LIMITS.get(name)
        print(f"{name:22}{numba[name]:8.2f}{numpy[name]:8.2f}   {limit or ''}")


if __name__ == "__main__":
    main()
