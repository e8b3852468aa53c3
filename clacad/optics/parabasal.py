"""Rays infinitesimally close to an axis ray, through surfaces given one by one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clacad.base.types import Floats
from clacad.optics.rays import Fate, Rays
from clacad.optics.sequence import Interface, trace_sequence

STEP = 2e-3
"""Entrance height of the outer differential rays over the radius of the aperture; half of it for the inner ones."""


@dataclass(frozen=True, eq=False)
class Parabasal:
    """Derivatives of surfaces about the axis ray; NaN where one of the rays is not transmitted.

    Attributes
    ----------
    direction : (3,) unit
        Exit direction of the axis ray, sheet frame.
    cosines, slopes : (2, 2), radians/length
        Derivatives with respect to the entrance height (columns) of the exit ray's direction cosines and of
        its slopes (rows), lens frame: zero for an afocal pair.
    """

    direction: Floats
    cosines: Floats
    slopes: Floats


def parabasal(seq: Sequence[Interface], rotation: Floats, point: Floats, size: float) -> Parabasal:
    """Differentiate the real trace about the axis ray.

    Parameters
    ----------
    seq : sequence of Interface
    rotation : (3, 3)
        Lens → sheet; its third column is the direction of the axis ray before the first surface.
    point : (3,) lengths
        A point of that ray, sheet frame.
    size : float, length
        Entrance height of the outer rays, see `STEP`.

    Notes
    -----
    Central differences over `size` and `size`/2, extrapolated (Richardson): error of order (size/R)^4.
    """
    u, v, axis = rotation.T
    away = max(float(np.linalg.norm(point - np.asarray(face.vertex))) for face in seq)
    start = point - axis * ((away + 10.0 * size) / axis[2])  # before the first surface, however it is tilted
    heights = np.array([1.0, -1.0, 0.5, -0.5])[:, None] * size
    rows = np.concatenate([np.zeros((1, 3)), heights * u, heights * v]) + start
    seen = trace_sequence(seq, Rays(rows, np.broadcast_to(axis, rows.shape)))
    through = (seen.fate == Fate.ALIVE) | (seen.fate == Fate.BACKWARD)
    out = np.where(through[:, None], seen.direction, np.nan)
    lens = out @ rotation
    return Parabasal(out[0], _derivative(lens[1:, :2], size), _derivative(lens[1:, :2] / lens[1:, 2:], size))


def _derivative(values: Floats, size: float) -> Floats:
    """Derivative (2, 2) along u and v (columns) of values (8, 2) at heights ±size, ±size/2 along u, then along v."""
    columns = []
    for k in (0, 4):
        wide = (values[k] - values[k + 1]) / (2.0 * size)
        narrow = (values[k + 2] - values[k + 3]) / size
        columns.append((4.0 * narrow - wide) / 3.0)
    return np.stack(columns, axis=1)
