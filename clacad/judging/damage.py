"""Damage to a part: drilled holes, engraved steps, dents, with their position and size.

A hole in a closed mesh has walls. Walls of the design lie only on the borders of its cells and around its
rim; walls elsewhere are damage. Connected walls are one feature.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.text import count_text
from clacad.base.types import Floats, Ints
from clacad.base.units import millimetres
from clacad.base.vectors import doubled_normals
from clacad.formats.mesh.file_mesh import FileMesh
from clacad.judging.cell_triangles import levels, owner
from clacad.judging.face_deviation import STEEP, WIDE, believed, distance_to_faces, drawn_in
from clacad.sheet.lattice import Circle
from clacad.sheet.plate import Plate
from clacad.sheet.plate_edges import nearest_edges
from clacad.sheet.volume_and_extent import body_extent
from clacad.sheet.window import Body, Window

MICRON = 1e-6

OFF_BORDER = 5e-3
"""Distance in pitches from every border and rim of the design beyond which a wall is not one of its walls."""

ROUND = 0.03
"""Rms of a wall's corners from a circle, over its radius, up to which it is round."""

TURNS = 0.75
"""Least part of the full circle that a drilled wall covers."""

THROUGH = 0.9
"""Least height of a through wall, over the height of the material."""

FEWEST = 4
"""Least number of facets of a wall; noise makes smaller groups."""

SHOWN = 64


@dataclass(frozen=True, eq=False)
class DamageFeature:
    """A feature of a part that the design does not have.

    kind : "hole", "blind hole", "opening" or "step"
        Drilled through, drilled but not through, cut through in another shape, engraved or raised.
    centre : (2,) lengths. Sheet frame.
    size : (2,) lengths. Size of its bounding box; for a round feature the diameter twice.
    depth : length. Depth of its walls along the sheet's normal.
    cells : tuple of (i, j). Cells that lose material, numbered as in the window.
    """

    kind: str
    body: str
    centre: tuple[float, float]
    size: tuple[float, float]
    depth: float
    cells: tuple[tuple[int, int], ...]

    def words(self, unit: str, unit_m: float) -> str:
        """Text of the feature, in design units and mm."""
        number = _both(unit, unit_m)
        at = f"({number(self.centre[0])}, {number(self.centre[1])})"
        if self.kind in ("hole", "blind hole"):
            what = f"a {self.kind} of diameter {number(self.size[0])} at {at} in {self.body}"
            what += "" if self.kind == "hole" else f", {number(self.depth)} deep"
        elif self.kind == "opening":
            what = (
                f"an opening of {number(self.size[0])} x {number(self.size[1])} at {at} through {self.body}"
            )
        else:
            what = (
                f"a step of {number(self.depth)} over {number(self.size[0])} x {number(self.size[1])} at {at}"
                f" in {self.body}"
            )
        if not self.cells:
            return f"{what}, next to the cells"
        some = ", ".join(str(c) for c in self.cells[:6]) + (" …" if len(self.cells) > 6 else "")
        return f"{what}, in {count_text(len(self.cells), 'cell', 'd')}: {some}"

    def to_dict(self, unit_m: float) -> dict[str, Any]:
        """JSON-ready numbers; lengths in mm."""
        mm = millimetres(unit_m)
        return {
            "kind": self.kind,
            "body": self.body,
            "x_mm": self.centre[0] * mm,
            "y_mm": self.centre[1] * mm,
            "size_mm": [v * mm for v in self.size],
            "depth_mm": self.depth * mm,
            "diameter_mm": self.size[0] * mm if self.kind in ("hole", "blind hole") else None,
            "cells": [list(c) for c in self.cells],
        }


def _both(unit: str, unit_m: float) -> Any:
    def number(value: float) -> str:
        own = f"{value:.4g} {unit}"
        return own if unit == "mm" else f"{own} ({value * millimetres(unit_m):.4g} mm)"

    return number


