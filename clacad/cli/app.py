"""Run a command line: find the command, read its request, or print help, version or completions.

Words of the command line → a request and a console.

Options may precede and follow arguments. An option takes the next word as its value, even one that begins
with a dash.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from textwrap import fill, wrap
from typing import Any

from clacad.base import log
from clacad.base.text import near
from clacad.cli.command import GROUPS, Command, CommandParameter, commands, find, flag, parameters
from clacad.cli.console import Console

PROGRAM = "clacad"

VARIABLE = "_CLACAD_COMPLETE"
"""Environment variable by which a shell requests completions."""


@dataclass(frozen=True)
class Common:
    """Options of every command."""

    json: bool = flag("--json", "Result on stdout as JSON, everything else on stderr.")
    quiet: bool = flag("-q, --quiet", "Errors only.")
    all: bool = flag("--all", "Print every number and every check that passes, not only 24 lines.")
    verbose: bool = flag(
        "-v, --verbose", "Log every step on stderr, one JSON object a line, with tracebacks."
    )
    help: bool = flag("-h, --help", "Show this message and exit.")


@dataclass(frozen=True)
class Start:
    """Options of the program itself, before the command."""

    version: bool = flag("--version", "Print the version.")
    install_completion: bool = flag("--install-completion", "Install completion for the current shell.")
    show_completion: bool = flag(
        "--show-completion",
        "Show completion for the current shell, to copy it or customize the installation.",
    )


class BadUsage(ValueError):
    """Words that are no call of a command; exit status 2."""

    exit_status = 2

    def __init__(self, message: str, word: str) -> None:
        super().__init__(f"{message}\n  try: {' '.join(filter(None, (PROGRAM, word)))} --help")


@dataclass
class Given:
    """What was given: texts of options by field, other words in order, words left unread."""

    word: str
    options: dict[str, list[Any]]
    words: list[str]
    rest: list[str]

    def common(self) -> Common:
        """The options of every command that were given."""
        return Common(**{one.name: bool(self.options.get(one.name, [False])[-1]) for one in fields(Common)})

    def request(self, request: type) -> Any:
        """The request.

        Raises BadUsage: A required one is missing, a value has the wrong type or range, or a word is left
            over.
        Raises BadOption.
        """
        words, values = list(self.words), {}
        for one in parameters(request):
            texts = self.options.get(one.name, []) if one.flags else _share(one, words)
            if texts:
                values[one.name] = self._value(one, texts)
            elif one.default is MISSING:
                raise BadUsage(f"Missing {'option' if one.flags else 'argument'} {one.shown}.", self.word)
        if words:
            raise BadUsage(f"Got unexpected extra argument(s) ({' '.join(words)})", self.word)
        return request(**values)

    def _value(self, one: CommandParameter, texts: list[Any]) -> Any:
        if one.several:
            return tuple(self._single(one, text) for text in texts)
        return self._single(one, texts[-1])

    def _single(self, one: CommandParameter, text: Any) -> Any:
        if one.read is not None:
            return one.read(next((f for f in one.flags if f.startswith("--")), one.metavar), text)
        try:
            return _typed(one, text)
        except ValueError as error:
            raise BadUsage(f"Invalid value for {one.shown}: {error}", self.word) from None


def _share(one: CommandParameter, words: list[str]) -> list[str]:
    """Take the words of an argument off the list."""
    count = len(words) if one.several else 1
    taken, words[:] = words[:count], words[count:]
    return taken


def _typed(one: CommandParameter, text: Any) -> Any:
    """A text as the type of a parameter."""
    if one.kind in ("bool", "str"):
        return text
    if one.kind == "Path":
        if os.path.exists(text) and not os.access(text, os.R_OK):
            raise ValueError(f"path {text!r} is not readable.")
        return Path(text)
    try:
        number = int(text) if one.kind == "int" else float(text)
    except ValueError:
        named = ("a valid integer", "an integer") if one.kind == "int" else ("a valid number", "a number")
        raise ValueError("Input should be {}, unable to parse string as {}".format(*named)) from None
    if one.least is not None and number < one.least:
        raise ValueError(f"Input should be greater than or equal to {one.least}")
    if one.most is not None and number > one.most:
        raise ValueError(f"Input should be less than or equal to {one.most}")
    return number


def scan(
    known: Sequence[CommandParameter], given: Sequence[str], word: str = "", *, up_to_word: bool = False
) -> Given:
    """Sort the words of the command line into options and others.

    word : The command, for messages.
    up_to_word : Whether to end at the first word that is no option.
    Raises BadUsage: An unknown option, one without its value, or a switch with a value.
    """
    flags = {flag: (one, True) for one in known for flag in one.flags}
    flags |= {flag: (one, False) for one in known for flag in one.opposites}
    found, left = Given(word, {}, [], []), list(given)
    while left:
        text = left.pop(0)
        if text == "--" or (not _is_option(text) and up_to_word):
            found.rest = left if text == "--" else [text, *left]
            break
        if not _is_option(text):
            found.words.append(text)
        elif text.startswith("--"):
            flag, equals, value = text.partition("=")
            _take(found, flags, flag, value if equals else None, left)
        else:
            _take_letters(found, flags, text[1:], left)
    if not up_to_word:
        found.words, found.rest = found.words + found.rest, []
    return found


def _is_option(text: str) -> bool:
    return text.startswith("-") and text != "-"


Flags = dict[str, tuple[CommandParameter, bool]]


def _take(found: Given, flags: Flags, flag: str, value: str | None, left: list[str]) -> None:
    """Note one option with its value, which may be the next word."""
    if flag not in flags:
        raise BadUsage(f"No such option: {flag}{_possible(flag, flags)}", found.word)
    one, on = flags[flag]
    if one.kind == "bool":
        if value is not None:
            raise BadUsage(f"Option '{flag}' does not take a value.", found.word)
        found.options.setdefault(one.name, []).append(on)
        return
    if value is None:
        if not left:
            raise BadUsage(f"Option '{flag}' requires an argument.", found.word)
        value = left.pop(0)
    found.options.setdefault(one.name, []).append(value)


def _take_letters(found: Given, flags: Flags, letters: str, left: list[str]) -> None:
    """Note options of one letter that are written together, the last one with its value: -qo DIR, -oDIR."""
    for k, letter in enumerate(letters):
        flag, rest = f"-{letter}", letters[k + 1 :]
        takes_value = flag in flags and flags[flag][0].kind != "bool"
        _take(found, flags, flag, rest if takes_value and rest else None, left)
        if takes_value:
            return


def _possible(flag: str, flags: Flags) -> str:
    from difflib import get_close_matches

    near = sorted(get_close_matches(flag, [one for one in flags if one.startswith("--")]))
    return f" (Possible options: {', '.join(near)})" if near else ""


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
