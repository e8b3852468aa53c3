"""Run a command line: find the command, read its request, or print help, version or completions."""

from __future__ import annotations

import os
import sys
from collections.abc import Container, Sequence
from typing import Any

from clacad.base import log
from clacad.base.text import near
from clacad.cli.arguments import VARIABLE, BadUsage, Common, Start, scan
from clacad.cli.command import Command, commands, find, parameters
from clacad.cli.console import Console


def run(given: Sequence[str]) -> int:
    """Run a command line and return its exit status.

    Raises
    ------
    BadUsage, BadOption
        The words are no call of a command.
    Exception
        Any error of the command.
    """
    if os.environ.get(VARIABLE, "").startswith("complete_"):
        from clacad.cli.completion import complete

        text, status = complete(os.environ)
        print(text)  # noqa: T201
        return status
    start = scan([*parameters(Start), *parameters(Common)], given, up_to_word=True)
    before = start.common()
    if before.help or not given:
        from clacad.cli.help_text import program_help

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
        from clacad.cli.help_text import command_help

        print(command_help(command))  # noqa: T201
        return 0
    if common.verbose or before.verbose:
        log.start()
        log.note("start", **_circumstances())
    request = given.request(command.request)
    return command.run(request, Console(json=common.json or before.json, quiet=common.quiet or before.quiet))


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
