"""Compiled straight path through facets that halve the bins of a grid: a block of rays, face by face.

Over halved bins (see `squares`) each side of a body is one piece of surface. A ray that is steeper than it
over all those bins passes it once, at the half whose plane gives a hit over that half. Uncertain cases are
left.
"""

from __future__ import annotations

from math import floor, nan

import numpy as np

from clacad.base.compiled import exact, least
from clacad.base.types import Floats, Rows
from clacad.optics.rays import Fate
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.block import (
    CI,
    CI0,
    CJ,
    CJ0,
    DX,
    DY,
    DZ,
    GOOD,
    GX,
    GY,
    GZ,
    HALF,
    PATH,
    SCRATCH,
    X,
    Y,
    Z,
    lanes,
)
from clacad.tracing.compiled.cells import in_zone, kept, relocate, sheet_xy
from clacad.tracing.compiled.face import bend
from clacad.tracing.compiled.packing import Packed
from clacad.tracing.compiled.records import Outcome
from clacad.tracing.facets.compiled_hierarchy import LEVEL
from clacad.tracing.facets.compiled_tiles import SquareGrid, half_bin, to_level
from clacad.tracing.facets.squares import (
    BIN,
    BINS_X,
    BINS_Y,
    CLIMB,
    CORNER,
    DOWN_HIGH,
    DOWN_LOW,
    HAIR,
    LOW_X,
    LOW_Y,
    OFF,
    PER_X,
    PER_Y,
    ROUNDED,
    SHEAR,
    SPLIT,
    UP_HIGH,
    UP_LOW,
    Squares,
)

INSIDE_CELL = 1e-9
"""Least distance of a hit from the borders of its cell, as a share of a cell."""

# Rows of a block's scratch array after those of `straight_path_slots`: cell of the launch and its centre,
# whether cells changed, the rectangle that a ray stays in, and the distance of a plane, later that of the
# hit.
HOME_I, HOME_J, CENTRE_X, CENTRE_Y, ODD, LEAST_X, MOST_X, LEAST_Y, MOST_Y, FAR, ROWS = range(
    SCRATCH, SCRATCH + 11
)

ALIVE, GHOST = int(Fate.ALIVE), int(Fate.GHOST)


@exact
def suits_squares(grid: Squares, lat: Floats) -> bool:
    """Whether there are squares at all, and nothing else in the path of light."""
    for row in grid.table:
        if not row[DOWN_HIGH] < row[UP_LOW]:
            return False
    return len(grid.plane) > 0 and lat[slot.BAFFLE] == slot.NO_BAFFLE and lat[slot.LINED] < 0.0


@exact
def through_squares(grid: Squares, sheet: Packed, s: Floats, m: int) -> None:
    """Trace a launched block straight through every body; uncertain rays lose their mark GOOD.

    Positions are then in the sheet frame; CI and CJ hold the last cell, CI0 and CJ0 the first.
    """
    bodies, faces = sheet.bodies, sheet.faces
    _in_sheet(sheet, s, m)
    met = 0
    for b in range(len(bodies)):
        row = grid.table[b]
        _begin(s, m, bodies[b, slot.LEVEL] + bodies[b, slot.BODY_LOW], row[SHEAR])
        for side in range(2):
            f = 2 * b + side
            low, high = (row[DOWN_LOW], row[DOWN_HIGH]) if side == 0 else (row[UP_LOW], row[UP_HIGH])
            landed = faces[f, slot.ARRAY] >= 0.0 and faces[f, slot.LAND] == faces[f, slot.LAND]
            squares = _squares_of(row, side)
            to_level(squares, row[SHEAR], s, m, 0.5 * (low + high))
            for _ in range(2):
                _planes_of_bins(grid, side, s, m)
                _to_planes(squares, row[SHEAR], s, m, max(2.0 * HAIR, ROUNDED * row[OFF]))
            level = LEVEL * LEVEL if landed else -1.0
            _refract(s, m, sheet.media[f], sheet.media[f + 1], row[CLIMB + side], level, row[SHEAR])
            if faces[f, slot.ARRAY] >= 0.0:
                _note_cells(sheet, s, m, int(faces[f, slot.ARRAY]), met == 0)
                met += 1
            if f == 0:
                for i in range(m):
                    s[GOOD, i] = s[GOOD, i] if s[PATH, i] >= 0.0 else 0.0
        _hold_among_squares(grid, row, s, m, bodies[b, slot.LEVEL] + bodies[b, slot.BODY_HIGH])
    for i in range(m):
        away, back = s[ODD, i] != 0.0, s[CI, i] == s[CI0, i] and s[CJ, i] == s[CJ0, i]
        if met == 0 or (away and back):
            s[GOOD, i] = 0.0


