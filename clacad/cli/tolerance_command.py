"""`clacad tolerance` and `clacad sweep`: what fabrication errors, or other parameters, do to light."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.base.text import mrad_text, percent_text
from clacad.cli.command import Command, OfDesign, option, overwrite_option, required
from clacad.cli.console import Brief, Console, facts, table
from clacad.cli.option_values import cell_option, load_counted, of_cell, parse_slopes, words_of

if TYPE_CHECKING:
    from clacad.verification.tolerance import Study, Sweep

LEAST = 1e-3
"""Share from which a contributor is printed with its change; the others are named."""


def _rays() -> Any:
    return option("--rays N", "Rays of each bundle.", 256, least=64, most=1_000_000)


def _workers() -> Any:
    return option("--workers N", "Processes on this machine; default one a core.", None, least=1)


def _scheduler() -> Any:
    return option("--scheduler ADDRESS", "Dask scheduler to work on instead, e.g. tcp://host:8786.", None)


def _overwrite() -> Any:
    return overwrite_option("Begin again; replace files of another origin.")


@dataclass(frozen=True, kw_only=True)
class Tolerance(OfDesign):
    """What fabrication errors do to light: ranked contributors, Monte Carlo, yield."""

    out: Path | None = option(
        "-o, --out DIR",
        "Write tolerances.json, .csv and .png here; a run that was stopped goes on from here.",
    )
    samples: int | None = option(
        "--samples N", "Sheets drawn; default the design's tolerances.samples.", least=0, most=10_000_000
    )
    seed: int | None = option("--seed N", "Default the design's.", least=0, most=1_000_000_000)
    cell: tuple[int, int] | None = cell_option()
    rays: int = _rays()
    workers: int | None = _workers()
    scheduler: str | None = _scheduler()
    overwrite: bool = _overwrite()


def run_tolerance(request: Tolerance, console: Console) -> int:
    """Make many sheets with the design's tolerances, print contributors and yield, write the tables."""
    design = of_cell(load_counted(request.design, request.set), request.cell)
    from clacad.formats.study_file import TOLERANCES
    from clacad.verification.tolerance import Farm, tolerance, write_study
    from clacad.verification.tolerance.study import TASK, study_seconds
    from clacad.verification.tolerance.study_files import study_document

    kept = _checkpoint(request, TOLERANCES)
    overwrite = request.overwrite or (kept is not None and kept.exists())
    farm = Farm(request.workers, request.scheduler)
    takes = study_seconds(design, request.samples, request.rays)
    with console.progress() as progress, console.forecast(TASK, takes) as span:
        progress.expect(span.middle)
        study = tolerance(design, request.samples, request.seed, request.rays, farm, kept, progress)
    written = [] if request.out is None else write_study(study, request.out, overwrite=overwrite)
    console.show(lambda: study_document(study), lambda: tolerance_text(study), lambda: _brief(study))
    if written:
        console.say("wrote " + ", ".join(str(p) for p in written))
    return 0


@dataclass(frozen=True, kw_only=True)
class SweepDesign(OfDesign):
    """Build, judge and trace a design at every point of a grid of values: table and plots."""

    vary: tuple[str, ...] = required(
        "--vary KEY=FROM:TO:COUNT",
        "Values of one key, or KEY=A,B,C; FROM:TO:COUNT:log for equal ratios. Several: every combination.",
    )
    out: Path | None = option(
        "-o, --out DIR", "Write sweep.csv and sweep.png here; a run that was stopped goes on from here."
    )
    formats: tuple[str, ...] = option("--format F,G", "csv, parquet.", ("csv",), read=words_of)
    rays: int = _rays()
    incident: tuple[float, float] | None = option(
        "--incident SX,SY",
        "Judge light about these slopes along the sheet's x and y; default: about the middle of the field"
        " of each point.",
        read=parse_slopes,
    )
    workers: int | None = _workers()
    scheduler: str | None = _scheduler()
    overwrite: bool = _overwrite()


def run_sweep(request: SweepDesign, console: Console) -> int:
    """Build, judge and trace every point of a grid, print the table, write it."""
    design = load_counted(request.design, request.set)
    from clacad.verification.tolerance import Farm, parse_vary, sweep, write_sweep
    from clacad.verification.tolerance.parameter_sweep import TASK, sweep_seconds
    from clacad.verification.tolerance.study_files import SWEEP, require_writable

    require_writable(request.formats)
    axes = [parse_vary(text) for text in request.vary]
    kept = _checkpoint(request, SWEEP)
    overwrite = request.overwrite or (kept is not None and kept.exists())
    farm = Farm(request.workers, request.scheduler)
    takes = sweep_seconds(axes, request.rays)
    with console.progress() as progress, console.forecast(TASK, takes) as span:
        progress.expect(span.middle)
        found = sweep(design, axes, request.rays, farm, kept, progress, request.incident)
    written = (
        [] if request.out is None else write_sweep(found, request.out, request.formats, overwrite=overwrite)
    )
    head = {"design": found.name, "sha256": found.sha256, "incident": found.incident}
    console.show(
        lambda: {**head, "columns": found.columns(), "rows": found.rows},
        lambda: sweep_text(found),
        lambda: _sweep_brief(found),
    )
    if written:
        console.say("wrote " + ", ".join(str(p) for p in written))
    return 0


