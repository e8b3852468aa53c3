"""`clacad wave`: one telescopelet's light as a wave, beside its rays."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from clacad.base.digits import digits
from clacad.cli.announce_cost import forecast
from clacad.cli.console import Progress, show_json, show_text, size, table
from clacad.cli.design_commands import load_counted
from clacad.cli.option_values import BadOption, parse_two_angles, parse_wavelength

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
    kind = _kind(request.out)
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


def _kind(out: Path | None) -> Literal["png", "svg"]:
    """Kind of picture that a file's name asks for."""
    ending = "png" if out is None else out.suffix.lower().removeprefix(".")
    if ending == "svg":
        return "svg"
    if ending != "png":
        raise BadOption(f"-o {out}: the picture's name ends in .png or .svg")
    return "png"


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
    """The numbers as a table: waves beside rays, along lens x and y."""

    def mrad(values: tuple[float, ...]) -> str:
        return ", ".join(digits(1e3 * v, count=4) for v in values)

    head = (
        f"{found.design}: {1e9 * found.wavelength:.4g} nm, slope {found.slope[0]:.4g}, {found.slope[1]:.4g} along lens x, y; "
        f"Fresnel number {digits(min(found.fresnel), count=4)}; holds here: {found.far_field.way}"
    )
    rows = [
        [
            "",
            "share to the partner",
            "Strehl ratio",
            "middle off the law",
            "full width, half max.",
            "half of the light in",
            "",
        ]
    ]
    for far, name, share in (
        (found.exact, "waves, exact surfaces", found.share),
        (found.thin, "waves, ideal lenses", found.thin_share),
    ):
        if far is not None:
            one = far.marginals
            rows.append([
                name, digits(share, count=4), digits(far.strehl, count=4), mrad(tuple(m.middle for m in one)), mrad(tuple(m.width for m in one)),
                mrad(tuple(m.half_energy for m in one)), "mrad, lens x, y",
            ])  # fmt: skip
    rows.append(
        [
            "rays, exact surfaces",
            digits(found.rays.share, count=4),
            "",
            mrad(found.rays.mean),
            "",
            mrad(found.rays.half_energy),
            "mrad, mean",
        ]
    )
    lines = [
        head, table(rows), f"λ/w of what is lit of lens 2: {mrad(found.slit)} mrad; rays alone miss the law by {digits(1e3 * found.rays.rms, count=4)} "
        "mrad rms",
        f"in coherent light equal cells send orders λ/p = {mrad(found.order)} mrad apart: the law is met to ± half of that",
        *(f"not computed, {way}: {why}" for way, why in found.refused.items()),
    ]  # fmt: skip
    return "\n".join(lines)
