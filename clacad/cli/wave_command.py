"""`clacad wave`: one telescopelet's light as a wave, compared with its rays."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from clacad.cli.command import Command, OfDesign, dry_run_option, flag, option, overwrite_option
from clacad.cli.console import Console, size, table
from clacad.cli.option_values import load_counted, parse_two_angles, parse_wavelength, picture_kind

if TYPE_CHECKING:
    from clacad.waves import WaveReport

TASK = "wave"


@dataclass(frozen=True, kw_only=True)
class Wave(OfDesign):
    """Light as a wave through one telescopelet: far field, Strehl ratio, share to the partner, its rays."""

    out: Path | None = option("-o, --out FILE", "Write the picture here, .png or .svg.")
    field: tuple[float, float] | None = option(
        "--field A[,B]",
        "Angles of the light off the middle of the field along x and y, e.g. '0.5 deg,0'; default the "
        "middle.",
        read=parse_two_angles,
    )
    wavelength: float | None = option(
        "--wavelength L", "Default the design's, e.g. '633 nm'.", read=parse_wavelength
    )
    field_lens: bool = flag(
        "--field-lens", "As if a lens at the common focus imaged lens 1 onto lens 2: ideal lenses only."
    )
    dry_run: bool = dry_run_option("Print grid and cost; write nothing.")
    overwrite: bool = overwrite_option()


def run(request: Wave, console: Console) -> int:
    """Print far field, Strehl ratio and share of waves and rays, draw them with -o."""
    kind = picture_kind(request.out)
    design = load_counted(request.design, request.set)
    from clacad.storage.atomic import require_writable, write_content
    from clacad.waves.through_sheet import look, outlook, situation

    if request.out is not None:
        require_writable(request.out, overwrite=request.overwrite)
    lit = situation(design, request.field or (0.0, 0.0), request.wavelength, field_lens=request.field_lens)
    ahead = outlook(lit)
    if request.dry_run:
        console.show(lambda: {"forecast": ahead}, lambda: _forecast_text(ahead))
        return 0
    with console.progress() as progress, console.forecast(TASK, ahead["seconds"]) as span:
        progress.expect(span.middle)
        progress("sending waves through a telescopelet", None)
        found = look(lit, design.name)
    written = None if request.out is None else str(request.out)
    if request.out is not None:
        write_content(request.out, found.picture(kind), overwrite=request.overwrite)
    console.show(
        lambda: found.to_dict() | {"forecast": ahead, "file": written},
        lambda: wave_text(found) + ("" if written is None else f"\nwrote {written}"),
    )
    return 0


def _forecast_text(ahead: dict[str, float]) -> str:
    return (
        f"{ahead['rays']:.0f} x {ahead['rays']:.0f} rays, a grid of {ahead['points']:.0f} points a side, "
        f"about {ahead['seconds']:.2g} s of processor time, {size(ahead['bytes'])} of memory; nothing is "
        "written"
    )


def wave_text(found: WaveReport) -> str:
    """Table of the numbers of waves and rays, angles in mrad along lens x and y."""
    from clacad.waves.wave_report import HEAD, head, rows, sentences

    return "\n".join(
        [
            f"{found.design}: {head(found)}",
            table([HEAD, *rows(found)]),
            "angles in mrad, lens x, y",
            *sentences(found),
        ]
    )


COMMANDS = (Command("wave", "look", Wave, run),)
