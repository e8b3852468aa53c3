"""Draw the picture at the head of the README: two lens arrays, one telescopelet, two traced rays and their fates.

Usage: python tests/benchmarks/two_arrays.py [FILE]. Outlines are the design's own faces cut by y = 0, to scale; light
runs to the right.
"""

from __future__ import annotations

import sys
from html import escape
from pathlib import Path

import numpy as np

import clacad
from clacad.exporting.drawing.views import heights, outlines

CELLS, PITCH = 5, 3.0
SCALE, TOP, LEFT = 26.0, 36.0, 120.0
DESIGN = {
    "format": 1, "name": "two arrays", "unit": "mm",
    "law": {"eta": [-0.5, -0.5], "delta": [0.0, 0.0], "euler": [0.0, 0.0, 0.0]},
    "pair": {"form": "biconvex", "separation": 10.0, "index": 1.5},
    "lattice": {"kind": "square", "pitch": PITCH, "count": [CELLS, 1]},
}  # fmt: skip
STYLE = (
    "text{font:14px system-ui,sans-serif;fill:#333}.lens{fill:#bcd9ee;stroke:#3b6f9c}.pair{fill:#e7f0e4;stroke:#2b7a4b;"
    "stroke-dasharray:5 4}.ray,.ghost{fill:none;stroke:#c4483a;stroke-width:1.8}.ghost{stroke:#888;stroke-dasharray:6 3}"
)


def at(points: np.ndarray) -> str:
    """Points (k, 2) of x upwards and z to the right, mm, as SVG writes them."""
    half = 0.5 * CELLS * PITCH
    return " ".join(f"{LEFT + SCALE * (z + 4.0):.1f},{TOP + SCALE * (half - x):.1f}" for x, z in points)


def text(x: float, z: float, words: str, anchor: str = "middle") -> str:
    """Words at a point of the drawing."""
    left, top = at(np.array([[x, z]])).split(",")
    return f'<text x="{left}" y="{top}" text-anchor="{anchor}">{escape(words)}</text>'


def ray(window: clacad.Window, x: float, slope: float) -> str:
    """A ray that would meet z = 0 at x, from z = -3.5 mm, with its fate next to its end."""
    rays = clacad.Rays([[x - 3.5 * slope, 0.0, -3.5]], [[slope, 0.0, 1.0]])
    result = clacad.trace(window, rays, record=True)
    assert result.hits is not None
    end = result.position + 3.5 * result.direction
    path = np.vstack([rays.position, *result.hits, end])[:, [0, 2]]
    fate = clacad.Fate(result.fate[0]).name
    line = f'<polyline class="{"ray" if fate == "ALIVE" else "ghost"}" points="{at(path)}"/>'
    return line + text(path[-1, 0] - 0.15, path[-1, 1] + 0.3, f"fate {fate}", "start")


def picture() -> str:
    """The drawing as SVG."""
    window = clacad.prescribe(clacad.Design.from_dict(DESIGN))
    x = np.linspace(-0.5, 0.5, 401) * CELLS * PITCH * (1.0 - 1e-9)
    lenses = [shape for body in window.bodies for shape in outlines(x, *heights(window, body, x, 0.0))]
    low, high = window.z_range
    half = 0.5 * PITCH
    box = np.array([[half, low - 0.3], [half, high + 0.3], [-half, high + 0.3], [-half, low - 0.3]])
    top = 0.5 * CELLS * PITCH
    parts = [
        f'<polygon class="pair" points="{at(box)}"/>',
        *(f'<polygon class="lens" points="{at(shape)}"/>' for shape in lenses),
        ray(window, 0.5, -0.06), ray(window, -PITCH - 0.6, -0.3),
        text(top + 0.6, 0.0, "lens array 1"), text(top + 0.6, window.thin.offset[2], "lens array 2"),
        text(half + 0.2, 0.5 * (low + high), "one telescopelet"),
    ]  # fmt: skip
    body = "\n".join(parts)
    return f"""<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 760 460" width="760" height="460" role="img" \
aria-label="two lens arrays, one telescopelet, two rays">
<style>{STYLE}</style>
<rect width="100%" height="100%" fill="#fff"/>
{body}
</svg>
"""


if __name__ == "__main__":
    Path(sys.argv[1] if sys.argv[1:] else "exports/showcase/two-arrays.svg").write_text(
        picture(), encoding="utf-8"
    )
