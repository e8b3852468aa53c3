"""Positions of the cells and lenses of each array, compiled.

Uniform sheets read one set of numbers; non-uniform sheets read `OwnCells`. Argument types decide which:
kernels for uniform sheets are compiled without the code that reads `OwnCells`.
Compared with `clacad.sheet.cell_places` and `clacad.tracing.reference.launch.cell_in`.

Compiled twins of `clacad.sheet.plate_edges`: whether a point lies in a plate, and the next edge that a ray
crosses.

Steps of the straight path on non-uniform sheets: blocks into cells of another pitch, displaced lenses.
"""

from __future__ import annotations

from math import copysign, inf, sqrt
from typing import NamedTuple

import numpy as np

from clacad.base.compiled import exact, inlined, least, multiply_add, pair_sum, two_product, two_sum
from clacad.base.types import Floats
from clacad.sheet.edge_columns import CX, CY, RADIUS, SENSE, X0, X1, Y0, Y1
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.block import (
    AX,
    AY,
    CI,
    CJ,
    DX,
    DY,
    DZ,
    GOOD,
    GX,
    GY,
    GZ,
    PATH,
    ROOT,
    SIZE,
    XL,
    YL,
    X,
    Y,
    Z,
    lane,
    lanes,
)
from clacad.tracing.compiled.cells import hexagon_steps, in_zone, kept, locate, relocate, to_array
from clacad.tracing.compiled.face import height, lens_roots, meet, to_lens, to_sheet
from clacad.tracing.compiled.packing import OwnCells, Packed
from clacad.tracing.compiled.records import Ray, Vector

Place = tuple[float, float, float, float]


class CellRule(NamedTuple):
    """Cells' positions: cell (i, j) lies i − across + skew j pitches from x0, and j − along rows from y0."""

    skew: float
    across: float
    along: float
    pitch: float
    row: float
    x0: float
    y0: float


@exact
def own_offset(sheet: Packed, own: OwnCells, f: int, i: float, j: float) -> tuple[float, float]:
    """Offset of the lens of a cell from the face's vertex on a non-uniform sheet; see `VertexChange.at`."""
    if own.change[f, slot.CHANGES] == 0.0:
        return 0.0, 0.0
    ax, ay = times_gradient(gradient_of(own, f), centre_of(grid_of(sheet.lattice), i, j))
    which = int(own.change[f, slot.TABLE])
    if which >= 0:
        tx, ty = tabled(sheet, own, which, i, j)
        ax, ay = ax + tx, ay + ty
    return ax, ay


@exact
def own_size(sheet: Packed, own: OwnCells, f: int, i: float, j: float) -> float:
    """Scale factor of the lens of a cell; 1 for cells that are not kept."""
    which = int(own.change[f, slot.SIZES])
    if which < 0 or not kept(sheet.lattice, sheet.rows, i, j):
        return 1.0
    return float(own.size[which, place_in_row(sheet.lattice, i, j), int(j)])


@inlined
def own_frame(frames: Floats | None, sheet: Packed, own: OwnCells, f: int, i: float, j: float) -> float:
    """Write the numbers of a cell's lens into the row of face f, and return its rise besides its offset's."""
    if frames is None:
        return 0.0
    which, face = int(own.change[f, slot.FRAME]), sheet.faces[f]
    if which < 0:
        return 0.0
    row = frames[which, 0, 0]
    if kept(sheet.lattice, sheet.rows, i, j):
        row = frames[which, place_in_row(sheet.lattice, i, j), int(j)]
    face[slot.CY], face[slot.KX] = row[slot.FIRST], row[slot.SECOND]
    for k in range(9):
        face[slot.R0 + k] = row[slot.AXES + k]
    return float(row[slot.LIFT])


@inlined
def framed(own: OwnCells | None, f: int) -> bool:
    """Whether the lenses of face f have frames of their own."""
    if own is None:
        return False
    return _in_frames(own.frame, own.change, f)


@inlined
def _in_frames(frames: Floats | None, change: Floats, f: int) -> bool:
    if frames is None:
        return False
    return bool(change[f, slot.FRAME] >= 0.0)


