"""Flux through triangles, which sums to a mesh's volume.

The design's is in `clacad.sheet.volume_and_extent`.
"""

from __future__ import annotations

import numpy as np

from clacad.base.types import Floats


def flux(corners: Floats) -> Floats:
    """Flux of (0, 0, z) through triangles (t, 3, 3): a closed surface's sum is its volume (t,).

    Vertical walls add nothing, and a shift in x, y changes nothing.
    """
    ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray((ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]) * corners[:, :, 2].sum(axis=1) / 6.0)
