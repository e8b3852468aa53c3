"""Cost of a stack: bytes of its files, processor seconds of its light; refusals by the limits.

Options of a stack: light, files and limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from clacad.base.machine_rates import Rates, Span, total
from clacad.base.types import Pair2
from clacad.exporting.forecast import forecast
from clacad.exporting.formats.format import Forecast
from clacad.exporting.formats.indexed_meshes import GLB
from clacad.exporting.formats.step import WORD as STEP
from clacad.exporting.limits import refuse_over_limits
from clacad.exporting.request import Request
from clacad.exporting.tessellations import Meshes
from clacad.formats.step.step_mode import Mode
from clacad.sheet.need_window import need_equal_cells
from clacad.sheet.stack import Stack

FORMATS = (STEP, GLB)
"""File formats of a stack; both support assemblies."""

QUADS = 8
"""Facets along a cell side of a GLB file, which is for viewing."""


@dataclass(frozen=True, eq=False)
class StackRequest:
    """Options of a stack.

    Parameters
    ----------
    gaps : tuple of float
        Clear distances between neighbours, in the unit of the first design; one for all, or one for each.
    formats : tuple of "step" and "glb"
    field : float or None, radians
        Slopes of the light reach to its tangent; None: check.field of the first design.
    zone : (width, height) or None
        Lit part of the first sheet, about its centre, in the unit of the first design; None: all of it, or
        one cell where all cells of all sheets act alike.
    object_distance : float or None
        Distance of the imaged point before array 1 of the first sheet, in the unit of the first design; None:
        its check.object, else ten times its separation.
    rays : int
    cells : (a, b) or None
        Number of cells of every sheet to write and measure.
    quads : int
        Facets along a cell side, of GLB.
    step : "auto", "fused" or "instanced"
    overwrite, force : bool
        Replace files of another origin; ignore the limits of size.
    mesh_light : bool
        Trace rung mesh too, with `quads` facets along a cell side.
    ids : tuple of str or None
        Names of the sheets; None: a, b, c, …
    """

    gaps: tuple[float, ...]
    formats: tuple[str, ...] = FORMATS
    field: float | None = None
    object_distance: float | None = None
    rays: int = 65536
    cells: tuple[int, int] | None = None
    quads: int = QUADS
    step: Mode = "auto"
    overwrite: bool = False
    force: bool = False
    mesh_light: bool = False
    ids: tuple[str, ...] | None = None
    zone: Pair2 | None = None


RAY_SECONDS, FIXED_SECONDS = 1.6e-6, 0.4
"""Processor seconds per ray and sheet on all rungs, and fixed seconds, on the reference machine."""

TASK = "stack light"
"""Name under which the time of the light is recorded."""


def rows_by_sheet(standing: Stack, asked: StackRequest) -> dict[str, list[Forecast]]:
    """Cost that each sheet adds to the files, by its id; a repeated sheet adds none.

    Raises
    ------
    CellsDiffer
        GLB is requested for a non-uniform sheet.
    """
    wanted, seen = Request(formats=asked.formats, step=asked.step), set()
    found: dict[str, list[Forecast]] = {}
    for one in standing.sheets:
        if GLB in asked.formats:
            need_equal_cells(one.window, f"sheet {one.id} in GLB", "the stack's STEP holds it: --format step")
        found[one.id] = []
        if id(one.window) not in seen:
            seen.add(id(one.window))
            found[one.id] = forecast(Meshes(one.window), asked.formats, asked.quads, wanted)
    return found


def rows(standing: Stack, asked: StackRequest) -> list[Forecast]:
    """Cost of the files: one row per format, for all distinct sheets together."""
    several = [row for each in rows_by_sheet(standing, asked).values() for row in each]
    return [_together([row for row in several if row.format == name]) for name in asked.formats]


def _together(several: Sequence[Forecast]) -> Forecast:
    """Combined row for the parts of one file."""
    first = several[0]

    def added(name: str) -> int | None:
        values = [getattr(row, name) for row in several]
        return None if None in values else sum(values)

    return Forecast(
        first.format,
        sum(row.bytes for row in several),
        False,
        added("facets"),
        first.quads,
        sum(row.modelled for row in several),
        (sum(r.memory[0] for r in several), sum(r.memory[1] for r in several)),
        (sum(r.seconds[0] for r in several), sum(r.seconds[1] for r in several)),
        added("stored"),
        sum(row.places for row in several),
    )


def light_seconds(sheets: int, asked: StackRequest) -> float:
    """Processor seconds of the light on the reference machine."""
    return FIXED_SECONDS + RAY_SECONDS * asked.rays * sheets


def in_all(standing: Stack, asked: StackRequest) -> Span:
    """Processor seconds of light and files on this machine."""
    rates = Rates.here()
    files = [Span(*row.seconds) for row in rows(standing, asked)]
    return total([rates.span(TASK, light_seconds(len(standing.sheets), asked)), *files])


def refuse(standing: Stack, asked: StackRequest, folder: Path) -> None:
    """Refuse files beyond the limits of size.

    Raises
    ------
    LimitRefused
    """
    if not asked.force:
        refuse_over_limits(standing.sheets[0].window, rows(standing, asked), folder)
