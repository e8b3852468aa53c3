"""Rays infinitesimally close to the axis ray of a telescopelet, traced through its real faces.

The pair is traced as it stands in the sheet: no cells, no rims. Used to place tilted plano pairs, to
state what a recipe leaves, and to find the best-focus recipe.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from clacad.base.types import Floats
from clacad.optics.surface import meet_at, refract
from clacad.sheet.window import Body, Window

Shifts = Sequence[tuple[float, float]]


def trace_pair(
    bodies: Sequence[Body], shifts: Shifts, start: Floats, direction: Floats
) -> tuple[Floats, Floats]:
    """Carry rays through the faces of the telescopelet over the origin cell.

    Parameters
    ----------
    bodies : sequence of Body
    shifts : displacement of the cells of array 0 and 1, lengths
    start, direction : (n, 3) arrays
        Sheet frame with the centre of cell 1 as origin; unit directions.

    Returns
    -------
    position, direction : (n, 3) arrays
        At the last face; NaN where a ray misses a face or is totally reflected.
    """
    position, direction = start, direction
    for body in bodies:
        for face, n1, n2 in ((body.front, 1.0, body.index), (body.back, body.index, 1.0)):
            shift = (0.0, 0.0) if face.array is None else shifts[face.array]
            vertex = np.array([face.vertex[0] + shift[0], face.vertex[1] + shift[1], face.vertex[2]])
            local, ray = (position - vertex) @ face.rotation, direction @ face.rotation
            met, point = meet_at(face.surface, local, ray)
            ray, _ = refract(ray, met.gradient, met.root, n1, n2)
            position = point @ face.rotation.T + vertex
            direction = ray @ face.rotation.T
    return position, direction


@dataclass(frozen=True)
class Parabasal:
    """What a pair does to the axis ray and its neighbours.

    direction : (3,) unit
        Where the axis ray leaves to.
    power : (2, 2), radians/length
        Change of exit direction with entrance position: zero for an afocal pair.
    """

    direction: Floats
    power: Floats


def parabasal(
    bodies: Sequence[Body], shifts: Shifts, rotation: Floats, origin: Floats, size: float
) -> Parabasal:
    """Differentiate the real trace about the axis ray (the ray along the lens axis through lens 1's centre).

    Parameters
    ----------
    rotation : (3, 3)
        Lens → sheet; its third column is the axis.
    origin : (3,)
        Reference point of lens 1 in the sheet frame.
    size : float
        Step of the central differences (length); their error is of order (size/R)².
    """
    u, v, axis = rotation.T
    steps = np.array([np.zeros(3), u, -u, v, -v]) * size
    start = origin + steps - axis * (10.0 * size)
    _, out = trace_pair(bodies, shifts, start, np.broadcast_to(axis, start.shape).copy())
    lateral = out @ np.stack([u, v], axis=1)
    power = np.stack([lateral[1] - lateral[2], lateral[3] - lateral[4]], axis=1) / (2.0 * size)
    return Parabasal(out[0], power)


def residual(window: Window, rotation: Floats, origin: Floats, asked: Floats) -> dict[str, float]:
    """Parabasal law error (radians) and decollimation over half a cell (radians) of a built window.

    Parameters
    ----------
    rotation : (3, 3)
        Lens → sheet of the asked law: its axis is the axis ray before the window.
    origin : (3,)
        A point of the axis ray, sheet frame, lengths.
    asked : (3,) unit
        Direction the law gives to the axis ray.

    Returns
    -------
    dict
        Both infinite where the axis ray does not get through.
    """
    found = parabasal(window.bodies, window.shifts, rotation, origin, 1e-4 * window.lattice.circumradius)
    if not (np.isfinite(found.direction).all() and np.isfinite(found.power).all()):
        # the axis ray misses a lens or is totally reflected: a window to be built and judged, not an error
        return {"law": inf, "decollimation": inf}
    cross = np.cross(found.direction, asked)
    error = float(np.arctan2(np.linalg.norm(cross), found.direction @ asked))
    half = 0.5 * max(window.lattice.pitch)
    return {"law": error, "decollimation": float(np.linalg.norm(found.power, 2)) * half}
