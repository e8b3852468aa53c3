"""A uniform sheet in coherent light: a grating, sin θ' = sin θ + mλ/p, under the far field of one cell.

Light that is coherent over many cells leaves only in the directions of that grating. One order lies within
half a step of the law's direction. The light goes to the few orders that the far field of one cell covers;
the law's own direction receives light only where an order coincides with it. Sunlight through a window pane
does not show these orders: it is coherent over 50 µm, less than a cell.
"""

from __future__ import annotations

import numpy as np

from clacad.base.types import Pair2
from clacad.sheet.lattice import Lattice


def order_steps(lattice: Lattice, wavelength: float) -> Pair2:
    """Steps of the direction cosine between orders along both reciprocal lattice vectors: λ/p on a square
    lattice.

    wavelength : float, length
    """
    vectors = np.array([lattice.offset(1, 0), lattice.offset(0, 1)], dtype=np.float64)
    first, second = np.linalg.norm(np.linalg.inv(vectors), axis=0)
    return wavelength * float(first), wavelength * float(second)
