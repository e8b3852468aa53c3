"""No ray is lost: python tests/benchmarks/fates.py [rays] [--write].

Random rays from all directions at windows of every form, tilted by up to 20 degrees: each must end in exactly one
fate, and the numpy path and the compiled kernels must agree on every fate, cell and ghost order. One ray that does
not is printed with all its bits, and the exit status is 1. --write puts the counts into tests/benchmarks/trace.md.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from oracle.windows import beam, biconvex, collection

from clacad.optics.rays import Fate, Rays
from clacad.sheet.window import Window
from clacad.tracing.trace import trace

BLOCK = 100_000
COLUMNS = ("fate", "cell", "order", "surface")


def windows() -> dict[str, Window]:
    """Every form the tests know, and the tilted pair at steps up to 20 degrees."""
    made = dict(collection())
    for degrees in (1, 5, 10, 15, 20):
        made[f"biconvex tilted by {degrees} degrees"] = biconvex(euler=(0.3, np.radians(degrees), 0.4))
    return made


def all_directions(window: Window, number: int, seed: int) -> Rays:
    """Half the rays as the tests aim them; half with directions even over the sphere, aimed at the sheet."""
    half = number // 2
    position, direction = beam(window, number - half, seed)
    rng = np.random.default_rng(seed)
    d = rng.normal(size=(half, 3))
    d /= np.linalg.norm(d, axis=1)[:, None]
    x0, x1, y0, y1 = window.lattice.extent()
    low, high = window.z_range
    aim = rng.uniform((x0, y0, low), (x1, y1, high), (half, 3))
    start = aim - d * np.maximum((aim[:, 2:] - low) / np.maximum(np.abs(d[:, 2:]), 1e-9), 0.01) * 1.5
    return Rays(np.concatenate([position, start]), np.concatenate([direction, d]))


def compare(window: Window, rays: Rays) -> tuple[np.ndarray, np.ndarray]:
    """Number of rays in each fate, and the rows on which the two paths differ."""
    one, two = (trace(window, rays, path=path) for path in ("numpy", "numba"))
    apart = np.zeros(len(rays), dtype=bool)
    for column in COLUMNS:
        apart |= (getattr(one, column) != getattr(two, column)).reshape(len(rays), -1).any(axis=1)
    counts = np.bincount(one.fate, minlength=len(Fate))
    if counts.sum() != len(rays) or len(counts) > len(Fate):
        raise AssertionError(f"{len(rays)} rays, {counts.sum()} fates")
    return counts, np.flatnonzero(apart)


def main() -> int:
    """Send the rays, window after window; 1 if the two paths differ on any."""
    numbers = [int(a) for a in sys.argv[1:] if a.isdigit()]
    total = numbers[0] if numbers else 10_000_000
    made = windows()
    each = -(-total // len(made))
    counts, differing, start = np.zeros(len(Fate), dtype=np.int64), 0, time.process_time()
    for name, window in made.items():
        for k in range(0, each, BLOCK):
            rays = all_directions(window, min(BLOCK, each - k), k // BLOCK + 1)
            found, apart = compare(window, rays)
            counts += found
            differing += len(apart)
            for row in apart[:3]:
                bits = " ".join(float(v).hex() for v in (*rays.position[row], *rays.direction[row]))
                sys.stdout.write(f"{name}: the paths differ on {bits}\n")
    text = f"{counts.sum()} rays at {len(made)} windows, {differing} on which the two paths differ.\n\n"
    text += "| fate | rays |\n|---|---:|\n" + "".join(f"| {f.name} | {counts[f]} |\n" for f in Fate)
    sys.stdout.write(text + f"{time.process_time() - start:.0f} s of one core\n")
    if "--write" in sys.argv:
        from trace_peers import write  # needs the peers' own helpers, which lie in the same folder

        write(text, "fates")
    return int(differing > 0)


if __name__ == "__main__":
    sys.exit(main())
