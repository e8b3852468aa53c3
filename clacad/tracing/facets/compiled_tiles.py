"""Compiled tracing of facets: the lookup and the walk from facet to facet.

The straight path through one face of facets, compiled: a block of rays by lookup in the regular grid.

The first guess is where the ray meets the face's middle height. The facet over that point is intersected,
then the facet over the hit. If that hit lies over the same facet, it is the hit: a ray steeper than every
facet has only one. Arithmetic runs in vector loops, table loads in separate loops. Rays over bins that
contain anything but the two halves of a square, and those that need more steps, are looked up one by one.
"""

from __future__ import annotations

from math import inf, isnan, nan

import numpy as np

from clacad.base.compiled import exact, inlined, least
from clacad.base.types import Floats, Ints
from clacad.optics.ledger import ABOVE, ASIDE, BACK, BACK_LAND, FRONT, FRONT_LAND, WALL
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.array_cells import place_in_row
from clacad.tracing.compiled.block import (
    AX,
    CI,
    CJ,
    DX,
    DY,
    DZ,
    GOOD,
    GX,
    GY,
    GZ,
    HALF,
    PATH,
    RANGE,
    X,
    Y,
    Z,
    lanes,
)
from clacad.tracing.compiled.cells import kept
from clacad.tracing.compiled.column import (
    border_ahead,
    divide_outline,
    edge_ahead,
    ends_of_body,
    enter_cell,
    in_footprint,
    jump,
    sort_divisions,
    start_search,
    step_on,
    write_event,
)
from clacad.tracing.compiled.face import bend
from clacad.tracing.compiled.packing import Packed
from clacad.tracing.compiled.records import (
    CELL,
    FACET,
    FACET_NORMAL,
    MOST_ARRAYS,
    START,
    STEP,
    CellRay,
    Ray,
    Vector,
)
from clacad.tracing.facets.tiles import (
    ABSENT,
    BIN,
    BINS_X,
    BINS_Y,
    BY_TILE,
    LAND,
    LENS,
    LOW_X,
    LOW_Y,
    PER_X,
    PER_Y,
    SPLIT,
    VOID,
    CellHeights,
    Tiles,
)

NOT_LOOKED_UP, NONE = -2, -1
"""State of the facet that an array is in: not yet looked up; none exists."""

NO_STEP = -2
"""In place of a crossed border: an edge of the plate, which leads to no other cell."""


@exact
def locate_facet(tiles: Tiles, tile: int, x: float, y: float) -> int:
    """Facet over a point of the cell frame: the one the point lies deepest in; −1 far outside the tile."""
    row = tiles.table[tile]
    i = min(max(int((x - row[LOW_X]) * row[PER_X]), 0), int(row[BINS_X]) - 1)
    j = min(max(int((y - row[LOW_Y]) * row[PER_Y]), 0), int(row[BINS_Y]) - 1)
    b = int(row[BIN]) + j * int(row[BINS_X]) + i
    best, deepest = -1, -inf
    for k in range(tiles.start[b], tiles.start[b + 1]):
        f = tiles.member[k]
        w = tiles.weight[f]
        inside = min(
            w[0, 0] * x + w[0, 1] * y + w[0, 2],
            min(w[1, 0] * x + w[1, 1] * y + w[1, 2], w[2, 0] * x + w[2, 1] * y + w[2, 2]),
        )
        if inside > deepest:
            best, deepest = f, inside
            if inside > 0.0:
                break
    return best


@inlined
def _first_of(own: CellHeights | None, sheet: Packed, f: int, i: float, j: float) -> int:
    """Entry of a cell in `CellHeights.first`; of identical cells ABSENT, which is not read."""
    if own is None:
        return ABSENT
    return _own_first(own, sheet, f, i, j)


@exact
def _own_first(own: CellHeights, sheet: Packed, f: int, i: float, j: float) -> int:
    if not kept(sheet.lattice, sheet.rows, i, j):
        return ABSENT
    return int(own.first[f, place_in_row(sheet.lattice, i, j), int(j)])


