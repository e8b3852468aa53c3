"""The cheapest setting and the smallest file within a requested error, or a message that none exists.

The error of facets and the rounding of a file's numbers are measured on the design itself, by a few traces.
The grid follows from them (`clacad.verification.accuracy.file_floors`), bytes from the forecast of an
export. STEP holds the faces themselves. Readers are assumed to refract at the facets.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

from clacad.base.machine_rates import Span
from clacad.base.text import mrad_text, plain, size_text
from clacad.exporting.formats.registry import format_of, formats
from clacad.exporting.limits import MOST_BYTES
from clacad.optics.rays import Fate
from clacad.sheet.window import Window
from clacad.storage.errors import ExportError
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

    quads : Facets per cell side.
    error : radians. Forecast rms direction error, the worst of the formats.
    normals : "facet" or "vertex"
    formats : Formats for which the facets were chosen.
    """

    quads: int
    error: float
    normals: Normals
    formats: tuple[str, ...]

    def __str__(self) -> str:
        """Text of the chosen facets and their error."""
        return (
            f"{', '.join(self.formats)}: {self.quads} quads a cell side, {mrad_text(self.error, 3)} rms"
            f" through {self.normals} normals"
        )


def facets_for(
    design: Design, window: Window, target: float, formats: Sequence[str], normals: Normals = "facet"
) -> ChosenFacets | None:
    """Choose the coarsest facets with which every format is within a target; None if no format has facets.

    design, window : The bundle is that of the design's checks.
    target : radians. Rms direction error to the exact surfaces.
    formats : Words for `--format`; formats with exact surfaces, maps or masks are ignored.
    normals : "facet" or "vertex". Normals at which the reader of the file refracts.
    Raises TargetOutOfReach: The target is below a format's floor, or needs too fine a mesh; the message names
        the floor and an alternative.
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
    where the ray shifts by less than a facet between them.
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
            f"{format}: {mrad_text(target)} takes {quads} quads a cell side, more than {MOST_QUADS}; "
            + _other_ways(target, seen, smooth)
        )
    return quads


def _below(
    format: str, floor: Floor, target: float, seen: Probe, smooth: dict[str, float]
) -> TargetOutOfReach:
    where = "" if floor.best_quads is None else f", reached at {floor.best_quads:.0f} quads a cell side"
    return TargetOutOfReach(
        f"{format}: {mrad_text(target)} is below its floor of {mrad_text(floor.floor, 3)}{where} "
        f"({floor.note}); {_other_ways(target, seen, smooth)}"
    )


def _other_ways(target: float, seen: Probe, smooth: dict[str, float]) -> str:
    vertex = next(family for family in FAMILIES if family.normals == "vertex")
    by_normals = family_floor(seen, vertex, smooth, confirm=False).quads_for(target)
    step = "use step, whose faces are exact"
    if by_normals is None or by_normals > MOST_QUADS:
        return step
    return f"{step}, or ply read by its vertex normals ({by_normals} quads a cell side, normals = vertex)"


STEP_ERROR = 1e-11
"""Upper limit of the error of a STEP file's faces (radians): its numbers have 16 digits (see `step_rung`)."""


@dataclass(frozen=True, slots=True)
class FileWithin:
    """A file within a target error.

    format : Word for `--format`.
    quads : Facets per cell side; None: the exact faces.
    error : radians. Forecast rms direction error to the exact surfaces.
    bytes : Approximate size.
    seconds : Processor seconds of the export on this machine, as a wide range.
    """

    format: str
    quads: int | None
    error: float
    bytes: int
    seconds: Span

    def __str__(self) -> str:
        """Text of the file's format, error and cost."""
        how = (
            "exact faces"
            if self.quads is None
            else f"{self.quads} quads a cell side, {mrad_text(self.error, 3)} rms"
        )
        return f"{self.format} ({how}), about {size_text(self.bytes)}, {self.seconds} of processor time"

    @property
    def options(self) -> str:
        """Options of `clacad export` that write the file."""
        return f"--format {self.format}" + ("" if self.quads is None else f" --quads {self.quads}")

    def to_dict(self) -> dict[str, Any]:
        """JSON-able form."""
        return dict(
            plain(
                {
                    "format": self.format,
                    "quads": self.quads,
                    "error": self.error,
                    "bytes": self.bytes,
                    "seconds": [self.seconds.low, self.seconds.high],
                    "options": self.options,
                }
            )
        )


def files_within(design: Design, window: Window, floors: Sequence[Floor], target: float) -> list[FileWithin]:
    """Files whose light is within a target, the smallest first.

    design, window : The window has the cells that will be written.
    floors : Of this design; see `file_floors.floors`.
    target : radians. Rms direction error to the exact surfaces.
    Raises TargetOutOfReach: No file of this design is within the target.
    """
    found = [*_meshes(design, window, floors, target), *_step(design, window, target)]
    if not found:
        raise TargetOutOfReach(
            f"no file is within {mrad_text(target)}: facets cannot be made so fine, and STEP is within "
            f"{mrad_text(STEP_ERROR, 6)} where the body can be a solid"
        )
    return sorted(found, key=lambda one: (one.bytes, one.error))


def whole_meshes() -> tuple[str, ...]:
    """Mesh formats of the whole sheet as one file."""
    return tuple(one.word for one in formats() if one.chosen_by_error and one.whole_sheet)


def _meshes(design: Design, window: Window, floors: Sequence[Floor], target: float) -> list[FileWithin]:
    """Meshes with the coarsest facets within the target that are also within the size limits."""
    from clacad.exporting.quads_and_roles import Sizes
    from clacad.exporting.tessellations import Meshes

    sizes, found = Sizes(Meshes(window)), []
    for floor in floors:
        quads = floor.quads_for(SAFE * target) if floor.normals == "facet" else None
        for name in whole_meshes():
            if (
                format_of(name).holds(window)
                and name in floor.formats.split(", ")
                and quads is not None
                and quads <= MOST_QUADS
                and sizes.fits(name, quads)
            ):
                seconds = _seconds(design, name, quads)
                found.append(FileWithin(name, quads, floor.error(quads), sizes.bytes(name, quads), seconds))
    return found


def _step(design: Design, window: Window, target: float) -> list[FileWithin]:
    """The STEP file, where the bodies can be solids and its size is allowed."""
    from clacad.exporting.formats import step
    from clacad.formats.step.part21 import chosen_mode
    from clacad.topology.complex_parts import CannotBuild

    if target < STEP_ERROR:
        return []
    try:
        size = step.step_bytes(window, chosen_mode(window, "auto"))
    except (CannotBuild, ExportError):
        return []
    return (
        []
        if size > MOST_BYTES
        else [FileWithin(step.WORD, None, STEP_ERROR, size, _seconds(design, step.WORD, None))]
    )


def _seconds(design: Design, format: str, quads: int | None) -> Span:
    from clacad.exporting.forecast import rough_span
    from clacad.exporting.request import Request

    return rough_span(design, Request((format,), quads={} if quads is None else {format: quads}))
