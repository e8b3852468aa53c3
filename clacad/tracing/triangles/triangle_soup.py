"""Triangles from any source, known only by their corners: read, and assigned to bodies.

A file of a part that a shop delivered contains no cells, faces or bodies. Triangles are joined where they
share a corner to the last bit. Each connected piece belongs to the body of the window whose heights it lies
nearest.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Ints
from clacad.sheet.window import Window
from clacad.tracing.layout import BodyPlan, Layout, lay_out
from clacad.tracing.triangles.hierarchy import hierarchy
from clacad.tracing.triangles.squares import Triangles, find_squares
from clacad.tracing.triangles.tiles import Normals

UNITS = (1.0, 1000.0, 0.001, 25.4, 1.0 / 25.4)
MATCH = 0.02
"""Share by which the extents of a file without a unit may differ from the window's."""


class UnusableMesh(ValueError):
    """A mesh that light cannot be traced through as requested, or that does not belong to this sheet; exit
    status 2.
    """

    exit_status = 2


@dataclass(frozen=True, eq=False)
class TriangleSoup:
    """Triangles of all bodies, sheet frame, window units.

    Parameters
    ----------
    corners : (t, 3, 3) lengths
        Counter-clockwise seen from outside.
    normals : (t, 3, 3) or None
        Unit outward normals at the corners, where the file has them.
    """

    corners: Floats
    normals: Floats | None = None


def read_soup(path: str | os.PathLike[str], window: Window) -> TriangleSoup:
    """Read a mesh file (STL, 3MF, PLY, OBJ, GLB) in the window's units.

    Parameters
    ----------
    path : path
    window : Window

    Raises
    ------
    ValueError
        The file states no unit and its size fits the window in none, or in more than one.
    """
    # readers are in the room of the formats' writers; the tracer needs them only when it is given a path
    from clacad.formats.mesh.readers import read_mesh

    return soup_of(read_mesh(path), window)


def soup_of(found: Any, window: Window) -> TriangleSoup:
    """Triangles of a `FileMesh`, every placement expanded, in the window's units."""
    if not found.expandable:
        raise UnusableMesh(f"the mesh represents {found.facet_count} triangles: too many to hold them all")
    corners, normals = [], []
    for part in found.parts:
        own = part.corners(0, part.facet_count)
        of_corners = part.corner_normals(0, part.facet_count)
        for place in part.placements:
            corners.append(own @ place[:3] + place[3])
            if of_corners is not None:
                turned = of_corners @ np.linalg.inv(place[:3]).T
                normals.append(turned / np.linalg.norm(turned, axis=2, keepdims=True))
    both = np.concatenate(corners) if corners else np.empty((0, 3, 3))
    factor = found.unit / window.unit if found.unit is not None else _factor(both, window)
    whole = len(normals) == len(corners) and normals
    return TriangleSoup(both * factor, np.concatenate(normals) if whole else None)


def _factor(corners: Floats, window: Window) -> float:
    """Window units per file unit, by size."""
    x0, x1, y0, y1 = window.lattice.extent()
    if window.outline is not None:
        boxes = [body.box for body in lay_out(window).bodies]
        x0, x1 = min(b[0] for b in boxes), max(b[1] for b in boxes)
        y0, y1 = min(b[2] for b in boxes), max(b[3] for b in boxes)
    elif len(window.bodies) > 1:
        dx, dy = np.subtract(window.shifts[1], window.shifts[0])  # a field lens lies between
        x0, x1, y0, y1 = min(x0, x0 + dx), max(x1, x1 + dx), min(y0, y0 + dy), max(y1, y1 + dy)
    size = np.ptp(corners.reshape(-1, 3), axis=0)[:2]
    wanted = np.array([x1 - x0, y1 - y0])
    fits = [f for f in UNITS if (np.abs(size * f / wanted - 1.0) < MATCH).all()]
    if len(fits) != 1:
        raise UnusableMesh(
            f"the mesh is {size[0]:.6g} by {size[1]:.6g} and states no unit; the window is "
            f"{wanted[0]:.6g} by {wanted[1]:.6g}: no unit fits"
        )
    return fits[0]


def lay_out_soup(window: Window, soup: TriangleSoup, normals: Normals) -> tuple[Layout, Triangles]:
    """Prepare a window and triangles from any source for tracing.

    Raises
    ------
    ValueError
        A body of the window has no triangles, or vertex normals are requested for a file without them.
    """
    if normals == "vertex" and soup.normals is None:
        raise UnusableMesh('normals = "vertex", but the mesh has none; they are never estimated')
    exact = lay_out(window)
    owner = _owners(exact, soup.corners)
    bodies = [np.flatnonzero(owner == b) for b in range(len(exact.bodies))]
    for mine, body in zip(bodies, window.bodies, strict=True):
        if len(mine) == 0:
            raise UnusableMesh(f"no triangles of the mesh belong to {body.name!r}")
    rank, trees = hierarchy([soup.corners[mine] for mine in bodies])
    if normals == "vertex":
        trees = trees._replace(corner_normal=_upward(soup, np.concatenate(bodies)[rank]))
    plans = tuple(_bounded(plan, soup.corners[mine]) for plan, mine in zip(exact.bodies, bodies, strict=True))
    return replace(exact, bodies=plans), Triangles(trees, find_squares(trees))


def _upward(soup: TriangleSoup, which: Ints) -> Floats:
    assert soup.normals is not None
    return np.ascontiguousarray(soup.normals[which])


def _bounded(plan: BodyPlan, corners: Floats) -> BodyPlan:
    """Body with the triangles' heights as its bounds."""
    low, high = float(corners[..., 2].min()) - plan.level, float(corners[..., 2].max()) - plan.level
    pad = 1e-9 * (plan.box[1] - plan.box[0])
    return replace(plan, low=low - pad, high=high + pad)


def _owners(layout: Layout, corners: Floats) -> NDArray[np.int64]:
    """Body (t,) of each triangle: that of its connected piece, by the piece's middle height."""
    if len(layout.bodies) == 1 or len(corners) == 0:
        return np.zeros(len(corners), dtype=np.int64)
    piece = _pieces(corners)
    low = np.full(int(piece.max()) + 1, np.inf)
    high = -low
    np.minimum.at(low, piece, corners[..., 2].min(axis=1))
    np.maximum.at(high, piece, corners[..., 2].max(axis=1))
    middles = np.array([b.level + 0.5 * (b.low + b.high) for b in layout.bodies])
    nearest = np.abs(0.5 * (low + high)[:, None] - middles).argmin(axis=1)
    return np.asarray(nearest[piece])


def _pieces(corners: Floats) -> Ints:
    """Number the connected pieces: triangles are joined where they share a corner exactly."""
    points = corners.reshape(-1, 3)
    order = np.lexsort(points.T)
    in_order = points[order]
    vertex = np.zeros(len(points), dtype=np.int64)
    vertex[order[1:]] = np.cumsum((in_order[1:] != in_order[:-1]).any(axis=1))
    triangles = vertex.reshape(-1, 3)
    label = np.arange(int(triangles.max()) + 1)
    while True:  # labels fall to the least of their piece; pointers halve the way at every round
        least = label[triangles].min(axis=1)
        new = label.copy()
        np.minimum.at(new, triangles.ravel(), np.repeat(least, 3))
        new = new[new]
        if np.array_equal(new, label):
            break
        label = new
    _, piece = np.unique(label[triangles[:, 0]], return_inverse=True)
    return np.asarray(piece.ravel(), dtype=np.int64)
