"""One tiling of a body (its cell templates and their positions), and the flat land around it up to the
outline.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import ceil, pi, sin, sqrt
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Bytes, Floats, Ints
from clacad.mesh.cell_template import CELL, NOTHING, PLAIN, Offset, TemplateMaker
from clacad.sheet.edge_columns import RADIUS
from clacad.sheet.lattice import Circle, Lattice, Rectangle
from clacad.sheet.plate import Plate
from clacad.sheet.representative_cells import representative_cells
from clacad.sheet.window import Body, Window
from clacad.topology.complex_parts import CannotBuild

if TYPE_CHECKING:
    from clacad.mesh.cell_batch import OwnMeshCells


JUDGED = 16
"""Number of sampled cells of a non-uniform sheet whose facet errors are measured, besides the outermost
lenses.
"""


@dataclass(frozen=True, eq=False)
class Tiled:
    """One tiling of a body: its templates and their positions.

    maker : Of all cells; in a non-uniform sheet of the first cell.
    shift : (2,) lengths
    lattice : Pattern of the tiling's cells about their own middle.
    own : Set if every cell is a separate piece.
    """

    maker: TemplateMaker
    shift: tuple[float, float]
    lattice: Lattice
    own: OwnMeshCells | None = None

    def border_levels(self, segments: list[tuple[int, int, int, int]], face: int) -> list[tuple[int, int]]:
        """Levels of one face at both ends of segments: cell i, j, side and number of the segment."""
        if self.own is None:
            return [self.maker.border_levels(k, n, face) for _, _, k, n in segments]
        return self.own.border_levels(np.array(segments, dtype=np.int64).reshape(-1, 4), face)

    def edge_makers(self, edge: list[tuple[int, int, int]]) -> dict[Offset, TemplateMaker]:
        """Makers of the cells (i, j) of sides (i, j, k), to read the points of their sides from."""
        cells = sorted({(i, j) for i, j, _ in edge}, key=lambda at: at[::-1])
        if self.own is None or not cells:
            return dict.fromkeys(cells, self.maker)
        regular = self.own.as_regular(np.array(cells, dtype=np.int64)).tolist()
        return {
            (i, j): self.own.regular.maker if same else self.own.rare.at((i, j))
            for (i, j), same in zip(cells, regular, strict=True)
        }

    def judged(self, window: Window, body: Body) -> list[tuple[TemplateMaker, Body]]:
        """Makers of representative cells for facet errors, each with the body of its uniform equivalent."""
        if self.own is None:
            return [(self.maker, body)]
        cells = representative_cells(window, "facets", JUDGED)
        return [(self.own.rare.at((i, j)), self.own.rare.body_at((i, j))) for i, j in cells.tolist()]


Point = tuple[float, float]
Key = tuple[int, int, int]  # owner cell i, j and canonical point; outline corners are (−1, n, −1)

_TOUCH = 8.0 * 2.0**-23  # relative to the sheet: smaller gaps than a float32 file can hold count as none


def outline_polygon(window: Window) -> Floats:
    """Corners (n, 2) of the window's outline, counter-clockwise, centred on the origin (lengths).

    A circle becomes a polygon of equal area, or a circumscribed one if a cell would otherwise protrude.
    """
    outline, lattice = window.outline, window.lattice
    if isinstance(outline, Rectangle):
        x, y = 0.5 * outline.width, 0.5 * outline.height
        return np.array([(x, -y), (x, y), (-x, y), (-x, -y)])
    assert isinstance(outline, Circle)
    r = 0.5 * outline.diameter
    n = _sides_of_circle(window, r)
    angle = (2 * np.arange(n) + 1) * (pi / n)
    unit = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    equal = r * sqrt(2.0 * pi / n / sin(2.0 * pi / n))
    widest = max((place.lattice(lattice) for place in window.placements), key=lambda one: one.pitch)
    corners = widest.centres(lattice.cells())[:, None, :] + widest.tile()
    # largest distance of a cell's corner from the centre; the polygon's sides are equal · cos(π/n) from it
    across = np.hypot(corners[..., 0], corners[..., 1]).max(initial=0.0)
    if across >= equal * np.cos(pi / n) * (1.0 - 1e-6):
        equal = r / np.cos(pi / n) * (1.0 + 1e-6)
    return np.asarray(equal * unit)


def _sides_of_circle(window: Window, radius: float) -> int:
    """Number of polygon sides that replace a circle of a radius (length)."""
    many = ceil(pi * sqrt(500.0 * radius / min(window.lattice.pitch)))
    return int(np.clip(many, 360, 8192)) // 4 * 4


def outline_polygons(window: Window) -> tuple[Floats, ...]:
    """Loops of the window's outline as polygons (n, 2), the land on their left: outer loop first, then holes.

    Arcs of a plate are replaced by sides that enclose the same area.
    """
    if not isinstance(window.outline, Plate):
        return (outline_polygon(window),)
    return window.outline.polygons(_sides_of_circle(window, float(window.outline.edges[:, RADIUS].max())))


def row_states(
    window: Window,
    row: Ints,
    offsets: tuple[Offset, ...],
    ringed: bool,
    places: Lattice,
    shift: tuple[float, float] = (0.0, 0.0),
) -> Bytes:
    """States of the neighbours of each kept cell of a row, (n, len(offsets)): NOTHING, CELL or PLAIN.

    ringed : Whether there is land out to the window's outline.
    places : Pattern of the cells about their own middle.
    shift : (2,) lengths. Displacement of the cells against the centre of the outline.
    """
    there = row[:, None] + np.array(offsets)
    kept = window.lattice.contains(there)
    states = np.where(kept, CELL, NOTHING).astype(np.uint8)
    if ringed and not kept.all():
        absent = np.argwhere(~kept)
        inside = _reaches_inside(window, there[~kept], places, shift)
        states[tuple(absent[inside].T)] = PLAIN
    return states


def _reaches_inside(
    window: Window, index: Ints, places: Lattice, shift: tuple[float, float]
) -> NDArray[np.bool_]:
    """Whether a cell's footprint overlaps the inside of the outline (for neighbours of kept cells only)."""
    if not isinstance(window.outline, Rectangle):
        return np.ones(len(index), dtype=bool)  # a round outline never touches the kept cells
    corners = places.centres(index)[:, None, :] + places.tile() + np.array(shift)
    half = 0.5 * np.array([window.outline.width, window.outline.height])
    half -= _TOUCH * half.max()
    return np.asarray(((corners.min(axis=1) < half) & (corners.max(axis=1) > -half)).all(axis=1))


