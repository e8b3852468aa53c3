"""Error of the facets against the exact surfaces: slope and sag."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from clacad.base.vectors import doubled_normals
from clacad.mesh.integer_heights import LENS
from clacad.optics.law.orientation import angle_between
from clacad.sheet.window import Body, Face, lens_height_and_normal

if TYPE_CHECKING:
    from clacad.mesh.prototile import Prototile

# edge middles, centroid, and the three inner points of the rule that is exact to degree 2
_EDGES = np.array([(0.5, 0.5, 0.0), (0.0, 0.5, 0.5), (0.5, 0.0, 0.5), (1 / 3, 1 / 3, 1 / 3)])
_INNER = np.array([(2 / 3, 1 / 6, 1 / 6), (1 / 6, 2 / 3, 1 / 6), (1 / 6, 1 / 6, 2 / 3)])


def facet_errors(tile: Prototile, body: Body) -> tuple[float, float]:
    """Slope and sag error of a prototile's optical facets.

    Returns
    -------
    slope : float
        rms angle between facet and exact normal over the facets' area, worse of the two faces (radians).
    sag : float
        Largest normal distance found at edge middles, centroids and inner points (length).
    """
    slopes, sags = [0.0], [0.5 * tile.step]
    for side, face in enumerate((body.front, body.back)):
        chosen = (tile.part[:, side] == LENS) & ~tile.bevelled(side)
        if face.array is None or not chosen.any() or (np.abs(tile.lens[:, side]) >= 2**60).all():
            continue
        slope, sag = _face_errors(tile, face, side, chosen)
        slopes.append(slope)
        sags.append(sag)
    return max(slopes), max(sags)


def _face_errors(tile: Prototile, face: Face, side: int, chosen: NDArray[np.bool_]) -> tuple[float, float]:
    """Rms angle (radians) and largest distance (length) of the chosen facets of one face from its surface."""
    triangles = tile.plan.triangles[chosen]
    corner = np.concatenate(
        [tile.plan.xy[triangles], (tile.lens[triangles, side] * tile.step)[..., None]], axis=2
    )
    cross = doubled_normals(corner)
    area = np.linalg.norm(cross, axis=1)
    flat = area > 0.0
    corner, cross, area = corner[flat], cross[flat], area[flat]
    normal = cross / area[:, None]
    squares = np.zeros(len(area))
    sag = 0.0
    for weights in (*_INNER, *_EDGES):
        at = np.einsum("c,tcd->td", weights, corner)
        z, exact = lens_height_and_normal(face, at[:, 0], at[:, 1])
        sag = max(sag, float(np.nanmax(np.abs(z - at[:, 2]) * exact[:, 2], initial=0.0)))
        if weights.max() == 2 / 3:
            angle = angle_between(normal, exact)
            squares += np.where(np.isnan(angle), 0.0, angle) ** 2 / 3.0
    return float(np.sqrt(np.sum(area * squares) / np.sum(area))), sag
