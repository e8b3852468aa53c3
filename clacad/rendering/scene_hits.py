"""Objects that rays meet in the scene and their light, in numpy. `clacad.rendering.compiled.scene_hits` is
its twin.

All distances are in lengths of the given direction, which need not be a unit vector.
"""

from __future__ import annotations

import numpy as np

from clacad.base.types import Bools, Floats, Ints
from clacad.base.vectors import doubled_normals
from clacad.rendering import scene_arrays as slot
from clacad.rendering.scene_arrays import SceneArrays
from clacad.tracing.facets.hierarchy import nearest_triangle

UNTURNED = np.eye(3)


def look(
    stage: SceneArrays, origin: Floats, direction: Floats, limit: Floats | float = np.inf
) -> tuple[Floats, Bools]:
    """Light that rays find, looking from `origin` along `direction`.

    origin, direction : (n, 3) arrays, scene frame
    limit : (n,) or float. Objects count at distances above 0 and below this.

    Returns
    -------
    light : (n, 3)
        Linear rgb; of sky or ground where nothing was met.
    met : (n,) bool
        Whether an object was met.
    """
    distance, which, triangle = nearest(stage, origin, direction, limit)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        light = background(stage, direction)
        for k in np.unique(which[which >= 0]):
            rows = np.flatnonzero(which == k)
            light[rows] = _painted(
                stage, int(k), origin[rows], direction[rows], distance[rows], triangle[rows]
            )
    return light, which >= 0


def nearest(
    stage: SceneArrays, origin: Floats, direction: Floats, limit: Floats | float
) -> tuple[Floats, Ints, Ints]:
    """Distance (n,), primitive (n,) and triangle (n,) of the first hit; −1 where there is none."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return _nearest(stage, origin, direction, limit)


def _nearest(
    stage: SceneArrays, origin: Floats, direction: Floats, limit: Floats | float
) -> tuple[Floats, Ints, Ints]:
    """As `nearest`, with the warnings of divisions."""
    distance = np.full(len(origin), limit) if np.isscalar(limit) else np.array(limit, dtype=np.float64)
    which = np.full(len(origin), -1, dtype=np.int64)
    triangle = np.full(len(origin), -1, dtype=np.int64)
    for (first, end), box in zip(stage.cluster, stage.cluster_box, strict=True):
        near = np.flatnonzero(may_cross(box, origin, direction))
        for k in range(first, end) if len(near) else ():
            rows = near[may_cross(stage.box[k], origin[near], direction[near])]
            if not len(rows):
                continue
            local, ray = origin[rows] - stage.origin[k], direction[rows]
            if (stage.rotation[k] != UNTURNED).any():
                local, ray = local @ stage.rotation[k], ray @ stage.rotation[k]
            if stage.kind[k] == slot.MESH:
                t, facet = nearest_triangle(stage.forest, int(stage.piece[k, 0]), local, ray, distance[rows])
                triangle[rows[facet >= 0]] = facet[facet >= 0]
                closer = facet >= 0
            else:
                t = _distance(stage, k, local, ray)
                closer = (t > 0.0) & (t < distance[rows])
            distance[rows[closer]], which[rows[closer]] = t[closer], k
    return distance, which, triangle


def may_cross(box: Floats, position: Floats, direction: Floats) -> Bools:
    """Which rays (n,) pass through a box (low, high)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (box[0] - position) / direction, (box[1] - position) / direction
        near = np.fmax.reduce(np.fmin(a, b), axis=1)
        far = np.fmin.reduce(np.fmax(a, b), axis=1)
    return np.asarray((near <= far * (1.0 + 1e-12)) & (far > 0.0))


def _distance(stage: SceneArrays, k: int, local: Floats, ray: Floats) -> Floats:
    """Distance (n,) to a primitive in its own frame; NaN or ∞ where it is missed."""
    kind, (a, b, c, _) = stage.kind[k], stage.size[k]
    if kind == slot.FLOOR:
        t = -local[:, 1] / ray[:, 1]
        return np.where(t * np.linalg.norm(ray, axis=1) <= a, t, np.nan)
    if kind == slot.SPHERE:
        return _sphere(local, ray, a)
    if kind == slot.BOX:
        return _box(local, ray, np.array([a, b, c]))
    if kind == slot.CONE:
        return _cone(local, ray, a, b, c)
    if kind == slot.PRISM:
        first, end = stage.piece[k]
        return _prism(local, ray, a, stage.outline[first:end])
    t = -local[:, 2] / ray[:, 2]
    x, y = local[:, 0] + t * ray[:, 0], local[:, 1] + t * ray[:, 1]
    return np.where((np.abs(x) <= a) & (np.abs(y) <= b), t, np.nan)