FEW = 16
"""Largest number of sides of an outline that cells may touch; the polygon of a circle has more."""

Segment = tuple[int, Key, Key, tuple[int, int, int, int] | None]


@dataclass(frozen=True, eq=False)
class LandRing:
    """The ring of land of one tiling.

    keys : Points of the ring's boundary.
    position : key → (x, y), sheet frame (lengths)
        Of all boundary points, including those that are only on the outline.
    triangles : (t, 3). Indices into `keys`, counter-clockwise from +z.
    rim : list of (outline side, start key, end key, touching cell or None)
        The outline counter-clockwise. A cell that touches it is (i, j, side of its tile, segment).
    """

    keys: list[Key]
    position: dict[Key, tuple[float, float]]
    triangles: Ints
    rim: list[Segment]


def boundary(lattice: Lattice) -> list[tuple[int, int, int]]:
    """Every (i, j, side) whose neighbour is not kept."""
    index = lattice.cells()
    found = []
    for k, step in enumerate(lattice.steps):
        bare = index[~lattice.contains(index + np.array(step))]
        found += [(i, j, k) for i, j in bare.tolist()]
    return found


def ring_about(window: Window, tiled: tuple[Tiled, ...]) -> int | None:
    """Number of triangles of the ring and its wall, but for cells whose sides have more points than the
    regular cell's; None where cells touch the outline.
    """
    loops = outline_polygons(window)
    outer, found = sum(map(len, loops)), 0
    for side in range(2):
        own = tiled[min(side, len(tiled) - 1)]
        lattice, maker = own.lattice, own.maker if own.own is None else own.own.regular.maker
        x0, x1, y0, y1 = lattice.extent()
        half = np.abs(loops[0]).max(axis=0) * (1.0 - _TOUCH)
        shift = np.abs(own.shift) if len(tiled) > 1 else np.zeros(2)
        if len(loops[0]) <= FEW and (np.array([max(-x0, x1), max(-y0, y1)]) + shift >= half).any():
            return None
        inner = sum(len(maker.tile.plan.sides[k]) - 1 for _, _, k in boundary(window.lattice))
        # a ring around a hole has as many triangles as corners; half of the wall's, two a side, is added
        found += inner + 2 * outer + 2 * (len(loops) - 1)
    return found


