"""Chief rays through sheets and spaces in a row, one meridian at a time: matrices of position and slope.

The chief ray of a cell passes through the middle of its lens 1. As long as cells are small, the chief rays of
many cells represent the light. A sheet maps position and slope (x, t) to (x + s t, (t − δ − κ x)/η) from
array 1 to array 2. The determinant of this map is 1/η; a sheet is no lens, so the determinant need not be 1.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import inf

import numpy as np

from clacad.base.types import Floats


@dataclass(frozen=True, eq=False)
class ChiefRays:
    """Affine map of position and slope in one meridian: (x, t) ↦ matrix (x, t) + shift.

    Parameters
    ----------
    matrix : (2, 2)
        ((A, B), (C, D)): A and D are numbers, B a length, C one over a length.
    shift : (2,)
        A length and a slope.
    """

    matrix: Floats
    shift: Floats

    def then(self, after: ChiefRays) -> ChiefRays:
        """Return the map of this element followed by `after`."""
        return ChiefRays(after.matrix @ self.matrix, after.matrix @ self.shift + after.shift)

    @property
    def determinant(self) -> float:
        """A D − B C; a product of 1/η."""
        (a, b), (c, d) = self.matrix
        return float(a * d - b * c)

    def image(self, distance: float) -> tuple[float, float, float]:
        """Image of an axial point that lies `distance` before array 1.

        Parameters
        ----------
        distance : float, length

        Returns
        -------
        beyond : float, length
            Distance of the image behind the last array, < 0 before it; infinite where light leaves parallel.
        across : float, length
            How far off the axis it lies.
        magnification : float
            Lateral.
        """
        seen = space(distance).then(self)
        (a, b), (c, d) = seen.matrix
        if d == 0.0:
            return inf, inf, inf
        beyond = float(-b / d) + 0.0  # no −0
        return beyond, float(seen.shift[0] + beyond * seen.shift[1]), float(a + beyond * c)


def sheet(eta: float, separation: float, delta: float = 0.0, kappa: float = 0.0) -> ChiefRays:
    """A sheet from array 1 to array 2.

    Parameters
    ----------
    eta : float
        Not 0. |η| ≤ 1; for |η| > 1 the light is not centred on chief rays: use `of_beams`.
    separation : float, length
    delta : float
        Offset in the middle of the sheet.
    kappa : float, one over a length
        Growth of the offset across the sheet, dδ/dx.
    """
    return ChiefRays(np.array([[1.0, separation], [-kappa / eta, 1.0 / eta]]), np.array([0.0, -delta / eta]))


def with_field_lens(eta: float, aside: float, delta: float = 0.0) -> ChiefRays:
    """A sheet whose field lens images lens 1 onto lens 2: all chief rays leave in the middle of cell 2.

    aside : float, length
        Distance from the middle of cell 1 to that of its partner.
    """
    return ChiefRays(np.array([[1.0, 0.0], [0.0, 1.0 / eta]]), np.array([aside, -delta / eta]))


def of_beams(
    eta: float, separation: float, delta: float = 0.0, kappa: float = 0.0, scale: float = 1.0
) -> ChiefRays:
    """A sheet described by the middle of the transmitted light, which for |η| > 1 is not a chief ray.

    Lens 1 arrives at lens 2 as a copy η times as large, displaced by s t. If the copy is larger than lens 2,
    the transmitted part is centred on lens 2's cell, at g X, with X the middle of lens 1. It entered at (g X
    − X − s t)/η from X, and its slope is (t − δ − κ X)/η.

    scale : float
        g, the pitch of array 2 over that of array 1.
    """
    if abs(eta) <= 1.0:
        return sheet(eta, separation, delta, kappa)
    part = eta / (eta + scale - 1.0)  # X = part (x + s t/η)
    x, t = part, part * separation / eta
    matrix = [[scale * x, scale * t], [-kappa * x / eta, (1.0 - kappa * t) / eta]]
    return ChiefRays(np.array(matrix), np.array([0.0, -delta / eta]))


def space(length: float) -> ChiefRays:
    """Empty space of a length, which may be negative."""
    return ChiefRays(np.array([[1.0, length], [0.0, 1.0]]), np.zeros(2))


def in_a_row(elements: Iterable[ChiefRays]) -> ChiefRays:
    """Elements in the order light passes them, combined into one."""
    whole = space(0.0)
    for element in elements:
        whole = whole.then(element)
    return whole
