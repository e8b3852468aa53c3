"""Sums over a stream of triangles in one pass, compiled: see `clacad.formats.mesh.measure`."""

from __future__ import annotations

import numpy as np

from clacad.base.compiled import entry, inlined, mixed, two_sum
from clacad.base.hashing import GOLDEN, MIX, STIR
from clacad.base.types import Floats, Words

FIRST, SECOND = np.uint64(GOLDEN), np.uint64(0xC2B2AE3D27D4EB4F)
"""Seeds of the two hashes."""

MINUS_ZERO, ZERO = np.uint64(1 << 63), np.uint64(0)

VOLUME, AREA = 0, 2
"""Indices of six times the volume and twice the area in the totals, each in two parts."""


@inlined
def point_hash(words: Words, facet: int, corner: int, seed: np.uint64) -> np.uint64:
    """Hash of a corner from the bits of its coordinates; −0 is 0."""
    x, y, z = words[facet, corner, 0], words[facet, corner, 1], words[facet, corner, 2]
    x = ZERO if x == MINUS_ZERO else x
    y = ZERO if y == MINUS_ZERO else y
    z = ZERO if z == MINUS_ZERO else z
    value = mixed(x ^ seed)
    value = mixed(value + y * MIX)
    return mixed(value + z * STIR)


@inlined
def edge_hash(start: np.uint64, end: np.uint64, seed: np.uint64) -> np.uint64:
    """Hash of a directed edge: the undirected one's, negative if traversed backwards; 0 for no length."""
    if start == end:
        return ZERO
    low, high = (start, end) if start < end else (end, start)
    value = mixed(low * STIR + mixed(high + seed))
    return value if start < end else ZERO - value


@entry
def add_facets(
    corners: Floats, words: Words, origin: Floats, sums: Words, totals: Floats, box: Floats
) -> None:
    """Add facets (k, 3, 3) to the sums over a stream.

    Parameters
    ----------
    words : (k, 3, 3)
        The bits of `corners`.
    origin : (3,)
        Point the cones of the volume start from.
    sums : (2,)
        Of the hashes of directed edges.
    totals : (4,)
        See VOLUME and AREA; each is a rounded sum and its rounding error.
    box : (2, 3)
        Lowest and highest corner.
    """
    for f in range(len(corners)):
        for k in range(2):
            seed = FIRST if k == 0 else SECOND
            a = point_hash(words, f, 0, seed)
            b = point_hash(words, f, 1, seed)
            c = point_hash(words, f, 2, seed)
            sums[k] += edge_hash(a, b, seed) + edge_hash(b, c, seed) + edge_hash(c, a, seed)
        for axis in range(3):
            for corner in range(3):
                place = corners[f, corner, axis]
                box[0, axis] = min(place, box[0, axis])
                box[1, axis] = max(place, box[1, axis])
        ax, ay, az = corners[f, 0, 0] - origin[0], corners[f, 0, 1] - origin[1], corners[f, 0, 2] - origin[2]
        bx, by, bz = corners[f, 1, 0] - origin[0], corners[f, 1, 1] - origin[1], corners[f, 1, 2] - origin[2]
        cx, cy, cz = corners[f, 2, 0] - origin[0], corners[f, 2, 1] - origin[1], corners[f, 2, 2] - origin[2]
        ux, uy, uz = bx - ax, by - ay, bz - az
        vx, vy, vz = cx - ax, cy - ay, cz - az
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        high, low = two_sum(totals[VOLUME], ax * nx + ay * ny + az * nz)
        totals[VOLUME], totals[VOLUME + 1] = high, totals[VOLUME + 1] + low
        high, low = two_sum(totals[AREA], np.sqrt(nx * nx + ny * ny + nz * nz))
        totals[AREA], totals[AREA + 1] = high, totals[AREA + 1] + low


@entry
def hash_corners(words: Words, hashes: Words) -> None:
    """Hash every corner of facets (k, 3, 3), given by the bits of its coordinates, into (k, 3)."""
    for f in range(len(words)):
        for c in range(3):
            hashes[f, c] = point_hash(words, f, c, FIRST)
