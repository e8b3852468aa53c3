"""One ray, one face: intersection and refraction in the lens frame, heights, the rules of a column.

At a wall, which one: a border of a cell or of an optical zone, or the outline, and its normal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clacad.base.types import Bools, Floats
from clacad.base.vectors import to_sheet, to_surface
from clacad.optics.surface import Quadric, Surface, gradient, meet_at, refract
from clacad.sheet.cell_places import LensPlaces
from clacad.sheet.face_order import lined_array
from clacad.sheet.plate_edges import nearest_edges
from clacad.sheet.window import IDENTITY, Face, heights_of_lenses
from clacad.tracing.layout import BodyPlan, FacePlan, Layout


@dataclass(frozen=True, slots=True, eq=False)
class Hit:
    """Where m rays cross a lens face, cell frame.

    local : (m, 2), z : (m,) lengths
    distance : (m,) length. NaN where the ray misses the lens.
    direction : (m, 3). After refraction; NaN at total internal reflection.
    upright : (m,) bool. The surface is visible from straight above or below there: it is part of the face.
    """

    local: Floats
    z: Floats
    distance: Floats
    direction: Floats
    upright: Bools


def cross(
    face: FacePlan, local: Floats, z: Floats, direction: Floats, n1: float, n2: float, places: LensPlaces
) -> Hit:
    """Intersect a lens face from its −z side and refract; m rays, `local` (m, 2) and `z` (m,) over the body's
    level.

    places : here and below. Position of each ray's lens, see `clacad.tracing.layout.lenses`.
    """
    turn = places.axes(face.rotation)
    ray = to_surface(turn, direction)
    surface = places.shape(face.surface)
    met, point = meet_at(surface, to_surface(turn, _start(places, local, z)), ray)
    out, _ = refract(ray, met.gradient, met.root, n1, n2)
    upright = np.isfinite(met.distance)
    if turn is not None:
        with np.errstate(invalid="ignore"):
            upright &= to_sheet(turn, met.gradient)[:, 2] > 0.0
    return _hit(places, to_sheet(turn, point), met.distance, to_sheet(turn, out), upright)


def cross_at(
    face: FacePlan,
    local: Floats,
    z: Floats,
    direction: Floats,
    distance: Floats,
    n1: float,
    n2: float,
    places: LensPlaces,
) -> Hit:
    """Refract at crossings (m,) that were already found, and polish them.

    `meet` returns the other crossing where a ray falls in the lens's frame while it rises in the sheet's.
    """
    turn = places.axes(face.rotation)
    start, ray = to_surface(turn, _start(places, local, z)), to_surface(turn, direction)
    if places.size is not None:
        distance = distance / places.size
    surface = places.shape(face.surface)
    for _ in range(2):
        point = start + distance[:, None] * ray
        normal, over = _upward(surface, point)
        distance = distance - over / (ray * normal).sum(axis=1)
    point = start + distance[:, None] * ray
    normal, _ = _upward(surface, point)
    root = (ray * normal).sum(axis=1)
    out, _ = refract(ray, normal, root, n1, n2)
    return _hit(places, to_sheet(turn, point), distance, to_sheet(turn, out), root > 0.0)


def _start(places: LensPlaces, local: Floats, z: Floats) -> Floats:
    """Points (m, 3), sheet axes, from the apexes of the rays' lenses, in lengths of the face's one lens."""
    vx, vy, vz = places.apex
    start = np.column_stack([local[:, 0] - vx, local[:, 1] - vy, z - vz])
    return start if places.size is None else start / places.size[:, None]


def _hit(places: LensPlaces, point: Floats, distance: Floats, direction: Floats, upright: Bools) -> Hit:
    """Hit in the cell frame from `point` (m, 3) and `distance` (m,) in lengths of the face's one lens."""
    if places.size is not None:
        point, distance = point * places.size[:, None], distance * places.size
    vx, vy, vz = places.apex
    local = np.column_stack([point[:, 0] + vx, point[:, 1] + vy])
    return Hit(local, point[:, 2] + vz, distance, direction, upright)


