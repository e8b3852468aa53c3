"""`clacad new`: a design file from a template, for a wish, or from answers at a terminal; its schema."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.cli.command import Command, Overridden, dry_run_option, flag, option, overwrite_option
from clacad.cli.console import Brief, Console, facts, say, table
from clacad.cli.option_values import BadOption, command_line

if TYPE_CHECKING:
    from clacad.advice.proposal import Proposal

SCHEMA = "clacad.schema.json"
"""File that the first line of every template names; editors look for it in the design's own folder."""


@dataclass(frozen=True, kw_only=True)
class New(Overridden):
    """Write a commented design file: from a template, or for a wish, tried until it passes."""

    name: str | None = option(
        "NAME", "Name of the design; writes NAME.toml. Without it, a terminal prints questions."
    )
    template: str | None = option(
        "--template T",
        "paper, biconvex, galilean, slab, plano, hexagonal, tilted, window; or a design of the paper: "
        "fig3, fig6-theta-1, paper-b …; default paper.",
    )
    wishes: tuple[str, ...] = option(
        "--for KEY=VALUE,...",
        "Find a design that does this and passes verify: eta, width or circle, viewing, object, process, "
        "material, index, wavelength, pitch, flange, holes, form, kind, delta, euler, field, error, "
        "white; e.g. "
        "'eta=-1, circle=60 mm, process=moulding'. Repeatable.",
        (),
    )
    list: bool = flag("--list", "Print the templates with a line about each.")
    dry_run: bool = dry_run_option("Print the file, write nothing.")
    overwrite: bool = overwrite_option()


def run(request: New, console: Console) -> int:
    """Write the design and print the next step; without a name, print questions at a terminal.

    Raises DesignError, NoSuchSheet, CannotWrite, ExportRefused.
    """
    if request.list:
        from clacad.design import templates

        found = templates()
        console.show(lambda: found, lambda: "\n".join(_grouped(found)), lambda: _list_brief(found))
        return 0
    name, words = request.name, _words(request)
    if name is None:
        if request.wishes or request.template is not None or not (sys.stdin.isatty() and sys.stdout.isatty()):
            raise BadOption("a NAME is needed; only a terminal prints the question for it")
        name, words = ask()
    target = Path(f"{name.removesuffix('.toml')}.toml")
    if words is not None:
        return _from_wish(request, target, words, console)
    if request.set:
        raise BadOption("--set belongs to --for")
    return _from_template(request, target, console)


def _grouped(found: Mapping[str, str]) -> Iterator[str]:
    """Templates under headings: those to start from, then the paper's designs by figure."""
    from clacad.design.starter_designs import differences, figure_of

    figures = {name: figure_of(name) for name in found}
    yield "to start from"
    yield table(((f"  {name}", about) for name, about in found.items() if not figures[name]), "")
    for figure in dict.fromkeys(filter(None, figures.values())):
        names = [name for name in found if figures[name] == figure]
        yield f"the paper's {figure}, and what differs from paper-base"
        yield table(((f"  {name}", differences(name)) for name in names), "")


def _list_brief(found: Mapping[str, str]) -> Brief:
    """Templates to start from with a few words each; names of the paper's designs."""
    from re import split

    from clacad.design.starter_designs import figure_of

    rows = [(name, split("[.:,;] ", about)[0]) for name, about in found.items() if not figure_of(name)]
    paper = ", ".join(name for name in found if figure_of(name))
    return Brief(
        f"{len(found)} templates: clacad new NAME --template T", (facts([*rows, ("paper's", paper)]),)
    )


def _words(request: New) -> dict[str, Any] | None:
    """The words of the wish, None where there is none."""
    if request.wishes and request.template is not None:
        raise BadOption("--template and --for exclude each other")
    if not request.wishes:
        return None
    from clacad.advice.wish import parse_wish

    return parse_wish(request.wishes)


def _stem(target: Path) -> str:
    return target.name.removesuffix(".toml")