def _first(near: Floats, far: Floats) -> Floats:
    """The nearer of two distances that is above 0."""
    return np.where(near > 0.0, near, far)


def _sphere(local: Floats, ray: Floats, radius: float) -> Floats:
    """Nearer hit above 0; the ray is first carried to its point nearest the centre, for accuracy."""
    a = np.einsum("ij,ij->i", ray, ray)
    middle = -np.einsum("ij,ij->i", local, ray) / a
    near = local + middle[:, None] * ray
    half = np.sqrt((radius * radius - np.einsum("ij,ij->i", near, near)) / a)
    return _first(middle - half, middle + half)


def _box(local: Floats, ray: Floats, half: Floats) -> Floats:
    p, q = (-half - local) / ray, (half - local) / ray
    near, far = np.fmax.reduce(np.fmin(p, q), axis=1), np.fmin.reduce(np.fmax(p, q), axis=1)
    # a ray along a side's plane but outside it: 0/0 is left out above, so the coordinate decides
    beside = ((ray == 0.0) & (np.abs(local) > half)).any(axis=1)
    return np.where((near <= far) & ~beside, _first(near, far), np.nan)


def _cone(local: Floats, ray: Floats, bottom: float, top: float, height: float) -> Floats:
    """Frustum with axis y from 0 to `height`, closed: nearest of mantle and two caps above 0."""
    k = (top - bottom) / height
    middle = -np.einsum("ij,ij->i", local, ray) / np.einsum("ij,ij->i", ray, ray)
    x, y, z = (local + middle[:, None] * ray).T
    u, v, w = ray.T
    r = bottom + k * y
    a, b, c = u * u + w * w - k * k * v * v, x * u + z * w - k * v * r, x * x + z * z - r * r
    root = np.sqrt(b * b - a * c)
    q = -(b + np.copysign(root, b))
    best = np.full(len(local), np.inf)
    for t in (q / a, c / q):
        at = y + t * v
        good = (t + middle > 0.0) & (at >= 0.0) & (at <= height) & (bottom + k * at >= 0.0)
        best = np.where(good & (t + middle < best), t + middle, best)
    for level, radius in ((0.0, bottom), (height, top)):
        t = (level - y) / v
        px, pz = x + t * u, z + t * w
        good = (t + middle > 0.0) & (px * px + pz * pz <= radius * radius)
        best = np.where(good & (t + middle < best), t + middle, best)
    return best


def _prism(local: Floats, ray: Floats, half: float, outline: Floats) -> Floats:
    """Outline in x, y, between z = −half and half: nearest of two caps and all sides above 0."""
    best = np.full(len(local), np.inf)
    for level in (-half, half):
        t = (level - local[:, 2]) / ray[:, 2]
        x, y = local[:, 0] + t * ray[:, 0], local[:, 1] + t * ray[:, 1]
        best = np.where((t > 0.0) & (t < best) & _inside(outline, x, y), t, best)
    for (x0, y0), (x1, y1) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        nx, ny = y1 - y0, x0 - x1
        t = (nx * (x0 - local[:, 0]) + ny * (y0 - local[:, 1])) / (nx * ray[:, 0] + ny * ray[:, 1])
        x, y, z = (local + t[:, None] * ray).T
        along = (x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)
        good = (t > 0.0) & (t < best) & (along >= 0.0) & (along <= nx * nx + ny * ny) & (np.abs(z) <= half)
        best = np.where(good, t, best)
    return best


def _inside(outline: Floats, x: Floats, y: Floats) -> Bools:
    """Whether points lie inside a polygon, by counting borders to the right."""
    inside = np.zeros(len(x), dtype=bool)
    for (x0, y0), (x1, y1) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        crosses = (y0 > y) != (y1 > y)
        inside ^= crosses & (x < (x1 - x0) * (y - y0) / (y1 - y0 if y1 != y0 else 1.0) + x0)
    return inside


# -- light -------------------------------------------------------------------------------------
def background(stage: SceneArrays, direction: Floats) -> Floats:
    """Light (n, 3) of the sky, linear in elevation, or of the ground below the horizon."""
    down = (direction[:, 1] < 0.0)[:, None]
    if (stage.sky[0] == stage.sky[1]).all():
        return np.where(down, stage.ground, stage.sky[1])
    elevation = np.arctan2(direction[:, 1], np.hypot(direction[:, 0], direction[:, 2])) / (0.5 * np.pi)
    share = np.clip(elevation, 0.0, 1.0)[:, None]
    sky = stage.sky[1] + (stage.sky[0] - stage.sky[1]) * share
    return np.where(down, stage.ground, sky)