def make_land(window: Window, tiled: Tiled, centre: tuple[float, float]) -> LandRing:
    """Triangulate the land between the cells of one tiling and the outline.

    The makers of `tiled` give the points of the cells' sides; `centre` (2,) is the outline's, lengths. A cell
    beyond the outline raises CannotBuild, CL136.
    """
    free = isinstance(window.outline, Plate)  # no cell touches the edge of a plate, or protrudes from it
    loops = [polygon + np.array(centre) for polygon in outline_polygons(window)]
    polygon, scale = loops[0], float(np.abs(loops[0]).max())
    position: dict[Key, tuple[float, float]] = {}
    directed: list[tuple[Key, Key]] = []  # land on the left
    touching: dict[tuple[Key, Key], tuple[int, int, int, int]] = {}
    edge = boundary(window.lattice)
    few = not free and len(polygon) <= FEW
    for (i, j, k), (keys, places) in zip(edge, _side_points(tiled, edge), strict=True):
        for key, at in zip(keys, places):
            position.setdefault(key, at)
        ends = np.array([position[keys[0]], position[keys[-1]]]) if few else None
        if ends is not None and len(_on_side(polygon, ends, scale)):
            for n, (a, b) in enumerate(pairwise(keys)):
                touching[a, b] = (i, j, k, n)
        else:
            directed += zip(keys[1:], keys)
    if free:
        rim = _free_rim(loops, position)
    else:
        _refuse_outside(window, np.array(list(position.values())).reshape(-1, 2), polygon, scale)
        rim = _rim(polygon, position, touching, scale)
    directed += [(a, b) for _, a, b, cell in rim if cell is None]
    rings = link_loops(directed, position)
    keys = list(dict.fromkeys(key for ring in rings for key in ring))
    number = {key: n for n, key in enumerate(keys)}
    return LandRing(keys, position, triangulate_loops(rings, number, position), rim)


def _side_points(tiled: Tiled, edge: list[tuple[int, int, int]]) -> list[tuple[list[Key], list[Point]]]:
    """Points of sides (i, j, k), each with the key of the cell that owns it: x, y on the sheet (lengths)."""
    makers, alike = tiled.edge_makers(edge), dict[tuple[int, int], list[int]]()
    for n, (i, j, k) in enumerate(edge):
        alike.setdefault((id(makers[i, j]), k), []).append(n)
    found: dict[int, tuple[list[Key], list[Point]]] = {}
    for numbers in alike.values():
        i, j, k = edge[numbers[0]]
        maker = makers[i, j]
        side = maker.tile.plan.sides[k]
        point = maker.places[1][side].tolist()
        owner = maker.places[0][side] + np.array([edge[n][:2] for n in numbers])[:, None]
        place = tiled.lattice.centres(owner) + np.array(tiled.shift) + maker.xy[side]
        for n, cells, at in zip(numbers, owner.tolist(), place.tolist()):
            found[n] = ([(*cell, p) for cell, p in zip(cells, point)], [(x, y) for x, y in at])
    return [found[n] for n in range(len(edge))]


def _on_side(polygon: Floats, points: Floats, scale: float) -> Ints:
    """Sides of the polygon on which all of the points lie."""
    a, b = polygon, np.roll(polygon, -1, axis=0)
    along = (b - a) / np.hypot(*(b - a).T)[:, None]
    relative = points[None] - a[:, None]
    across = along[:, None, 0] * relative[..., 1] - along[:, None, 1] * relative[..., 0]
    return np.flatnonzero((np.abs(across) < _TOUCH * scale).all(axis=1))


def _refuse_outside(window: Window, points: Floats, polygon: Floats, scale: float) -> None:
    a, b = polygon, np.roll(polygon, -1, axis=0)
    along = (b - a) / np.hypot(*(b - a).T)[:, None]
    middle = polygon.mean(axis=0)
    from_middle = a - middle
    nearest = float((along[:, 1] * from_middle[:, 0] - along[:, 0] * from_middle[:, 1]).min())
    points = points[np.hypot(*(points - middle).T) > (1.0 - _TOUCH) * nearest]
    for start in range(0, len(points), 4096):
        relative = points[start : start + 4096, None] - a[None]
        across = along[:, 0] * relative[..., 1] - along[:, 1] * relative[..., 0]
        if (across < -_TOUCH * scale).any():
            raise CannotBuild(
                "CL136",
                f"a cell of {window.name!r} reaches {-float(across.min()):.3g} beyond the outline"
                f" {window.outline}; a larger outline or fewer cells would hold it",
            )


