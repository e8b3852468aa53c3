"""Image of a point through a stack: by chief rays, and by the point nearest to all rays."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from math import inf, isfinite
from typing import Any

import numpy as np

from clacad.base.sobol import sobol
from clacad.base.types import Floats
from clacad.optics.rays import Fate
from clacad.stacking.chief_matrices import meridian
from clacad.stacking.stack_light import FEWEST, cone, middle_of_light, started
from clacad.tracing.through_stack import StackTracer


@dataclass(frozen=True, eq=False)
class StackImage:
    """The image of a point before a stack.

    Attributes
    ----------
    object_distance : float, length
        Distance before array 1 of the first sheet, on the axis through the centre of the lit cell.
    predicted : (x, y)
        Distance of the image behind array 2 of the last sheet, < 0 before it; infinite where light leaves
        parallel; None where the meridians are coupled.
    magnification : (x, y)
    by_rays : (x, y)
        Distance at which the rays of a meridian are closest together, measured as `predicted`.
    point : (3,) or None
        Point nearest to all rays, least squares, from the centre of array 2 of the last sheet.
    spread : float, length
        Rms distance of the rays from it.
    rays : int
        Number of ALIVE rays used.
    """

    object_distance: float
    predicted: tuple[float | None, float | None]
    magnification: tuple[float | None, float | None]
    by_rays: tuple[float | None, float | None]
    point: tuple[float, float, float] | None
    spread: float
    rays: int

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)


def measure_image(tracer: StackTracer, rays: int, field: float, distance: float) -> StackImage:
    """Trace light of a point through the stack and locate its image.

    Parameters
    ----------
    tracer : StackTracer
    rays : int
    field : float, radians
        Light within slopes of its tangent, as far as the first sheet reaches.
    distance : float, length
        Of the point before array 1 of the first sheet.
    """
    stack = tracer.stack
    first, last = stack.sheets[0], stack.sheets[-1]
    place, slope = cone(stack, sobol(rays, 2), field, distance)
    found = tracer(started(stack, place, slope))
    alive = found.fate == Fate.ALIVE
    where = middle_of_light(stack)
    predicted = [meridian(stack, axis) for axis in (0, 1)]
    images = [(None, None) if one is None else one.image(distance)[::2] for one in predicted]
    shown = tuple(_finite(image[0]) for image in images)
    sized = tuple(_finite(image[1]) for image in images)
    point, spread = None, inf
    lines: tuple[float | None, float | None] = (None, None)
    if alive.sum() >= FEWEST:
        at = found.position[alive] - [*where, last.lens_planes[1]]
        way = found.direction[alive] / np.linalg.norm(found.direction[alive], axis=1)[:, None]
        point, spread = nearest_point(at, way)
        lines = (_waist(at, way, 0), _waist(at, way, 1))
    assert first.scale == 1.0  # the stack's unit is the first sheet's
    return StackImage(
        distance, (shown[0], shown[1]), (sized[0], sized[1]), lines, point, spread, int(alive.sum())
    )


def _finite(value: float | None) -> float | None:
    return value if value is not None and isfinite(value) else None


def nearest_point(position: Floats, direction: Floats) -> tuple[tuple[float, float, float] | None, float]:
    """Point nearest to straight lines, from a linear system of three equations, and its rms distance from
    them.

    Parameters
    ----------
    position, direction : (n, 3)
        Unit directions.

    Returns
    -------
    point : (3,) or None
        None where the lines are parallel within rounding error.
    spread : float, length
    """
    middle = position.mean(axis=0)
    across = np.eye(3) - direction[:, :, None] * direction[:, None, :]
    whole = across.sum(axis=0)
    if np.linalg.cond(whole) > 1e12:
        return None, inf
    point = np.linalg.solve(whole, np.einsum("nij,nj->i", across, position - middle))
    away = np.einsum("nij,nj->ni", across, position - middle - point)
    x, y, z = (point + middle).tolist()
    return (x, y, z), float(np.sqrt((away**2).sum(axis=1).mean()))


def _waist(position: Floats, direction: Floats, axis: int) -> float | None:
    """Height z at which lines (n, 3) are closest together in a meridian; None where they are parallel."""
    slope = direction[:, axis] / direction[:, 2]
    place = position[:, axis] - slope * position[:, 2]
    away = slope - slope.mean()
    square = float(away @ away)
    if square <= 1e-24 * len(slope):
        return None
    return float(-(away @ (place - place.mean())) / square)