# -- holes and steps ------------------------------------------------------------------------------------
def find_features(
    window: Window,
    mesh: FileMesh,
    factor: float = 1.0,
    present: Sequence[str] | None = None,
    noise: float = 0.0,
) -> list[DamageFeature]:
    """Find holes and steps of a part that lies in the design's frame.

    window : Window with the cells that the part holds.
    mesh : Mesh registered by `clacad.judging.registration.place`.
    factor : Design units per unit of the mesh.
    present : names of the bodies it holds, or None for all
    noise : length. Scatter of the corners.
    Returns list of DamageFeature, the largest first.
    """
    walls = [_made_walls(window, chunk * factor, noise) for chunk in mesh.chunks()]
    corners = np.concatenate([w for w in walls if len(w)] or [np.empty((0, 3, 3))])
    if not len(corners):
        return []
    held = [k for k, body in enumerate(window.bodies) if present is None or body.name in present]
    number = np.full(len(corners), held[0])
    if len(held) > 1:
        number = np.searchsorted(levels(window)[2], corners[..., 2].mean(axis=1))
    found = []
    for k in held:
        mine = corners[number == k]
        parts = _connected(mine, 1e-6 * min(window.lattice.pitch))
        features = [_feature(window, window.bodies[k], mine[part], noise) for part in parts]
        found += [feature for feature in features if feature is not None]
    return sorted(found, key=lambda f: -max(f.size))


def _made_walls(window: Window, corners: Floats, noise: float) -> Floats:
    """Steep facets (k, 3, 3) where the design has no wall: inside its rim, off the borders of cells."""
    normal = doubled_normals(corners)
    length = np.linalg.norm(normal, axis=1)
    steep = np.asarray(corners[(np.abs(normal[:, 2]) < STEEP * length) & (length > 0.0)])
    if not len(steep):
        return steep
    steep = steep[believed(steep, noise)]
    room = OFF_BORDER * min(window.lattice.pitch) + WIDE * noise
    between = levels(window)[2]
    body = np.searchsorted(between, steep[..., 2].mean(axis=1))
    keep = np.zeros(len(steep), dtype=bool)
    for number, piece in enumerate(window.bodies):
        rows = np.flatnonzero(body == number)
        if len(rows):
            points = steep[rows][..., :2].reshape(-1, 2)
            off = _off_walls(window, piece, points, room)
            keep[rows] = off.reshape(-1, 3).any(axis=1)
    return np.asarray(steep[keep])


def _off_walls(window: Window, body: Body, points: Floats, room: float) -> NDArray[np.bool_]:
    """Points (n, 2) farther than `room` inside the rim of a body and from the borders of its kept cells."""
    x0, x1, y0, y1 = body_extent(window, body)
    if isinstance(window.outline, Circle):
        middle = np.array([0.5 * (x0 + x1), 0.5 * (y0 + y1)])
        inside: NDArray[np.bool_] = (
            np.hypot(*(points - middle).T) < 0.5 * window.outline.diameter * (1.0 - 1e-3) - room
        )
    elif isinstance(window.outline, Plate):
        size = max(x1 - x0, y1 - y0)
        deep = nearest_edges(window.outline.edges, points)[0] > 1e-3 * size + room
        inside = window.outline.inside(points) & deep
    else:
        above, below = points > np.array([x0, y0]) + room, points < np.array([x1, y1]) - room
        inside = np.asarray(above.all(axis=1) & below.all(axis=1))
    lattice = window.lattice
    for face in (body.front, body.back):
        array = owner(body, face)
        own = window.lattice_of(array)
        cell, x, y = window.locate(array, points[:, 0], points[:, 1])
        near = np.zeros(len(points), dtype=bool)
        seam = 0.5 * window.land.seam
        for (di, dj), half in zip(own.steps, own.half_widths, strict=False):
            ox, oy = own.offset(di, dj)
            from_border = half - np.abs(x * ox + y * oy) / (2.0 * half)
            near |= (from_border < room) | (np.abs(from_border - seam) < room)
        beside = ~lattice.contains(cell)
        ours = np.zeros(len(points), dtype=bool)  # outside the cells, only borders next to a kept cell count
        for step in [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)]:
            ours |= lattice.contains(cell + np.asarray(step))
        on_cells = near & (~beside | ours)
        if window.outline is None:
            inside &= ~beside
        inside &= ~on_cells
    return np.asarray(inside)


