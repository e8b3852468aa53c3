"""`clacad steer`: plates that move, and where the light goes at every position."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

from clacad.base.text import mrad_text, percent_text, table
from clacad.cli.command import Command, OfDesign, dry_run_option, option, overwrite_option, required
from clacad.cli.console import Brief, Console, facts
from clacad.cli.option_values import BadOption, load_counted, parse_angle, parse_moves, parse_travel

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.steering import Position, Steered

TASK = "steer"

KINDS = (".csv", ".png", ".svg", ".html")
"""Endings of the files that are written."""

SECONDS_A_RAY, SECONDS_OF_WAVES = 4e-6, 0.8
"""Processor seconds for each ray, and for the waves of a position, on the reference machine."""


@dataclass(frozen=True, kw_only=True)
class SteerBeam(OfDesign):
    """Move plates of a design and print where light along the normal goes at every position."""

    travel: str = required("--travel LENGTH", "Largest displacement to either side, e.g. '±50 um'.")
    axis: str = option("--axis A", "x, y, xy (along both at once) or z (along the normal: focus).", "x")
    move: dict[int, float] | None = option(
        "--move plate2=1,plate3=.5",
        "Plates that move, in the order of the light, and their part of the travel; default the last by 1.",
        read=parse_moves,
    )
    positions: int = option("--positions N", "Positions of the scan.", 11, least=2, most=1001)
    rays: int = option("--rays N", "Rays over a cell.", 8192, least=64, most=1_000_000)
    waves: bool = option(
        "--waves/--no-waves", "Efficiency of diffraction orders in coherent light; most of the time.", True
    )
    tilt: float | None = option(
        "--tilt ANGLE",
        "Tilt of each plate that moves, e.g. '0.1 mrad': print how much the exit slopes change by it.",
        read=parse_angle,
    )
    out: Path | None = option("-o, --out FILE", "Table .csv, picture .png or .svg, page with a slider .html.")
    dry_run: bool = dry_run_option()
    overwrite: bool = overwrite_option()


def run(request: SteerBeam, console: Console) -> int:
    """Scan, print the positions, write the file."""
    kind = None if request.out is None else request.out.suffix.lower()
    if request.out is not None and kind not in KINDS:
        raise BadOption(f"-o {request.out}: the name ends in {', '.join(KINDS)}")
    design = load_counted(request.design, request.set)
    travel = parse_travel("--travel", request.travel, design.unit)
    seconds = 0.5 + request.positions * (
        SECONDS_A_RAY * request.rays + (SECONDS_OF_WAVES if request.waves else 0.0)
    )
    if request.dry_run:
        console.show(
            lambda: {"forecast": {"positions": request.positions, "seconds": seconds}},
            lambda: (
                f"{request.positions} positions, about {seconds:.2g} s of processor time; nothing is written"
            ),
        )
        return 0
    from clacad.steering import Scan, steer
    from clacad.storage.atomic import require_writable, write_content

    if request.out is not None:
        require_writable(request.out, overwrite=request.overwrite)
    with console.progress() as progress, console.forecast(TASK, seconds) as span:
        progress.expect(span.middle)
        scan = Scan(travel, request.axis, request.move, request.positions, request.tilt or 0.0)
        found = steer(design, scan, rays=request.rays, waves=request.waves, progress=progress)
    if request.out is not None and kind is not None:
        write_content(request.out, _content(design, found, kind), overwrite=request.overwrite)
    console.show(found.to_dict, lambda: _text(found), lambda: _brief(found))
    if request.out is not None:
        console.say(f"wrote {request.out}")
    return 0


def _content(design: Design, found: Steered, kind: str) -> str | bytes:
    """Content of the requested file."""
    from clacad.report.scan_files import csv_text, page, picture

    if kind == ".html":
        return page(design, found)
    return csv_text(found) if kind == ".csv" else picture(found, "png" if kind == ".png" else "svg")


HEAD = ("travel/{}", "slope/mrad", "paraxial", "spread", "share", "beam/p", "order", "efficiency", "on order")


FOCUS = (HEAD[0], "convergence, 1/m", *HEAD[3:6])
"""Columns of a travel along the normal, which steers no beam."""

LOST = "-"
"""What is printed where no light passes its own lenses."""


def _rows(found: Steered) -> list[tuple[str, ...]]:
    """Head and one row for each position."""
    head: tuple[str, ...] = HEAD
    rows = list(map(_row, found.positions))
    if found.axis == "z":
        powers = [_known(one.power, ".4g") for one in found.positions]
        head, rows = FOCUS, [(row[0], power, *row[3:6]) for row, power in zip(rows, powers, strict=True)]
    return [(head[0].format(found.unit), *head[1:]), *rows]


def _known(value: float, style: str, lost: str = LOST) -> str:
    return format(value, style) if isfinite(value) else lost


def _row(one: Position) -> tuple[str, ...]:
    """One position as text; slopes and spread in thousandths."""
    slopes, paraxial = (
        ", ".join(_known(round(1e3 * value, 3) + 0.0, ".4g") for value in pair)
        for pair in (one.slopes, one.closed_form)
    )
    waves = [_known(v, ".3f", "") for v in (one.efficiency, one.efficiency_on_order)]
    return (
        f"{one.travel:.4g}",
        slopes,
        paraxial,
        mrad_text(one.spread, 3, unit="") if isfinite(one.spread) else LOST,
        percent_text(one.share, 1, fixed=True),
        _known(one.exit_beam_over_pitch, ".3f"),
        "{}, {}".format(*one.diffraction_order),
        *waves,
    )


def _verdict(found: Steered) -> str:
    """Reach, spread and share of the whole scan."""
    both, lost = (found.lit[0], found.lit[-1]), len(found.positions) - len(found.lit)
    if found.axis == "z":
        low, high = sorted(one.power for one in both)
        reach = f"convergence {low:.4g} to {high:.4g} 1/m"
    else:
        low, high = sorted(1e3 * one.slopes[found.along] for one in both)
        reach = f"exit slopes {low:.4g} to {high:.4g} mrad"
    return (
        f"{found.name}: {reach}, spread up to {mrad_text(found.worst_spread)}, share at least"
        f" {percent_text(found.least_share)}"
        + (f"; no light leaves through its own lenses at {lost} of the positions" if lost else "")
    )


def _notes(found: Steered) -> list[tuple[str, str]]:
    """Linearity, cross-talk and orders; of a travel along the normal, its change of convergence."""
    if found.axis == "z":
        first, last = found.positions[0], found.positions[-1]
        rate = (last.power - first.power) / (last.travel - first.travel)
        return [("focus", f"the convergence changes by {rate:.4g} 1/m in 1 {found.unit}"), *_wobble(found)]
    terms = ", ".join(f"{value:.4g}" for value in found.odd_terms)
    steps = mrad_text(found.order_step[found.along])
    return [
        (
            "linearity",
            f"terms of travel, travel^3, travel^5 in 1/{found.unit}^k: {terms}; the rest is at most "
            f"{mrad_text(found.nonlinearity, 3)}",
        ),
        ("cross-talk", f"{mrad_text(found.cross_talk, 3)} across the travel"),
        *_wobble(found),
        (
            "orders",
            f"{steps} apart in coherent light; efficiency of the nearest order, and of one at the peak",
        ),
    ]


def _wobble(found: Steered) -> list[tuple[str, str]]:
    """Largest change of the slopes by a tilt, if one was requested."""
    if not found.tilt:
        return []
    middle, rim = (mrad_text(value, 3) for value in found.wobble)
    text = f"a plate that moves, tilted by {mrad_text(found.tilt, 3)}, changes the slopes by {middle} at most"
    return [("wobble", f"{text}, and by {rim} at the rim of the sheet")]


def _text(found: Steered) -> str:
    """Every position, its stray light, and the notes."""
    stray = [
        f"  stray at {one.travel:.4g}: "
        + "; ".join(
            "cell {}, {}: {} at slopes {:.4g}, {:.4g}".format(
                *light.order, percent_text(light.share), *light.slope
            )
            for light in one.orders[1:]
        )
        for one in found.positions
        if len(one.orders) > 1
    ]
    notes = table([(f"  {name}", text) for name, text in _notes(found)], "")
    return "\n".join([table(_rows(found)), *stray, notes, _verdict(found)])


def _brief(found: Steered) -> Brief:
    """Verdict, positions, linearity and orders."""
    return Brief(_verdict(found), (facts(_rows(found)), facts(_notes(found))))


COMMANDS = (Command("steer", "look", SteerBeam, run),)
