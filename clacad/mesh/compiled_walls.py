"""Walls of many regular cells, compiled: `clacad.mesh.cell_triangulation.strip` for cells in arrays.

A column is (front level, back level), with VOID in place of a column that does not exist. Around a point of a
side lie the cell's column and its neighbour's; around a node those of all its cells, in canonical order.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clacad.base.compiled import entry, exact
from clacad.base.types import Bools, Floats, Ints

VOID = 2**61
"""Front level of a column that does not exist."""

ROOM = 64
"""Triangles that one edge of the footprint may have."""

Scratch = NDArray[np.int64]


class Edges(NamedTuple):
    """Edges of the footprint of every regular cell at which a wall is possible.

    sides : (m, s) int64. Points of each side; side k has `segments[k]` segments.
    segments : (m,) int64
    inner : (e, 3) int64
        Edges between lens and land: first point, second point, whether the lens is on the left.
    places : (m, 3) int64. Place of the cell among those around each of its corners; then the places of the
        neighbour across side k at the side's start and end.
    land : (2,) int64
    """

    sides: Ints
    segments: Ints
    inner: Ints
    places: Ints
    land: Ints


class CellColumns(NamedTuple):
    """CellColumns of n cells.

    own : (n, p, 2) int64. At each point of the footprint.
    there : (n, m, s, 2) int64. Of the neighbour across each side, in the cell's direction.
    nodes : (n, m, c, 2) int64. Of all cells around each corner.
    drawn : (n, m) bool. Whether the cell has the wall over the side.
    """

    own: Ints
    there: Ints
    nodes: Ints
    drawn: Bools


@exact
def _ring_levels(ring: Ints, count: int, out: Ints) -> int:
    """Write the distinct levels of the columns around a point, ascending; their number."""
    found = 0
    for c in range(count):
        if ring[c, 0] == VOID:
            continue
        for face in range(2):
            level = ring[c, face]
            at = found
            while at > 0 and out[at - 1] > level:
                at -= 1
            if at > 0 and out[at - 1] == level:
                continue
            for move in range(found, at, -1):
                out[move] = out[move - 1]
            out[at] = level
            found += 1
    return found


@exact
def _covers(ring: Ints, c: int, low: int, high: int) -> bool:
    """Whether a column covers all levels from low to high."""
    return bool(ring[c, 0] != VOID and ring[c, 0] <= low and ring[c, 1] >= high)


@exact
def _run(ring: Ints, count: int, low: int, high: int, at: int) -> int:
    """Number of the run of adjacent columns that cover [low, high] and contain column `at`."""
    number = 0
    for first in range(count):
        if not _covers(ring, first, low, high) or _covers(ring, (first + count - 1) % count, low, high):
            continue
        c = first
        while _covers(ring, c % count, low, high):
            if c % count == at:
                return number
            c += 1
        number += 1
    return 0


@exact
def _chain(ring: Ints, count: int, low: int, high: int, at: int, work: Scratch, out: Ints) -> int:
    """Write the levels of the vertices of a wall's vertical edge, from low to high; their number."""
    out[0] = low
    if low == high:
        return 1
    found, made, below = _ring_levels(ring, count, work), 1, low
    for n in range(found + 1):
        above = high
        if n < found:
            above = work[n]
            if above <= low or above >= high:
                continue
        run = _run(ring, count, below, above, at)
        if run > 0:
            out[made] = below + (above - below) // (run + 1)
            made += 1
        out[made] = above
        made += 1
        below = above
    return made


