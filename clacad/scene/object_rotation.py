"""Rotations of objects about the fixed axes, exact at right angles."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


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
