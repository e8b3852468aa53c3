"""Allowed deviations of a part, in millimetres, as drawings state them: from the [tolerances] of its design."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from clacad.base.units import millimetres

if TYPE_CHECKING:
    from clacad.design import Design


@dataclass(frozen=True, slots=True)
class Allowances:
    """Half widths of the ± tolerances; 0 where the design states none.

    Parameters
    ----------
    thickness : (body 1, body 2), mm
        Of the centre thickness.
    separation : float, mm
        Lens to lens.
    radius : (array 1, array 2)
        Of every radius, relative.
    decentre : (array 1, array 2), mm
    rotation, tilt : float, radians
        Of array 2 against array 1, about the normal and about x and y.
    roughness : float, mm
        Largest rms height of the lens faces.
    """

    thickness: tuple[float, float] = (0.0, 0.0)
    separation: float = 0.0
    radius: tuple[float, float] = (0.0, 0.0)
    decentre: tuple[float, float] = (0.0, 0.0)
    rotation: float = 0.0
    tilt: float = 0.0
    roughness: float = 0.0

    def of_body(self, number: int, bodies: int) -> float:
        """Of the centre thickness (mm) of body 0, 1 …; of a plate between two, the larger of theirs."""
        middle = bodies == 3 and number == 1
        return max(self.thickness) if middle else self.thickness[min(number, 1)]


NO_ALLOWANCES = Allowances()
"""Allowances of a design that states none."""


def allowances(design: Design) -> Allowances:
    """Tolerances of a design; the roughness of its lens faces is that of [tolerances] or [body], the larger
    of the two.
    """
    spec, mm = design.tolerances, millimetres(design.unit_m)
    return Allowances(
        (spec.thickness[0] * mm, spec.thickness[1] * mm), spec.separation * mm, spec.radius,
        (spec.decentre[0] * mm, spec.decentre[1] * mm), spec.rotation, spec.tilt,
        max(spec.roughness, design.body.roughness) * mm,
    )  # fmt: skip