def _from_template(request: New, target: Path, console: Console) -> int:
    from clacad.design import template as text_of

    template = request.template or "paper"
    text = text_of(_stem(target), template)
    if not request.dry_run:
        with _place(target, overwrite=request.overwrite) as write:
            write(text)
    checking = command_line("clacad check", target)
    console.show(
        lambda: {"path": str(target), "template": template, "text": text, "written": not request.dry_run},
        lambda: (
            text.rstrip("\n")
            if request.dry_run
            else ("\n      ".join([f"wrote {target}\nnext: {checking}", _following(target)[0]]))
        ),
    )
    return 0


def _from_wish(request: New, target: Path, words: dict[str, Any], console: Console) -> int:
    from clacad.design import template

    template(_stem(target))  # a name that no design can have is refused before the search
    if request.dry_run:
        found = _searched(words, request, target, console)
    else:
        with _place(target, overwrite=request.overwrite) as write:  # and so is one that may not be written
            found = _searched(words, request, target, console)
            write(found.text)
    console.show(
        lambda: _document(found, target, written=not request.dry_run),
        lambda: found.text.rstrip("\n") if request.dry_run else _text(found, target),
        None if request.dry_run else lambda: _brief(found, words, target),
    )
    return 0


def _document(found: Proposal, target: Path, *, written: bool) -> dict[str, Any]:
    return {
        "path": str(target),
        "written": written,
        "wish": found.wish.words(),
        "text": found.text,
        "design": found.design.to_dict(),
        "passed": found.judged.passes,
        "checks": [check.to_dict() for check in found.judged.checks],
        "reasons": list(found.reasons),
        "trade_offs": [trade.to_dict() for trade in found.trades],
        "judged": found.judgements,
    }


def _text(found: Proposal, target: Path) -> str:
    """Reasons, neighbouring sizes, and the next step."""
    from clacad.advice.trade_offs import rows_of

    return "\n".join(
        [
            *found.reasons,
            "what other sizes would give, each built and traced:",
            table(rows_of(found.trades)),
            f"wrote {target}: {_verdict(found)} ({found.judgements} designs were built and judged)",
            "next: " + "\n      ".join(_following(target)),
        ]
    )


def _verdict(found: Proposal) -> str:
    """Outcome of verify, and the parts of the wish that the design does not fulfil."""
    from clacad.advice.proposal import not_met

    unmet = [text.partition(":")[0] for text in not_met(found.wish, found.judged)]
    return "verify will pass" + (f", the wish is not met: {', '.join(unmet)}" if unmet else "")


def _following(target: Path) -> tuple[str, str]:
    """Commands that make the design and judge its files."""
    out = target.with_suffix("")
    return command_line("clacad export", target, "-o", out, "--format", "step"), command_line(
        "clacad verify", target, "--files", out
    )


def _brief(found: Proposal, words: Mapping[str, Any], target: Path) -> Brief:
    """What was requested, the numbers of the design, what it does not do, next commands."""
    from clacad.advice.proposal import not_met, plain_words
    from clacad.advice.trade_offs import rows_of
    from clacad.cli.tables import counted, problems

    names, units, values = rows_of(found.trades[:1])
    made = [
        f"{name} {value} {unit.removeprefix('+- ')}".rstrip()
        for name, value, unit in zip(names, values, units, strict=True)
    ]
    rows = [
        ("requested", plain_words(words)),
        ("design", ", ".join(made[1:])),
        *(("not met", text) for text in not_met(found.wish, found.judged)),
    ]
    checks, word = found.judged.checks, _verdict(found)
    head = f"wrote {target}: {word} ({found.judgements} designs were built and judged)"
    return Brief(head, (facts(rows), problems(checks)), _following(target), word, counted(checks))


def _searched(words: dict[str, Any], request: New, target: Path, console: Console) -> Proposal:
    from clacad.advice.proposal import design_for

    with console.progress() as progress:
        return design_for(words, request.set, name=_stem(target), progress=progress)


