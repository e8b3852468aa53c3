"""A mesh in the numbers the tracer needs: one cell's facets as planes over its footprint, and where to find
them.

A sheet's mesh is a height field of one cell's triangles, repeated. In a cell the ray's facet is looked up in
a regular grid of bins, and the neighbour across each edge is known. The walk handles the cell's border,
exactly as for smooth lenses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Bools, Floats, Ints
from clacad.sheet.window import PLANE, Body, Face, Window, lens_height_and_normal
from clacad.storage.errors import LimitRefused
from clacad.tracing.layout import BodyPlan, FacePlan, Layout, lay_out

if TYPE_CHECKING:
    from clacad.mesh import Mesh
    from clacad.mesh.body_mesh import BodyMesh
    from clacad.mesh.land_ring import Tiled
    from clacad.mesh.prototile import Prototile

    TilingMaker = Callable[[float, BodyMesh, Tiled, "Normals"], "MeshTiling"]


Normals = Literal["facet", "vertex"]

LENS, LAND, VOID = 0, 1, 2
BEYOND = 2**59
"""Levels beyond this represent a missing face."""

# Columns of a tile's row: first facet, first bin, bins in x and y, corner of the grid, bins per length,
# diagonal.
FIRST, BIN, BINS_X, BINS_Y, LOW_X, LOW_Y, PER_X, PER_Y, SPLIT, TILE_NUMBERS = range(10)


ABSENT, BY_TILE = -1, -2
"""Entries of `CellHeights.first` below 0: no such cell in the mesh; BY_TILE − k: the planes of tile k."""


class CellHeights(NamedTuple):
    """Heights of the points of those cells of a non-uniform sheet that have one footprint.

    first : (faces, n1, n2) ints
        Number of the first height of each cell on each face, or an entry below 0; rows as in `as_table`.
    height : (k,) float32. In the sheet frame, point by point; a mesh's heights are exact in this precision.
    corner : (m, 3) ints. Points at the corners of each facet.
    normal : (k, 3) or (0, 3). Exact unit normals towards +z at the points, for normals = "vertex".
    """

    first: Ints
    height: NDArray[np.float32]
    corner: Ints
    normal: Floats


class Tiles(NamedTuple):
    """Facets of every tiling, one after the other.

    table : (tiles, TILE_NUMBERS)
    of : (bodies, 2) ints. Tile of a body's front and back.
    weight : (m, 3, 3)
        Barycentric coordinate k of facet i over (x, y) is a x + b y + c; inside where all three are ≥ 0.
    `beside` : (m, 3) ints. Facet across the edge opposite corner k, −1 at the tile's border.
    plane : (m, 2, 3)
        Height a x + b y + c of front and back over the body's level; NaN where there is no surface.
    part : (m, 2) uint8. LENS, LAND or VOID.
    start : (bins + 1,) ints, member : ints
        Facets of bin b are member[start[b] : start[b + 1]], those nearest its middle first.
    half : (2 bins,) ints. Facets that are exactly one half of a bin: 2 b below its diagonal, 2 b + 1 beyond;
        −1 for none. Diagonals rise (SPLIT = −1) or fall (+1).
    lens : (2 bins, 2, 3). Planes of those facets where they belong to the lens, NaN elsewhere.
    normal : (m, 2, 3, 3) or (0, 2, 3, 3)
        Unit normals towards +z of front and back at the facet's corners, for normals = "vertex".
    own : None on a uniform sheet: kernels are then compiled without the code that reads it.
    """

    table: Floats
    of: Ints
    weight: Floats
    beside: Ints
    plane: Floats
    part: NDArray[np.uint8]
    start: Ints
    member: Ints
    half: Ints
    lens: Floats
    normal: Floats
    own: CellHeights | None = None


@dataclass(frozen=True, eq=False)
class TiledFace(FacePlan):
    """A face made of the mesh's facets: bounds as of any face, the surface in the tiles.

    tile : Index of its tile; of a plane face that of its body, whose facets are level.
    side : 0 or 1. Front or back.
    """

    tiles: Tiles = field(kw_only=True)
    tile: int = field(kw_only=True)
    side: int = field(kw_only=True)


@dataclass(frozen=True, eq=False)
class Tile:
    """One tiling of one body, facets in the cell frame.

    corners : (m, 3, 2) lengths, heights : (m, 3, 2) front and back at the corners over the body's level
    land : heights of the land as meshed, NaN where there is none
    reach : (2, 3). Of front and back: lowest and highest point, and steepest slope of the lens.
    """

    corners: Floats
    heights: Floats
    triangles: Ints
    part: NDArray[np.uint8]
    normal: Floats
    land: tuple[float, float]
    reach: Floats


def refuse_many(count: int, most: int) -> None:
    """Reject a mesh with too many triangles of cells that differ. Raises LimitRefused."""
    if count > most:
        raise LimitRefused(
            f'rung "mesh": about {count:,} triangles of cells that differ are more than the {most:,}'
            " that are held; use fewer quads or fewer cells"
        )


@dataclass(frozen=True, eq=False)
class MeshTiling:
    """What the cells of one tiling of a body look like.

    tiles : The tile of equal footprints; then those of single cells.
    first : (2, n1, n2) ints. Of front and back, as in `CellHeights`, counted from the tiling's first tile.
    height, normal : of front and back, as in `CellHeights`
    """

    tiles: list[Tile]
    first: Ints = field(default_factory=lambda: np.zeros((2, 0, 0), dtype=np.int64))
    height: tuple[NDArray[np.float32], ...] = ()
    normal: tuple[Floats, ...] = ()


def lay_out_mesh(
    window: Window, mesh: Mesh, normals: Normals, own_tiling: TilingMaker | None = None
) -> tuple[Layout, Tiles]:
    """Prepare a window and its mesh for tracing.

    window : Window that defines cells, land and baffle; the mesh defines heights.
    normals : "facet" or "vertex". Normals of the facets, or the exact normals at the vertices, interpolated.
    own_tiling : `own_sheet.own_tiling`, for a non-uniform sheet.
    Raises ValueError: The mesh has other bodies than the window.
    """
    if [body.name for body in mesh.bodies] != [body.name for body in window.bodies]:
        raise ValueError("the mesh was made from a window with other bodies")
    exact = lay_out(window)
    tiles: list[Tile] = []
    of, plans, sides = [], [], list[tuple[MeshTiling, int, int]]()
    for plan, meshed in zip(exact.bodies, mesh.bodies, strict=True):
        make = uniform_tiling if own_tiling is None else own_tiling
        found = [make(plan.level, meshed, tiled, normals) for tiled in meshed.tiled]
        starts = len(tiles) + np.cumsum([0, *(len(one.tiles) for one in found)])
        which = [next(k for k, one in enumerate(found) if _has(one.tiles[0], side)) for side in (0, 1)]
        of.append([int(starts[k]) for k in which])
        plans.append(_plan(plan, [one.tiles for one in found], which))
        sides += [(found[k], side, int(starts[k])) for side, k in enumerate(which)]
        tiles += [tile for one in found for tile in one.tiles]
    own = None if own_tiling is None else _cell_heights(sides, tiles)
    joined = _joined(tiles, np.array(of), own)
    bodies = (_tiled(plan, joined, one) for plan, one in zip(plans, of, strict=True))
    return replace(exact, bodies=tuple(bodies)), joined


def uniform_tiling(level: float, meshed: BodyMesh, tiled: Tiled, normals: Normals) -> MeshTiling:
    """One tiling, of identical cells, of a body at a level."""
    return MeshTiling([make_tile(meshed.body, tiled.maker.tile, level, normals)])


def _cell_heights(sides: list[tuple[MeshTiling, int, int]], tiles: list[Tile]) -> CellHeights:
    """Heights of all faces in one list: a tiling, one of its sides, and its first tile, face by face."""
    firsts, start = [], 0
    for tiling, side, tile in sides:
        first = tiling.first[side]
        firsts.append(np.where(first >= 0, first + start, np.where(first <= BY_TILE, first - tile, first)))
        start += len(tiling.height[side])
    corner = np.concatenate([tile.triangles for tile in tiles])
    height, normal = (
        np.ascontiguousarray(np.concatenate([getattr(tiling, name)[side] for tiling, side, _ in sides]))
        for name in ("height", "normal")
    )
    return CellHeights(np.array(firsts), height, corner, normal)


def _tiled(plan: BodyPlan, tiles: Tiles, of: list[int]) -> BodyPlan:
    """Body whose faces know their facets; `of` (2,): the tiles of front and back."""
    front, back = (
        TiledFace(
            **{one.name: getattr(face, one.name) for one in fields(face)},
            tiles=tiles,
            tile=of[side],
            side=side,
        )
        for side, face in enumerate((plan.front, plan.back))
    )
    return replace(plan, front=front, back=back)


def _has(tile: Tile, side: int) -> bool:
    return bool(np.isfinite(tile.heights[..., side]).any())


def make_tile(body: Body, prototile: Prototile, level: float, normals: Normals) -> Tile:
    """Read a prototile: footprint, levels, parts."""
    plan, step = prototile.plan, prototile.step
    levels = prototile.corner_levels()
    heights = np.where(np.abs(levels) > BEYOND, np.nan, levels * step - level)
    normal = np.zeros((0, 2, 3, 3))
    if normals == "vertex":
        per_point = np.stack([_vertex_normals(face, plan.xy) for face in (body.front, body.back)], axis=1)
        normal = per_point[plan.triangles].transpose(0, 2, 1, 3)
    part = prototile.part
    front, back = (np.nan if abs(flat) > BEYOND else flat * step - level for flat in prototile.land)
    corners = plan.xy[plan.triangles]
    reach = np.array([reach_of(corners, heights[..., side], part[:, side] == LENS) for side in (0, 1)])
    return Tile(corners, heights, plan.triangles, part, normal, (front, back), reach)


def reach_of(corners: Floats, heights: Floats, lens: Bools) -> tuple[float, float, float]:
    """Lowest and highest of heights (m, 3), and the steepest slope of the facets of the lens."""
    if not np.isfinite(heights).any():
        return np.nan, np.nan, 0.0
    a, b, _ = _planes(corners, heights).T
    steepest = float(np.hypot(a, b)[lens].max(initial=0.0))
    return float(np.nanmin(heights)), float(np.nanmax(heights)), steepest


def _vertex_normals(face: Face, xy: Floats) -> Floats:
    if face.array is None:
        return np.tile([0.0, 0.0, 1.0], (len(xy), 1))
    return lens_height_and_normal(face, xy[:, 0], xy[:, 1])[1]


def _plan(plan: BodyPlan, tiles: list[list[Tile]], sides: list[int]) -> BodyPlan:
    """Body with the mesh's bounds in place of the lenses'; `tiles` of each of its tilings."""
    front, back = (
        _plan_face(face, tiles[k], side)
        for side, (face, k) in enumerate(zip((plan.front, plan.back), sides, strict=True))
    )
    whole = all(not (tile.part == VOID).any() for tiling in tiles for tile in tiling)
    pad = 1e-9 * float(np.ptp(tiles[0][0].corners))
    return replace(
        plan,
        front=front,
        back=back,
        low=front.low - pad,
        high=back.high + pad,
        covered=whole if plan.columnar else front.high < back.low,
        separate=front.high < back.low,
    )


def _plan_face(face: FacePlan, tiles: list[Tile], side: int) -> FacePlan:
    land = tiles[0].land[side] if face.array is not None else face.land
    lows, highs, slopes = np.array([tile.reach[side] for tile in tiles]).T
    return replace(
        face,
        surface=PLANE,
        vertex=(0.0, 0.0, 0.0),
        rotation=None,
        low=float(np.fmin(lows.min(), land)),
        high=float(np.fmax(highs.max(), land)),
        slope=float(slopes.max()) * (1.0 + 1e-12) if face.array is not None else 0.0,
        whole=all(bool((tile.part[:, side] == LENS).all()) for tile in tiles),
        land=land,
        change=None,
    )


def _planes(corners: Floats, heights: Floats) -> Floats:
    """Coefficients (m, 3) of z = a x + b y + c through three corners."""
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p, q = heights[:, 1] - heights[:, 0], heights[:, 2] - heights[:, 0]
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    a = (p * v[:, 1] - q * u[:, 1]) / area
    b = (q * u[:, 0] - p * v[:, 0]) / area
    return np.stack([a, b, heights[:, 0] - a * corners[:, 0, 0] - b * corners[:, 0, 1]], axis=1)


def weights_of(corners: Floats) -> Floats:
    """Coefficients (m, 3, 3) of the barycentric coordinates."""
    return np.stack([_planes(corners, np.eye(3)[k] + 0.0 * corners[:, :, 0]) for k in range(3)], axis=1)


def _beside(triangles: Ints) -> Ints:
    """Facet across the edge opposite each corner, −1 where there is none."""
    m = len(triangles)
    ends = np.stack([triangles[:, [1, 2]], triangles[:, [2, 0]], triangles[:, [0, 1]]], axis=1)
    key = np.sort(ends, axis=2).reshape(-1, 2)
    code = key[:, 0] * (int(triangles.max()) + 1) + key[:, 1]
    order = np.argsort(code, kind="stable")
    twin = np.flatnonzero(code[order][:-1] == code[order][1:])
    out = np.full(3 * m, -1, dtype=np.int64)
    out[order[twin]], out[order[twin + 1]] = order[twin + 1] // 3, order[twin] // 3
    return out.reshape(m, 3)


def _binned(corners: Floats) -> tuple[list[float], Ints, Ints]:
    """Grid of bins over a tile: the table's numbers, starts and members."""
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    count = max(1, int(round(np.sqrt(0.5 * len(corners)))))
    width = (high - low) / count
    hair = 1e-9 * width  # a facet on a bin's border is in both bins
    first = np.clip(((corners.min(axis=1) - hair - low) / width).astype(np.int64), 0, count - 1)
    last = np.clip(((corners.max(axis=1) + hair - low) / width).astype(np.int64), 0, count - 1)
    across = last - first + 1  # bins that contain a facet, along x and y
    facets, bins = over_bins(np.arange(len(corners)), first, across, count)
    middle = low + width * (np.stack([bins % count, bins // count], axis=1) + 0.5)
    weights = weights_of(corners)[facets]
    deep = (np.einsum("mkc,mc->mk", weights[..., :2], middle) + weights[..., 2]).min(axis=1)
    order = np.lexsort([-deep, bins])
    start = np.searchsorted(bins[order], np.arange(count * count + 1))
    table = [float(count), float(count), *low.tolist(), *(1.0 / width).tolist()]
    return table, start.astype(np.int64), facets[order].astype(np.int64)


def over_bins(which: Ints, first: Ints, across: Ints, bins_x: int) -> tuple[Ints, Ints]:
    """Every pair of a facet of `which` (k,) and a bin it is over.

    first, across : (m, 2). Of all facets: the first bin along x and y, and the number of bins from there.
    """
    each = across[which].prod(axis=1)
    facet = np.repeat(which, each)
    place = np.arange(len(facet)) - np.repeat(np.cumsum(each) - each, each)
    j, i = np.divmod(place, across[facet, 0])
    return facet, (first[facet, 1] + j) * bins_x + first[facet, 0] + i


def _halves(corners: Floats, table: list[float]) -> tuple[float, Ints]:
    """Direction of a grid's diagonals, and the facet that fills each half of each bin."""
    nx, ny, low, per = int(table[0]), int(table[1]), np.array(table[2:4]), np.array(table[4:6])
    place = (corners - low) * per
    near = np.rint(place)
    bins = near.min(axis=1).astype(np.int64)
    u, v = (near - bins[:, None]).transpose(2, 0, 1)
    fits = (np.abs(place - near) < 1e-9).all(axis=(1, 2)) & (u <= 1).all(axis=1) & (v <= 1).all(axis=1)
    fits &= (bins >= 0).all(axis=1) & (bins < [nx, ny]).all(axis=1)
    best, found = 1.0, np.full(2 * nx * ny, -1, dtype=np.int64)
    for split in (-1.0, 1.0):
        beyond = v.mean(axis=1) + split * u.mean(axis=1) > 0.5 + 0.5 * split
        on = np.abs(v + split * u - (0.5 + 0.5 * split)) < 0.5  # two corners lie on the diagonal
        chosen = np.flatnonzero(fits & (on.sum(axis=1) == 2))
        half = np.full(2 * nx * ny, -1, dtype=np.int64)
        half[2 * (bins[chosen, 1] * nx + bins[chosen, 0]) + beyond[chosen]] = chosen
        if (half >= 0).sum() > (found >= 0).sum():
            best, found = split, half
    return best, found


def _joined(tiles: list[Tile], of: Ints, own: CellHeights | None) -> Tiles:
    """Concatenate tilings in the arrays of `Tiles`; `of` (bodies, 2): tile of each front and back."""
    table: list[list[float]] = []
    starts, members, facets = [np.zeros(1, dtype=np.int64)], list[Ints](), 0
    beside, halves = [], list[Ints]()
    for tile in tiles:
        numbers, start, member = _binned(tile.corners)
        split, half = _halves(tile.corners, numbers)
        halves.append(np.where(half >= 0, half + facets, -1))
        table.append([float(facets), float(sum(len(s) - 1 for s in starts[1:])), *numbers, split])
        starts.append(np.append(start[:-1], start[-1]) + sum(len(k) for k in members))
        members.append(member + facets)
        near = _beside(tile.triangles)
        beside.append(np.where(near >= 0, near + facets, -1))
        facets += len(tile.corners)
    planes = [np.stack([_planes(t.corners, t.heights[..., s]) for s in (0, 1)], axis=1) for t in tiles]
    plane = np.ascontiguousarray(np.concatenate(planes))
    part, half = np.concatenate([t.part for t in tiles]).astype(np.uint8), np.concatenate(halves)
    return Tiles(
        table=np.array(table),
        of=of,
        weight=np.concatenate([weights_of(t.corners) for t in tiles]),
        beside=np.concatenate(beside),
        plane=plane,
        part=part,
        start=_chained(starts[1:]),
        member=np.concatenate(members),
        half=half,
        lens=np.where(((half >= 0)[:, None] & (part[half] == LENS))[..., None], plane[half], np.nan),
        normal=np.ascontiguousarray(np.concatenate([t.normal for t in tiles])),
        own=own,
    )


def _chained(starts: list[Ints]) -> Ints:
    """Starts of consecutive grids in one list: each grid's last entry is the next one's first."""
    return np.concatenate([*(s[:-1] for s in starts), starts[-1][-1:]])
