"""`clacad optimise`: faces that keep closer to the law of a design, written as a new design."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import degrees, inf
from pathlib import Path
from typing import TYPE_CHECKING

from clacad.base.text import mrad_text
from clacad.cli.command import Command, OfDesign, dry_run_option, flag, option, overwrite_option
from clacad.cli.console import Brief, Console, facts
from clacad.cli.entry_point import INTERRUPTED
from clacad.cli.option_values import (
    BadOption,
    cell_option,
    command_line,
    load_counted,
    of_cell,
    parse_angle,
    parse_design_file,
    parse_moves,
    parse_travel,
    words_of,
)

if TYPE_CHECKING:
    from clacad.checks.check import Check
    from clacad.design import Design
    from clacad.optimising import Optimised
    from clacad.report.better_faces import GainAsMade
    from clacad.steering import Scan

TASK = "optimise"


def _free(option: str, text: str) -> tuple[str, ...]:
    """Read "radii,conic" as words, each once. Raises BadOption: A word twice."""
    words = words_of(option, text)
    twice = next((word for n, word in enumerate(words) if word in words[:n]), None)
    if twice is not None:
        raise BadOption(f"{option} {text}: {twice} is named twice")
    return words


def _weights(option: str, text: str) -> tuple[tuple[float, float], ...]:
    """Read ".5:1,1:1" as parts of the field and their weights."""
    found = []
    for one in text.split(","):
        part, colon, weight = one.partition(":")
        try:
            found.append((float(part), float(weight) if colon else 1.0))
        except ValueError:
            raise BadOption(f"{option} {text}: it is part:weight of the field, such as .5:1,1:1") from None
    return tuple(found)


@dataclass(frozen=True, kw_only=True)
class Optimise(OfDesign):
    """Search for faces that keep closer to the law; write them as a design with given faces."""

    out: Path | None = option("-o, --out FILE", "Better design file to write.", read=parse_design_file)
    free: tuple[str, ...] = option(
        "--free A,B",
        "What may change: radii, conic, bending (own radii a face), a4, a6, a8, offset, field (the field "
        "lens); of listed plates also thickness and joints.",
        ("radii", "conic"),
        read=_free,
    )
    field: float | None = option(
        "--field E",
        "Half angle of the cone of rays, e.g. '1 deg'; default the design's check.field.",
        read=parse_angle,
    )
    weights: tuple[tuple[float, float], ...] | None = option(
        "--weights P:W,P:W",
        "Parts of the field and the weight of each, e.g. .5:1,1:1; default the whole field.",
        read=_weights,
    )
    spectrum: str | None = option(
        "--spectrum WORD",
        "Seek the least mean error over lines of light: visible (F e d C), photopic, or design (its "
        "[light]); default the design's wavelength.",
    )
    scan: str | None = option(
        "--scan LENGTH",
        "Of plates that move by up to this to either side, e.g. '±50 um': seek the least spread at all "
        "positions, with the exit beam, the last slope and the share held.",
    )
    axis: str = option("--axis A", "Axis of the scan: x, y or xy.", "x")
    move: dict[int, float] | None = option(
        "--move plate2=1,plate3=.5",
        "Plates that the scan moves, and their part of the travel; default the last by 1.",
        read=parse_moves,
    )
    starts: int = option(
        "--starts N", "Starts of the search, the first from the design's faces.", 1, least=1, most=1000
    )
    tolerances: bool = flag(
        "--tolerances",
        "Seek the least expected error of parts made with the design's [tolerances], not of the perfect "
        "part.",
    )
    seconds: float | None = option(
        "--seconds S",
        "End the search after this time with the best so far; a search that ends earlier gives the same "
        "result with any number.",
    )
    compare: Path | None = option(
        "--compare PAGE",
        "Write a page with before and after: spots, error maps, sections, thicknesses, and whether the "
        "gain survives 1 µm and 0.1 mrad.",
    )
    cell: tuple[int, int] | None = cell_option()
    dry_run: bool = dry_run_option()
    overwrite: bool = overwrite_option()


def run(request: Optimise, console: Console) -> int:
    """Search, write the better design, print the gain; exit 1 where verify will fail, 130 when stopped."""
    if request.seconds is not None and not 0.0 < request.seconds < inf:
        raise BadOption(f"--seconds {request.seconds:g}: it is a number of seconds above 0, such as 60")
    design = of_cell(load_counted(request.design, request.set), request.cell)
    from clacad.optimising import Effort, optimise, outlook
    from clacad.optimising.search import design_text
    from clacad.storage.atomic import write_file

    page, weights = _page(request), request.weights or ((1.0, 1.0),)
    scan = _scan(request, design)
    with _named_as_typed():
        ahead = outlook(
            design, request.free, weights, tolerances=request.tolerances, spectrum=request.spectrum, scan=scan
        )
    ahead["seconds"] *= request.starts
    ahead["seconds"] += _page_seconds(page)
    if request.dry_run:
        console.show(lambda: {"forecast": ahead}, lambda: _forecast_text(ahead, page))
        return 0
    if request.out is None:
        raise BadOption("the better design needs a file: give it with -o better.toml")
    ended: list[Optimised] = []

    def best_so_far(evaluations: int, rms: float) -> None:
        progress(f"best so far {mrad_text(rms, 3)}", min(0.99, evaluations / ahead["evaluations"]))

    def search(private: Path) -> None:
        with console.forecast(TASK, ahead["seconds"]) as span:
            progress.expect(span.middle)
            found = optimise(
                design,
                request.free,
                scan or request.field,
                best_so_far,
                weights=weights,
                tolerances=request.tolerances,
                seconds=Effort(request.seconds, request.starts),
                spectrum=request.spectrum,
            )
        ended.append(found)
        private.write_text(design_text(found), encoding="utf-8", newline="\n")

    with console.progress() as progress:
        write_file(request.out, search, overwrite=request.overwrite)  # refuses a taken name before the search
        made = _compared(ended[0], page, overwrite=request.overwrite)
    return _finished(ended[0], made, request, console)


def _scan(request: Optimise, design: Design) -> Scan | None:
    """Positions of the requested scan."""
    if request.scan is None:
        if request.move is not None:
            raise BadOption("--move belongs to --scan, the travel of the plates")
        return None
    from clacad.steering import Scan

    return Scan(parse_travel("--scan", request.scan, design.unit), request.axis, request.move)


@contextmanager
def _named_as_typed() -> Iterator[None]:
    """Report mistakes in the words of --free under the name of the option."""
    from clacad.design import DesignError

    try:
        yield
    except DesignError as error:
        found = [replace(one, path="--free") if one.key == "free" else one for one in error.mistakes]
        raise DesignError(found) from None


def _page(request: Optimise) -> Path | None:
    """Path of the requested page; an invalid or taken name is refused before the search."""
    if request.compare is None:
        return None
    from clacad.report.better_faces import html_file
    from clacad.storage.errors import ExportRefused

    page = html_file(request.compare)
    if page.exists() and not request.overwrite and not request.dry_run:
        raise ExportRefused(f"{page} exists; choose another name, or ask to overwrite")
    return page


def _page_seconds(page: Path | None) -> float:
    """Seconds that a page takes."""
    if page is None:
        return 0.0
    from clacad.report.better_faces import SECONDS

    return SECONDS


def _compared(found: Optimised, page: Path | None, *, overwrite: bool) -> GainAsMade | None:
    """Write the page, unless the search was interrupted."""
    if page is None or found.stopped == "interrupted":
        return None
    from clacad.report.better_faces import write_before_and_after

    return write_before_and_after(found, page, overwrite)


def _forecast_text(ahead: dict[str, float], page: Path | None) -> str:
    files = "one file of about 4 kB" + ("" if page is None else " and a page of about 1.4 MB")
    return (
        f"{ahead['unknowns']:.0f} unknowns, about {ahead['evaluations']:.0f} evaluations, about "
        f"{ahead['seconds']:.2g} s of processor time on one core, {files}; nothing is written"
    )


def _finished(found: Optimised, made: GainAsMade | None, request: Optimise, console: Console) -> int:
    """Print what was found and written; the exit status."""
    from clacad.advice import judge

    out, interrupted = request.out, found.stopped == "interrupted"
    judged = None if interrupted else judge(found.design)
    checks = () if judged is None else judged.failing
    failed = [f"{one.id}: {one.sentence}" for one in checks]
    more = {} if made is None else {"page": str(request.compare), "as_made": made.to_dict()}
    following = command_line("clacad check" if failed else "clacad verify", str(out))
    word = "" if judged is None else judged.verdict()
    pages = "" if made is None else f" and {request.compare}"
    written = f"wrote {out}{pages}{', the best so far' if found.stopped else ''}"
    wrong = [f"verify will fail: {sentence}" for sentence in failed]
    if console.json or found.after:
        console.show(
            lambda: found.to_dict() | {"path": str(out), "failed": failed} | more,
            lambda: "\n".join(
                [*_lines(found, made), *wrong, *([] if interrupted else [f"next: {following}"])]
            ),
            lambda: _brief(found, made, checks, word, () if interrupted else (following,)),
        )
    console.say(written)
    return INTERRUPTED if interrupted else 1 if failed else 0


def _brief(
    found: Optimised, made: GainAsMade | None, failing: Sequence[Check], word: str, following: tuple[str, ...]
) -> Brief:
    """The gain over the field, what of it survives as made, the checks that will fail, the verdict."""
    from clacad.cli.tables import problems

    about, *gained = _lines(found, made)[: -1 if made is not None else None]
    own = min(range(len(found.before)), key=lambda k: abs(found.before[k].field - found.field))
    errors = (mrad_text(one.law_rms) for one in (found.before[own], found.after[own]))
    head = f"{found.design.name}: rms error to the law {'  ->  '.join(errors)}"
    rows = [("as made", "" if made is None else made.sentence())]
    rows += [("field", text.strip()) for text in gained]
    return Brief(head, (facts([*rows, ("search", about)]), problems(failing)), following, word)


def _lines(found: Optimised, made: GainAsMade | None) -> list[str]:
    """The gain as text."""
    from clacad.optimising.search import expected, gains, left_out

    free = ", ".join(found.free)
    about = f"{found.design.name}: {found.unknowns} unknowns ({free}), {found.evaluations} evaluations"
    lines = [f"{about}, field {degrees(found.field):.4g} deg", *(f"  {text}" for text in gains(found))]
    lines += [expected(found)] if found.expected is not None else []
    lines += [left_out(found)] if found.left_out and not found.stopped else []
    lines += ["the seconds were over before the search had ended"] if found.stopped == "seconds" else []
    return lines + ([] if made is None else [made.sentence()])


COMMANDS = (Command("optimise", "make", Optimise, run),)