def _checkpoint(request: Tolerance | SweepDesign, kind: str) -> Path | None:
    """The checkpoint in the output folder; with --overwrite a new one."""
    from clacad.verification.tolerance.study_files import checkpoint_path

    if request.out is None:
        return None
    kept = checkpoint_path(request.out, kind)
    if request.overwrite:
        kept.unlink(missing_ok=True)
    return kept


def tolerance_text(study: Study) -> str:
    """Contributors of each measure, limits and yield."""
    from clacad.base.text import plainly
    from clacad.verification.tolerance.study import RANKED
    from clacad.verification.tolerance.study_files import WORDS

    sides = (
        "± tolerance; two standard deviations" if study.distribution == "normal" else "± tolerance; uniform"
    )
    lines = [["parameter", sides, "unit"]]
    for p in study.parameters:
        value, unit = plainly(p.half, p.unit)
        lines.append([p.name, value, f"{unit} rms, from lenslet to lenslet".strip() if p.scatter else unit])
    blocks = [study.name, table(lines)]
    if study.cell is not None:
        blocks.append(f"the sheet is non-uniform: the study is of the uniform sheet of {study.of_cell}")
    for measure in RANKED:
        blocks += _measure_blocks(study, measure, *WORDS[measure])
    blocks.append(_yield_text(study))
    return "\n".join(blocks)


TIGHTER = 0.6
"""Factor of a tolerance whose gain in yield is printed."""


def _brief(study: Study) -> Brief:
    """Yield; the limits that most sheets miss, the errors that matter most, what tighter tolerances give."""
    from clacad.base.text import bound, plainly
    from clacad.verification.tolerance.study import RANKED, yield_if_tighter

    missed, count = study.misses(), len(study.measures)
    limits = sorted(
        (one for one in study.limits if missed[one.measure]), key=lambda one: -missed[one.measure]
    )
    rows = [
        (
            "missed by",
            f"{missed[one.measure]} of {count}",
            f"{one.measure} {bound(one.relation, *plainly(one.value, study.units[one.measure], 4))}",
        )
        for one in limits[:3]
    ]
    already = study.nominal_misses()
    rows += [("missed by", "the sheet as designed", ", ".join(already))] if already else []
    rows += [("of", study.of_cell, "")] if study.of_cell else []
    worst: dict[str, tuple[float, str]] = {}
    for measure in [one for one in RANKED if missed.get(one)] or RANKED:
        for name, _, share in study.ranking(measure):
            worst[name] = max(worst.get(name, (LEAST, "")), (share, measure))
    ranked = sorted(worst.items(), key=lambda one: -one[1][0])[:3]
    errors = [
        ("error", name, f"{percent_text(share, 2)} of the change of {measure}")
        for name, (share, measure) in ranked
        if measure
    ]
    halves = {one.key: one for one in study.parameters if one.half}
    now = study.good().mean() if count else 1.0
    gains = [(gain, key) for key in halves if (gain := yield_if_tighter(study, key, TIGHTER) or 0.0) > now]
    for gain, key in sorted(gains, key=lambda pair: -pair[0])[:3]:
        half, unit = halves[key].half, halves[key].unit
        wide, less = (" ".join(filter(None, plainly(value, unit, 3))) for value in (half, TIGHTER * half))
        errors.append(("tighten", key, f"from {wide} to {less}: yield {percent_text(gain, 1, fixed=True)}"))
    head = f"{study.name}: {_yield(study)}" if count else f"{study.name}: no sheets drawn"
    return Brief(head, (facts(rows), facts(errors)), (), _yield(study))


def _yield(study: Study) -> str:
    """Share of good sheets with its 95 % interval; "" where none were drawn."""
    if not len(study.measures):
        return ""
    share, low, high = study.yields()
    least, most = (percent_text(end, 1, fixed=True, unit="") for end in (low, high))
    of = f"of {len(study.measures)} sheets"
    return f"yield {percent_text(share, 1, fixed=True)} {of} (95 %: {least} to {most})"


