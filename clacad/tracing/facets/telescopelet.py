"""Light through the faces of a file, one telescopelet at a time, in double precision: triangles or heights.

*Triangles.* Those over one cell are gathered. In each body rays meet the first facet that faces outward
against them, then the first that faces outward along them. Walls (facets nearly parallel to z) let nothing
through. Nothing of the mesher or of the exact surfaces is used.

*Heights on a grid*, as in maps and point files, are a bicubic surface: the cubic spline through the samples
of one cell. Beyond the border of the cell the samples belong to another lens. There, and where land covers
the lens, the surface continues as the design's lens, displaced by the nearest sample's deviation: a spline
must not ring at an edge of the part.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Bools, Bytes, Floats, Ints, Pair2, Rows
from clacad.optics.rays import NO_CELL, Fate, Rays, TraceResult
from clacad.optics.surface import meet, refract
from clacad.sheet.window import Body, Face, Window, face_height, in_optical_tile, lens_height
from clacad.tracing.facets.hierarchy import Hierarchy, hierarchy

RINGS = 3
"""Nodes by which the grid extends beyond the samples."""

ROUNDS = 30
SAME = 1e-13
"""Height over the pitch below which a ray has met the surface."""


@dataclass(frozen=True, eq=False)
class SampledFace:
    """One face over one cell as a bicubic spline.

    face : Face of the design, for its land.
    origin : (3,) lengths. Centre of the face's cell in the sheet frame, z = 0.
    window : Window whose optical zone ends the face.
    low, step : (2,) lengths. First node, cell frame, and spacing of nodes.
    coefficients : (nx + 2, ny + 2) lengths
        Coefficients of cubic B-splines; node (i, j) is the middle of the 3 × 3 block that begins at [i, j].
    """

    face: Face
    origin: Floats
    window: Window
    low: Floats
    step: Floats
    coefficients: Floats


def sampled_face(window: Window, face: Face, origin: Floats, samples: Floats, step: Floats) -> SampledFace:
    """Fit a bicubic surface to samples of one cell.

    window, face
    origin : (3,) lengths. Centre of the face's cell in the sheet frame, z = 0.
    samples : (m, 3) lengths. x and y in the cell frame, on a grid; z in the sheet frame.
    step : (2,) lengths. Spacing of samples along x and y.
    Raises ValueError: Fewer than 4 × 4 samples lie on the lens.
    """
    known = _samples_on_lens(window, face, samples)
    if len(known) < 16:
        raise ValueError(
            f"{len(known)} samples lie on the lens of a cell; 16 and more make a bicubic surface"
        )
    first = known[:, :2].min(axis=0)
    index = np.rint((known[:, :2] - first) / step).astype(np.int64)
    low = first - RINGS * step
    count = index.max(axis=0) + 1 + 2 * RINGS
    x, y = (low[k] + step[k] * np.arange(count[k]) for k in (0, 1))
    off = np.full(tuple(count), np.nan)
    off[index[:, 0] + RINGS, index[:, 1] + RINGS] = known[:, 2] - _lens(face, known[:, 0], known[:, 1])
    gx, gy = np.meshgrid(x, y, indexing="ij")
    height = _lens(face, gx.ravel(), gy.ravel()).reshape(gx.shape) + _nearest(off)
    rows = _interpolation(count[0])
    columns = _interpolation(count[1])
    padded = np.zeros((count[0] + 2, count[1] + 2))
    padded[1:-1, 1:-1] = height
    coefficients = np.linalg.solve(columns, np.linalg.solve(rows, padded).T).T
    return SampledFace(face, np.asarray(origin), window, low, np.asarray(step), coefficients)


def _samples_on_lens(window: Window, face: Face, samples: Floats) -> Floats:
    """Those samples (m, 3) that lie in the optical zone of their cell and not on land."""
    x, y = samples[:, 0], samples[:, 1]
    here = np.isfinite(samples).all(axis=1) & in_optical_tile(window, x, y)
    on_lens = here & (face_height(window, face, x, y) == lens_height(face, x, y))
    return np.asarray(samples[on_lens])


def _lens(face: Face, x: Floats, y: Floats) -> Floats:
    """Height of the design's lens; beyond its equator that of its apex, which no light reaches."""
    z = lens_height(face, x, y)
    return np.where(np.isfinite(z), z, face.vertex[2])


