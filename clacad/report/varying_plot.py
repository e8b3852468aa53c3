"""The sheet whose law varies, on the report's page: δ of its cells, and the light of the asked point through focus."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clacad.imaging.best_point import spot_at
from clacad.imaging.image_by_rays import RungImage, image
from clacad.imaging.through_focus import heights, reach_of
from clacad.report.figures import ACCENT, SECOND, svg
from clacad.report.panels import Margins, panels
from clacad.verification.light.image_checks import RAYS, asked_image

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from clacad.design import Design
    from clacad.sheet.window import Window

MOST_CELLS = 40_000
"""Cells that the map shows; of more, some spread over the sheet."""


def varying(design: Design, window: Window) -> str:
    """Map of δ, and the width of the image through focus where the design is made to image; "" where all cells are alike."""
    laws = window.cell_laws
    if laws is None:
        return ""
    cells = window.lattice.cells()
    cells = cells[np.linspace(0, len(cells), min(len(cells), MOST_CELLS), endpoint=False).astype(np.int64)]
    deltas, mm = laws.deltas(window.lattice, cells), window.unit * 1e3
    x, y = window.lattice.centres(cells).T * mm
    asked = asked_image(design)
    seen = None if asked is None else image(window, asked[0], ("surfaces",), RAYS).rungs[0]
    focused = seen is not None and np.isfinite(seen.found.point).all()

    def draw(figure: Figure) -> None:
        axes = panels(figure, 1, 3 if focused else 2, Margins(top=0.3, across=0.75, right=0.6))
        most = float(np.abs(deltas).max()) or 1.0
        for k, axis in enumerate("xy"):
            shown = axes[k].scatter(x, y, c=deltas[:, k], s=max(0.05, 3000.0 / len(x)), marker="s", cmap="RdBu_r", vmin=-most,
                                    vmax=most, linewidths=0, rasterized=True)  # fmt: skip
            axes[k].set_title(f"delta {axis}", fontsize=8.5)
            axes[k].set_aspect("equal")
            axes[k].set_xlabel("x on the sheet (mm)")
            axes[k].grid(False)
        axes[0].set_ylabel("y on the sheet (mm)")
        figure.colorbar(shown, ax=axes[1], shrink=0.9, fraction=0.05, pad=0.03)
        if seen is not None and focused:
            _through_focus(axes[2], seen, mm)

    return svg(7.6, 3.0, "delta of each cell, and the light of the asked point through focus", draw)


def _through_focus(panel: object, seen: RungImage, mm: float) -> None:
    """Rms width in x and y at heights about the image."""
    from typing import Any, cast

    axes = cast(Any, panel)
    z = heights(seen, reach_of(seen))
    widths = np.array(
        [spot_at(seen.position, seen.direction, np.array([*seen.found.point[:2], h])) for h in z]
    )
    for k, colour in ((0, ACCENT), (1, SECOND)):
        axes.plot(z * mm, widths[:, k] * mm, color=colour, lw=1.0, label=f"rms in {'xy'[k]}")
    axes.axvline(seen.predicted.point[2] * mm, color="#888888", lw=0.6, ls="--")
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("height (mm; dashed: by the law)")
    axes.set_title("light of the asked point (mm)", fontsize=8.5)
    axes.legend(fontsize=7)
