"""Sobol points: the only source of deterministic, evenly spread test rays.

Unscrambled, in Gray-code order, direction numbers of S. Joe and F. Y. Kuo, SIAM J. Sci. Comput. 30, 2635
(2008), "new-joe-kuo-6". Any 2^k first points fill every elementary interval. The first point is the
origin; it is left out by default, so that no ray starts exactly in a corner.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# (degree s, coefficients a, initial numbers m) of dimensions 2 to 10; dimension 1 is van der Corput's
# sequence
_JOE_KUO = (
    (1, 0, (1,)),
    (2, 1, (1, 3)),
    (3, 1, (1, 3, 1)),
    (3, 2, (1, 1, 1)),
    (4, 1, (1, 1, 3, 3)),
    (4, 4, (1, 3, 5, 13)),
    (5, 2, (1, 1, 5, 5, 17)),
    (5, 4, (1, 1, 5, 5, 5)),
    (5, 7, (1, 1, 7, 11, 19)),
)
_BITS = 52


def sobol(count: int, dimension: int, skip: int = 1) -> NDArray[np.float64]:
    """First points of the Sobol sequence.

    dimension : 1 to 10
    skip : Points left out at the start (1: the origin). Consecutive chunks with rising `skip` continue one
        sequence.
    Returns (count, dimension) array in [0, 1).
    Raises ValueError: Dimension out of range.
    """
    if not 1 <= dimension <= len(_JOE_KUO) + 1:
        raise ValueError(f"Sobol points are given for 1 to {len(_JOE_KUO) + 1} dimensions, not {dimension}")
    number = np.arange(skip, skip + count, dtype=np.uint64)
    gray = number ^ (number >> np.uint64(1))
    points = np.zeros((count, dimension), dtype=np.uint64)
    bits = max(1, int(skip + count).bit_length())
    for d in range(dimension):
        for bit, direction in enumerate(_directions(d, bits)):
            chosen = (gray >> np.uint64(bit)) & np.uint64(1)
            points[:, d] ^= chosen * np.uint64(direction)
    return np.asarray(points * 2.0**-_BITS, dtype=np.float64)


def _directions(dimension: int, bits: int) -> list[int]:
    """Direction numbers scaled to 52 bits; at least `bits` numbers."""
    if dimension == 0:
        return [1 << (_BITS - 1 - k) for k in range(bits)]
    degree, coefficients, initial = _JOE_KUO[dimension - 1]
    m = list(initial)
    for k in range(degree, bits):
        value = m[k - degree] ^ (m[k - degree] << degree)
        for j in range(1, degree):
            if (coefficients >> (degree - 1 - j)) & 1:
                value ^= m[k - j] << j
        m.append(value)
    return [m[k] << (_BITS - 1 - k) for k in range(bits)]
