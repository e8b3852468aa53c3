"""A cell's own triangles for each state of its neighbours: the unit that a sheet repeats.

A cell owns its two caps, its inner walls, the walls on the borders of which it is the left cell, and the
walls towards neighbours that do not exist. Its triangles depend only on which neighbours are cells,
land or nothing, so a sheet of any size has a few templates.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from clacad.base.arrays import unique_rows
from clacad.base.types import Bools, Floats, Ints
from clacad.mesh import cell_triangulation as pl
from clacad.mesh.cell_triangulation import Column, Ring, strip
from clacad.mesh.integer_heights import FAR, LAND, LENS, NONE
from clacad.sheet.pattern import node_cells

if TYPE_CHECKING:
    from clacad.mesh.prototile import Prototile
    from clacad.sheet.lattice import Lattice

Offset = tuple[int, int]

NOTHING, CELL, PLAIN = 0, 1, 2  # state of a neighbour: nothing, a kept cell, plain land
FRONT, FRONT_LAND, BACK, BACK_LAND, WALL = 0, 1, 2, 3, 4  # kinds of triangle


@dataclass(frozen=True, eq=False)
class Template:
    """The triangles owned by one cell, with vertices that cells share.

    owner : (v, 2) int64. Index step to the cell in whose frame the vertex has its canonical coordinates.
    point : (v,) int64. Canonical footprint point.
    level : (v,) int64
    xy : (v, 2) lengths. In the owner's cell frame.
    z : (v,) lengths
    triangles : (t, 3)
    kind : (t,) uint8. FRONT, FRONT_LAND, BACK, BACK_LAND or WALL.
    inner : (v,) bool. Whether a vertex lies on no side of the cell: no other cell has it.
    """

    owner: Ints
    point: Ints
    level: Ints
    xy: Floats
    z: Floats
    triangles: Ints
    kind: NDArray[np.uint8]
    inner: Bools

    @cached_property
    def owners(self) -> tuple[Ints, Ints]:
        """Distinct index steps (k, 2), and the index of each vertex's step among them (v,)."""
        return unique_rows(self.owner)

    def local(self, lattice: Lattice) -> Floats:
        """Vertices (v, 3) in the cell's own frame, lengths."""
        origin = lattice.centres(np.zeros(2, dtype=np.int64))
        xy = self.xy + (lattice.centres(self.owner) - origin)
        return np.concatenate([xy, self.z[:, None]], axis=1)


def neighbour_offsets(lattice: Lattice) -> tuple[Offset, ...]:
    """Index steps to every cell that shares a border or a node with a cell (8 or 6)."""
    steps = set()
    for cells in node_cells(lattice):
        for here, _ in cells:
            steps |= {(there[0] - here[0], there[1] - here[1]) for there, _ in cells}
    return tuple(sorted(steps - {(0, 0)}))


_ON_SIDE, _AT_NODE, _SIDE = 2**32, 2**36, 2**24
"""Offsets of canonical points on borders and nodes of a non-uniform sheet: numbered along them, not as in a
cell.
"""


