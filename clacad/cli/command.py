"""Registry of commands: each is a frozen dataclass, whose fields are its options, and a function.

Every module of this package whose name ends in `_command` states its commands as `COMMANDS`. Parser, help,
completion and `clacad explain` loop over them; a new command is one new module.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
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
