"""Compiled straight path through triangles from any source: rays decided with certainty within a few bins of
a grid.
"""

from __future__ import annotations

from math import floor, inf, isnan

from clacad.base.compiled import exact
from clacad.base.types import Floats
from clacad.optics.rays import Fate
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.cells import in_zone, kept, sheet_xy, to_array
from clacad.tracing.compiled.face import snell
from clacad.tracing.compiled.packing import Packed
from clacad.tracing.compiled.records import Launched, Outcome, Ray, Vector
from clacad.tracing.triangles.compiled_hierarchy import is_level
from clacad.tracing.triangles.compiled_search import hit, normal_of
from clacad.tracing.triangles.facet_grid import (
    BIN,
    BINS_X,
    BINS_Y,
    CORNER,
    DOWN_HIGH,
    HAIR,
    LOW_X,
    LOW_Y,
    PER_X,
    PER_Y,
    UP_HIGH,
    UP_LOW,
    FacetGrid,
)
from clacad.tracing.triangles.hierarchy import Hierarchy

NOTHING, UNSURE = -1, -2
"""In place of a facet number: none is met; undecided here."""

MOST_BINS = 4
"""Largest number of bins that a stretch may touch."""

INSIDE_CELL = 1e-9
"""Least distance of a hit from the borders of its cell, as a share of a cell."""

ALIVE, GHOST = int(Fate.ALIVE), int(Fate.GHOST)


@exact
def _bin_of(place: float) -> int:
    """Bin of a position counted in bins; −1 within the tolerance of a border."""
    whole = floor(place)
    part = place - whole
    return int(whole) if 2.0 * HAIR < part < 1.0 - 2.0 * HAIR else -1


@exact
def _walls_in(grid: FacetGrid, row: Floats, i0: int, i1: int, j0: int, j1: int) -> int:
    """Number of bins with walls among those from i0 to i1 and j0 to j1."""
    first, wide = int(row[CORNER]), int(row[BINS_X]) + 1
    below, above = first + j0 * wide, first + (j1 + 1) * wide
    held = grid.walled
    return int(held[above + i1 + 1] - held[above + i0] - held[below + i1 + 1] + held[below + i0])


@exact
def _first_on_stretch(
    trees: Hierarchy, grid: FacetGrid, b: int, origin: Vector, ray: Ray, stretch: tuple[float, float], but: int
) -> tuple[float, int]:  # fmt: skip
    """First facet of body b, except one, on a stretch of a ray: distance and number, inf and NOTHING or
    UNSURE.
    """
    row, (begin, end) = grid.table[b], stretch
    x, y = origin[0] + ray.x, origin[1] + ray.y
    i0 = _bin_of((x + begin * ray.L - row[LOW_X]) * row[PER_X])
    i1 = _bin_of((x + end * ray.L - row[LOW_X]) * row[PER_X])
    j0 = _bin_of((y + begin * ray.M - row[LOW_Y]) * row[PER_Y])
    j1 = _bin_of((y + end * ray.M - row[LOW_Y]) * row[PER_Y])
    i0, i1, j0, j1 = min(i0, i1), max(i0, i1), min(j0, j1), max(j0, j1)
    if (
        i0 < 0
        or j0 < 0
        or i1 >= row[BINS_X]
        or j1 >= row[BINS_Y]
        or (i1 - i0 + 1) * (j1 - j0 + 1) > MOST_BINS
    ):
        return inf, UNSURE
    if _walls_in(grid, row, i0, i1, j0, j1) > 0:
        return inf, UNSURE
    nearest, which = inf, NOTHING
    for j in range(j0, j1 + 1):
        for i in range(i0, i1 + 1):
            place = int(row[BIN]) + j * int(row[BINS_X]) + i
            for k in range(grid.start[place], grid.start[place + 1]):
                facet = grid.member[k]
                t = hit(trees.corner[facet], origin, ray)[0]
                if begin <= t < nearest and t <= end and facet != but:
                    nearest, which = t, facet
    return nearest, which


@exact
def _free_until(
    trees: Hierarchy, grid: FacetGrid, b: int, origin: Vector, ray: Ray, end: float, but: int
) -> bool:
    """Whether a ray certainly meets no facet of body b, except one, before a distance."""
    return end <= 0.0 or _first_on_stretch(trees, grid, b, origin, ray, (0.0, end), but)[1] == NOTHING


@exact
def _no_wall_between(grid: FacetGrid, b: int, x: float, y: float, u: float, v: float) -> bool:
    """Whether there is no wall between two positions on the sheet."""
    row = grid.table[b]
    right, top = row[BINS_X] - 1.0, row[BINS_Y] - 1.0
    i, j = floor((x - row[LOW_X]) * row[PER_X]), floor((y - row[LOW_Y]) * row[PER_Y])
    k, l = floor((u - row[LOW_X]) * row[PER_X]), floor((v - row[LOW_Y]) * row[PER_Y])  # noqa: E741
    if not (0.0 <= min(i, k) and max(i, k) <= right and 0.0 <= min(j, l) and max(j, l) <= top):
        return False
    return bool(_walls_in(grid, row, int(min(i, k)), int(max(i, k)), int(min(j, l)), int(max(j, l))) == 0)