@exact
def _lines(columns: Ints, lines: Ints) -> int:
    """Write fronts and backs of both columns, ascending: level at p, level at q, column, 1 for a front."""
    found = 0
    for which in range(2):
        p, q = columns[2 * which], columns[2 * which + 1]
        if p[0] == VOID or q[0] == VOID or (p[0] == p[1] and q[0] == q[1]):
            continue
        for face in range(2):
            total = p[face] + q[face]
            at = found
            while at > 0:
                before = lines[at - 1, 0] + lines[at - 1, 1]
                if before < total or (before == total and lines[at - 1, 3] >= 1 - face):
                    break
                at -= 1
            for move in range(found, at, -1):
                for n in range(4):
                    lines[move, n] = lines[move - 1, n]
            lines[at, 0], lines[at, 1], lines[at, 2], lines[at, 3] = p[face], q[face], which, 1 - face
            found += 1
    return found


@exact
def _zip(p: int, q: int, chains: Ints, counts: Ints, flipped: bool, out: Ints, used: int) -> int:
    """Write the triangles between two upward chains at p and q, p on the left seen from outside."""
    i = j = 0
    while i < counts[0] - 1 or j < counts[1] - 1:
        out[used, 0, 0], out[used, 0, 1] = p, chains[0, i]
        out[used, 1, 0], out[used, 1, 1] = q, chains[1, j]
        if j == counts[1] - 1 or (i < counts[0] - 1 and chains[0, i + 1] <= chains[1, j + 1]):
            i += 1
            out[used, 2, 0], out[used, 2, 1] = p, chains[0, i]
        else:
            j += 1
            out[used, 2, 0], out[used, 2, 1] = q, chains[1, j]
        if flipped:
            for n in range(2):
                out[used, 1, n], out[used, 2, n] = out[used, 2, n], out[used, 1, n]
        used += 1
    return used


@exact
def _strip(p: int, q: int, at: Ints, counts: Ints, rings: Ints, work: Any, out: Ints, used: int) -> int:
    """Write the wall over the edge p → q; −1 if two heights cross inside the edge.

    at : (2, 2) places of left and right column around p and q; counts : columns around p and q
    """
    columns, lines, chains, levels, lengths = work
    found = _lines(columns, lines)
    solid_left = solid_right = 0
    for n in range(found - 1):
        step = 1 if lines[n, 3] else -1
        if lines[n, 2] == 0:
            solid_left += step
        else:
            solid_right += step
        below, above = lines[n], lines[n + 1]
        if (solid_left > 0) == (solid_right > 0) or (below[0] == above[0] and below[1] == above[1]):
            continue
        if below[0] > above[0] or below[1] > above[1]:
            return -1
        which = 0 if solid_left > 0 else 1
        for end in range(2):
            lengths[end] = _chain(
                rings[end], counts[end], below[end], above[end], at[which, end], levels, chains[end]
            )
        used = _zip(p, q, chains, lengths, which == 1, out, used)
    return used


@entry
def join_walls(chosen: Ints, cells: CellColumns, edges: Edges, work: Any, first: Ints, out: Ints) -> int:
    """Write the walls of the chosen cells into `out` (t, 3, 2): point and level of each corner.

    first : (n + 1,). Receives the first triangle of each chosen cell.

    Returns their number, −1 if two heights cross inside an edge, −2 if `out` is too small.
    """
    columns, rings, at, counts, rest = work
    used = 0
    for number in range(len(chosen)):
        i, first[number] = chosen[number], used
        own, there, nodes = cells.own[i], cells.there[i], cells.nodes[i]
        for e in range(len(edges.inner)):
            if used + ROOM > len(out):
                return -2
            lens = 0 if edges.inner[e, 2] else 1
            for end in range(2):
                point = edges.inner[e, end]
                counts[end] = 2
                for face in range(2):
                    rings[end, 0, face] = columns[2 * lens + end, face] = own[point, face]
                    rings[end, 1, face] = columns[2 - 2 * lens + end, face] = edges.land[face]
                at[lens, end], at[1 - lens, end] = 0, 1
            used = _strip(edges.inner[e, 0], edges.inner[e, 1], at, counts, rings, rest, out, used)
            if used < 0:
                return -1
        for k in range(len(edges.sides)):
            if not cells.drawn[i, k]:
                continue
            last = edges.segments[k]
            for s in range(last):
                if used + ROOM > len(out):
                    return -2
                same = True
                for end in range(2):
                    point = edges.sides[k, s + end]
                    counts[end], at[0, end], at[1, end] = 2, 0, 1
                    for face in range(2):
                        rings[end, 0, face] = columns[end, face] = own[point, face]
                        rings[end, 1, face] = columns[2 + end, face] = there[k, s + end, face]
                        same = same and columns[end, face] == columns[2 + end, face]
                if same:
                    continue
                for end in range(2):
                    if s + end == end * last:  # a node
                        corner = (k + end) % len(edges.sides)
                        counts[end] = nodes.shape[1]
                        for c in range(counts[end]):
                            rings[end, c, 0], rings[end, c, 1] = nodes[corner, c, 0], nodes[corner, c, 1]
                        at[0, end], at[1, end] = edges.places[corner, 0], edges.places[k, 1 + end]
                used = _strip(edges.sides[k, s], edges.sides[k, s + 1], at, counts, rings, rest, out, used)
                if used < 0:
                    return -1
    first[len(chosen)] = used
    return used


