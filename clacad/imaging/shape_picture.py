"""Picture of the requested light on a screen, next to the light of traced rays."""

from __future__ import annotations

from typing import Any

import numpy as np

from clacad.base.drawn_figure import drawn, no_formula
from clacad.imaging.shape import Rendered

SIZE = (9.6, 4.0)


def plot_png(seen: Rendered, name: str, unit: str) -> bytes:
    """Both pictures and their difference as PNG, reproducible for equal light; `unit` of the lengths."""
    return drawn("png", SIZE, lambda figure: _draw(figure, seen, name, unit), {"font.size": 8.0})


def _draw(figure: Any, seen: Rendered, name: str, unit: str) -> None:
    panels = figure.subplots(1, 3)
    x0, x1, y0, y1 = seen.corners
    most = float(np.quantile(seen.seen[seen.seen > 0.0], 0.98)) if seen.seen.any() else 1.0
    most = max(float(seen.target.max()), most)
    both = {"extent": (x0, x1, y0, y1), "interpolation": "nearest"}
    panels[0].imshow(seen.target, cmap="gray", vmin=0.0, vmax=most, **both)
    panels[1].imshow(seen.seen, cmap="gray", vmin=0.0, vmax=most, **both)
    panels[2].imshow(seen.seen - seen.target, cmap="RdBu_r", vmin=-most, vmax=most, **both)
    titles = (
        "asked, as wide as a cell",
        f"by rays: {100 * seen.within:.4g} % within one blur",
        f"by rays less asked: {100 * seen.difference:.3g} % elsewhere,\nof which lenses alone make {100 * seen.by_lenses:.3g}",
    )
    for panel, title in zip(panels, titles, strict=True):
        panel.set_title(title, fontsize=8)
        panel.set_xlabel(f"x / {unit}")
    panels[0].set_ylabel(f"y / {unit}, seen from behind the screen")
    figure.suptitle(no_formula(name), fontsize=10)
