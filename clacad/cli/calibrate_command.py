"""`clacad calibrate`: depths of the levels of a writer from a measured coupon."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from clacad.base.text import table
from clacad.cli.command import Command, option, overwrite_option, required
from clacad.cli.console import Brief, Console, facts
from clacad.cli.option_values import parse_distance

if TYPE_CHECKING:
    from clacad.measuring.wedge_fields import WedgeDepths


@dataclass(frozen=True, kw_only=True)
class Calibrate:
    """Measure a coupon of the format wedge and write the calibration that the format dose reads."""

    wedge: Path = required("WEDGE", "Height map of the coupon: X3P, SDF, XYZ, NPY, TIFF or PNG.")
    out: Path = required("-o, --out FILE", "Table of levels and depths, CSV.")
    side: str = option("--side LENGTH", "Side of a field as written.", "100 um")
    unit: str | None = option("--unit WORD", "Length unit of a cloud that states none.")
    overwrite: bool = overwrite_option()


def run(given: Calibrate, console: Console) -> int:
    """Measure the coupon, write the table, print the depths."""
    side = parse_distance("--side", given.side, "m")
    from clacad.measuring.wedge_fields import calibrate
    from clacad.storage.atomic import require_writable, write_content

    require_writable(given.out, overwrite=given.overwrite)
    with console.progress():
        found = calibrate(given.wedge, side, given.unit)
    write_content(given.out, found.to_csv(), overwrite=given.overwrite)
    console.show(found.to_dict, lambda: _text(found), lambda: Brief(_verdict(found), (facts(_rows(found)),)))
    console.say(f"wrote {given.out}")
    return 0


def _rows(found: WedgeDepths) -> list[tuple[str, ...]]:
    """Levels, depths and their uncertainties as text."""
    rows = zip(found.levels.tolist(), found.depths.tolist(), found.halves.tolist(), strict=True)
    return [
        ("level", "depth um", "u um"),
        *((f"{k}", f"{1e6 * d:.4f}", f"{1e6 * u:.4f}") for k, d, u in rows),
    ]


def _verdict(found: WedgeDepths) -> str:
    """Range of the calibration."""
    return (
        f"{found.name}: {len(found.levels)} levels, depths to {1e6 * found.depths[-1]:.5g} um, known to"
        f" {1e9 * found.halves.max():.2g} nm; level 0 measured {1e9 * found.level_0:.2g} nm"
    )


def _text(found: WedgeDepths) -> str:
    """Every level, and the range."""
    return f"{table(_rows(found))}\n{_verdict(found)}"


COMMANDS = (Command("calibrate", "make", Calibrate, run),)