@exact
def _in_sheet(sheet: Packed, s: Floats, m: int) -> None:
    """Transform launched positions to the sheet frame, where they are certainly in a cell."""
    lat, base, hair = sheet.lattice, sheet.bodies[0, slot.LEVEL], INSIDE_CELL * sheet.lattice[slot.HALF]
    for i in range(m):
        if not (in_zone(lat, s[X, i], s[Y, i], hair) and kept(lat, sheet.rows, s[CI, i], s[CJ, i])):
            s[GOOD, i] = 0.0
        s[CENTRE_X, i], s[CENTRE_Y, i] = sheet_xy(lat, 0, s[CI, i], s[CJ, i], 0.0, 0.0)
        s[HOME_I, i], s[HOME_J, i], s[ODD, i] = s[CI, i], s[CJ, i], 0.0
    for i in range(m):
        s[X, i], s[Y, i], s[Z, i] = s[CENTRE_X, i] + s[X, i], s[CENTRE_Y, i] + s[Y, i], base + s[Z, i]


@exact
def _begin(s: Floats, m: int, level: float, shear: float) -> None:
    """Begin the rectangle in grid coordinates that rays stay in where they cross the lower end of a body.

    They may not start above it.
    """
    x, y, z, dx, dy, dz, good = lanes(s, (X, Y, Z, DX, DY, DZ, GOOD))
    left, right, lower, upper = lanes(s, (LEAST_X, MOST_X, LEAST_Y, MOST_Y))
    for i in range(m):
        t = (level - z[i]) / dz[i]
        u = x[i] + t * dx[i]
        v = y[i] + t * dy[i] - shear * u
        left[i], right[i], lower[i], upper[i] = u, u, v, v
        good[i] = good[i] if t >= 0.0 else 0.0


@exact
def _squares_of(row: Floats, side: int) -> SquareGrid:
    """The bins of a body, as halved by one of its sides."""
    return (
        row[LOW_X],
        row[LOW_Y],
        row[PER_X],
        row[PER_Y],
        row[BINS_X],
        row[BINS_Y],
        row[BIN],
        row[SPLIT + side],
    )


@exact
def _planes_of_bins(grid: Squares, side: int, s: Floats, m: int) -> None:
    """Load the planes over the present half bins of rays."""
    for i in range(m):
        h = int(s[HALF, i])
        s[GX, i], s[GY, i], s[GZ, i] = grid.plane[h, side, 0], grid.plane[h, side, 1], grid.plane[h, side, 2]
        s[FAR, i] = grid.plane[h, side, 3]


@exact
def _to_planes(squares: SquareGrid, shear: float, s: Floats, m: int, hair: float) -> None:
    """Distances of rays to their planes: NaN unless over the same half, `hair` bins inside; and the half."""
    x, y, z, dx, dy, dz, bins, far = lanes(s, (X, Y, Z, DX, DY, DZ, HALF, FAR))
    a, b, c = lanes(s, (GX, GY, GZ))
    low_x, low_y, per_x, per_y, nx, ny, first, split = squares
    for i in range(m):
        t = (far[i] - (a[i] * x[i] + b[i] * y[i] + c[i] * z[i])) / (
            a[i] * dx[i] + b[i] * dy[i] + c[i] * dz[i]
        )
        u, v = x[i] + t * dx[i], y[i] + t * dy[i]
        u, v = (u - low_x) * per_x, (v - shear * u - low_y) * per_y
        here = half_bin(u, v, nx, ny, first, split)
        p, q = u - np.floor(u), v - np.floor(v)
        inside = least(
            least(least(p, q), least(1.0 - p, 1.0 - q)), 0.5 * abs(q + split * p - (0.5 + 0.5 * split))
        )
        far[i] = t if here == bins[i] and inside > hair else nan
        bins[i] = here


@exact
def _refract(s: Floats, m: int, n1: float, n2: float, climb: float, level: float, shear: float) -> None:
    """Move to the hits and refract there, where rays are steeper than the facets before and behind them.

    level : squared slope up to which a facet may be land; negative where there is none
    """
    x, y, z, dx, dy, dz, good, path = lanes(s, (X, Y, Z, DX, DY, DZ, GOOD, PATH))
    gx, gy, gz, far = lanes(s, (GX, GY, GZ, FAR))
    left, right, lower, upper = lanes(s, (LEAST_X, MOST_X, LEAST_Y, MOST_Y))
    mu, weight = n1 / n2, (n2 - n1) / n2 * ((n2 + n1) / n2)
    for i in range(m):
        t, u, v, w = far[i], dx[i], dy[i], dz[i]
        px, py = x[i] + t * u, y[i] + t * v
        x[i], y[i], z[i] = px, py, z[i] + t * w
        path[i] += n1 * t
        left[i], right[i] = least(left[i], px), -least(-right[i], -px)
        row = py - shear * px
        lower[i], upper[i] = least(lower[i], row), -least(-upper[i], -row)
        a, b, c = gx[i], gy[i], gz[i]
        root = a * u + b * v + c * w
        incident = mu * root
        g = bend(a * a + b * b + c * c, incident, weight)
        up = mu * w + g * c
        dx[i], dy[i], dz[i] = mu * u + g * a, mu * v + g * b, up
        flat = a * a + b * b <= level * c * c
        sure = t == t and root > 0.0 and w > climb and up > climb and not flat
        good[i] = good[i] if sure else 0.0


