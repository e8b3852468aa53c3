"""Run a command line: find the command, read its request, or print help, version or completions."""

from __future__ import annotations

import os
import sys
from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import MISSING
from textwrap import fill, wrap
from typing import Any

from clacad.base import log
from clacad.base.text import near
from clacad.cli.command import (
    GROUPS,
    PROGRAM,
    VARIABLE,
    BadUsage,
    Command,
    CommandParameter,
    Common,
    Start,
    commands,
    find,
    parameters,
    scan,
)
from clacad.cli.console import Console

ABOUT = "Design, make and verify generalized confocal lenslet arrays."
EPILOG = """Same design, same bytes.

Exit status: 0 all checks passed; 1 a check failed or did not run; 2 bad input; 3 refused by a limit;
4 cannot write, or workers were lost; 70 internal; 130 interrupted.

Example: clacad export designs/paper-a-covered.toml -o exports/paper --format step,3mf,stl --cells 10x10"""

WIDEST, NARROWEST = 110, 52
"""Columns of help."""

FIRST_COLUMN = 30
"""Most characters of a form next to which its help begins."""


def run(given: Sequence[str]) -> int:
    """Run a command line and return its exit status.

    Raises BadUsage, BadOption: The words are no call of a command.
    Raises Exception: Any error of the command.
    """
    if os.environ.get(VARIABLE, "").startswith("complete_"):
        from clacad.cli.completion import complete

        text, status = complete(os.environ)
        print(text)  # noqa: T201
        return status
    start = scan([*parameters(Start), *parameters(Common)], given, up_to_word=True)
    before = start.common()
    if before.help or not given:
        print(program_help(list(commands())), file=sys.stdout if given else sys.stderr)
        return 0 if given else 2
    if start.options.keys() & {"version", "show_completion", "install_completion"}:
        print(_answer(start.options.keys()))  # noqa: T201
        return 0
    if not start.rest:
        raise BadUsage("Missing command.", "")
    word, *rest = start.rest
    command = find(word)
    if command is None:
        words = near(word, [one.word for one in commands()], most=3)
        meant = f" Did you mean {', '.join(map(repr, words))}?" if words else ""
        raise BadUsage(f"No such command {word!r}.{meant}", "")
    return _run(command, rest, before)


def _run(command: Command, words: Sequence[str], before: Common) -> int:
    """Run a command; switches that precede it count as those that follow it."""
    given = scan([*parameters(command.request), *parameters(Common)], words, command.word)
    common = given.common()
    if common.help:
        print(command_help(command))  # noqa: T201
        return 0
    if common.verbose or before.verbose:
        log.start()
        log.note("start", **_circumstances())
    request = given.request(command.request)
    switches = {name: getattr(common, name) or getattr(before, name) for name in ("json", "quiet", "all")}
    return command.run(request, Console(**switches))


def _answer(given: Container[str]) -> str:
    """Text that an option of the program itself prints."""
    from clacad import __version__
    from clacad.cli.completion import install_completion, show_completion

    if "version" in given:
        return f"clacad {__version__}"
    return show_completion() if "show_completion" in given else install_completion()


def _circumstances() -> dict[str, Any]:
    """What the log records of the call."""
    import platform

    from clacad import __version__

    return {
        "version": __version__,
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        "arguments": sys.argv[1:],
        "folder": os.getcwd(),
    }


def program_help(known: Sequence[Command]) -> str:
    """Help of the program: its options, and the commands by purpose."""
    width = _width()
    longest = max(len(one.word) for one in known)
    blocks = [
        f"Usage: {PROGRAM} [OPTIONS] COMMAND [ARGS]...",
        fill(ABOUT, width, initial_indent="  ", subsequent_indent="  "),
        _section("Options", _options([*parameters(Start), *parameters(Common)]), width),
    ]
    ordered = sorted(known, key=lambda one: one.word)
    for group in GROUPS:
        rows = [(one.word.ljust(longest), one.sentence) for one in ordered if one.group == group]
        blocks += [_section(group, rows, width)] if rows else []
    return "\n\n".join([*blocks, EPILOG])


def command_help(command: Command) -> str:
    """Help of one command: what it does, its arguments and options."""
    width, known = _width(), parameters(command.request)
    arguments = [one for one in known if not one.flags]
    places = "".join(f" {_place(one)}" for one in arguments)
    blocks = [
        f"Usage: {PROGRAM} {command.word} [OPTIONS]{places}",
        fill(command.sentence, width, initial_indent="  ", subsequent_indent="  "),
    ]
    if arguments:
        blocks.append(_section("Arguments", [(one.metavar, _about(one)) for one in arguments], width))
    options = [one for one in known if one.flags]
    return "\n\n".join([*blocks, _section("Options", _options([*options, *parameters(Common)]), width)])


def _width() -> int:
    from shutil import get_terminal_size

    return max(min(get_terminal_size().columns, WIDEST), NARROWEST) - 2


def _place(one: CommandParameter) -> str:
    """An argument in the line of usage."""
    return f"{{{one.metavar}}}" if one.default is MISSING else f"[{one.metavar}]"


def _options(known: Iterable[CommandParameter]) -> Iterator[tuple[str, str]]:
    for one in known:
        form = ", ".join(one.flags) + "".join(f" / {flag}" for flag in one.opposites)
        yield f"{form} {one.metavar}".rstrip(), _about(one)


def _about(one: CommandParameter) -> str:
    """Help of a parameter, with its default and range."""
    notes = [_range(one.least, one.most)]
    if one.default is MISSING:
        notes.insert(0, "required")
    elif (shown := _default(one)) is not None:
        notes.insert(0, f"default: {shown}")
    notes = [note for note in notes if note]
    return f"{one.help}  [{'; '.join(notes)}]" if notes else one.help


def _default(one: CommandParameter) -> Any:
    """Default as it would be given; None where the help does not show it."""
    if one.kind == "bool":
        flags = one.flags if one.default else one.opposites
        return flags[0].lstrip("-") if one.opposites else None
    if one.default in (None, (), ""):
        return None
    return ",".join(one.default) if isinstance(one.default, tuple) else one.default


def _range(least: int | None, most: int | None) -> str:
    if most is None:
        return "" if least is None else f"x>={least}"
    return f"x<={most}" if least is None else f"{least}<=x<={most}"


def _section(title: str, rows: Iterable[tuple[str, str]], width: int) -> str:
    """Heading, and one form a row with its help in a second column."""
    rows = list(rows)
    first = min(max(len(form) for form, _ in rows), FIRST_COLUMN) + 2
    lines = [f"{title}:"]
    for form, about in rows:
        text = wrap(about, max(width - first - 2, 10), break_on_hyphens=False)
        if len(form) > FIRST_COLUMN:
            lines.append(f"  {form}")
            form = ""
        lines.append(f"  {form.ljust(first)}{text[0]}")
        lines += [f"  {'':{first}}{line}" for line in text[1:]]
    return "\n".join(lines)
