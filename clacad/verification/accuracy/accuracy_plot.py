"""Error against seconds, log-log, with the Pareto front drawn."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from textwrap import wrap
from typing import Any

import numpy as np

from clacad.base.drawn_figure import drawn, no_formula
from clacad.base.text import mrad_text
from clacad.verification.accuracy.accuracy_row import AccuracyRow, AccuracyTable, pareto

SIZE = (10.4, 6.2)
AXES = (0.07, 0.3, 0.985, 0.9)
"""Left, bottom, right and top of both panels, parts of the figure; legends and conclusion lie below."""

LETTERS = 150
"""Letters in a line of the conclusion."""

Y_LABEL = "rms direction error to the exact trace (mrad)"

STYLE = {
    "law": ("#7a7a7a", "D"),
    "thin": ("#b07aa1", "s"),
    "surfaces": ("#1f4e79", "*"),
    "mesh": ("#e07b39", "o"),
    "step": ("#3a7d44", "P"),
}
"""Colour and marker of each rung; vertex normals are drawn hollow."""

FILE_SECONDS = (("write_s", "^", "write"), ("read_s", "v", "read"))
"""Seconds of a file, their marker and what it means."""

DOT, THIN, LETTER, TALL = 4.0, 1.5, 4.4, 8.0
"""Half a marker, half the room of a line, width of a letter and height of a label of 7 points, in points."""

OFFSETS = tuple(
    (dx, dy)
    for far in (6.0, 12.0)
    for dx, dy in (
        (far, -3.0),
        (-far, -3.0),
        (far, far - 2.0),
        (far, -far - 4.0),
        (-far, far - 2.0),
        (-far, -far - 4.0),
    )
)
"""Offsets (points) of a label's start (dx > 0) or end (dx < 0) from its point; the first free one is used."""

Box = tuple[float, float, float, float]


def plot_svg(table: AccuracyTable, target: float | None = None) -> str:
    """Picture of a table as SVG text; the same table gives the same text.

    target : float or None, radians. Error that is drawn as a line.
    """
    style = {"svg.hashsalt": "clacad", "font.size": 9.0, "svg.fonttype": "path"}
    return drawn("svg", SIZE, lambda figure: draw(figure, table, target), style, placed=True).decode()


def plot_png(table: AccuracyTable, target: float | None = None) -> bytes:
    """Picture of a table as PNG."""
    return drawn("png", SIZE, lambda figure: draw(figure, table, target), {"font.size": 9.0}, placed=True)


def draw(figure: Any, table: AccuracyTable, target: float | None = None) -> None:
    """Draw both panels, their legends below them, and the conclusion as the figure's caption."""
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    figure.subplots_adjust(*AXES, wspace=0.2)
    for axes in (left, right):
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.grid(True, which="major", color="#dddddd", lw=0.6)
        axes.set_ylabel(Y_LABEL)
        if target is not None:
            axes.axhline(
                1e3 * target, color="#b00020", lw=0.9, ls="--", label=f"target {mrad_text(target, 6)}"
            )
    _draw_seconds(left, table)
    _draw_floors(right, table)
    figure.suptitle(f"{no_formula(table.design)}: what accuracy costs", fontsize=10)
    caption = "\n".join(wrap(no_formula(table.conclusion), LETTERS))
    figure.text(0.5, 0.012, caption, ha="center", va="bottom", fontsize=8, color="#333333")


def _draw_seconds(axes: Any, table: AccuracyTable) -> None:
    """Draw error against seconds: every row, the front of all rows, and that of the meshes alone."""
    shown = [r for r in table.rows if isfinite(r.model_rms) and r.model_rms > 0.0 and r.seconds > 0.0]
    count = table.rays or 1
    for row in shown:
        colour, marker = STYLE[row.rung]
        axes.plot(
            count * row.seconds_per_ray,
            1e3 * row.model_rms,
            marker,
            color=colour,
            markersize=10 if marker == "*" else 5.5,
            markerfacecolor="white" if row.normals == "vertex" else colour,
            alpha=0.5 if row.float == "f32" else 1.0,
        )
    fronts = (
        (shown, "#444444", "-", "best of all settings"),
        ([r for r in shown if r.rung == "mesh"], "#e07b39", ":", "best of meshes"),
    )
    for key, marker, verb in FILE_SECONDS:
        unnamed = {"mesh": f"{verb} 5 x 5 cells, STL", "step": f"{verb} 5 x 5 cells, STEP"}
        for row in [row for row in shown if getattr(row, key)]:
            place, look = (
                (getattr(row, key), 1e3 * row.model_rms),
                {"color": STYLE[row.rung][0], "mfc": "white"},
            )
            axes.plot(*place, marker, ms=4.5, label=unnamed.pop(row.rung, None), **look)
    for rows, colour, line, name in fronts:
        best = pareto(rows)
        axes.plot(
            [count * r.seconds_per_ray for r in best],
            [1e3 * r.model_rms for r in best],
            line,
            color=colour,
            lw=1.1,
            zorder=0,
            label=f"{name} ({len(best)})",
        )
    axes.margins(0.08, 0.06)
    axes.set_xlabel(f"processor seconds for {count:,} rays, or for a file (s)")
    axes.set_title(
        "filled: facet normals; hollow: vertex normals; number: quads a cell side; pale: float32", fontsize=7
    )
    axes.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2, frameon=False)
    named = [row for row in shown if row.float == "f64" or row.rung == "surfaces"]
    label_points(axes, [(_label(row), (count * row.seconds_per_ray, 1e3 * row.model_rms)) for row in named])


