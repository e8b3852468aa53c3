"""Foreign triangles searched by Embree, for light that goes straight through; the rest is left to the own tree.

Embree works in single precision. It is asked only which triangle a ray meets; the hit is worked out in double
precision on that triangle, and a ray that passes an edge within the rounding of a float32, meets a wall, flat land
or another lenslet's face of one lens, or does not come out, is handed back to be traced by `compiled_hierarchy`. Needs
the package embreex (extra `pictures`).
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

from clacad.base.types import Bools, Floats, Ints
from clacad.optics.rays import NO_CELL, Fate, Rays, TraceResult
from clacad.optics.surface import refract
from clacad.sheet.window import Window
from clacad.tracing.layout import Layout
from clacad.tracing.triangles.tiles import Tiles

DOUBTFUL = 16.0
"""Float32 spacings at the scene's size within which a hit's place is not trusted to Embree."""

STEEP, LEVEL = 0.05, 1e-5
"""Slopes of walls and of what may be land, as in `compiled_hierarchy`."""


def available() -> bool:
    """Whether embreex is installed."""
    return find_spec("embreex") is not None


@dataclass(frozen=True, eq=False)
class _Body:
    """Triangles of one body and Embree's index of them.

    corners : (t, 3, 3) about `origin`, normals : (t, 3) outward unit, altitude : (t, 3) of each corner
    """

    scene: Any
    corners: Floats
    normals: Floats
    altitude: Floats
    origin: Floats


def _indexed(corners: Floats) -> _Body:
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    origin = 0.5 * (corners.min(axis=(0, 1)) + corners.max(axis=(0, 1)))
    local = corners - origin
    scene = EmbreeScene()
    TriangleMesh(scene, local.astype(np.float32))
    cross = np.cross(local[:, 1] - local[:, 0], local[:, 2] - local[:, 0])
    double = np.linalg.norm(cross, axis=1)
    edges = np.linalg.norm(local[:, [2, 0, 1]] - local[:, [1, 2, 0]], axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        return _Body(scene, local, cross / double[:, None], double[:, None] / edges, origin)


def trace_straight(window: Window, layout: Layout, tiles: Tiles, rays: Rays) -> tuple[TraceResult, Bools]:
    """Trace what goes straight through every body by its lens faces.

    Parameters
    ----------
    window : Window
    layout, tiles
        As `triangle_soup.lay_out_soup` gives them, facet normals.
    rays : Rays
        Without wavelengths of their own.

    Returns
    -------
    result : TraceResult
        Valid in the rows that were decided: ALIVE or GHOST.
    decided : (n,) bool
        False: to be traced by the own tree.
    """
    n = len(rays)
    position = np.array(rays.position, dtype=np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        direction = rays.direction / np.linalg.norm(rays.direction, axis=1, keepdims=True)
    path = np.zeros(n)
    cells = np.full((2, n, 2), NO_CELL, dtype=np.int64)
    plans = layout.bodies
    bottom = min(plan.level + plan.low for plan in plans)
    decided = np.isfinite(position).all(axis=1) & np.isfinite(direction).all(axis=1)
    decided &= (position[:, 2] < bottom) & (direction[:, 2] > 0.0)
    before = 1.0
    for number, body in enumerate(window.bodies):
        first, count = (int(v) for v in tiles.tree[number, 1:3])
        index = _indexed(tiles.corner[first : first + count])
        for face, after in ((body.front, body.index), (body.back, 1.0)):
            live = np.flatnonzero(decided)
            distance, normal, good = _hit(index, position[live], direction[live], face is body.front)
            if face.array is not None and face.land is not None:  # level triangles may be land
                good &= normal[:, 0] ** 2 + normal[:, 1] ** 2 > (2.0 * LEVEL * normal[:, 2]) ** 2
            decided[live[~good]] = False
            live, distance, normal = live[good], distance[good], normal[good]
            position[live] += distance[:, None] * direction[live]
            path[live] += before * distance
            if face.array is not None:
                _placed(window, face.array, position[live], live, cells, decided)
            direction[live], _ = refract(
                direction[live], normal, np.einsum("ij,ij->i", normal, direction[live]), before, after
            )
            decided[live[~(direction[live, 2] > 0.0)]] = False  # reflected totally, or backward
            before = after
    return _result(window, position, direction, path, cells, n), decided


def _hit(index: _Body, position: Floats, direction: Floats, entering: bool) -> tuple[Floats, Floats, Bools]:
    """Distance (n,), unit normal towards where the light goes (n, 3), and whether both are beyond doubt."""
    start = position - index.origin
    reach = float(np.abs(index.corners).max()) + float(np.abs(start).max(initial=0.0))
    doubt = DOUBTFUL * float(np.spacing(np.float32(reach)))
    away = start + (0.0 if entering else 2.0 * doubt) * direction
    # unsigned: Embree names what is nearest ahead of a float32 start
    name = index.scene.run(away.astype(np.float32), direction.astype(np.float32))
    found = np.asarray(name).astype(np.int64)
    good = found >= 0
    chosen = np.where(good, found, 0)
    corner, normal = index.corners[chosen], index.normals[chosen]
    along = np.einsum("ij,ij->i", normal, direction)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.einsum("ij,ij->i", corner[:, 0] - start, normal) / along
        point = start + distance[:, None] * direction
        inside = _from_edges(corner, normal, point, index.altitude[chosen])
        good &= (inside > doubt) & (distance > 4.0 * doubt) & ((along > 0.0) != entering)
        good &= np.abs(normal[:, 2]) >= STEEP
    return distance, np.where((along < 0.0)[:, None], -normal, normal), good


def _from_edges(corner: Floats, normal: Floats, point: Floats, altitude: Floats) -> Floats:
    """Distance (n,) of points in their triangles' planes from the nearest edge, negative outside."""
    nearest = np.full(len(point), np.inf)
    for k in range(3):
        a, b = corner[:, (k + 1) % 3], corner[:, (k + 2) % 3]
        edge = b - a
        across = np.cross(normal, edge)
        length = np.linalg.norm(edge, axis=1)
        nearest = np.minimum(nearest, np.einsum("ij,ij->i", point - a, across) / length)
    return np.where(altitude.min(axis=1) > 0.0, nearest, -np.inf)


def _placed(window: Window, array: int, point: Floats, rows: Ints, cells: Ints, decided: Bools) -> None:
    """Note the cell of an array that rays met; one that met two of one array's is left to the own tree."""
    shift = np.asarray(window.shifts[array])
    cell, _, _ = window.lattice.locate(point[:, 0] - shift[0], point[:, 1] - shift[1])
    known = cells[array, rows, 0] != NO_CELL
    same = (cells[array, rows] == cell).all(axis=1)
    decided[rows[(known & ~same) | ~window.lattice.contains(cell)]] = False
    cells[array, rows] = cell


def _result(
    window: Window, position: Floats, direction: Floats, path: Floats, cells: Ints, n: int
) -> TraceResult:
    order = cells[1] - cells[0]
    fate = np.where((order == 0).all(axis=1), Fate.ALIVE, Fate.GHOST).astype(np.uint8)
    surface = np.full(n, 2 * len(window.bodies) - 1, dtype=np.int32)
    return TraceResult(
        position,
        direction,
        fate,
        path,
        cells[0].astype(np.int32),
        order.astype(np.int32),
        surface,
        np.ones(n),
    )
