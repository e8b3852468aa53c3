"""POV-Ray scene of the sheet, for pictures by another program."""

from __future__ import annotations

from typing import TYPE_CHECKING

from clacad.exporting.formats.format import (
    FileKind,
    Forecast,
    Format,
    map_row,
    structured_cost,
    structured_count,
)
from clacad.exporting.roles import OWN_NUMBERS

if TYPE_CHECKING:
    from clacad.exporting.manifest import FileRecord, Job
    from clacad.exporting.request import Request
    from clacad.exporting.tessellations import Meshes
    from clacad.sheet.window import Window

WORD = "pov"


def _write(job: Job) -> list[FileRecord]:
    """Write the scene; no program reads it back."""
    from clacad.exporting.pov.pov_scene import write_pov

    path = job.stage.path(f"{job.stem}.pov")
    write_pov(job.window, path)
    return [job.record(path, WORD, unit="0.001 design unit", checks=())]


# -- cost ------------------------------------------------------------------------------------------


def _forecast(meshes: Meshes, _quads: int, _asked: Request) -> Forecast:

    window = meshes.window
    return map_row(WORD, _bytes(window), structured_cost(structured_count(window)), note=_note(window))


def _bytes(window: Window) -> int:
    """Size of the POV-Ray scene, generated in full: its loops do not grow; 0 for a sheet it cannot hold."""
    from clacad.exporting.pov.pov_scene import pov_lines
    from clacad.storage.errors import ExportError

    try:
        return sum(len(line.encode()) + 1 for line in pov_lines(window, None))
    except ExportError:  # reported at writing, so that the other formats are still made
        return 0


def _reading_seconds(cells: int, own: int) -> float:
    """Seconds for POV-Ray to read the lenses of all arrays; `own` lenses are defined per cell."""
    return 7.6e-6 * cells + 2.4e-5 * own


def _note(window: Window) -> str:
    """Note on the extra cost of a POV-Ray scene of a non-uniform sheet; "" for a uniform sheet."""
    if window.uniform:
        return ""
    cells = window.lattice.cell_count
    arrays = {face.array for face in window.faces if face.array is not None}
    moved = {face.array: face.change for face in window.faces if face.change is not None}
    tables = any(change.table is not None for change in moved.values())
    held = f"the places of {cells:,} lenses are a table" if tables else "a formula moves its lens, no larger"
    plain, whole = (_reading_seconds(cells * len(arrays), cells * n) for n in (0, len(moved)))
    return (
        f"every cell differs: {held}; POV-Ray reads it in {whole:.2g} s, a uniform one in {plain:.2g} s, and"
        " traces both as fast"
    )


FORMATS = (
    Format(
        WORD,
        "map",
        "scene of the sheet for POV-Ray, with exact surfaces",
        _write,
        _forecast,
        lambda sheet, _quads, _asked: structured_cost(2 * sheet.bodies),
        optical=False,
        turned_arrays=False,
        many_sizes=False,
        stored=(OWN_NUMBERS,),
    ),
)

FILES = (FileKind(WORD, "other"), FileKind("scene", "other"))