def _rim(
    polygon: Floats,
    position: dict[Key, tuple[float, float]],
    touching: dict[tuple[Key, Key], tuple[int, int, int, int]],
    scale: float,
) -> list[Segment]:
    """Walk the outline counter-clockwise, splitting it at every cell point that lies on it."""
    keys = list(position)
    at = np.array([position[key] for key in keys]).reshape(-1, 2)
    away = np.hypot(*(polygon - polygon.mean(axis=0)).T).min() - 2.0 * _TOUCH * scale
    outer = np.flatnonzero(np.hypot(*(at - polygon.mean(axis=0)).T) >= away)  # only these reach a corner
    corner: list[Key] = []
    for n, p in enumerate(polygon):
        near = outer[np.hypot(*(at[outer] - p).T) < _TOUCH * scale]
        corner.append(keys[near[0]] if len(near) else (-1, n, -1))
        position.setdefault(corner[-1], (float(p[0]), float(p[1])))
    rim: list[Segment] = []
    few = len(polygon) <= FEW
    for n in range(len(polygon)):
        a, b = polygon[n], polygon[(n + 1) % len(polygon)]
        length = float(np.hypot(*(b - a)))
        along = (b - a) / length
        chain = [corner[n]]
        if few and len(at):
            t = (at - a) @ along
            across = along[0] * (at[:, 1] - a[1]) - along[1] * (at[:, 0] - a[0])
            on = np.flatnonzero(
                (np.abs(across) < _TOUCH * scale) & (t > _TOUCH * scale) & (t < length - _TOUCH * scale)
            )
            chain += [keys[m] for m in on[np.argsort(t[on])]]
        chain.append(corner[(n + 1) % len(polygon)])
        rim += [(n, p, q, touching.get((p, q))) for p, q in zip(chain[:-1], chain[1:])]
    return rim


def _free_rim(loops: list[Floats], position: dict[Key, tuple[float, float]]) -> list[Segment]:
    """The sides of loops that no cell touches, numbered consecutively over all loops."""
    rim: list[Segment] = []
    for loop in loops:
        first, count = len(rim), len(loop)
        keys: list[Key] = [(-1, first + n, -1) for n in range(count)]
        position.update(zip(keys, map(tuple, loop.tolist()), strict=True))
        rim += [(first + n, keys[n], keys[(n + 1) % count], None) for n in range(count)]
    return rim


def link_loops(directed: list[tuple[Key, Key]], position: dict[Key, tuple[float, float]]) -> list[list[Key]]:
    """Link directed segments to closed loops; where loops touch, each bounds its own land."""
    leaving: dict[Key, list[Key]] = {}
    for a, b in directed:
        leaving.setdefault(a, []).append(b)
    loops = []
    while leaving:
        first = next(iter(leaving))
        loop, here, before = [], first, None
        while True:
            loop.append(here)
            choices = leaving[here]
            nxt = (
                choices[0]
                if len(choices) == 1 or before is None
                else _rightmost(position, before, here, choices)
            )
            choices.remove(nxt)
            if not choices:
                del leaving[here]
            before, here = here, nxt
            if here == first:
                break
        loops.append(loop)
    return loops


def _rightmost(position: dict[Key, tuple[float, float]], before: Key, here: Key, choices: list[Key]) -> Key:
    """The first choice, turning clockwise from the way back."""
    x, y = position[here]

    def heading(key: Key) -> float:
        return float(np.arctan2(position[key][1] - y, position[key][0] - x))

    back = heading(before)
    return min(choices, key=lambda key: (back - heading(key)) % (2.0 * pi) or 2.0 * pi)


def triangulate_loops(
    loops: list[list[Key]], number: dict[Key, int], position: dict[Key, tuple[float, float]]
) -> Ints:
    """Triangulate the region on the left of the loops without adding points."""
    if not loops:
        return np.empty((0, 3), dtype=np.int64)
    from manifold3d import triangulate

    order = np.array([number[key] for loop in loops for key in loop])
    polygons = [np.array([position[key] for key in loop]) for loop in loops]
    scale = float(max(np.abs(p).max() for p in polygons))
    found = np.asarray(triangulate([p / scale for p in polygons]), dtype=np.int64)
    return np.asarray(order[found])
