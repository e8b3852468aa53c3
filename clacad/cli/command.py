"""Registry of commands: each is a frozen dataclass, whose fields are its options, and a function.

Every module of this package whose name ends in `_command` states its commands as `COMMANDS`. Parser, help,
completion and `clacad explain` loop over them; a new command is one new module.

Words of the command line → a request and a console.

Options may precede and follow arguments. An option takes the next word as its value, even one that begins
with a dash.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import MISSING, dataclass, field, fields
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

from clacad.cli.console import Console

Read = Callable[[str, str], Any]
"""Name of an option and its text → value; raises `BadOption`."""

GROUPS = ("make", "look", "judge", "help")
"""Purposes of commands, in the order of the help."""


@dataclass(frozen=True)
class Command:
    """One command.

    word : Word by which it is called.
    group : Purpose under which the help lists it, one of `GROUPS`.
    request : Frozen dataclass of its arguments and options; the docstring is the help sentence.
    run : Function of a request and a console that returns the exit status.
    """

    word: str
    group: str
    request: type
    run: Callable[[Any, Console], int]

    @property
    def sentence(self) -> str:
        """Help sentence: the first paragraph of the request's docstring."""
        return " ".join((self.request.__doc__ or "").strip().partition("\n\n")[0].split())


def commands(first: str = "") -> Iterator[Command]:
    """Every command, imported module by module; the module named after a word comes first."""
    package = import_module(__name__.rpartition(".")[0])
    names = (one.name for one in iter_modules(package.__path__) if one.name.endswith("_command"))
    for name in sorted(names, key=lambda name: (name != f"{first}_command", name)):
        yield from import_module(f"{package.__name__}.{name}").COMMANDS


def find(word: str) -> Command | None:
    """The command of a word, or None."""
    return next((one for one in commands(word) if one.word == word), None)


# -- fields of a request -------------------------------------------------------------------------------------


def option(
    form: str,
    help: str,
    default: Any = None,
    *,
    least: int | None = None,
    most: int | None = None,
    read: Read | None = None,
) -> Any:
    """Field of a request: an option, or an argument if the form has no flag.

    form : As the help shows it: "-o, --out DIR", "--dry-run", "--movies/--no-movies", "DESIGN", "DESIGN...".
    default : Value where it is not given; `dataclasses.MISSING` where one is required.
    least, most : Range of a number.
    read : Reader of the text in place of the type's own.
    """
    declaration = {"form": form, "help": help, "least": least, "most": most, "read": read}
    return field(default=default, metadata=declaration)


def required(form: str, help: str, *, read: Read | None = None) -> Any:
    """Field of a request that must be given."""
    return option(form, help, MISSING, read=read)


def flag(form: str, help: str) -> Any:
    """Field of a request that is a switch, off by default."""
    return option(form, help, False)


def declared(name: str, default: Any = MISSING, read: Read | None = None) -> Any:
    """Field of a request as an export declares it: flag, help, range, and the default if none is given."""
    from clacad.exporting.formats.registry import words
    from clacad.exporting.request import DEFAULTS, OPTIONS

    one = OPTIONS[name]
    text = one.help.replace("{formats}", ", ".join(words()))
    value = getattr(DEFAULTS, name) if default is MISSING else default
    return option(f"{one.flag} {one.metavar or ''}", text, value, least=one.least, most=one.most, read=read)


def dry_run_option(help: str = "Print the forecast, write nothing.") -> Any:
    """Option --dry-run."""
    return flag("--dry-run", help)


def overwrite_option(help: str = "Replace an existing file.") -> Any:
    """Option --overwrite."""
    return flag("--overwrite", help)


@dataclass(frozen=True, kw_only=True)
class Overridden:
    """Request with values of its design or scene overridden."""

    set: tuple[str, ...] = option(
        "--set KEY=VALUE", 'Override one value, e.g. --set "law.eta=[-1.4,-1]". Repeatable.', ()
    )


@dataclass(frozen=True, kw_only=True)
class OfDesign(Overridden):
    """Request about one design."""

    design: Path = required("DESIGN", "Design file (TOML or JSON).")


@dataclass(frozen=True, kw_only=True)
class OfDesignAsMade(OfDesign):
    """Request about a design, and about the sheet that its process makes."""

    as_made: bool = flag(
        "--as-made", "Also send light through the sheet as its process makes it ([process])."
    )
    process: str | None = option("--process NAME", "Process profile in place of check.process.")

    @property
    def overrides(self) -> tuple[str, ...]:
        """All overridden values."""
        return self.set if self.process is None else (*self.set, f'check.process="{self.process}"')


# -- parameters of the command line --------------------------------------------------------------------------


@dataclass(frozen=True)
class CommandParameter:
    """Argument or option as the parser and the help need it.

    name : Field of the request.
    kind : Type of one value: "bool", "int", "float", "str" or "Path".
    several : Whether it may be given repeatedly.
    flags, opposites : Flags that give the option, and those that switch it off; none of an argument.
    metavar : Placeholder of the value; "" for a switch.
    default, help, least, most, read : As in `option`.
    """

    name: str
    kind: str
    several: bool
    flags: tuple[str, ...]
    opposites: tuple[str, ...]
    metavar: str
    default: Any
    help: str
    least: int | None
    most: int | None
    read: Read | None

    @property
    def shown(self) -> str:
        """Name in error messages."""
        return " / ".join(f"'{flag}'" for flag in self.flags) or f"'{self.metavar}'"


METAVARS = {"bool": "", "int": "N", "float": "X", "str": "WORD", "Path": "FILE"}
"""Type of a value → its placeholder where the form has none."""


def parameters(request: type) -> list[CommandParameter]:
    """Arguments and options of a request, in the order of its fields."""
    return [
        _parameter(one.name, str(one.type), one.default, **one.metadata)
        for one in fields(request)
        if "form" in one.metadata
    ]


def _parameter(name: str, annotation: str, default: Any, *, form: str, **more: Any) -> CommandParameter:
    kind = annotation.removesuffix(" | None")
    several = kind.endswith(", ...]") and more["read"] is None
    kind = kind.removeprefix("tuple[").removesuffix(", ...]") if several else kind
    words = form.replace(", ", " ").split()
    pairs = [word.partition("/") for word in words if word.startswith("-")]
    metavar = " ".join(word for word in words if not word.startswith("-")) or METAVARS.get(kind, "WORD")
    opposites = tuple(off for _, _, off in pairs if off)
    return CommandParameter(
        name, kind, several, tuple(on for on, _, _ in pairs), opposites, metavar, default, **more
    )


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
