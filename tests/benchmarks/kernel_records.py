"""Two trees of the package against each other: python tests/benchmarks/kernel_records.py OLD NEW [rounds [caches]].

One process a tree, each with an empty cache of compiled code, does the same work turn by turn: the seconds of
processor that compiling took, the rates as ratios new over old (median and middle half of the rounds: a busy machine
slows both), and whether every number of every result is the same to the last bit. Exit status 1 where one is not. A
folder of caches is kept for the next run, which then reports nothing of compiling.
"""

from __future__ import annotations

import hashlib
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

RAYS = 200_000
"""Rays of a rate; the walk, the facets and the effects take a tenth."""

SAMPLE = 4_000
"""Rays of each window whose results are compared bit by bit."""

PIXELS = 400


def digest(result: Any) -> str:
    """All numbers of a result: of a dataclass of arrays, or of one array."""
    import numpy as np

    arrays = [result] if isinstance(result, np.ndarray) else [getattr(result, f.name) for f in fields(result)]
    total = hashlib.sha256()
    for array in arrays:
        if isinstance(array, np.ndarray):
            total.update(np.ascontiguousarray(array).tobytes())
    return total.hexdigest()[:16]


def picture(scene: Any) -> Any:
    """Light of a picture, one thread."""
    from clacad.rendering import view_through

    return view_through(scene, threads=1, compiled=True).light


