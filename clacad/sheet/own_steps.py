"""Steps between neighbours of a non-uniform sheet: over every border, not of one representative cell.

The height difference of two spheres of one radius is linear along their border, so five points on it find the
highest step. With two radii the difference is curved and is evaluated at seventeen points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.sheet.window import Body, Face, Window, face_height

PLACES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Relative positions along a border where two cells are compared."""
CLOSER = tuple(k / 16.0 for k in range(17))
"""Relative positions along a border for lenses of many sizes."""


@dataclass(frozen=True, slots=True)
class OwnStep:
    """Highest step of a body (length), and the cell on the left of its border."""

    height: float
    cell: tuple[int, int]


def highest_step(window: Window, body: Body) -> OwnStep:
    """Find the highest step between neighbouring lenses of a body; 0 where land lies between them."""
    found = [_of_face(window, face) for face in (body.front, body.back) if face.array is not None]
    return max(found, key=lambda step: step.height, default=OwnStep(0.0, (0, 0)))


def _of_face(window: Window, face: Face) -> OwnStep:
    assert face.array is not None
    cells = window.lattice.cells()
    best = OwnStep(0.0, (int(cells[0, 0]), int(cells[0, 1])))
    if window.land.seam > 0.0:
        return best
    for k in range(len(window.lattice.steps) // 2):
        left = cells[window.lattice.contains(cells + np.array(window.lattice.steps[k]))]
        if not len(left):
            continue
        apart = _across(window, face, left, k)
        worst = int(np.nanargmax(np.where(np.isnan(apart), -1.0, apart)))
        if apart[worst] > best.height:
            best = OwnStep(float(apart[worst]), (int(left[worst, 0]), int(left[worst, 1])))
    return best


def greatest_steps(window: Window, face: Face, index: Ints) -> Floats:
    """Greatest step (n,), lengths, of a face from cells `index` (n, 2) to kept neighbours; 0 across land."""
    made = np.zeros(len(index))
    if face.array is None or window.land.seam > 0.0:
        return made
    for k, step in enumerate(window.lattice.steps):
        inner = np.flatnonzero(window.lattice.contains(index + np.array(step)))
        if len(inner):
            made[inner] = np.fmax(made[inner], _across(window, face, index[inner], k))
    return made


def _across(window: Window, face: Face, left: Ints, k: int) -> Floats:
    """Step (n,), lengths, from cells `left` (n, 2) to neighbours across border k; NaN at a hole."""
    assert face.array is not None
    lattice = window.lattice_of(face.array)
    tile, m = lattice.tile(), len(lattice.steps)
    right = left + np.array(lattice.steps[k])
    at = CLOSER if window.many_sizes else PLACES
    one = _along(tile[k], tile[(k + 1) % m], at)
    other = _along(tile[(k + m // 2 + 1) % m], tile[(k + m // 2) % m], at)
    return np.asarray(
        np.abs(_heights(window, face, left, one) - _heights(window, face, right, other)).max(axis=1)
    )


def _along(start: Floats, end: Floats, at: tuple[float, ...]) -> Floats:
    """Points (n, 2) on a border at the relative positions `at` (n), cell frame."""
    t = np.array(at)[:, None]
    return np.asarray((1.0 - t) * start + t * end)


def _heights(window: Window, face: Face, cells: Ints, places: Floats) -> Floats:
    """Heights (cells, places) of a face over points (p, 2) of cells (c, 2)."""
    index = np.repeat(cells, len(places), axis=0)
    x, y = np.tile(places, (len(cells), 1)).T
    return face_height(window, face, x, y, index).reshape(len(cells), len(places))