@contextmanager
def _place(target: Path, *, overwrite: bool) -> Iterator[Callable[[str], None]]:
    """Place of the design and its schema; both are published together, once the design's text is given.

    A schema of another program is left alone.
    """
    from clacad.storage.atomic import Stage, translated, write_content
    from clacad.storage.errors import ExportRefused

    if target.is_file() and not target.is_symlink() and not overwrite:
        raise ExportRefused(f"{target} exists; --overwrite replaces it, another NAME keeps it")
    with Stage(target.parent, overwrite=overwrite) as stage:
        private, schema = stage.path(target.name), target.parent / SCHEMA

        def write(text: str) -> None:
            with translated(target):
                private.write_text(text, encoding="utf-8", newline="")
                if not schema.exists():
                    stage.path(SCHEMA).write_text(_schema_text(), encoding="utf-8", newline="")
            stage.publish()

        yield write
    found = schema.read_bytes() if schema.is_file() else b""
    if found and found != _schema_text().encode():
        if b'"title": "clacad design"' in found:
            write_content(schema, _schema_text(), overwrite=True)
        else:
            say(f"{schema} is not clacad's and was left as it is: editors will not complete keys")


def _schema_text() -> str:
    """The JSON Schema of design files as text."""
    from clacad.cli.console import json_text
    from clacad.design import json_schema

    return json_text(json_schema())


# -- questions at a terminal ---------------------------------------------------------------------------------


def _questions() -> tuple[tuple[str, str, str], ...]:
    """Word, question and default as typed of each question."""
    from clacad.advice.wish import KEYS, UNIT

    return (
        ("eta", "eta, one number or [x, y] (-1 turns light over, 0 < eta < 1 shrinks)", "-1"),
        ("delta", "offset delta [x, y]", "[0, 0]"),
        ("euler", "phi, theta, psi of the lens axes in degrees [phi, theta, psi]", "[0, 0, 0]"),
        ("size", "size: a width, [width, height], or 'circle 60 mm'", "50 mm"),
        ("viewing", "looked at from", "1 m"),
        ("process", f"process: {KEYS['process'].kind.allowed(UNIT)}".replace('"', ""), "diamond-turning"),
        ("material", "material", "PMMA"),
        ("form", f"form: {KEYS['form'].kind.allowed(UNIT)}".replace('"', ""), "any"),
        ("kind", f"cells: {KEYS['kind'].kind.allowed(UNIT)}".replace('"', ""), "square"),
    )


def ask() -> tuple[str, dict[str, Any]]:
    """Name and words of a wish, from answers at a terminal; a question is repeated after a wrong answer."""
    name = _answer("name of the design", "window", _name)
    words: dict[str, Any] = {}
    for word, question, default in _questions():
        words |= _answer(question, default, partial(_word, word, words))
    return name, words


def _answer(question: str, default: str, read: Callable[[str], Any]) -> Any:
    from clacad.config.mistakes import DesignError

    while True:
        try:
            typed = input(f"{question} [{default}]: ").strip() or default
        except EOFError:  # Ctrl-D: no more answers
            raise KeyboardInterrupt from None
        try:
            return read(typed)
        except DesignError as problem:
            print(problem)  # noqa: T201


def _name(text: str) -> str:
    from clacad.design import template

    template(text.removesuffix(".toml").rpartition("/")[2])
    return text


def _word(word: str, before: dict[str, Any], text: str) -> dict[str, Any]:
    """The answer as words of a wish, checked alone and with the earlier ones."""
    from clacad.advice.wish import read_wish, read_word, written

    if word == "size":
        word, text = (
            ("circle", text.removeprefix("circle").strip()) if text.startswith("circle") else ("width", text)
        )
    found = {word: written(text)}
    read_word(word, found[word])
    if "eta" in before or word == "eta":
        read_wish(
            {"width": 1.0, **{k: v for k, v in (before | found).items() if k not in ("width", "circle")}}
        )
    return found


COMMANDS = (Command("new", "make", New, run),)