@exact
def _note_cells(sheet: Packed, s: Floats, m: int, array: int, first: bool) -> None:
    """Cells of an array in which hits certainly lie: first and last of each ray, whether they differ."""
    lat = sheet.lattice
    hair, at = INSIDE_CELL * lat[slot.HALF], slot.BETWEEN + 4 * array
    dx, dy, di, dj = lat[at], lat[at + 1], lat[at + 2], lat[at + 3]
    for k in range(m):
        if not s[GOOD, k] > 0.0:
            continue
        x, y = s[X, k] - s[CENTRE_X, k] - dx, s[Y, k] - s[CENTRE_Y, k] - dy
        i, j = s[HOME_I, k] - di, s[HOME_J, k] - dj
        if not in_zone(lat, x, y, hair):
            more_i, more_j, x, y = relocate(lat, x, y)
            i, j = i + more_i, j + more_j
            if not in_zone(lat, x, y, hair):
                s[GOOD, k] = 0.0
                continue
        if not kept(lat, sheet.rows, i, j):
            s[GOOD, k] = 0.0
        if first:
            s[CI0, k], s[CJ0, k] = i, j
        elif i != s[CI0, k] or j != s[CJ0, k]:
            s[ODD, k] = 1.0
        s[CI, k], s[CJ, k] = i, j


@exact
def _hold_among_squares(grid: Squares, row: Floats, s: Floats, m: int, level: float) -> None:
    """Require that rays stayed over halved bins up to a level."""
    held, start, wide = grid.odd, int(row[CORNER]), int(row[BINS_X]) + 1
    hair, high = max(2.0 * HAIR, ROUNDED * row[OFF]), int(row[BINS_Y]) + 1
    for i in range(m):
        if not s[GOOD, i] > 0.0:
            continue
        t = (level - s[Z, i]) / s[DZ, i]
        u = s[X, i] + t * s[DX, i]
        v = s[Y, i] + t * s[DY, i] - row[SHEAR] * u
        left, right = min(s[LEAST_X, i], u), max(s[MOST_X, i], u)
        lower, upper = min(s[LEAST_Y, i], v), max(s[MOST_Y, i], v)
        i0, i1 = (
            floor((left - row[LOW_X]) * row[PER_X] - hair),
            floor((right - row[LOW_X]) * row[PER_X] + hair) + 1,
        )
        j0, j1 = (
            floor((lower - row[LOW_Y]) * row[PER_Y] - hair),
            floor((upper - row[LOW_Y]) * row[PER_Y] + hair) + 1,
        )
        if not (t >= 0.0 and 0.0 <= i0 and i1 < wide and 0.0 <= j0 and j1 < high):
            s[GOOD, i] = 0.0
            continue
        below, above = start + int(j0) * wide, start + int(j1) * wide
        if held[above + int(i1)] - held[above + int(i0)] - held[below + int(i1)] + held[below + int(i0)] > 0:
            s[GOOD, i] = 0.0


@exact
def store_sheet_block(s: Floats, chosen: Rows, last: int, out: Outcome) -> None:
    """Write the rows of the rays of a block in the sheet frame that kept their mark."""
    for k in range(len(chosen)):
        if not s[GOOD, k] > 0.0:
            continue
        row = chosen[k]
        out.position[row, 0], out.position[row, 1], out.position[row, 2] = s[X, k], s[Y, k], s[Z, k]
        out.direction[row, 0], out.direction[row, 1], out.direction[row, 2] = s[DX, k], s[DY, k], s[DZ, k]
        out.path[row], out.surface[row] = s[PATH, k], last
        out.cell[row, 0], out.cell[row, 1] = np.int32(s[CI0, k]), np.int32(s[CJ0, k])
        out.order[row, 0], out.order[row, 1] = np.int32(s[CI, k] - s[CI0, k]), np.int32(s[CJ, k] - s[CJ0, k])
        out.fate[row] = GHOST if s[ODD, k] != 0.0 else ALIVE