@exact
def _bent(trees: Hierarchy, sheet: Packed, f: int, which: int, ray: Ray, n1: float, n2: float) -> Vector:
    """Direction behind a facet of face f that is certainly lens; (0, 0, 0) where that is undecided here."""
    nx, ny, nz = normal_of(trees, which)
    sign = -1.0 if f % 2 == 0 else 1.0
    nx, ny, nz = sign * nx, sign * ny, sign * nz
    root = nx * ray.L + ny * ray.M + nz * ray.N
    face = sheet.faces[f]
    landed = face[slot.ARRAY] >= 0.0 and not isnan(face[slot.LAND])
    if not (nz > 0.0 and root > 0.0) or (landed and is_level(nx, ny, nz)):
        return 0.0, 0.0, 0.0
    return snell((ray.L, ray.M, ray.N), (nx, ny, nz), root, n1, n2)


@exact
def straight_through(
    trees: Hierarchy, grid: FacetGrid, sheet: Packed, launched: Launched, row: int, out: Outcome
) -> bool:
    """Trace a launched ray straight through every body and write its row; False where that cannot be decided
    here.
    """
    lat, bodies, faces = sheet.lattice, sheet.bodies, sheet.faces
    if lat[slot.BAFFLE] != slot.NO_BAFFLE or not kept(lat, sheet.rows, launched.i, launched.j):
        return False
    base = bodies[0, slot.LEVEL]
    sx, sy = sheet_xy(lat, 0, launched.i, launched.j, 0.0, 0.0)
    origin = (sx, sy, base)
    ray = Ray(launched.x, launched.y, launched.z, launched.L, launched.M, launched.N)
    path, met = launched.carried, 0
    fi, fj, li, lj, ghost = 0.0, 0.0, 0.0, 0.0, False
    for b in range(len(bodies)):
        index, bounds = sheet.indices[b], grid.table[b]
        begin = (bodies[b, slot.LEVEL] + bodies[b, slot.BODY_LOW] - base - ray.z) / ray.N
        if begin < -1e-9 * lat[slot.HALF] or not bounds[DOWN_HIGH] < bounds[UP_LOW]:
            return False
        which = NOTHING
        for side in range(2):
            f = 2 * b + side
            if side == 1:
                after = (bounds[DOWN_HIGH] - base - ray.z) / ray.N
                if not _free_until(trees, grid, b, origin, ray, after, which):
                    return False
                begin = max(after, (bounds[UP_LOW] - base - ray.z) / ray.N)
            end = ((bounds[DOWN_HIGH] if side == 0 else bounds[UP_HIGH]) - base - ray.z) / ray.N
            far, which = _first_on_stretch(trees, grid, b, origin, ray, (begin, end), NOTHING)
            if which < 0 or path + far < 0.0:  # the first may not lie behind the start
                return False
            media = (1.0, index) if side == 0 else (index, 1.0)
            L, M, N = _bent(trees, sheet, f, which, ray, media[0], media[1])
            x, y, z = ray.x + far * ray.L, ray.y + far * ray.M, ray.z + far * ray.N
            if not N > 0.0 or not _no_wall_between(grid, b, sx + ray.x, sy + ray.y, sx + x, sy + y):
                return False
            if faces[f, slot.ARRAY] >= 0.0:
                i, j, u, v = to_array(lat, 0, int(faces[f, slot.ARRAY]), launched.i, launched.j, x, y)
                if not (in_zone(lat, u, v, INSIDE_CELL * lat[slot.HALF]) and kept(lat, sheet.rows, i, j)):
                    return False
                if met == 0:
                    fi, fj = i, j
                if faces[f, slot.BLIND] == 1.0:
                    i = fi
                elif faces[f, slot.BLIND] == 2.0:
                    j = fj
                ghost |= i != fi or j != fj
                li, lj, met = i, j, met + 1
            path += media[0] * far
            ray = Ray(x, y, z, L, M, N)
        after = (bounds[UP_HIGH] - base - ray.z) / ray.N
        if not _free_until(trees, grid, b, origin, ray, after, which):
            return False
    if met == 0 or (ghost and li == fi and lj == fj):
        return False
    out.position[row, 0], out.position[row, 1], out.position[row, 2] = sx + ray.x, sy + ray.y, base + ray.z
    out.direction[row, 0], out.direction[row, 1], out.direction[row, 2] = ray.L, ray.M, ray.N
    out.path[row], out.surface[row] = path, len(faces) - 1
    out.cell[row, 0], out.cell[row, 1] = int(fi), int(fj)
    out.order[row, 0], out.order[row, 1] = int(li - fi), int(lj - fj)
    out.fate[row] = GHOST if ghost else ALIVE
    return True
