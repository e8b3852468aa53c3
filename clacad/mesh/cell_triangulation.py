"""Triangulations of one cell's footprint: the regular grid, border points, cuts along a curve.

All triangles are counter-clockwise seen from +z. `sides[k]` lists the points of side k of the tile
in order, from corner k to corner k + 1 inclusive.

Walls: height ranges that one column covers and its neighbour does not, over each edge of the footprint.

At a point of the footprint, the wedges around it are columns (front level, back level). Walls meet
there in vertical edges between consecutive levels. Where more than one column touches along such an
edge (a saddle), every column but the first gets its own vertices in between: no edge is used by
four faces and no point of the surface moves.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from clacad.base.arrays import unique_rows
from clacad.base.types import Bools, Floats, Ints
from clacad.sheet.grid_steps import half_axes
from clacad.sheet.lattice import Lattice
from clacad.topology.complex_parts import BorderCurve, runs_round, solid_strips

Tags = TypeVar("Tags", NDArray[np.bool_], NDArray[np.uint8])


@dataclass(frozen=True, eq=False)
class Planar:
    """A triangulated cell footprint.

    xy : (n, 2) lengths, cell frame
    triangles : (m, 3)
    zone : (m,) bool. Whether the triangle lies in the optical zone.
    sides : m arrays of point numbers
    fixed : (n,) bool. Points that must not move (on the tile's or the zone's border).
    """

    xy: Floats
    triangles: Ints
    zone: Bools
    sides: tuple[Ints, ...]
    fixed: Bools


def grid(lattice: Lattice, tile: Floats, zone: Floats, steps: tuple[int, int], diagonal: int) -> Planar:
    """Triangulate a tile: a regular grid over its optical zone, and a ring of land if the zone is smaller.

    tile, zone : (m, 2) lengths
        Corners of the cell and of its optical zone (equal polygons if there is no seam).
    steps : (int, int)
        Grid steps along both half axes of a rectangle; a hexagon has that number along each side.
    diagonal : +1 or −1. Squares are split along (+x, +y) or along (+x, −y); no effect on hexagons.
    """
    xy, triangles, sides = _hexagon(zone, steps[0]) if lattice.hexagonal else _square(zone, steps, diagonal)
    fixed = np.zeros(len(xy), dtype=bool)
    for side in sides:
        fixed[side] = True
    planar = Planar(xy, triangles, np.ones(len(triangles), dtype=bool), sides, fixed)
    return planar if np.array_equal(tile, zone) else _with_ring(planar, tile)


def _square(zone: Floats, steps: tuple[int, int], diagonal: int) -> tuple[Floats, Ints, tuple[Ints, ...]]:
    """Points (n, 2), triangles (t, 3) and the points of each side of a rectangle divided into p × q."""
    p, q = steps
    x, y = np.meshgrid(*((2 * np.arange(n + 1) - n) / n for n in steps))  # symmetric to the last bit
    (ax, ay), (bx, by) = half_axes(zone)
    xy = np.stack([(ax * x + bx * y).ravel(), (ay * x + by * y).ravel()], axis=1)
    number = np.arange((p + 1) * (q + 1)).reshape(q + 1, p + 1)
    p00, p10, p01, p11 = (
        n.ravel() for n in (number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:])
    )
    if diagonal > 0:
        pair = [(p00, p10, p11), (p00, p11, p01)]
    else:
        pair = [(p00, p10, p01), (p10, p11, p01)]
    triangles = np.stack([np.stack(t, axis=1) for t in pair], axis=1).reshape(-1, 3)
    sides = (number[:, -1], number[-1, ::-1], number[::-1, 0], number[0, :])
    return xy, triangles, tuple(np.array(s) for s in sides)


def _hexagon(zone: Floats, q: int) -> tuple[Floats, Ints, tuple[Ints, ...]]:
    """Points (n, 2), triangles (t, 3) and points of each side of a convex polygon in q rings."""
    m = len(zone)
    ring = np.arange(1, q + 1)
    start = np.concatenate([[0], 1 + m * ring * (ring - 1) // 2])
    points = [np.zeros((1, 2))]
    triangles = []
    for r in range(1, q + 1):
        s = np.arange(r)
        for k in range(m):
            a, b = zone[k], zone[(k + 1) % m]
            points.append((a * (r - s)[:, None] + b * s[:, None]) / q)
            inner = max(m * (r - 1), 1)
            outer_a = start[r] + k * r + s
            outer_b = start[r] + (k * r + s + 1) % (m * r)
            inner_a = start[r - 1] + (k * (r - 1) + s) % inner
            triangles.append(np.stack([outer_a, outer_b, inner_a], axis=1))
            inner_b = start[r - 1] + (k * (r - 1) + s[1:] - 1) % inner
            triangles.append(np.stack([outer_a[1:], inner_a[1:], inner_b], axis=1))
    last = start[q] + np.arange(m * q + 1) % (m * q)
    sides = tuple(np.array(last[k * q : (k + 1) * q + 1]) for k in range(m))
    return np.concatenate(points), np.concatenate(triangles).astype(np.int64), sides


def _with_ring(zone: Planar, tile: Floats) -> Planar:
    """Surround the zone by flat land out to the tile, whose own sides then need only their corners."""
    n, m = len(zone.xy), len(tile)
    triangles = [zone.triangles]
    for k, side in enumerate(zone.sides):
        a, b = n + k, n + (k + 1) % m
        fan = np.stack([np.full(len(side) - 1, a), side[1:], side[:-1]], axis=1)
        triangles += [fan, np.array([[a, b, side[-1]]])]
    ring = sum(len(t) for t in triangles[1:])
    return Planar(
        np.concatenate([zone.xy, tile]),
        np.concatenate(triangles),
        np.concatenate([zone.zone, np.zeros(ring, dtype=bool)]),
        tuple(np.array([n + k, n + (k + 1) % m]) for k in range(m)),
        np.concatenate([zone.fixed, np.ones(m, dtype=bool)]),
    )


def side_points(start: Floats, end: Floats, t: Floats) -> Floats:
    """Points (n, 2) at parameters t on a straight side; both ends and mirror images are exact."""
    t = np.asarray(t, dtype=np.float64)[:, None]
    return np.asarray(np.where(t < 0.5, start + t * (end - start), end - (1.0 - t) * (end - start)))


def place(breaks: Floats, quads: int, least: float) -> tuple[Floats, Floats]:
    """Choose the border's sample parameters so that every break is one of them.

    A grid sample within a fifth of a step of a break moves there (no slivers); a break keeps at least
    `least` from the ends and from other breaks.

    Returns
    -------
    samples : (n,) ascending, 0 and 1 included
    grid_at : (quads + 1,)
        New index of each regular grid sample; the rest of `samples` is additional.
    """
    grid_at = np.arange(quads + 1) / quads
    extra: list[float] = []
    taken: set[int] = set()
    for t in breaks:
        i = int(np.rint(t * quads))
        if 0 < i < quads and i not in taken and abs(t * quads - i) < 0.2:
            grid_at[i] = t
            taken.add(i)
        else:
            extra.append(float(np.clip(t, least, 1.0 - least)))
    return np.unique(np.concatenate([grid_at, np.asarray(extra)])), grid_at


def space(breaks: Floats, least: float) -> list[Floats]:
    """Group parameters that lie within `least` of their neighbour: each group becomes one sample."""
    t = np.sort(breaks)
    if t.size == 0:
        return []
    return np.split(t, np.flatnonzero(np.diff(t) > least) + 1)


def with_side_samples(planar: Planar, tile: Floats, samples: list[tuple[Floats, Floats]]) -> Planar:
    """Move and add points on the tile's sides.

    samples : m pairs (samples, grid_at). Result of `place`, along each side.
    """
    xy = planar.xy.copy()
    triangles: list[list[int]] = []
    zone: list[bool] = []
    sides = []
    new: list[Floats] = []
    m = len(tile)
    for k, (t, grid_at) in enumerate(samples):
        a, b = tile[k], tile[(k + 1) % m]
        at = dict(zip(grid_at.tolist(), planar.sides[k].tolist()))
        xy[planar.sides[k][1:-1]] = side_points(a, b, grid_at)[1:-1]
        added = [value for value in t.tolist() if value not in at]
        for value, point in zip(added, side_points(a, b, np.asarray(added)) if added else ()):
            at[value] = len(xy) + len(new)
            new.append(point)
        side = [at[value] for value in t.tolist()]
        sides.append(np.asarray(side))
        if added and not triangles:
            triangles, zone = planar.triangles.tolist(), planar.zone.tolist()
        if added:
            _fan_side(triangles, zone, side, set(planar.sides[k].tolist()))
    if not new:
        return replace(planar, xy=xy, sides=tuple(sides))
    every = np.concatenate([xy, np.asarray(new).reshape(-1, 2)])
    fixed = np.concatenate([planar.fixed, np.ones(len(new), dtype=bool)])
    return replace(
        planar,
        xy=every,
        triangles=np.asarray(triangles, dtype=np.int64),
        zone=np.asarray(zone),
        sides=tuple(sides),
        fixed=fixed,
    )


def _fan_side(triangles: list[list[int]], zone: list[bool], side: list[int], old: set[int]) -> None:
    """Split the border triangle over each old border edge into a fan through the new points on it."""
    runs: dict[tuple[int, int], list[int]] = {}
    first = side[0]
    between: list[int] = []
    for point in side[1:]:
        if point in old:
            if between:
                runs[first, point] = between
            first, between = point, []
        else:
            between.append(point)
    for n in range(len(triangles)):
        for turn in range(3):
            p, q, c = (triangles[n][(turn + s) % 3] for s in range(3))
            if (p, q) not in runs:
                continue
            chain = [p, *runs.pop((p, q)), q]
            triangles[n] = [chain[0], chain[1], c]
            for u, v in zip(chain[1:-1], chain[2:]):
                triangles.append([u, v, c])
                zone.append(zone[n])
            break


def fan(sides: tuple[Ints, ...], centre: int) -> Ints:
    """Triangulate a convex tile by its border points and one point inside, (n, 3)."""
    rim = np.concatenate([side[:-1] for side in sides])
    return np.stack([rim, np.roll(rim, -1), np.full(len(rim), centre)], axis=1)


def polygon_fan(corners: Ints) -> Ints:
    """Triangulate a convex polygon without points between its corners, (n − 2, 3)."""
    return np.stack([np.full(len(corners) - 2, corners[0]), corners[1:-1], corners[2:]], axis=1)


def edges_of(triangles: Ints) -> tuple[Ints, Ints]:
    """Undirected edges (e, 2), and each triangle's three edge numbers (m, 3); edge s is corner s → s + 1."""
    both = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, number = unique_rows(both)
    return edges, number.reshape(-1, 3)


