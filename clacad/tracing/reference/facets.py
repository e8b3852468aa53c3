"""Facets of a mesh's own tiles in numpy: the facet over a point, and where rays cross a face of facets.

The twin of `clacad.tracing.triangles.compiled_tile_block`; used for few rays while no kernels are compiled.
"""

from __future__ import annotations

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.optics.surface import refract
from clacad.sheet.cell_places import LensPlaces
from clacad.tracing.layout import FacePlan
from clacad.tracing.reference.face import Hit, cross
from clacad.tracing.triangles.tiles import (
    BIN,
    BINS_X,
    BINS_Y,
    LENS,
    LOW_X,
    LOW_Y,
    PER_X,
    PER_Y,
    SPLIT,
    TiledFace,
    Tiles,
)

TRIES = 8
"""Facets looked up before a ray is left to the walk; two suffice for lens-like slopes."""


def meet_face(
    face: FacePlan, local: Floats, z: Floats, direction: Floats, n1: float, n2: float, places: LensPlaces
) -> Hit:
    """Intersect a face from its −z side and refract: its lens, see `face.cross`, or its facets.

    Rays must be steeper than all of the facets: then the first one found is the only one.
    """
    if not isinstance(face, TiledFace):
        return cross(face, local, z, direction, n1, n2, places)
    if face.array is None:
        distance = (face.low - z) / direction[:, 2]
        normal = np.broadcast_to(np.array([0.0, 0.0, 1.0]), direction.shape)
    else:
        facet, distance = _facets_met(face, local, z, direction)
        normal = normals_at(face, facet, local + distance[:, None] * direction[:, :2])
    root = (direction * normal).sum(axis=1)
    out, _ = refract(direction, normal, root, n1, n2)
    return Hit(
        local=local + distance[:, None] * direction[:, :2],
        z=z + distance * direction[:, 2],
        distance=distance,
        direction=out,
        upright=root > 0.0,
    )


def facets_over(tiles: Tiles, tile: int, xy: Floats) -> Ints:
    """Facets (m,) over points (m, 2) of the cell frame: those they lie deepest in; −1 far outside the
    tile.
    """
    row = tiles.table[tile]
    i, j = _bins(row, xy)
    bins = (row[BIN] + j * row[BINS_X] + i).astype(np.int64)
    first, last = tiles.start[bins], tiles.start[bins + 1]
    best, deepest = np.full(len(xy), -1, dtype=np.int64), np.full(len(xy), -np.inf)
    for k in range(int((last - first).max(initial=0))):
        rows = np.flatnonzero((first + k < last) & ~(deepest > 0.0))
        facet = tiles.member[first[rows] + k]
        inside = shares(tiles, facet, xy[rows]).min(axis=1)
        deeper = inside > deepest[rows]
        best[rows[deeper]], deepest[rows[deeper]] = facet[deeper], inside[deeper]
    return best


def shares(tiles: Tiles, facet: Ints, xy: Floats) -> Floats:
    """Barycentric coordinates (m, 3) of points (m, 2) in facets (m,)."""
    w = tiles.weight[facet]
    return np.asarray(w[..., 0] * xy[:, :1] + w[..., 1] * xy[:, 1:] + w[..., 2])


def normals_at(face: TiledFace, facet: Ints, xy: Floats) -> Floats:
    """Normals (m, 3) towards +z, of any length: the facets' own, or those of their corners interpolated at
    points (m, 2).
    """
    tiles, side = face.tiles, face.side
    a, b, _ = tiles.plane[facet, side].T
    own = np.column_stack([-a, -b, np.ones(len(facet))])
    if not len(tiles.normal):
        return own
    smooth = (shares(tiles, facet, xy)[..., None] * tiles.normal[facet, side]).sum(axis=1)
    return np.where((tiles.part[facet, side] == LENS)[:, None], smooth, own)


def _facets_met(face: TiledFace, local: Floats, z: Floats, direction: Floats) -> tuple[Ints, Floats]:
    """Facets (m,) of the lens that rays cross, and their distances (m,); NaN where none was found.

    Half bins, of which most tiles are made, are tried first; then facet by facet where they do not decide.
    """
    tiles, side, row = face.tiles, face.side, face.tiles.table[face.tile]
    level = 0.5 * (face.low + face.high)
    at_level = local + ((level - z) / direction[:, 2])[:, None] * direction[:, :2]
    half = _half_bins(row, at_level)
    for _ in range(2):
        distance = _to_planes(tiles.lens[half, side], local, z, direction)
        here = _half_bins(row, local + distance[:, None] * direction[:, :2])
        distance = np.where(here == half, distance, np.nan)
        half = here
    facet = tiles.half[half]
    rest = np.flatnonzero(np.isnan(distance))
    if len(rest):
        guess = np.where(facet[rest] < 0, facets_over(tiles, face.tile, at_level[rest]), facet[rest])
        facet[rest], distance[rest] = _settled(face, guess, local[rest], z[rest], direction[rest])
    return facet, distance


def _settled(
    face: TiledFace, guess: Ints, local: Floats, z: Floats, direction: Floats
) -> tuple[Ints, Floats]:
    """Facets and distances from a first guess, moving from each facet to the one over the hit; NaN where none
    is found.
    """
    tiles, side = face.tiles, face.side
    found, distance = np.zeros(len(guess), dtype=np.int64), np.full(len(guess), np.nan)
    open_to, facet = np.flatnonzero(guess >= 0), guess[guess >= 0]
    for _ in range(TRIES):
        if not len(open_to):
            break
        t = _to_planes(tiles.plane[facet, side], local[open_to], z[open_to], direction[open_to])
        hit = local[open_to] + t[:, None] * direction[open_to, :2]
        inside = (shares(tiles, facet, hit) >= 0.0).all(axis=1)
        lens = inside & (tiles.part[facet, side] == LENS)
        found[open_to[lens]], distance[open_to[lens]] = facet[lens], t[lens]
        on = ~(inside | np.isnan(t))
        open_to, facet = open_to[on], facets_over(tiles, face.tile, hit[on])
        open_to, facet = open_to[facet >= 0], facet[facet >= 0]
    return found, distance


def _to_planes(plane: Floats, local: Floats, z: Floats, direction: Floats) -> Floats:
    """Distances (m,) to planes (m, 3), heights a x + b y + c."""
    a, b, c = plane.T
    (x, y), (dx, dy, dz) = local.T, direction.T
    return np.asarray((c + a * x + b * y - z) / (dz - a * dx - b * dy))


def _half_bins(row: Floats, xy: Floats) -> Ints:
    """Numbers (m,) of the half squares over points (m, 2): twice the bin's, plus one beyond its diagonal."""
    i, j = _bins(row, xy)
    u, v = (xy[:, 0] - row[LOW_X]) * row[PER_X] - i, (xy[:, 1] - row[LOW_Y]) * row[PER_Y] - j
    beyond = v + row[SPLIT] * u > 0.5 + 0.5 * row[SPLIT]
    return np.asarray((2.0 * (row[BIN] + j * row[BINS_X] + i) + beyond).astype(np.int64))


def _bins(row: Floats, xy: Floats) -> tuple[Floats, Floats]:
    """Indices (m,) along x and y of the bins over points (m, 2), the nearest bin where there is none."""
    i, j = np.floor((xy[:, 0] - row[LOW_X]) * row[PER_X]), np.floor((xy[:, 1] - row[LOW_Y]) * row[PER_Y])
    return np.fmax(np.fmin(row[BINS_X] - 1.0, i), 0.0), np.fmax(np.fmin(row[BINS_Y] - 1.0, j), 0.0)
