"""Facets a cell side of every format of an export, and the role each file gets by them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import isfinite
from typing import TYPE_CHECKING

from clacad.exporting import limits
from clacad.exporting.format_names import MESHES, STL_FORMATS
from clacad.exporting.light_forecast import FINE, POWERS, Grader
from clacad.exporting.roles import Prospect, Role, role_of

if TYPE_CHECKING:
    from clacad.exporting.forecast import Forecast
    from clacad.exporting.request import Request
    from clacad.exporting.tessellations import Meshes

COARSEST = 4
"""Facets of a declared preview of which nothing else was said."""

COUNTED = (8, 16)
"""Grids whose facets are counted; those of others follow."""

TRACED = 256
"""Finest grid that is meshed only to tell a role; beyond it the formula of the coarser ones speaks."""


class Sizes:
    """Facets and bytes of the mesh formats at any grid, counted on two coarse ones."""

    def __init__(self, meshes: Meshes) -> None:
        self.meshes = meshes
        self._rows: dict[tuple[str, int], Forecast] = {}

    def facets(self, format: str, quads: int) -> int:
        """Facets that a file of a format stores, about; those of one cell where the format repeats it."""
        square, linear = self._cell if self.meshes.repeats(format) else self._sheet
        return int(square * quads * quads + linear * quads)

    def bytes(self, format: str, quads: int) -> int:
        """Size of the file, about, from one that is small enough to be drawn up."""
        drawn = min(quads, FINE if self.meshes.repeats(format) else COUNTED[1])
        row = self._drawn(format, drawn)
        facets = self.facets(format, quads)
        if format in STL_FORMATS:
            return row.bytes + 50 * (facets - self.facets(format, drawn))
        return int(row.places + (row.bytes - row.places) * facets / max(1, self.facets(format, drawn)))

    def fits(self, format: str, quads: int) -> bool:
        """Whether a file of a format is within the limits of facets and bytes."""
        facets = self.facets(format, quads)
        if format in STL_FORMATS:
            return facets <= limits.MOST_FACETS and 84 + 50 * facets <= limits.MOST_BYTES
        return facets <= limits.MOST_WELDED and self.bytes(format, quads) <= limits.MOST_BYTES

    def finest(self, format: str) -> int:
        """Finest grid of "auto" that fits, or the coarsest there is."""
        return max((quads for quads in POWERS if self.fits(format, quads)), default=POWERS[0])

    def _drawn(self, format: str, quads: int) -> Forecast:
        """Forecast of a file on a coarse grid, drawn up once."""
        from clacad.exporting.forecast import forecast

        if (format, quads) not in self._rows:
            self._rows[format, quads] = forecast(self.meshes, [format], quads)[0]
        return self._rows[format, quads]

    @cached_property
    def _cell(self) -> tuple[float, float]:
        return _law_of_growth(*(self.meshes.at(quads).cell.facet_count for quads in COUNTED))

    @cached_property
    def _sheet(self) -> tuple[float, float]:
        return _law_of_growth(*(self.meshes.facets(quads) for quads in COUNTED))


@dataclass(frozen=True, slots=True)
class Needed:
    """What a master of one format would take.

    quads : int, a cell side
    bytes : int
        Of the file, about.
    fits : bool
        Whether an export would write it without being forced.
    """

    quads: int
    bytes: int
    fits: bool


def masters(grader: Grader, formats: Sequence[str]) -> dict[str, Needed]:
    """Facets and bytes of a master in each mesh format; empty where no grid up to 1024 makes one."""
    quads, sizes = grader.foreseen(), Sizes(grader.meshes)
    if quads is None:
        return {}
    return {name: Needed(quads, sizes.bytes(name, quads), sizes.fits(name, quads)) for name in formats}


def _law_of_growth(coarse: int, fine: int) -> tuple[float, float]:
    """Facets a cell side squared, and a cell side, from those of the two grids that are counted."""
    small, large = COUNTED
    square = (fine / large - coarse / small) / (large - small)
    return square, coarse / small - small * square


def chosen_quads(grader: Grader, request: Request, formats: Sequence[str]) -> dict[str, int]:
    """Facet grid of each mesh format: as asked, chosen by its light, by slope error, or the finest within the limits.

    A declared preview of which nothing was said is as coarse as can be: slope errors are asked of masters.

    Raises
    ------
    LimitRefused
        Not even the coarsest facets fit.
    """
    chosen: dict[str, int] = {}
    rest: list[str] = []
    sizes = Sizes(grader.meshes)
    for name in formats:
        if name not in MESHES:
            continue
        asked = request.quads.get(name)
        if asked == "auto":
            chosen[name] = _automatic(grader, sizes, name)
        elif asked is not None:
            chosen[name] = asked
        elif request.role.get(name) is Role.PREVIEW:
            chosen[name] = COARSEST
        else:
            rest.append(name)
    if rest:
        chosen |= dict.fromkeys(rest, _by_default(grader.meshes, request, rest))
    return chosen


def _automatic(grader: Grader, sizes: Sizes, format: str) -> int:
    finest = sizes.finest(format)
    least = grader.foreseen() if finest > FINE else None
    if finest > FINE and (least is None or least > finest):
        return finest  # a preview: nothing that fits is worth tracing
    return grader.least(finest) or finest


def _by_default(meshes: Meshes, request: Request, formats: Sequence[str]) -> int:
    if request.slope_error == "auto":
        return limits.choose_quads(meshes, formats, request.force)
    return limits.quads_for_slope(meshes.window, float(request.slope_error), request.force)


def with_prospects(grader: Grader, rows: Sequence[Forecast], declared: Mapping[str, Role]) -> list[Forecast]:
    """Rows of a forecast with the role of each file, and what the light through it will do."""
    sizes = Sizes(grader.meshes)
    return [replace(row, prospect=_prospect(grader, sizes, row, declared)) for row in rows]


def _prospect(grader: Grader, sizes: Sizes, row: Forecast, declared: Mapping[str, Role]) -> Prospect:
    asked = declared.get(row.format)
    if row.quads is None:
        return Prospect(role_of(row.format) if asked is None else asked, asked is not None)
    rms, beyond = _light(grader, row.quads)
    role = asked if asked is not None else (Role.PREVIEW if beyond else Role.MASTER)
    known = rms if isfinite(rms) else None
    found = Prospect(role, asked is not None, row.quads, known, grader.limits.rms, beyond)
    if role is Role.MASTER and not beyond:
        return found
    needed = grader.foreseen()
    return replace(
        found, master_quads=needed, master_bytes=None if needed is None else sizes.bytes(row.format, needed)
    )


def _light(grader: Grader, quads: int) -> tuple[float, tuple[str, ...]]:
    """Forecast rms (radians), and the limits that light is forecast not to keep."""
    if quads > TRACED:
        rms = grader.law_rms(quads)
        return rms, () if rms <= grader.limits.rms else ("law_rms",)
    grade = grader.grade(quads)
    return grade.rms, grade.beyond(grader.limits)
