"""A plate: the side outline of a body as straight and round edges, with holes through it.

Mesh, solid, tracer, masks and drawings all use this class. The outer boundary is a closed polygon whose sides
may be arcs, as in a DXF polyline. The *bulge* of a side is the tangent of a quarter of its arc's angle. It is
positive where the arc bends to the right of the way from its first point to its second: outwards on a
counter-clockwise boundary. Holes are circles. Coordinates are in design units and absolute: the plate lies
where it is drawn, independent of its cells.

A cell is kept if it lies wholly inside the plate, outside its holes, and at least `CLEARANCE` of a pitch from
every edge: a narrower sliver of land would not survive the rounding of a mesh file. No cell ever touches the
edge of a plate.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import ceil, pi, sqrt
from typing import Any, Literal

import numpy as np

from clacad.base.polygons import within
from clacad.base.types import Bools, Floats
from clacad.sheet.plate_edges import (
    Vertex,
    arc_angle,
    as_sides,
    closed_loop,
    distances,
    edge_box,
    extremes,
    inside,
    keeps_off,
    loop_area,
    nearest_edges,
)

CLEARANCE = 1e-3
"""Least distance between a cell and the edges and holes of its plate, as part of the pitch."""

SLIVER = 4e-6
"""Least distance between a cell and the edges, as part of the plate's size:
four times the resolution of float32.
"""

QUARTER = sqrt(2.0) - 1.0
"""Bulge of a quarter circle: tan(90°/4)."""


@dataclass(frozen=True, slots=True)
class Hole:
    """A round hole through a plate: centre and diameter (lengths), purpose,
    and excess of its diameter over its pin's.
    """

    x: float
    y: float
    diameter: float
    purpose: Literal["mount", "pin"] = "mount"
    play: float = 0.0


@dataclass(frozen=True)
class Plate:
    """An outline of straight and round sides, counter-clockwise, and the holes in it.

    Parameters
    ----------
    vertices : tuple of (x, y, bulge)
        Lengths; bulge of the side from this vertex to the next.
    holes : tuple of Hole
    moved : (x, y), lengths
        Displacement at which every kept cell must lie inside as well: that of array 2's cells.
    """

    vertices: tuple[Vertex, ...]
    holes: tuple[Hole, ...] = ()
    moved: tuple[float, float] = (0.0, 0.0)

    def __repr__(self) -> str:
        return f"Plate({len(self.vertices)} corners, {len(self.holes)} holes)"

    def __getstate__(self) -> dict[str, Any]:
        """Return the constructor's values, without cached results."""
        return {name: self.__dict__[name] for name in ("vertices", "holes", "moved")}

    @cached_property
    def loops(self) -> tuple[Floats, ...]:
        """Edges (k, EDGE_NUMBERS) of the boundary and of each hole, the material on their left;
        arcs span at most 90°.
        """
        return closed_loop(self.vertices), *(
            closed_loop(tuple((*p, -QUARTER) for p in _quarters(hole))) for hole in self.holes
        )

    @cached_property
    def edges(self) -> Floats:
        """All edges, (e, EDGE_NUMBERS)."""
        return np.concatenate(self.loops)

    @property
    def area(self) -> float:
        """Area of the plate without its holes, length²."""
        return loop_area(self.loops[0]) - sum(0.25 * pi * hole.diameter**2 for hole in self.holes)

    @cached_property
    def box(self) -> tuple[float, float, float, float]:
        """Bounding box (x_min, x_max, y_min, y_max), lengths."""
        points = extremes(self.loops[0])
        (x0, y0), (x1, y1) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
        return x0, x1, y0, y1

    @property
    def diameter(self) -> float:
        """Diameter (length) of a round plate about the origin, drilled or not; 0 for any other boundary."""
        across = -2.0 * self.vertices[0][1]
        return across if self.vertices == plate_of_circle(across) else 0.0

    @property
    def reach(self) -> tuple[float, float]:
        """Greatest |x| and |y| of the plate (lengths)."""
        x0, x1, y0, y1 = self.box
        return max(abs(x0), abs(x1)), max(abs(y0), abs(y1))

    @cached_property
    def free_box(self) -> tuple[float, float]:
        """Half sides of a rectangle about the centre of the box that no edge enters;
        (0, 0) where there is none.
        """
        x0, x1, y0, y1 = self.box
        centre = np.array([0.5 * (x0 + x1), 0.5 * (y0 + y1)])
        if not self.inside(centre[None])[0]:
            return 0.0, 0.0
        low, high = 0.0, 1.0
        for _ in range(40):
            share = 0.5 * (low + high)
            half = share * 0.5 * np.array([x1 - x0, y1 - y0])
            sides = centre + half * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
            low, high = (share, high) if self._clear(sides) else (low, share)
        share = low * (1.0 - 1e-9)
        return 0.5 * share * (x1 - x0), 0.5 * share * (y1 - y0)

    @property
    def least_land(self) -> float:
        """Least distance between a hole's side and the boundary or another hole (length);
        infinite without holes.
        """
        middles = np.array([(hole.x, hole.y) for hole in self.holes]).reshape(-1, 2)
        radii = np.array([0.5 * hole.diameter for hole in self.holes])
        gaps = [nearest_edges(self.loops[0], middles)[0] - radii] if self.holes else []
        for n in range(1, len(radii)):
            gaps.append(np.hypot(*(middles[n:] - middles[n - 1]).T) - radii[n:] - radii[n - 1])
        return float(np.min(np.concatenate(gaps))) if gaps else np.inf

    def free_width(self, low: float, high: float) -> float:
        """Width of the widest rectangle about x = 0 between two heights y that no edge enters;
        0 without one.
        """
        narrow, wide = 0.0, 2.0 * self.reach[0]
        for _ in range(40):
            x = 0.25 * (narrow + wide)
            sides = np.array([(-x, low), (x, low), (x, high), (-x, high)])
            free = bool(self.inside(sides).all()) and self._clear(sides)
            narrow, wide = (2.0 * x, wide) if free else (narrow, 2.0 * x)
        return narrow

    def _clear(self, polygon: Floats) -> bool:
        """Whether no edge has a point in a convex polygon (m, 2)."""
        return not bool(
            (distances(self.edges, polygon) == 0.0).any() or within(polygon, *self.edges[:, :2].T).any()
        )

    def inside(self, points: Floats) -> Bools:
        """Which points (..., 2), lengths, lie in the material; see `clacad.sheet.plate_edges.inside`."""
        flat = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        return inside(self.edges, flat).reshape(np.shape(points)[:-1])

    @cached_property
    def kept(self) -> dict[Any, Any]:
        """Cache for results that other modules compute from this plate;
        not compared, copied or pickled with it.
        """
        return {}

    def room(self, pitch: tuple[float, float]) -> float:
        """Distance kept between a cell and every edge (length)."""
        x0, x1, y0, y1 = self.box
        return max(CLEARANCE * min(pitch), SLIVER * max(x1 - x0, y1 - y0, *self.reach))

    def holds(self, tile: Floats, centres: Floats, room: float) -> Bools:
        """Which cells lie wholly inside, at least `room` from every edge, both in place and displaced by
        `moved`.

        Parameters
        ----------
        tile : (m, 2), lengths
            Corners of a cell relative to its centre, counter-clockwise.
        centres : (n, 2), lengths
        room : length
        """
        held = self._holds(tile, centres, room)
        if self.moved != (0.0, 0.0):
            held &= self._holds(tile, centres + np.array(self.moved), room)
        return held

    def _holds(self, tile: Floats, centres: Floats, room: float) -> Bools:
        held = np.ones(len(centres), dtype=bool)
        reach = float(np.hypot(*tile.T).max()) + room
        for edge in self.edges:
            low, high = edge_box(edge)
            near = np.flatnonzero(
                held & (centres > low - reach).all(axis=1) & (centres < high + reach).all(axis=1)
            )
            for start in range(0, len(near), 4096):
                some = near[start : start + 4096]
                held[some] = keeps_off(edge, tile, centres[some], room)
        rest = np.flatnonzero(held)  # no edge is near: a cell is inside if its centre is
        held[rest] = inside(self.edges, centres[rest])
        return held

    def polygons(self, steps: int) -> tuple[Floats, ...]:
        """The loops as polygons (n, 2) of equal areas; an arc of angle φ becomes ⌈φ·steps/2π⌉ sides, at least
        two.

        The inner corners of an arc lie off it by such a distance that the fan has the sector's area; its ends
        are exact.
        """
        return tuple(
            np.concatenate(
                [as_sides(edge, max(2, ceil(steps * arc_angle(edge) / (2.0 * pi)))) for edge in loop]
            )
            for loop in self.loops
        )