@entry
def place_corners(
    chosen: Ints, caps: Ints, own: Ints, xy: Floats, walls: Ints, wanted: Any, found: Any
) -> None:
    """Write the corners of the triangles of the chosen cells: caps, then walls.

    caps : (t, 3, 3) int64. Point, face, and constant level of each corner; face 2: the constant level.
    own, xy : CellColumns (n, p, 2) and positions (n, p, 2) of the points of all cells.
    walls : (w, 3, 2). As from `join_walls`.
    wanted : (first, start, step)
        First wall of each chosen cell (n + 1,); its first triangle in `found`; height of a level.
    found : (corners (t, 3, 3), points (t, 3), levels (t, 3))
        Receive lengths, the point of each corner and its level.
    """
    first, start, step = wanted
    corners, points, levels = found
    for number in range(len(chosen)):
        i, at = chosen[number], start[number]
        count = len(caps) + first[number + 1] - first[number]
        for t in range(count):
            for c in range(3):
                if t < len(caps):
                    point, face = caps[t, c, 0], caps[t, c, 1]
                    level = own[i, point, face] if face < 2 else caps[t, c, 2]
                else:
                    wall = first[number] + t - len(caps)
                    point, level = walls[wall, c, 0], walls[wall, c, 1]
                points[at + t, c], levels[at + t, c] = point, level
                corners[at + t, c, 0], corners[at + t, c, 1] = xy[i, point, 0], xy[i, point, 1]
                corners[at + t, c, 2] = level * step


@entry
def corner_normals(corners: Floats, exact: Floats, which: Ints, out: Floats) -> None:
    """Write unit normals at the corners of triangles (t, 3, 3): the exact ones (m, 3) of rows `which` (t, 3),
    where they are numbers, else those of the triangles; (0, 0, 1) for one without area.
    """
    for t in range(len(corners)):
        ux, uy, uz = corners[t, 1, 0], corners[t, 1, 1], corners[t, 1, 2]
        vx, vy, vz = corners[t, 2, 0], corners[t, 2, 1], corners[t, 2, 2]
        ux, uy, uz = ux - corners[t, 0, 0], uy - corners[t, 0, 1], uz - corners[t, 0, 2]
        vx, vy, vz = vx - corners[t, 0, 0], vy - corners[t, 0, 1], vz - corners[t, 0, 2]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = np.sqrt((x * x + y * y) + z * z)
        flat = not length > 0.0
        length = 1.0 if flat else length
        for c in range(3):
            out[t, c, 0], out[t, c, 1], out[t, c, 2] = x / length, y / length, z / length
            if flat:
                out[t, c, 0], out[t, c, 1], out[t, c, 2] = 0.0, 0.0, 1.0
            row = which[t, c]
            for axis in range(3):
                if row >= 0 and not np.isnan(exact[row, axis]):
                    out[t, c, axis] = exact[row, axis]
