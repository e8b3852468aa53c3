"""Polygons in the plane: areas, inside tests, distances to the rim, intersections of convex ones.

Lengths of any unit. A polygon is an array (m, 2) of its corners; convex ones run counter-clockwise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from clacad.base.types import Bools, Floats, Ints


def polygon_area(points: Floats) -> float:
    """Signed area of a polygon (m, 2), length²; counter-clockwise is positive."""
    return 0.0 if len(points) < 3 else float(polygon_areas(points[None])[0])


def polygon_areas(points: Floats) -> Floats:
    """Signed areas (k,), length², of polygons (k, m, 2) with equal numbers of corners."""
    x, y = np.moveaxis(
        points - points[:, :1], -1, 0
    )  # shoelace about a corner: no cancellation far from the origin
    return np.asarray(0.5 * np.sum(x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y, axis=1))


def doubled_areas(xy: Floats, triangles: Ints) -> Floats:
    """Twice the signed area of each triangle, (m,)."""
    a, b, c = xy[triangles[:, 0]], xy[triangles[:, 1]], xy[triangles[:, 2]]
    ab, ac = b - a, c - a
    return np.asarray(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])


def within(polygon: Floats, x: Floats, y: Floats, open_rim: bool = False) -> Bools:
    """Which points (...), given by x and y, lie in a convex counter-clockwise polygon (m, 2).

    open_rim : whether points on the rim are outside
    """
    inside = np.ones(np.shape(x), dtype=np.bool_)
    for start, end in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        left = (end[0] - start[0]) * (y - start[1]) - (end[1] - start[1]) * (x - start[0])
        inside &= left > 0.0 if open_rim else left >= 0.0
    return inside


def distance_to_rim(polygon: Floats, start: Floats, direction: Floats) -> Floats:
    """Distances (n,) from an inner point to the rim of a convex polygon along unit directions (n, 2)."""
    reach = np.full(len(direction), np.inf)
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        normal = np.array([b[1] - a[1], a[0] - b[0]])  # outward
        towards = direction @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.where(towards > 0.0, ((a - start) @ normal) / towards, np.inf)
        reach = np.fmin(reach, distance)
    return reach


def clip(subject: Floats, window: Floats) -> Floats:
    """Clip a convex polygon (m, 2), lengths, by another, both counter-clockwise (Sutherland and Hodgman)."""
    for start, end in zip(window, np.roll(window, -1, axis=0), strict=True):
        if len(subject) == 0:
            break
        edge = end - start
        inside = edge[0] * (subject[:, 1] - start[1]) - edge[1] * (subject[:, 0] - start[0])
        following, ahead = np.roll(subject, -1, axis=0), np.roll(inside, -1)
        kept = []
        for here, there, a, b in zip(subject, following, inside, ahead, strict=True):
            if a >= 0.0:
                kept.append(here)
            if (a < 0.0) != (b < 0.0):
                kept.append(here + (there - here) * (a / (a - b)))
        subject = np.array(kept) if kept else np.empty((0, 2))
    return subject


def common_areas(polygon: Floats, places: Floats, window: Floats) -> Floats:
    """Areas (k,) of a convex polygon (m, 2), or (k, m, 2), moved to (k, 2), cut with another; length².

    Vectorised `clip` with identical bits: rows with fewer corners than others are padded.
    """
    corners = polygon + places[:, None]
    count = np.full(len(places), polygon.shape[-2])
    for start, end in zip(window, np.roll(window, -1, axis=0), strict=True):
        slots = np.arange(corners.shape[1])
        follower = np.where(slots + 1 < count[:, None], slots + 1, 0)
        there = np.take_along_axis(corners, follower[..., None], axis=1)
        edge = end - start
        a = edge[0] * (corners[..., 1] - start[1]) - edge[1] * (corners[..., 0] - start[0])
        b = np.take_along_axis(a, follower, axis=1)
        real = slots < count[:, None]
        crossed = real & ((a < 0.0) != (b < 0.0))
        part = np.divide(a, a - b, out=np.zeros_like(a), where=crossed)
        made = np.stack([corners, corners + (there - corners) * part[..., None]], axis=2)
        kept = np.stack([real & (a >= 0.0), crossed], axis=2).reshape(len(places), 2 * len(slots))
        count = kept.sum(axis=1)
        order = np.argsort(~kept, axis=1, kind="stable")[:, : count.max(initial=0)]
        corners = np.take_along_axis(made.reshape(len(places), -1, 2), order[..., None], axis=1)
    areas = np.zeros(len(places))
    for n in sorted(set(count[count > 2].tolist())):
        here = count == n
        areas[here] = polygon_areas(corners[here, :n])
    return areas