@inlined
def _tile_of(tiles: Tiles, own: CellHeights | None, sheet: Packed, f: int, i: float, j: float) -> int:
    """Tile over a cell on face f; −1 for a cell that is not in the mesh."""
    tile = int(tiles.of[f // 2, f % 2])
    if own is None:
        return tile
    first = _own_first(own, sheet, f, i, j)
    return tile if first >= 0 else BY_TILE - first


@inlined
def plane_of(tiles: Tiles, own: CellHeights | None, sheet: Packed, f: int, first: int, facet: int) -> Vector:
    """Height a x + b y + c of a facet of face f over the body's level, in the cell whose entry is `first`."""
    if own is None:
        side = f % 2
        return tiles.plane[facet, side, 0], tiles.plane[facet, side, 1], tiles.plane[facet, side, 2]
    return _own_plane(tiles, own, sheet, f, first, facet)


@exact
def _own_plane(tiles: Tiles, own: CellHeights, sheet: Packed, f: int, first: int, facet: int) -> Vector:
    side = f % 2
    if first < 0 or tiles.part[facet, side] != LENS:
        return tiles.plane[facet, side, 0], tiles.plane[facet, side, 1], tiles.plane[facet, side, 2]
    z = 1.0 * own.height[first + own.corner[facet, 0]]
    u = 1.0 * own.height[first + own.corner[facet, 1]] - z  # heights are multiples of one step: exact
    v = 1.0 * own.height[first + own.corner[facet, 2]] - z
    p, q = tiles.weight[facet, 1], tiles.weight[facet, 2]
    level = z - sheet.bodies[f // 2, slot.LEVEL]
    return u * p[0] + v * q[0], u * p[1] + v * q[1], level + (u * p[2] + v * q[2])


@exact
def facet_normal(tiles: Tiles, sheet: Packed, f: int, first: int, facet: int, x: float, y: float) -> Vector:
    """Normal towards +z: the facet's, or that of its corners interpolated at a point."""
    side = f % 2
    if len(tiles.normal) == 0 or tiles.part[facet, side] != LENS:
        a, b, _ = plane_of(tiles, tiles.own, sheet, f, first, facet)
        return -a, -b, 1.0
    gx, gy, gz = 0.0, 0.0, 0.0
    for k in range(3):
        w = tiles.weight[facet, k]
        share = w[0] * x + w[1] * y + w[2]
        nx, ny, nz = _corner_normal(tiles, tiles.own, side, first, facet, k)
        gx, gy, gz = gx + share * nx, gy + share * ny, gz + share * nz
    return gx, gy, gz


@inlined
def _corner_normal(
    tiles: Tiles, own: CellHeights | None, side: int, first: int, facet: int, k: int
) -> Vector:
    """Exact normal at corner k of a facet."""
    n = tiles.normal[facet, side, k]
    if own is not None and first >= 0:
        n = own.normal[first + own.corner[facet, k]]
    return n[0], n[1], n[2]


# -- the walk ----------------------------------------------------------------------------------
@exact
def _levels(
    tiles: Tiles, sheet: Packed, row: int, at: int, causes: Ints, work: Floats, dx: float, dy: float
) -> tuple[float, float]:
    """Height of a face at the start and its rise along the ray, in the ray's present column; NaN for none."""
    faces = sheet.faces
    if faces[row, slot.ARRAY] < 0.0:
        return faces[row, slot.LOW], 0.0
    f = causes[FACET + at]
    if f < 0:
        return faces[row, slot.LAND], 0.0
    if tiles.part[f, row % 2] == VOID:
        return nan, 0.0
    first = _first_of(tiles.own, sheet, row, work[CELL + 2 * at], work[CELL + 2 * at + 1])
    a, b, c = plane_of(tiles, tiles.own, sheet, row, first, f)
    return a * work[START + 2 * at] + b * work[START + 2 * at + 1] + c, a * dx + b * dy


@exact
def _kind(tiles: Tiles, faces: Floats, row: int, facet: int) -> int:
    """Kind of crossing of a face's plane over a facet: of a lens or plane face, or of land."""
    side = row % 2
    if faces[row, slot.ARRAY] < 0.0:
        return FRONT if side == 0 else BACK
    land = facet < 0 or tiles.part[facet, side] == LAND
    if side == 0:
        return FRONT_LAND if land else FRONT
    return BACK_LAND if land else BACK


@inlined
def _look_up_again(causes: Ints) -> None:
    """Discard the present facets of the arrays."""
    for at in range(MOST_ARRAYS):
        causes[FACET + at] = NOT_LOOKED_UP


@exact
def first_facet_change(
    tiles: Tiles, sheet: Packed, b: int, ray: CellRay, inside: bool, event: Floats, work: Floats, causes: Ints
) -> None:
    """Find where a ray first enters or leaves the facets of body b: `reference.column.first_change` for
    facets.

    A piece lies over one facet of each of the body's tilings; in it both faces are planes.
    """
    start_search(sheet, b, ray, work)
    _look_up_again(causes)
    along, above, aside = ends_of_body(sheet, b, ray, inside)
    limit = min(aside, above)
    since, cause, kind = 0.0, WALL, ASIDE
    normal = (0.0, 0.0, 1.0)
    walking = not above <= 0.0
    if not walking:
        kind = ABOVE
    entered = 0.0  # start of the piece
    while walking:
        end, across, edge, at, sense = _next_edge(tiles, sheet, b, along, (entered, limit), work, causes)
        ahead = edge_ahead(sheet, b, along, entered)
        if ahead < end:
            end, across, edge = ahead, NO_STEP, -1
        end = max(end, entered)
        changed, since, cause = _first_stretch(
            tiles, sheet, b, along, inside, (entered, end, since, cause), work, causes
        )
        if changed:
            kind = cause
            normal = _normal_met(tiles, sheet, b, along, (kind, since), work, causes)
            break
        if limit <= end:
            kind, since = (ABOVE, above) if above <= end else (ASIDE, aside)
            break
        entered = end
        if inside:
            t = jump(sheet, b, ray, entered, work)
            if t > entered:
                entered, since, cause = t, t, WALL
                _look_up_again(causes)
                continue
        if across >= 0:
            step_on(across, sense, work, STEP + 2 * at)
            causes[FACET + at] = NOT_LOOKED_UP
        elif edge >= 0:
            causes[FACET + at] = tiles.beside[causes[FACET + at], edge]
        elif across != NO_STEP:
            break
    write_event(sheet, kind, since, work, event)
    event[FACET_NORMAL], event[FACET_NORMAL + 1], event[FACET_NORMAL + 2] = normal


@inlined
def _next_edge(
    tiles: Tiles, sheet: Packed, b: int, ray: Ray, span: tuple[float, float], work: Floats, causes: Ints
) -> tuple[float, int, int, int, float]:
    """Enter the present facets, and find where the ray leaves the first of them.

    span : start of the piece, and the end of the search
    Returns the distance; the crossed border of the cell, or the facet's edge, −1 for neither; its array; and
    the sense in which the border is crossed.
    """
    lat = sheet.lattice
    entered, end = span
    across, edge, of, sense = -1, -1, -1, 1.0
    for k in range(2):
        at = int(sheet.bodies[b, slot.CELLS + k])
        if at < 0:
            continue
        u, v = enter_cell(sheet.lattices[at], at, work)
        if causes[FACET + at] == NOT_LOOKED_UP:
            causes[FACET + at] = NONE
            i, j = work[CELL + 2 * at], work[CELL + 2 * at + 1]
            face = 2 * b + (k if at == int(sheet.faces[2 * b + k, slot.ARRAY]) else 1 - k)
            tile = _tile_of(tiles, tiles.own, sheet, face, i, j)
            if tile >= 0 and kept(lat, sheet.rows, i, j):
                # slightly into the piece, so that a ray along an edge is in the facet it goes to
                t = entered + 2.0 * lat[slot.TINY]
                causes[FACET + at] = locate_facet(tiles, tile, u + t * ray.L, v + t * ray.M)
        t, n, towards = border_ahead(sheet.lattices[at], ray, u, v, end)
        if n >= 0:
            end, across, edge, of, sense = t, n, -1, at, towards
        f = causes[FACET + at]
        if f < 0:
            continue
        for n in range(3):
            wx, wy = tiles.weight[f, n, 0], tiles.weight[f, n, 1]
            speed = wx * ray.L + wy * ray.M
            if speed >= 0.0 or tiles.beside[f, n] < 0:
                continue
            t = -(wx * u + wy * v + tiles.weight[f, n, 2]) / speed
            if t < end:
                end, across, edge, of = t, -1, n, at
    return end, across, edge, of, sense


@exact
def _array_of(sheet: Packed, b: int, side: int) -> int:
    """The array in whose cells a face of body b is looked up: its own, or the body's."""
    array = sheet.faces[2 * b + side, slot.ARRAY]
    return int(array) if array >= 0.0 else int(sheet.bodies[b, slot.ENTRY])


@inlined
def _first_stretch(
    tiles: Tiles,
    sheet: Packed,
    b: int,
    ray: Ray,
    inside: bool,
    span: tuple[float, float, float, int],
    work: Floats,
    causes: Ints,
) -> tuple[bool, float, int]:
    """Find the first stretch of a piece whose state differs from the ray's; see `column`.

    span : start and end of the piece, since when the state is known, and its cause
    Returns whether there is one, its start (else that of the last), and what is crossed there.
    """
    faces, bodies, tiny = sheet.faces, sheet.bodies, sheet.lattice[slot.TINY]
    entered, end, since, cause = span
    sx, sy, z, L, M, N = ray
    main, front_at, back_at = int(bodies[b, slot.ENTRY]), _array_of(sheet, b, 0), _array_of(sheet, b, 1)
    low, low_rise = _levels(tiles, sheet, 2 * b, front_at, causes, work, L, M)
    high, high_rise = _levels(tiles, sheet, 2 * b + 1, back_at, causes, work, L, M)
    work[0], causes[0] = (low - z) / (N - low_rise), _kind(tiles, faces, 2 * b, causes[FACET + front_at])
    work[1], causes[1] = (high - z) / (N - high_rise), _kind(tiles, faces, 2 * b + 1, causes[FACET + back_at])
    count = 2
    if causes[FACET + main] < 0:
        count = divide_outline(bodies, b, ray, work, causes, count)
    count = sort_divisions(work, causes, count, max(entered, since - tiny), since, end)
    over_cell = kept(sheet.lattice, sheet.rows, work[CELL + 2 * main], work[CELL + 2 * main + 1])
    for c in range(count + 1):
        to, why = (work[c], causes[c]) if c < count else (end, WALL)
        if not to - since > tiny:
            cause = cause if c == count or why == WALL else why
            continue
        t = 0.5 * (since + to)
        level = z + t * N
        over = in_footprint(sheet, b, sx + t * L, sy + t * M, over_cell)
        now = over and low + t * low_rise <= level <= high + t * high_rise
        if now != inside:
            return True, since, cause
        since, cause = to, why
    return False, since, cause


@inlined
def _normal_met(
    tiles: Tiles, sheet: Packed, b: int, ray: Ray, met: tuple[int, float], work: Floats, causes: Ints
) -> Vector:
    """Normal towards +z of the facet where the state changed; (0, 0, 1) without such a facet."""
    kind, t = met
    if kind != FRONT and kind != BACK:
        return 0.0, 0.0, 1.0
    f = 2 * b + (0 if kind == FRONT else 1)
    at = _array_of(sheet, b, f % 2)
    facet = causes[FACET + at]
    if facet < 0:
        return 0.0, 0.0, 1.0
    first = _first_of(tiles.own, sheet, f, work[CELL + 2 * at], work[CELL + 2 * at + 1])
    x, y = work[START + 2 * at] + t * ray.L, work[START + 2 * at + 1] + t * ray.M
    return facet_normal(tiles, sheet, f, first, facet, x, y)


SquareGrid = tuple[float, float, float, float, float, float, float, float]
"""Corner of a grid of halved bins, bins per length, count, first number, direction of diagonals (SPLIT)."""

TRIES = 8
"""Facets looked up before a ray is left to the walk; two suffice for lens-like slopes."""


@exact
def cross_facets(
    tiles: Tiles,
    sheet: Packed,
    f: int,
    s: Floats,
    m: int,
    media: tuple[float, float],
    climb: float,
    origin: Vector,
) -> None:
    """Cross one face of facets; positions plus the origin are relative to cell and level, then without it."""
    faces, own = sheet.faces, tiles.own
    x, y, z = lanes(s, (X, Y, Z))
    ox, oy, oz = origin
    for i in range(m):
        x[i], y[i], z[i] = x[i] + ox, y[i] + oy, z[i] + oz
    tile = tiles.of[f // 2, f % 2]
    row = tiles.table[tile]
    level = 0.5 * (faces[f, slot.LOW] + faces[f, slot.HIGH])
    _find_cells(own, sheet, f, tile, s, m)
    to_level(_squares_of(row), 0.0, s, m, level)
    for _ in range(2):
        _planes_of_bins(tiles, own, sheet, f, s, m)
        _to_planes(row, s, m)
    _settle(tiles, own, sheet, f, level, s, m)
    _refract_facets(s, m, media[0], media[1], climb)


@inlined
def _find_cells(own: CellHeights | None, sheet: Packed, f: int, tile: int, s: Floats, m: int) -> None:
    """Entries of the rays' cells; cells of another tile are left to the walk."""
    if own is not None:
        for i in range(m):
            first = _own_first(own, sheet, f, s[CI, i], s[CJ, i]) if s[GOOD, i] > 0.0 else BY_TILE - tile
            if first < 0 and first != BY_TILE - tile:
                s[GOOD, i] = 0.0
            s[AX, i] = first


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


@inlined
def _planes_of_bins(tiles: Tiles, own: CellHeights | None, sheet: Packed, f: int, s: Floats, m: int) -> None:
    """Load the planes over the present half bins of rays; NaN where there is no such facet."""
    side = f % 2
    for i in range(m):
        h = int(s[HALF, i])
        s[GX, i], s[GY, i], s[GZ, i] = tiles.lens[h, side, 0], tiles.lens[h, side, 1], tiles.lens[h, side, 2]
    if own is not None:
        for i in range(m):
            first, facet = int(s[AX, i]), tiles.half[int(s[HALF, i])]
            if first >= 0 and facet >= 0 and tiles.part[facet, side] == LENS:
                s[GX, i], s[GY, i], s[GZ, i] = _own_plane(tiles, own, sheet, f, first, facet)


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
def _settle(
    tiles: Tiles, own: CellHeights | None, sheet: Packed, f: int, level: float, s: Floats, m: int
) -> None:
    """Fill in the normals; look up one by one the rays whose facet is not certain."""
    gx, gy, gz, far = lanes(s, (GX, GY, GZ, RANGE))
    for i in range(m):
        gx[i], gy[i], gz[i] = -gx[i], -gy[i], 1.0
    smooth, tile = len(tiles.normal) > 0, tiles.of[f // 2, f % 2]
    for i in range(m):
        if not (smooth or isnan(far[i])) or not s[GOOD, i] > 0.0:
            continue
        x, y, z, u, v, w = s[X, i], s[Y, i], s[Z, i], s[DX, i], s[DY, i], s[DZ, i]
        facet, first = tiles.half[int(s[HALF, i])], ABSENT
        if own is not None:
            first = int(s[AX, i])
        if isnan(far[i]):
            t = (level - z) / w
            guess = locate_facet(tiles, tile, x + t * u, y + t * v) if facet < 0 else facet
            facet, far[i] = _facet_met(tiles, sheet, f, first, guess, Ray(x, y, z, u, v, w))
            if facet < 0:
                s[GOOD, i] = 0.0
                continue
        gx[i], gy[i], gz[i] = facet_normal(tiles, sheet, f, first, facet, x + far[i] * u, y + far[i] * v)


@exact
def _facet_met(tiles: Tiles, sheet: Packed, f: int, first: int, guess: int, ray: Ray) -> tuple[int, float]:
    """Facet that one ray meets, and where; −1 if it is not found, or no part of the lens."""
    x, y, z, u, v, w = ray
    facet = guess
    for _ in range(TRIES):
        a, b, c = plane_of(tiles, tiles.own, sheet, f, first, facet)
        t = (c + a * x + b * y - z) / (w - a * u - b * v)
        if isnan(t):
            break
        p, q = x + t * u, y + t * v
        inside = True
        for k in range(3):
            e = tiles.weight[facet, k]
            inside &= e[0] * p + e[1] * q + e[2] >= 0.0
        if inside:
            return (facet, t) if tiles.part[facet, f % 2] == LENS else (-1, t)
        facet = locate_facet(tiles, tiles.of[f // 2, f % 2], p, q)
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
