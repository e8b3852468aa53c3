"""`clacad accuracy`: error against seconds over the rungs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from clacad.cli.announce_cost import forecast, tell_compiling
from clacad.cli.console import Progress, show_json, show_text, size, table
from clacad.cli.design_commands import load_counted
from clacad.cli.option_values import parse_angle, picture_kind
from clacad.storage.atomic import require_writable

if TYPE_CHECKING:
    from clacad.verification.accuracy.accuracy_table import AccuracyRow, AccuracyTable
    from clacad.verification.accuracy.cheapest_file import FileWithin
    from clacad.verification.accuracy.file_floors import Floor


def measure_accuracy(
    path: Path, overrides: list[str], rays: int, target: str | None, out: Path | None, *, overwrite: bool, json: bool,
    quiet: bool,
) -> int:  # fmt: skip
    """Print the table (or JSON), write the plot, name the cheapest file within a target."""
    design = load_counted(path, overrides)
    from clacad.prescription.prescribe import prescribe
    from clacad.tracing.worst_cell import worst_cell
    from clacad.verification.accuracy.accuracy_table import TASK, accuracy, accuracy_seconds
    from clacad.verification.accuracy.cheapest_file import files_within
    from clacad.verification.kernels_ahead import OF_TABLE, compiling_seconds
    from clacad.verification.kernels_ahead import TASK as COMPILING

    kind = picture_kind(out, "svg")
    limit = None if target is None else parse_angle("--target", target)
    if out is not None:
        require_writable(out, overwrite=overwrite)
    progress, window = Progress(quiet=quiet), prescribe(design)
    try:
        with forecast(TASK, accuracy_seconds(rays, window), quiet=quiet) as span:
            ahead = compiling_seconds(worst_cell(window, design.check.field).like, OF_TABLE)
            tell_compiling(COMPILING, ahead, quiet=quiet)
            progress.expect(span.middle + ahead)
            measured = accuracy(design, rays=rays, progress=progress)
    finally:
        progress.done()
    if out is not None:
        _write(out, kind, measured, limit, overwrite)
    files = [] if limit is None else files_within(design, window, measured.floors, limit)
    if json:
        document = measured.to_dict()
        if limit is not None:
            chosen = measured.cheapest(limit, rays)
            document["target"] = {
                "radians": limit, "files": [one.to_dict() for one in files], "chosen": chosen.to_dict(),
            }  # fmt: skip
        show_json(document)
        return 0
    show_text(accuracy_text(measured), quiet=quiet)
    if limit is not None:
        show_text(target_text(path, limit, files), quiet=quiet)
    return 0


def target_text(path: Path, target: float, files: Sequence[FileWithin]) -> str:
    """The cheapest file within a target (radians), how to write it, and the others."""
    first, *rest = files
    lines = [
        f"cheapest file within {1e3 * target:g} mrad: {first}",
        f"  clacad export {path} -o DIR {first.options}",
    ]
    return "\n".join(lines + [f"also within it: {one}" for one in rest])


def _write(out: Path, kind: str, measured: AccuracyTable, target: float | None, overwrite: bool) -> None:
    from clacad.storage.atomic import write_content
    from clacad.verification.accuracy.accuracy_plot import plot_png, plot_svg

    plot = plot_png if kind == "png" else plot_svg
    write_content(out, plot(measured, target), overwrite=overwrite)


def accuracy_text(measured: AccuracyTable) -> str:
    """The table for a person, errors in mrad."""
    front = set(map(id, measured.pareto()))
    lines = [
        ["", "rung", "setting", "model rms", "95 %", "max", "law rms", "other fate", "seconds", "Mrays/s", "prepare s",
         "memory", "file"]
    ]  # fmt: skip
    lines += [_line(row, id(row) in front) for row in measured.rows]
    reference = measured.reference
    notes = [
        f"errors in mrad; truth: rung surfaces, itself {1e3 * reference['rms']:.2g} rms, {1e3 * reference['max']:.2g} "
        f"max from a {reference['digits']:.0f}-digit trace of {reference['rays']:.0f} rays",
        "seconds: processor time of the trace alone, best of 3; prepare s: compiling, tessellating or reading, once before the "
        "first ray; other fate: share of the rays that end elsewhere than in the truth",
        "* no other setting is better in both error and seconds",
        *measured.notes,
    ]
    blocks = [
        f"{measured.design}, {measured.rays:,} rays",
        table(lines),
        *notes,
        floors_text(measured.floors),
        f"conclusion: {measured.conclusion}",
    ]
    return "\n".join(blocks)


def floors_text(floors: Sequence[Floor]) -> str:
    """Where accuracy stops paying, one line a family of formats, errors in mrad."""
    lines = [["format", "read by its", "floor", "at quads", "facets", "forecast, traced", ""]]
    for one in floors:
        if one.floor is None:
            lines.append([one.formats, "", "", "", "", "", one.note])
            continue
        best = "" if one.best_quads is None else f"{one.best_quads:.3g}"
        facets = "" if one.facets is None else f"{one.facets:.2g}"
        confirmed = ", ".join(f"{1e3 * f:.3g} {1e3 * t:.3g} at {q}" for q, f, t in one.confirmed)
        lines.append(
            [
                one.formats,
                f"{one.normals} normals",
                f"{1e3 * one.floor:.2g}",
                best,
                facets,
                confirmed,
                one.note,
            ]
        )
    return f"where accuracy stops paying: the least error of each file format, in mrad\n{table(lines)}"


def _line(row: AccuracyRow, on_front: bool) -> list[str]:
    errors = [f"{1e3 * e:.3g}" for e in (row.model_rms, row.model_p95, row.model_max, row.law_rms)]
    return [
        "*" if on_front else "", row.rung, row.setting, *errors, f"{row.disagree:.2%}", f"{row.seconds:.3g}",
        f"{row.rays_per_s / 1e6:.3g}", f"{row.prepare_s:.2g}", size(row.memory),
        "" if row.file_bytes is None else size(row.file_bytes),
    ]  # fmt: skip
