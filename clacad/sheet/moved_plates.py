"""Sheets with plates moved from where they are designed, and where paraxial light then leaves.

Plates are numbered in the order of the light, from 1. A plate that moves takes the cells of its faces along,
so that faces of one array on two plates move together or not at all.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats
from clacad.base.vectors import rotated_by
from clacad.optics.sequence import Interface
from clacad.sheet.face_order import plates_of, refractions
from clacad.sheet.like_cell import interfaces

if TYPE_CHECKING:
    from clacad.sheet.window import Body, Face, Window


class CannotMove(ValueError):
    """A plate that cannot move as requested."""

    exit_status = 2


def moved_plates(window: Window, moves: Mapping[int, Floats]) -> Window:
    """Return the sheet with some plates moved; its law stays that of the design.

    moves : Number of a plate → its displacement (3,), lengths, sheet frame. Others stay.
    Raises CannotMove: No such plate, or two plates that carry lenses of one array move differently.
    """
    plates = plates_of(window.bodies)
    unknown = sorted(set(moves) - set(range(1, len(plates) + 1)))
    if unknown:
        raise CannotMove(f"plate{unknown[0]}: the design has the plates 1 to {len(plates)}")
    shifts = [np.asarray(place.shift) for place in window.placements]
    bodies: list[Body] = []
    own: dict[int, tuple[int, Floats]] = {}
    for number, plate in enumerate(plates, start=1):
        move = np.asarray(moves.get(number, np.zeros(3)), dtype=np.float64)
        for face in (face for body in plate for face in (body.front, body.back)):
            if face.array is None:
                continue
            before, there = own.setdefault(face.array, (number, move))
            if not np.array_equal(there[:2], move[:2]):
                raise CannotMove(
                    f"plates {before} and {number} carry lenses of one array and cannot move apart; give the"
                    ' faces of the plates between the outer ones array = "field"'
                )
        bodies += [
            replace(body, front=_raised(body.front, move[2]), back=_raised(body.back, move[2]))
            for body in plate
        ]
    places = tuple(
        replace(place, shift=(float(x), float(y)))
        for place, (x, y) in zip(
            window.placements,
            (shift + own[k][1][:2] if k in own else shift for k, shift in enumerate(shifts)),
            strict=True,
        )
    )
    low, high = window.z_range
    first, last = (float(moves[k][2]) if k in moves else 0.0 for k in (1, len(plates)))
    return replace(window, bodies=tuple(bodies), placements=places, z_range=(low + first, high + last))


def _raised(face: Face, rise: float) -> Face:
    """The face with its land, `rise` (length) higher."""
    x, y, z = face.vertex
    return replace(face, vertex=(x, y, z + rise), land=None if face.land is None else face.land + rise)


def tilted_plate(window: Window, number: int, turn: Floats, aside: Floats) -> list[Interface]:
    """Faces of one telescopelet with a plate tilted as a whole, the centre of cell 1 at x = y = 0.

    number : Of the plate, from 1. turn : (3,) radians. Vector of the rotation about the plate's own middle.
    aside : (3,) lengths. Place of the telescopelet in the sheet: the plate rises there by turn × aside.
    """
    plate, whole, found = plates_of(window.bodies)[number - 1], rotated_by(*turn), []
    heights = (plate[0].front.vertex[2], plate[-1].back.vertex[2])
    for (body, face, _, _), one in zip(refractions(window.bodies), interfaces(window), strict=True):
        if body in plate:
            array = body.arrays[0] if face.array is None else face.array
            pivot = np.array([*window.shifts[array], 0.5 * sum(heights)]) - aside
            rotation = np.eye(3) if one.rotation is None else one.rotation
            vertex = pivot + whole @ (np.asarray(one.vertex) - pivot)
            one = Interface(one.surface, vertex, one.index_before, one.index_after, whole @ rotation)
        found.append(one)
    return found


def paraxial_exit(window: Window, height: Floats, slope: Floats) -> tuple[Floats, Floats]:
    """Height and slope (2,) at the last vertex of a paraxial ray of cell 1, sheet axes.

    Lenses lie along the normal.

    height, slope : (2,). At the first vertex, from the middle of the cell.
    """
    optical = np.array(slope, dtype=np.float64)  # slope times the refractive index
    at, medium = window.bodies[0].front.vertex[2], 1.0
    for _, face, before, after in refractions(window.bodies):
        height = height + (face.vertex[2] - at) / medium * optical
        at, medium = face.vertex[2], after
        if face.array is None:
            continue
        middle = np.asarray(face.vertex[:2]) + np.asarray(window.shifts[face.array])
        turn = face.rotation[:2, :2]
        bent = face.side * np.diag([face.surface.curvature_x, face.surface.curvature_y])
        optical = optical - (after - before) * (turn @ bent @ turn.T) @ (height - middle)
    return np.asarray(height), np.asarray(optical)