def _upward(surface: Surface, point: Floats) -> tuple[Floats, Floats]:
    """Normal G towards +z at points near a lens (lens frame), and heights over it, in units of 1/|G|."""
    x, y, z = point.T
    if not isinstance(surface, Quadric):
        normal = gradient(surface, x, y)
        return normal, (z - surface.sag(x, y)) * normal[:, 2]
    cx, cy, kappa, side = surface.curvature_x, surface.curvature_y, surface.kappa, surface.side
    normal = np.column_stack([-side * cx * x, -side * cy * y, 1.0 - side * kappa * z])
    return normal, -0.5 * side * (cx * x * x + cy * y * y + (kappa * z - 2.0 * side) * z)


def cross_land(direction: Floats, n1: float, n2: float) -> Floats:
    """Directions (m, 3) behind a plane parallel to the sheet; NaN at total internal reflection."""
    gradient = np.broadcast_to(np.array([0.0, 0.0, 1.0]), direction.shape)
    return refract(direction, gradient, direction[:, 2], n1, n2)[0]


def height(face: FacePlan, local: Floats, places: LensPlaces) -> Floats:
    """Height (m,) of the lens over the body's level above points (m, 2) of the cell frame; NaN for none."""
    if face.array is None:
        return np.full(len(local), face.vertex[2])
    lens = Face(face.surface, face.vertex, IDENTITY if face.rotation is None else face.rotation)
    return heights_of_lenses(lens, places, local[:, 0], local[:, 1])


def in_zone(layout: Layout, local: Floats, margin: float, array: int = 0) -> Bools:
    """Which points (m, 2) of the cell frame of an array lie at least `margin` inside their cell's borders."""
    inside = np.ones(len(local), dtype=bool)
    with np.errstate(invalid="ignore"):
        for (ux, uy), half in zip(layout.normals[array], layout.widths[array], strict=True):
            inside &= np.abs(ux * local[:, 0] + uy * local[:, 1]) <= half - margin
    return inside


def on_line(layout: Layout, xy: Floats) -> Bools:
    """Which sheet points (m, 2) of the face with the opaque line lie on the line around kept cells."""
    array = lined_array(layout.window)
    place = xy - np.asarray(layout.window.shifts[array])
    cell, *local = layout.lattices[array].locate(place[:, 0], place[:, 1])
    zone = in_zone(layout, np.stack(local, axis=1), 0.5 * layout.window.land.line, array)
    return np.asarray(layout.lattice.contains(cell) & ~zone)


def in_footprint(body: BodyPlan, xy: Floats, kept: Bools) -> Bools:
    """Which sheet points (m, 2) lie over the body, given which (m,) lie over a kept cell of its array."""
    shape, half_x, half_y = body.outline
    if shape == "none":
        return kept
    if body.plate is not None:
        return body.plate.inside(xy)
    x, y = xy[:, 0] - body.centre[0], xy[:, 1] - body.centre[1]
    if shape == "circle":
        return np.asarray(x * x + y * y <= half_x * half_x)
    return np.asarray((np.abs(x) <= half_x) & (np.abs(y) <= half_y))


def well_inside(body: BodyPlan, xy: Floats) -> Bools:
    """Which sheet points (m, 2) are certainly over the body: the region is convex, points between too."""
    x, y = (xy - np.asarray(body.centre)).T
    half_x, half_y, radius = body.inner
    inside = (np.abs(x) < half_x) & (np.abs(y) < half_y)
    return np.asarray(inside & (x * x + y * y < radius * radius) & (radius > 0.0))


def lens_roots(
    face: FacePlan, local: Floats, z: Floats, direction: Floats, places: LensPlaces
) -> tuple[Floats, Floats]:
    """Both distances (m,) at which rays cross the whole of a lens's surface; +inf where they do not.

    Roots only divide the ray into stretches; heights decide what each stretch is. A root of the half beyond
    the equator is therefore harmless.
    """
    turn = places.axes(face.rotation)
    p, d = to_surface(turn, _start(places, local, z)), to_surface(turn, direction)
    one, other = _roots_of_one(places.shape(face.surface), p, d)
    return (one, other) if places.size is None else (one * places.size, other * places.size)