@inlined
def place_in_row(lat: Floats, i: float, j: float) -> int:
    """First index of a kept cell in a table."""
    return int(i) + int(j) // 2 if lat[slot.HEXAGONAL] != 0.0 else int(i)


@inlined
def gradient_of(own: OwnCells, f: int) -> Place:
    """Gradient of the lens offsets on a face, row by row."""
    change = own.change
    return change[f, slot.XX], change[f, slot.XY], change[f, slot.YX], change[f, slot.YY]


@inlined
def times_gradient(gradient: Place, place: tuple[float, float]) -> tuple[float, float]:
    """Product of a gradient and a position."""
    (xx, xy, yx, yy), (x, y) = gradient, place
    return xx * x + xy * y, yx * x + yy * y


@inlined
def grid_of(lat: Floats) -> CellRule:
    """Numbers that locate the cells of a lattice."""
    if lat[slot.HEXAGONAL] != 0.0:
        return CellRule(0.5, 0.0, 0.0, lat[slot.PITCH], lat[slot.ROW], lat[slot.X0], lat[slot.Y0])
    across, along = 0.5 * (lat[slot.N1] - 1.0), 0.5 * (lat[slot.N2] - 1.0)
    return CellRule(0.0, across, along, lat[slot.PITCH], lat[slot.ROW], 0.0, 0.0)


@inlined
def steps_to(grid: CellRule, i: float, j: float) -> tuple[float, float]:
    """Number of pitches and rows from the lattice's origin (x0, y0) to a cell, exact."""
    return (i - grid.across) + grid.skew * j, j - grid.along


@inlined
def centre_of(grid: CellRule, i: float, j: float) -> tuple[float, float]:
    """Centre of a cell, rounded."""
    across, along = steps_to(grid, i, j)
    return grid.x0 + across * grid.pitch, grid.y0 + along * grid.row


@exact
def tabled(sheet: Packed, own: OwnCells, which: int, i: float, j: float) -> tuple[float, float]:
    """Tabulated part of the offset of a lens; 0 for cells that are not kept."""
    if not kept(sheet.lattice, sheet.rows, i, j):
        return 0.0, 0.0
    place = place_in_row(sheet.lattice, i, j)
    return own.table[which, place, int(j), 0], own.table[which, place, int(j), 1]


@inlined
def lens_at(sheet: Packed, own: OwnCells | None, f: int, i: float, j: float) -> Place:
    """Vertex of the lens of a cell, from the cell's centre and the body's level, and its scale factor."""
    vx, vy, vz = sheet.faces[f, slot.VX], sheet.faces[f, slot.VY], sheet.faces[f, slot.VZ]
    if own is None:
        return vx, vy, vz, 1.0
    return _own_lens_at(sheet, own, f, i, j)


@exact
def _own_lens_at(sheet: Packed, own: OwnCells, f: int, i: float, j: float) -> Place:
    vx, vy, vz = sheet.faces[f, slot.VX], sheet.faces[f, slot.VY], sheet.faces[f, slot.VZ]
    ax, ay = own_offset(sheet, own, f, i, j)
    rise = ax * own.change[f, slot.RISE_X] + ay * own.change[f, slot.RISE_Y]
    rise += own_frame(own.frame, sheet, own, f, i, j)
    return vx + ax, vy + ay, vz + rise, own_size(sheet, own, f, i, j)


@inlined
def lens_height(
    sheet: Packed, own: OwnCells | None, f: int, cell: tuple[float, float], x: float, y: float
) -> float:
    """Height of the lens of a cell over the body's level at a point of the cell frame; NaN for none."""
    if own is None:
        return height(sheet.faces, f, x, y)
    vx, vy, vz = sheet.faces[f, slot.VX], sheet.faces[f, slot.VY], sheet.faces[f, slot.VZ]
    px, py, pz, size = _own_lens_at(sheet, own, f, cell[0], cell[1])
    return float(pz + size * (height(sheet.faces, f, vx + (x - px) / size, vy + (y - py) / size) - vz))


