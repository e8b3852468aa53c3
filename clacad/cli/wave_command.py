"""`clacad wave`: one telescopelet's light as a wave, beside its rays."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from clacad.cli.announce_cost import forecast
from clacad.cli.console import Progress, show_json, show_text, size, table
from clacad.cli.design_commands import load_counted
from clacad.cli.option_values import parse_two_angles, parse_wavelength, picture_kind

if TYPE_CHECKING:
    from clacad.waves import WaveReport

TASK = "wave"


@dataclass(frozen=True)
class WaveRequest:
    """What the command line asked; `field` and `wavelength` as typed."""

    out: Path | None
    field: str | None
    wavelength: str | None
    field_lens: bool
    dry_run: bool
    overwrite: bool


def wave_design(path: Path, overrides: list[str], request: WaveRequest, *, json: bool, quiet: bool) -> int:
    """Print far field, Strehl ratio and share beside the rays', draw them with -o; --dry-run says what it would take."""
    field, wavelength = parse_two_angles("--field", request.field), parse_wavelength(request.wavelength)
    kind = picture_kind(request.out)
    design = load_counted(path, overrides)
    from clacad.storage.atomic import require_writable, write_content
    from clacad.waves.lit_cell import situation
    from clacad.waves.through_sheet import look, outlook

    if request.out is not None:
        require_writable(request.out, overwrite=request.overwrite)
    lit = situation(design, field, wavelength, field_lens=request.field_lens)
    ahead = outlook(lit)
    if request.dry_run:
        return _show_forecast(ahead, json=json, quiet=quiet)
    progress = Progress(quiet=quiet)
    try:
        with forecast(TASK, ahead["seconds"], quiet=quiet) as span:
            progress.expect(span.middle)
            progress("sending waves through a telescopelet", None)
            found = look(lit, design.name)
    finally:
        progress.done()
    if request.out is not None:
        write_content(request.out, found.picture(kind), overwrite=request.overwrite)
    if json:
        show_json(
            found.to_dict() | {"forecast": ahead, "file": None if request.out is None else str(request.out)}
        )
    else:
        show_text(wave_text(found) + ("" if request.out is None else f"\nwrote {request.out}"), quiet=quiet)
    return 0


def _show_forecast(ahead: dict[str, float], *, json: bool, quiet: bool) -> int:
    """What it would take."""
    if json:
        show_json({"forecast": ahead})
        return 0
    show_text(
        f"{ahead['rays']:.0f} x {ahead['rays']:.0f} rays, a grid of {ahead['points']:.0f} points a side, about "
        f"{ahead['seconds']:.2g} s of processor time, {size(ahead['bytes'])} of memory; nothing is written",
        quiet=quiet,
    )
    return 0


def wave_text(found: WaveReport) -> str:
    """The numbers as a table: waves beside rays, angles in mrad along lens x and y."""
    from clacad.waves.as_rows import HEAD, head, rows, sentences

    return "\n".join(
        [
            f"{found.design}: {head(found)}",
            table([HEAD, *rows(found)]),
            "angles in mrad, lens x, y",
            *sentences(found),
        ]
    )
