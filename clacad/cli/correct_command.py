"""`clacad correct`: the next command for a machine, by a height map of the part that it made."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from clacad.base.text import mrad_text, plainly
from clacad.cli.command import Command, OfDesign, option, overwrite_option, required
from clacad.cli.console import Brief, Console, facts
from clacad.cli.option_values import BadOption, cell_option, load_counted, tilted_option

if TYPE_CHECKING:
    from clacad.making.correction import Correction

TASK = "correct"


@dataclass(frozen=True, kw_only=True)
class Correct(OfDesign):
    """Correct the commanded shape of a face by a height map of the part that was made with it."""

    measured: Path = required(
        "--measured MAP", "Height map of the made part, or a deviation map that verify -o wrote."
    )
    out: Path | None = option(
        "-o, --out DIR",
        "Write the command and the state of the loop here; the next round continues from them.",
    )
    side: str | None = option("--side front|back", "Side that the map shows; else by its name, or the front.")
    z_scale: str | None = option("--z-scale TEXT", "Scale of a map's heights, e.g. '1.0063 +- 1e-4'.")
    lateral_scale: str | None = option("--lateral-scale TEXT", "Lateral scale of a map.")
    tilted: Path | None = tilted_option()
    cell: tuple[int, int] | None = cell_option("Cell of the sheet nearest to the middle of the map.")
    unit: str | None = option("--unit WORD", "Length unit of a cloud x y z that states none, e.g. um.")
    calibration: Path | None = option(
        "--calibration CSV", "Level and depth by clacad calibrate: writes the dose of the command, too."
    )
    overwrite: bool = overwrite_option("Replace files of another origin.")


def run(request: Correct, console: Console) -> int:
    """Make one round of corrections, write the command, print what was taken off."""
    if request.out is None:
        raise BadOption(
            "the command needs a folder, from which the next round continues: give it with -o DIR"
        )
    if request.side not in (None, "front", "back"):
        raise BadOption(f"--side {request.side}: it is front or back")
    side = request.side or ("back" if "back" in request.measured.name.lower() else "front")
    design = load_counted(request.design, request.set)
    from clacad.making.correction import correct
    from clacad.storage.atomic import require_folder

    require_folder(request.out)
    with console.forecast(TASK, 4.0):
        found = correct(
            design,
            request.measured if request.cell is None else (request.measured, request.cell),
            side=side,
            previous=request.out,
            z_scale=request.z_scale,
            lateral_scale=request.lateral_scale,
            tilted=request.tilted,
            unit=request.unit,
        )
    written = (
        []
        if found.stopped
        else found.write(request.out, overwrite=request.overwrite, calibration=request.calibration)
    )
    head = f"{design.name}, {side}, round {found.round}: {found.summary}"
    rows = [*_rows(found), *([("wrote", ", ".join(map(str, written)))] if written else [])]
    console.show(
        lambda: found.to_dict() | {"stopped": found.stopped, "files": [str(path) for path in written]},
        lambda: "\n".join([head, *(f"  {name}: {text}" for name, text in rows)]),
        lambda: Brief(head, (facts(rows),)),
    )
    return 0


def _rows(found: Correction) -> list[tuple[str, str]]:
    """What the rounds found, the conic nearest to the command, and what limits the loop."""
    rounds = [mrad_text(one["law_rms"], 3) for one in found.history if one.get("law_rms") is not None]
    face, unit = found.face, found.design.unit
    nano = 1e9 * found.design.unit_m
    rows = [("light through the measured form", ", ".join(rounds))] if rounds else []
    rows.append(
        (
            "conic nearest to the command",
            f"R {' '.join(plainly(face['radius'], unit, 6))}, K {face['conic']:+.3f}, astigmatism"
            f" {face['astigmatism']:.3g} 1/{unit}; it leaves {nano * face['rms']:.3g} nm rms",
        )
    )
    if found.no_next_design:
        rows.append(("next", found.no_next_design))
    return [*rows, *(("note", note) for note in found.notes)]


COMMANDS = (Command(TASK, "make", Correct, run),)
