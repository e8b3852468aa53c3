"""Error against seconds, log-log, with the Pareto front drawn."""

from __future__ import annotations

import io
from math import isfinite
from typing import Any

from clacad.accuracy.table import Row, Table

STYLE = {
    "law": ("#7a7a7a", "D"),
    "thin": ("#b07aa1", "s"),
    "surfaces": ("#1f4e79", "*"),
    "mesh": ("#e07b39", "o"),
    "step": ("#3a7d44", "P"),
}
"""Colour and marker of each rung; vertex normals are drawn hollow."""


def plot_svg(table: Table, target: float | None = None) -> str:
    """Picture of a table as SVG text, the same for the same table.

    Parameters
    ----------
    table : Table
    target : float or None, radians
        Drawn as a line.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with rc_context({"svg.hashsalt": "clacad", "font.size": 9.0, "svg.fonttype": "path"}):
        figure = Figure(figsize=(7.2, 4.8), layout="constrained")
        FigureCanvasSVG(figure)
        _draw(figure.add_subplot(), table, target)
        out = io.StringIO()
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": "clacad"})
    return out.getvalue()


def plot_png(table: Table, target: float | None = None) -> bytes:
    """The same picture as PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 4.8), layout="constrained", dpi=120)
    FigureCanvasAgg(figure)
    _draw(figure.add_subplot(), table, target)
    out = io.BytesIO()
    figure.savefig(out, format="png", metadata={"Software": "clacad"})
    return out.getvalue()


def _draw(axes: Any, table: Table, target: float | None) -> None:
    shown = [
        row for row in table.rows if isfinite(row.model_rms) and row.model_rms > 0.0 and row.seconds > 0.0
    ]
    for row in shown:
        colour, marker = STYLE[row.rung]
        hollow = row.normals == "vertex"
        axes.plot(
            row.seconds, 1e3 * row.model_rms, marker, color=colour, markersize=9 if marker == "*" else 6,
            markerfacecolor="white" if hollow else colour, alpha=0.55 if row.float == "f32" else 1.0,
        )  # fmt: skip
        if row.float == "f64":
            axes.annotate(_label(row), (row.seconds, 1e3 * row.model_rms), fontsize=7, xytext=(5, 3),
                          textcoords="offset points", color="#333333")  # fmt: skip
    front = [row for row in table.pareto() if row in shown]
    axes.plot(
        [r.seconds for r in front], [1e3 * r.model_rms for r in front], "-", color="#888888", lw=0.9, zorder=0
    )
    if target is not None:
        axes.axhline(1e3 * target, color="#b00020", lw=0.9, ls="--")
        axes.annotate(f"target {1e3 * target:g} mrad", (0.01, 1e3 * target), xycoords=("axes fraction", "data"),
                      fontsize=8, color="#b00020", xytext=(0, 3), textcoords="offset points")  # fmt: skip
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel(f"processor seconds for {table.rays:,} rays")
    axes.set_ylabel("rms direction error to the exact trace / mrad")
    axes.set_title(
        f"{table.design}: what accuracy costs (line: no other setting is better in both; hollow: vertex normals; "
        "pale: float32)", fontsize=8,
    )  # fmt: skip
    axes.grid(True, which="major", color="#dddddd", lw=0.6)


def _label(row: Row) -> str:
    return f"{row.quads}" if row.rung == "mesh" else row.rung
