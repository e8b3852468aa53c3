"""Steps between neighbours of a sheet whose cells differ: over every border, not of one cell that stands for all.

Of two spheres the difference in height along their border is a straight line, so five places on it see the highest step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.sheet.window import Body, Face, Window, face_height

PLACES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Where on a border the two cells are compared."""


@dataclass(frozen=True, slots=True)
class OwnStep:
    """The highest step of a body (length), and the cell on the left of the border where it stands."""

    height: float
    cell: tuple[int, int]


def highest_step(window: Window, body: Body) -> OwnStep:
    """Find the highest step between neighbouring lenses of a body; 0 where land lies between them."""
    found = [_of_face(window, face) for face in (body.front, body.back) if face.array is not None]
    return max(found, key=lambda step: step.height)


def _of_face(window: Window, face: Face) -> OwnStep:
    assert face.array is not None
    cells, lattice = window.lattice.cells(), window.lattice_of(face.array)
    best = OwnStep(0.0, (int(cells[0, 0]), int(cells[0, 1])))
    if window.land.seam > 0.0:
        return best
    tile, m = lattice.tile(), len(lattice.steps)
    for k in range(m // 2):
        there = cells + np.array(lattice.steps[k])
        left = cells[window.lattice.contains(there)]
        right = left + np.array(lattice.steps[k])
        if not len(left):
            continue
        one = _along(tile[k], tile[(k + 1) % m])
        other = _along(tile[(k + m // 2 + 1) % m], tile[(k + m // 2) % m])
        apart = np.abs(_heights(window, face, left, one) - _heights(window, face, right, other)).max(axis=1)
        worst = int(np.nanargmax(np.where(np.isnan(apart), -1.0, apart)))
        if apart[worst] > best.height:
            best = OwnStep(float(apart[worst]), (int(left[worst, 0]), int(left[worst, 1])))
    return best


def _along(start: Floats, end: Floats) -> Floats:
    """Places (5, 2) on a border, cell frame."""
    t = np.array(PLACES)[:, None]
    return np.asarray((1.0 - t) * start + t * end)


def _heights(window: Window, face: Face, cells: Ints, places: Floats) -> Floats:
    """Heights (cells, places) of a face over places (p, 2) of cells (c, 2)."""
    index = np.repeat(cells, len(places), axis=0)
    x, y = np.tile(places, (len(cells), 1)).T
    return face_height(window, face, x, y, index).reshape(len(cells), len(places))