@inlined
def lens_crossings(
    sheet: Packed, own: OwnCells | None, f: int, cell: tuple[float, float], ray: Ray
) -> tuple[float, float]:
    """Both distances at which a ray of the cell frame crosses all of a lens's surface (`lens_roots`)."""
    x, y, z, L, M, N = ray
    if own is None:
        return lens_roots(sheet.faces, f, x, y, z, L, M, N)
    vx, vy, vz = sheet.faces[f, slot.VX], sheet.faces[f, slot.VY], sheet.faces[f, slot.VZ]
    px, py, pz, size = _own_lens_at(sheet, own, f, cell[0], cell[1])
    x, y, z = vx + (x - px) / size, vy + (y - py) / size, vz + (z - pz) / size
    one, two = lens_roots(sheet.faces, f, x, y, z, L, M, N)
    return size * one, size * two


@inlined
def into_array(
    sheet: Packed, own: OwnCells | None, of: int, array: int, i: float, j: float, x: float, y: float
) -> Place:
    """Cell and local coordinates in another array of a point given in the cells of array `of`."""
    if own is None:
        return to_array(sheet.lattice, of, array, i, j, x, y)
    return _into_own(sheet.lattices, of, array, i, j, x, y)


@exact
def _into_own(lattices: Floats, of: int, array: int, i: float, j: float, x: float, y: float) -> Place:
    here, there = lattices[of], lattices[array]
    if of == array:
        di, dj, x, y = relocate(there, x, y)
        return i + di, j + dj, x, y
    if here[slot.PITCH] == there[slot.PITCH] and here[slot.ROW] == there[slot.ROW]:
        return to_array(there, of, array, i, j, x, y)
    grid = grid_of(here)
    across, along = steps_to(grid, i, j)
    xh, xl = two_product(across, grid.pitch)
    xh, xl = pair_sum(xh, xl, grid.x0, 0.0)
    yh, yl = two_product(along, grid.row)
    yh, yl = pair_sum(yh, yl, grid.y0, 0.0)
    xh, xl = pair_sum(xh, xl, x, 0.0)
    yh, yl = pair_sum(yh, yl, y, 0.0)
    h, e = two_sum(here[slot.SHIFT + 2 * of], -here[slot.SHIFT + 2 * array])
    xh, xl = pair_sum(xh, xl, h, e)
    h, e = two_sum(here[slot.SHIFT + 2 * of + 1], -here[slot.SHIFT + 2 * array + 1])
    yh, yl = pair_sum(yh, yl, h, e)
    return locate(there, xh, xl, yh, yl)


@exact
def on_line(sheet: Packed, f: int, of: int, i: float, j: float, x: float, y: float) -> bool:
    """Whether a point of face f, given in the cells of array `of`, lies on its opaque line, if it has one."""
    lat = sheet.lattice
    if lat[slot.LINED] != f:
        return False
    array = int(lat[slot.LINE_ARRAY])
    i, j, x, y = into_array(sheet, sheet.own, of, array, i, j, x, y)
    inside = in_zone(sheet.lattices[array], x, y, lat[slot.LINE])
    return kept(lat, sheet.rows, i, j) and not inside


@exact
def in_plate(edges: Floats, x: float, y: float) -> bool:
    """Whether a point is in the material that edges (e, EDGE_NUMBERS) bound (`sheet.plate_edges.inside`)."""
    found = False
    for n in range(len(edges)):
        low, high = edges[n, Y0] <= y, edges[n, Y1] <= y
        sense = edges[n, SENSE]
        if low == high and sense == 0.0:
            continue
        left = _left(edges, n, x, y)
        if low != high and (left == low):
            found = not found
        if sense != 0.0 and left == (sense < 0.0):
            u, v = x - edges[n, CX], y - edges[n, CY]
            if u * u + v * v < edges[n, RADIUS] * edges[n, RADIUS]:
                found = not found
    return found