def _connected(corners: Floats, room: float) -> list[Ints]:
    """Facets (k, 3, 3) connected by corners, to `room`, as lists of their rows."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not len(corners):
        return []
    _, index = np.unique(
        np.round(corners.reshape(-1, 3) / (4.0 * room)).astype(np.int64), axis=0, return_inverse=True
    )
    index = index.reshape(-1, 3)
    size = int(index.max()) + 1
    ends = np.concatenate([index[:, [0, 1]], index[:, [1, 2]]])
    links = coo_array((np.ones(len(ends), dtype=np.int8), (ends[:, 0], ends[:, 1])), shape=(size, size))
    _, label = connected_components(links, directed=False)
    mine = label[index[:, 0]]
    order = np.argsort(mine, kind="stable")
    return list(np.split(order, np.flatnonzero(np.diff(mine[order])) + 1))


def _feature(window: Window, body: Body, corners: Floats, noise: float) -> DamageFeature | None:
    """Feature of a connected wall (k, 3, 3); None where it is too small to be one."""
    points = corners.reshape(-1, 3)
    low, high = points.min(axis=0), points.max(axis=0)
    size = high[:2] - low[:2]
    depth = float(high[2] - low[2])
    least = OFF_BORDER * min(window.lattice.pitch) + WIDE * noise
    if max(float(size.max()), depth) < least or len(corners) < FEWEST:
        return None
    through = depth > THROUGH * _thickness(window, body, points)
    circle = _circle(corners)
    if circle is not None:
        x, y, radius = circle
        kind = "hole" if through else "blind hole"
        cells = _cells_under(window, body, (x, y), (radius, radius), True)
        return DamageFeature(kind, body.name, (x, y), (2.0 * radius, 2.0 * radius), depth, cells)
    centre = 0.5 * (low[:2] + high[:2])
    cells = _cells_under(window, body, (centre[0], centre[1]), (0.5 * size[0], 0.5 * size[1]), False)
    return DamageFeature(
        "opening" if through else "step",
        body.name,
        (float(centre[0]), float(centre[1])),
        (float(size[0]), float(size[1])),
        depth,
        cells,
    )


def _thickness(window: Window, body: Body, points: Floats) -> float:
    """Median height (length) of a body's material at points (n, 3); infinite where it has none."""
    heights = []
    for way in (-1.0, 1.0):
        facing = np.broadcast_to([0.0, 0.0, way], points.shape)
        off = distance_to_faces(replace(window, bodies=(body,)), points, facing, [body.name])
        with np.errstate(invalid="ignore"):
            heights.append(points[:, 2] - off.distance / off.normal[:, 2])
    thick = heights[1] - heights[0]
    known = np.isfinite(thick)
    return float(np.median(thick[known])) if known.any() else np.inf


def _circle(corners: Floats) -> tuple[float, float, float] | None:
    """Centre and radius of an upright round wall whose normals point to its axis (a hole), or None."""
    points = corners[..., :2].reshape(-1, 2)
    about = points.mean(axis=0)
    x, y = (points - about).T
    found, *_ = np.linalg.lstsq(np.column_stack([2 * x, 2 * y, np.ones_like(x)]), x * x + y * y, rcond=None)
    square = found[2] + found[0] ** 2 + found[1] ** 2
    if not np.isfinite(square) or square <= 0.0:
        return None
    radius = float(np.sqrt(square))
    centre = about + found[:2]
    off = np.hypot(*(points - centre).T) - radius
    if np.sqrt(np.mean(off**2)) > ROUND * radius:
        return None
    normal = doubled_normals(corners)
    middle = corners.mean(axis=1)[:, :2] - centre
    if float((normal[:, :2] * middle).sum()) > 0.0:  # a post, not a hole
        return None
    angle = np.sort(np.arctan2(points[:, 1] - centre[1], points[:, 0] - centre[0]))
    gap = float(np.max(np.diff(np.concatenate([angle, [angle[0] + 2.0 * np.pi]]))))
    return (float(centre[0]), float(centre[1]), radius) if gap < 2.0 * np.pi * (1.0 - TURNS) else None


