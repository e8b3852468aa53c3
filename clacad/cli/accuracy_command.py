"""Measurements of the program: `clacad accuracy` (error against seconds over the rungs; with --hard the
stability table) and `clacad atlas` (every figure and movie of the paper, with its numbers).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.base.text import mrad_text, short_size_text
from clacad.cli.command import Command, Overridden, declared, flag, option, overwrite_option, required
from clacad.cli.console import Brief, Console, facts, table
from clacad.cli.option_values import BadOption, load_counted, parse_angle, picture_kind, words_of

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.paper.make_atlas import Atlas
    from clacad.verification.accuracy.accuracy_table import AccuracyRow, AccuracyTable
    from clacad.verification.accuracy.choose_setting import FileWithin
    from clacad.verification.accuracy.file_floors import Floor


@dataclass(frozen=True, kw_only=True)
class Accuracy(Overridden):
    """Error against seconds over the rungs: table, plot, the cheapest file for a target."""

    design: Path | None = option("DESIGN", "Design file (TOML or JSON); not needed with --hard.")
    rays: int = option("--rays N", "Rays sent up every rung.", 100_000, least=100, most=100_000_000)
    target: float | None = option(
        "--target E",
        "Name the cheapest file within this rms direction error, e.g. '0.5 mrad'.",
        read=parse_angle,
    )
    out: Path | None = option("-o, --out FILE", "Write the plot here, .svg or .png.")
    hard: bool = flag(
        "--hard",
        "Print the stability table instead: named hard cases, error of textbook formulas and of clacad in"
        " ulp.",
    )
    maps: bool = flag(
        "--maps",
        "Print what height maps of a made part would give instead: error of law rms and seconds against"
        " pixel and noise, and under hard conditions.",
    )
    overwrite: bool = overwrite_option()


def run_accuracy(request: Accuracy, console: Console) -> int:
    """Print the table, write the plot, name the cheapest file within a target; or the stability table."""
    if request.hard:
        return _show_hard(console)
    if request.design is None:
        raise BadOption("a DESIGN file is needed, unless --hard is given")
    design = load_counted(request.design, request.set)
    if request.maps:
        return _show_maps(design, console)
    from clacad.prescription.prescribe import prescribe
    from clacad.storage.atomic import require_writable
    from clacad.tracing.worst_cell import worst_cell
    from clacad.verification.accuracy.accuracy_table import COMPILING_TASK as COMPILING
    from clacad.verification.accuracy.accuracy_table import (
        OF_TABLE,
        TASK,
        accuracy,
        accuracy_seconds,
        compiling_seconds,
    )
    from clacad.verification.accuracy.choose_setting import files_within

    picture_kind(request.out, "svg")
    if request.out is not None:
        require_writable(request.out, overwrite=request.overwrite)
    window = prescribe(design)
    with (
        console.progress() as progress,
        console.forecast(TASK, accuracy_seconds(request.rays, window)) as span,
    ):
        ahead = compiling_seconds(worst_cell(window, design.check.field).like, OF_TABLE)
        console.announce_compiling(COMPILING, ahead)
        progress.expect(span.middle + ahead)
        measured = accuracy(design, rays=request.rays, progress=progress)
    _write_plot(request, measured)
    limit = request.target
    files = [] if limit is None else files_within(design, window, measured.floors, limit)
    export = f"clacad export {request.design} -o DIR "
    target = [] if limit is None else [f"cheapest file within {mrad_text(limit, 6)}: {files[0]}"]
    also = [f"also within it: {one}" for one in files[1:]]
    commands = [export + one.options for one in files[:1]]
    console.show(
        lambda: _document(request, measured, files),
        lambda: "\n".join([accuracy_text(measured), *target, *(f"  {one}" for one in commands), *also]),
        lambda: _brief(measured, target, also, commands),
    )
    return 0


def _show_hard(console: Console) -> int:
    """Measure the hard cases with the installed arithmetic; exit 1 where a row exceeds its limit."""
    from clacad.verification.stability import as_dict, as_text, stability_table

    rows = stability_table()
    wrong = [row for row in rows if not row.holds]
    word = f"{len(rows) - len(wrong)} of {len(rows)} results within their limits"
    worst = [(row.name, line) for row, line in zip(wrong, as_text(wrong).split("\n")[1:], strict=False)]
    console.show(
        lambda: as_dict(rows), lambda: as_text(rows), lambda: Brief(f"hard cases: {word}", (worst,), (), word)
    )
    return 0 if all(row.holds for row in rows) else 1


def _show_maps(design: Design, console: Console) -> int:
    """Measure height maps of a perfect front, one for each condition."""
    from clacad.measuring.map_accuracy import as_lines, map_accuracy

    with console.progress() as progress:
        rows = map_accuracy(design, progress=progress)
    title = f"{design.name}: height maps of a perfect front, errors in mrad"
    console.show(
        lambda: {"design": design.name, "maps": [row.to_dict() for row in rows]},
        lambda: "\n".join([title, table(as_lines(rows))]),
        lambda: Brief(title, (facts(as_lines(rows)),), (), title),
    )
    return 0


def _document(request: Accuracy, measured: AccuracyTable, files: Sequence[FileWithin]) -> dict[str, Any]:
    document = measured.to_dict()
    if request.target is not None:
        chosen = measured.cheapest(request.target, request.rays)
        document["target"] = {
            "radians": request.target,
            "files": [one.to_dict() for one in files],
            "chosen": chosen.to_dict(),
        }
    return document


def _write_plot(request: Accuracy, measured: AccuracyTable) -> None:
    if request.out is None:
        return
    from clacad.storage.atomic import write_content
    from clacad.verification.accuracy.accuracy_plot import plot_png, plot_svg

    plot = plot_png if picture_kind(request.out, "svg") == "png" else plot_svg
    write_content(request.out, plot(measured, request.target), overwrite=request.overwrite)


def accuracy_text(measured: AccuracyTable) -> str:
    """Table as text, errors in mrad."""
    front = set(map(id, measured.pareto()))
    lines = [
        [
            "",
            "rung",
            "setting",
            "model rms",
            "95 %",
            "max",
            "law rms",
            "other fate",
            "seconds",
            "Mrays/s",
            "prepare s",
            "write s",
            "read s",
            "memory",
            "file",
        ]
    ]
    lines += [_line(row, id(row) in front) for row in measured.rows]
    reference = measured.reference
    notes = [
        f"errors in mrad; truth: rung surfaces, itself {mrad_text(reference['rms'], 2, unit='')} rms, "
        f"{mrad_text(reference['max'], 2, unit='')} max from a {reference['digits']:.0f}-digit trace of "
        f"{reference['rays']:.0f} rays",
        "seconds: processor time of the trace alone, best of 3; prepare s: compiling, tessellating or "
        "reading, once before the first ray; write s, read s: 5 x 5 cells as a file; other fate: share of "
        "the rays that end elsewhere than in the truth",
        "* no other setting is better in both error and seconds",
        *measured.notes,
        *([] if measured.spectrum is None else [measured.spectrum.sentence()]),
        *([] if measured.made is None else [measured.made.sentence()]),
    ]
    blocks = [
        f"{measured.design}, {measured.rays:,} rays",
        table(lines),
        *notes,
        floors_text(measured.floors),
        f"conclusion: {measured.conclusion}",
    ]
    return "\n".join(blocks)


def _brief(
    measured: AccuracyTable, target: Sequence[str], also: Sequence[str], commands: Sequence[str]
) -> Brief:
    """The conclusion, the settings that no other beats in error and seconds, the least error of files.

    target, also, commands : The cheapest file within a target, the others, and how to write it.
    """
    from clacad.exporting.formats.registry import formats

    front = [["rung", "setting", "error / mrad", "seconds", "prepare s", "file"]]
    best = sorted(measured.pareto(), key=lambda row: row.model_rms)
    for row in best[:: -(-len(best) // 6) or 1]:
        size = "" if row.file_bytes is None else short_size_text(row.file_bytes)
        error = mrad_text(row.model_rms, 3, unit="")
        front.append([row.rung, row.setting, error, f"{row.seconds:.3g}", f"{row.prepare_s:.2g}", size])
    common = {one.word for one in formats() if one.at_a_glance is not None}
    floors = []
    for one in reversed(measured.floors):
        words = [word for word in one.formats.split(", ") if word in common]
        if words:
            floor = one.floor
            least = (
                [] if floor is None else [f"{one.normals} normals: no less than {mrad_text(floor, 2)} rms"]
            )
            floors.append([", ".join(words), *least, one.note])
    head = f"{measured.design}, {measured.rays:,} rays: {measured.headline}"
    white = [] if measured.spectrum is None else [("white", measured.spectrum.sentence())]
    white += [] if measured.made is None else [("as made", measured.made.sentence())]
    files = [("file", f"  {text}") for text in (*target, *also)]
    return Brief(
        head,
        (facts(front), facts(floors), files, white),
        tuple(commands),
        target[0] if target else measured.headline,
    )


def floors_text(floors: Sequence[Floor]) -> str:
    """Where accuracy stops paying, one line a family of formats, errors in mrad."""
    lines = [["format", "read by its", "floor", "at quads", "facets", "forecast, traced", ""]]
    for one in floors:
        if one.floor is None:
            lines.append([one.formats, "", "", "", "", "", one.note])
            continue
        best = "" if one.best_quads is None else f"{one.best_quads:.3g}"
        facets = "" if one.facets is None else f"{one.facets:.2g}"
        confirmed = ", ".join(
            f"{mrad_text(f, 3, unit='')} {mrad_text(t, 3, unit='')} at {q}" for q, f, t in one.confirmed
        )
        lines.append(
            [
                one.formats,
                f"{one.normals} normals",
                mrad_text(one.floor, 2, unit=""),
                best,
                facets,
                confirmed,
                one.note,
            ]
        )
    return f"where accuracy stops paying: the least error of each file format, in mrad\n{table(lines)}"


def _line(row: AccuracyRow, on_front: bool) -> list[str]:
    errors = [mrad_text(e, 3, unit="") for e in (row.model_rms, row.model_p95, row.model_max, row.law_rms)]
    return [
        "*" if on_front else "",
        row.rung,
        row.setting,
        *errors,
        f"{row.disagree:.2%}",
        f"{row.seconds:.3g}",
        f"{row.rays_per_s / 1e6:.3g}",
        f"{row.prepare_s:.2g}",
        *("" if taken is None else f"{taken:.2g}" for taken in (row.write_s, row.read_s)),
        short_size_text(row.memory),
        "" if row.file_bytes is None else short_size_text(row.file_bytes),
    ]


def _rows(name: str, text: str) -> tuple[str, ...]:
    """Read "F1,F2" as names of rows."""
    rows = words_of(name, text.upper())
    if not rows:
        raise BadOption(f"{name} {text}: it names no row; give one, such as F3, or leave it out for all")
    return rows


@dataclass(frozen=True, kw_only=True)
class MakeAtlas:
    """Every figure and movie of the paper, each with its numbers measured in the picture."""

    out: Path = required("-o, --out DIR", "Folder to write to.")
    scenes: Path | None = option(
        "--scenes DIR", "Folder of the scene files; default those that come with clacad."
    )
    rows: tuple[str, ...] = option("--rows F1,F2", "Only these; default all.", (), read=_rows)
    size: int = option("--size N", "Pixels across a figure.", 440, least=16, most=8192)
    samples: int = option("--samples N", "Rays a pixel.", 16, least=1, most=4096)
    movie_size: int = option("--movie-size N", "Pixels across a movie.", 220, least=16, most=4096)
    movies: bool = option("--movies/--no-movies", "Make the movies.", True)
    measure: bool = option("--measure/--no-measure", "Measure the rows in rendered pictures.", True)
    overwrite: bool = declared("overwrite")


def run_atlas(request: MakeAtlas, console: Console) -> int:
    """Make the paper's figures and movies, measure their rows; exit 1 when one fails."""
    from clacad.design.starter_designs import shipped_designs
    from clacad.paper.make_atlas import ATLAS, AtlasRequest, atlas_seconds, make_atlas, prepare

    scenes = shipped_designs() / "scenes" if request.scenes is None else request.scenes
    if not scenes.is_dir():
        raise BadOption(
            f"{scenes}: there is no such folder; give the folder of the scene files with --scenes"
        )
    job = prepare(
        AtlasRequest(
            scenes,
            request.out,
            request.size,
            request.samples,
            request.movies,
            request.movie_size,
            request.rows,
            request.measure,
            request.overwrite,
        )
    )
    with console.progress() as progress, console.forecast(ATLAS, atlas_seconds(job)):
        atlas = make_atlas(job, progress)
    console.show(lambda: _atlas_document(atlas), lambda: _atlas_text(atlas))
    return 0 if atlas.passed else 1


def _atlas_document(atlas: Atlas) -> dict[str, Any]:
    rows = {row: [one.to_dict() for one in found] for row, found in atlas.findings.items()}
    return {"folder": str(atlas.folder), "files": list(atlas.files), "passed": atlas.passed, "rows": rows}


def _atlas_text(atlas: Atlas) -> str:
    """Every measured number next to its formula, and how many miss their tolerance."""
    findings = [(row, one) for row, found in atlas.findings.items() for one in found]
    lines = [
        (row, "pass" if one.passed else "FAIL", f"{one.measured:.4g}", f"{one.expected:.4g}", one.what)
        for row, one in findings
    ]
    rows = table([("row", "", "measured", "formula", ""), *lines]) if lines else ""
    failed = sum(not one.passed for _, one in findings)
    verdict = f"{len(findings)} numbers measured, {failed} outside their tolerance"
    return f"{rows}\nwrote {atlas.folder / 'index.html'}: {verdict}"


COMMANDS = (
    Command("accuracy", "judge", Accuracy, run_accuracy),
    Command("atlas", "look", MakeAtlas, run_atlas),
)