@exact
def next_edge(edges: Floats, x: float, y: float, L: float, M: float, after: float) -> float:
    """Least distance beyond `after` at which a ray's projection crosses an edge; inf for none."""
    nearest = inf
    for n in range(len(edges)):
        u, v = edges[n, X1] - edges[n, X0], edges[n, Y1] - edges[n, Y0]
        px, py = x - edges[n, X0], y - edges[n, Y0]
        if edges[n, SENSE] == 0.0:
            speed = u * M - v * L
            if speed == 0.0:
                continue
            t = -(u * py - v * px) / speed
            along = (px + t * L) * u + (py + t * M) * v
            if after < t < nearest and 0.0 <= along <= u * u + v * v:
                nearest = t
            continue
        px, py = x - edges[n, CX], y - edges[n, CY]
        square, half = L * L + M * M, px * L + py * M
        rest = px * px + py * py - edges[n, RADIUS] * edges[n, RADIUS]
        disc = half * half - square * rest
        if square == 0.0 or not disc >= 0.0:
            continue
        q = -(half + copysign(sqrt(disc), half))
        for k in range(2):
            if k == 0 and q == 0.0:
                continue
            t = rest / q if k == 0 else q / square
            if after < t < nearest and _left(edges, n, x + t * L, y + t * M) == (edges[n, SENSE] < 0.0):
                nearest = t
    return nearest


@exact
def _left(edges: Floats, n: int, x: float, y: float) -> bool:
    """Whether a point lies to the left of the chord of an edge."""
    return bool(
        (edges[n, X1] - edges[n, X0]) * (y - edges[n, Y0])
        > (edges[n, Y1] - edges[n, Y0]) * (x - edges[n, X0])
    )


CLEAR = 2.0**-44
"""Share of half a cell: closer to a border no cell is decided here; 100 times the rounding of both paths."""


@exact
def carry_own(
    lattices: Floats, s: Floats, m: int, level: float, index: float, arrays: tuple[int, int], origin: Vector
) -> None:
    """Carry rays to a level and into the cells of the array there; see `straight_path.carry`.

    Cells of equal index in two arrays lie index times the pitch difference apart, exact where the pitches are
    equal. Products and sums are kept in pairs.
    """
    z, dx, dy, dz, path = lanes(s, (Z, DX, DY, DZ, PATH))
    ox, oy, oz = origin
    rise = level - oz
    here, there = lattices[arrays[0]], lattices[arrays[1]]
    x, y, xl, yl, ci, cj = lanes(s, (X, Y, XL, YL, CI, CJ))
    for i in range(m):
        t = (rise - z[i]) / dz[i]
        x[i], y[i] = x[i] + ox + t * dx[i], y[i] + oy + t * dy[i]
        z[i] = level
        path[i] += index * t
    one, two, of, to = grid_of(here), grid_of(there), slot.SHIFT + 2 * arrays[0], slot.SHIFT + 2 * arrays[1]
    for i in range(m):
        xl[i], yl[i] = steps_to(one, ci[i], cj[i])
    _apart(x, xl, m, two_sum(one.pitch, -two.pitch), _beside(one.x0, two.x0, here[of], here[to]))
    _apart(y, yl, m, two_sum(one.row, -two.row), _beside(one.y0, two.y0, here[of + 1], here[to + 1]))
    if here[slot.HEXAGONAL] != 0.0:
        _into_hexagons(there, s, m)
        return
    _into_squares(x, xl, ci, lane(s, GOOD), m, two.pitch)
    _into_squares(y, yl, cj, lane(s, GOOD), m, two.row)


@exact
def _beside(first: float, second: float, shift: float, other: float) -> tuple[float, float]:
    """Displacement between two arrays, as a pair, from the first position and the shift of each."""
    h, e = two_sum(first, -second)
    a, b = two_sum(shift, -other)
    return pair_sum(h, e, a, b)