def split(triangles: Ints, zone: Tags, xy: Floats, number: Ints, middle: Ints) -> tuple[Ints, Tags]:
    """Split triangles at the points that lie on their edges.

    Parameters
    ----------
    triangles (m, 3), xy (n, 2)
    zone : (m, ...)
        Kind of each triangle; its pieces inherit it.
    number : (m, 3)
        Edge numbers, as returned by `edges_of`.
    middle : (e,)
        Point on each edge, −1 for none. At most two of a triangle's edges have one.
    """
    on = middle[number]
    cuts = (on >= 0).sum(axis=1)
    out, tags = [triangles[cuts == 0]], [zone[cuts == 0]]
    for count in (1, 2):
        rows = np.flatnonzero(cuts == count)
        if not len(rows):
            continue
        # rotate so that the cut edge is corner 0 → 1, or the uncut edge corner 2 → 0
        has = on[rows] >= 0
        turn = np.argmax(has, axis=1) if count == 1 else (np.argmin(has, axis=1) + 1) % 3
        order = (turn[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(triangles[rows], order, axis=1).T
        p, q, _ = np.take_along_axis(on[rows], order, axis=1).T
        if count == 1:
            pieces = [(a, p, c), (p, b, c)]
        else:  # p on a–b, q on b–c: a corner b and a quadrilateral a p q c, split along its shorter diagonal
            across = np.hypot(*(xy[a] - xy[q]).T) <= np.hypot(*(xy[p] - xy[c]).T)
            pieces = [(p, b, q), (a, p, np.where(across, q, c)), (np.where(across, a, p), q, c)]
        out += [np.stack(piece, axis=1) for piece in pieces]
        tags += [zone[rows]] * len(pieces)
    return np.concatenate(out), np.concatenate(tags)


Column = tuple[int, int] | None  # front and back level; None: no material
Vertex = tuple[int, int]  # point of the footprint, level


class Ring:
    """The columns around one point of the footprint, counter-clockwise.

    wedges : sequence of (tag, column). Tags name the wedges; two walls of different cells agree on them.
    """

    __slots__ = ("columns", "levels", "place")

    def __init__(self, wedges: Sequence[tuple[Hashable, Column]]) -> None:
        self.place = {tag: n for n, (tag, _) in enumerate(wedges)}
        self.columns = [column for _, column in wedges]
        self.levels = sorted({level for column in self.columns if column is not None for level in column})

    def chain(self, low: int, high: int, wedge: Hashable) -> list[int]:
        """Levels from `low` to `high` where the vertical edge of a wall has vertices, ends included.

        `wedge` is the tag of the wedge whose column the wall bounds.
        """
        stops = [low, *(level for level in self.levels if low < level < high), high]
        out = [low]
        for a, b in zip(stops[:-1], stops[1:]):
            run = self._run(a, b, self.place[wedge])
            if run > 0:  # own vertices: a different inner level for each further column
                out.append(a + (b - a) // 2 if run == 1 else a + (b - a) // (run + 1))
            out.append(b)
        return out

    def _run(self, a: int, b: int, at: int) -> int:
        """Number, from 0, of the run of neighbouring wedges that cover [a, b] and contain wedge `at`."""
        return runs_round([c is not None and c[0] <= a and c[1] >= b for c in self.columns])[at]


def strip(
    p: int,
    q: int,
    left: tuple[Column, Column],
    right: tuple[Column, Column],
    tags: tuple[Hashable, Hashable],
    rings: tuple[Ring, Ring],
) -> list[tuple[Vertex, Vertex, Vertex]]:
    """Wall triangles over the footprint edge p → q.

    p, q : Points of the footprint; the left column lies on the left of p → q.
    left, right : (column at p, column at q)
    tags : (left, right). The wedges' tags in both rings.
    rings : (ring at p, ring at q)

    Returns triangles of vertices (point, level), outward.
    """
    lines = _lines(left, right)
    triangles: list[tuple[Vertex, Vertex, Vertex]] = []
    for below, above, solid in zip(lines[:-1], lines[1:], solid_strips([line[2]] for line in lines)):
        if solid[0] == solid[1] or below[:2] == above[:2]:
            continue
        if below[0] > above[0] or below[1] > above[1]:
            raise ValueError(
                f"two heights cross inside the edge {p}–{q} of the footprint: a crossing was missed"
            )
        tag = tags[0] if solid[0] else tags[1]
        first, second = (
            [(point, z) for z in (ring.chain(low, high, tag) if low < high else [low])]
            for point, ring, low, high in zip((p, q), rings, below[:2], above[:2])
        )
        # seen from the right hand of p → q, p on the left: outward of the left column
        faces = zipper(first, second)
        triangles += faces if solid[0] else [(a, c, b) for a, b, c in faces]
    return triangles


def _lines(left: tuple[Column, Column], right: tuple[Column, Column]) -> list[tuple[int, int, BorderCurve]]:
    """Fronts and backs of both columns, ascending: level at p, level at q, column and face of each."""
    lines = []
    for which, (at_p, at_q) in enumerate((left, right)):
        # a column without thickness (two faces meeting along the edge) does not divide the other's wall
        if at_p is not None and at_q is not None and (at_p[0] != at_p[1] or at_q[0] != at_q[1]):
            lines += [(at_p[face], at_q[face], BorderCurve(which, face == 0)) for face in (0, 1)]
    return sorted(lines, key=lambda line: (line[0] + line[1], not line[2].opens))


def zipper(first: list[Vertex], second: list[Vertex]) -> list[tuple[Vertex, Vertex, Vertex]]:
    """Triangulate the strip between two upward chains; counter-clockwise with `first` on the left."""
    triangles = []
    i = j = 0
    while i < len(first) - 1 or j < len(second) - 1:
        if j == len(second) - 1 or (i < len(first) - 1 and first[i + 1][1] <= second[j + 1][1]):
            triangles.append((first[i], second[j], first[i + 1]))
            i += 1
        else:
            triangles.append((first[i], second[j], second[j + 1]))
            j += 1
    return triangles
