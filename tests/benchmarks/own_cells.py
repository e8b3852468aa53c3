"""Cost of non-uniform cells: the same rays through window-100mm as it is and aimed, turn by turn in one run.

`python tests/benchmarks/own_cells.py` prints nanoseconds a ray on one thread, the least of the turns, and their ratio; of the
biconic lenses that an aimed sheet needs, and of ellipsoids, whose arithmetic is a tenth of it. Of a uniform sheet fewer rays
are walked: lenses that lie far out in their cells reach farther up, and more rays pass a border next to one.
Uniform sheets do not use the kernels of non-uniform ones (`tests/tracing/test_own_kernels.py`).
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

import clacad

DESIGNS = Path(__file__).parents[2] / "designs"
AIMED = {"lattice.outline": {"circle": 100}, "check.process": "none", "pair.offset": "paraxial"}
LENSES = {"biconic": {"pair.surface": "biconic", "pair.conic": [-0.7, -0.7]}, "ellipsoids": {}}
AT_EYE = {"lattice.aperture": {"point": [0, 0, -400]}}
CELLS = {"equal cells": {}, "aimed": AT_EYE, "aimed, traced vertices": {**AT_EYE, "pair.offset": "traced"}}
RAYS, TURNS = 200_000, 7


def light(viewer: np.ndarray) -> clacad.Rays:
    """Rays of a viewer that reach the sheet."""
    rng = np.random.default_rng(3)
    r, a = 45.0 * np.sqrt(rng.uniform(size=RAYS)), 2.0 * np.pi * rng.uniform(size=RAYS)
    at = np.column_stack([r * np.cos(a), r * np.sin(a), np.zeros(RAYS)])
    way = at - viewer
    way /= np.linalg.norm(way, axis=1)[:, None]
    return clacad.Rays(at - way * (1.0 / way[:, 2:]), way)


def main() -> None:
    """Print the table."""
    plain = clacad.load(str(DESIGNS / "window-100mm.toml")).replace(AIMED)
    windows = {
        (lens, cells): clacad.prescribe(plain.replace({**shape, **keys}))
        for lens, shape in LENSES.items()
        for cells, keys in CELLS.items()
    }
    rays = light(np.array([0.0, 0.0, -400.0]))
    best = dict.fromkeys(windows, np.inf)
    for turn in range(TURNS + 1):
        for name, window in windows.items():
            began = time.process_time()
            clacad.trace(window, rays, path="numba", threads=1)
            if turn:  # the first compiles
                best[name] = min(best[name], time.process_time() - began)
    for (lens, cells), seconds in best.items():
        ratio = seconds / best[lens, "equal cells"]
        print(f"{lens:12}{cells:24} {1e9 * seconds / RAYS:8.1f} ns a ray   {ratio:.3f}")


if __name__ == "__main__":
    main()