@exact
def _apart(x: Floats, steps: Floats, m: int, pitch: tuple[float, float], shift: tuple[float, float]) -> None:
    """Add steps · pitch + shift to x; `steps` receives the rounding error."""
    (ph, pl), (ch, cl) = pitch, shift
    for i in range(m):
        k = steps[i]
        h = k * ph
        low = multiply_add(k, ph, -h) + k * pl
        h, e = two_sum(h, ch)
        x[i], f = two_sum(h, x[i])
        steps[i] = (low + cl) + (e + f)


@exact
def _into_squares(x: Floats, low: Floats, cell: Floats, good: Floats, m: int, pitch: float) -> None:
    per_pitch, half = 1.0 / pitch, 0.5 * pitch * (1.0 - CLEAR)
    for i in range(m):
        a = np.floor(x[i] * per_pitch + 0.5)
        u = multiply_add(-a, pitch, x[i]) + low[i]
        x[i] = u
        cell[i] += a
        good[i] = least(good[i], half - abs(u))


@exact
def _into_hexagons(lat: Floats, s: Floats, m: int) -> None:
    x, y, xl, yl, ci, cj, good = lanes(s, (X, Y, XL, YL, CI, CJ, GOOD))
    pitch, row = lat[slot.PITCH], lat[slot.ROW]
    per_pitch, per_row, half, slant = 1.0 / pitch, 1.0 / row, 0.5 * pitch, row / pitch
    clear = half * (1.0 - CLEAR)
    for i in range(m):
        b = np.floor(y[i] * per_row + 0.5)
        a = np.floor(x[i] * per_pitch - 0.5 * b + 0.5)
        u, v = x[i] - (a + 0.5 * b) * pitch, y[i] - b * row
        i_step, j_step = hexagon_steps(u, v, half, slant, 0.5)
        a, b = a + i_step, b + j_step
        u = multiply_add(-(a + 0.5 * b), pitch, x[i]) + xl[i]
        v = multiply_add(-b, row, y[i]) + yl[i]
        x[i], y[i] = u, v
        ci[i] += a
        cj[i] += b
        one, two, three = abs(u), abs(0.5 * u + slant * v), abs(0.5 * u - slant * v)
        good[i] = least(least(good[i], clear - one), least(clear - two, clear - three))


@exact
def to_own_lens(sheet: Packed, own: OwnCells, f: int, s: Floats, m: int, offset: Vector) -> None:
    """Transform rays to the lens of each ray's own cell, where lenses vary from cell to cell.

    Positions plus the offset are relative to the face's vertex; lengths are in units of the lens's size.
    Lenses with frames of their own: see `meet_framed`.
    """
    if own.change[f, slot.CHANGES] == 0.0 or framed(own, f):
        return
    x, y, ax, ay, ci, cj = lanes(s, (X, Y, AX, AY, CI, CJ))
    grid, gradient = grid_of(sheet.lattice), gradient_of(own, f)
    for i in range(m):
        ax[i], ay[i] = times_gradient(gradient, centre_of(grid, ci[i], cj[i]))
    which = int(own.change[f, slot.TABLE])
    if which >= 0:
        _add_tabled(sheet, own.table[which], s, m)
    if _level(own, f):
        for i in range(m):
            x[i], y[i] = x[i] - ax[i], y[i] - ay[i]
        return
    _look_up_sizes(sheet, own, f, s, m)
    z, path, size = lanes(s, (Z, PATH, SIZE))
    rise_x, rise_y = own.change[f, slot.RISE_X], own.change[f, slot.RISE_Y]
    ox, oy, oz = offset
    for i in range(m):
        rise = ax[i] * rise_x + ay[i] * rise_y
        x[i] = (x[i] + ox - ax[i]) / size[i] - ox
        y[i] = (y[i] + oy - ay[i]) / size[i] - oy
        z[i] = (z[i] + oz - rise) / size[i] - oz
        path[i] /= size[i]


@inlined
def _level(own: OwnCells, f: int) -> bool:
    """Whether the lenses of a face have one height and one size."""
    change = own.change
    level = change[f, slot.RISE_X] == 0.0 and change[f, slot.RISE_Y] == 0.0
    return bool(level and change[f, slot.SIZES] < 0.0)


