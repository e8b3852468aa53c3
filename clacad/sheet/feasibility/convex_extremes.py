"""Least values, covered shares and half widths of a function over a convex cell.

The functions here are smooth and nearly convex on a lenslet. A sampled start followed by zooming
finds the least value to rounding error; corners and borders are always among the samples.

Features that matter to a process (grooves, walls, slopes, thin and tall features) are such values of the
faces.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from math import acos, asin, inf
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.arrays import distinct
from clacad.base.polygons import distance_to_rim, within
from clacad.base.types import Bools, Floats
from clacad.optics.surface import principal_radii
from clacad.sheet.window import Face, Window, lens_height_and_normal, optical_tile

if TYPE_CHECKING:
    from clacad.sheet.feasibility.derived_numbers import Feasibility

Heights = Callable[[Floats, Floats], Floats]
"""A function of cell-frame x and y, (n,) lengths each; NaN where it has no value."""
Inside = Callable[[Floats, Floats], Bools]
"""Which points (n,) belong to a region."""

BORDER_SAMPLES = 257
GRID = 25
NODES = 24


def border(polygon: Floats, number: int, samples: int = BORDER_SAMPLES) -> Floats:
    """Points (samples, 2), lengths, along edge `number` of a polygon, both corners included exactly."""
    start, end = polygon[number], polygon[(number + 1) % len(polygon)]
    t = np.linspace(0.0, 1.0, samples)[:, None]
    return np.asarray((1.0 - t) * start + t * end)


def outline(polygon: Floats, samples: int = BORDER_SAMPLES) -> Floats:
    """Points along all edges of a polygon (m, 2), (m samples, 2), lengths."""
    return np.concatenate([border(polygon, k, samples) for k in range(len(polygon))])


def least(function: Heights, polygon: Floats) -> tuple[float, tuple[float, float]]:
    """Least value of a function over a convex polygon, and its position.

    Returns −inf where the function has no value (NaN) at some sample: no bound can be given.
    """
    rim = outline(polygon, 65)
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    x, y = (g.ravel() for g in np.meshgrid(*(np.linspace(low[k], high[k], GRID) for k in (0, 1))))
    keep = within(polygon, x, y)
    points = np.concatenate([rim, np.column_stack([x[keep], y[keep]])])
    value = function(points[:, 0], points[:, 1])
    if np.isnan(value).any():
        at = points[np.isnan(value)][0]
        return -np.inf, (float(at[0]), float(at[1]))
    best = int(np.argmin(value))
    found = (float(value[best]), points[best])
    found = min(found, _zoom_inside(function, polygon, points[best], (high - low) / (GRID - 1)), key=_first)
    if best < len(rim):
        found = min(found, _zoom_along(function, polygon, best), key=_first)
    return found[0], (float(found[1][0]), float(found[1][1]))


def _first(pair: tuple[float, Floats]) -> float:
    return pair[0]


def _zoom_inside(function: Heights, polygon: Floats, at: Floats, size: Floats) -> tuple[float, Floats]:
    """Search ever smaller boxes around the best point so far."""
    found = (np.inf, at)
    steps = np.linspace(-1.0, 1.0, 9)
    for _ in range(8):  # to 1e-7 of the cell, where a smooth minimum is exact
        x, y = (g.ravel() for g in np.meshgrid(at[0] + size[0] * steps, at[1] + size[1] * steps))
        value = np.where(within(polygon, x, y), function(x, y), np.inf)
        best = int(np.nanargmin(value))
        if value[best] < found[0]:
            found = (float(value[best]), np.array([x[best], y[best]]))
            at = found[1]
        size = size / 4.0
    return found


def _zoom_along(function: Heights, polygon: Floats, sample: int) -> tuple[float, Floats]:
    """Search ever smaller pieces of the edge that contains rim sample number `sample` (65 per edge)."""
    edge, place = divmod(sample, 65)
    start, end = polygon[edge], polygon[(edge + 1) % len(polygon)]
    middle, size = place / 64.0, 1.0 / 64.0
    found = (np.inf, start)
    for _ in range(9):
        t = np.clip(middle + size * np.linspace(-1.0, 1.0, 9), 0.0, 1.0)[:, None]
        points = (1.0 - t) * start + t * end
        value = function(points[:, 0], points[:, 1])
        best = int(np.nanargmin(value))
        if value[best] < found[0]:
            found = (float(value[best]), points[best])
            middle = float(t[best, 0])
        size /= 4.0
    return found


def reach(inside: Inside, directions: Floats, limit: float) -> Floats:
    """Distance from the origin to the end of a star-shaped region along unit directions (n, 2), (n,) lengths.

    Infinite where the region extends beyond `limit`; 0 if the origin is outside.
    """
    ends = _end(inside, np.zeros((1, 2)), directions, np.full(len(directions), limit))
    beyond = inside(directions[:, 0] * limit, directions[:, 1] * limit)
    return np.asarray(np.where(beyond, np.inf, ends))


def _end(inside: Inside, start: Floats, direction: Floats, outside: Floats) -> Floats:
    """Last inner point along rays from inner points `start`, whose points at `outside` are outside, (n,)."""
    low, width = np.zeros_like(outside), outside
    fraction = np.arange(1, 16) / 16.0
    for _ in range(13):  # each round cuts the interval in sixteen: 52 bits
        distance = low[:, None] + width[:, None] * fraction
        points = start[:, None] + distance[..., None] * direction[:, None]
        good = inside(points[..., 0].ravel(), points[..., 1].ravel()).reshape(distance.shape)
        first_bad = np.where(good.all(axis=1), 15, good.argmin(axis=1))
        width = width / 16.0
        low = low + width * first_bad
    return low + 0.5 * width


def share_covered(inside: Inside, polygon: Floats, pole: Floats) -> float:
    """Share of a convex polygon's area that belongs to a region star-shaped about `pole`.

    Polar area integral, ½∫r² dφ, by Gauss–Legendre between the angles where its integrand has a kink:
    the corners, and the points where the region's rim crosses an edge (found by bisection). 1 exactly
    if no part of the polygon lies outside; 0 if the pole does.
    """
    if not inside(pole[:1], pole[1:])[0]:
        return 0.0
    kinks = _kinks(inside, polygon)
    angles = np.arctan2(kinks[:, 1] - pole[1], kinks[:, 0] - pole[0])
    angles = distinct(np.concatenate([angles, [-np.pi, np.pi]]))
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    middle, half = 0.5 * (angles[1:] + angles[:-1]), 0.5 * np.diff(angles)
    phi = (middle[:, None] + half[:, None] * nodes).ravel()
    weight = (half[:, None] * weights).ravel()
    direction = np.column_stack([np.cos(phi), np.sin(phi)])
    to_edge = distance_to_rim(polygon, pole, direction)
    just_inside = pole + (to_edge * (1.0 - 1e-13))[:, None] * direction
    reaches = inside(just_inside[:, 0], just_inside[:, 1])
    if reaches.all():
        return 1.0
    radius = to_edge.copy()
    starts = np.broadcast_to(pole, direction[~reaches].shape)
    radius[~reaches] = _end(inside, starts, direction[~reaches], to_edge[~reaches])
    return float((weight @ radius**2) / (weight @ to_edge**2))


def _kinks(inside: Inside, polygon: Floats) -> Floats:
    """Corners of the polygon and points of its edges where the region begins or ends, (k, 2)."""
    points = np.stack([border(polygon, k) for k in range(len(polygon))])
    good = inside(points[..., 0].ravel(), points[..., 1].ravel()).reshape(points.shape[:2])
    edge, k = np.nonzero(good[:, 1:] != good[:, :-1])
    if len(edge) == 0:
        return polygon
    into = good[edge, k]
    first, last = points[edge, k + ~into], points[edge, k + into]
    length = np.hypot(*(last - first).T)
    along = (last - first) / length[:, None]
    return np.concatenate([polygon, first + _end(inside, first, along, length)[:, None] * along])


FINE = 20
"""Least voxels across a lenslet to resolve it, and least layers in its height to avoid stairs."""


@dataclass(frozen=True, slots=True)
class Named:
    """A number and its description."""

    value: float
    what: str


def wall(window: Window, facts: Feasibility) -> Named:
    """Highest vertical wall on the optical sides (length): step between neighbours, or edge of a seam."""
    found = [Named(body.step, f"the step between neighbours of {body.name}") for body in facts.bodies]
    if window.land.seam > 0.0:
        found += [
            Named(_edge_of_seam(window, face), f"the edge of the seam on {name}")
            for name, face in _lens_faces(window)
            if face.land is not None
        ]
    return max(found, key=lambda n: n.value)


def groove(window: Window, radius: float) -> Named:
    """Greatest share of a cell's width that a tool of this nose radius (length) leaves rounded at the
    grooves.

    Where two faces meet in an inner corner of turning angle τ, the nose touches them r·tan(τ/2) before it.
    Between two spheres of radius R without a seam the share is r/R in the middle of a border and r/√(R² −
    p²/4) at its ends, where the slopes across it are steepest. A concave lens has no groove at its border,
    but a nose larger than its radius does not fit in at all: 1.
    """
    return max(
        (_rounded(window, name, face, radius) for name, face in _lens_faces(window)), key=lambda n: n.value
    )


def steepest(facts: Feasibility) -> Named:
    """Steepest slope of a lens face against the sheet (radians)."""
    lens = min(facts.lenses, key=lambda lens: lens.least_normal_z)
    return Named(acos(min(1.0, max(-1.0, lens.least_normal_z))), lens.name)


def draft(window: Window, facts: Feasibility, negligible: float) -> Named:
    """Least angle of any surface that must release to the sheet's normal (radians); 0 for a vertical wall.

    negligible : length. Walls lower than this do not count.
    """
    step = wall(window, facts)
    if step.value > negligible:
        return Named(0.0, step.what)
    lens = min(facts.lenses, key=lambda lens: lens.least_normal_z)
    return Named(asin(min(1.0, max(-1.0, lens.least_normal_z))), lens.name)


def narrowest(window: Window) -> Named:
    """Narrowest feature that must be resolved across the sheet (length), halved where two voxels must fit."""
    found = [Named(min(window.lattice.pitch) / FINE, f"a {FINE}th of the pitch")]
    if window.land.seam > 0.0:
        found.append(Named(0.5 * window.land.seam, "half of the seam"))
    if window.baffle is not None:
        found.append(Named(0.5 * window.baffle.wall, "half of the baffle's wall"))
    return min(found, key=lambda n: n.value)


def shallowest(facts: Feasibility) -> Named:
    """Layer height that shapes the flatter lens in the least number of layers (length)."""
    lens = min(facts.lenses, key=lambda lens: lens.sag)
    return Named(lens.sag / FINE, f"a {FINE}th of the height of {lens.name}")


def tallest(window: Window, facts: Feasibility) -> Named:
    """Greatest height over width of a lens, a seam or a baffle's wall."""
    found = [
        Named(lens.sag / min(window.lattice.pitch), f"{lens.name} over the pitch") for lens in facts.lenses
    ]
    if window.land.seam > 0.0:
        deepest = max(
            (_edge_of_seam(window, f) for _, f in _lens_faces(window) if f.land is not None), default=0.0
        )
        found.append(Named(deepest / window.land.seam, "the depth of the seam over its width"))
    if window.baffle is not None and len(facts.bodies) > 1:
        height = max(above.low - below.high for below, above in pairwise(facts.bodies))
        found.append(Named(height / window.baffle.wall, "the baffle's height over its wall"))
    return max(found, key=lambda n: n.value)


