"""The first triangle by Embree, where it is installed: Embree names the triangle, clacad computes the
distance.

Embree works in single precision, so only the number of the triangle is used. The hit is computed again in
double precision on that triangle, and what is not beyond doubt is left to the trees. `compiled_hierarchy`
traces rays that pass an edge within the rounding error of a float32, that meet a wall, flat land or another
lenslet's face of one lens, or that do not leave the sheet. Rays of a picture whose triangle is not confirmed
go down the `median_tree`. Needs the package embreex (extra `pictures`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from typing import Any

import numpy as np

from clacad.base.types import Bools, Floats, Ints, Rows
from clacad.optics.rays import NO_CELL, Fate, Rays, TraceResult
from clacad.optics.surface import refract
from clacad.sheet.window import Face, Window
from clacad.tracing.layout import Layout
from clacad.tracing.triangles.hierarchy import Hierarchy
from clacad.tracing.triangles.median_tree import Tree, meet_each, nearest_triangle

DOUBTFUL = 16.0
"""Float32 spacings at the scene's size within which the position of a hit from Embree is not trusted."""

STEEP, LEVEL = 0.05, 1e-5
"""Slopes of walls and of what may be land, as in `compiled_hierarchy`."""

NOTHING = 0xFFFFFFFF
"""Embree's number for no triangle, read as unsigned."""

MANY = 4096
"""Rays of a picture below which the tree answers before Embree has built its own."""

KEPT_SCENES = 8
"""Largest number of cached Embree trees of a picture's meshes."""

_SCENES: dict[tuple[int, int], tuple[Tree, Any]] = {}


@lru_cache(maxsize=1)
def installed() -> bool:
    """Whether Embree is available."""
    return find_spec("embreex") is not None


def embree_scene(corners: Floats) -> Any:
    """Embree's own tree of triangles (t, 3, 3), lengths about a point among them, in single precision."""
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    scene = EmbreeScene()
    TriangleMesh(scene, np.ascontiguousarray(corners, dtype=np.float32))
    return scene


def name_first(scene: Any, start: Floats, direction: Floats) -> Ints:
    """Number (n,) of the triangle each ray meets first as single precision sees it; −1 for none.

    Parameters
    ----------
    start : (n, 3) lengths, about the scene's point
    direction : (n, 3), unit
    """
    found = scene.run(start.astype(np.float32), direction.astype(np.float32), query="INTERSECT")
    number = np.asarray(found).astype(np.int64)
    return np.where(number == NOTHING, -1, number)


# -- a trace through facets --------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class BodyTree:
    """Triangles of one body and Embree's tree of them.

    corners : (t, 3, 3) lengths about `origin`, normals : (t, 3) outward unit
    altitude : (t, 3) lengths, of each corner over the side opposite
    """

    scene: Any
    corners: Floats
    normals: Floats
    altitude: Floats
    origin: Floats

    @classmethod
    def of(cls, corners: Floats) -> BodyTree:
        """Index the triangles (t, 3, 3) of a body about its middle."""
        origin = 0.5 * (corners.min(axis=(0, 1)) + corners.max(axis=(0, 1)))
        local = corners - origin
        cross = np.cross(local[:, 1] - local[:, 0], local[:, 2] - local[:, 0])
        double = np.linalg.norm(cross, axis=1)
        edges = np.linalg.norm(local[:, [2, 0, 1]] - local[:, [1, 2, 0]], axis=2)
        with np.errstate(divide="ignore", invalid="ignore"):
            normals, altitude = cross / double[:, None], double[:, None] / edges
        return cls(embree_scene(local), local, normals, altitude, origin)


def body_trees(trees: Hierarchy) -> tuple[BodyTree, ...]:
    """Embree's trees of the triangles of every body."""
    return tuple(
        BodyTree.of(trees.corner[first : first + count]) for first, count in trees.tree[:, 1:3].tolist()
    )


