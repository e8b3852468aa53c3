"""Single precision, to show what it costs in accuracy: rays through exact surfaces, and facets as a file rounds them.

Nothing that judges a part uses this; it fills two kinds of rows of the table.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clacad.mesh import Mesh
from clacad.mesh.body import BodyMesh
from clacad.rays import NO_CELL, Fate, Rays, TraceResult
from clacad.sheet import Face, Window
from clacad.surface import Quadric

Floats = NDArray[np.float64]
Single = NDArray[np.float32]
BLOCK = 4096


def trace_single(window: Window, rays: Rays) -> TraceResult:
    """Trace rays through the lens faces of their telescopelets in float32, cell by cell in local coordinates.

    Only what a picture needs: light that stays within the lens faces (ALIVE, GHOST); everything else is MISSED.

    Raises
    ------
    ValueError
        A face is no quadric.
    """
    if not all(isinstance(face.surface, Quadric) for face in window.faces):
        raise ValueError("single precision is traced through quadrics only")
    parts = [_block(window, rays, slice(k, k + BLOCK)) for k in range(0, len(rays), BLOCK)]
    direction, fate, cell, order = (np.concatenate(column) for column in zip(*parts, strict=True))
    n = len(rays)
    return TraceResult(
        rays.position, direction, fate, np.zeros(n), cell, order, np.zeros(n, dtype=np.int32), np.ones(n)
    )


def _block(
    window: Window, rays: Rays, rows: slice
) -> tuple[Floats, NDArray[np.uint8], NDArray[np.int32], NDArray[np.int32]]:
    """One block of rays; positions are local to the cell before they are rounded."""
    given = rays.direction[rows]
    ray = (given / np.linalg.norm(given, axis=1, keepdims=True)).astype(np.float32)
    start = rays.position[rows]
    to_plane = (window.z_range[0] - start[:, 2]) / given[:, 2]
    at = start + to_plane[:, None] * given
    first, x, y = window.lattice.locate(at[:, 0], at[:, 1])
    place = np.stack([x, y, at[:, 2]], axis=1).astype(np.float32)
    index, before, crossed = first, np.float32(1.0), False
    for body in window.bodies:
        for face, after in ((body.front, np.float32(body.index)), (body.back, np.float32(1.0))):
            if face.array == 1 and not crossed:
                index, place = _next_cell(window, face, place, ray, first)
                crossed = True
            place, ray = _through(face, place, ray, before, after)
            before = after
    alive = np.isfinite(ray).all(axis=1) & window.lattice.contains(first) & window.lattice.contains(index)
    order = (index - first).astype(np.int32)
    fate = np.where(alive, np.where((order == 0).all(axis=1), Fate.ALIVE, Fate.GHOST), Fate.MISSED).astype(
        np.uint8
    )
    cell = np.where(alive[:, None], first, NO_CELL).astype(np.int32)
    return ray.astype(np.float64), fate, cell, np.where(alive[:, None], order, NO_CELL).astype(np.int32)


def _next_cell(window: Window, face: Face, place: Single, ray: Single, first: NDArray[np.int64]
               ) -> tuple[NDArray[np.int64], Single]:  # fmt: skip
    """Carry rays to the height of array 2 and say in which of its cells they are."""
    low = np.float32(face.vertex[2])
    moved = place + ((low - place[:, 2]) / ray[:, 2])[:, None] * ray
    sx, sy = window.shifts[1]
    centre = window.lattice.centres(np.zeros((1, 2), dtype=np.int64))[0]
    step, x, y = window.lattice.locate(
        moved[:, 0].astype(np.float64) - sx + centre[0], moved[:, 1].astype(np.float64) - sy + centre[1]
    )
    local = np.stack([x, y, moved[:, 2]], axis=1).astype(np.float32)
    return first + step, local


def _through(
    face: Face, place: Single, ray: Single, before: np.float32, after: np.float32
) -> tuple[Single, Single]:
    surface = face.surface
    assert isinstance(surface, Quadric)
    turn = face.rotation.astype(np.float32)
    local = (place - np.array(face.vertex, dtype=np.float32)) @ turn
    d = ray @ turn
    cx, cy, kappa, s = (
        np.float32(v) for v in (surface.curvature_x, surface.curvature_y, surface.kappa, surface.side)
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        base = local - (local[:, 2] / d[:, 2])[:, None] * d
        x, y = base[:, 0], base[:, 1]
        a = cx * d[:, 0] ** 2 + cy * d[:, 1] ** 2 + kappa * d[:, 2] ** 2
        b = cx * x * d[:, 0] + cy * y * d[:, 1] - s * d[:, 2]
        c = cx * x * x + cy * y * y
        root = np.sqrt(b * b - a * c)
        hit = base + (c / (s * root - b))[:, None] * d
        g = np.stack([-s * cx * hit[:, 0], -s * cy * hit[:, 1], 1 - s * kappa * hit[:, 2]], axis=1)
        mu = before / after
        q = np.sqrt((g * g).sum(axis=1) * ((after - before) * (after + before) / after**2) + (mu * root) ** 2)
        out = mu * d + ((after - before) * (after + before) / after**2 / (q + mu * root))[:, None] * g
    return hit @ turn.T + np.array(face.vertex, dtype=np.float32), out @ turn.T


def rounded(mesh: Mesh, cell: tuple[int, int], scale: float) -> Mesh:
    """Round the vertices of a mesh to float32 as a file does that keeps sheet coordinates, seen from one cell.

    Parameters
    ----------
    mesh : Mesh
    cell : (i, j)
        Rounding depends on where in the sheet a cell lies.
    scale : float
        File units per design unit; rounding happens in the file's unit.
    """
    return replace(mesh, bodies=tuple(_rounded_body(mesh.window, body, cell, scale) for body in mesh.bodies))


def _rounded_body(window: Window, body: BodyMesh, cell: tuple[int, int], scale: float) -> BodyMesh:
    tiled = []
    for one in body.tiled:
        tile = one.maker.tile
        centre = window.lattice.centres(np.array(cell))[None] + np.asarray(one.shift)
        xy = _single((tile.plan.xy + centre) * scale) / scale - centre
        step = tile.step
        lens = np.rint(_single(tile.lens * (step * scale)) / (step * scale)).astype(np.int64)
        far = np.abs(tile.lens) > 2**59
        made = replace(tile, plan=replace(tile.plan, xy=xy), lens=np.where(far, tile.lens, lens))
        maker = copy(one.maker)  # only its tile is read by a trace; the templates stay those of the mesh
        maker.tile = made
        tiled.append(replace(one, maker=maker))
    return replace(body, tiled=tuple(tiled))


def _single(values: NDArray[np.floating]) -> Floats:
    return values.astype(np.float32).astype(np.float64)
