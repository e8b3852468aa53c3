"""Notes of a drawing: allowed deviations, and how the sheet is oriented.

Allowed deviations of a part, in millimetres, as drawings state them: from the [tolerances] of its design.

How the part must be held, derived from its geometry alone: light, lenses, outline and holes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats
from clacad.base.units import millimetres
from clacad.optics.surface import sag
from clacad.sheet.edge_columns import CX, CY, RADIUS, X0, X1, Y0, Y1
from clacad.sheet.plate import Plate
from clacad.sheet.window import Face, Window

if TYPE_CHECKING:
    from clacad.design import Design


@dataclass(frozen=True, slots=True)
class Allowances:
    """Half widths of the ± tolerances; 0 where the design states none.

    thickness : (body 1, body 2), mm. Of the centre thickness.
    separation : mm. Lens to lens.
    radius : (array 1, array 2). Of every radius, relative.
    decentre : (array 1, array 2), mm
    rotation, tilt : radians. Of array 2 against array 1, about the normal and about x and y.
    roughness : mm. Largest rms height of the lens faces.
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
    """Tolerances of a design; roughness of its lens faces: the larger of [tolerances] and [body]."""
    spec, mm = design.tolerances, millimetres(design.unit_m)
    return Allowances(
        (spec.thickness[0] * mm, spec.thickness[1] * mm),
        spec.separation * mm,
        spec.radius,
        (spec.decentre[0] * mm, spec.decentre[1] * mm),
        spec.rotation,
        spec.tilt,
        max(spec.roughness, design.body.roughness) * mm,
    )


SAME = 1e-9
"""Relative difference within which two lengths are equal."""

HALF: tuple[Floats, ...] = (np.diag([-1.0, -1.0]),)
QUARTER: tuple[Floats, ...] = (np.array([[0.0, -1.0], [1.0, 0.0]]),)
OVER: tuple[Floats, ...] = (np.diag([1.0, -1.0]), np.diag([-1.0, 1.0]))
"""Ways to rotate a plate in its plane by a half or a quarter turn, and to turn it over; any one suffices."""


def orientation(window: Window) -> list[str]:
    """Sentences on how the part must be held, derived from the geometry alone."""
    first, last = window.bodies[0].name, window.bodies[-1].name
    found = [
        "The light of the checks travels towards +z and meets lens 1 first"
        + (
            f", on {first}; {last} carries lens 2."
            if first != last
            else "; lens 2 is the back of the same body."
        ),
        (
            "The axes are right-handed: with the light at your back and +y up, +x points to the left. No file"
            " is mirrored."
        ),
        *_turning(window),
    ]
    if window.recipe.get("field", {}).get("equal_plates"):
        found.append(
            f"{first} and {last} are the same part: order it twice and put the two back to back, field lenses"
            " inside."
        )
    return found


def _turning(window: Window) -> tuple[str, str]:
    """Whether the part may be turned about z, and whether it may be turned over."""
    faces = [face for face in window.faces if face.array is not None]
    centred = all(face.untilted and face.vertex[:2] == (0.0, 0.0) for face in faces)
    if not (window.uniform and centred and all(shift == (0.0, 0.0) for shift in window.shifts)):
        why = "lens axes or offsets point one way" if window.uniform else "it is not uniform"
        turned = f"It may not be turned about z: {why}. Mark the corner +x, +y."
        return turned, "It may not be turned over: the two sides differ. Mark the side of lens 1."
    square = not window.lattice.hexagonal and window.lattice.pitch[0] == window.lattice.pitch[1]
    reach = window.lattice.circumradius
    round_ones = all(_same(_heights(face, reach), _heights(face, reach).T) for face in faces)
    if not _fits(window, HALF):
        turned = (
            "It may not be turned about z: outline or holes fit one way round. The optics would stay the same"
            " by half a turn."
        )
    elif square and round_ones and _fits(window, QUARTER):
        turned = "It may be turned by quarter turns about z: the optics stay the same."
    else:
        turned = "It may be turned by half a turn about z, not by a quarter: the optics stay the same."
    if not _both_sides_alike(window, faces, reach):
        return turned, "It may not be turned over: the two sides differ. Mark the side of lens 1."
    if not _fits(window, OVER):
        return (
            turned,
            "It may not be turned over: outline or holes fit one way round. Mark the side of lens 1.",
        )
    return turned, "It may be turned over, too: both sides are alike."


def _both_sides_alike(window: Window, faces: list[Face], reach: float) -> bool:
    """Whether light from either side meets the same lenses at the same distances."""
    heights = [face.vertex[2] for face in window.faces]
    thick = np.diff(heights)
    media = [body.index for body in window.bodies]
    return (
        media == media[::-1]
        and _same(thick, thick[::-1])
        and all(
            _same(_heights(one, reach), _heights(other, reach))
            for one, other in zip(faces, faces[::-1], strict=True)
        )
    )


def _heights(face: Face, reach: float) -> Floats:
    """Heights of a face over a quarter of its cell (8, 8), length; all surfaces are even in x and in y."""
    x = reach * np.arange(1, 9) / 8.0
    return face.surface.side * sag(face.surface, x[:, None], x[None, :])


def _same(one: Floats, other: Floats) -> bool:
    size = float(np.nanmax(np.abs(one), initial=0.0))
    return np.allclose(one, other, rtol=0.0, atol=SAME * size, equal_nan=True)


def _fits(window: Window, ways: tuple[Floats, ...]) -> bool:
    """Whether a plate coincides with itself after one of these rotations; other outlines always do."""
    plate = window.outline
    return not isinstance(plate, Plate) or any(
        np.array_equal(_marks(plate, np.eye(2)), _marks(plate, way)) for way in ways
    )


def _marks(plate: Plate, way: Floats) -> Floats:
    """Ends, centre and radius of every edge of a rotated plate, sorted, in steps of the rounding error."""
    step = 1e-6 * max(plate.reach)
    ends = [np.rint(plate.edges[:, pair] @ way.T / step) for pair in ([X0, Y0], [X1, Y1], [CX, CY])]
    later = (ends[0][:, 0] > ends[1][:, 0]) | (
        (ends[0][:, 0] == ends[1][:, 0]) & (ends[0][:, 1] > ends[1][:, 1])
    )
    first, last = np.where(later[:, None], ends[1], ends[0]), np.where(later[:, None], ends[0], ends[1])
    rows = np.column_stack([first, last, ends[2], np.rint(plate.edges[:, RADIUS] / step)]) + 0.0
    return rows[np.lexsort(rows.T)]
