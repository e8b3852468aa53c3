"""Rung "mesh" of a non-uniform sheet.

*Its own mesh.* Nearly all cells of a tiling have one footprint; their facets differ in the heights of their
corners alone, which are looked up by cell and point (`tiles.CellHeights`). Cells with other footprints, where
faces end or cross within a cell or on its border, are tiles of their own.

*Triangles from any source, and arrays that are turned.* The trees that find triangles know no cells. Light is
traced through the triangles as if they belonged to a uniform sheet without an end
(`triangle_soup.endless_layout`). The cells of every ray are then found from the points where it met the
arrays, in the order in which it met them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.pairs import two_sum
from clacad.base.types import Bools, Floats, Ints, Singles
from clacad.optics.rays import NO_CELL, Fate, Rays, TraceResult
from clacad.sheet.cell_places import places_in_rows
from clacad.sheet.window import Window, heights_and_normals_of_lenses
from clacad.tracing.facets.tiles import (
    ABSENT,
    BY_TILE,
    LENS,
    MeshTiling,
    Normals,
    Tile,
    make_tile,
    refuse_many,
    weights_of,
)
from clacad.tracing.layout import BodyPlan, FacePlan, Layout, colours, lay_out
from clacad.tracing.reference.face import in_footprint, on_line
from clacad.tracing.reference.launch import Beam
from clacad.tracing.reference.walk import Walkers, note_cell, order_of

if TYPE_CHECKING:
    from clacad.mesh.body_mesh import BodyMesh
    from clacad.mesh.cell_batch import CellBatch, OwnMeshCells
    from clacad.mesh.land_ring import Tiled

BATCH = 200_000
"""Facets of the cells whose heights are computed together, about: some megabytes."""

MOST_LOOKED_UP = 200_000_000
"""Largest number of facets of a tiling whose heights are held: about 2 bytes each, 14 with normals."""

MOST_CELLS = 4096
"""Largest number of these cells."""


def own_tiling(level: float, meshed: BodyMesh, tiled: Tiled, normals: Normals) -> MeshTiling:
    """Tiles, and heights of the cells, of one tiling of a body of a non-uniform sheet at a level."""
    lattice, none = meshed.window.lattice, np.zeros(0, dtype=np.float32)
    shape = (2, *lattice.count)
    if tiled.own is None:
        tile = make_tile(meshed.body, tiled.maker.tile, level, normals)
        return MeshTiling([tile], np.full(shape, BY_TILE), (none, none), (np.zeros((0, 3)), np.zeros((0, 3))))
    tile = make_tile(meshed.body, tiled.own.regular.tile, level, normals)
    made = _Cells(level, meshed, tiled.own, normals, tile, np.full(shape, ABSENT))
    cells = lattice.cells() if meshed.cells is None else meshed.cells
    refuse_many(len(cells) * len(tile.corners), MOST_LOOKED_UP // (1 if normals == "facet" else 7))
    many = max(1, min(MOST_CELLS, BATCH // len(tile.corners)))
    for first in range(0, len(cells), many):
        made.add(cells[first : first + many])
    return made.done()


@dataclass(eq=False)
class _Cells:
    """Collects the cells of a tiling; fields as in `MeshTiling`, each list by side."""

    level: float
    meshed: BodyMesh
    own: OwnMeshCells
    normals: Normals
    tile: Tile
    first: Ints
    count: list[int] = field(default_factory=lambda: [0, 0])
    height: tuple[list[Singles], list[Singles]] = field(default_factory=lambda: ([], []))
    normal: tuple[list[Floats], list[Floats]] = field(default_factory=lambda: ([], []))
    rare: list[Tile] = field(default_factory=list)
    reach: list[Floats] = field(default_factory=list)

    def add(self, cells: Ints) -> None:
        """Add cells (n, 2) of the tiling."""
        own, window, body = self.own, self.meshed.window, self.meshed.body
        batch = own.batch(cells)
        alike = batch.regular & (batch.xy == own.regular.maker.xy).all(axis=(1, 2))
        at = places_in_rows(window.lattice, cells), cells[:, 1]
        for n in np.flatnonzero(~alike).tolist():
            self.rare.append(self._single(batch, n))
            self.first[:, at[0][n], at[1][n]] = BY_TILE - len(self.rare)
        heights, held = batch.own[alike] * own.base.step, own.base.held
        for side, face in enumerate((body.front, body.back)):
            here = self.first[side]
            if held[side] or not own.base.meshed()[side]:
                here[at[0][alike], at[1][alike]] = BY_TILE
                continue
            here[at[0][alike], at[1][alike]] = self._numbered(side, heights[..., side])
            if self.normals == "vertex":
                xy = own.regular.tile.plan.xy
                places = window.lenses(face, cells[alike][:, None])
                seen = np.broadcast_to(xy, (int(alike.sum()), *xy.shape))
                up = heights_and_normals_of_lenses(face, places, seen[..., 0], seen[..., 1])[1]
                self.normal[side].append(up.reshape(-1, 3))
        if alike.any():
            self.reach.append(self._reach(heights - self.level))

    def _single(self, batch: CellBatch, n: int) -> Tile:
        """Tile of cell n of a batch, whose footprint is its own."""
        own, (i, j) = self.own, batch.cells[n].tolist()
        body = own.rare.body_at((i, j)) if self.normals == "vertex" else self.meshed.body
        if not batch.regular[n]:
            return make_tile(body, own.rare.at((i, j)).tile, self.level, self.normals)
        tile, lattice = own.regular.tile, self.meshed.window.lattice_of(own.base.tiling.array)
        steps = lattice.centres(own.regular.maker.places[0]) - lattice.centres(np.zeros(2, dtype=np.int64))
        plan = replace(tile.plan, xy=batch.xy[n] + steps)
        return make_tile(body, replace(tile, plan=plan, lens=batch.own[n]), self.level, self.normals)

    def _numbered(self, side: int, heights: Floats) -> Ints:
        """Keep heights (n, p) of one side; the numbers (n,) of their first."""
        cells, points = heights.shape
        first: Ints = self.count[side] + points * np.arange(cells)
        self.height[side].append(heights.astype(np.float32).ravel())
        self.count[side] += cells * points
        return first

    def _reach(self, heights: Floats) -> Floats:
        """`Tile.reach` (2, 3) of cells with heights (n, p, 2) over the body's level."""
        found = np.array(self.tile.reach)
        weight = weights_of(self.tile.corners)[:, 1:, :2]
        for side in (0, 1):
            lens = self.tile.part[:, side] == LENS
            z = heights[..., side][:, self.tile.triangles[lens]]
            rise = np.stack([z[..., 1] - z[..., 0], z[..., 2] - z[..., 0]], axis=-1)
            slope = np.einsum("nmk,mkc->nmc", rise, weight[lens])
            found[side] = z.min(), z.max(), np.hypot(slope[..., 0], slope[..., 1]).max()
        return found

    def done(self) -> MeshTiling:
        """Return the tiling."""
        lows, highs, slopes = np.moveaxis(np.array(self.reach or [self.tile.reach]), 2, 0)
        reach = np.stack([lows.min(axis=0), highs.max(axis=0), slopes.max(axis=0)], axis=1)
        height = tuple(np.concatenate([np.zeros(0, dtype=np.float32), *one]) for one in self.height)
        normal = tuple(np.concatenate([np.zeros((0, 3)), *one]) for one in self.normal)
        return MeshTiling([replace(self.tile, reach=reach), *self.rare], self.first, height, normal)


