"""The pictures of README.md: views through the paper's sheets, 480 pixels across, 32 rays a pixel; the page with sliders.

    python tests/benchmarks/gallery.py
    python tests/benchmarks/gallery.py --no-views    the page and the far field alone
    python tests/benchmarks/gallery.py --wide        docs/_static/wide-field.webp alone

Right-handed, as through a part made from the design. WebP of quality 82: a tenth of the bytes of PNG.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image

import clacad
from clacad.design import template
from clacad.rendering import view_through
from clacad.rendering.picture_files import pixels_of
from clacad.scene import load_scene

ROOT = Path(__file__).parents[2]
VIEWS = ROOT / "exports/showcase/views"
SCENES = (
    "fig3-z-m2", "fig3-z-2", "fig3-z-8", "fig2-eta-1", "fig4-delta-0.005-0.01", "fig5-phi-26.57", "fig5-phi-45", "fig6-theta-0.25",
    "fig8-z-60",
)  # fmt: skip
PIXELS, SAMPLES, QUALITY = 480, 32, 82
FIRST = ("fig5-phi-45", 640, 64)
"""The picture before the first command: scene, pixels across, rays a pixel."""
WINDOW = ROOT / "designs/window-100mm.toml"
PAGE, FAR_FIELD = VIEWS.parent / "explorer.html", VIEWS.parent / "wave.png"


def draw(name: str, pixels: int, samples: int, file: Path) -> None:
    """Render one scene into a file."""
    began = time.process_time()
    changes = ("camera.mirror=false", f"camera.pixels=[{pixels},{pixels}]", f"camera.samples={samples}")
    made = view_through(load_scene(ROOT / "designs/scenes" / f"{name}.toml", changes))
    Image.fromarray(pixels_of(made)).save(file, quality=QUALITY, method=6)
    print(f"{file.relative_to(ROOT)}: {file.stat().st_size} bytes, {time.process_time() - began:.0f} s")


WIDE = ROOT / "docs/_static/wide-field.webp"
WIDE_PIXELS, WIDE_SAMPLES, AWAY, BEHIND = 180, 12, 1500.0, 100.0
TODAY = """format = 1
name = "field-lens-10deg"
unit = "mm"
law = {eta = [-1, -1]}
pair = {form = "slab", separation = 2.836, field_lens = true, material = "PMMA", wavelength = 546.1}
lattice = {pitch = 0.5, count = [400, 400]}
"""
"""A slab with field lenses at the focus whose cells hold a cone of 10 degrees, 200 mm wide."""
SCENE = """format = 1
name = "wide-field"
unit = "mm"
sheet = {design = "%s", rung = "surfaces", surround = "opaque", set = {"lattice.count" = [400, 400]}}
camera = {position = [%r, 0, %r], target = [0, 0, %r], frame = 96, pixels = %d, samples = %d}
light = {ambient = 0.5, key = 0.55, direction = [-0.5, 0.6, -0.6]}
background = {sky = ["#22303c", "#22303c"], ground = "#22303c"}
effects = {mode = "list", list = ["ghosts"]}
object = [
  {id = "knight", kind = "mesh", file = "chess-knight.stl", at = [0, -30, %r], size = 66, colour = "#e6d3a3"},
  {id = "ruler", kind = "screen", at = [0, -38, %r], size = [84, 9], pattern = "stripes", period = 4},
]
"""


def wide_field(file: Path) -> None:
    """Real images in front of 200 mm sheets of eta -1, from -8, 0 and 8 degrees: field lenses; below, three plates with an opaque line.

    The outer columns of a picture are seen 10 degrees off the normal.
    """
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copy(ROOT / "designs/chess-knight.stl", folder)
        (folder / "today.toml").write_text(TODAY)
        three = template("three", "three-plates-10deg")
        line = '[lattice]\nline = {face = 1, width = "12 um"}'
        (folder / "three.toml").write_text(three.replace("[lattice]", line))
        for design in ("today.toml", "three.toml"):
            views = []
            for angle in np.radians([-8.0, 0.0, 8.0]):
                x, z = float(AWAY * np.sin(angle)), float(-BEHIND - AWAY * np.cos(angle))
                numbers = (design, x, z, -BEHIND, WIDE_PIXELS, WIDE_SAMPLES, BEHIND, BEHIND)
                (folder / "scene.toml").write_text(SCENE % numbers)
                views.append(pixels_of(view_through(load_scene(folder / "scene.toml"))))
            rows.append(np.concatenate(views, axis=1))
    Image.fromarray(np.concatenate(rows)).save(file, quality=QUALITY, method=6)


def main() -> None:
    """Make them all."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--no-views", action="store_true")
    parser.add_argument("--wide", action="store_true")
    if parser.parse_args().wide:
        wide_field(WIDE)
        return
    window = clacad.load(WINDOW)
    clacad.explore(window, PAGE, overwrite=True)
    FAR_FIELD.write_bytes(clacad.wave(window).picture())
    if parser.parse_args().no_views:
        return
    VIEWS.mkdir(exist_ok=True)
    draw(*FIRST, VIEWS.parent / "view-phi-45.webp")
    for name in SCENES:
        draw(name, PIXELS, SAMPLES, VIEWS / f"{name}.webp")
    wide_field(WIDE)


if __name__ == "__main__":
    main()
