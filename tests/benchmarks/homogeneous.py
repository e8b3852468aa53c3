"""Cost of non-uniform sheets to uniform ones: the same jobs in this checkout and in an older one, turn by turn.

`python tests/benchmarks/homogeneous.py OLD` prints, for each job, CPU seconds (the least of the turns) in the checkout at the folder OLD
and in this one, their ratio, and whether the bytes are the same. Before non-uniform sheets: commit 3a30a00, `git worktree add OLD 3a30a00`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

TURNS = 3
JOBS = """
import hashlib, json, sys, tempfile, time
from pathlib import Path
import numpy as np
import clacad
from clacad.mesh import tessellate
designs = Path(sys.argv[1])
def sheet(name):
    return clacad.prescribe(clacad.load(str(designs / name)))
def light(window, count):
    rng = np.random.default_rng(2)
    x0, x1, y0, y1 = window.lattice.extent()
    at = np.column_stack([rng.uniform(x0, x1, count), rng.uniform(y0, y1, count), np.full(count, window.z_range[0] - 1e-3)])
    way = np.column_stack([rng.uniform(-0.03, 0.03, (count, 2)), np.ones(count)])
    return clacad.Rays(at, way)
def digest(result):
    made = hashlib.sha256()
    for part in (result.position, result.direction, result.optical_path, result.fate, result.cell, result.order):
        made.update(np.ascontiguousarray(part).tobytes())
    return made.hexdigest()
def meshed(window):
    made = hashlib.sha256()
    for body in tessellate(window.with_cells((12, 12)), quads=12).bodies:
        for rows in body.rows():
            made.update(np.ascontiguousarray(rows).tobytes())
    return made.hexdigest()
def files(name):
    made = hashlib.sha256()
    with tempfile.TemporaryDirectory() as folder:
        clacad.export(clacad.load(str(designs / name)), Path(folder) / "out", formats=("step", "stl", "tiff", "xyz"), cells=(6, 6), quads=8, force=True)
        for path in sorted((Path(folder) / "out").iterdir()):
            if path.suffix != ".json":
                made.update(path.read_bytes())
    return made.hexdigest()
plain, tilted = sheet("window-100mm.toml"), sheet("paper-a-covered.toml")
jobs = {"prescribe": lambda: repr(sheet("paper-a-covered.toml"))}
for name, window in (("window-100mm", plain), ("paper-a-covered", tilted)):
    for rung, path, count in (("law", "numpy", 200_000), ("thin", "numpy", 100_000), ("surfaces", "numpy", 100_000), ("surfaces", "numba", 1_000_000)):
        rays = light(window, count)
        jobs[f"{name}, {rung}, {path}"] = lambda w=window, r=rays, u=rung, p=path: digest(clacad.trace(w, r, rung=u, path=p, threads=1))
    jobs[f"{name}, mesh"] = lambda w=window: meshed(w)
jobs["window-100mm, files"] = lambda: files("window-100mm.toml")
told = {}
for name, job in jobs.items():
    job()
    least = float("inf")
    for _ in range(3):
        start = time.process_time()
        said = job()
        least = min(least, time.process_time() - start)
    told[name] = [least, said]
print(json.dumps(told))
"""


def measured(checkout: Path, designs: Path) -> dict[str, tuple[float, str]]:
    """CPU seconds and digest of every job, run by the package in a checkout."""
    environment = {
        **os.environ,
        "PYTHONPATH": str(checkout),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }
    done = subprocess.run(
        [sys.executable, "-c", JOBS, str(designs)],
        env=environment,
        cwd=checkout,
        capture_output=True,
        text=True,
        check=True,
    )
    found: dict[str, tuple[float, str]] = json.loads(done.stdout)
    return found


def main() -> None:
    """Print the table."""
    old, new = Path(sys.argv[1]).resolve(), Path(__file__).resolve().parents[2]
    designs = old / "designs"
    least: dict[str, list[float]] = {}
    same: dict[str, bool] = {}
    for _ in range(TURNS):
        before, after = measured(old, designs), measured(new, designs)
        for name, (seconds, said) in before.items():
            row = least.setdefault(name, [float("inf"), float("inf")])
            row[0], row[1] = min(row[0], seconds), min(row[1], after[name][0])
            same[name] = said == after[name][1]
    print("| job | before / s | now / s | ratio | bytes |\n|---|---:|---:|---:|---|")
    for name, (one, other) in least.items():
        print(
            f"| {name} | {one:.3f} | {other:.3f} | {other / one:.2f} | {'the same' if same[name] else 'others'} |"
        )


if __name__ == "__main__":
    main()
