"""The far field as waves and as rays, side by side along both lens axes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from clacad.base.drawn_figure import drawn, no_formula
from clacad.base.types import Floats
from clacad.waves.far_field import Marginal

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from clacad.waves.through_sheet import WaveReport

SIZE = (9.6, 4.2)
STYLE = {"font.size": 9.0, "svg.hashsalt": "clacad", "svg.fonttype": "path"}
INK, WAVES, IDEAL, RAYS = "#1c2733", "#1b6ca8", "#8b98a5", "#c2571a"

LOBES = 4.0
"""Widths λ/w that are shown on either side of the law, at least."""

BINS = 60
"""Of the rays."""


def picture(found: WaveReport, format: Literal["png", "svg"] = "png") -> bytes:
    """Draw light against the angle off the law, along lens x and lens y; the same bytes for the same numbers."""
    return drawn(format, SIZE, lambda figure: draw(figure, found), STYLE)


def draw(figure: Figure, found: WaveReport) -> None:
    """Draw on a figure that is given."""
    for k, axes in enumerate(figure.subplots(1, 2)):
        axis(axes, found, k)
    one = "one telescopelet" if found.cell is None else f"cell ({found.cell[0]}, {found.cell[1]})"
    figure.suptitle(
        no_formula(f"{found.design}: {one}'s far field at {1e9 * found.wavelength:.4g} nm, Fresnel number {min(found.fresnel):.3g}"),
        fontsize=10,
    )  # fmt: skip


def axis(axes: Axes, found: WaveReport, k: int) -> None:
    """Draw one lens axis, k = 0 or 1, on axes that are given."""
    rays = found.rays.off[:, k]
    reach = max(LOBES * found.slit[k], 1.2 * float(np.abs(rays).max(initial=0.0)))
    scale = found.slit[k]
    for far, name, colour, line in (
        (found.exact, "waves, exact surfaces", WAVES, "-"),
        (found.thin, "waves, ideal lenses", IDEAL, "--"),
    ):
        if far is not None:
            shown = _within(far.marginals[k], reach)
            axes.plot(1e3 * shown[0], scale * shown[1], line, color=colour, lw=1.3, label=name)
    counts, edges = np.histogram(rays, BINS, (-reach, reach))
    height = counts / max(1, len(rays)) / (edges[1] - edges[0]) * scale
    axes.stairs(height, 1e3 * edges, color=RAYS, fill=True, alpha=0.25, label="rays, exact surfaces")
    if height.max(initial=0.0) > 2.0:  # rays of a good pair stand in one place: let the waves be seen
        axes.set_ylim(0.0, 2.0)
    axes.axvline(0.0, color=INK, lw=0.6)
    axes.set_xlabel(f"off the law along lens {'xy'[k]} / mrad")
    axes.set_ylabel("light a λ/w")
    axes.legend(fontsize=7, loc="upper right")


def _within(one: Marginal, reach: float) -> tuple[Floats, Floats]:
    kept = np.abs(one.off) <= reach
    return one.off[kept], one.density[kept]
