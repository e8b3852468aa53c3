"""The auto plan against all effects on three shipped scenes: python tests/benchmarks/effects_scenes.py [pixels].

Prints for each the difference of the two pictures (mean over blocks of 5 x 5 pixels of the absolute difference, over
the mean light), the seconds of both, and the effects the plan chose. Draws are random but fixed, so both pictures carry
noise of their own; blocks average it.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

from clacad.rendering import view_through
from clacad.scene import load_scene

SCENES = Path(__file__).parents[2] / "designs" / "scenes"
NAMES = ("effects-narrow", "effects-wide", "effects-unresolved")
EVERY = ["ghosts", "walls", "fresnel", "absorption", "dispersion", "reflections", "tir_paths", "diffraction",
         "scatter", "polarisation"]  # fmt: skip
BIN = 5


def compared(name: str, pixels: int) -> tuple[float, float, float, tuple[str, ...], str]:
    """Difference, seconds of the auto plan and of all effects, effects on, rung."""
    auto = load_scene(SCENES / f"{name}.toml", (f"camera.pixels=[{pixels},{pixels}]",))
    every = auto.replace({"effects.mode": "list", "effects.list": EVERY, "sheet.rung": "surfaces"})
    pictures, seconds = [], []
    for scene in (auto, every):
        start = time.process_time()
        pictures.append(view_through(scene, threads=1))
        seconds.append(time.process_time() - start)
    a, b = (binned(picture.light) for picture in pictures)
    plan = pictures[0].passage.plan
    return float(np.abs(a - b).mean() / b.mean()), *seconds, plan.names, plan.rung


def binned(light):
    """Means over blocks of pixels."""
    h, w, _ = light.shape
    return light.reshape(h // BIN, BIN, w // BIN, BIN, 3).mean(axis=(1, 3))


def main() -> None:
    pixels = int(sys.argv[1]) if len(sys.argv) > 1 else 40
    print(f"{'scene':20}{'difference':>11}{'auto s':>9}{'all s':>9}  effects on")
    for name in NAMES:
        error, fast, slow, names, rung = compared(name, pixels)
        print(f"{name:20}{error:10.2%} {fast:8.1f} {slow:8.1f}  {rung}: {', '.join(names) or 'none'}")


if __name__ == "__main__":
    main()
