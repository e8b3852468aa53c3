"""`clacad explore`: a page with sliders for the numbers of a design."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan, degrees
from pathlib import Path
from typing import TYPE_CHECKING

from clacad.cli.command import Command, OfDesign, dry_run_option, overwrite_option, required
from clacad.cli.console import Console, size, table
from clacad.cli.option_values import load_counted

if TYPE_CHECKING:
    from clacad.explorer import Explored


@dataclass(frozen=True, kw_only=True)
class Explore(OfDesign):
    """One page with sliders: the view through the sheet, live, its verdict, and the design file they make."""

    out: Path = required("-o, --out FILE", "The page: one .html file.")
    dry_run: bool = dry_run_option("Print what the page would be and cost; write nothing.")
    overwrite: bool = overwrite_option()


def run(request: Explore, console: Console) -> int:
    """Write the page, or with --dry-run forecast it; print its first verdict and what it leaves out."""
    design = load_counted(request.design, request.set)  # refuses before a module is loaded that makes pages
    from clacad.explorer.write_page import SECONDS, explore

    with console.forecast("explore", SECONDS):
        made = explore(design, request.out, request.overwrite, dry_run=request.dry_run)
    console.show(lambda: made.to_dict() | {"processor_s": SECONDS}, lambda: _text(made, design.unit))
    return 0


def _text(made: Explored, unit: str) -> str:
    """What was written, and the verdict of the page before a slider is moved."""
    found = made.verdict
    field, onset = (
        ", ".join(f"{degrees(atan(t)):.3g}" for t in two) for two in (found.half_field, found.ghost_onset)
    )
    rows = [
        ("light to the partner", f"{100 * found.share:.3g} %", "along the middle of the field"),
        ("", f"{100 * found.share_from_eye:.3g} %", "over the sheet, of what reaches the eye"),
        ("field, x, y", f"{field} deg", "half width: beyond it no light obeys the law"),
        ("ghosts from, x, y", f"{onset} deg", "off the middle of the field"),
        ("sharpest pitch", f"{found.advised_pitch:.4g} {unit}", "for what is looked at"),
    ]
    head = f"wrote {made.file}" if made.written else f"would write {made.file}"
    seconds = "" if made.written else "; takes less than a second of processor time"
    left_out = "\n".join(f"not shown: {one}" for one in made.not_shown)
    return f"{head}: {size(made.bytes)}{seconds}\n{table(rows)}\n{left_out}"


COMMANDS = (Command("explore", "look", Explore, run),)
