"""Cost of a sheet whose cells all differ: window-100mm, round, aimed at an eye 400 mm away (29,512 cells an array).

    python tests/benchmarks/non_uniform.py [ROW ...] [--against OTHER_TREE]
    python tests/benchmarks/non_uniform.py --part volume|surfaces|law|thin|mesh

The first form is that of `calls.py`: processor seconds, wall clock, peak memory and bytes of whole commands, in turns with an
older tree. The second runs one call of the library and prints its own microseconds a ray (or seconds); the first form counts
its whole process.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from calls import Row, main
from own_cells import RAYS, light

HERE = Path(__file__).resolve()
AIMED = (
    "--set", "name=aimed", "--set", "lattice.outline={circle=100}", "--set", "lattice.aperture={point=[0,0,-400]}",
    "--set", "pair.surface=biconic", "--set", "pair.conic=[-0.7,-0.7]", "--set", "check.process=none",
)  # fmt: skip
"""The aimed window, as changes of designs/window-100mm.toml."""


def _keys(cells: int = 0, viewer: float = 400.0) -> tuple[str, ...]:
    """Changes of the design for `cells` x `cells` cells; 0: the window of 100 mm."""
    if not cells:
        return AIMED
    # the same lenses over more of the sheet: the eye is farther away
    viewer *= max(cells / 200.0, 1.0)
    size = (
        "--set",
        f"lattice.count=[{cells},{cells}]",
        "--set",
        f"lattice.aperture={{point=[0,0,{-viewer:g}]}}",
    )
    return (*AIMED[:2], *AIMED[6:], *size)


def _export(form: str, *options: str, cells: int = 0) -> Row:
    words = (
        "export",
        "designs/window-100mm.toml",
        *_keys(cells),
        "-o",
        "{out}",
        "--format",
        form,
        "-q",
        "--force",
    )
    return Row((*words, *options))


def _verify(given: str, cells: int = 0) -> Row:
    return Row(("verify", "designs/window-100mm.toml", *_keys(cells), "--files", "{given}", "-q"), given)


def _part(name: str) -> Row:
    return Row((str(HERE), "--part", name))


GROWTH = (10, 32, 100, 316, 548)
"""Cells along a side of the sheets that show how seconds and memory grow: 10² to 3·10⁵ classes."""

ROWS = {
    "check": Row(("check", "designs/window-100mm.toml", *AIMED, "-q")),
    "check printed": Row(("check", "designs/window-100mm.toml", *AIMED)),
    "dry run": _export("step,stl", "--dry-run"),
    "step": _export("step"),
    "step verify": _verify("step"),
    **{
        f"step{how}, {kind} {form}": _export(
            "step", "--set", f"lattice.kind={kind}", "--set", f"pair.form={form}", "--step", step
        )
        for kind, form in (("hexagonal", "slab"), ("hexagonal", "plano"), ("square", "plano"))
        for how, step in (("", "auto"), (" fused", "fused"))
    },
    "step fused": _export("step", "--step", "fused"),
    "step fused verify": _verify("step fused"),
    "stl 8": _export("stl", "--quads", "8"),
    "stl 8 verify": _verify("stl 8"),
    "3mf 8": _export("3mf", "--quads", "8"),
    "glb 16": _export("glb", "--quads", "16"),
    "ply 16": _export("ply", "--quads", "16"),
    "gds": _export("gds"),
    "tiff,xyz,sag": _export("tiff,xyz,sag"),
    **{part: _part(part) for part in ("volume", "surfaces", "law", "thin", "mesh")},
    "fused 40 x 40 of equal cells": Row(
        ("export", "designs/window-100mm.toml", "--cells", "40x40", "-o", "{out}", "--format", "step", "--step", "fused", "-q")
    ),
    "two glenses": Row(("render", "designs/scenes/glens-knight.toml", "-o", "{out}.png", "--overwrite", "-q")),
    **{f"step, {n * n} cells": _export("step", cells=n) for n in GROWTH},
    **{f"stl 4, {n * n} cells": _export("stl", "--quads", "4", cells=n) for n in GROWTH},
}  # fmt: skip
"""Name → what is run; a row whose name another row gives runs first."""


def part(name: str) -> str:
    """One call of the library on the aimed window: its own processor seconds, the second call of two."""
    import clacad

    keys = {
        "lattice.outline": {"circle": 100}, "lattice.aperture": {"point": [0, 0, -400]}, "pair.surface": "biconic",
        "pair.conic": [-0.7, -0.7], "check.process": "none",
    }  # fmt: skip
    window = clacad.prescribe(
        clacad.load(str(HERE.parents[2] / "designs" / "window-100mm.toml")).replace(keys)
    )
    if name == "volume":
        from clacad.sheet.volume_and_extent import body_volume

        began = time.process_time()
        body_volume(window, window.bodies[0])
        return f"volume {time.process_time() - began:.2f} s"
    rays = light(np.array([0.0, 0.0, -400.0]))
    options = {"rung": name, "threads": 1} | ({"mesh": 4} if name == "mesh" else {})
    seconds = []
    for _ in range(2):
        began = time.process_time()
        clacad.trace(window, rays, **options)
        seconds.append(time.process_time() - began)
    return f"{name} first {1e6 * seconds[0] / RAYS:.3f}, then {1e6 * seconds[1] / RAYS:.3f} us a ray"


if __name__ == "__main__":
    if "--part" in sys.argv:
        asked = argparse.ArgumentParser()
        asked.add_argument("--part", required=True)
        print(part(asked.parse_args().part))
    else:
        main(ROWS)