def trace_straight(layout: Layout, bodies: tuple[BodyTree, ...], rays: Rays) -> tuple[TraceResult, Bools]:
    """Trace rays that go straight through every body by its lens faces.

    Parameters
    ----------
    layout : Layout
        As `triangle_soup.lay_out_soup` gives it, facet normals.
    bodies : tuple of BodyTree
        As `body_trees` gives them.
    rays : Rays
        n, without wavelengths of their own.

    Returns
    -------
    result : TraceResult
        Valid in the rows that were decided: ALIVE or GHOST.
    decided : (n,) bool
        False: to be traced by clacad's own tree.
    """
    window, straight, before = layout.window, _Straight.launched(layout, rays), 1.0
    for body, triangles in zip(window.bodies, bodies, strict=True):
        for face, after in ((body.front, body.index), (body.back, 1.0)):
            straight.cross(window, triangles, face, (before, after), face is body.front)
            before = after
    return straight.result(2 * len(window.bodies) - 1), straight.decided


@dataclass(frozen=True, eq=False)
class _Straight:
    """n rays on their way straight through; columns are changed in place.

    position, direction : (n, 3), sheet frame
    path : (n,) lengths
    cells : (arrays, n, 2) ints
        Cell of each array, NO_CELL before it is met.
    decided : (n,) bool
        All decisions so far are beyond doubt.
    """

    position: Floats
    direction: Floats
    path: Floats
    cells: Ints
    decided: Bools

    @classmethod
    def launched(cls, layout: Layout, rays: Rays) -> _Straight:
        """Rays before the sheet that go towards it; the others are not decided here."""
        n = len(rays)
        position = np.array(rays.position, dtype=np.float64)
        with np.errstate(invalid="ignore", divide="ignore"):
            direction = rays.direction / np.linalg.norm(rays.direction, axis=1, keepdims=True)
        bottom = min(plan.level + plan.low for plan in layout.bodies)
        decided = np.isfinite(position).all(axis=1) & np.isfinite(direction).all(axis=1)
        decided &= (position[:, 2] < bottom) & (direction[:, 2] > 0.0)
        return cls(
            position,
            direction,
            np.zeros(n),
            np.full((len(layout.window.placements), n, 2), NO_CELL, dtype=np.int64),
            decided,
        )

    def cross(
        self, window: Window, triangles: BodyTree, face: Face, indices: tuple[float, float], entering: bool
    ) -> None:
        """Move the decided rays to one face of a body and refract them; refractive index before and after it."""
        live = np.flatnonzero(self.decided)
        distance, normal, good = _hit(triangles, self.position[live], self.direction[live], entering)
        if face.array is not None and face.land is not None:  # level triangles may be land
            good &= normal[:, 0] ** 2 + normal[:, 1] ** 2 > (2.0 * LEVEL * normal[:, 2]) ** 2
        self.decided[live[~good]] = False
        live, distance, normal = live[good], distance[good], normal[good]
        self.position[live] += distance[:, None] * self.direction[live]
        self.path[live] += indices[0] * distance
        if face.array is not None:
            self.note_cells(window, face.array, live)
        root = np.einsum("ij,ij->i", normal, self.direction[live])
        self.direction[live], _ = refract(self.direction[live], normal, root, *indices)
        self.decided[live[~(self.direction[live, 2] > 0.0)]] = False  # reflected totally, or backward

    def note_cells(self, window: Window, array: int, rows: Rows) -> None:
        """Record the cell of an array that rays (k,) met; rays that met two cells of one array are left to
        clacad's tree.
        """
        shift, point = np.asarray(window.shifts[array]), self.position[rows]
        cell, _, _ = window.lattice.locate(point[:, 0] - shift[0], point[:, 1] - shift[1])
        known = self.cells[array, rows, 0] != NO_CELL
        same = (self.cells[array, rows] == cell).all(axis=1)
        self.decided[rows[(known & ~same) | ~window.lattice.contains(cell)]] = False
        self.cells[array, rows] = cell

    def result(self, last: int) -> TraceResult:
        """All n rows as if they had left through the last surface; rays that met a field lens elsewhere stay
        undecided.
        """
        n = len(self.path)
        for other in self.cells[2:]:
            self.decided[(other != self.cells[0]).any(axis=1)] = False
        order = self.cells[1] - self.cells[0]
        fate = np.where((order == 0).all(axis=1), Fate.ALIVE, Fate.GHOST).astype(np.uint8)
        surface = np.full(n, last, dtype=np.int32)
        cell, order = self.cells[0].astype(np.int32), order.astype(np.int32)
        return TraceResult(self.position, self.direction, fate, self.path, cell, order, surface, np.ones(n))


