"""What compiling takes, kernel by kernel: python tests/benchmarks/kernel_compile.py [WORD | --main-job].

Each kernel in a process of its own with an empty cache, then again with the cache it left: seconds of processor of the
first call, of loading, memory at the peak, and which calls of a user need it. WORD picks rows. With --main-job the main job
of the README runs on an empty cache, and each kernel that it compiles is reported.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[2]

PREPARE = """
import resource, sys, time
sys.path[:0] = [{tests!r}, {tests!r} + "/benchmarks"]
import numpy as np
from oracle.windows import biconvex
from peer_jobs import beam
from viewscenes import view_scene
from clacad import Tracer, tessellate, trace
from clacad.rendering import view_through
from clacad.tracing.facets.triangle_soup import TriangleSoup
window = biconvex(count=(20, 20))
rays = beam(window, 1000, 0.001, 0.4)
mesh = tessellate(window, quads=4)
soup = TriangleSoup(np.concatenate([rows for body in mesh.bodies for rows in body.rows()]))
scene = view_scene("phi_45", 60, "surfaces")
began = time.process_time()
{call}
spent = time.process_time() - began
print(spent, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""

TRACE = "trace(window, rays, threads=1, "
KERNELS = {
    "surfaces": (TRACE + 'path="numba")', "trace of 750,000 rays or more; accuracy; scenes with many rays"),
    "mesh": (TRACE + 'rung="mesh", mesh=mesh)', "rung mesh with the sheet's own mesh; accuracy"),
    "triangles": (TRACE + 'rung="mesh", mesh=soup)', "rung mesh with a file"),
    "float32": (TRACE + 'precision="float32")', 'precision="float32"; accuracy'),
    "law": (TRACE + 'rung="law", path="numba")', "rung law, many rays"),
    "thin": (TRACE + 'rung="thin", path="numba")', "rung thin, many rays"),
    "sums of law's rays (with law)": (
        'Tracer(window, "law", path="numba", threads=1).sums(rays)', "Tracer.sums, whatever the rung"
    ),
    "losses (with surfaces)": (
        TRACE + 'effects=("fresnel", "absorption", "polarisation"), path="numba")', "effects, many rays"
    ),
    "picture": ("view_through(scene, threads=1, compiled=True)", "pictures of more than 250,000 rays"),
}  # fmt: skip


def measured(call: str, cache: str) -> tuple[float, float]:
    """Seconds of processor of the first call of a process, and its peak of memory in MB."""
    source = PREPARE.format(tests=str(ROOT / "tests"), call=call)
    told = subprocess.run(
        [sys.executable, "-c", source], env={**os.environ, "NUMBA_CACHE_DIR": cache, "PYTHONPATH": str(ROOT)},
        check=True, capture_output=True, text=True,
    ).stdout.split()  # fmt: skip
    return float(told[-2]), float(told[-1]) / 1e3


WATCHED = """
import atexit, json, sys, time
from numba.core import event
from clacad.cli.entry_point import main
stack, found = [], {{}}
class Listener(event.Listener):
    def on_start(self, one):
        stack.append((str(one.data["dispatcher"].py_func.__qualname__), time.process_time()))
    def on_end(self, one):
        name, began = stack.pop()
        if not stack:
            found[name] = found.get(name, 0.0) + time.process_time() - began
event.register("numba:compile", Listener())
atexit.register(lambda: open({told!r}, "w").write(json.dumps([found, time.process_time()])))
sys.exit(main({words!r}))
"""


def main_job() -> None:
    """Print what the export and the verification of the README compile on an empty cache, and take in all."""
    design = str(ROOT / "designs" / "paper-a-covered.toml")
    print("| kernel | compiling, s | who asks for it |\n|---|---|---|")
    with tempfile.TemporaryDirectory() as place:
        out, told = Path(place, "paper"), Path(place, "told.json")
        words = ("--format", "step,3mf,stl", "--quads", "3mf=auto,stl=4", "--role", "stl=preview", "-q")
        jobs = {
            "export": ["export", design, "-o", str(out), *words],
            "verify": ["verify", design, "--files", str(out), "-o", str(out / "report"), "-q"],
        }
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(Path(place, "kernels")), "PYTHONPATH": str(ROOT)}
        total = 0.0
        for job, arguments in jobs.items():
            program = WATCHED.format(told=str(told), words=arguments)
            subprocess.run([sys.executable, "-c", program], env=environment, check=True)
            found, took = json.loads(told.read_text())
            for name, seconds in sorted(found.items(), key=lambda pair: -pair[1]):
                print(f"| {name} | {seconds:.2f} | {job} |")
            print(f"| all of {took:.1f} s | {sum(found.values()):.2f} | {job} |", flush=True)
            total += sum(found.values())
        print(f"| the job | {total:.2f} | |")


def main(word: str = "") -> None:
    """Print the table."""
    if word == "--main-job":
        main_job()
        return
    print("| kernel | compiling, s | loading, s | memory, MB | who asks for it |\n|---|---|---|---|---|")
    for name, (call, who) in KERNELS.items():
        if word in name:
            with tempfile.TemporaryDirectory() as cache:
                (first, memory), (loading, _) = measured(call, cache), measured(call, cache)
            print(f"| {name} | {first:.1f} | {loading:.2f} | {memory:.0f} | {who} |", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:2])
