"""Straight through sheets whose cells differ, compiled: the twin of `reference.surfaces` for arrays of own pitch and place.

A kernel of its own, one ray at a time: sheets of equal cells load nothing of it. Rays for which a straight trace does not
hold are left to numpy's walk, as are bodies that a lens does not cover.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import NamedTuple

import numpy as np

from clacad.base.compiled import entry, exact
from clacad.base.compiled_pairs import pair_sum, two_product, two_sum
from clacad.base.types import Floats, Ints, Rows
from clacad.optics.rays import Fate, Rays
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.cells import in_zone, kept, locate, relocate, sheet_xy, to_array
from clacad.tracing.compiled.face import meet, snell, to_lens, to_sheet
from clacad.tracing.compiled.launch import launch_ray
from clacad.tracing.compiled.packing import Packed, pack_array_1
from clacad.tracing.compiled.records import Outcome
from clacad.tracing.compiled.threads import in_arrays, over_threads
from clacad.tracing.layout import Layout
from clacad.tracing.ledger import Ledger
from clacad.tracing.reference.surfaces import BEHIND

ALIVE, GHOST = int(Fate.ALIVE), int(Fate.GHOST)

# Columns of a face's row in `OwnCells.change`.
CHANGES, XX, XY, YX, YY, TABLE = range(6)


class OwnCells(NamedTuple):
    """Where the cells of every array stand, and the lens in each.

    lattices : (arrays, LATTICE_NUMBERS)
        The packed lattice with each array's own pitch, origin and half widths.
    change : (faces, 6)
        Whether lenses stand elsewhere in each cell, the gradient row by row, and which table (−1: none).
    table : (tables, n1, n2, 2) lengths
    """

    lattices: Floats
    change: Floats
    table: Floats


class OwnRay(NamedTuple):
    """A ray in a cell of an array: point from the cell's centre and the body's level, direction."""

    array: int
    i: float
    j: float
    x: float
    y: float
    z: float
    L: float
    M: float
    N: float


def pack_own(layout: Layout) -> OwnCells:
    """Pack what differs from cell to cell; kept with the layout."""
    made: OwnCells | None = layout.kept.get("own_cells")
    if made is None:
        made = layout.kept["own_cells"] = _pack_own(layout)
    return made


def _pack_own(layout: Layout) -> OwnCells:
    base = slot.lattice_row(layout)
    rows: list[Floats] = []
    tables: list[Floats] = []
    for array, lattice in enumerate(layout.lattices):
        row = base.copy()
        row[slot.PITCH], row[slot.ROW] = lattice.pitch[0], lattice.row_height
        row[slot.X0], row[slot.Y0] = lattice.first_centre
        row[slot.HALF : slot.HALF + len(layout.halves)] = layout.widths[array]
        row[slot.REACH] = lattice.circumradius
        rows.append(row)
    change = []
    for body in layout.bodies:
        for face in (body.front, body.back):
            one = [0.0, 0.0, 0.0, 0.0, 0.0, -1.0]
            if face.change is not None:
                one[:5] = [1.0, *np.ravel(face.change.gradient).tolist()]
                if face.change.table is not None:
                    one[TABLE] = float(len(tables))
                    tables.append(face.change.table)
            change.append(one)
    table = np.array(tables) if tables else np.zeros((0, 1, 1, 2))
    return OwnCells(np.array(rows), np.array(change), np.ascontiguousarray(table))


@exact
def _apex(own: OwnCells, rows: Ints, f: int, i: float, j: float) -> tuple[float, float]:
    """How far the lens of a cell stands from the face's vertex; see `VertexChange.at`."""
    change, lat = own.change, own.lattices[0]
    if change[f, CHANGES] == 0.0:
        return 0.0, 0.0
    if lat[slot.HEXAGONAL] != 0.0:
        x, y = lat[slot.X0] + (i + 0.5 * j) * lat[slot.PITCH], lat[slot.Y0] + j * lat[slot.ROW]
    else:
        x = (2.0 * i - (lat[slot.N1] - 1.0)) * (0.5 * lat[slot.PITCH])
        y = (2.0 * j - (lat[slot.N2] - 1.0)) * (0.5 * lat[slot.ROW])
    ax, ay = change[f, XX] * x + change[f, XY] * y, change[f, YX] * x + change[f, YY] * y
    which = int(change[f, TABLE])
    if which >= 0 and kept(lat, rows, i, j):
        place = int(i) + int(j) // 2 if lat[slot.HEXAGONAL] != 0.0 else int(i)
        ax, ay = ax + own.table[which, place, int(j), 0], ay + own.table[which, place, int(j), 1]
    return ax, ay