def plate_of_circle(diameter: float) -> tuple[Vertex, ...]:
    """Boundary of a round plate about the origin, as four quarter circles."""
    r = 0.5 * diameter
    return (0.0, -r, QUARTER), (r, 0.0, QUARTER), (0.0, r, QUARTER), (-r, 0.0, QUARTER)


def plate_of_rectangle(
    width: float, height: float, corners: tuple[str, float] | None = None
) -> tuple[Vertex, ...]:
    """Boundary of a rectangle about the origin; `corners`: ("round", radius) or ("chamfer", leg), lengths."""
    x, y = 0.5 * width, 0.5 * height
    if corners is None:
        return (-x, -y, 0.0), (x, -y, 0.0), (x, y, 0.0), (-x, y, 0.0)
    c, bulge = corners[1], QUARTER if corners[0] == "round" else 0.0
    return (
        (-x + c, -y, 0.0),
        (x - c, -y, bulge),
        (x, -y + c, 0.0),
        (x, y - c, bulge),
        (x - c, y, 0.0),
        (-x + c, y, bulge),
        (-x, y - c, 0.0),
        (-x, -y + c, bulge),
    )


def counter_clockwise(vertices: tuple[Vertex, ...]) -> tuple[Vertex, ...]:
    """Return a closed polygon in counter-clockwise order."""
    if loop_area(closed_loop(vertices)) > 0.0:
        return vertices
    back = vertices[::-1]
    return tuple((x, y, 0.0 - back[(n + 1) % len(back)][2]) for n, (x, y, _) in enumerate(back))


def _quarters(hole: Hole) -> tuple[tuple[float, float], ...]:
    """Four points of a hole's circle, clockwise."""
    x, y, r = hole.x, hole.y, 0.5 * hole.diameter
    return (x + r, y), (x, y - r), (x - r, y), (x, y + r)
