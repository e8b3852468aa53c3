"""Studies and sweeps as files: JSON, CSV, Parquet, PNG; all files of a study are written, or none.

Plots of studies and sweeps; the same numbers give the same bytes.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict
from importlib.util import find_spec
from math import ceil, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad import __version__
from clacad.base.drawn_figure import drawn
from clacad.base.text import percent_text
from clacad.formats.study_file import FORMAT, TOLERANCES
from clacad.storage.atomic import Stage, canonical_json
from clacad.verification.tolerance.parameter_sweep import CannotVary, Sweep, shown
from clacad.verification.tolerance.study import RANKED, Study, finite

if TYPE_CHECKING:
    from matplotlib.figure import Figure


SWEEP = "sweep"
CHECKPOINT = ".checkpoint"


def checkpoint_path(folder: Path, kind: str) -> Path:
    """Path of the checkpoint of a study."""
    return folder / f"{kind}{CHECKPOINT}"


def study_document(study: Study) -> dict[str, Any]:
    """Content of tolerances.json, also used for the report's section."""
    share, low, high = study.yields()
    return {
        "kind": TOLERANCES,
        "format": FORMAT,
        "design": {"name": study.name, "sha256": study.sha256},
        **({} if study.cell is None else {"cell": list(study.cell), "cells_tried": study.tried}),
        "unit_m": study.unit_m,
        "distribution": study.distribution,
        "seed": study.seed,
        "rays": study.rays,
        "samples": len(study.measures),
        "units": study.units,
        "parameters": [
            {"name": p.name, "key": p.key, "tolerance": p.half, "unit": p.unit, "one_sided": p.one_sided}
            | ({"scatter": True} if p.scatter else {})
            for p in study.parameters
        ],
        "nominal": {name: finite(value) for name, value in study.nominal.items()},
        "sensitivities": [_sensitivity(study, k) for k in range(len(study.parameters))],
        "ranking": {
            measure: [
                {"parameter": name, "change": finite(change), "share": share_of}
                for name, change, share_of in study.ranking(measure)
            ]
            for measure in RANKED
        },
        "root_sum_square": {m: finite(float(np.sqrt((study.change(m) ** 2).sum()))) for m in RANKED},
        "percentiles": {
            m: dict(zip(("5", "50", "95"), (finite(v) for v in study.percentiles(m)), strict=True))
            for m in study.units
        },
        "limits": [asdict(lim) | {"missed": study.misses()[lim.measure]} for lim in study.limits],
        "yield": {"share": finite(share), "low": low, "high": high},
        "nominal_misses": study.nominal_misses(),
        "versions": {"clacad": __version__},
    }


def _sensitivity(study: Study, number: int) -> dict[str, Any]:
    plus, minus = study.ends[number]
    return {
        "parameter": study.parameters[number].name,
        "slope": {m: finite(float(v)) for m, v in zip(study.units, study.slopes[number], strict=True)},
        "plus": {m: finite(float(v)) for m, v in zip(study.units, plus, strict=True)},
        "minus": {m: finite(float(v)) for m, v in zip(study.units, minus, strict=True)},
    }


def study_table(study: Study) -> str:
    """Content of tolerances.csv: one line per sheet with its errors, its measures, and whether it is good."""
    lines = [["sheet", *(p.name for p in study.parameters), *study.units, "good"]]
    good = study.good()
    for k in range(len(study.measures)):
        numbers = [shown(float(v)) for v in (*study.errors[k], *study.measures[k])]
        lines.append([str(k), *numbers, str(int(good[k]))])
    return _csv(lines)


def _csv(lines: Sequence[Sequence[str]]) -> str:
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows([harmless_cell(cell) for cell in line] for line in lines)
    return out.getvalue()


def harmless_cell(cell: str) -> str:
    """Put an apostrophe before text that a spreadsheet would run as a formula; numbers are unchanged."""
    try:
        float(cell)
    except ValueError:
        return f"'{cell}" if cell.startswith(("=", "+", "-", "@", "\t", "\r")) else cell
    return cell


def write_study(study: Study, folder: str | os.PathLike[str], *, overwrite: bool = False) -> list[Path]:
    """Write tolerances.json, .csv and .png.

    Returns
    -------
    list of Path

    Raises
    ------
    ExportRefused, CannotWrite
    """
    return _published(
        Path(folder),
        {
            f"{TOLERANCES}.json": canonical_json(study_document(study)).encode(),
            f"{TOLERANCES}.csv": study_table(study).encode(),
            f"{TOLERANCES}.png": plot_tolerances(study),
        },
        overwrite,
    )