def _cells_under(
    window: Window, body: Body, centre: Sequence[float], half: Sequence[float], round_: bool
) -> tuple[tuple[int, int], ...]:
    """Cells of the body's arrays that overlap a disc or a box."""
    lattice = window.lattice
    fine = [np.linspace(-1.0, 1.0, 4 * int(np.ceil(2.0 * h / min(lattice.pitch))) + 33) for h in half]
    u, v = (g.ravel() for g in np.meshgrid(*fine))
    keep = u * u + v * v <= 1.0 if round_ else np.ones(len(u), dtype=bool)
    x, y = centre[0] + u[keep] * half[0], centre[1] + v[keep] * half[1]
    found: set[tuple[int, int]] = set()
    for face in (body.front, body.back):
        cell, _, _ = window.locate(owner(body, face), x, y)
        cell = np.unique(cell[lattice.contains(cell)], axis=0)
        found |= {(int(i), int(j)) for i, j in cell}
    return tuple(sorted(found))


# -- dents ----------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Dent:
    """A place where a face deviates locally.

    cell : (i, j). Numbered as in the window.
    place : (2,) lengths. Sheet frame.
    depth : length. Along the face's normal; positive where material is missing.
    """

    face: str
    cell: tuple[int, int]
    place: tuple[float, float]
    depth: float

    def to_dict(self, unit_m: float) -> dict[str, Any]:
        """JSON-ready numbers: position in mm, depth in µm."""
        mm = millimetres(unit_m)
        return {
            "face": self.face,
            "cell": list(self.cell),
            "x_mm": self.place[0] * mm,
            "y_mm": self.place[1] * mm,
            "depth_um": self.depth * unit_m / MICRON,
        }

    def words(self, unit_m: float) -> str:
        """Text of the dent."""
        told = self.to_dict(unit_m)
        kind = "too low" if self.depth > 0.0 else "too high"
        return (
            f"{self.face} is {abs(told['depth_um']):.4g} µm {kind} at x {told['x_mm']:.4g}, y"
            f" {told['y_mm']:.4g} mm, cell {self.cell}"
        )


def find_dents(
    window: Window,
    mesh: FileMesh,
    factor: float,
    present: Sequence[str],
    damaged: Sequence[tuple[int, tuple[int, int]]],
    noise: float = 0.0,
) -> list[Dent]:
    """Find the deepest point of each damaged face of a cell, in one more pass.

    damaged : sequence of (number of the face in the order of the light, cell)
        From `clacad.judging.deviation_map.DeviationMap.damaged`.
    noise : length. Scatter of single corners.
    Returns list of Dent, the deepest first.
    """
    asked = set(damaged)
    between = levels(window)
    deepest: dict[tuple[int, tuple[int, int]], tuple[float, float, float]] = {}
    for chunk in mesh.chunks():
        corners = chunk * factor
        normal = doubled_normals(corners)
        length = np.linalg.norm(normal, axis=1)
        good = (np.abs(normal[:, 2]) > STEEP * length) & believed(corners, noise)
        corners, normal = corners[good], normal[good] / length[good, None]
        inward = (corners.mean(axis=1, keepdims=True) - corners).reshape(-1, 3)
        facing, points = np.repeat(normal, 3, axis=0), corners.reshape(-1, 3)
        off = distance_to_faces(window, points, facing, present, between, drawn_in(window, inward, noise))
        value = off.distance * np.where(facing[:, 2] > 0.0, -1.0, 1.0)
        for face, cell in asked:
            rows = np.flatnonzero((off.face == face) & (off.cell == cell).all(axis=1) & off.known)
            if len(rows):
                row = rows[int(np.argmax(np.abs(value[rows])))]
                told = (float(value[row]), float(points[row, 0]), float(points[row, 1]))
                if abs(told[0]) > abs(deepest.get((face, cell), (0.0,))[0]):
                    deepest[face, cell] = told
    names = [f"{body.name} {side}" for body in window.bodies for side in ("front", "back")]
    found = [Dent(names[face], cell, told[1:], told[0]) for (face, cell), told in deepest.items()]
    return sorted(found, key=lambda d: -abs(d.depth))[:SHOWN]
