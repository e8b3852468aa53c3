"""What the commands share: help by purpose, and the options that mean the same wherever they stand."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from clacad.exporting.formats.registry import words
from clacad.exporting.request import OPTIONS

HELP = "Design, make and verify generalized confocal lenslet arrays."
EPILOG = """Same design, same bytes.

Exit status: 0 all checks passed; 1 a check failed or did not run; 2 bad input; 3 refused by a limit;
4 cannot write, or workers were lost; 70 internal; 130 interrupted.

Example: clacad export designs/paper-a-covered.toml -o exports/paper --format step,3mf,stl --cells 10x10"""

GROUPS = {
    "make": ("new", "check", "optimise", "shape", "export", "stack", "schema"),
    "look": ("trace", "image", "render", "explore", "wave", "atlas", "effects"),
    "judge": ("verify", "accuracy", "sweep", "tolerance"),
    "help": ("explain", "doctor"),
}


class Grouped(TyperGroup):
    """Lists commands by purpose, and takes texts and paths as they are given."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read what stands before the command."""
        _take_as_given(self, ctx)
        return super().parse_args(ctx, args)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of that name."""
        command = super().get_command(ctx, cmd_name)
        return command and _take_as_given(command, ctx)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write one section a purpose."""
        width = max((len(name) for name in self.commands), default=0)
        for title, names in GROUPS.items():
            rows = [
                (name.ljust(width), self.commands[name].get_short_help_str(90))
                for name in names
                if name in self.commands
            ]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write the epilog line by line, not refilled."""
        formatter.write("\n" + EPILOG + "\n")


def _take_as_given(command: Any, ctx: Any) -> Any:
    """The command, none of its parameters about to load pydantic for a text or a path."""
    for parameter in command.get_params(ctx):
        if getattr(parameter, "_runtime_param", ...) is None:
            parameter._runtime_param = _AsGiven()
    return command


class _AsGiven:
    """What texts and paths of the command line become: themselves. All else is left to the library.

    Releases of it that keep their conversion in `_runtime_param` load pydantic for every parameter, 0.08 s; others have no such
    thing and are let alone.
    """

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:
        """The value as the command takes it; refused as the library refuses."""
        wanted = param.type_descriptor.annotation
        if value is None:
            return () if param.multiple or param.nargs == -1 else None
        if isinstance(wanted, type) and type(value) is wanted:  # a text, or what stands there by default
            return value
        if (
            wanted is Path
            and isinstance(value, str)
            and (os.access(value, os.R_OK) or not os.path.exists(value))
        ):
            return Path(value)
        if wanted == list[str] and all(isinstance(one, str) for one in value):
            return list(value)
        param._runtime_param = None
        return param.get_runtime_param().coerce(value, param=param, ctx=ctx)


def print_version(value: bool) -> None:
    """Print the version and end."""
    if value:
        from clacad import __version__

        typer.echo(f"clacad {__version__}")
        raise typer.Exit


def _circumstances() -> dict[str, Any]:
    import platform
    import sys

    from clacad import __version__

    return {
        "version": __version__, "python": platform.python_version(), "system": f"{platform.system()} {platform.machine()}",
        "arguments": sys.argv[1:], "folder": os.getcwd(),
    }  # fmt: skip


def start_log(value: bool) -> bool:
    """Begin the log on standard error, if asked for."""
    if value:
        from clacad.base import log

        log.start()
        log.note("start", **_circumstances())
    return value


def declared(name: str) -> Any:
    """Option of a command that says what the declaration of exports says: flag, help and range."""
    option = OPTIONS[name]
    text = option.help.replace("{formats}", ", ".join(words()))
    return typer.Option(option.flag, metavar=option.metavar, min=option.least, max=option.most, help=text)


Design = Annotated[
    Path, typer.Argument(metavar="DESIGN", help="Design file (TOML or JSON).", show_default=False)
]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help='Override one value, e.g. --set "law.eta=[-1.4,-1]". Repeatable.'
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Result on stdout as JSON, everything else on stderr.")]
Quiet = Annotated[bool, typer.Option("-q", "--quiet", help="Errors only.")]
Verbose = Annotated[bool, typer.Option("-v", "--verbose", callback=start_log, help="Log what is done on stderr, one JSON "
                                      "object a line, with tracebacks.")]  # fmt: skip
Out = Annotated[
    Path, typer.Option("-o", "--out", metavar="DIR", help="Folder to write to.", show_default=False)
]
Cells = Annotated[str | None, declared("cells")]

Workers = Annotated[
    int | None, typer.Option("--workers", min=1, help="Processes on this machine; default one a core.")
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler", metavar="ADDRESS", help="Dask scheduler to work on instead, e.g. tcp://host:8786."
    ),
]
Again = Annotated[bool, typer.Option("--overwrite", help="Begin again; replace files of another origin.")]
Overwrite = Annotated[bool, declared("overwrite")]
Replace = Annotated[bool, typer.Option("--overwrite", help="Replace an existing file.")]
