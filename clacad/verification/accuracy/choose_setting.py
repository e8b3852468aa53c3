"""The cheapest setting within a requested error: the facets of a file, or a message that none exists.

The error of facets and the rounding of a file's numbers are measured on the design itself, by a few traces.
The grid
follows from them; see `clacad.verification.accuracy.file_floors`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

from clacad.exporting.formats.registry import format_of
from clacad.optics.rays import Fate
from clacad.sheet.window import Window
from clacad.verification.accuracy.accuracy_row import TargetOutOfReach
from clacad.verification.accuracy.file_floors import (
    EXACT,
    FAMILIES,
    SMALL,
    Family,
    Floor,
    Probe,
    family_floor,
    probe,
)

if TYPE_CHECKING:
    from clacad.design import Design

RAYS = 4096
MOST_QUADS = 1024
"""Facets per cell side beyond which one cell alone takes minutes to mesh."""

TRACED = 160
"""Finest grid that is traced before it is chosen; finer ones are extrapolated from the finest traced."""

SAFE = 0.95
"""Part of the target that is used as the limit: other bundles of rays have errors a few per cent larger."""

Normals = Literal["facet", "vertex"]


@dataclass(frozen=True, slots=True)
class ChosenFacets:
    """The coarsest facets within a target.

    Parameters
    ----------
    quads : int
        Facets per cell side.
    error : float, radians
        Forecast rms direction error, the worst of the formats.
    normals : "facet" or "vertex"
    formats : tuple of str
        Formats for which the facets were chosen.
    """

    quads: int
    error: float
    normals: Normals
    formats: tuple[str, ...]

    def __str__(self) -> str:
        """Text of the chosen facets and their error."""
        return (
            f"{', '.join(self.formats)}: {self.quads} quads a cell side, {1e3 * self.error:.3g} mrad rms"
            f" through {self.normals} normals"
        )


def facets_for(
    design: Design, window: Window, target: float, formats: Sequence[str], normals: Normals = "facet"
) -> ChosenFacets | None:
    """Choose the coarsest facets with which every format is within a target; None if no format has facets.

    Parameters
    ----------
    design, window
        The bundle is that of the design's checks.
    target : float, radians
        Rms direction error to the exact surfaces.
    formats : sequence of str
        Words for `--format`; formats with exact surfaces, maps or masks are ignored.
    normals : "facet" or "vertex"
        Normals at which the reader of the file refracts.

    Raises
    ------
    TargetOutOfReach
        The target is below a format's floor, or needs too fine a mesh; the message names the floor and an
        alternative.
    """
    asked = tuple(name for name in formats if format_of(name).chosen_by_error)
    if not asked:
        return None
    seen = _probe(design, window)
    smooth = _constants(seen, ("facet", "vertex"))
    floors = [(name, _floor(seen, name, normals, smooth)) for name in asked]
    chosen = [_traced(seen, name, floor, target, smooth) for name, floor in floors]
    quads = max(quads for quads, _ in chosen)
    return ChosenFacets(quads, max(floor.error(quads) for _, floor in chosen), normals, asked)


def mesh_floors(design: Design, window: Window, formats: Sequence[str]) -> list[Floor]:
    """Measure the least error of some faceted formats, read by their facets."""
    seen = _probe(design, window)
    smooth = _constants(seen, ("facet",))
    families = {_family(name, "facet"): name for name in formats}
    return [_floor(seen, name, "facet", smooth) for name in families.values()]


def floor_of(design: Design, window: Window, format: str, normals: Normals = "facet") -> Floor:
    """Measure the least error that a faceted format can reach."""
    seen = _probe(design, window)
    return _floor(seen, format, normals, _constants(seen, (normals,)))


def out_of_reach(
    design: Design, window: Window, target: float, format: str, floor: Floor
) -> TargetOutOfReach:
    """Error for a target below a format's floor, with alternatives that reach it."""
    seen = _probe(design, window)
    return _below(format, floor, target, seen, _constants(seen, ("vertex",)))


def _probe(design: Design, window: Window) -> Probe:
    from clacad.sheet.bundle import bundle
    from clacad.tracing.trace import trace

    rays = bundle(window, RAYS, design.check.field, design.check.field_centre).rays
    truth = trace(window, rays, path="size")
    if not bool((truth.fate == Fate.ALIVE).any()):
        raise TargetOutOfReach("no ray gets through the design: there is no error to choose by")
    return probe(window, rays, truth)


def _constants(seen: Probe, kinds: Sequence[Normals]) -> dict[str, float]:
    """Error constants of facets and vertex normals without rounding."""
    power = {"facet": 1, "vertex": 2}
    return {kind: seen.error(seen.held(SMALL, EXACT, kind)) * SMALL ** power[kind] for kind in kinds}


def _floor(seen: Probe, format: str, normals: str, smooth: dict[str, float]) -> Floor:
    return family_floor(seen, _family(format, normals), smooth, confirm=False)


def _family(format: str, normals: str) -> Family:
    for family in FAMILIES:
        if format in family.formats.split(", ") and family.normals == normals:
            return family
    raise TargetOutOfReach(
        f"{format} holds no normals at its corners: give normals = facet, or write ply or glb"
    )


def _traced(
    seen: Probe, format: str, floor: Floor, target: float, smooth: dict[str, float]
) -> tuple[int, Floor]:
    """Grid within the target, and the floor's constants corrected by a trace of that grid.

    The constant of facets depends slightly on their size. The errors of two successive faces are correlated
    where the
    ray shifts by less than a facet between them.
    """
    power = 2 if floor.normals == "vertex" else 1
    quads = _quads(format, floor, target, seen, smooth)
    for _ in range(4):
        if quads > TRACED:
            break
        error = seen.error(seen.held(quads, _family(format, floor.normals).holding or EXACT, floor.normals))
        floor = replace(floor, a=error * quads**power)
        again = _quads(format, floor, target, seen, smooth)
        if again <= quads:
            break
        quads = again
    return quads, floor


def _quads(format: str, floor: Floor, target: float, seen: Probe, smooth: dict[str, float]) -> int:
    quads = floor.quads_for(SAFE * target)
    if quads is None:
        raise _below(format, floor, target, seen, smooth)
    if quads > MOST_QUADS:
        raise TargetOutOfReach(
            f"{format}: {1e3 * target:.4g} mrad takes {quads} quads a cell side, more than {MOST_QUADS}; "
            + _other_ways(target, seen, smooth)
        )
    return quads


def _below(
    format: str, floor: Floor, target: float, seen: Probe, smooth: dict[str, float]
) -> TargetOutOfReach:
    where = "" if floor.best_quads is None else f", reached at {floor.best_quads:.0f} quads a cell side"
    return TargetOutOfReach(
        f"{format}: {1e3 * target:.4g} mrad is below its floor of {1e3 * floor.floor:.3g} mrad{where} "
        f"({floor.note}); {_other_ways(target, seen, smooth)}"
    )


def _other_ways(target: float, seen: Probe, smooth: dict[str, float]) -> str:
    vertex = next(family for family in FAMILIES if family.normals == "vertex")
    by_normals = family_floor(seen, vertex, smooth, confirm=False).quads_for(target)
    step = "use step, whose faces are exact"
    if by_normals is None or by_normals > MOST_QUADS:
        return step
    return f"{step}, or ply read by its vertex normals ({by_normals} quads a cell side, normals = vertex)"
