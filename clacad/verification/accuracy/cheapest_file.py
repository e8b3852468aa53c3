"""The smallest file that carries a design's light within a requested error.

Facet sizes follow from the measured floors of the formats (`clacad.verification.accuracy.file_floors`),
bytes from
the forecast of an export; STEP holds the faces themselves. Readers are assumed to refract at the facets.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from clacad.base.machine_rates import Span
from clacad.base.text import plain
from clacad.exporting.formats.registry import format_of, formats
from clacad.exporting.limits import MOST_BYTES, size_text
from clacad.storage.errors import ExportError
from clacad.verification.accuracy.accuracy_row import TargetOutOfReach
from clacad.verification.accuracy.choose_setting import MOST_QUADS, SAFE
from clacad.verification.accuracy.file_floors import Floor

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.sheet.window import Window

STEP_ERROR = 1e-11
"""Upper limit of the error of a STEP file's faces (radians): its numbers have 16 digits (see `step_rung`)."""


@dataclass(frozen=True, slots=True)
class FileWithin:
    """A file within a target error.

    Parameters
    ----------
    format : str
        Word for `--format`.
    quads : int or None
        Facets per cell side; None: the exact faces.
    error : float, radians
        Forecast rms direction error to the exact surfaces.
    bytes : int
        Approximate size.
    seconds : Span
        Processor seconds of the export on this machine, as a wide range.
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
            else f"{self.quads} quads a cell side, {1e3 * self.error:.3g} mrad rms"
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

    Parameters
    ----------
    design, window
        The window has the cells that will be written.
    floors : sequence of Floor
        Of this design; see `file_floors.floors`.
    target : float, radians
        Rms direction error to the exact surfaces.

    Raises
    ------
    TargetOutOfReach
        No file of this design is within the target.
    """
    found = [*_meshes(design, window, floors, target), *_step(design, window, target)]
    if not found:
        raise TargetOutOfReach(
            f"no file is within {1e3 * target:.4g} mrad: facets cannot be made so fine, and STEP is within "
            f"{1e3 * STEP_ERROR:g} mrad where the body can be a solid"
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
    from clacad.formats.step.step_mode import chosen_mode
    from clacad.topology.cannot_build import CannotBuild

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