@exact
def _into(own: OwnCells, ray: OwnRay, array: int) -> OwnRay:
    """The same ray in the cells of another array, or of its own where it has left its cell; see `launch.cell_in`."""
    of, i, j, x, y, z, L, M, N = ray
    here, there = own.lattices[of], own.lattices[array]
    if of == array:
        di, dj, x, y = relocate(there, x, y)
        return OwnRay(array, i + di, j + dj, x, y, z, L, M, N)
    if here[slot.PITCH] == there[slot.PITCH] and here[slot.ROW] == there[slot.ROW]:
        i, j, x, y = to_array(there, of, array, i, j, x, y)
        return OwnRay(array, i, j, x, y, z, L, M, N)
    if here[slot.HEXAGONAL] != 0.0:
        xh, xl = two_product(i + 0.5 * j, here[slot.PITCH])
        xh, xl = pair_sum(xh, xl, here[slot.X0], 0.0)
        yh, yl = two_product(j, here[slot.ROW])
        yh, yl = pair_sum(yh, yl, here[slot.Y0], 0.0)
    else:
        xh, xl = two_product(2.0 * i - (here[slot.N1] - 1.0), 0.5 * here[slot.PITCH])
        yh, yl = two_product(2.0 * j - (here[slot.N2] - 1.0), 0.5 * here[slot.ROW])
    xh, xl = pair_sum(xh, xl, x, 0.0)
    yh, yl = pair_sum(yh, yl, y, 0.0)
    h, e = two_sum(here[slot.SHIFT + 2 * of], -here[slot.SHIFT + 2 * array])
    xh, xl = pair_sum(xh, xl, h, e)
    h, e = two_sum(here[slot.SHIFT + 2 * of + 1], -here[slot.SHIFT + 2 * array + 1])
    yh, yl = pair_sum(yh, yl, h, e)
    i, j, x, y = locate(there, xh, xl, yh, yl)
    return OwnRay(array, i, j, x, y, z, L, M, N)


@exact
def _at(ray: OwnRay, z: float) -> tuple[float, float]:
    """Where a ray crosses a plane, still seen from its cell."""
    t = (z - ray.z) / ray.N
    return ray.x + t * ray.L, ray.y + t * ray.M


@exact
def _through(
    sheet: Packed, own: OwnCells, f: int, ray: OwnRay, n1: float, n2: float
) -> tuple[bool, float, OwnRay]:
    """Cross one face: whether the ray met the lens itself, upright, in its zone, how far that is, and the ray behind it."""
    faces = sheet.faces
    ax, ay = _apex(own, sheet.rows, f, ray.i, ray.j)
    vx, vy, vz = faces[f, slot.VX] + ax, faces[f, slot.VY] + ay, faces[f, slot.VZ]
    u, v, w = to_lens(faces, f, ray.x - vx, ray.y - vy, ray.z - vz)
    L, M, N = to_lens(faces, f, ray.L, ray.M, ray.N)
    t, px, py, pz, gx, gy, gz, root = meet(faces, f, u, v, w, L, M, N)
    if not isfinite(t) or (faces[f, slot.TURNED] != 0.0 and not to_sheet(faces, f, gx, gy, gz)[2] > 0.0):
        return False, t, ray
    a, b, c = snell((L, M, N), (gx, gy, gz), root, n1, n2)
    a, b, c = to_sheet(faces, f, a, b, c)
    px, py, pz = to_sheet(faces, f, px, py, pz)
    x, y, z = px + vx, py + vy, pz + vz
    good = c > 0.0
    if faces[f, slot.ARRAY] >= 0.0:
        good = good and in_zone(own.lattices[ray.array], x, y, sheet.lattice[slot.MARGIN])
    land = faces[f, slot.LAND]
    if faces[f, slot.WHOLE] == 0.0 and land == land:
        good = good and (z - land) * faces[f, slot.SIDE] <= 0.0
    return good, t, OwnRay(ray.array, ray.i, ray.j, x, y, z, a, b, c)


@exact
def _over_body(body: Floats, own: OwnCells, ray: OwnRay) -> bool:
    """Whether a ray is certainly over the body."""
    x, y = sheet_xy(own.lattices[ray.array], ray.array, ray.i, ray.j, ray.x, ray.y)
    x, y, radius = x - body[slot.MID_X], y - body[slot.MID_Y], body[slot.INNER_R]
    inside = abs(x) < body[slot.INNER_X] and abs(y) < body[slot.INNER_Y]
    return bool(inside and x * x + y * y < radius * radius and radius > 0.0)


@exact
def _structured(
    sheet: Packed, own: OwnCells, f: int, level: float, ray: OwnRay
) -> tuple[bool, float, OwnRay]:
    """Into the cell of a face where its lenses begin; whether that is kept and the ray steep enough, and how far it is."""
    face = sheet.faces[f]
    t = (level - ray.z) / ray.N
    x, y = _at(ray, level)
    at = OwnRay(ray.array, ray.i, ray.j, x, y, level, ray.L, ray.M, ray.N)
    at = _into(own, at, int(face[slot.ARRAY]))
    good = kept(sheet.lattice, sheet.rows, at.i, at.j) and at.N >= face[slot.CLIMB]
    return good, t, at


