"""Error against seconds, log-log, with the Pareto front drawn."""

from __future__ import annotations

from math import isfinite
from typing import Any

from clacad.base.drawn_figure import drawn
from clacad.verification.accuracy.error_and_seconds import AccuracyRow, AccuracyTable, pareto

SIZE = (9.6, 4.6)

STYLE = {
    "law": ("#7a7a7a", "D"),
    "thin": ("#b07aa1", "s"),
    "surfaces": ("#1f4e79", "*"),
    "mesh": ("#e07b39", "o"),
    "step": ("#3a7d44", "P"),
}
"""Colour and marker of each rung; vertex normals are drawn hollow."""


def plot_svg(table: AccuracyTable, target: float | None = None) -> str:
    """Picture of a table as SVG text, the same for the same table.

    Parameters
    ----------
    table : AccuracyTable
    target : float or None, radians
        Drawn as a line.
    """
    style = {"svg.hashsalt": "clacad", "font.size": 9.0, "svg.fonttype": "path"}
    return drawn("svg", SIZE, lambda figure: _draw(figure, table, target), style).decode()


def plot_png(table: AccuracyTable, target: float | None = None) -> bytes:
    """The same picture as PNG."""
    return drawn("png", SIZE, lambda figure: _draw(figure, table, target), {"font.size": 9.0})


def _draw(figure: Any, table: AccuracyTable, target: float | None) -> None:
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    _draw_seconds(left, table)
    _draw_floors(right, table)
    for axes in (left, right):
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.grid(True, which="major", color="#dddddd", lw=0.6)
        if target is not None:
            axes.axhline(1e3 * target, color="#b00020", lw=0.9, ls="--")
    if target is not None:
        left.annotate(f"target {1e3 * target:g} mrad", (0.01, 1e3 * target), xycoords=("axes fraction", "data"),
                      fontsize=8, color="#b00020", xytext=(0, 3), textcoords="offset points")  # fmt: skip
    figure.suptitle(f"{table.design}: what accuracy costs", fontsize=10)


def _draw_seconds(axes: Any, table: AccuracyTable) -> None:
    """Error against seconds: every row, the front of all rows, and that of the meshes alone."""
    shown = [r for r in table.rows if isfinite(r.model_rms) and r.model_rms > 0.0 and r.seconds > 0.0]
    count = table.rays or 1
    for row in shown:
        colour, marker = STYLE[row.rung]
        hollow = row.normals == "vertex"
        at = (count * row.seconds_per_ray, 1e3 * row.model_rms)
        axes.plot(
            *at, marker, color=colour, markersize=10 if marker == "*" else 5.5,
            markerfacecolor="white" if hollow else colour, alpha=0.5 if row.float == "f32" else 1.0,
        )  # fmt: skip
        if row.float == "f64" or row.rung == "surfaces":
            axes.annotate(
                _label(row), at, fontsize=7, xytext=(5, 4), textcoords="offset points", color="#333333"
            )
    fronts = (
        (shown, "#444444", "-", "best of all"),
        ([r for r in shown if r.rung == "mesh"], "#e07b39", ":", "best of meshes"),
    )
    for rows, colour, line, name in fronts:
        best = pareto(rows)
        axes.plot(
            [count * r.seconds_per_ray for r in best], [1e3 * r.model_rms for r in best], line, color=colour, lw=1.1, zorder=0,
            label=f"{name} ({len(best)})",
        )  # fmt: skip
    best = pareto(shown)
    axes.plot([count * r.seconds_per_ray for r in best], [1e3 * r.model_rms for r in best], "o", mfc="none",
              mec="#444444", markersize=15, lw=1.0)  # fmt: skip
    axes.legend(fontsize=7, loc="center right")
    axes.set_xlabel(f"processor seconds for {count:,} rays")
    axes.set_ylabel("rms direction error to the exact trace / mrad")
    axes.set_title(
        "filled: facet normals; hollow: vertex normals; number: quads a cell side; pale: float32", fontsize=7
    )


def _draw_floors(axes: Any, table: AccuracyTable) -> None:
    """Error against quads a cell side, as forecast for each way of holding a vertex, and as traced."""
    found = [f for f in table.floors if f.floor is not None]
    colours = ("#1f4e79", "#b07aa1", "#3a7d44", "#e07b39", "#7a7a7a", "#b00020", "#8c6d31", "#17becf")
    grids = [2.0 ** (k / 4.0) for k in range(8, 57)]
    for one, colour in zip(found, colours, strict=False):
        axes.plot(grids, [1e3 * one.error(q) for q in grids], "--" if one.normals == "vertex" else "-", color=colour,
                  lw=1.0, label=f"{one.formats}: {one.normals} normals")  # fmt: skip
        axes.plot(
            [q for q, _, _ in one.confirmed], [1e3 * t for _, _, t in one.confirmed], "x", color=colour, ms=6
        )
        if one.best_quads is not None and one.best_quads <= grids[-1]:
            axes.plot(one.best_quads, 1e3 * one.floor, "o", color=colour, ms=4)
    axes.set_xlabel("quads a cell side")
    axes.set_title("where it stops paying: dot: least; cross: traced", fontsize=7)
    if found:
        axes.legend(fontsize=6, loc=(0.03, 0.33))


def _label(row: AccuracyRow) -> str:
    if row.rung == "mesh":
        return f"{row.quads}"
    return f"{row.rung} float32" if row.float == "f32" else row.rung
