"""`clacad check`: what would be made, what verify will say of it, and which keys would make it pass; `--fix` changes them."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from clacad.cli.console import Progress, say, show_json, show_text, table
from clacad.cli.design_commands import load_design

if TYPE_CHECKING:
    from clacad.advice import Advice, Fixed, Judged
    from clacad.design import Design


def check_design(path: Path, overrides: list[str], *, json: bool, quiet: bool) -> int:
    """Derive and judge everything, print it; exit 1 when verify will fail, 3 when nothing could be written.

    Keys that would mend what fails or warns are only looked for where they are told.
    """
    from clacad.advice import judge
    from clacad.exporting.outlook import outlook
    from clacad.storage.errors import LimitRefused

    judged = judge(_listable(load_design(path, overrides)), remedies=True)
    told = json or not quiet  # grids are chosen by light only where somebody reads of them
    forecast = outlook(judged.window, judged.design if told else None)
    if json:
        show_json(_document(judged, forecast, _advised(judged, quiet=quiet)))
    elif not quiet:
        _show(judged, forecast)
    if judged.passes and all(row["refused"] for row in forecast):
        raise LimitRefused(str(forecast[0]["refused"]))
    return 0 if judged.passes else 1


def _listable(design: Design) -> Design:
    """The design; with an outline only if its cells, which are then gone through one by one, are not too many.

    Raises
    ------
    LimitRefused
    """
    from clacad.exporting.limits import refuse_uncountable

    if design.lattice.outline is not None:
        refuse_uncountable(design)
    return design


def _advised(judged: Judged, *, quiet: bool) -> Advice:
    from clacad.advice import advise

    progress = Progress(quiet=quiet)
    try:
        return advise(judged.design, progress, judged)
    finally:
        progress.done()


def _show(judged: Judged, forecast: list[dict[str, Any]]) -> None:
    """Print what was derived and judged, then what would mend it, which takes its time, and the verdict."""
    from clacad.cli.tables import advice_text, check_text
    from clacad.sheet.feasibility import describe

    show_text(check_text(judged.design.name, describe(judged.window, judged.facts), judged.checks, forecast))
    advice = advice_text(_advised(judged, quiet=False))
    show_text(f"{advice}\n{verdict(judged)}".lstrip("\n"))


def _document(judged: Judged, forecast: list[dict[str, Any]], advice: Advice) -> dict[str, Any]:
    from clacad.sheet.feasibility import describe

    return {
        "design": judged.design.name, "derived": [list(row) for row in describe(judged.window, judged.facts)],
        "recipe": dict(judged.window.recipe), "residual": dict(judged.window.residual),
        "checks": [check.to_dict() for check in judged.checks], "forecast": forecast, "passed": judged.passes,
        "verdict": verdict(judged), "advice": advice.to_dict(),
    }  # fmt: skip


def verdict(judged: Judged) -> str:
    """Return what verify will say in one line."""
    if not judged.passes:
        return f"verify will fail: {', '.join(dict.fromkeys(c.id for c in judged.failing))}"
    notes = []
    if judged.warning:
        notes.append(f"warning of {', '.join(dict.fromkeys(c.id for c in judged.warning))}")
    if judged.tight:
        notes.append(f"{', '.join(dict.fromkeys(c.id for c in judged.tight))} at the very limit")
    return "verify will pass" + (f", {'; '.join(notes)}" if notes else "")


def fix_design(
    path: Path, overrides: list[str], out: Path | None, *, overwrite: bool, json: bool, quiet: bool
) -> int:
    """Find the fewest keys that make a design pass, print them, write the design; exit 1, nothing written, where none do."""
    from clacad.storage.atomic import Stage, translated

    if out is None:
        fixed = _searched(load_design(path, overrides), quiet=quiet)
        return _tell(fixed, None, json=json, quiet=quiet)
    if out.suffix.lower() not in (".toml", ".json"):
        raise typer.BadParameter(f"-o {out}: a design file's name ends in .toml or .json")
    design = load_design(path, overrides)
    with Stage(
        out.parent, overwrite=overwrite
    ) as stage:  # refuses a name that may not be written before the search
        private = stage.path(out.name)
        fixed = _searched(design, quiet=quiet)
        if fixed.passes:
            text, kept = _text(path, overrides, fixed, out)
            if not kept:
                say(f"{out}: written anew, without the comments of {path}", quiet=quiet)
            with translated(out):
                private.write_text(text, encoding="utf-8", newline="")
            stage.publish()
    return _tell(fixed, out if fixed.passes else None, json=json, quiet=quiet)


def _searched(design: Design, *, quiet: bool) -> Fixed:
    from clacad.advice import fix

    progress = Progress(quiet=quiet)
    try:
        return fix(design, progress)
    finally:
        progress.done()


def _text(path: Path, overrides: list[str], fixed: Fixed, out: Path) -> tuple[str, bool]:
    """Text of the file to write, and whether it is the given one with its keys changed, or a new one."""
    from clacad.config.edit_text import parse as parse_override
    from clacad.config.edit_text import with_values
    from clacad.config.toml_text import parse, read_text
    from clacad.design import Design

    is_json = path.suffix.lower() == ".json"
    if is_json == (out.suffix.lower() == ".json"):
        given = dict(pair for text in overrides if isinstance(pair := parse_override(text), tuple))
        with suppress(LookupError):  # a table with lines of its own was overridden as a whole
            text = with_values(read_text(str(path)), {**given, **fixed.changes}, is_json=is_json)
            if Design.from_dict(parse(text, out.name)) == fixed.design:
                return text, True
    if is_json:
        return fixed.design.canonical_toml(), False
    from json import dumps

    return dumps(fixed.design.to_dict(), indent=1, ensure_ascii=False) + "\n", False


def _tell(fixed: Fixed, written: Path | None, *, json: bool, quiet: bool) -> int:
    """Print the changes, the checks with them, and what binds where nothing passes."""
    from clacad.cli.tables import checks_text

    name = fixed.design.name
    if json:
        show_json({"design": name, **fixed.to_dict(), "written": None if written is None else str(written)})
        return 0 if fixed.passes else 1
    if fixed.judged is not None:
        show_text(f"{name}\n{checks_text(fixed.judged.checks)}", quiet=quiet)
    if fixed.changes:
        show_text(f"changed\n{table(fixed.rows())}", quiet=quiet)
    show_text(str(fixed), quiet=quiet)
    if written is not None:
        show_text(f"wrote {written}\nnext: clacad export {written} -o exports --format step", quiet=quiet)
    return 0 if fixed.passes else 1