def write_sweep(
    found: Sweep,
    folder: str | os.PathLike[str],
    formats: Sequence[str] = ("csv",),
    *,
    overwrite: bool = False,
) -> list[Path]:
    """Write sweep.csv or sweep.parquet (or both), and sweep.png.

    Raises
    ------
    CannotVary
        An unknown format, or Parquet without the package that writes it.
    ExportRefused, CannotWrite
    """
    require_writable(formats)
    writers = {"csv": sweep_table, "parquet": sweep_parquet}
    files = {f"{SWEEP}.{name}": writers[name](found) for name in formats}
    return _published(Path(folder), {**files, f"{SWEEP}.png": plot_sweep(found)}, overwrite)


def require_writable(formats: Sequence[str]) -> None:
    """Refuse unknown or unavailable formats of a table, before a sweep and not after it.

    Raises CannotVary: An unknown format, or Parquet without the package that writes it.
    """
    unknown = [name for name in formats if name not in ("csv", "parquet")]
    if unknown or not formats:
        raise CannotVary(f"--format {','.join(unknown) or 'nothing'}: a table is written as csv or parquet")
    if "parquet" in formats and find_spec("pyarrow") is None:
        raise CannotVary("--format parquet needs the package pyarrow: pip install 'clacad[parquet]'")


def sweep_table(found: Sweep) -> bytes:
    """The table as CSV."""
    columns = found.columns()
    return _csv([columns, *([shown(row[name]) for name in columns] for row in found.rows)]).encode()


def sweep_parquet(found: Sweep) -> bytes:
    """The table as Parquet: numbers as float64, the rest as text."""
    import pyarrow
    from pyarrow import parquet

    columns = {}
    for name in found.columns():
        values = [row[name] for row in found.rows]
        number = all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
        columns[name] = [float(v) for v in values] if number else [shown(v) for v in values]
    out = io.BytesIO()
    parquet.write_table(pyarrow.table(columns), out)
    return out.getvalue()


def _published(folder: Path, files: dict[str, bytes], overwrite: bool) -> list[Path]:
    with Stage(folder, overwrite=overwrite) as stage:
        for name, content in files.items():
            stage.path(name).write_bytes(content)
        stage.publish()
    return [folder / name for name in files]


WORDS = {
    "image_shift": ("image shift / mrad", 1e3),
    "moire_rate": ("moiré: slip of array 2 / 1e-6", 1e6),
    "residual_power": ("residual power / dioptres", 1.0),
    "blur": ("blur, rms / mrad", 1e3),
    "throughput": ("throughput", 1.0),
    "law_rms": ("law error, rms / mrad", 1e3),
    "law_bias": ("law bias / mrad", 1e3),
}
"""Title and factor of each measure that is drawn."""

SHOWN = 8
"""Contributors drawn for each measure."""

SWEPT = ("law_rms", "law_bias", "blur", "throughput", "residual_power")

BAR, LINE, LIMIT = "#1f4e79", "#e07b39", "#b00020"


def plot_tolerances(study: Study) -> bytes:
    """Draw ranked contributors of each measure, and its distribution over Monte-Carlo sheets, as PNG."""
    return _png((11.0, 9.6), lambda figure: _draw_study(figure, study))


def plot_sweep(found: Sweep) -> bytes:
    """Draw measures as PNG: over one key lines, over two maps, over more against the first, one line each."""
    if len(found.axes) == 2:
        return _png((11.0, 6.4), lambda figure: _draw_maps(figure, found))
    return _png((11.0, 6.4), lambda figure: _draw_lines(figure, found))


def _png(size: tuple[float, float], draw: Callable[[Figure], None]) -> bytes:
    return drawn("png", size, draw, {"font.size": 8.5, "axes.titlesize": 9.0})


def _draw_study(figure: Figure, study: Study) -> None:
    share, low, high = study.yields()
    figure.suptitle(
        f"{study.name}: {len(study.measures)} sheets, {percent_text(share, 1, fixed=True)} good "
        f"(95 %: {percent_text(low, 1, fixed=True, unit='')} to"
        f" {percent_text(high, 1, fixed=True, unit='')});"
        " bars: largest change over each tolerance alone",
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
    x, y = found.axes
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
