"""What files are changed by so that the process of a design makes the part: its shrinkage and its sink."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from clacad.design.process_profiles import profile
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
    spec, of = design.process, profile(design.check.process)
    lateral, height = of.made["lateral"], of.made["height"]
    shrinkage = (lateral, lateral, height) if spec.shrinkage is None else spec.shrinkage
    thickness = spec.thickness
    if thickness is None:
        thickness = 0.0 if of.made["substrate"] else shrinkage[2]
    sink = of.made["sink"] / design.unit_m if spec.sink is None else spec.sink
    return Compensation(of.name, shrinkage, thickness, sink)


def nose_of(design: Design) -> float | None:
    """Radius (length) of the nose of a design's process; None where it has no tool."""
    nose = design.process.nose
    if nose is None:
        nose = profile(design.check.process).made["nose"] / design.unit_m
    return nose if nose > 0.0 else None
