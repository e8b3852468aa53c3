"""Studies and sweeps as files: JSON, CSV, Parquet, PNG; all files of a study are written, or none."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from clacad import __version__
from clacad.formats.study_file import FORMAT, TOLERANCES
from clacad.storage.atomic import Stage, canonical_json
from clacad.verification.tolerance.light_measures import MEASURES
from clacad.verification.tolerance.parameter_sweep import CannotVary, Sweep, shown
from clacad.verification.tolerance.study import RANKED, Study, finite

SWEEP = "sweep"
CHECKPOINT = ".checkpoint"


def checkpoint_path(folder: Path, kind: str) -> Path:
    """Path of the checkpoint of a study."""
    return folder / f"{kind}{CHECKPOINT}"


def study_document(study: Study) -> dict[str, Any]:
    """Content of tolerances.json, also used for the report's section."""
    share, low, high = study.yields()
    return {
        "kind": TOLERANCES, "format": FORMAT, "design": {"name": study.name, "sha256": study.sha256},
        **({} if study.cell is None else {"cell": list(study.cell), "cells_tried": study.tried}),
        "unit_m": study.unit_m, "distribution": study.distribution, "seed": study.seed, "rays": study.rays,
        "samples": len(study.measures), "units": dict(MEASURES),
        "parameters": [
            {"name": p.name, "key": p.key, "tolerance": p.half, "unit": p.unit, "one_sided": p.one_sided}
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
            m: dict(zip(("5", "50", "95"), (finite(v) for v in study.percentiles(m)), strict=True)) for m in MEASURES
        },
        "limits": [
            {"measure": lim.measure, "relation": lim.relation, "value": lim.value, "source": lim.source,
             "missed": study.misses()[lim.measure]}
            for lim in study.limits
        ],
        "yield": {"share": finite(share), "low": low, "high": high},
        "nominal_misses": study.nominal_misses(),
        "versions": {"clacad": __version__},
    }  # fmt: skip


def _sensitivity(study: Study, number: int) -> dict[str, Any]:
    plus, minus = study.ends[number]
    return {
        "parameter": study.parameters[number].name,
        "slope": {m: finite(float(v)) for m, v in zip(MEASURES, study.slopes[number], strict=True)},
        "plus": {m: finite(float(v)) for m, v in zip(MEASURES, plus, strict=True)},
        "minus": {m: finite(float(v)) for m, v in zip(MEASURES, minus, strict=True)},
    }


def study_table(study: Study) -> str:
    """Content of tolerances.csv: one line per sheet with its errors, its measures, and whether it is good."""
    lines = [["sheet", *(p.name for p in study.parameters), *MEASURES, "good"]]
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
    """Return a cell with an apostrophe before text that a spreadsheet would run as a formula; numbers are unchanged."""
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
    from clacad.verification.tolerance.study_plots import plot_tolerances

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
    found: Sweep, folder: str | os.PathLike[str], formats: Sequence[str] = ("csv",), *, overwrite: bool = False
) -> list[Path]:  # fmt: skip
    """Write sweep.csv or sweep.parquet (or both), and sweep.png.

    Raises
    ------
    CannotVary
        An unknown format, or Parquet without the package that writes it.
    ExportRefused, CannotWrite
    """
    from clacad.verification.tolerance.study_plots import plot_sweep

    require_writable(formats)
    writers = {"csv": sweep_table, "parquet": sweep_parquet}
    files = {f"{SWEEP}.{name}": writers[name](found) for name in formats}
    return _published(Path(folder), {**files, f"{SWEEP}.png": plot_sweep(found)}, overwrite)


def require_writable(formats: Sequence[str]) -> None:
    """Refuse unknown or unavailable formats of a table, before a sweep and not after it.

    Raises
    ------
    CannotVary
        An unknown format, or Parquet without the package that writes it.
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
