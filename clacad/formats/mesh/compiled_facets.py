"""Facets in the form of a binary STL file, compiled: see `clacad.formats.mesh.stl`."""

from __future__ import annotations

import numpy as np

from clacad.base.compiled import entry
from clacad.base.types import Floats, Singles


@entry
def facet_numbers(corners: Floats, scale: float, numbers: Singles) -> bool:
    """Write normal and corners of facets (k, 3, 3) into (k, 4, 3) float32; return whether all of them are
    finite.

    scale : float
        File units per unit of the corners.

    Corners are rounded first, without −0; the normal is that of the rounded triangle, of length 1, or 0 for
    one
    without area.
    """
    finite = True
    zero = np.float32(0.0)
    for f in range(len(corners)):
        for corner in range(3):
            for axis in range(3):
                value = np.float32(corners[f, corner, axis] * scale) + zero
                numbers[f, 1 + corner, axis] = value
                finite = finite and np.isfinite(value)
        ax, ay, az = np.float64(numbers[f, 1, 0]), np.float64(numbers[f, 1, 1]), np.float64(numbers[f, 1, 2])
        ux, uy, uz = numbers[f, 2, 0] - ax, numbers[f, 2, 1] - ay, numbers[f, 2, 2] - az
        vx, vy, vz = numbers[f, 3, 0] - ax, numbers[f, 3, 1] - ay, numbers[f, 3, 2] - az
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        if not length > 0.0:
            length = 1.0
        numbers[f, 0, 0] = np.float32(nx / length) + zero
        numbers[f, 0, 1] = np.float32(ny / length) + zero
        numbers[f, 0, 2] = np.float32(nz / length) + zero
    return finite