def told(
    window: Window, bodies: tuple[BodyPlan, ...], rays: Rays, result: TraceResult, record: bool
) -> TraceResult:
    """Result with the cells of the sheet itself; `result` was recorded through the triangles of
    `endless_layout`.

    Rays that passed a body outside its cells have missed the sheet; the endless sheet calls them land.
    """
    way = _Way.of(bodies, rays, result)
    n, places = len(rays), np.zeros((len(rays), 3))
    beam = Beam(np.arange(n), 0, np.full((n, 2), NO_CELL), np.zeros((n, 2)), np.zeros(n), places)
    walkers, missed = Walkers.unmet(beam, places), np.zeros(n, dtype=bool)
    for b, plan in enumerate(lay_out(window).bodies):
        rows = np.flatnonzero(way.dry[b] & ~missed)
        top = way.tops[b][rows]
        over = in_footprint(plan, top[:, :2], window.lattice.contains(_cells(window, plan.arrays[0], top)))
        missed[rows[~over]] = True
        for side, face in enumerate((plan.front, plan.back)):
            if face.array is None:
                continue
            met = (way.met[2 * b + side] | way.dry[b]) & ~missed
            at = np.where(way.dry[b][:, None], way.tops[b], way.hits[2 * b + side])
            walkers = _noted(window, walkers, face, at, met, ~way.dry[b])
    found = _written(rays, result, walkers, missed)
    if window.land.lined >= 0:
        found = _ended_at_line(lay_out(window), rays, found)
    return found if record else replace(found, hits=None, directions=None)


@dataclass(frozen=True, eq=False)
class _Way:
    """Record of n rays, face by face.

    hits : (faces, n, 3) lengths
    met : (faces, n) bool. Whether they were refracted at that face.
    dry : (bodies, n) bool. Whether they have passed that body without meeting it.
    tops : (bodies, n, 3) lengths. Points where those rays rose past it.
    """

    hits: Floats
    met: Bools
    dry: Bools
    tops: Floats

    @classmethod
    def of(cls, bodies: tuple[BodyPlan, ...], rays: Rays, result: TraceResult) -> _Way:
        """Derive it from a recorded trace: a face that was not met repeats the last point, or the end."""
        hits, turns, surface = result.hits, result.directions, result.surface
        assert hits is not None
        assert turns is not None
        wall, last = result.fate == Fate.WALL, _last_body(bodies, result)
        end = np.where(wall[:, None], result.position, np.nan)
        met, dry = np.zeros(hits.shape[:2], dtype=bool), np.zeros((len(bodies), len(rays)), dtype=bool)
        tops = np.zeros((len(bodies), len(rays), 3))
        point, ray = rays.position, rays.direction
        for b, body in enumerate(bodies):
            for f in (2 * b, 2 * b + 1):
                met[f] = np.where(wall, (hits[f] != end).any(axis=1), f <= surface) & (b <= last)
            passed = met[2 * b + 1] & (hits[2 * b + 1] != point).any(axis=1)
            dry[b] = (b < last) & ~passed
            met[2 * b : 2 * b + 2] &= ~dry[b]
            with np.errstate(invalid="ignore", divide="ignore"):
                tops[b] = point + ((body.level + body.high - point[:, 2]) / ray[:, 2])[:, None] * ray
            point, ray = (
                np.where(dry[b][:, None], before, at[2 * b + 1])
                for before, at in ((point, hits), (ray, turns))
            )
        return cls(hits, met, dry, tops)


