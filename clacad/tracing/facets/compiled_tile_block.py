"""The straight path through one face of facets, compiled: a block of rays by lookup in the regular grid.

The first guess is where the ray meets the face's middle height. The facet over that point is intersected,
then the facet over the hit. If that hit lies over the same facet, it is the hit: a ray steeper than every
facet has only one. Arithmetic runs in vector loops, table loads in separate loops. Rays over bins that
contain anything but the two halves of a square, and those that need more steps, are looked up one by one.
"""

from __future__ import annotations

from math import isnan

import numpy as np

from clacad.base.compiled import exact, least
from clacad.base.types import Floats
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.block import DX, DY, DZ, GOOD, GX, GY, GZ, HALF, PATH, RANGE, X, Y, Z, lanes
from clacad.tracing.compiled.face import bend
from clacad.tracing.compiled.records import Ray, Vector
from clacad.tracing.facets.compiled_tiles import facet_normal, locate_facet
from clacad.tracing.facets.tiles import BIN, BINS_X, BINS_Y, LENS, LOW_X, LOW_Y, PER_X, PER_Y, SPLIT, Tiles

SquareGrid = tuple[float, float, float, float, float, float, float, float]
"""Corner of a grid of halved bins, bins per length, count, first number, direction of diagonals (SPLIT)."""

TRIES = 8
"""Facets looked up before a ray is left to the walk; two suffice for lens-like slopes."""


