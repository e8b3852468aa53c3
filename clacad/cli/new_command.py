"""`clacad new`: a design file from a template, or from a wish; and the schema that editors read beside it."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from clacad.cli.console import Progress, say, show_json, show_text, table

if TYPE_CHECKING:
    from clacad.advice.proposal import Proposal

SCHEMA = "clacad.schema.json"
"""File that the first line of every template names; editors look for it in the design's own folder."""


@dataclass(frozen=True, slots=True)
class NewRequest:
    """What to write: NAME.toml from a template, or for a wish."""

    name: str | None
    template: str | None
    wishes: tuple[str, ...]
    overrides: tuple[str, ...]
    dry_run: bool
    overwrite: bool


def list_templates(*, json: bool, quiet: bool) -> int:
    """Print the templates with one line about each."""
    from clacad.design import templates

    found = templates()
    if json:
        show_json(found)
    else:
        show_text("\n".join(_grouped(found)), quiet=quiet)
    return 0


def _grouped(found: Mapping[str, str]) -> Iterator[str]:
    """Templates under headings: those to start from, then the paper's designs, the variants of one figure under its name."""
    from clacad.design.starter_designs import differences, figure_of

    figures = {name: figure_of(name) for name in found}
    yield "to start from"
    yield table(((f"  {name}", about) for name, about in found.items() if not figures[name]), "")
    for figure in dict.fromkeys(filter(None, figures.values())):
        names = [name for name in found if figures[name] == figure]
        yield f"the paper's {figure}, and what differs from paper-base"
        yield table(((f"  {name}", differences(name)) for name in names), "")


def new_design(request: NewRequest, *, json: bool, quiet: bool) -> int:
    """Write the design and say what to do next; without a name, ask at a terminal.

    Raises
    ------
    DesignError, NoSuchSheet, CannotWrite, ExportRefused
    """
    from clacad.cli.questions import ask

    name, words = request.name, _words(request)
    if name is None:
        if request.wishes or request.template is not None or not (sys.stdin.isatty() and sys.stdout.isatty()):
            raise typer.BadParameter(
                "a NAME is needed; it is asked for only at a terminal", param_hint="NAME"
            )
        name, words = ask()
    target = Path(f"{name.removesuffix('.toml')}.toml")
    stem = target.name.removesuffix(".toml")
    if words is not None:
        return _from_wish(request, target, stem, words, json=json, quiet=quiet)
    if request.overrides:
        raise typer.BadParameter("--set belongs to --for", param_hint="--set")
    return _from_template(request, target, stem, json=json, quiet=quiet)


def _words(request: NewRequest) -> dict[str, Any] | None:
    """The words of the wish, None where there is none."""
    from clacad.advice.wish import parse_wish

    if request.wishes and request.template is not None:
        raise typer.BadParameter("--template and --for exclude each other", param_hint="--for")
    return parse_wish(request.wishes) if request.wishes else None


def _from_template(request: NewRequest, target: Path, stem: str, *, json: bool, quiet: bool) -> int:
    from clacad.design import template as text_of

    template = request.template or "paper"
    text = text_of(stem, template)
    if not request.dry_run:
        with _place(target, overwrite=request.overwrite) as write:
            write(text)
    if json:
        show_json({"path": str(target), "template": template, "text": text, "written": not request.dry_run})
    elif request.dry_run:
        show_text(text.rstrip("\n"), quiet=quiet)
    else:
        out = target.with_suffix("")
        show_text(
            f"wrote {target}\nnext: clacad check {target}\n      clacad export {target} -o {out} --format step",
            quiet=quiet,
        )
    return 0


def _from_wish(
    request: NewRequest, target: Path, stem: str, words: dict[str, Any], *, json: bool, quiet: bool
) -> int:
    from clacad.design import template

    template(stem)  # a name that no design can have is refused before the search
    if request.dry_run:
        found = _searched(words, request, stem, quiet=quiet)
    else:
        with _place(target, overwrite=request.overwrite) as write:  # so is one that may not be written
            found = _searched(words, request, stem, quiet=quiet)
            write(found.text)
    if json:
        show_json(_document(found, target, written=not request.dry_run))
    elif request.dry_run:
        show_text(found.text.rstrip("\n"), quiet=quiet)
    else:
        show_text(_told(found, target), quiet=quiet)
    return 0


def _document(found: Proposal, target: Path, *, written: bool) -> dict[str, Any]:
    return {
        "path": str(target), "written": written, "wish": found.wish.words(), "text": found.text,
        "design": found.design.to_dict(), "passed": found.judged.passes,
        "checks": [check.to_dict() for check in found.judged.checks], "reasons": list(found.reasons),
        "trade_offs": [trade.to_dict() for trade in found.trades], "judged": found.judgements,
    }  # fmt: skip


def _told(found: Proposal, target: Path) -> str:
    """The reasons, the neighbours, and what comes next."""
    from clacad.advice.trade_offs import rows_of

    out = target.with_suffix("")
    return "\n".join([
        *found.reasons, "what other sizes would give, each built and traced:", table(rows_of(found.trades)),
        f"wrote {target}: verify will pass ({found.judgements} designs were built and judged)",
        f"next: clacad export {target} -o {out} --format step", f"      clacad verify {target} --files {out}",
    ])  # fmt: skip


def _searched(words: dict[str, Any], request: NewRequest, stem: str, *, quiet: bool) -> Proposal:
    from clacad.advice.proposal import design_for

    progress = Progress(quiet=quiet)
    try:
        return design_for(words, request.overrides, name=stem, progress=progress)
    finally:
        progress.done()


@contextmanager
def _place(target: Path, *, overwrite: bool) -> Iterator[Callable[[str], None]]:
    """A place for the design and, beside it, the schema; both appear at once, when the design's text was given.

    A schema of another program is left alone.
    """
    from clacad.storage.atomic import Stage, translated, write_content
    from clacad.storage.errors import ExportRefused

    if target.is_file() and not target.is_symlink() and not overwrite:
        raise ExportRefused(f"{target} exists; --overwrite replaces it, another NAME keeps it")
    with Stage(target.parent, overwrite=overwrite) as stage:
        private, beside = stage.path(target.name), target.parent / SCHEMA

        def write(text: str) -> None:
            with translated(target):
                private.write_text(text, encoding="utf-8", newline="")
                if not beside.exists():
                    stage.path(SCHEMA).write_text(_schema_text(), encoding="utf-8", newline="")
            stage.publish()

        yield write
    there = beside.read_bytes() if beside.is_file() else b""
    if there and there != _schema_text().encode():
        if b'"title": "clacad design"' in there:
            write_content(beside, _schema_text(), overwrite=True)
        else:
            say(f"{beside} is not clacad's and was left as it is: editors will not complete keys")


def _schema_text() -> str:
    """What `clacad schema` prints."""
    from clacad.cli.console import json_text
    from clacad.design import json_schema

    return json_text(json_schema())