def label_points(axes: Any, labels: Sequence[tuple[str, tuple[float, float]]]) -> None:
    """Write labels next to their points where they cover no point, line or label; omit those without room."""
    axes.set(xlim=axes.get_xlim(), ylim=axes.get_ylim())  # fix the view before positions are read from it
    scale = 72.0 / axes.figure.dpi
    taken = _drawn_boxes(axes, scale)
    low, high = (np.array(corner) * scale for corner in (axes.bbox.min, axes.bbox.max))
    for text, place in labels:
        x, y = (axes.transData.transform(place) * scale).tolist()
        wide = LETTER * len(text)
        for dx, dy in OFFSETS:
            left = x + dx if dx >= 0.0 else x + dx - wide
            here = (left, y + dy, left + wide, y + dy + TALL)
            inside = here[0] > low[0] and here[1] > low[1] and here[2] < high[0] and here[3] < high[1]
            if inside and not any(_overlap(here, other) for other in taken):
                taken.append(here)
                axes.annotate(
                    text,
                    place,
                    fontsize=7,
                    xytext=(left - x, dy),
                    textcoords="offset points",
                    color="#333333",
                )
                break


def _drawn_boxes(axes: Any, scale: float) -> list[Box]:
    """Boxes about the markers, texts and lines of a panel, in points; `scale` is points per pixel."""
    extents = [text.get_window_extent().extents * scale for text in axes.texts]
    found: list[Box] = [(float(a), float(b), float(c), float(d)) for a, b, c, d in extents]
    for line in axes.lines:
        at = line.get_transform().transform(line.get_xydata()) * scale
        half = DOT if line.get_linestyle() == "None" else THIN
        for start, end in zip(at, at[1:] if len(at) > 1 else at, strict=False):
            count = 2 + int(np.hypot(*(end - start)) / THIN)
            found += [
                (x - half, y - half, x + half, y + half) for x, y in np.linspace(start, end, count).tolist()
            ]
    return found


def _overlap(one: Box, other: Box) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def _draw_floors(axes: Any, table: AccuracyTable) -> None:
    """Draw error against quads per cell side, forecast and traced, for each way of storing a vertex."""
    found = [f for f in table.floors if f.floor is not None]
    colours = ("#1f4e79", "#b07aa1", "#3a7d44", "#e07b39", "#7a7a7a", "#b00020", "#8c6d31", "#17becf")
    grids = [2.0 ** (k / 4.0) for k in range(8, 57)]
    for one, colour in zip(found, colours, strict=False):
        axes.plot(
            grids,
            [1e3 * one.error(q) for q in grids],
            "--" if one.normals == "vertex" else "-",
            color=colour,
            lw=1.0,
            label=f"{one.formats}: {one.normals} normals",
        )
        axes.plot(
            [q for q, _, _ in one.confirmed], [1e3 * t for _, _, t in one.confirmed], "x", color=colour, ms=6
        )
        if one.best_quads is not None and one.best_quads <= grids[-1]:
            axes.plot(one.best_quads, 1e3 * one.floor, "o", color=colour, ms=4)
    axes.set_xlabel("quads a cell side (count)")
    axes.set_title("files: line: forecast; cross: traced; dot: least error", fontsize=7)
    if found:
        axes.legend(fontsize=6.5, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2, frameon=False)


def _label(row: AccuracyRow) -> str:
    if row.rung == "mesh":
        return f"{row.quads}"
    return f"{row.rung} float32" if row.float == "f32" else row.rung