@dataclass(eq=False)
class TemplateMaker:
    """Makes and caches the templates of one prototile.

    lattice : Pattern of the cells.
    others : Index step → the maker of that neighbour, in a non-uniform sheet; None for a uniform one.
    """

    tile: Prototile
    lattice: Lattice
    others: Callable[[Offset], TemplateMaker] | None = None
    offsets: tuple[Offset, ...] = field(init=False)
    _made: dict[bytes, Template] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self.offsets = neighbour_offsets(self.lattice)
        self._levels = self.tile.corner_levels()
        self._apart = bool((np.abs(self.tile.land) == FAR).any())
        self.places = self._canonical()
        self.xy = _in_owner(self)
        self.caps = _make_caps(self)
        self.inner = _inner_walls(self.tile.plan.triangles, self._levels)
        ends = {point for wall in self.inner for point in wall[:2]}
        self._join_edges(ends)
        self._spokes: dict[int, list[tuple[int, int]]] = {point: [] for point in ends}
        for edge in self._left:
            if edge[0] in self._spokes:
                self._spokes[edge[0]].append(edge)
        self._rings: dict[tuple[int, bytes], Ring] = {}

    def _join_edges(self, ends: set[int]) -> None:
        """Index the triangles' edges at which a wall is possible.

        These edges begin at one of `ends` or on a side of the tile. For each the index holds the triangle on
        its left, that triangle's third corner, and the corner at which the edge begins.
        """
        triangles = self.tile.plan.triangles
        walled = np.zeros(len(self.tile.plan.xy), dtype=bool)
        walled[list(ends)] = True
        walled[np.concatenate(self.tile.plan.sides)] = True
        edge = np.flatnonzero(walled[triangles.ravel()])
        a, b, third = (
            triangles[:, turned].ravel()[edge].tolist() for turned in ([0, 1, 2], [1, 2, 0], [2, 0, 1])
        )
        number = (edge // 3).tolist()
        self._left = dict(zip(zip(a, b), number))
        self._third = dict(zip(zip(a, b), third))
        self._after = dict(zip(zip(number, a), (edge % 3).tolist()))

    def beside(self, step: Offset) -> TemplateMaker:
        """The maker of the kept cell at an index step."""
        return self if self.others is None or step == (0, 0) else self.others(step)

    # -- owners of points ------------------------------------------------------------------------

    def _canonical(self) -> tuple[Ints, Ints]:
        """Owner step and canonical point of every footprint point."""
        n = len(self.tile.plan.xy)
        owner, point = np.zeros((n, 2), dtype=np.int64), np.arange(n)
        sides, half = self.tile.plan.sides, len(self.tile.plan.sides) // 2
        for k in range(half, 2 * half):
            inner = sides[k][1:-1]
            owner[inner] = self.lattice.steps[k]
            if self.others is None:
                point[inner] = sides[k - half][1:-1][::-1]
        for k in range(2 * half if self.others is not None else 0):
            inner = sides[k][1:-1][:: 1 if k < half else -1]
            point[inner] = _ON_SIDE + _SIDE * (k % half) + np.arange(len(inner))
        self._corner_of: dict[int, tuple[int, int]] = {}
        for index, cells in enumerate(node_cells(self.lattice)):
            for place, (step, corner) in enumerate(cells):
                local = int(sides[corner][0])
                owner[local] = (-step[0], -step[1])
                point[local] = sides[cells[0][1]][0] if self.others is None else _AT_NODE + index
                self._corner_of[local] = (index, place)
        self._next = {p: q for side in sides for p, q in zip(side[:-1].tolist(), side[1:].tolist())}
        self._side_of = {int(p): (k, i + 1) for k, side in enumerate(sides) for i, p in enumerate(side[1:-1])}
        return owner, point

    # -- columns and fans ---------------------------------------------------------------------

    def _column(self, triangle: int, point: int) -> Column:
        """The column of a triangle at one of its corners."""
        front, back = self._levels[triangle, self._after[triangle, point]].tolist()
        return None if front == NONE or back == -NONE else (front, back)

    def _fan(self, point: int, first: int) -> list[int]:
        """Triangles about a point, counter-clockwise from the edge point → first."""
        fan = []
        edge = (point, first)
        while edge in self._left:
            fan.append(self._left[edge])
            edge = (point, self._third[edge])
            if edge == (point, first):
                break
        return fan

    def _own_fan(self, point: int) -> list[int]:
        """Triangles about a point of the footprint, in canonical order."""
        if point in self._next:
            return self._fan(point, self._next[point])
        start = min(q for p, q in self._spokes[point])
        return self._fan(point, start)

    def _ring(self, point: int, states: dict[Offset, int], code: bytes) -> Ring:
        """All columns around a point, of its own cell and of its neighbours."""
        shared = point in self._corner_of or point in self._side_of
        key = (point, code if shared else b"")
        if key not in self._rings:
            self._rings[key] = Ring(self._wedges(point, states))
        return self._rings[key]

    def _wedges(self, point: int, states: dict[Offset, int]) -> list[tuple[Hashable, Column]]:
        """Columns around a point counter-clockwise, each tagged by index step to its cell and triangle."""
        half = len(self.tile.plan.sides) // 2
        # cells around the point in canonical order; the point in each: (side, index of the point on it)
        around: list[tuple[Offset, tuple[int, int]]] = []
        if point in self._corner_of:
            index, place = self._corner_of[point]
            cells = node_cells(self.lattice)[index]
            here = cells[place][0]
            around = [((s[0] - here[0], s[1] - here[1]), (c, 0)) for s, c in cells]
        elif point in self._side_of:
            k, i = self._side_of[point]
            other = (k + half) % (2 * half)
            pair = [((0, 0), (k, i)), (self.lattice.steps[k], (other, -1 - i))]
            around = pair if k < half else pair[::-1]
        wedges: list[tuple[Hashable, Column]] = []
        if not around:
            wedges += [(((0, 0), t), self._column(t, point)) for t in self._own_fan(point)]
        for offset, (side, on) in around:
            state = CELL if offset == (0, 0) else states[offset]
            if state == CELL:
                there = self.beside(offset)
                local = int(there.tile.plan.sides[side][on])
                wedges += [((offset, t), there._column(t, local)) for t in there._own_fan(local)]
            else:
                wedges.append(((offset, -1), _absent(self, state)))
        return wedges

    # -- templates ----------------------------------------------------------------------------

    def template(self, states: NDArray[np.uint8]) -> Template:
        """The triangles of a cell with neighbours in these states (in the order of `offsets`).

        Templates are cached in a uniform sheet.
        """
        code = states.astype(np.uint8).tobytes()
        if self.others is not None:
            return self._make(dict(zip(self.offsets, states.tolist())), code)
        if code not in self._made:
            self._made[code] = self._make(dict(zip(self.offsets, states.tolist())), code)
        return self._made[code]

    def _make(self, states: dict[Offset, int], code: bytes) -> Template:
        """The template of a cell: its caps and walls, with the vertices they use and no others."""
        walls = self._walls(states, code)
        point, level, caps, kinds = self.caps
        walled = np.zeros(len(self.tile.plan.xy), dtype=bool)
        walled[[vertex[0] for triangle in walls for vertex in triangle]] = True
        shared = np.flatnonzero(walled[point])
        known = dict(zip(zip(point[shared].tolist(), level[shared].tolist()), shared.tolist()))
        count = len(point)
        more: list[tuple[int, int]] = []
        rows = []
        for triangle in walls:
            row = []
            for vertex in triangle:
                if vertex not in known:
                    known[vertex] = count + len(more)
                    more.append(vertex)
                row.append(known[vertex])
            rows.append(row)
        extra = np.asarray(more, dtype=np.int64).reshape(-1, 2)
        point, level = np.concatenate([point, extra[:, 0]]), np.concatenate([level, extra[:, 1]])
        triangles = np.concatenate([caps, np.asarray(rows, dtype=np.int64).reshape(-1, 3)])
        kind = np.concatenate([kinds, np.full(len(rows), WALL, dtype=np.uint8)])
        taken = np.zeros(len(point), dtype=bool)
        taken[triangles] = True
        used = np.flatnonzero(taken)
        renumber = np.zeros(len(point), dtype=np.int64)
        renumber[used] = np.arange(len(used))
        point, level = point[used], level[used]
        owner, canonical = self.places[0][point], self.places[1][point]
        heights = np.asarray(level * self.tile.step, dtype=np.float64)
        inner = ~np.isin(point, np.concatenate(self.tile.plan.sides))
        return Template(owner, canonical, level, self.xy[point], heights, renumber[triangles], kind, inner)

    def _walls(self, states: dict[Offset, int], code: bytes) -> list[tuple[tuple[int, int], ...]]:
        found: list[tuple[tuple[int, int], ...]] = []
        zero = (0, 0)
        for p, q, left, right in self.inner:
            found += strip(
                p,
                q,
                (self._column(left, p), self._column(left, q)),
                (self._column(right, p), self._column(right, q)),
                ((zero, left), (zero, right)),
                (self._ring(p, states, code), self._ring(q, states, code)),
            )
        for k in range(len(self.tile.plan.sides)):
            step = self.lattice.steps[k]
            if self._apart and states[step] == NOTHING:
                continue  # the outline's wall, built from both faces, closes the cell here
            if states[step] != CELL or k < len(self.tile.plan.sides) // 2:
                found += self._border(k, states, code)
        return found

    def _border(self, k: int, states: dict[Offset, int], code: bytes) -> list[tuple[tuple[int, int], ...]]:
        """Walls over side k of the tile."""
        sides, m = self.tile.plan.sides, len(self.tile.plan.sides)
        step = self.lattice.steps[k]
        there = self.beside(step) if states[step] == CELL else self
        opposite = there.tile.plan.sides[(k + m // 2) % m][::-1]
        found: list[tuple[tuple[int, int], ...]] = []
        for i, (p, q) in enumerate(zip(sides[k][:-1].tolist(), sides[k][1:].tolist())):
            left = self._left[p, q]
            columns = (self._column(left, p), self._column(left, q))
            if states[step] == CELL:
                p_there, q_there = int(opposite[i]), int(opposite[i + 1])
                right = there._left[q_there, p_there]
                others = (there._column(right, p_there), there._column(right, q_there))
            else:
                right = -1
                others = (_absent(self, states[step]),) * 2
            if columns == others:
                continue
            found += strip(
                p,
                q,
                columns,
                others,
                (((0, 0), left), (step, right)),
                (self._ring(p, states, code), self._ring(q, states, code)),
            )
        return found

    def border_levels(self, k: int, segment: int, face: int) -> tuple[int, int]:
        """Level of one face at both ends of a segment of side k (0 front, 1 back)."""
        side = self.tile.plan.sides[k]
        p, q = int(side[segment]), int(side[segment + 1])
        triangle = self._left[p, q]
        at_p, at_q = self._column(triangle, p), self._column(triangle, q)
        assert at_p is not None
        assert at_q is not None
        return at_p[face], at_q[face]


def _in_owner(maker: TemplateMaker) -> Floats:
    """Every footprint point in the frame of its owner cell, (n, 2): bit for bit as in that cell."""
    sides, half = maker.tile.plan.sides, len(maker.tile.plan.sides) // 2
    xy = maker.tile.plan.xy.copy()
    for k, points in enumerate(maker.tile.on_left):
        xy[sides[k][1:-1]] = points if k < half else points[::-1]
    corners = maker.tile.plan.xy[[side[0] for side in sides]]
    for cells in node_cells(maker.lattice):
        for _, corner in cells:
            xy[sides[corner][0]] = corners[cells[0][1]]
    return xy


def _absent(maker: TemplateMaker, state: int) -> Column:
    """The column in place of a cell that is not kept."""
    front, back = maker.tile.land
    return (front, back) if state == PLAIN and front != NONE and back != -NONE else None


def _make_caps(maker: TemplateMaker) -> tuple[Ints, Ints, Ints, NDArray[np.uint8]]:
    """Both caps: vertex points, vertex levels, triangles, kinds."""
    plan, part = maker.tile.plan, maker.tile.part
    points, levels, kinds = [], [], []
    for side in (0, 1):
        level = maker._levels[:, :, side]
        if (np.abs(level) == FAR).all():
            continue
        if maker.tile.plane[side]:
            corners = _plane_cap(maker.tile.plan)
            z = np.full(corners.shape, maker.tile.lens[0, side])
            kind = np.full(len(corners), (FRONT, BACK)[side])
        else:
            solid = (part[:, side] == LENS) | (part[:, side] == LAND)
            corners, z = plan.triangles[solid], level[solid]
            kind = np.where(part[solid, side] == LENS, (FRONT, BACK)[side], (FRONT_LAND, BACK_LAND)[side])
            kind[maker.tile.bevelled(side)[solid]] = WALL
        if side == 0:  # material above: seen from outside (below) the orientation is reversed
            corners, z = corners[:, ::-1], z[:, ::-1]
        points.append(corners)
        levels.append(z)
        kinds.append(kind)
    key = np.stack([np.concatenate(points).ravel(), np.concatenate(levels).ravel()], axis=1)
    vertex, inverse = unique_rows(key)
    return vertex[:, 0], vertex[:, 1], inverse.reshape(-1, 3), np.concatenate(kinds).astype(np.uint8)


def _plane_cap(plan: pl.Planar) -> Ints:
    """Triangles of a plane face: a fan over the border points only, if a point lies inside."""
    sides = plan.sides
    if all(len(side) == 2 for side in sides):
        return pl.polygon_fan(np.array([side[0] for side in sides]))
    centre = int(np.argmin(np.hypot(*plan.xy.T)))
    if any(centre in side for side in sides):
        return plan.triangles
    return pl.fan(sides, centre)


def _inner_walls(triangles: Ints, levels: Ints) -> list[tuple[int, int, int, int]]:
    """Edges inside the footprint at which the columns differ: (p, q, left, right triangle)."""
    edges, number = pl.edges_of(triangles)
    order = np.argsort(number.ravel(), kind="stable")
    sorted_number = number.ravel()[order]
    twice = np.flatnonzero(sorted_number[:-1] == sorted_number[1:])
    one, two = order[twice], order[twice + 1]

    def ends(flat: Ints) -> tuple[Ints, Ints]:
        t, s = flat // 3, flat % 3
        return levels[t, s], levels[t, (s + 1) % 3]

    (p1, q1), (q2, p2) = ends(one), ends(two)
    differ = np.flatnonzero((p1 != p2).any(axis=1) | (q1 != q2).any(axis=1))
    walls = []
    for n in differ:
        t, s = int(one[n] // 3), int(one[n] % 3)
        walls.append((int(triangles[t, s]), int(triangles[t, (s + 1) % 3]), t, int(two[n] // 3)))
    return walls