def _measure_blocks(study: Study, measure: str, title: str, factor: float) -> Iterator[str]:
    """Percentiles of one measure, and its contributors from the largest on."""
    low, middle, high = (f"{factor * v:.4g}" for v in study.percentiles(measure))
    yield (
        f"{title}: as designed {factor * study.nominal[measure]:.4g}; of the sheets 5 % below {low}, "
        f"half below {middle}, 95 % below {high}"
    )
    by_cell = measure == "law_rms"
    if by_cell:
        yield "    of the worst of the middle cell and the cells in the corners, by its centre:"
    ranking = study.ranking(measure)
    rows = [
        [percent_text(s, 1, fixed=True), n, _change(factor * c), *([_cell(study, n)] if by_cell else [])]
        for n, c, s in ranking
        if s >= LEAST
    ]
    rest = ", ".join(n for n, _, s in ranking if s < LEAST)
    if rows:
        yield table(rows, indent="    ")
        if rest:
            yield f"    less than {percent_text(LEAST, 6)} each: {rest}"


def _cell(study: Study, parameter: str) -> str:
    """Location of the cell whose law error this parameter makes the worst."""
    x, y = (metres / study.unit_m for metres in study.place(parameter))
    return "in the middle" if x == y == 0.0 else f"at ({x:.4g}, {y:.4g})"


def _change(value: float) -> str:
    return f"{value:.4g}" if isfinite(value) else "no light gets through"


def _yield_text(study: Study) -> str:
    from clacad.base.text import bound, plainly

    missed = study.misses()
    rows = [["a good sheet keeps", "limit", "sheets that miss it", "from"]]
    for limit in study.limits:
        text = bound(limit.relation, *plainly(limit.value, study.units[limit.measure]))
        rows.append([limit.measure, text, str(missed[limit.measure]), limit.source])
    text = table(rows)
    nominal = study.nominal_misses()
    if nominal:
        text += f"\nthe sheet as designed already misses: {', '.join(nominal)}"
    return "\n".join(filter(None, (text, _yield(study))))


def sweep_text(found: Sweep) -> str:
    """The table of a sweep in mrad and percent, the worst numbers only."""
    keys = [key for key, _ in found.axes]
    lines = [
        [
            *keys,
            "state",
            "law rms",
            "law bias",
            "blur",
            "throughput",
            "eta x, y",
            "exit x, y",
            "partner",
            "ghosts",
            "",
        ]
    ]
    for row in found.rows:
        lines.append(
            [*(str(row[key]) for key in keys), row["state"], *_optics(row), row["failed"] or row["message"]]
        )
    return f"{found.name}; angles in mrad\n{_light(found)}\n{table(lines)}"


def _sweep_brief(found: Sweep) -> Brief:
    """Number of points that pass; errors, throughput and problem of each."""
    keys = [key for key, _ in found.axes]
    rows = [[*keys, "state", "law rms", "law bias", "throughput", "ghosts", ""]]
    for row in found.rows:
        law_rms, law_bias, _, throughput, _, _, _, ghosts = _optics(row)
        wrong = str(row["failed"] or row["message"])
        values = (str(row[key]) for key in keys)
        rows.append([*values, row["state"], law_rms, law_bias, throughput, ghosts, wrong])
    good = sum(row["state"] == "ok" for row in found.rows)
    head = f"{found.name}: {good} of {len(found.rows)} points are ok; angles in mrad"
    return Brief(head, (facts(rows), [("light", f"  {_light(found).splitlines()[0]}")]))


def _light(found: Sweep) -> str:
    """The light of a sweep, in words."""
    field = (
        "light: over the field about its middle, check.field and check.field_centre of each point (aimed "
        "cells: the field follows them); a beam along the normal is judged with --incident 0,0"
    )
    if found.incident is not None:
        x, y = found.incident
        field = (
            f"light: over check.field about the slopes ({x:g}, {y:g}) of --incident along the sheet's x "
            "and y, at every point"
        )
    beam = "of the parallel beam in the middle of that light"
    return f"{field}\nexit (mean slopes), partner and ghosts (shares of thin lenses): {beam}"


def _optics(row: dict[str, Any]) -> list[str]:
    angles = [mrad_text(row[name], unit="") for name in ("law_rms", "law_bias", "blur")]
    return [*angles, f"{row['throughput']:.3f}", f"{row['eta_x']:.5g}, {row['eta_y']:.5g}", *_beam(row)]


def _beam(row: dict[str, Any]) -> list[str]:
    """Exit slope, share of the partner, and that of all ghosts with the strongest order."""
    ghosts = [(order, part) for order, part in row["orders"].items() if order != "0,0"]
    strongest = f" ({ghosts[0][0]}: {ghosts[0][1]:.3f})" if ghosts else ""
    exit_slopes = f"{row['beam_exit_x']:.4g}, {row['beam_exit_y']:.4g}"
    return [exit_slopes, f"{row['partner_share']:.3f}", f"{row['ghost_share']:.3f}{strongest}"]


COMMANDS = (
    Command("tolerance", "judge", Tolerance, run_tolerance),
    Command("sweep", "judge", SweepDesign, run_sweep),
)
