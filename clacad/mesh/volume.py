"""Volume of a mesh by its own divergence sum; the design's is in `clacad.sheet.volume_and_extent`."""

from __future__ import annotations

from math import fsum
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats

if TYPE_CHECKING:
    from clacad.mesh.body_mesh import BodyMesh


def flux(corners: Floats) -> Floats:
    """Flux of (0, 0, z) through triangles (t, 3, 3): a closed surface's sum is its volume (t,).

    Vertical walls add nothing, and a shift in x, y changes nothing.
    """
    ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray((ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]) * corners[:, :, 2].sum(axis=1) / 6.0)


def mesh_volume(mesh: BodyMesh) -> float:
    """Sum the flux over the templates, each times its number, and the land (length³)."""
    parts: list[float] = []
    for template, lattice, number in mesh.census:
        xy = template.xy + (lattice.centres(template.owner) - lattice.centres(np.zeros(2, dtype=np.int64)))
        corners = np.concatenate([xy, template.z[:, None]], axis=1)[template.triangles]
        parts.append(number * fsum(flux(corners).tolist()))
    parts += flux(mesh.plain.corners).tolist()
    return fsum(parts)