def _nearest(values: Floats) -> Floats:
    """Replace NaN in a table (m, n) by the nearest known neighbours, ring after ring."""
    filled = values.copy()
    while np.isnan(filled).any():
        padded = np.pad(filled, 1, constant_values=np.nan)
        around = np.stack(
            [
                padded[1 + i : padded.shape[0] - 1 + i, 1 + j : padded.shape[1] - 1 + j]
                for i in (-1, 0, 1)
                for j in (-1, 0, 1)
            ]
        )
        known = np.isfinite(around)
        count = known.sum(axis=0)
        mean = np.where(known, around, 0.0).sum(axis=0) / np.maximum(count, 1)
        filled = np.where(np.isnan(filled) & (count > 0), mean, filled)
    return filled


def _interpolation(count: int) -> Floats:
    """Matrix (n + 2, n + 2) from coefficients to heights at n nodes; outer rows: no third derivative."""
    matrix = np.zeros((count + 2, count + 2))
    for k in range(count):
        matrix[k + 1, k : k + 3] = (1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0)
    matrix[0, :4] = matrix[-1, -4:] = (-1.0, 3.0, -3.0, 1.0)
    return matrix


def height_and_slope(face: SampledFace, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
    """Height (n,) of the surface at positions in its cell frame, and its derivatives along x and y."""
    cells, values, slopes = [], [], []
    for k, at in enumerate((x, y)):
        most = face.coefficients.shape[k] - 4
        u = np.clip((at - face.low[k]) / face.step[k], 0.0, most + 1.0)
        cell = np.minimum(u.astype(np.int64), most)
        t = u - cell
        cells.append(cell)
        values.append(
            np.stack([(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3]) / 6.0
        )
        slopes.append(
            np.stack([-((1 - t) ** 2), 3 * t**2 - 4 * t, -3 * t**2 + 2 * t + 1, t**2]) / (2.0 * face.step[k])
        )
    z, dx, dy = (np.zeros(len(x)) for _ in range(3))
    for i in range(4):
        for j in range(4):
            c = face.coefficients[cells[0] + i, cells[1] + j]
            z += c * values[0][i] * values[1][j]
            dx += c * slopes[0][i] * values[1][j]
            dy += c * values[0][i] * slopes[1][j]
    return z, dx, dy


@dataclass(frozen=True, eq=False)
class GraphFace:
    """One face over one cell as a height with slopes, such as a face as a process makes it.

    face : Face of the design, for its land.
    origin : (3,) lengths. Centre of the face's cell in the sheet frame, z = 0.
    window : Window whose optical zone ends the face.
    height : Height (n,) of the sheet frame over places of the cell frame, and its slopes along x and y.
    aside : Which places (n,) of the cell frame are no lens form; light through them ends as LAND.
    scale : Factors along x and y of the cell as designed.
    """

    face: Face
    origin: Floats
    window: Window
    height: Callable[[Floats, Floats], tuple[Floats, Floats, Floats]]
    aside: Callable[[Floats, Floats], Bools]
    scale: Pair2


def meet_sampled(
    face: SampledFace | GraphFace, position: Floats, direction: Floats
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Intersect rays with a surface given by heights.

    position, direction : (n, 3) arrays. Sheet frame; unit directions with d_z > 0.

    Returns
    -------
    distance : (n,) lengths
        NaN where the surface is not met ahead within the optical zone of its cell.
    normal : (n, 3)
        Towards +z, not unit.
    land : (n,) bool
        Where the design covers the lens with land.
    """
    local = position - face.origin
    distance = (face.face.vertex[2] - local[:, 2]) / direction[:, 2]
    size = min(face.window.lattice.pitch)
    z, dx, dy = (np.zeros(len(local)) for _ in range(3))
    gap = np.full(len(local), np.inf)
    for _ in range(ROUNDS):
        x, y, height = (local + distance[:, None] * direction).T
        z, dx, dy = face.height(x, y) if isinstance(face, GraphFace) else height_and_slope(face, x, y)
        gap = height - z
        if not (np.abs(gap) > SAME * size).any():
            break
        rate = direction[:, 2] - dx * direction[:, 0] - dy * direction[:, 1]
        distance = distance - gap / np.where(rate > 0.0, rate, 1.0)
    x, y, _ = (local + distance[:, None] * direction).T
    rounded = None
    if isinstance(face, GraphFace):
        rounded = face.aside(x, y)
        x, y = x / face.scale[0], y / face.scale[1]
    inside = in_optical_tile(face.window, x, y)
    met = inside & (np.abs(gap) <= 1e3 * SAME * size) & (distance >= 0.0)
    if rounded is not None and face.face.land is None:
        land = met & rounded
    else:
        land = met & ~(face_height(face.window, face.face, x, y) == lens_height(face.face, x, y))
    if rounded is not None and face.face.land is not None:
        met, land = met & ~land, met & rounded & ~land
    return np.where(met, distance, np.nan), np.column_stack([-dx, -dy, np.ones(len(dx))]), land


@dataclass(frozen=True, eq=False)
class FacetFace:
    """The facets of one side of one body over one cell, in a tree of boxes.

    trees : One body: the facets `trees.corner` (t, 3, 3), lengths relative to `origin`, wound
        counter-clockwise seen from outside.
    normals : (t, 3). Outward, length twice the facet's area.
    origin : (3,) lengths. Sheet frame.
    z_range : (low, high), lengths, relative to origin
    land : (t,) bool. Facets that are flat land: light through them is not lens light.
    """

    trees: Hierarchy | None
    normals: Floats
    origin: Floats
    z_range: tuple[float, float]
    land: Bools


@dataclass(frozen=True, eq=False)
class ExactFace:
    """A face of the design in place of facets, where a file contains only one of two bodies.

    origin : (3,) lengths. Centre of the face's cell in the sheet frame, z = 0.
    window : Window whose optical zone ends the face; None: it continues.
    scale : Factors along x and y of the cell as designed.
    """

    face: Face
    origin: Floats
    window: Window | None = None
    scale: Pair2 = (1.0, 1.0)


AnyFace = FacetFace | ExactFace | SampledFace | GraphFace


@dataclass(frozen=True, eq=False)
class FacetBody:
    """Front and back of one body over one cell; `body`, of the design, has the index of its light."""

    front: AnyFace
    back: AnyFace
    body: Body


def facet_face(corners: Floats, origin: Floats, land: Bools | None = None) -> FacetFace:
    """Prepare facets (t, 3, 3) of the sheet frame, about `origin` (3,); `land` (t,) marks flat land."""
    flat_land = np.zeros(len(corners), dtype=bool) if land is None else land
    local = np.asarray(corners, dtype=np.float64) - origin
    if not len(local):
        return FacetFace(None, np.zeros((0, 3)), origin, (0.0, 0.0), flat_land)
    rank, trees = hierarchy([local])
    local = trees.corner
    normals = np.cross(local[:, 1] - local[:, 0], local[:, 2] - local[:, 0])
    return FacetFace(
        trees, normals, origin, (float(local[..., 2].min()), float(local[..., 2].max())), flat_land[rank]
    )


def on_land(window: Window, face: Face, corners: Floats) -> Bools:
    """Which facets (k, 3, 3) are the face's flat land: all corners at its height, up to float32 rounding."""
    if face.land is None:
        return np.zeros(len(corners), dtype=bool)
    reach = max(abs(v) for v in window.z_range)
    room = 1e-6 * min(window.lattice.pitch) + 2.0**-23 * reach
    return np.asarray((np.abs(corners[..., 2] - face.land) <= room).all(axis=1))


def first_crossing(
    face: FacetFace, position: Floats, direction: Floats, entering: bool
) -> tuple[Floats, Ints]:
    """Distance to the first facet that light enters (or leaves) through, and its number.

    position, direction : (n, 3) arrays. Sheet frame; unit directions with d_z > 0.
    entering : Facets facing the light (outward normal against it), else those facing along it.

    Returns
    -------
    distance : (n,) array
        NaN where no facet is met ahead.
    facet : (n,) ints
        −1 there.
    """
    distance = np.full(len(position), np.nan)
    facet = np.full(len(position), -1, dtype=np.int64)
    if face.trees is not None and len(position):
        from clacad.tracing.facets.compiled_hierarchy import first_facet

        start, ray = position - face.origin, np.ascontiguousarray(direction)
        first_facet(face.trees, face.normals, start, ray, -1.0 if entering else 1.0, distance, facet)
    return distance, facet


def _meet(face: AnyFace, position: Floats, direction: Floats, entering: bool) -> tuple[Floats, Floats, Bools]:
    """Distance (n,) along each ray, NaN for none; normal (n, 3) in the light's direction; land or not."""
    if isinstance(face, FacetFace):
        if not len(face.normals):
            return np.full(len(position), np.nan), position, np.zeros(len(position), dtype=bool)
        distance, facet = first_crossing(face, position, direction, entering)
        return distance, face.normals[facet] * (-1.0 if entering else 1.0), face.land[facet]
    if isinstance(face, SampledFace | GraphFace):
        return meet_sampled(face, position, direction)
    turn = face.face.rotation
    apex = face.origin + np.asarray(face.face.vertex)
    met = meet(face.face.surface, (position - apex) @ turn, direction @ turn)
    distance = np.where(met.distance >= 0.0, met.distance, np.nan)
    if face.window is not None and face.face.array is not None:  # a hit beyond belongs to another lens
        x, y, _ = (position + distance[:, None] * direction - face.origin).T
        inside = in_optical_tile(face.window, x / face.scale[0], y / face.scale[1])
        distance = np.where(inside, distance, np.nan)
    return distance, met.gradient @ turn.T, np.zeros(len(position), dtype=bool)


def trace_facets(bodies: tuple[FacetBody, ...], rays: Rays) -> TraceResult:
    """Send rays through the facets over one telescopelet.

    bodies : In the order of the light.
    rays : Sheet frame, of one wavelength, or without: the design's.
    Returns: ALIVE where the ray entered and left every body over this telescopelet and goes on forwards, LAND
        where it did so through land; TIR, BACKWARD; WALL where no facet was met (a wall, or another cell).
        `cell` and `order` are not known here.
    """
    passing = _Passing.launched(rays)
    live = np.arange(len(rays))
    number, before = 0, 1.0
    line = None if rays.wavelength is None or not len(rays) else float(rays.wavelength[0])
    index = [one.body.index_at(line) for one in bodies] + [1.0]
    for k, one in enumerate(bodies):
        if not one.body.joined:
            live = passing.cross(one.front, live, number, (before, index[k]), True)
        joint = k + 1 < len(bodies) and bodies[k + 1].body.joined
        after = index[k + 1] if joint else 1.0
        live = passing.cross(one.back, live, number + 1, (index[k], after), False, joint)
        number, before = number + 2, after
    passing.fate[live[passing.aside[live]]] = Fate.LAND
    unknown = np.full((len(rays), 2), NO_CELL, dtype=np.int32)
    return TraceResult(
        passing.position,
        passing.direction,
        passing.fate,
        passing.path,
        unknown,
        unknown,
        passing.surface,
        np.ones(len(rays)),
    )


@dataclass(frozen=True, eq=False)
class _Passing:
    """n rays on their way through facets; columns are changed in place, `aside` (n,): through land."""

    position: Floats
    direction: Floats
    fate: Bytes
    surface: NDArray[np.int32]
    path: Floats
    aside: Bools

    @classmethod
    def launched(cls, rays: Rays) -> _Passing:
        """Rays before the first face, of unit direction."""
        n = len(rays)
        direction = rays.direction / np.linalg.norm(rays.direction, axis=1, keepdims=True)
        fate, surface = np.full(n, Fate.ALIVE, dtype=np.uint8), np.full(n, NO_CELL, dtype=np.int32)
        return cls(rays.position.copy(), direction, fate, surface, np.zeros(n), np.zeros(n, dtype=bool))

    def cross(
        self,
        face: AnyFace,
        live: Rows,
        number: int,
        indices: tuple[float, float],
        entering: bool,
        joint: bool = False,
    ) -> Rows:
        """Move live rays (k,) to face `number` and refract them between two indices; return those left.

        A flat `joint` has no cells: light beyond its facets meets the same plane.
        """
        distance, normal, on_land = _meet(face, self.position[live], self.direction[live], entering)
        if joint and isinstance(face, FacetFace) and face.trees is not None and np.ptp(face.z_range) == 0.0:
            level = face.origin[2] + face.z_range[0]
            way = (level - self.position[live, 2]) / self.direction[live, 2]
            beside = np.isnan(distance) & (way >= 0.0)
            distance = np.where(beside, way, distance)
            normal = np.where(beside[:, None], [0.0, 0.0, 1.0], normal)
            on_land = on_land & ~beside
        met = np.isfinite(distance)
        self.aside[live[met & on_land]] = True
        self.fate[live[~met]] = Fate.WALL
        live, distance, normal = live[met], distance[met], normal[met]
        self.position[live] += distance[:, None] * self.direction[live]
        self.path[live] += indices[0] * distance
        self.surface[live] = number
        root = np.einsum("ij,ij->i", normal, self.direction[live])
        out, _ = refract(self.direction[live], normal, root, *indices)
        reflected = np.isnan(out[:, 0])
        self.fate[live[reflected]] = Fate.TIR
        live, out = live[~reflected], out[~reflected]
        self.direction[live] = out
        back = out[:, 2] <= 0.0
        self.fate[live[back]] = Fate.BACKWARD
        return live[~back]