def rates() -> dict[str, Callable[[], Any]]:
    """What is timed."""
    from fates import all_directions
    from oracle.windows import biconvex, slab
    from peer_jobs import beam
    from viewscenes import view_scene

    from clacad import tessellate, trace

    base = biconvex(count=(200, 200))
    hexagonal = biconvex(kind="hexagonal", eta=(-0.5, -0.7), thickness=0.0012, count=(200, 200))
    tilted, plate = biconvex(euler=(0.0, 0.1, 0.0), count=(200, 200)), slab()
    inner, anywhere = beam(base, RAYS, 0.001, 0.4), beam(base, RAYS, 0.005, 1.0)
    few = beam(base, RAYS // 10, 0.005, 0.4)
    mesh = tessellate(base, quads=16)
    wild = all_directions(base, RAYS // 10, 1)
    turned, plain = beam(tilted, RAYS, 0.001, 0.4), beam(hexagonal, RAYS, 0.005, 1.0)
    land = biconvex(web=0.0006, count=(60, 60))
    scattered = all_directions(land, RAYS // 10, 2)

    def by(window: Any, rays: Any, *effects: str, **words: Any) -> Callable[[], Any]:
        return lambda: trace(window, rays, effects=effects, path="numba", threads=1, **words)

    return {
        "straight path, in-cell": by(base, inner),
        "chunk, anywhere on the array": by(base, anywhere),
        "chunk, single precision": by(base, anywhere, precision="float32"),
        "straight path, tilted": by(tilted, turned),
        "straight path, hexagons": by(hexagonal, plain),
        "slab": by(plate, beam(plate, RAYS, 0.005, 0.6)),
        "walk, every direction": by(base, wild),
        "walk, lands": by(land, scattered),
        "mesh": by(base, few, rung="mesh", mesh=mesh),
        "mesh, walk": by(base, wild, rung="mesh", mesh=mesh),
        "effects": by(base, few, "fresnel", "absorption", "polarisation"),
        "camera picture": lambda: picture(view_scene("phi_45", PIXELS, "surfaces")),
    }


def answers() -> dict[str, Callable[[], Any]]:
    """What is compared bit by bit."""
    import numpy as np
    from fates import all_directions, windows
    from viewscenes import view_scene

    from clacad import tessellate, trace
    from clacad.tracing.facets.triangle_soup import TriangleSoup

    def exact(window: Any, seed: int, record: bool) -> Any:
        rays = all_directions(window, SAMPLE, seed)
        return trace(window, rays, path="numba", threads=1, record=record)

    def facets(window: Any, seed: int, normals: str) -> Any:
        made: Any = tessellate(window, quads=8)
        if normals == "soup":
            made, normals = TriangleSoup(np.concatenate([t for b in made.bodies for t in b.rows()])), "facet"
        rays = all_directions(window, SAMPLE // 4, seed)
        return trace(window, rays, rung="mesh", mesh=made, normals=normals, threads=1)

    def lossy(window: Any, seed: int) -> Any:
        rays = all_directions(window, SAMPLE, seed)
        return trace(window, rays, effects=("fresnel", "absorption", "polarisation"), path="numba", threads=1)

    found: dict[str, Callable[[], Any]] = {}
    for k, (name, window) in enumerate(windows().items()):
        found[f"{name}"] = lambda w=window, k=k: exact(w, k, True)
        found[f"{name}, effects"] = lambda w=window, k=k: lossy(w, k)
        if k % 4 == 0:
            found[f"{name}, facets"] = lambda w=window, k=k: facets(w, k, "facet")
            found[f"{name}, vertex normals"] = lambda w=window, k=k: facets(w, k, "vertex")
            found[f"{name}, triangles"] = lambda w=window, k=k: facets(w, k, "soup")
    for view in ("base", "eta_x_-1", "phi_45", "phi_45_theta_0.5_psi_90"):
        found[f"picture {view}"] = lambda v=view: picture(view_scene(v, 120, "surfaces"))
    return found


def serve(tree: str) -> None:
    """Do the work that the lines of the standard input request, in one tree; seconds of processor, or a digest, a line."""
    sys.path[:0] = places(tree)
    known, compared = rates(), answers()
    for line in sys.stdin:
        what, name = line.rstrip("\n").split("\t")
        start = time.process_time()
        try:
            result = (known if what == "rate" else compared)[name]()
            spent = time.process_time() - start
            print(f"{spent:.9f}" if what == "rate" else digest(result), flush=True)
        except Exception as problem:
            print(f"failed: {type(problem).__name__} {problem}".replace("\n", " ")[:200], flush=True)


def places(tree: str) -> list[str]:
    """Where a tree keeps what is imported here."""
    return [tree, str(Path(tree) / "tests"), str(Path(tree) / "tests" / "benchmarks")]


class Tree:
    """A tree's process."""

    def __init__(self, place: str, cache: str) -> None:
        """Start it with a cache of its own."""
        spoken = {**os.environ, "NUMBA_CACHE_DIR": cache, "PYTHONPATH": place}
        self.process = subprocess.Popen(
            [sys.executable, __file__, "--serve", place], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            text=True, env=spoken, cwd=place,
        )  # fmt: skip

    def ask(self, what: str, name: str) -> str:
        """Give its answer."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(f"{what}\t{name}\n")
        self.process.stdin.flush()
        return self.process.stdout.readline().strip()


def main(arguments: list[str]) -> int:
    """Measure and print; 1 where a bit differs."""
    old, new = (str(Path(a).resolve()) for a in arguments[:2])
    rounds = int(arguments[2]) if len(arguments) > 2 else 9
    sys.path[:0] = places(old)
    names, questions = list(rates()), list(answers())
    with tempfile.TemporaryDirectory() as folder:
        kept = arguments[3] if len(arguments) > 3 else folder
        trees = [Tree(place, f"{kept}/{k}") for k, place in enumerate((old, new))]
        first = [[float(tree.ask("rate", name)) for name in names] for tree in trees]
        print(f"compile and first run: old {sum(first[0]):.1f} s, new {sum(first[1]):.1f} s of processor")
        differing = 0
        for question in questions:
            one, two = (tree.ask("bits", question) for tree in trees)
            if one != two:
                differing += 1
                print(f"  differs: {question}: {one} {two}")
        print(f"{len(questions) - differing} of {len(questions)} results the same to the last bit")
        ratios: dict[str, list[float]] = {name: [] for name in names}
        for turn in range(rounds):
            for name in names:
                order = trees if turn % 2 else trees[::-1]
                spent = {id(tree): float(tree.ask("rate", name)) for tree in order}
                ratios[name].append(spent[id(trees[0])] / spent[id(trees[1])])
        print("rate, new over old: median (middle half)")
        for name, each in ratios.items():
            low, _, high = statistics.quantiles(each, n=4)
            print(f"  {name:32}{statistics.median(each):6.3f}  ({low:.3f} to {high:.3f})")
    return int(differing > 0)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--serve"]:
        serve(sys.argv[2])
        sys.exit(0)
    sys.exit(main(sys.argv[1:]))
