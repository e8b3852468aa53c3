"""Plots of studies and sweeps; the same numbers give the same bytes."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil, isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.drawn_figure import drawn
from clacad.verification.tolerance.parameter_sweep import Sweep
from clacad.verification.tolerance.study import RANKED, Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WORDS = {
    "image_shift": ("image shift / mrad", 1e3), "moire_rate": ("moiré: slip of array 2 / 1e-6", 1e6),
    "residual_power": ("residual power / dioptres", 1.0), "blur": ("blur, rms / mrad", 1e3),
    "throughput": ("throughput", 1.0), "law_rms": ("law error, rms / mrad", 1e3),
    "law_bias": ("law bias / mrad", 1e3),
}  # fmt: skip
"""Title and factor of each measure that is drawn."""

SHOWN = 8
"""Contributors drawn for each measure."""

SWEPT = ("law_rms", "law_bias", "blur", "throughput", "residual_power")

BAR, LINE, LIMIT = "#1f4e79", "#e07b39", "#b00020"


def plot_tolerances(study: Study) -> bytes:
    """Draw the ranked contributors of each measure, and its distribution over the Monte-Carlo sheets, as PNG."""
    return _png((11.0, 9.6), lambda figure: _draw_study(figure, study))


def plot_sweep(found: Sweep) -> bytes:
    """Draw measures as PNG: over one key as lines, over two as maps, over more against the first, one line each."""
    if len(found.axes) == 2:
        return _png((11.0, 6.4), lambda figure: _draw_maps(figure, found))
    return _png((11.0, 6.4), lambda figure: _draw_lines(figure, found))


def _png(size: tuple[float, float], draw: Callable[[Figure], None]) -> bytes:
    return drawn("png", size, draw, {"font.size": 8.5, "axes.titlesize": 9.0})


def _draw_study(figure: Figure, study: Study) -> None:
    share, low, high = study.yields()
    figure.suptitle(
        f"{study.name}: {len(study.measures)} sheets, {100 * share:.1f} % good "
        f"(95 %: {100 * low:.1f} to {100 * high:.1f}); bars: largest change over each tolerance alone",
        fontsize=10,
    )
    axes = figure.subplots(4, 3).ravel()
    limits = {limit.measure: limit.value for limit in study.limits}
    for place, measure in enumerate(RANKED):
        row, column = divmod(place, 3)
        _draw_ranking(axes[6 * row + column], study, measure)
        _draw_histogram(axes[6 * row + 3 + column], study, measure, limits.get(measure))


def _draw_ranking(axes: Any, study: Study, measure: str) -> None:
    title, factor = WORDS[measure]
    ranked = study.ranking(measure)
    worst = max((c for _, c, _ in ranked if isfinite(c)), default=0.0)
    rows = [(n, c) for n, c, _ in ranked if isfinite(c) and c > 0.01 * worst][:SHOWN][::-1]
    axes.barh([name for name, _ in rows], [factor * change for _, change in rows], color=BAR)
    axes.set_title(title, loc="left")
    axes.margins(y=0.02)


def _draw_histogram(axes: Any, study: Study, measure: str, limit: float | None) -> None:
    title, factor = WORDS[measure]
    column = factor * study.column(measure)
    column = column[np.isfinite(column)]
    if len(column):
        axes.hist(column, bins=min(40, max(8, len(column) // 8)), color="#9db7d1")
    if isfinite(study.nominal[measure]):
        axes.axvline(factor * study.nominal[measure], color=LINE, lw=1.2, label="as designed")
    if limit is not None:
        axes.axvline(factor * limit, color=LIMIT, lw=1.2, ls="--", label="limit")
    axes.set_ylabel("sheets")
    axes.legend(fontsize=7, frameon=False)


def _numbers(values: tuple[Any, ...]) -> list[float]:
    """Positions of the values of a key on an axis: the values where they are numbers, else 0, 1, 2 …"""
    texts = [str(v).split(" ")[0] if isinstance(v, str) else v for v in values]
    try:
        return [float(t) for t in texts]
    except (TypeError, ValueError):
        return [float(k) for k in range(len(values))]


def _label(axis: tuple[str, tuple[Any, ...]]) -> str:
    unit = {str(v).partition(" ")[2] for v in axis[1] if isinstance(v, str)}
    return axis[0] + (f" / {unit.pop()}" if len(unit) == 1 and unit != {""} else "")


def _draw_lines(figure: Figure, found: Sweep) -> None:
    """Draw each measure against the first key, one line for each combination of the others."""
    figure.suptitle(f"{found.name}: {len(found.rows)} points", fontsize=10)
    first, *others = found.axes
    at = _numbers(first[1])
    size = len(found.rows) // len(at)
    axes = figure.subplots(2, ceil(len(SWEPT) / 2)).ravel()
    for panel, measure in zip(axes, SWEPT):
        title, factor = WORDS[measure]
        table = np.array([row[measure] for row in found.rows], dtype=np.float64).reshape(len(at), size)
        for k in range(min(size, 24)):
            panel.plot(at, factor * table[:, k], "o-", ms=3, lw=1.0, color=BAR if size == 1 else None)
        panel.set_title(title, loc="left")
        panel.set_xlabel(_label(first))
        panel.grid(True, color="#dddddd", lw=0.6)
    for panel in axes[len(SWEPT) :]:
        panel.set_axis_off()
    if others:
        axes[-1].text(0.0, 0.9, "one line for each of " + ", ".join(key for key, _ in others), fontsize=8)


def _draw_maps(figure: Figure, found: Sweep) -> None:
    """Draw each measure over both keys, as a map."""
    figure.suptitle(f"{found.name}: {len(found.rows)} points", fontsize=10)
    (x, y) = found.axes
    shape = (len(x[1]), len(y[1]))
    axes = figure.subplots(2, ceil(len(SWEPT) / 2)).ravel()
    for panel, measure in zip(axes, SWEPT):
        title, factor = WORDS[measure]
        table = factor * np.array([row[measure] for row in found.rows], dtype=np.float64).reshape(shape)
        image = panel.imshow(np.ma.masked_invalid(table.T), origin="lower", aspect="auto", cmap="viridis")
        figure.colorbar(image, ax=panel)
        panel.set_title(title, loc="left")
        for name, axis, axis_of in ((x, panel.xaxis, 0), (y, panel.yaxis, 1)):
            ticks = sorted({round(t) for t in np.linspace(0, shape[axis_of] - 1, min(6, shape[axis_of]))})
            axis.set_ticks(ticks, [str(name[1][t])[:9] for t in ticks])
            axis.set_label_text(_label(name))
    for panel in axes[len(SWEPT) :]:
        panel.set_axis_off()
