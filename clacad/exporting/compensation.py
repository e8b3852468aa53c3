"""What files are changed by so that the process of a design makes the part: its shrinkage and its sink."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from clacad.design.process import Process, process_of
from clacad.sheet.shrunk import bent_window, grown_window, growth

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.sheet.window import Window


@dataclass(frozen=True, slots=True)
class Compensation:
    """Changes of a file against the part.

    process : Name of the profile.
    shrinkage : Along x, y and z: part = file × (1 − s).
    thickness : Shrinkage of the distances between faces.
    sink : length. Depth by which the middle of a lenslet sinks.
    """

    process: str
    shrinkage: tuple[float, float, float]
    thickness: float
    sink: float

    def window(self, window: Window) -> Window:
        """The sheet as files hold it. Raises CannotShrink."""
        apart = growth((self.thickness,) * 3)[2]
        return bent_window(grown_window(window, growth(self.shrinkage), apart), self.sink)

    @property
    def cut_as_insert(self) -> bool:
        """Whether a tool cuts the negative of the part."""
        return Process(self.process).cut_as_insert

    @property
    def uniform(self) -> bool:
        """Whether the part is the file at another size, which turns no ray."""
        return len({*self.shrinkage, self.thickness}) == 1 and not self.sink

    def to_dict(self, scale: float) -> dict[str, Any]:
        """Entry of a file in the manifest; `scale`: millimetres per design unit."""
        return {
            "process": self.process,
            "shrinkage": list(self.shrinkage),
            "thickness": self.thickness,
            "sink": self.sink * scale,
        }


def compensation_of(design: Design) -> Compensation:
    """Compensation for the process of a design: section [process] over the defaults of `check.process`."""
    process = process_of(design)
    return Compensation(process.name, process.shrinkage, process.thickness, process.sink / design.unit_m)


def nose_of(design: Design) -> float | None:
    """Radius (length) of the nose of a design's process; None where it has no tool."""
    return process_of(design).nose / design.unit_m or None
