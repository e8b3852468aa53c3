"""Rays against the lens patches of a STEP file's text, for files too large for a CAD kernel. Lengths in mm.

Newton's method on rational Bézier patches. The patches are used as written in the text. Their trims are not
read here, so callers must decide from the position of a hit.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats
from clacad.base.units import millimetres
from clacad.formats.placements import applied
from clacad.formats.step.occ_rays import RayPaths, media_of
from clacad.formats.step.text_health import Scan, casteljau, patches_of
from clacad.optics.surface import refract
from clacad.sheet.window import Face, Window

ROUNDS = 30
CLOSE = 1e-11
"""Step of Newton's method, in parameters, below which a hit is found."""
EDGE = 1e-9
"""Parameters by which a hit may lie outside the patch."""


@dataclass(frozen=True, eq=False)
class PlacedPatch:
    """One lens patch at its placement.

    control : (m, n, 4) homogeneous, mm
    sense : −1 if it faces against du × dv
    middle : (2,) mm
        x and y in the middle of its parameters; the patch belongs to the cell that contains this point.
    """

    control: Floats
    sense: float
    middle: Floats


@dataclass(frozen=True, eq=False)
class Cells:
    """Cell of an array that a point lies over: a patch may extend beyond the cell of its lens.

    window : Window
    array : 0 or 1
    """

    window: Window
    array: int

    def of(self, place: Floats) -> NDArray[np.int64]:
        """Cells (n, 2) of points (n, 2), mm."""
        at = place / millimetres(self.window.unit)
        return self.window.locate(self.array, at[:, 0], at[:, 1])[0]


def column_patches(scan: Scan, low: Floats, high: Floats) -> list[PlacedPatch]:
    """Patches of all instances whose poles reach into a column low … high (2,) of x and y."""
    found = []
    for group in patches_of(scan):
        for poles, weights, sense, part in zip(
            group.poles, group.weights, group.sense, group.part, strict=True
        ):
            flat = poles.reshape(-1, 3)
            where = scan.parts[part].placements
            box = np.array([flat.min(axis=0), flat.max(axis=0)])
            middle, reach = box.mean(axis=0), 0.5 * float(np.linalg.norm(np.ptp(box, axis=0)))
            near = where.at(where.near(low - reach - middle[:2], high + reach - middle[:2]))
            at = applied(near, middle[None])[:, 0, :2]
            for placement in near[((at > low - reach) & (at < high + reach)).all(axis=1)]:
                placed = applied(placement, flat).reshape(poles.shape)
                over = placed.reshape(-1, 3)[:, :2]
                if (over.max(axis=0) < low).any() or (over.min(axis=0) > high).any():
                    continue
                control = np.concatenate([placed * weights[..., None], weights[..., None]], axis=-1)
                half = np.array([0.5])
                middle = _surface(control, half, half)[0][0, :2]
                found.append(PlacedPatch(control, float(sense), middle))
    return found


def first_hits(
    patches: Sequence[PlacedPatch], cells: Cells, position: Floats, direction: Floats, entering: bool
) -> tuple[Floats, Floats]:
    """Distances (n,) to the first patch that faces against the light (entering) or along it, NaN for none.

    Returned with unit normals (n, 3) in the direction of the light. A patch counts only over its own cell.
    """
    best, normal = np.full(len(position), np.inf), np.zeros_like(position)
    for patch in patches:
        away, outward = _meet(patch, position, direction)
        facing = np.einsum("ij,ij->i", outward, direction)
        with np.errstate(invalid="ignore"):
            closer = (away < best) & (facing < 0.0 if entering else facing > 0.0) & (away > 0.0)
        rows = np.flatnonzero(closer)
        place = position[rows, :2] + away[rows, None] * direction[rows, :2]
        rows = rows[(cells.of(place) == cells.of(patch.middle[None])).all(axis=1)]
        best[rows] = away[rows]
        normal[rows] = outward[rows] * (-1.0 if entering else 1.0)
    return np.where(np.isfinite(best), best, np.nan), normal


def plane_hits(face: Face, scale: float, position: Floats, direction: Floats) -> tuple[Floats, Floats]:
    """Distances and normals as of `first_hits` for a plane face, which is no lens: it is taken from the
    design.
    """
    away = (face.vertex[2] * scale - position[:, 2]) / direction[:, 2]
    return np.where(away > 0.0, away, np.nan), np.broadcast_to([0.0, 0.0, 1.0], direction.shape)


