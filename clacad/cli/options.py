"""What the commands share: help by purpose, and the options that mean the same wherever they stand."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

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
    """Lists commands by purpose."""

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


def print_version(value: bool) -> None:
    """Print the version and end."""
    if value:
        from clacad import __version__

        typer.echo(f"clacad {__version__}")
        raise typer.Exit


def _circumstances() -> dict[str, Any]:
    import os
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
    return typer.Option(
        option.flag, metavar=option.metavar, min=option.least, max=option.most, help=option.help
    )


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