def _last_body(bodies: tuple[BodyPlan, ...], result: TraceResult) -> Ints:
    """Number (n,) of the body in which rays ended; beyond the last if all are passed, −1 if none is met."""
    lows = np.array([body.level + body.low for body in bodies])
    with np.errstate(invalid="ignore"):
        at_wall = np.searchsorted(lows, result.position[:, 2], side="right") - 1
    ended = np.where(result.fate == Fate.WALL, np.maximum(at_wall, 0), result.surface // 2)
    ended = np.where(result.fate <= Fate.LAND, len(bodies), ended)
    return np.asarray(np.where(result.fate >= Fate.MISSED, -1, ended), dtype=np.int64)


def _cells(window: Window, array: int, at: Floats) -> Ints:
    """Cells (m, 2) of an array that contain points (m, 3), kept or not, from differences rounded once."""
    dx, dy = window.placements[array].shift
    (x, x_low), (y, y_low) = two_sum(at[:, 0], -dx), two_sum(at[:, 1], -dy)
    return window.lattice_of(array).locate(x, y, x_low, y_low)[0]


def _noted(
    window: Window, walkers: Walkers, face: FacePlan, at: Floats, met: Bools, on_lens: Bools
) -> Walkers:
    """Enter the cells of those rays (n,) that met a face at points (n, 3) in their record."""
    assert face.array is not None
    rows = np.flatnonzero(met)
    cell = _cells(window, face.array, at[rows])
    some = walkers.take(rows)
    some = note_cell(lay_out(window), replace(some, beam=replace(some.beam, cell=cell)), face, on_lens[rows])
    noted = {name: getattr(walkers, name).copy() for name in ("first", "last", "odd", "second", "ghost")}
    for name, column in noted.items():
        column[rows] = getattr(some, name)
    return replace(walkers, **noted)


def _written(rays: Rays, result: TraceResult, walkers: Walkers, missed: Bools) -> TraceResult:
    """Rows with their cells; missed rays as launched."""
    order = np.where(missed[:, None], NO_CELL, order_of(walkers)).astype(np.int32)
    through = result.fate <= Fate.GHOST
    fate = np.where(through, np.where(walkers.ghost, Fate.GHOST, Fate.ALIVE), result.fate)
    back = missed[:, None]
    hits, turns = result.hits, result.directions
    assert hits is not None
    assert turns is not None
    return replace(
        result,
        cell=walkers.first.astype(np.int32),
        order=order,
        fate=np.where(missed, Fate.MISSED, fate).astype(np.uint8),
        position=np.where(back, rays.position, result.position),
        direction=np.where(back, rays.direction, result.direction),
        surface=np.where(missed, NO_CELL, result.surface).astype(np.int32),
        optical_path=np.where(missed, 0.0, result.optical_path),
        hits=np.where(back, rays.position, hits),
        directions=np.where(back, rays.direction, turns),
    )


def _ended_at_line(layout: Layout, rays: Rays, found: TraceResult) -> TraceResult:
    """A recorded trace in which the opaque line of a face ends the rays that hit it."""
    number = layout.window.land.lined
    assert found.hits is not None
    assert found.directions is not None  # both recorded
    rows = np.flatnonzero((found.surface >= number) & on_line(layout, found.hits[number, :, :2]))
    names = ("hits", "directions", "optical_path", "fate", "surface", "position", "direction")
    changed = {name: getattr(found, name).copy() for name in names}
    hits, ways = changed["hits"], changed["directions"]
    before = ways[number - 1] if number else rays.direction
    hits[number + 1 :, rows], ways[number:, rows] = hits[number, rows], before[rows]
    for same, media in colours(layout, rays, rows):
        ends = np.stack([rays.position[same], *hits[: number + 1, same]])
        changed["optical_path"][same] = np.array(media[: number + 1]) @ np.linalg.norm(
            np.diff(ends, axis=0), axis=2
        )
    changed["fate"][rows], changed["surface"][rows] = Fate.VIGNETTED, number
    changed["position"][rows], changed["direction"][rows] = hits[number, rows], before[rows]
    return replace(found, **changed)
