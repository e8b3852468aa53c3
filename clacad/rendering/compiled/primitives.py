"""Distances to primitives, compiled: a block of rays in a primitive's own frame, one plain loop a shape.

The twin of `rendering.scene_hits`' shapes. Distances are in lengths of the given direction; NaN or ∞ where a
ray misses.
"""

from __future__ import annotations

import math

import numpy as np

from clacad.base.compiled import exact
from clacad.base.types import Floats
from clacad.rendering.scene_arrays import BOX, CONE, END, KIND, ORIGIN, PIECE, PRISM, SIZE, SPHERE, TURN


@exact
def to_frame(prim: Floats, k: int, m: int, ray: Floats, local: Floats) -> None:
    """Starts and directions (6, m) of rays in the frame of primitive k."""
    x, y, z, u, v, w = ray[0, :m], ray[1, :m], ray[2, :m], ray[3, :m], ray[4, :m], ray[5, :m]
    lx, ly, lz, ru, rv, rw = (
        local[0, :m],
        local[1, :m],
        local[2, :m],
        local[3, :m],
        local[4, :m],
        local[5, :m],
    )
    ox, oy, oz = prim[k, ORIGIN], prim[k, ORIGIN + 1], prim[k, ORIGIN + 2]
    a, b, c = prim[k, TURN], prim[k, TURN + 1], prim[k, TURN + 2]
    d, e, f = prim[k, TURN + 3], prim[k, TURN + 4], prim[k, TURN + 5]
    g, h, q = prim[k, TURN + 6], prim[k, TURN + 7], prim[k, TURN + 8]
    if a == 1.0 and e == 1.0 and q == 1.0:  # of a rotation: none
        for i in range(m):
            lx[i], ly[i], lz[i] = x[i] - ox, y[i] - oy, z[i] - oz
        for i in range(m):
            ru[i], rv[i], rw[i] = u[i], v[i], w[i]
        return
    for i in range(m):
        px, py, pz = x[i] - ox, y[i] - oy, z[i] - oz
        lx[i], ly[i], lz[i] = px * a + py * d + pz * g, px * b + py * e + pz * h, px * c + py * f + pz * q
    for i in range(m):
        p, r, s = u[i], v[i], w[i]
        ru[i], rv[i], rw[i] = p * a + r * d + s * g, p * b + r * e + s * h, p * c + r * f + s * q


@exact
def distances(prim: Floats, store: Floats, k: int, m: int, local: Floats, out: Floats, work: Floats) -> None:
    """Write the distance (m,) to primitive k, which is no mesh; `work` (2, m) is scratch."""
    kind, a, b, c = prim[k, KIND], prim[k, SIZE], prim[k, SIZE + 1], prim[k, SIZE + 2]
    if kind == SPHERE:
        _sphere(m, local, a, out)
    elif kind == BOX:
        _box(m, local, a, b, c, out)
    elif kind == CONE:
        _cone(m, local, a, b, c, out)
    elif kind == PRISM:
        _prism(store, int(prim[k, PIECE]), int(prim[k, END]), m, local, a, out, work)
    else:
        _screen(m, local, a, b, out)


@exact
def _sphere(m: int, local: Floats, radius: float, out: Floats) -> None:
    """Nearer hit above 0 of a sphere about the origin."""
    x, y, z, u, v, w = local[0, :m], local[1, :m], local[2, :m], local[3, :m], local[4, :m], local[5, :m]
    for i in range(m):
        inverse = 1.0 / (u[i] * u[i] + v[i] * v[i] + w[i] * w[i])
        middle = -(x[i] * u[i] + y[i] * v[i] + z[i] * w[i]) * inverse
        px, py, pz = x[i] + middle * u[i], y[i] + middle * v[i], z[i] + middle * w[i]
        half = math.sqrt((radius * radius - (px * px + py * py + pz * pz)) * inverse)
        near = middle - half
        out[i] = near if near > 0.0 else middle + half


@exact
def _span(p: float, d: float, half: float) -> tuple[float, float]:
    """Distances at which a ray enters and leaves a slab; all or nothing for a ray parallel to it."""
    inverse = 1.0 / d
    a, b = (-half - p) * inverse, (half - p) * inverse
    outside = abs(p) > half
    near, far = (a, b) if a < b else (b, a)
    along = d == 0.0
    near = (np.inf if outside else -np.inf) if along else near
    far = (-np.inf if outside else np.inf) if along else far
    return near, far


@exact
def _box(m: int, local: Floats, hx: float, hy: float, hz: float, out: Floats) -> None:
    """Nearer hit above 0 of a box about the origin."""
    x, y, z, u, v, w = local[0, :m], local[1, :m], local[2, :m], local[3, :m], local[4, :m], local[5, :m]
    for i in range(m):
        a, b = _span(x[i], u[i], hx)
        c, d = _span(y[i], v[i], hy)
        e, f = _span(z[i], w[i], hz)
        near = a if a > c else c
        near = near if near > e else e
        far = b if b < d else d
        far = far if far < f else f
        hit = near if near > 0.0 else far
        out[i] = hit if near <= far else np.nan


