"""`clacad optimise`: a design in, a better design of the same law out."""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING

from clacad.cli.announce_cost import forecast
from clacad.cli.console import Progress, say, show_json, show_text
from clacad.cli.design_commands import load_counted
from clacad.cli.interrupts import INTERRUPTED
from clacad.cli.option_values import BadOption, parse_angle

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.optimising.search import Optimised

TASK = "optimise"


@dataclass(frozen=True)
class OptimiseRequest:
    """What the command line asked: where to write, what is free, over which field (radians; None: the design's)."""

    out: Path | None
    free: tuple[str, ...]
    field: float | None
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


def optimise_design(
    path: Path, overrides: list[str], request: OptimiseRequest, *, json: bool, quiet: bool
) -> int:
    """Search, write the better design, say what was gained; exit 1 where it breaks a design rule, 130 when stopped."""
    design = load_counted(path, overrides)
    from clacad.optimising import optimise, outlook
    from clacad.optimising.optimised_text import design_text
    from clacad.storage.atomic import write_file

    ahead = outlook(design, request.free)
    if request.dry_run:
        return _show_forecast(ahead, json=json, quiet=quiet)
    if request.out is None:
        raise BadOption("the better design needs a file: give it with -o better.toml")
    progress, ended = Progress(quiet=quiet), []

    def best_so_far(evaluations: int, rms: float) -> None:
        progress(f"best so far {1e3 * rms:.3g} mrad", min(0.99, evaluations / ahead["evaluations"]))

    def search(private: Path) -> None:
        with forecast(TASK, ahead["seconds"], quiet=quiet) as span:
            progress.expect(span.middle)
            ended.append(optimise(design, request.free, request.field, best_so_far))
        private.write_text(design_text(ended[0]), encoding="utf-8", newline="\n")

    try:
        write_file(
            request.out, search, overwrite=request.overwrite
        )  # a name that is taken is refused before the search
    finally:
        progress.done()
    return _finished(ended[0], request.out, json=json, quiet=quiet)


def _show_forecast(ahead: dict[str, float], *, json: bool, quiet: bool) -> int:
    """What a search would cost."""
    if json:
        show_json({"forecast": ahead})
    else:
        show_text(
            f"{ahead['unknowns']:.0f} unknowns, about {ahead['evaluations']:.0f} evaluations, about {ahead['seconds']:.2g} s "
            "of processor time on one core, one file of about 3 kB; nothing is written",
            quiet=quiet,
        )
    return 0


def _finished(found: Optimised, out: Path, *, json: bool, quiet: bool) -> int:
    """Say what was found and written; the exit status."""
    from clacad.optimising.optimised_text import gains

    failed = broken_rules(found.design) if found.finished else []
    if json:
        show_json(found.to_dict() | {"path": str(out), "failed": failed})
    elif found.finished:
        about = f"{found.design.name}: {found.unknowns} unknowns ({', '.join(found.free)}), {found.evaluations} evaluations"
        show_text(
            "\n".join([f"{about}, field {degrees(found.field):.4g} deg", *(f"  {t}" for t in gains(found))]),
            quiet=quiet,
        )
    for sentence in failed:
        say(f"design rule broken: {sentence}", quiet=quiet)
    say(
        f"wrote {out}" + (f"\nnext: clacad verify {out}" if found.finished else ", the best so far"),
        quiet=quiet,
    )
    return INTERRUPTED if not found.finished else 1 if failed else 0


def broken_rules(design: Design) -> list[str]:
    """Sentences of the design rules that a design breaks."""
    from clacad.prescription.prescribe import prescribe
    from clacad.sheet.feasibility import feasibility
    from clacad.verification import design_checks

    window = prescribe(design)
    checks = design_checks(design, window, feasibility(window))
    return [f"{check.id}: {check.sentence}" for check in checks if check.state == "fail"]