def _meet(patch: PlacedPatch, position: Floats, direction: Floats) -> tuple[Floats, Floats]:
    """Distance (n,) along rays, NaN where the patch is not met, and outward unit normal (n, 3)."""
    helper = np.where(np.abs(direction[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    one = np.cross(direction, helper)
    one /= np.linalg.norm(one, axis=1, keepdims=True)
    two = np.cross(direction, one)
    u, v = np.full(len(position), 0.5), np.full(len(position), 0.5)
    step = np.full(len(position), np.inf)
    with np.errstate(all="ignore"):
        for _ in range(ROUNDS):
            place, du, dv = _surface(patch.control, u, v)
            away = place - position
            f, g = np.einsum("ij,ij->i", away, one), np.einsum("ij,ij->i", away, two)
            fu, fv = np.einsum("ij,ij->i", du, one), np.einsum("ij,ij->i", dv, one)
            gu, gv = np.einsum("ij,ij->i", du, two), np.einsum("ij,ij->i", dv, two)
            det = fu * gv - fv * gu
            su, sv = (f * gv - fv * g) / det, (fu * g - f * gu) / det
            u, v = np.clip(u - su, -0.5, 1.5), np.clip(v - sv, -0.5, 1.5)
            step = np.maximum(np.abs(su), np.abs(sv))
            if not (step > CLOSE).any():
                break
        place, du, dv = _surface(patch.control, u, v)
        normal = patch.sense * np.cross(du, dv)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        met = (step <= CLOSE) & (np.abs(u - 0.5) <= 0.5 + EDGE) & (np.abs(v - 0.5) <= 0.5 + EDGE)
        distance = np.einsum("ij,ij->i", place - position, direction)
    return np.where(met, distance, np.nan), normal


def _surface(control: Floats, u: Floats, v: Floats) -> tuple[Floats, Floats, Floats]:
    """Points and tangents (n, 3) at parameters (n,)."""
    u, v = u[:, None], v[:, None]
    rows, rows_u = casteljau(np.broadcast_to(control[:, :, None], (*control.shape[:2], len(u), 4)), u)
    place, place_v = casteljau(rows, v)
    place_u, _ = casteljau(rows_u, v)
    w = place[:, 3:]
    point = place[:, :3] / w
    return point, (place_u[:, :3] - point * place_u[:, 3:]) / w, (place_v[:, :3] - point * place_v[:, 3:]) / w


def follow_patches(
    path: str | os.PathLike[str],
    position: Any,
    direction: Any,
    indices: Sequence[float],
    low: Sequence[float],
    high: Sequence[float],
    window: Window,
    faces: Sequence[int],
) -> dict[str, Any]:
    """Trace rays through the lens patches of a file's text.

    Parameters
    ----------
    path, position, direction, indices, low, high
        As in `clacad.formats.step.occ_rays.follow_rays`.
    window, faces
        Faces (numbers) of a window in the order in which light meets them.

    Returns
    -------
    dict of lists : as of `clacad.formats.step.occ_rays.follow_rays`; `curved` is true everywhere
    """
    patches = _kept(path, tuple(low), tuple(high))
    paths, media = RayPaths.begun(position, direction, len(faces)), media_of(indices)
    place, way = paths.position, paths.direction
    live = np.arange(len(place))
    for step, number in enumerate(faces):
        face = window.faces[number]
        if face.array is None:
            distance, normal = plane_hits(face, millimetres(window.unit), place[live], way[live])
        else:
            cells = Cells(window, face.array)
            distance, normal = first_hits(patches, cells, place[live], way[live], step % 2 == 0)
        met = np.isfinite(distance)
        paths.end[live[~met]] = 1
        live, distance, normal = live[met], distance[met], normal[met]
        place[live] += distance[:, None] * way[live]
        paths.hits[live, step], paths.crossings[live] = place[live], step + 1
        root = np.einsum("ij,ij->i", normal, way[live])
        bent, _ = refract(way[live], normal, root, media[step], media[step + 1])
        out = np.isfinite(bent).all(axis=1)
        paths.end[live[~out]] = 3
        live = live[out]
        way[live] = bent[out]
    return paths.to_lists(np.ones((len(place), len(faces)), dtype=bool))


_COLUMNS: dict[tuple[object, ...], list[PlacedPatch]] = {}


def _kept(path: str | os.PathLike[str], low: tuple[float, ...], high: tuple[float, ...]) -> list[PlacedPatch]:
    """The patches of a column; kept for the next call in this process."""
    from clacad.formats.step.read_back import scanned

    state = os.stat(path)
    key = (os.fspath(path), state.st_size, state.st_mtime_ns, low, high)
    if key not in _COLUMNS:
        _COLUMNS.clear()
        _COLUMNS[key] = column_patches(scanned(path), np.array(low), np.array(high))
    return _COLUMNS[key]