def _painted(
    stage: SceneArrays, k: int, origin: Floats, direction: Floats, distance: Floats, triangle: Ints
) -> Floats:
    """Light (n, 3) of primitive k where rays meet it."""
    turn = stage.rotation[k]
    local = (origin - stage.origin[k]) @ turn + distance[:, None] * (direction @ turn)
    paint, (first, second) = stage.paint[k], stage.colours[k]
    if paint == slot.COORDINATES:
        share = local[:, :2] / (2.0 * stage.size[k, :2]) + 0.5
        return np.column_stack([share, np.ones(len(local))])
    if paint == slot.IMAGE:
        return _sampled(stage, k, local)
    colour = np.broadcast_to(first, (len(local), 3))
    if paint == slot.CHECKER:
        side = stage.pattern[k]
        odd = (np.floor(local[:, 0] / side) + np.floor(local[:, 2] / side)) % 2.0 == 1.0
        colour = np.where(odd[:, None], first, second)
    elif paint == slot.STRIPES:
        period = stage.pattern[k]
        colour = np.where((np.floor(2.0 * local[:, 0] / period) % 2.0 == 0.0)[:, None], first, second)
    if stage.key == 0.0:
        return colour * stage.ambient
    normal = _normal(stage, k, local, triangle) @ turn.T
    away = np.einsum("ij,ij->i", normal, direction) > 0.0
    normal = np.where(away[:, None], -normal, normal)
    shade = stage.ambient + stage.key * np.maximum(0.0, normal @ stage.towards_light)
    return np.asarray(colour * shade[:, None])


def _normal(stage: SceneArrays, k: int, local: Floats, triangle: Ints) -> Floats:
    """Unit normals (n, 3) in the primitive's frame, of either sign."""
    kind, (a, b, c, _) = stage.kind[k], stage.size[k]
    normal = np.zeros_like(local)
    if kind == slot.FLOOR:
        normal[:, 1] = 1.0
    elif kind == slot.SPHERE:
        normal = local / a
    elif kind == slot.BOX:
        side = np.argmax(np.abs(local) / np.array([a, b, c]), axis=1)
        normal[np.arange(len(local)), side] = 1.0
    elif kind == slot.CONE:
        slope, radius = (b - a) / c, np.hypot(local[:, 0], local[:, 2])
        off = np.abs(radius - (a + slope * local[:, 1]))
        flat = np.minimum(np.abs(local[:, 1]), np.abs(local[:, 1] - c)) < off
        mantle = np.column_stack([local[:, 0], -slope * radius, local[:, 2]])
        normal = np.where(flat[:, None], (0.0, 1.0, 0.0), mantle)
    elif kind == slot.PRISM:
        first, end = stage.piece[k]
        normal = _prism_normal(local, a, stage.outline[first:end])
    elif kind == slot.MESH:
        corner = stage.forest.corner[triangle]
        normal = doubled_normals(corner)
    else:
        normal[:, 2] = 1.0
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def _prism_normal(local: Floats, half: float, outline: Floats) -> Floats:
    """Normal of the nearest side or cap."""
    best = half - np.abs(local[:, 2])
    normal = np.tile([0.0, 0.0, 1.0], (len(local), 1))
    for (x0, y0), (x1, y1) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        nx, ny = y1 - y0, x0 - x1
        length = np.hypot(nx, ny)
        share = ((local[:, 0] - x0) * (x1 - x0) + (local[:, 1] - y0) * (y1 - y0)) / (length * length)
        share = np.clip(share, 0.0, 1.0)
        off = np.hypot(local[:, 0] - x0 - share * (x1 - x0), local[:, 1] - y0 - share * (y1 - y0))
        closer = off < best
        best = np.where(closer, off, best)
        normal[closer] = (nx / length, ny / length, 0.0)
    return normal


def _sampled(stage: SceneArrays, k: int, local: Floats) -> Floats:
    """Bilinear light of a picture; its right edge is at −x, where a viewer before the screen sees it."""
    height, width = stage.picture[k]
    x = np.clip((0.5 - local[:, 0] / (2.0 * stage.size[k, 0])) * width - 0.5, 0.0, width - 1.0)
    y = np.clip((0.5 - local[:, 1] / (2.0 * stage.size[k, 1])) * height - 0.5, 0.0, height - 1.0)
    i, j = (
        np.minimum(x.astype(np.int64), max(width - 2, 0)),
        np.minimum(y.astype(np.int64), max(height - 2, 0)),
    )
    u, v = (x - i)[:, None], (y - j)[:, None]
    right, down = int(width > 1), int(height > 1) * width
    at = stage.piece[k, 0] + j * width + i
    pixels = stage.pixels
    upper = pixels[at] * (1.0 - u) + pixels[at + right] * u
    lower = pixels[at + down] * (1.0 - u) + pixels[at + down + right] * u
    return np.asarray(upper * (1.0 - v) + lower * v)


__all__ = ["background", "look", "nearest"]
