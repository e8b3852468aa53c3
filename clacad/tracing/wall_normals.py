"""Which wall a ray is at, and its normal: borders of cells, borders of optical zones, the outline."""

from __future__ import annotations

import numpy as np

from clacad.base.types import Floats
from clacad.sheet.plate_edges import nearest_edges
from clacad.tracing.layout import BodyPlan, Layout

NUDGE = 16 * 2.0**-52
"""Share of a cell by which a ray is moved beyond its wall, so that rounding does not leave it before the
wall.
"""


def wall_normals(
    layout: Layout, body: BodyPlan, direction: Floats, local: dict[int, Floats], xy: Floats
) -> Floats:
    """Horizontal unit normals (m, 2) of the walls that rays are at, on the side the rays go to.

    Parameters
    ----------
    direction : (m, 3)
    local : one (m, 2) array for each of the body's arrays
        The points, relative to the cells they are in.
    xy : (m, 2)
        The same points in the sheet frame.
    """
    away, normals = [], []
    for array, points in local.items():
        for (ux, uy), half in zip(layout.normals[array], layout.widths[array], strict=True):
            sign = np.where(ux * direction[:, 0] + uy * direction[:, 1] < 0.0, -1.0, 1.0)
            reach = np.abs(ux * points[:, 0] + uy * points[:, 1])
            edges = [half] if layout.margin == 0.0 else [half, half - layout.margin]
            away.append(np.min([np.abs(reach - edge) for edge in edges], axis=0))
            normals.append(sign[:, None] * np.array([ux, uy]))
    for gap, normal in _outline(body, xy):
        sign = np.where((normal * direction[:, :2]).sum(axis=1) < 0.0, -1.0, 1.0)
        away.append(gap)
        normals.append(sign[:, None] * normal)
    nearest = np.argmin(np.array(away), axis=0)
    return np.asarray(np.array(normals)[nearest, np.arange(len(xy))])


def _outline(body: BodyPlan, xy: Floats) -> list[tuple[Floats, Floats]]:
    """Distance from each side of the outline, and its outward normal."""
    shape, half_x, half_y = body.outline
    if shape == "none":
        return []
    if body.plate is not None:
        return [nearest_edges(body.plate.edges, xy)]
    point = xy - np.asarray(body.centre)
    if shape == "circle":
        radius = np.maximum(np.hypot(point[:, 0], point[:, 1]), 1e-300)
        return [(np.abs(radius - half_x), point / radius[:, None])]
    axes = np.eye(2)
    return [
        (np.abs(np.abs(point[:, i]) - half), np.broadcast_to(axes[i], point.shape))
        for i, half in ((0, half_x), (1, half_y))
    ]