def _hit(body: BodyTree, position: Floats, direction: Floats, entering: bool) -> tuple[Floats, Floats, Bools]:
    """Distance (n,), unit normal towards where the light goes (n, 3), and whether both are beyond doubt."""
    start = position - body.origin
    reach = float(np.abs(body.corners).max()) + float(np.abs(start).max(initial=0.0))
    doubt = DOUBTFUL * float(np.spacing(np.float32(reach)))
    away = start + (0.0 if entering else 2.0 * doubt) * direction
    found = name_first(body.scene, away, direction)  # nearest ahead of a float32 start
    good = found >= 0
    chosen = np.where(good, found, 0)
    corner, normal = body.corners[chosen], body.normals[chosen]
    along = np.einsum("ij,ij->i", normal, direction)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.einsum("ij,ij->i", corner[:, 0] - start, normal) / along
        point = start + distance[:, None] * direction
        inside = _from_edges(corner, normal, point, body.altitude[chosen])
        good &= (inside > doubt) & (distance > 4.0 * doubt) & ((along > 0.0) != entering)
        good &= np.abs(normal[:, 2]) >= STEEP
    return distance, np.where((along < 0.0)[:, None], -normal, normal), good


def _from_edges(corner: Floats, normal: Floats, point: Floats, altitude: Floats) -> Floats:
    """Distance (n,) of points in their triangles' planes from the nearest edge, negative outside."""
    nearest = np.full(len(point), np.inf)
    for k in range(3):
        a, b = corner[:, (k + 1) % 3], corner[:, (k + 2) % 3]
        edge = b - a
        across = np.cross(normal, edge)
        length = np.linalg.norm(edge, axis=1)
        nearest = np.minimum(nearest, np.einsum("ij,ij->i", point - a, across) / length)
    return np.where(altitude.min(axis=1) > 0.0, nearest, -np.inf)


# -- a picture -------------------------------------------------------------------------------


def first_triangle(
    tree: Tree, first: int, end: int, root: int, origin: Floats, direction: Floats, limit: Floats
) -> tuple[Floats, Ints]:
    """First triangle that each ray meets; as `median_tree.nearest_triangle`, by Embree where it is installed.

    Parameters
    ----------
    tree : Tree
        Several meshes behind one another.
    first, end : int
        Triangles of this mesh in `tree.corners`; `root` is its first node.
    origin, direction : (n, 3) arrays; limit : (n,)
        As there; so is the return value.
    """
    if len(origin) < MANY or not installed() or first == end:
        return nearest_triangle(tree, root, origin, direction, limit)
    corners = tree.corners[first:end]
    low, high = tree.low[root], tree.high[root]
    middle, reach = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
    length = np.linalg.norm(direction, axis=1)
    unit = direction / length[:, None]
    # rays start close to the mesh: single precision counts from there
    ahead = np.maximum(0.0, np.einsum("ij,ij->i", middle - origin, unit) - 1.5 * reach)
    start = origin + ahead[:, None] * unit - middle
    which = name_first(_kept_scene(tree, first, end, middle), start, unit)
    hit = which >= 0
    distance, triangle = limit.copy(), np.full(len(origin), -1, dtype=np.int64)
    rows = np.flatnonzero(hit)
    t = meet_each(corners[which[rows]], origin[rows], direction[rows])
    sound = t > 0.0
    closer = rows[sound & (t < limit[rows])]
    distance[closer], triangle[closer] = t[sound & (t < limit[rows])], which[closer] + first
    again = rows[~sound]
    if len(again):
        distance[again], triangle[again] = nearest_triangle(
            tree, root, origin[again], direction[again], limit[again]
        )
    return distance, triangle


def _kept_scene(tree: Tree, first: int, end: int, middle: Floats) -> Any:
    """Embree's tree of a mesh, cached with the lifetime of `tree`."""
    key = id(tree), first
    kept = _SCENES.get(key)
    if kept is None or kept[0] is not tree:
        kept = (tree, embree_scene(tree.corners[first:end] - middle))
        if len(_SCENES) >= KEPT_SCENES:
            _SCENES.clear()
        _SCENES[key] = kept
    return kept[1]
