"""The pictures of README.md: views through the paper's sheets, 480 pixels across, 32 rays a pixel; the page with sliders.

    python tests/benchmarks/gallery.py
    python tests/benchmarks/gallery.py --no-views    the page and the far field alone

Right-handed, as through a part made from the design. WebP of quality 82: a tenth of the bytes of PNG.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from PIL import Image

import clacad
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


def main() -> None:
    """Make them all."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--no-views", action="store_true")
    window = clacad.load(WINDOW)
    clacad.explore(window, PAGE, overwrite=True)
    FAR_FIELD.write_bytes(clacad.wave(window).picture())
    if parser.parse_args().no_views:
        return
    VIEWS.mkdir(exist_ok=True)
    draw(*FIRST, VIEWS.parent / "view-phi-45.webp")
    for name in SCENES:
        draw(name, PIXELS, SAMPLES, VIEWS / f"{name}.webp")


if __name__ == "__main__":
    main()