@exact
def _stays(sheet: Packed, own: OwnCells, f: int, level: float, margin: float, ray: OwnRay) -> bool:
    """Whether a ray behind a face is steep enough, and in its cell still at a level."""
    x, y = _at(ray, level)
    return bool(ray.N >= sheet.faces[f, slot.CLIMB] and in_zone(own.lattices[ray.array], x, y, margin))


@entry
def own_chunk(
    sheet: Packed, own: OwnCells, chosen: Rows, position: Floats, direction: Floats, out: Outcome, left: Rows
) -> int:
    """Trace rays straight through and write the rows of those for which that holds; put the others into `left`.

    Returns
    -------
    int
        How many were left.
    """
    bodies, margin, count = sheet.bodies, sheet.lattice[slot.MARGIN], 0
    for k in range(len(chosen)):
        row = chosen[k]
        good, launched = launch_ray(sheet, position, direction, row)
        gap = launched.carried
        ray = OwnRay(
            0, launched.i, launched.j, launched.x, launched.y, launched.z, launched.L, launched.M, launched.N
        )
        path, met, fi, fj, li, lj, oi, oj = 0.0, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        good = good and ray.N > 0.0
        for b in range(len(bodies)):
            if not good:
                break
            body, index, columnar = bodies[b], sheet.indices[b], bodies[b, slot.COLUMNAR] != 0.0
            good = body[slot.COVERED] != 0.0
            if b:
                level = ray.z - (body[slot.LEVEL] - bodies[b - 1, slot.LEVEL])
                gap = (body[slot.BODY_LOW] - level) / ray.N
                x, y = ray.x + gap * ray.L, ray.y + gap * ray.M
                ray = OwnRay(ray.array, ray.i, ray.j, x, y, body[slot.BODY_LOW], ray.L, ray.M, ray.N)
            if good:
                ray = _into(own, ray, int(body[slot.ENTRY]))
            for side in range(2):
                f = 2 * b + side
                face = sheet.faces[f]
                lens = face[slot.ARRAY] >= 0.0
                before, step = 0.0, 0.0
                if good and lens and not columnar:
                    good, before, ray = _structured(sheet, own, f, face[slot.LOW], ray)
                    good = good and in_zone(own.lattices[ray.array], ray.x, ray.y, margin)
                elif good and lens and side == 0:
                    good = kept(sheet.lattice, sheet.rows, ray.i, ray.j) and ray.N >= face[slot.CLIMB]
                if good:
                    n1, n2 = (1.0, index) if side == 0 else (index, 1.0)
                    good, step, ray = _through(sheet, own, f, ray, n1, n2)
                if good and columnar and side == 0:
                    good = ray.N >= max(face[slot.CLIMB], sheet.faces[f + 1, slot.CLIMB])
                elif good and columnar:
                    good = _stays(sheet, own, f, body[slot.BODY_HIGH], 0.0, ray)
                elif good:
                    good = _over_body(body, own, ray)
                    good = good and (not lens or _stays(sheet, own, f, face[slot.HIGH], margin, ray))
                step += before
                if side == 0:
                    first = gap + step
                    if b == 0:
                        good = good and first >= -BEHIND * (abs(gap) + abs(step))
                    path += first
                else:
                    path += index * step
                if lens:
                    if met == 0:
                        fi, fj = ray.i, ray.j
                    elif oi == 0.0 and oj == 0.0:
                        oi, oj = ray.i - fi, ray.j - fj
                    li, lj, met = ray.i, ray.j, met + 1
        if not good:
            left[count] = row
            count += 1
            continue
        if li != fi or lj != fj:
            oi, oj = li - fi, lj - fj
        last = len(bodies) - 1
        x, y = sheet_xy(own.lattices[ray.array], ray.array, ray.i, ray.j, ray.x, ray.y)
        out.position[row, 0], out.position[row, 1] = x, y
        out.position[row, 2] = ray.z + bodies[last, slot.LEVEL]
        out.direction[row, 0], out.direction[row, 1], out.direction[row, 2] = ray.L, ray.M, ray.N
        out.path[row], out.surface[row] = path, 2 * last + 1
        out.cell[row, 0], out.cell[row, 1] = np.int32(fi), np.int32(fj)
        out.order[row, 0], out.order[row, 1] = np.int32(oi), np.int32(oj)
        out.fate[row] = ALIVE if oi == 0.0 and oj == 0.0 else GHOST
    return count


def trace_own(
    layout: Layout, rays: Rays, ledger: Ledger, rows: Rows, indices: Sequence[float], threads: int
) -> Rows:
    """Trace the rays `rows` straight through, write those for which that holds, and give the rows of the others.

    indices : refractive index of each body
    """
    sheet = pack_array_1(layout)._replace(indices=np.asarray(indices, dtype=np.float64))
    own, (position, direction, out) = pack_own(layout), in_arrays(rays, ledger)

    def one(chosen: Rows) -> Rows:
        left = np.empty_like(chosen)
        return left[: own_chunk(sheet, own, chosen, position, direction, out, left)]

    return np.concatenate(over_threads(one, rows, threads))