@exact
def _look_up_sizes(sheet: Packed, own: OwnCells, f: int, s: Floats, m: int) -> None:
    """Size of the lens of each ray's cell."""
    for i in range(m):
        s[SIZE, i] = own_size(sheet, own, f, s[CI, i], s[CJ, i]) if s[GOOD, i] > 0.0 else 1.0


@exact
def _add_tabled(sheet: Packed, table: Floats, s: Floats, m: int) -> None:
    """Add the tabulated part of the lens offsets; GOOD rays are in kept cells."""
    ax, ay, ci, cj, good = lanes(s, (AX, AY, CI, CJ, GOOD))
    for i in range(m):
        kept = good[i] > 0.0
        a, b = ci[i] if kept else 0.0, cj[i] if kept else 0.0
        place = place_in_row(sheet.lattice, a, b)
        ax[i] += table[place, int(b), 0]
        ay[i] += table[place, int(b), 1]


@exact
def from_own_lens(own: OwnCells, f: int, s: Floats, m: int, offset: Vector) -> None:
    """Undo `to_own_lens`."""
    if own.change[f, slot.CHANGES] == 0.0 or framed(own, f):
        return
    x, y, ax, ay = lanes(s, (X, Y, AX, AY))
    if _level(own, f):
        for i in range(m):
            x[i], y[i] = x[i] + ax[i], y[i] + ay[i]
        return
    z, path, size = lanes(s, (Z, PATH, SIZE))
    rise_x, rise_y = own.change[f, slot.RISE_X], own.change[f, slot.RISE_Y]
    ox, oy, oz = offset
    for i in range(m):
        x[i] = (x[i] + ox) * size[i] + ax[i] - ox
        y[i] = (y[i] + oy) * size[i] + ay[i] - oy
        z[i] = (z[i] + oz) * size[i] + (ax[i] * rise_x + ay[i] * rise_y) - oz
        path[i] *= size[i]


@inlined
def meet_framed(
    own: OwnCells | None, sheet: Packed, f: int, s: Floats, m: int, index: float, offset: Vector
) -> None:
    """Carry rays to the lens of each ray's own cell, where lenses have frames of their own."""
    if own is not None:
        _meet_in_frames(own.frame, own, sheet, f, s, m, index, offset)


@exact
def _meet_in_frames(
    frames: Floats | None,
    own: OwnCells,
    sheet: Packed,
    f: int,
    s: Floats,
    m: int,
    index: float,
    offset: Vector,
) -> None:
    """Carry to positions relative to the face's vertex, which the offset is not part of; normals are kept."""
    if frames is None:
        return
    faces, (ox, oy, oz) = sheet.faces, offset
    rise_x, rise_y = own.change[f, slot.RISE_X], own.change[f, slot.RISE_Y]
    for i in range(m):
        if not s[GOOD, i] > 0.0:
            continue
        ax, ay = own_offset(sheet, own, f, s[CI, i], s[CJ, i])
        az = ax * rise_x + ay * rise_y + own_frame(frames, sheet, own, f, s[CI, i], s[CJ, i])
        size = own_size(sheet, own, f, s[CI, i], s[CJ, i])
        x, y, z = (s[X, i] + ox - ax) / size, (s[Y, i] + oy - ay) / size, (s[Z, i] + oz - az) / size
        x, y, z = to_lens(faces, f, x, y, z)
        u, v, w = to_lens(faces, f, s[DX, i], s[DY, i], s[DZ, i])
        t, x, y, z, gx, gy, gz, s[ROOT, i] = meet(faces, f, x, y, z, u, v, w)
        x, y, z = to_sheet(faces, f, x, y, z)
        gx, gy, gz = to_sheet(faces, f, gx, gy, gz)
        s[X, i], s[Y, i], s[Z, i] = size * x + ax, size * y + ay, size * z + az
        s[GX, i], s[GY, i], s[GZ, i] = gx, gy, gz
        s[PATH, i] += index * (size * t)
        if not gz > 0.0:
            s[GOOD, i] = 0.0
