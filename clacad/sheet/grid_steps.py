"""Steps of a cell's facet grid in each direction: one along a cylinder, `quads` otherwise.

Facets as long as the cell represent a surface ruled along a side of its cell exactly. More facets would add
bytes and no accuracy.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from clacad.base.types import Floats
from clacad.optics.surface import Biconic, Quadric
from clacad.sheet.face_order import plates_of
from clacad.sheet.window import Body, Face, Window, optical_tile

Steps = tuple[int, int]
"""Steps along the first half axis of a rectangular cell (towards its first side), and along the second."""

Number = TypeVar("Number", int, float)

ALIGNED = 1e-12
"""Sine of the largest angle between a cylinder and the side of its cell that counts as 0."""


def grid_steps(window: Window, array: int, faces: Sequence[Face], quads: Number) -> tuple[Number, Number]:
    """Steps of the grid that several faces share over the cells of an array."""
    if window.lattice.hexagonal:
        return quads, quads
    first, second = (
        1 if all(_ruled(face, axis) for face in faces) else quads
        for axis in half_axes(optical_tile(window, array))
    )
    return first, second


def lens_squares(window: Window, quads: Number) -> Number:
    """Number of grid squares over all lens faces of one cell; a hexagonal cell has three times as many."""
    total = quads - quads
    for body in window.bodies:
        for face in (body.front, body.back):
            if face.array is not None:
                faces = faces_of_plate(window, body, face.array)
                along, across = grid_steps(window, face.array, faces, quads)
                total += along * across
    return total


def plate_of(window: Window, body: Body) -> tuple[Body, ...]:
    """Bodies of the plate that contains a body, itself included."""
    return next((plate for plate in plates_of(window.bodies) if body in plate), (body,))


def faces_of_plate(window: Window, body: Body, array: int) -> list[Face]:
    """Faces of a body's plate that one grid over the cells of an array describes: joined bodies share
    triangles.
    """
    place = window.placements[array]
    return [
        face
        for one in plate_of(window, body)
        for face in (one.front, one.back)
        if face.array is None or window.placements[face.array] == place
    ]


def half_axes(zone: Floats) -> tuple[Floats, Floats]:
    """Vectors (2, 2), lengths, from a rectangle's (4, 2) centre to the midpoints of its first two sides."""
    return 0.5 * (zone[0] + zone[1]), 0.5 * (zone[1] + zone[2])


def one_tiling(window: Window, body: Body) -> tuple[int, ...]:
    """Return the array(s) whose cells cut a body: one where the faces' cells coincide, else both."""
    arrays = body.arrays
    alike = len(arrays) == 2 and window.placements[arrays[0]] == window.placements[arrays[1]]
    return arrays[:1] if alike else arrays


def _ruled(face: Face, axis: Floats) -> bool:
    """Whether a face is ruled along a direction (2,) of the sheet: a plane, or a cylinder along it."""
    if face.array is None:
        return True
    if not isinstance(face.surface, Quadric | Biconic):
        return False
    along = np.abs(np.array([*axis, 0.0]) @ face.rotation) / np.hypot(*axis)
    curvatures = face.surface.curvature_x, face.surface.curvature_y
    return any(
        curvature == 0.0 and np.delete(along, k).max() <= ALIGNED for k, curvature in enumerate(curvatures)
    )
