"""What equal cells do in coherent light: a grating, sin θ' = sin θ + mλ/p, under the far field of one cell.

Light that is one wave over many cells leaves in the directions of that grating alone. One of them lies within half a
step of the law's direction, and the light goes to the few that the far field of one cell covers; the law itself is met
only where an order happens to fall on it. Sunlight through a window pane is no such light: it agrees with itself over
50 µm, less than a cell.
"""

from __future__ import annotations

import numpy as np

from clacad.base.types import Pair2
from clacad.sheet.lattice import Lattice


def order_steps(lattice: Lattice, wavelength: float) -> Pair2:
    """Steps of the direction cosine from order to order along both vectors of the reciprocal lattice: λ/p on a square one.

    wavelength : float, length
    """
    vectors = np.array([lattice.offset(1, 0), lattice.offset(0, 1)], dtype=np.float64)
    first, second = np.linalg.norm(np.linalg.inv(vectors), axis=0)
    return wavelength * float(first), wavelength * float(second)
