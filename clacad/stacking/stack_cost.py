"""What a stack costs: bytes of its files, processor seconds of its light; and what is refused for it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from clacad.base.machine_rates import Rates, Span, total
from clacad.exporting.forecast import Forecast, forecast
from clacad.exporting.limits import refuse_over_limits
from clacad.exporting.request import Request
from clacad.exporting.tessellations import Meshes
from clacad.sheet.stack import Stack
from clacad.stacking.stack_request import StackRequest

RAY_SECONDS, FIXED_SECONDS = 1.6e-6, 0.4
"""Processor seconds of a ray through a sheet on all rungs, and of the rest, on the reference machine."""

TASK = "stack light"
"""Name under which the time of the light is noted."""


def rows(standing: Stack, asked: StackRequest) -> list[Forecast]:
    """What the files would cost: one row a format, of all sheets that differ together."""
    found: dict[str, list[Forecast]] = {name: [] for name in asked.formats}
    wanted = Request(formats=asked.formats, step=asked.step)
    for window in {id(one.window): one.window for one in standing.sheets}.values():
        meshes = Meshes(window)
        for row in forecast(meshes, asked.formats, asked.quads, wanted):
            found[row.format].append(row)
    return [_together(several) for several in found.values() if several]


def _together(several: Sequence[Forecast]) -> Forecast:
    """One row for the parts of one file."""
    first = several[0]

    def added(name: str) -> int | None:
        values = [getattr(row, name) for row in several]
        return None if None in values else sum(values)

    return Forecast(
        first.format, sum(row.bytes for row in several), False, added("facets"), first.quads,
        sum(row.modelled for row in several), (sum(r.memory[0] for r in several), sum(r.memory[1] for r in several)),
        (sum(r.seconds[0] for r in several), sum(r.seconds[1] for r in several)), added("stored"),
        sum(row.places for row in several),
    )  # fmt: skip


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
