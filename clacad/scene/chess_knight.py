"""The built-in chess knight: a flat extruded profile facing −x on a rotationally symmetric plinth, 1 high.

Analytic, so that it has no facets: frusta and one prism. The sculpted piece is `designs/chess-knight.py`.
Objects are rotated about the fixed axes, exactly at right angles.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

PLINTH: Final = (
    # y from, y to, radius below, radius above
    (0.00, 0.055, 0.250, 0.250),
    (0.055, 0.085, 0.250, 0.205),
    (0.085, 0.125, 0.215, 0.215),
    (0.125, 0.185, 0.200, 0.150),
    (0.185, 0.215, 0.170, 0.170),
)
"""Rotationally symmetric foot, frusta from below."""

PROFILE: Final = np.array(
    [
        (0.150, 0.205),
        (0.188, 0.290),
        (0.208, 0.400),
        (0.214, 0.510),
        (0.206, 0.620),
        (0.184, 0.720),
        (0.150, 0.805),
        (0.108, 0.870),
        (0.068, 0.912),
        (0.050, 1.000),
        (0.008, 0.930),
        (-0.030, 0.905),
        (-0.078, 0.858),
        (-0.120, 0.795),
        (-0.168, 0.725),
        (-0.215, 0.665),
        (-0.236, 0.625),
        (-0.234, 0.580),
        (-0.208, 0.552),
        (-0.172, 0.548),
        (-0.150, 0.572),
        (-0.128, 0.545),
        (-0.090, 0.545),
        (-0.048, 0.572),
        (-0.012, 0.590),
        (0.002, 0.556),
        (-0.012, 0.500),
        (-0.052, 0.430),
        (-0.096, 0.355),
        (-0.130, 0.280),
        (-0.146, 0.205),
    ]
)
"""Outline of the head in x, y, counter-clockwise."""

HALF_THICKNESS: Final = 0.085
"""Half of the head's thickness in z."""

EYE: Final = (-0.062, 0.785, 0.020)
"""Eye: x, y and radius of a short rod through the head, a darker shade of the piece's colour."""

EYE_SHADE: Final = 0.15


def turned(degrees: tuple[float, float, float]) -> NDArray[np.float64]:
    """Rotation (3, 3), object → scene, about the fixed x, then y, then z axis."""
    made = np.eye(3)
    for axis, angle in enumerate(degrees):
        c, s = _exact_cosine(angle), _exact_cosine(angle - 90.0)
        one = np.eye(3)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        one[i, i] = one[j, j] = c
        one[i, j], one[j, i] = -s, s
        made = one @ made
    return made


def _exact_cosine(degrees: float) -> float:
    """Cosine, exact at multiples of 90 degrees."""
    turn = degrees % 360.0
    if turn % 90.0 == 0.0:
        return (1.0, 0.0, -1.0, 0.0)[int(turn // 90.0) % 4]
    return math.cos(math.radians(turn))