def _roots_of_one(surface: Surface, p: Floats, d: Floats) -> tuple[Floats, Floats]:
    """Both distances of rays in the frame of an unscaled lens, points and directions (m, 3)."""
    if isinstance(surface, Quadric):
        kappa = surface.kappa
    else:  # Newton starts from the quadric of equal curvatures and mean κ
        kappa = 0.5 * (
            (1.0 + surface.conic_x) * surface.curvature_x + (1.0 + surface.conic_y) * surface.curvature_y
        )
    roots = _quadric_roots(surface, kappa, p, d)
    if isinstance(surface, Quadric):
        return roots
    with np.errstate(all="ignore"):
        met = meet_at(surface, p, d)[0].distance
        other = np.where(np.abs(roots[0] - met) < np.abs(roots[1] - met), roots[1], roots[0])
        for _ in range(8):
            other = other - _biconic_step(surface, p + other[:, None] * d, d)
    return _finite(met), _finite(other)


def _quadric_roots(surface: Surface, kappa: float, p: Floats, d: Floats) -> tuple[Floats, Floats]:
    cx, cy, side = surface.curvature_x, surface.curvature_y, float(surface.side)
    a = cx * d[:, 0] ** 2 + cy * d[:, 1] ** 2 + kappa * d[:, 2] ** 2
    b = cx * p[:, 0] * d[:, 0] + cy * p[:, 1] * d[:, 1] + (kappa * p[:, 2] - side) * d[:, 2]
    c = cx * p[:, 0] ** 2 + cy * p[:, 1] ** 2 + (kappa * p[:, 2] - 2.0 * side) * p[:, 2]
    with np.errstate(all="ignore"):
        q = -(b + np.copysign(np.sqrt(b * b - a * c), b))
        return _finite(c / q), _finite(q / a)


def _biconic_step(surface: Surface, point: Floats, d: Floats) -> Floats:
    """Newton step along the ray towards z = sag(x, y)."""
    sag = surface.sag(point[:, 0], point[:, 1])
    normal = surface.normal(point[:, 0], point[:, 1])
    return np.asarray((point[:, 2] - sag) * normal[:, 2] / (d * normal).sum(axis=1))


def _finite(t: Floats) -> Floats:
    return np.where(np.isfinite(t), t, np.inf)


NUDGE = 16 * 2.0**-52
"""Share of a cell by which a ray is moved beyond its wall: rounding must not leave it before."""


def wall_normals(
    layout: Layout, body: BodyPlan, direction: Floats, local: dict[int, Floats], xy: Floats
) -> Floats:
    """Horizontal unit normals (m, 2) of the walls that rays are at, on the side the rays go to.

    direction : (m, 3)
    local : one (m, 2) array for each of the body's arrays. The points, relative to the cells they are in.
    xy : (m, 2). The same points in the sheet frame.
    """
    away, normals = [], []
    for array, points in local.items():
        for (ux, uy), half in zip(layout.normals[array], layout.widths[array], strict=True):
            sign = np.where(ux * direction[:, 0] + uy * direction[:, 1] < 0.0, -1.0, 1.0)
            reach = np.abs(ux * points[:, 0] + uy * points[:, 1])
            edges = [half] if layout.margin == 0.0 else [half, half - layout.margin]
            away.append(np.min([np.abs(reach - edge) for edge in edges], axis=0))
            normals.append(sign[:, None] * np.array([ux, uy]))
    for gap, normal in _sides_of_outline(body, xy):
        sign = np.where((normal * direction[:, :2]).sum(axis=1) < 0.0, -1.0, 1.0)
        away.append(gap)
        normals.append(sign[:, None] * normal)
    nearest = np.argmin(np.array(away), axis=0)
    return np.asarray(np.array(normals)[nearest, np.arange(len(xy))])


def _sides_of_outline(body: BodyPlan, xy: Floats) -> list[tuple[Floats, Floats]]:
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


def lens_normals(face: FacePlan, local: Floats, z: Floats, places: LensPlaces) -> Floats:
    """Unit normals (m, 3), sheet axes, of a lens face at points of the cell frame; NaN beyond the equator.

    places : Position of each point's lens, see `clacad.tracing.layout.lenses`.
    """
    surface, turn = places.shape(face.surface), places.axes(face.rotation)
    x, y, _ = to_surface(turn, _start(places, local, z)).T
    return to_sheet(turn, surface.normal(x, y))
