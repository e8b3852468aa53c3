"""The non-uniform sheet on the report's page: δ, η and steps of its cells, the worst ones, light of the object point."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.types import Floats
from clacad.imaging.best_point import spot_at
from clacad.imaging.image_by_rays import RungImage, image
from clacad.imaging.through_focus import heights, reach_of
from clacad.report.figures import ACCENT, SECOND, svg
from clacad.report.panels import Margins, panels
from clacad.sheet.own_steps import greatest_steps
from clacad.verification.check_kinds.light import LAW_RMS, THROUGHPUT
from clacad.verification.light.image_checks import RAYS, asked_image

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from clacad.sheet.window import Window
    from clacad.verification import Report

ROUNDING = 1e-6
"""Steps (micrometres) that are none."""

ACROSS = 400
"""Pixels along the longer side of a map."""


def varying(report: Report, window: Window) -> str:
    """Maps of δ and steps of cells, the worst ones ringed, light of the object point through focus; "" for a uniform sheet."""
    laws = window.cell_laws
    if laws is None:
        return ""
    mm = window.unit * 1e3
    maps = _maps(window)
    asked = asked_image(report.design)
    seen = None if asked is None else image(window, asked[0], ("surfaces",), RAYS).rungs[0]
    box = tuple(v * mm for v in window.lattice.extent())

    def draw(figure: Figure) -> None:
        room = Margins(left=0.75, bottom=0.62, top=0.3, across=1.35, down=0.75, right=0.85)
        axes = panels(figure, 2, 2, room).ravel()
        most = max(float(np.nanmax(np.abs(maps[:2]))), 1e-300)
        for k, axis in enumerate("xy"):
            shown = axes[k].imshow(maps[k], cmap="RdBu_r", vmin=-most, vmax=most, **_placed(box))
            axes[k].set_title(f"delta {axis}", fontsize=8.5)
            figure.colorbar(shown, ax=axes[k], fraction=0.05, pad=0.03)
        high = 1e3 * mm * maps[2]
        top = float(np.nanmax(high)) if np.nanmax(high) > ROUNDING else 1.0
        shown = axes[2].imshow(high, cmap="viridis", vmin=0.0, vmax=top, **_placed(box))
        axes[2].set_title("greatest step to the next cell (\N{MICRO SIGN}m)", fontsize=8.5)
        figure.colorbar(shown, ax=axes[2], fraction=0.05, pad=0.03)
        own_eta = laws.ratios is not None
        if own_eta:
            shown = axes[3].imshow(maps[3], cmap="viridis", **_placed(box))
            axes[3].set_title("eta", fontsize=8.5)
            figure.colorbar(shown, ax=axes[3], fraction=0.05, pad=0.03)
        for panel in axes[: 3 + own_eta]:
            panel.grid(False)
            panel.set_xlabel("x on the sheet (mm)")
            panel.set_ylabel("y on the sheet (mm)")
        if words := _named_cells(axes[2], report, window, mm):
            axes[2].set_xlabel(f"x on the sheet (mm)\nringed, the worst: {words}")
        if seen is not None and np.isfinite(seen.found.point).all():
            _through_focus(axes[3], seen, mm)
        elif not own_eta:
            axes[3].set_axis_off()

    return svg(
        7.6,
        6.0,
        "delta of each cell, steps between cells, and "
        + ("the light of the asked point through focus" if laws.ratios is None else "eta of each cell"),
        draw,
    )


def _placed(box: tuple[float, ...]) -> dict[str, Any]:
    """How a map lies on the sheet."""
    return {"extent": box, "origin": "lower", "interpolation": "nearest", "aspect": "equal"}


def _maps(window: Window) -> Floats:
    """δ_x, δ_y, the greatest step (length) and η_x at points over the sheet, (4, h, w); NaN where no cell is kept."""
    assert window.cell_laws is not None  # who calls this has looked
    x0, x1, y0, y1 = window.lattice.extent()
    pixel = max(x1 - x0, y1 - y0) / ACROSS
    width, height = (max(1, round((b - a) / pixel)) for a, b in ((x0, x1), (y0, y1)))
    x = np.linspace(x0, x1, width, endpoint=False) + 0.5 * (x1 - x0) / width
    y = np.linspace(y0, y1, height, endpoint=False) + 0.5 * (y1 - y0) / height
    across, up = (v.ravel() for v in np.meshgrid(x, y))
    index, _, _ = window.locate(0, across, up)
    cells, which = np.unique(index, axis=0, return_inverse=True)
    kept = window.lattice.contains(cells)
    found = np.full((4, len(cells)), np.nan)
    found[:2, kept] = window.cell_laws.deltas(window.lattice, cells[kept]).T
    steps = [greatest_steps(window, face, cells[kept]) for face in window.faces if face.array is not None]
    found[2, kept] = np.max(steps, axis=0)
    found[3, kept] = window.cell_laws.ratios_of(window.lattice, cells[kept])[:, 0]
    return found[:, which.ravel()].reshape(4, height, width)


def _named_cells(panel: Any, report: Report, window: Window, mm: float) -> str:
    """Ring the cells that checks of light name as the worst, with their names."""
    named: dict[tuple[int, int], list[str]] = {}
    for check in report.checks:
        cell = (check.detail or {}).get("cell")
        if cell is not None and check.where == "surfaces" and check.kind in (LAW_RMS, THROUGHPUT):
            named.setdefault((int(cell[0]), int(cell[1])), []).append(check.id)
    for cell in named:
        x, y = window.lattice.centres(np.array(cell)) * mm
        panel.plot(
            [x], [y], "o", ms=9, mfc="none", mec="#d62728", mew=1.4, clip_on=False, scalex=False, scaley=False
        )
    return "; ".join(f"cell {cell} by {', '.join(ids)}" for cell, ids in named.items())


def _through_focus(panel: Any, seen: RungImage, mm: float) -> None:
    """Rms width in x and y at heights about the image."""
    z = heights(seen, reach_of(seen))
    widths = np.array(
        [spot_at(seen.position, seen.direction, np.array([*seen.found.point[:2], h])) for h in z]
    )
    for k, colour, line in ((0, ACCENT, "-"), (1, SECOND, "--")):
        panel.plot(z * mm, widths[:, k] * mm, line, color=colour, lw=1.0, label=f"rms in {'xy'[k]}")
    panel.axvline(seen.predicted.point[2] * mm, color="#888888", lw=0.6, ls="--")
    panel.set_ylim(bottom=0.0)
    panel.set_xlabel("height (mm; dashed: by the law)")
    panel.set_title("light of the asked point (mm)", fontsize=8.5)
    panel.legend(fontsize=7)