@exact
def _screen(m: int, local: Floats, hx: float, hy: float, out: Floats) -> None:
    """Hit of a rectangle in the plane z = 0."""
    x, y, z, u, v, w = local[0, :m], local[1, :m], local[2, :m], local[3, :m], local[4, :m], local[5, :m]
    for i in range(m):
        s = -z[i] / w[i]
        inside = (abs(x[i] + s * u[i]) <= hx) & (abs(y[i] + s * v[i]) <= hy)
        out[i] = s if inside else np.nan


@exact
def _cone(m: int, local: Floats, bottom: float, top: float, height: float, out: Floats) -> None:
    """Nearest hit above 0 of a closed frustum with axis y."""
    x, y, z, u, v, w = local[0, :m], local[1, :m], local[2, :m], local[3, :m], local[4, :m], local[5, :m]
    slope = (top - bottom) / height
    for i in range(m):
        middle = -(x[i] * u[i] + y[i] * v[i] + z[i] * w[i]) / (u[i] * u[i] + v[i] * v[i] + w[i] * w[i])
        px, py, pz = x[i] + middle * u[i], y[i] + middle * v[i], z[i] + middle * w[i]
        r = bottom + slope * py
        a = u[i] * u[i] + w[i] * w[i] - slope * slope * v[i] * v[i]
        b = px * u[i] + pz * w[i] - slope * v[i] * r
        c = px * px + pz * pz - r * r
        root = math.sqrt(b * b - a * c)
        q = -(b + (root if b >= 0.0 else -root))
        best = np.inf
        s = q / a
        at = py + s * v[i]
        good = (s + middle > 0.0) & (at >= 0.0) & (at <= height) & (bottom + slope * at >= 0.0)
        best = s + middle if good else best
        s = c / q
        at = py + s * v[i]
        good = (s + middle > 0.0) & (at >= 0.0) & (at <= height) & (bottom + slope * at >= 0.0)
        best = s + middle if good & (s + middle < best) else best
        s = -py / v[i]
        cx, cz = px + s * u[i], pz + s * w[i]
        good = (s + middle > 0.0) & (cx * cx + cz * cz <= bottom * bottom)
        best = s + middle if good & (s + middle < best) else best
        s = (height - py) / v[i]
        cx, cz = px + s * u[i], pz + s * w[i]
        good = (s + middle > 0.0) & (cx * cx + cz * cz <= top * top)
        out[i] = s + middle if good & (s + middle < best) else best


@exact
def _prism(
    store: Floats, first: int, end: int, m: int, local: Floats, half: float, out: Floats, work: Floats
) -> None:
    """Nearest hit above 0 of an extruded outline between z = −half and half."""
    x, y, z, u, v, w = local[0, :m], local[1, :m], local[2, :m], local[3, :m], local[4, :m], local[5, :m]
    best, level, odd = out[:m], work[0, :m], work[1, :m]
    for i in range(m):
        best[i] = np.inf
    for k in range(2):
        cap = half if k else -half
        for i in range(m):
            level[i], odd[i] = (cap - z[i]) / w[i], -1.0
        for n in range(first, end, 2):  # crossings of the outline to the right, counted by sign
            j = n + 2 if n + 2 < end else first
            x0, y0, x1, y1 = store[n], store[n + 1], store[j], store[j + 1]
            if y0 == y1:
                continue
            run = (x1 - x0) / (y1 - y0)
            for i in range(m):
                px, py = x[i] + level[i] * u[i], y[i] + level[i] * v[i]
                crosses = ((y0 > py) != (y1 > py)) & (px < run * (py - y0) + x0)
                odd[i] = -odd[i] if crosses else odd[i]
        for i in range(m):
            better = (odd[i] > 0.0) & (level[i] > 0.0) & (level[i] < best[i])
            best[i] = level[i] if better else best[i]
    for n in range(first, end, 2):
        j = n + 2 if n + 2 < end else first
        x0, y0, x1, y1 = store[n], store[n + 1], store[j], store[j + 1]
        nx, ny = y1 - y0, x0 - x1
        square = nx * nx + ny * ny
        for i in range(m):
            s = (nx * (x0 - x[i]) + ny * (y0 - y[i])) / (nx * u[i] + ny * v[i])
            along = (x[i] + s * u[i] - x0) * (x1 - x0) + (y[i] + s * v[i] - y0) * (y1 - y0)
            good = (
                (s > 0.0)
                & (s < best[i])
                & (along >= 0.0)
                & (along <= square)
                & (abs(z[i] + s * w[i]) <= half)
            )
            best[i] = s if good else best[i]