@exact
def cross_facets(
    tiles: Tiles,
    faces: Floats,
    f: int,
    s: Floats,
    m: int,
    media: tuple[float, float],
    climb: float,
    origin: Vector,
) -> None:
    """Cross one face of facets; positions plus the origin are relative to cell and level, then without it."""
    x, y, z = lanes(s, (X, Y, Z))
    ox, oy, oz = origin
    for i in range(m):
        x[i], y[i], z[i] = x[i] + ox, y[i] + oy, z[i] + oz
    side = f % 2
    tile = tiles.of[f // 2, side]
    row = tiles.table[tile]
    level = 0.5 * (faces[f, slot.LOW] + faces[f, slot.HIGH])
    to_level(_squares_of(row), 0.0, s, m, level)
    _planes_of_bins(tiles, side, s, m)
    _to_planes(row, s, m)
    _planes_of_bins(tiles, side, s, m)
    _to_planes(row, s, m)
    _settle(tiles, tile, side, level, s, m)
    _refract_facets(s, m, media[0], media[1], climb)


@exact
def _squares_of(row: Floats) -> SquareGrid:
    """The regular grid of a tile."""
    return (row[LOW_X], row[LOW_Y], row[PER_X], row[PER_Y], row[BINS_X], row[BINS_Y], row[BIN], row[SPLIT])


@exact
def to_level(squares: SquareGrid, shear: float, s: Floats, m: int, level: float) -> None:
    """Extrapolate rays to a level without moving them, and find the half bin there.

    shear : Step of the rows along y per length along x; 0 for rectangular bins.
    """
    x, y, z, dx, dy, dz, bins = lanes(s, (X, Y, Z, DX, DY, DZ, HALF))
    low_x, low_y, per_x, per_y, nx, ny, first, split = squares
    for i in range(m):
        t = (level - z[i]) / dz[i]
        u, v = x[i] + t * dx[i], y[i] + t * dy[i]
        bins[i] = half_bin((u - low_x) * per_x, (v - shear * u - low_y) * per_y, nx, ny, first, split)


@exact
def half_bin(u: float, v: float, nx: float, ny: float, first: float, split: float) -> float:
    """Number of the half square over a point given in bins: twice the bin's, plus one beyond the diagonal."""
    i, j = np.floor(u), np.floor(v)
    i, j = least(nx - 1.0, i), least(ny - 1.0, j)
    i, j = i if i > 0.0 else 0.0, j if j > 0.0 else 0.0
    beyond = (v - j) + split * (u - i) > 0.5 + 0.5 * split
    return 2.0 * (first + j * nx + i) + (1.0 if beyond else 0.0)


@exact
def _planes_of_bins(tiles: Tiles, side: int, s: Floats, m: int) -> None:
    """Load the planes over the present half bins of rays; NaN where there is no such facet."""
    for i in range(m):
        h = int(s[HALF, i])
        s[GX, i], s[GY, i], s[GZ, i] = tiles.lens[h, side, 0], tiles.lens[h, side, 1], tiles.lens[h, side, 2]


@exact
def _to_planes(row: Floats, s: Floats, m: int) -> None:
    """Distances of rays to their planes, unmoved: NaN if the hit lies over another half bin, and that bin."""
    x, y, z, dx, dy, dz, bins, far = lanes(s, (X, Y, Z, DX, DY, DZ, HALF, RANGE))
    a, b, c = lanes(s, (GX, GY, GZ))
    low_x, low_y, per_x, per_y, nx, ny, first, split = _squares_of(row)
    for i in range(m):
        t = (c[i] + a[i] * x[i] + b[i] * y[i] - z[i]) / (dz[i] - a[i] * dx[i] - b[i] * dy[i])
        here = half_bin(
            (x[i] + t * dx[i] - low_x) * per_x, (y[i] + t * dy[i] - low_y) * per_y, nx, ny, first, split
        )
        far[i] = t if here == bins[i] else np.nan
        bins[i] = here


@exact
def _settle(tiles: Tiles, tile: int, side: int, level: float, s: Floats, m: int) -> None:
    """Fill in the normals; look up one by one the rays whose facet is not certain."""
    gx, gy, gz, far = lanes(s, (GX, GY, GZ, RANGE))
    for i in range(m):
        gx[i], gy[i], gz[i] = -gx[i], -gy[i], 1.0
    smooth = len(tiles.normal) > 0
    for i in range(m):
        if not (smooth or isnan(far[i])) or not s[GOOD, i] > 0.0:
            continue
        x, y, z, u, v, w = s[X, i], s[Y, i], s[Z, i], s[DX, i], s[DY, i], s[DZ, i]
        facet = tiles.half[int(s[HALF, i])]
        if isnan(far[i]):
            t = (level - z) / w
            guess = locate_facet(tiles, tile, x + t * u, y + t * v) if facet < 0 else facet
            facet, far[i] = _facet_met(tiles, tile, side, guess, Ray(x, y, z, u, v, w))
            if facet < 0:
                s[GOOD, i] = 0.0
                continue
        gx[i], gy[i], gz[i] = facet_normal(tiles, facet, side, x + far[i] * u, y + far[i] * v)


@exact
def _facet_met(tiles: Tiles, tile: int, side: int, guess: int, ray: Ray) -> tuple[int, float]:
    """Facet that one ray meets, and where; −1 if it is not found, or no part of the lens."""
    x, y, z, u, v, w = ray
    facet = guess
    for _ in range(TRIES):
        a, b, c = tiles.plane[facet, side, 0], tiles.plane[facet, side, 1], tiles.plane[facet, side, 2]
        t = (c + a * x + b * y - z) / (w - a * u - b * v)
        if isnan(t):
            break
        p, q = x + t * u, y + t * v
        inside = True
        for k in range(3):
            e = tiles.weight[facet, k]
            inside &= e[0] * p + e[1] * q + e[2] >= 0.0
        if inside:
            return (facet, t) if tiles.part[facet, side] == LENS else (-1, t)
        facet = locate_facet(tiles, tile, p, q)
    return -1, np.nan


@exact
def _refract_facets(s: Floats, m: int, n1: float, n2: float, climb: float) -> None:
    """Move to the hits and refract there by the normals in GX, GY, GZ."""
    x, y, z, dx, dy, dz, good = lanes(s, (X, Y, Z, DX, DY, DZ, GOOD))
    gx, gy, gz, far, path = lanes(s, (GX, GY, GZ, RANGE, PATH))
    mu, weight = n1 / n2, (n2 - n1) / n2 * ((n2 + n1) / n2)
    for i in range(m):
        t, u, v, w = far[i], dx[i], dy[i], dz[i]
        x[i], y[i], z[i] = x[i] + t * u, y[i] + t * v, z[i] + t * w
        path[i] += n1 * t
        a, b, c = gx[i], gy[i], gz[i]
        root = u * a + v * b + w * c
        incident = mu * root
        g = bend(a * a + b * b + c * c, incident, weight)
        dx[i], dy[i] = mu * u + g * a, mu * v + g * b
        up = mu * w + g * c
        dz[i] = up
        good[i] = least(least(good[i], root), least(up, up - climb))
