"""`clacad optimise`: a design in, a better design of the same law out."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import degrees, inf
from pathlib import Path
from typing import TYPE_CHECKING

from clacad.cli.announce_cost import forecast
from clacad.cli.console import Progress, say, show_json, show_text
from clacad.cli.design_commands import load_counted
from clacad.cli.interrupts import INTERRUPTED
from clacad.cli.option_values import BadOption, design_file, parse_angle

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.optimising import Optimised
    from clacad.optimising.gain_as_made import GainAsMade

TASK = "optimise"


@dataclass(frozen=True)
class OptimiseRequest:
    """What the command line asked.

    out, compare : path or None
        The better design, and the page with before and after.
    free : tuple of str
    field : float or None, radians
        None: the design's.
    weights : tuple of (part of the field, weight)
    tolerances : bool
    seconds : float or None
    """

    out: Path | None
    compare: Path | None
    free: tuple[str, ...]
    field: float | None
    weights: tuple[tuple[float, float], ...]
    tolerances: bool
    seconds: float | None
    dry_run: bool
    overwrite: bool


def words_of(text: str) -> tuple[str, ...]:
    """Read "radii,conic" as words, each once.

    Raises
    ------
    BadOption
        A word twice.
    """
    words = tuple(word.strip() for word in text.split(",") if word.strip())
    twice = next((word for n, word in enumerate(words) if word in words[:n]), None)
    if twice is not None:
        raise BadOption(f"--free {text}: {twice} is named twice")
    return words


def field_of(text: str | None) -> float | None:
    """Read the half angle of --field as radians."""
    return None if text is None else parse_angle("--field", text)


def weights_of(text: str | None) -> tuple[tuple[float, float], ...]:
    """Read ".5:1,1:1" as parts of the field and their weights.

    Raises
    ------
    BadOption
    """
    if text is None:
        return ((1.0, 1.0),)
    found = []
    for one in text.split(","):
        part, colon, weight = one.partition(":")
        try:
            found.append((float(part), float(weight) if colon else 1.0))
        except ValueError:
            raise BadOption(f"--weights {text}: it is part:weight of the field, such as .5:1,1:1") from None
    return tuple(found)


def seconds_of(value: float | None) -> float | None:
    """Read --seconds.

    Raises
    ------
    BadOption
    """
    if value is not None and not (0.0 < value < inf):
        raise BadOption(f"--seconds {value:g}: it is a number of seconds above 0, such as 60")
    return value


def optimise_design(
    path: Path, overrides: list[str], request: OptimiseRequest, *, json: bool, quiet: bool
) -> int:
    """Search, write the better design, say what was gained; exit 1 where verify will fail, 130 when stopped."""
    design_file(request.out)
    design = load_counted(path, overrides)
    from clacad.optimising import optimise, outlook
    from clacad.optimising.optimised_text import design_text
    from clacad.storage.atomic import write_file

    page = _page(request)
    with _named_as_typed():
        ahead = outlook(design, request.free, request.weights, tolerances=request.tolerances)
    if page is not None:
        ahead["seconds"] += page_seconds()
    if request.dry_run:
        return _show_forecast(ahead, page, json=json, quiet=quiet)
    if request.out is None:
        raise BadOption("the better design needs a file: give it with -o better.toml")
    progress, ended = Progress(quiet=quiet), []

    def best_so_far(evaluations: int, rms: float) -> None:
        progress(f"best so far {1e3 * rms:.3g} mrad", min(0.99, evaluations / ahead["evaluations"]))

    def search(private: Path) -> None:
        with forecast(TASK, ahead["seconds"], quiet=quiet) as span:
            progress.expect(span.middle)
            found = optimise(
                design, request.free, request.field, best_so_far, weights=request.weights, tolerances=request.tolerances,
                seconds=request.seconds,
            )  # fmt: skip
        ended.append(found)
        private.write_text(design_text(found), encoding="utf-8", newline="\n")

    try:
        write_file(
            request.out, search, overwrite=request.overwrite
        )  # a name that is taken is refused before the search
        made = _compared(ended[0], page, overwrite=request.overwrite)
    finally:
        progress.done()
    return _finished(ended[0], made, request, json=json, quiet=quiet)


@contextmanager
def _named_as_typed() -> Iterator[None]:
    """Let mistakes in what shall be free name the option that they were typed behind.

    Raises
    ------
    DesignError
    """
    from clacad.design import DesignError

    try:
        yield
    except DesignError as error:
        found = [replace(one, path="--free") if one.key == "free" else one for one in error.mistakes]
        raise DesignError(found) from None


def page_seconds() -> float:
    """Processor seconds of a page."""
    from clacad.report.better_faces import SECONDS

    return SECONDS


def _page(request: OptimiseRequest) -> Path | None:
    """Where the page goes, if one is asked for; a name that is none, or is taken, is refused before the search."""
    if request.compare is None:
        return None
    from clacad.report.better_faces import html_file
    from clacad.storage.errors import ExportRefused

    page = html_file(request.compare)
    if page.exists() and not request.overwrite and not request.dry_run:
        raise ExportRefused(f"{page} exists; choose another name, or ask to overwrite")
    return page


def _compared(found: Optimised, page: Path | None, *, overwrite: bool) -> GainAsMade | None:
    """Write the page, unless the search was interrupted."""
    if page is None or found.stopped == "interrupted":
        return None
    from clacad.report.better_faces import write_before_and_after

    return write_before_and_after(found, page, overwrite)


def _show_forecast(ahead: dict[str, float], page: Path | None, *, json: bool, quiet: bool) -> int:
    """What a search would cost."""
    if json:
        show_json({"forecast": ahead})
    else:
        files = "one file of about 4 kB" + ("" if page is None else " and a page of about 1.4 MB")
        show_text(
            f"{ahead['unknowns']:.0f} unknowns, about {ahead['evaluations']:.0f} evaluations, about {ahead['seconds']:.2g} s "
            f"of processor time on one core, {files}; nothing is written",
            quiet=quiet,
        )
    return 0


def _finished(
    found: Optimised, made: GainAsMade | None, request: OptimiseRequest, *, json: bool, quiet: bool
) -> int:
    """Say what was found and written; the exit status."""
    out, failed = request.out, failing(found.design) if found.stopped != "interrupted" else []
    if json:
        more = {} if made is None else {"page": str(request.compare), "as_made": made.to_dict()}
        show_json(found.to_dict() | {"path": str(out), "failed": failed} | more)
    elif found.after:
        show_text("\n".join(_told(found, made)), quiet=quiet)
    for sentence in failed:
        say(f"verify will fail: {sentence}", quiet=quiet)
    pages = "" if made is None else f" and {request.compare}"
    next_step = (
        f"\nnext: clacad {'check' if failed else 'verify'} {out}" if found.stopped != "interrupted" else ""
    )
    say(f"wrote {out}{pages}{', the best so far' if found.stopped else ''}{next_step}", quiet=quiet)
    return INTERRUPTED if found.stopped == "interrupted" else 1 if failed else 0


def _told(found: Optimised, made: GainAsMade | None) -> list[str]:
    """What was found, for a person."""
    from clacad.optimising.optimised_text import expected, gains, left_out

    about = f"{found.design.name}: {found.unknowns} unknowns ({', '.join(found.free)}), {found.evaluations} evaluations"
    lines = [f"{about}, field {degrees(found.field):.4g} deg", *(f"  {text}" for text in gains(found))]
    lines += [expected(found)] if found.expected is not None else []
    lines += [left_out(found)] if found.left_out and not found.stopped else []
    lines += ["the seconds were over before the search had ended"] if found.stopped == "seconds" else []
    return lines + ([] if made is None else [made.sentence()])


def failing(design: Design) -> list[str]:
    """Sentences of the checks that verify will fail: design rules, and light through one cell."""
    from clacad.advice import judge

    return [f"{check.id}: {check.sentence}" for check in judge(design).failing]
