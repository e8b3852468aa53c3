"""`clacad explore`: a page on which the design's numbers are moved."""

from __future__ import annotations

from math import atan, degrees
from pathlib import Path
from typing import TYPE_CHECKING

from clacad.cli.announce_cost import forecast
from clacad.cli.console import show_json, show_text, size, table
from clacad.cli.design_commands import load_counted

if TYPE_CHECKING:
    from clacad.explorer import Explored


def explore_design(
    path: Path, overrides: list[str], out: Path, *, dry_run: bool, overwrite: bool, json: bool, quiet: bool
) -> int:
    """Write the page, or with --dry-run say what it would be; print what it says first and what it leaves out."""
    design = load_counted(path, overrides)  # refuses before anything is loaded that makes pages
    from clacad.explorer.write_page import SECONDS, explore

    with forecast("explore", SECONDS, quiet=quiet):
        made = explore(design, out, overwrite, dry_run=dry_run)
    if json:
        show_json(made.to_dict() | {"processor_s": SECONDS})
    else:
        show_text(_told(made, design.unit), quiet=quiet)
    return 0


def _told(made: Explored, unit: str) -> str:
    """What was written, and what the page says before anything is moved."""
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
