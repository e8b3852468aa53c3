"""`clacad check`: derived numbers, forecast of verify, advice; `clacad explore`: a page with sliders."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from math import acos, atan, degrees
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.base.text import mrad_text, pair_text, percent_text, short_size_text, span_text
from clacad.cli.command import (
    Command,
    OfDesign,
    OfDesignAsMade,
    dry_run_option,
    flag,
    option,
    overwrite_option,
    required,
)
from clacad.cli.console import Brief, Console, facts, show_text, table
from clacad.cli.option_values import BadOption, cell_option, command_line, load_counted, load_design

if TYPE_CHECKING:
    from clacad.advice import Advice, Fixed, Judged
    from clacad.design import Design
    from clacad.explorer import Explored
    from clacad.making.light_as_made import JudgedAsMade


@dataclass(frozen=True, kw_only=True)
class CheckDesign(OfDesignAsMade):
    """Derive what would be made, forecast the verdict of verify, find the keys that would make it pass."""

    fix: bool = flag(
        "--fix", "Find the fewest keys that make it pass; the law, the material and all limits stay."
    )
    out: Path | None = option(
        "-o, --out FILE", "With --fix, write the design that passes here, comments kept."
    )
    overwrite: bool = overwrite_option()


def run_check(request: CheckDesign, console: Console) -> int:
    """Derive and judge everything, print it; exit 1 when verify will fail, 3 when nothing could be written.

    Keys that would change a failure or a warning are searched for only where they are printed.
    """
    if request.fix:
        if request.as_made:
            raise BadOption("--fix is about the design: leave out --as-made")
        return _fix(request, console)
    if request.out is not None:
        raise BadOption("-o is where --fix writes the design that passes: give --fix, too")
    from clacad.advice import judge
    from clacad.exporting.forecast import outlook
    from clacad.storage.errors import LimitRefused

    design = _listable(load_design(request.design, request.overrides))
    judged = judge(design, remedies=True, as_made=request.as_made)
    printed = console.json or not console.quiet  # grids are chosen by light only where they are printed
    forecast = outlook(judged.window, judged.design if printed else None)
    if console.json:
        console.show(lambda: _document(judged, forecast, _advised(judged, console)), str)
    elif console.all and not console.quiet:
        _show(judged, forecast, console)
    elif not console.quiet:
        advice = _advised(judged, console)
        console.show(dict, str, lambda: _brief(judged, forecast, advice, request))
    if judged.passes and all(row["refused"] for row in forecast):
        raise LimitRefused(str(forecast[0]["refused"]))
    return 0 if judged.passes else 1


def _listable(design: Design) -> Design:
    """The design; one with an outline, whose cells are visited one by one, only within their limit."""
    from clacad.exporting.limits import refuse_uncountable

    if design.lattice.outline is not None:
        refuse_uncountable(design)
    return design


def _advised(judged: Judged, console: Console) -> Advice:
    from clacad.advice import advise

    with console.progress() as progress:
        return advise(judged.design, progress, judged)


def _show(judged: Judged, forecast: list[dict[str, Any]], console: Console) -> None:
    """Print the derived numbers and the checks, then the advice, which takes longer, and the verdict."""
    from clacad.cli.tables import advice_text, check_text
    from clacad.sheet.feasibility import describe

    show_text(check_text(judged.design.name, describe(judged.window, judged.facts), judged.checks, forecast))
    from clacad.measuring.measured import iso_rows_of_design

    terms = iso_rows_of_design(judged.design, judged.window)
    if terms:
        show_text(table([("in the terms of ISO 14880", "unit", "design"), *terms]))
    advice = advice_text(_advised(judged, console))
    if judged.made is not None:
        advice = "\n".join([*judged.made.lines(), advice])
    show_text(f"{advice}\n{judged.verdict()}".lstrip("\n"))


def _brief(judged: Judged, forecast: list[dict[str, Any]], advice: Advice, request: CheckDesign) -> Brief:
    """Sheet, law, light, lenses and files in a line each; failures and warnings with what mends them."""
    from clacad.cli.tables import counted, problems

    design, word = judged.design, judged.verdict()
    rows = [
        ("sheet", _sheet(judged)),
        ("law", _law(judged)),
        ("light", _light(judged)),
        ("lenses", _lenses(judged)),
        *([] if judged.made is None else [("as made", _made(judged.made))]),
        ("files", "; ".join(map(_file, forecast))),
    ]
    free = [] if advice.sharper is None else [("free", f"  free     {advice.sharper}")]
    path, changes = request.design, request.set
    following = command_line("clacad check", path, "--fix", "-o", f"{path.stem}-fixed.toml", changes=changes)
    if judged.passes:
        following = command_line(
            "clacad export", path, "-o", f"exports/{path.stem}", "--format", "step", changes=changes
        )
    return Brief(
        f"{design.name}: {word}",
        (facts(rows), [*problems(judged.checks, advice.of), *free]),
        (following,),
        word,
        counted(judged.checks),
    )


def _sheet(judged: Judged) -> str:
    """Form, material, cells, size."""
    from clacad.sheet.feasibility.as_rows import cells_text
    from clacad.sheet.volume_and_extent import whole_extent

    design, bodies = judged.design, judged.facts.bodies
    x0, x1, y0, y1 = whole_extent(judged.window)
    height = max(body.high for body in bodies) - min(body.low for body in bodies)
    size = " x ".join(f"{length:.4g}" for length in (x1 - x0, y1 - y0, height))
    cells = f"{cells_text(judged.window.lattice)} {judged.window.lattice.kind} cells"
    pitch = pair_text(judged.window.lattice.pitch)
    material = design.pair.material
    return ", ".join(
        [
            design.pair.form,
            *([material] if material else []),
            f"{cells} of {pitch} {design.unit}",
            f"{size} {design.unit}",
        ]
    )


def _law(judged: Judged) -> str:
    """Law, and errors of the light with their limits."""
    from clacad.checks.light_kinds import LAW_BIAS, LAW_RMS, LAW_WHITE, TEMPERATURE

    given, errors = judged.design.to_dict()["law"], []
    for kind, name in ((LAW_RMS, "rms"), (LAW_BIAS, "bias")):
        check = kind.first(judged.checks)
        if check is not None and isinstance(check.value, float) and isinstance(check.limit, float):
            limit = mrad_text(check.limit, 3, unit="")
            cell = "" if "cell" not in check.detail else " in cell ({}, {})".format(*check.detail["cell"])
            errors.append(f"{name} {mrad_text(check.value, 3)} (limit {limit}){cell}")
    white = LAW_WHITE.first(judged.checks)
    if white is not None and isinstance(white.value, float):
        floor = white.detail["floor"]
        least = f" (floor of one material {mrad_text(floor, 3, unit='')})" if floor == floor else ""
        errors.append(f"in white light {mrad_text(white.value, 3)}{least}")
    warm = TEMPERATURE.first(judged.checks)
    if warm is not None and isinstance(warm.value, float):
        errors.append(f"± {warm.detail['rows'][-1]['kelvin']:g} K change {mrad_text(warm.value, 3)}")
    return "; ".join([*(f"{name} {pair_text(given[name])}" for name in ("eta", "delta")), *errors])


def _made(found: JudgedAsMade) -> str:
    """Error designed and made, shares, and the parameters that cost most."""
    light = found.light
    kept = "not known" if light.undisturbed != light.undisturbed else percent_text(light.undisturbed, 4)
    return "; ".join(
        [
            f"{light.process.name}: rms {mrad_text(light.formed, 3)} clear of roundings"
            f" (designed {mrad_text(light.designed, 3)}, all light {mrad_text(light.everything, 3)})",
            f"{percent_text(light.share_formed)} of the light passes clear,"
            f" {percent_text(light.share_rounded, 2)} met a rounding, texture leaves {kept} undisturbed",
            *found.advice,
        ]
    )


def _light(judged: Judged) -> str:
    """Shares of light to the partner, field of view and first ghosts."""
    from clacad.checks.light_kinds import THROUGHPUT

    check, numbers = THROUGHPUT.first(judged.checks), judged.facts
    shares = (
        []
        if check is None or "mean" not in check.detail
        else [
            f"{percent_text(check.detail['middle'])} to the partner in the middle of the field,"
            f" {percent_text(check.detail['mean'])} over it"
        ]
    )
    field, ghosts = (
        pair_text([degrees(atan(slope)) for slope in two])
        for two in (numbers.half_field, numbers.ghost_onset)
    )
    return "; ".join([*shares, f"half field {field} deg, ghosts from {ghosts} deg"])


def _lenses(judged: Judged) -> str:
    """Radii, sag, steepest slope and edge; the process."""
    lens, unit, process = judged.facts.lenses[0], judged.design.unit, judged.design.check.process
    parts = [
        f"radius {pair_text(lens.radius)} {unit}",
        f"sag {lens.sag:.3g} {unit}",
        f"slope {degrees(acos(min(1.0, lens.least_normal_z))):.3g} deg",
        f"edge {min(body.edge for body in judged.facts.bodies):.3g} {unit}",
    ]
    return ", ".join(parts) + (f"; process {process}" if process else "")


def _file(row: dict[str, Any]) -> str:
    """Format, role, size and seconds of a file of a forecast."""
    if row["refused"]:
        return f"{row['format']} refused"
    role = str(row.get("role", "")).replace("-", " ")
    grid = f"{row['quads']} quads" if row["quads"] is not None else ""
    words = (row["format"], role, grid, short_size_text(row["bytes"]), f"in {span_text(*row['seconds'])}")
    return " ".join(filter(None, words))


def _document(judged: Judged, forecast: list[dict[str, Any]], advice: Advice) -> dict[str, Any]:
    from clacad.measuring.measured import iso_rows_of_design

    rows = iso_rows_of_design(judged.design, judged.window)
    terms = [dict(zip(("name", "unit", "design"), row, strict=True)) for row in rows]
    return judged.to_dict() | {"forecast": forecast, "advice": advice.to_dict(), "iso_14880": terms}


def _fix(request: CheckDesign, console: Console) -> int:
    """Find the fewest keys that make a design pass, print them, write the design; exit 1 where none do."""
    from clacad.advice import fix
    from clacad.storage.atomic import Stage, translated

    out = request.out
    if out is not None and out.suffix.lower() not in (".toml", ".json"):
        raise BadOption(f"-o {out}: a design file's name ends in .toml or .json")
    design = load_design(request.design, request.overrides)
    if out is None:
        with console.progress() as progress:
            return _show_fixed(fix(design, progress), None, console)
    with Stage(out.parent, overwrite=request.overwrite) as stage:  # refuses a name before the search
        private = stage.path(out.name)
        with console.progress() as progress:
            fixed = fix(design, progress)
        if fixed.passes:
            text, kept = _text(request, fixed, out)
            if not kept:
                console.say(f"{out}: written from scratch, without the comments of {request.design}")
            with translated(out):
                private.write_text(text, encoding="utf-8", newline="")
            stage.publish()
    return _show_fixed(fixed, out if fixed.passes else None, console)


def _text(request: CheckDesign, fixed: Fixed, out: Path) -> tuple[str, bool]:
    """Text of the file to write, and whether it is the given one with its keys changed."""
    from clacad.config.edit_text import parse as parse_override
    from clacad.config.edit_text import with_values
    from clacad.config.toml_text import parse, read_text
    from clacad.design import Design

    path = request.design
    is_json = path.suffix.lower() == ".json"
    if is_json == (out.suffix.lower() == ".json"):
        given = dict(pair for text in request.overrides if isinstance(pair := parse_override(text), tuple))
        with suppress(LookupError):  # a table with lines of its own was overridden as a whole
            text = with_values(read_text(str(path)), {**given, **fixed.changes}, is_json=is_json)
            if Design.from_dict(parse(text, out.name)) == fixed.design:
                return text, True
    if is_json:
        return fixed.design.canonical_toml(), False
    from json import dumps

    return dumps(fixed.design.to_dict(), indent=1, ensure_ascii=False) + "\n", False


def _show_fixed(fixed: Fixed, written: Path | None, console: Console) -> int:
    """Print the changes, the checks with them, and the limits that bind where nothing passes."""
    from clacad.cli.tables import checks_text

    name = fixed.design.name
    blocks = [] if fixed.judged is None else [f"{name}\n{checks_text(fixed.judged.checks)}"]
    blocks += [f"changed\n{table(fixed.rows())}"] if fixed.changes else []
    blocks.append(str(fixed))
    if written is not None:
        blocks.append(f"wrote {written}\nnext: {command_line('clacad export', written, *OUT)}")
    path = None if written is None else str(written)

    def brief() -> Brief:
        from clacad.cli.tables import problems

        rows = [facts(fixed.rows()), [] if fixed.judged is None else problems(fixed.judged.checks)]
        following = () if path is None else (command_line("clacad export", path, *OUT),)
        word = str(fixed)
        made = [("file", f"  wrote {path}")] if path is not None else []
        return Brief(f"{name}: {word}", (*rows, made), following, word)

    console.show(
        lambda: {"design": name, **fixed.to_dict(), "written": path}, lambda: "\n".join(blocks), brief
    )
    return 0 if fixed.passes else 1


OUT = ("-o", "exports", "--format", "step")
"""Options of the command that makes a design that was fixed."""


@dataclass(frozen=True, kw_only=True)
class Explore(OfDesign):
    """One page with sliders: the view through the sheet, live, its verdict, and the design file they make."""

    out: Path = required("-o, --out FILE", "The page: one .html file.")
    cell: tuple[int, int] | None = cell_option()
    dry_run: bool = dry_run_option("Print what the page would be and cost; write nothing.")
    overwrite: bool = overwrite_option()


def run_explore(request: Explore, console: Console) -> int:
    """Write the page, or with --dry-run forecast it; print its first verdict and what it leaves out."""
    design = load_counted(request.design, request.set)  # refuses before a module is loaded that makes pages
    from clacad.explorer.write_page import SECONDS, explore

    with console.forecast("explore", SECONDS):
        made = explore(design, request.out, request.overwrite, cell=request.cell, dry_run=request.dry_run)
    console.show(lambda: made.to_dict() | {"processor_s": SECONDS}, lambda: _page_text(made, design.unit))
    return 0


def _page_text(made: Explored, unit: str) -> str:
    """What was written, and the verdict of the page before a slider is moved."""
    found = made.verdict
    field, onset = (
        ", ".join(f"{degrees(atan(t)):.3g}" for t in two) for two in (found.half_field, found.ghost_onset)
    )
    rows = [
        ("light to the partner", percent_text(found.share), "along the middle of the field"),
        ("", percent_text(found.share_from_eye), "over the sheet, of what reaches the eye"),
        ("field, x, y", f"{field} deg", "half width: beyond it no light obeys the law"),
        ("ghosts from, x, y", f"{onset} deg", "off the middle of the field"),
        ("sharpest pitch", f"{found.advised_pitch:.4g} {unit}", "for what is looked at"),
    ]
    head = f"wrote {made.file}" if made.written else f"would write {made.file}"
    seconds = "" if made.written else "; takes less than a second of processor time"
    left_out = "\n".join(f"not shown: {one}" for one in made.not_shown)
    return f"{head}: {short_size_text(made.bytes)}{seconds}\n{table(rows)}\n{left_out}"


COMMANDS = (
    Command("check", "make", CheckDesign, run_check),
    Command("explore", "look", Explore, run_explore),
)