def _lens_faces(window: Window) -> Iterator[tuple[str, Face]]:
    for body in window.bodies:
        for side, face in (("front", body.front), ("back", body.back)):
            if face.array is not None:
                yield f"the {side} of {body.name}", face


def _edge_of_seam(window: Window, face: Face) -> float:
    """Height of the lens over its land along the border of its zone."""
    assert face.land is not None
    tile = optical_tile(window)
    rim = np.concatenate([border(tile, k, 65) for k in range(len(tile))])
    z, _ = lens_height_and_normal(face, *rim.T)
    proud = face.land_side * (face.land - z)
    return float(np.nanmax(np.where(proud > 0.0, proud, 0.0)))


def _rounded(window: Window, name: str, face: Face, radius: float) -> Named:
    """Greatest share of a cell's width that a tool's nose leaves rounded on one face; see `groove`."""
    concave = [abs(r) for r in principal_radii(face.surface) if r < 0.0]
    if concave and min(concave) < radius:
        return Named(1.0, f"{name}, whose hollows are smaller than the tool")
    tile, worst = optical_tile(window), 0.0
    seam = window.land.seam > 0.0
    for number, step in enumerate(window.lattice.steps[: len(window.lattice.steps) // 2]):
        here = border(tile, number, 65)
        offset = np.asarray(window.lattice.offset(*step))
        outward, width = offset / np.linalg.norm(offset), float(np.linalg.norm(offset))
        # the neighbour is identical: its side of the border is the opposite side of this cell
        across = here - outward * 2.0 * (here @ outward)[:, None]
        angles = [_falling(face, here, outward), _falling(face, across, -outward)]
        if seam:
            lost = sum(np.tan(0.5 * np.maximum(a, 0.0)) * np.cos(a) for a in angles)
        else:
            turning = np.maximum(angles[0] + angles[1], 0.0)
            lost = np.tan(0.5 * turning) * (np.cos(angles[0]) + np.cos(angles[1]))
        worst = max(worst, radius * float(np.nanmax(lost, initial=0.0)) / width)
    return Named(min(1.0, worst), name) if worst < inf else Named(1.0, name)


def _falling(face: Face, points: Floats, outward: Floats) -> Floats:
    """Angle (n,) by which a face falls back into its material towards its border."""
    _, normal = lens_height_and_normal(face, *points.T)
    rise = -(normal[:, :2] @ outward) / normal[:, 2]
    return np.asarray(np.arctan(face.side * rise))
