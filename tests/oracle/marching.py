"""Rays through a window by brute force: small steps, bisection, textbook Snell.

Shares nothing with the tracer but the definition of the sheet: it reads from `clacad.sheet.window` how high the material is
over a point and marches. Only two things are known about a crossing: a face was met if the ray's height agrees
with the face's there, and anything else is a wall.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from clacad.sheet.lattice import Circle
from clacad.sheet.window import column, face_height, in_optical_tile, lens_height_and_normal


@dataclass
class Fate:
    """What became of one ray."""

    name: str
    direction: np.ndarray
    position: np.ndarray
    cells: list = field(default_factory=list)


def over_body(window, body, x, y):
    """Bottom and top of a body over sheet points (n,), NaN where there is none; and each face's (cell, local)."""
    places = {}
    for array in {body.front.array, body.back.array} - {None}:
        sx, sy = window.shifts[array]
        cell, lx, ly = window.lattice.locate(x - sx, y - sy)
        places[array] = (cell, lx, ly, window.lattice.contains(cell))
    main = body.front.array if body.front.array is not None else body.back.array
    if window.outline is None:
        inside = places[main][3]
    else:
        cx, cy = window.shifts[main] if len(places) == 1 else (0.0, 0.0)
        if isinstance(window.outline, Circle):
            inside = np.hypot(x - cx, y - cy) <= 0.5 * window.outline.diameter
        else:
            inside = (np.abs(x - cx) <= 0.5 * window.outline.width) & (
                np.abs(y - cy) <= 0.5 * window.outline.height
            )
    if body.columnar:
        _, lx, ly, kept = places[main]
        heights = [*column(window, body, lx, ly)]
        for i, face in enumerate((body.front, body.back)):
            heights[i] = np.where(kept, heights[i], np.nan if face.land is None else face.land)
    else:
        heights = []
        for face in (body.front, body.back):
            if face.array is None:
                heights.append(np.full(x.shape, face.vertex[2]))
                continue
            _, lx, ly, kept = places[face.array]
            land = np.nan if face.land is None else face.land
            heights.append(np.where(kept, face_height(window, face, lx, ly), land))
    bottom, top = (np.where(inside, h, np.nan) for h in heights)
    return bottom, top, places, inside


def solid(window, body, point):
    """Which points (n, 3) lie in the material."""
    bottom, top, _, _ = over_body(window, body, point[:, 0], point[:, 1])
    with np.errstate(invalid="ignore"):
        return (bottom <= point[:, 2]) & (point[:, 2] <= top)


def first_change(window, body, start, ray, state, step, until):
    """Distance at which one ray's state changes, or None before it has gone `until`."""
    chunk = 256
    begun = 0.0
    while begun < until:
        t = begun + step * np.arange(1, chunk + 1)
        hit = np.flatnonzero(solid(window, body, start + t[:, None] * ray) != state)
        hit = hit[t[hit] <= until + step]
        if len(hit):
            low, high = t[hit[0]] - step, t[hit[0]]
            for _ in range(60):
                middle = 0.5 * (low + high)
                if solid(window, body, (start + middle * ray)[None])[0] == state:
                    low = middle
                else:
                    high = middle
            return low, high
        begun = t[-1]
    return None


def snell(ray, normal, n1, n2):
    """Textbook vector form; None at total reflection."""
    if ray @ normal < 0:
        normal = -normal
    cosine = ray @ normal
    radicand = n2 * n2 - n1 * n1 * (1.0 - cosine * cosine)
    if radicand < 0:
        return None
    return (n1 * ray + (np.sqrt(radicand) - n1 * cosine) * normal) / n2


def face_normal(window, face, place):
    """("lens" or "land", unit normal, height) of a face over a point; the outermost of the two."""
    if face.array is None:
        return "lens", np.array([0.0, 0.0, 1.0]), face.vertex[2]
    _, lx, ly, kept = place
    z, normal = lens_height_and_normal(face, lx, ly)
    usable = bool(kept[0]) and np.isfinite(z[0])
    if window.land.seam > 0:
        usable &= bool(in_optical_tile(window, lx, ly)[0])
    if face.land is not None and (not usable or (z[0] - face.land) * face.side > 0):
        return "land", np.array([0.0, 0.0, 1.0]), face.land
    return "lens", normal[0], z[0]


def span(window, body):
    """Lowest and highest point of a body over one cell and its land."""
    tile = window.lattice.tile()
    low, high = tile.min(axis=0), tile.max(axis=0)
    x, y = (g.ravel() for g in np.meshgrid(*(np.linspace(a, b, 61) for a, b in zip(low, high))))
    heights = [face_height(window, face, x, y) for face in (body.front, body.back)]
    if body.columnar:
        heights = list(column(window, body, x, y))
    lands = [f.land for f in (body.front, body.back) if f.land is not None]
    values = np.concatenate([*heights, lands])
    return np.nanmin(values) - margin(window), np.nanmax(values) + margin(window)


def margin(window):
    """Height by which a march begins below and ends above a body."""
    return 0.02 * window.lattice.pitch[0]


def march(window, start, ray, step):
    """Follow one ray; see `Fate`."""
    launched = ray = ray / np.linalg.norm(ray)
    position = np.array(start, dtype=float)
    first, lands, cells = True, False, []
    for body in window.bodies:
        low, high = span(window, body)
        position = position + (low - position[2]) / ray[2] * ray
        if first:
            along = (start - position) @ ray
        change = first_change(window, body, position, ray, False, step, (high - position[2]) / ray[2])
        if change is None:
            at = (
                position + (high - margin(window) - position[2]) / ray[2] * ray
            )  # level with the highest material
            inside = over_body(window, body, at[:1], at[1:2])[3]
            if not inside[0] or (first and (at - start) @ ray < 0):
                return Fate("MISSED", launched, np.array(start))
            lands, position, first = True, at, False
            continue
        if first and change[0] < along:
            return Fate("MISSED", launched, np.array(start))
        first = False
        for face, state, n1, n2 in ((body.front, False, 1.0, body.index), (body.back, True, body.index, 1.0)):
            if state:
                change = first_change(window, body, position, ray, True, step, np.inf)
            inner = position + change[0 if state else 1] * ray
            _, _, places, _ = over_body(window, body, inner[:1], inner[1:2])
            kind, normal, z = face_normal(window, face, places.get(face.array))
            if body.columnar:  # outside the rim the land is the face on both sides
                bottom, top, _, _ = over_body(window, body, inner[:1], inner[1:2])
                actual = (top if state else bottom)[0]
                if abs(actual - z) > 1e-9 * window.lattice.pitch[0]:
                    kind, normal, z = "land", np.array([0.0, 0.0, 1.0]), actual
            slack = 1e-6 * window.lattice.pitch[0]
            if not abs(inner[2] - z) < slack:
                return Fate("WALL", ray, inner)
            position = inner
            lands |= kind == "land"
            if face.array is not None:
                cells.append(tuple(places[face.array][0][0]))
            if kind == "land" and window.land.opaque:
                return Fate("VIGNETTED", ray, inner)
            out = snell(ray, normal, n1, n2)
            if out is None:
                return Fate("TIR", ray, inner)
            ray = out
        if ray[2] <= 0:
            return Fate("BACKWARD", ray, position)
        change = first_change(
            window, body, position + slack * ray, ray, False, step, (high - position[2]) / ray[2]
        )
        if change is not None:
            return Fate("WALL", ray, position + change[1] * ray)
    if lands:
        return Fate("LAND", ray, position, cells)
    return Fate("ALIVE" if len(set(cells)) == 1 else "GHOST", ray, position, cells)
