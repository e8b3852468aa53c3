"""Facets of a mesh's own tiles in numpy: the facet over a point, and what rays meet first among the facets.

The twin of `compiled_tiles.cross_facets` and `compiled_tiles.first_facet_change` in `clacad.tracing.facets`;
used for few rays while no kernels are compiled. A column is searched in pieces that lie over one facet of
every tiling. In a piece both faces of a body are planes. A piece ends where a ray crosses an edge of a facet,
a border of the cell, or an edge of the plate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clacad.base.types import Bools, Floats, Ints, Rows
from clacad.optics.ledger import ABOVE, ASIDE, BACK, BACK_LAND, FRONT, FRONT_LAND, WALL
from clacad.optics.surface import refract
from clacad.sheet.cell_places import LensPlaces
from clacad.sheet.pattern import less_steps
from clacad.sheet.plate_edges import next_crossing
from clacad.tracing.facets.tiles import (
    BIN,
    BINS_X,
    BINS_Y,
    LAND,
    LENS,
    LOW_X,
    LOW_Y,
    PER_X,
    PER_Y,
    SPLIT,
    VOID,
    TiledFace,
    Tiles,
)
from clacad.tracing.layout import BodyPlan, FacePlan, Layout
from clacad.tracing.reference.column import (
    Event,
    Kinds,
    RaysInArray,
    RaysInColumn,
    first_change,
    first_stretch,
    grid_of,
    next_border,
    outline_crossings,
    piece_of,
    step_on,
)
from clacad.tracing.reference.face import Hit, cross, in_footprint, well_inside
from clacad.tracing.reference.launch import Beam, box_span, cell_in, sheet_xy

TRIES = 8
"""Facets looked up before a ray is left to the walk; two suffice for lens-like slopes."""


def meet_face(
    face: FacePlan, local: Floats, z: Floats, direction: Floats, n1: float, n2: float, places: LensPlaces
) -> Hit:
    """Intersect a face from its −z side and refract: its lens, see `face.cross`, or its facets.

    Rays must be steeper than all of the facets: then the first one found is the only one.
    """
    if not isinstance(face, TiledFace):
        return cross(face, local, z, direction, n1, n2, places)
    if face.array is None:
        distance = (face.low - z) / direction[:, 2]
        normal = np.broadcast_to(np.array([0.0, 0.0, 1.0]), direction.shape)
    else:
        facet, distance = _facets_met(face, local, z, direction)
        normal = normals_at(face, facet, local + distance[:, None] * direction[:, :2])
    root = (direction * normal).sum(axis=1)
    out, _ = refract(direction, normal, root, n1, n2)
    return Hit(
        local=local + distance[:, None] * direction[:, :2],
        z=z + distance * direction[:, 2],
        distance=distance,
        direction=out,
        upright=root > 0.0,
    )


def facets_over(tiles: Tiles, tile: int, xy: Floats) -> Ints:
    """Facets (m,) over points (m, 2) of the cell frame: those they lie deepest in; −1 far off the tile."""
    row = tiles.table[tile]
    i, j = _bins(row, xy)
    bins = (row[BIN] + j * row[BINS_X] + i).astype(np.int64)
    first, last = tiles.start[bins], tiles.start[bins + 1]
    best, deepest = np.full(len(xy), -1, dtype=np.int64), np.full(len(xy), -np.inf)
    for k in range(int((last - first).max(initial=0))):
        rows = np.flatnonzero((first + k < last) & ~(deepest > 0.0))
        facet = tiles.member[first[rows] + k]
        inside = shares(tiles, facet, xy[rows]).min(axis=1)
        deeper = inside > deepest[rows]
        best[rows[deeper]], deepest[rows[deeper]] = facet[deeper], inside[deeper]
    return best


def shares(tiles: Tiles, facet: Ints, xy: Floats) -> Floats:
    """Barycentric coordinates (m, 3) of points (m, 2) in facets (m,)."""
    w = tiles.weight[facet]
    return np.asarray(w[..., 0] * xy[:, :1] + w[..., 1] * xy[:, 1:] + w[..., 2])


def normals_at(face: TiledFace, facet: Ints, xy: Floats) -> Floats:
    """Normals (m, 3) towards +z, of any length: the facets' own, or their corners' at points (m, 2)."""
    tiles, side = face.tiles, face.side
    a, b, _ = tiles.plane[facet, side].T
    own = np.column_stack([-a, -b, np.ones(len(facet))])
    if not len(tiles.normal):
        return own
    smooth = (shares(tiles, facet, xy)[..., None] * tiles.normal[facet, side]).sum(axis=1)
    return np.where((tiles.part[facet, side] == LENS)[:, None], smooth, own)


def _facets_met(face: TiledFace, local: Floats, z: Floats, direction: Floats) -> tuple[Ints, Floats]:
    """Facets (m,) of the lens that rays cross, and their distances (m,); NaN where none was found.

    Half bins, of which most tiles are made, are tried first; then facet by facet where they do not decide.
    """
    tiles, side, row = face.tiles, face.side, face.tiles.table[face.tile]
    level = 0.5 * (face.low + face.high)
    at_level = local + ((level - z) / direction[:, 2])[:, None] * direction[:, :2]
    half = _half_bins(row, at_level)
    for _ in range(2):
        distance = _to_planes(tiles.lens[half, side], local, z, direction)
        here = _half_bins(row, local + distance[:, None] * direction[:, :2])
        distance = np.where(here == half, distance, np.nan)
        half = here
    facet = tiles.half[half]
    rest = np.flatnonzero(np.isnan(distance))
    if len(rest):
        guess = np.where(facet[rest] < 0, facets_over(tiles, face.tile, at_level[rest]), facet[rest])
        facet[rest], distance[rest] = _settled(face, guess, local[rest], z[rest], direction[rest])
    return facet, distance


def _settled(
    face: TiledFace, guess: Ints, local: Floats, z: Floats, direction: Floats
) -> tuple[Ints, Floats]:
    """Facets and distances from a first guess, moving to the facet over the hit; NaN where none is found."""
    tiles, side = face.tiles, face.side
    found, distance = np.zeros(len(guess), dtype=np.int64), np.full(len(guess), np.nan)
    open_to, facet = np.flatnonzero(guess >= 0), guess[guess >= 0]
    for _ in range(TRIES):
        if not len(open_to):
            break
        t = _to_planes(tiles.plane[facet, side], local[open_to], z[open_to], direction[open_to])
        hit = local[open_to] + t[:, None] * direction[open_to, :2]
        inside = (shares(tiles, facet, hit) >= 0.0).all(axis=1)
        lens = inside & (tiles.part[facet, side] == LENS)
        found[open_to[lens]], distance[open_to[lens]] = facet[lens], t[lens]
        on = ~(inside | np.isnan(t))
        open_to, facet = open_to[on], facets_over(tiles, face.tile, hit[on])
        open_to, facet = open_to[facet >= 0], facet[facet >= 0]
    return found, distance


def _to_planes(plane: Floats, local: Floats, z: Floats, direction: Floats) -> Floats:
    """Distances (m,) to planes (m, 3), heights a x + b y + c."""
    a, b, c = plane.T
    (x, y), (dx, dy, dz) = local.T, direction.T
    return np.asarray((c + a * x + b * y - z) / (dz - a * dx - b * dy))


def _half_bins(row: Floats, xy: Floats) -> Ints:
    """Numbers (m,) of the half squares over points (m, 2): twice the bin's, plus one beyond its diagonal."""
    i, j = _bins(row, xy)
    u, v = (xy[:, 0] - row[LOW_X]) * row[PER_X] - i, (xy[:, 1] - row[LOW_Y]) * row[PER_Y] - j
    beyond = v + row[SPLIT] * u > 0.5 + 0.5 * row[SPLIT]
    return np.asarray((2.0 * (row[BIN] + j * row[BINS_X] + i) + beyond).astype(np.int64))


def _bins(row: Floats, xy: Floats) -> tuple[Floats, Floats]:
    """Indices (m,) along x and y of the bins over points (m, 2), the nearest bin where there is none."""
    i, j = np.floor((xy[:, 0] - row[LOW_X]) * row[PER_X]), np.floor((xy[:, 1] - row[LOW_Y]) * row[PER_Y])
    return np.fmax(np.fmin(row[BINS_X] - 1.0, i), 0.0), np.fmax(np.fmin(row[BINS_Y] - 1.0, j), 0.0)


NOT_LOOKED_UP, NONE = -2, -1
"""State of the facet that a ray is in: not yet looked up; none exists."""

NO_STEP = -2
"""In place of a crossed border: an edge of a facet or of the plate, which leads to no other cell."""


def change(layout: Layout, body: BodyPlan, beam: Beam, inside: bool) -> Event:
    """Where each ray first enters or leaves the body's material, by facets if any: `column.first_change`."""
    if isinstance(body.front, TiledFace) and isinstance(body.back, TiledFace):
        return _FacetSearch.begun(layout, body, (body.front, body.back), beam, inside).found()
    return first_change(layout, body, beam, inside)


@dataclass(frozen=True, eq=False)
class _FacetSearch:
    """m rays on their way through the facets of one body; columns (m,) are changed in place.

    above, aside : distance until they are above the body or out of its box
    facet : present facet in each of its arrays
    entered : start of the present piece
    since, cause : distance since when their state is known, and the cause of that state
    """

    layout: Layout
    body: BodyPlan
    faces: tuple[TiledFace, TiledFace]
    beam: Beam
    inside: bool
    xy: Floats
    grids: list[RaysInArray]
    above: Floats
    aside: Floats
    facet: dict[int, Ints]
    entered: Floats
    since: Floats
    cause: Kinds
    kind: Kinds
    normal: Floats

    @classmethod
    def begun(
        cls, layout: Layout, body: BodyPlan, faces: tuple[TiledFace, TiledFace], beam: Beam, inside: bool
    ) -> _FacetSearch:
        """Rays at their starts."""
        m, xy = len(beam), sheet_xy(layout, beam)
        above = np.full(m, np.inf) if inside else (body.high - beam.z) / beam.direction[:, 2]
        return cls(
            layout,
            body,
            faces,
            beam,
            inside,
            xy,
            [grid_of(layout, beam, array) for array in body.arrays],
            above,
            np.maximum(box_span(layout, body, xy, beam.direction)[1], 0.0),
            {array: np.full(m, NOT_LOOKED_UP) for array in body.arrays},
            np.zeros(m),
            np.zeros(m),
            np.full(m, WALL, dtype=np.int8),
            np.where(above <= 0.0, ABOVE, ASIDE).astype(np.int8),
            np.tile([0.0, 0.0, 1.0], (m, 1)),
        )

    def found(self) -> Event:
        """Continue until every ray has met something, or is past the body."""
        active = np.flatnonzero(~(self.above <= 0.0))
        while len(active):
            active = self._through_piece(active)
        grids = self.grids
        cells = {g.array: g.cell + g.steps for g in grids}
        starts = {g.array: less_steps(self.layout.lattices[g.array], g.local, g.steps) for g in grids}
        return Event(self.kind, self.since, cells, starts, self.normal)

    def _through_piece(self, active: Rows) -> Rows:
        """Take the rays `active` (k,) through their present pieces; return those that go on."""
        piece = piece_of(self.layout, self.grids, self.beam, self.xy, active)
        self._look_up(piece, active)
        limit = np.minimum(self.above, self.aside)[active]
        end, across, edge, of = self._next_edge(piece, active, limit)
        end = np.maximum(end, self.entered[active])
        self.since[active], self.cause[active], changed = self._scan(piece, active, end)
        self._note_met(piece, active, changed)
        past = ~changed & (limit <= end)
        risen = past & (self.above[active] <= end)
        self.kind[active[past]] = np.where(risen[past], ABOVE, ASIDE)
        self.since[active[past]] = np.where(risen, self.above[active], self.aside[active])[past]
        on = ~(changed | past)
        active, across, edge, of = active[on], across[on], edge[on], of[on]
        self.entered[active] = end[on]
        skipped = self._skip_middle(active) if self.inside else np.zeros(len(active), dtype=bool)
        stepping = ~skipped & (across != NO_STEP)
        step_on(self.layout, self.grids, active[stepping], across[stepping])
        borders = len(self.layout.lattice.steps)
        for array, facet in self.facet.items():
            facet[active[stepping & (across // borders == array)]] = NOT_LOOKED_UP
            turned = np.flatnonzero(~skipped & (edge >= 0) & (of == array))
            rows = active[turned]
            facet[rows] = self.faces[0].tiles.beside[facet[rows], edge[turned]]
        return active

    def _face_of(self, array: int) -> TiledFace:
        """First face in the cells of an array; of a layer of two planes its front."""
        return next((face for face in self.faces if face.array == array), self.faces[0])

    def _look_up(self, piece: RaysInColumn, active: Rows) -> None:
        """Find the facets of rays that entered other cells."""
        for array, facet in self.facet.items():
            fresh = np.flatnonzero(facet[active] == NOT_LOOKED_UP)
            if not len(fresh):
                continue
            facet[active[fresh]] = NONE
            fresh = fresh[piece.kept[array][fresh]]
            # slightly into the piece, so that a ray along an edge is in the facet it goes to
            t = self.entered[active[fresh]] + 2.0 * self.layout.tiny
            point = piece.starts[array][fresh] + t[:, None] * piece.direction[fresh, :2]
            face = self._face_of(array)
            facet[active[fresh]] = facets_over(face.tiles, face.tile, point)

    def _next_edge(self, piece: RaysInColumn, active: Rows, limit: Floats) -> tuple[Floats, Ints, Ints, Ints]:
        """Distance at which rays leave the first of their facets; border and cell, or edge and array."""
        border, across = next_border(self.layout, piece)
        end, across = np.minimum(border, limit), np.where(border < limit, across, NO_STEP)
        edge, of = np.full(len(active), -1), np.full(len(active), -1)
        tiles = self.faces[0].tiles
        for array, facet in self.facet.items():
            own, (u, v) = facet[active], piece.starts[array].T
            weight, beside = tiles.weight[own], tiles.beside[own]
            speed = weight[..., 0] * piece.direction[:, :1] + weight[..., 1] * piece.direction[:, 1:2]
            t = -(weight[..., 0] * u[:, None] + weight[..., 1] * v[:, None] + weight[..., 2]) / speed
            t = np.where((own >= 0)[:, None] & (speed < 0.0) & (beside >= 0), t, np.inf)
            first = t.argmin(axis=1)
            t = t[np.arange(len(first)), first]
            closer = t < end
            end, across = np.where(closer, t, end), np.where(closer, NO_STEP, across)
            edge, of = np.where(closer, first, edge), np.where(closer, array, of)
        if self.body.plate is not None:  # its edges end a piece too, but lead to no other column
            after = self.entered[active] + self.layout.tiny
            ahead = next_crossing(self.body.plate.edges, piece.xy, piece.direction[:, :2], after)
            closer = ahead < end
            end, across = np.where(closer, ahead, end), np.where(closer, NO_STEP, across)
            edge = np.where(closer, -1, edge)
        return end, across, edge, of

    def _levels(self, piece: RaysInColumn, active: Rows, face: TiledFace) -> tuple[Floats, Floats, Kinds]:
        """Height of a face at the starts, its rise along the rays, NaN for none, (k,); kind of crossing."""
        k = len(active)
        lens, land = (FRONT, FRONT_LAND) if face.side == 0 else (BACK, BACK_LAND)
        if face.array is None:
            return np.full(k, face.low), np.zeros(k), np.full(k, lens, dtype=np.int8)
        facet, (u, v) = self.facet[face.array][active], piece.starts[face.array].T
        part, (a, b, c) = face.tiles.part[facet, face.side], face.tiles.plane[facet, face.side].T
        low, rise = a * u + b * v + c, a * piece.direction[:, 0] + b * piece.direction[:, 1]
        none = facet < 0
        low = np.where(none, face.land, np.where(part == VOID, np.nan, low))
        rise = np.where(none | (part == VOID), 0.0, rise)
        return low, rise, np.where(none | (part == LAND), land, lens).astype(np.int8)

    def _scan(self, piece: RaysInColumn, active: Rows, end: Floats) -> tuple[Floats, Kinds, Bools]:
        """Go through the stretches of a piece; see `column.first_stretch`."""
        (low, low_rise, front), (high, high_rise, back) = (
            self._levels(piece, active, face) for face in self.faces
        )
        up = piece.direction[:, 2]
        main = self.body.arrays[0]
        outside = self.facet[main][active] < 0
        outline = [np.where(outside, t, np.inf) for t in outline_crossings(self.body, piece)]
        times = np.array([(low - piece.z) / (up - low_rise), (high - piece.z) / (up - high_rise), *outline])
        walls = [np.full(len(active), WALL, dtype=np.int8)] * len(outline)
        earliest = np.maximum(self.entered[active], self.since[active] - self.layout.tiny)

        def solid(pick: Rows, t: Floats) -> Bools:
            level = piece.z[pick] + t * up[pick]
            point = piece.xy[pick] + t[:, None] * piece.direction[pick, :2]
            over = in_footprint(self.body, point, piece.kept[main][pick])
            above = low[pick] + t * low_rise[pick] <= level
            return np.asarray(over & above & (level <= high[pick] + t * high_rise[pick]))

        return first_stretch(
            self.layout.tiny,
            (times, np.array([front, back, *walls])),
            (earliest, end),
            (self.since[active], self.cause[active]),
            self.inside,
            solid,
        )

    def _note_met(self, piece: RaysInColumn, active: Rows, changed: Bools) -> None:
        """Record what changed the state of rays, and the normals of the facets involved."""
        self.kind[active[changed]] = self.cause[active[changed]]
        for face, lens in zip(self.faces, (FRONT, BACK), strict=True):
            if face.array is None:
                continue
            facet = self.facet[face.array][active]
            met = np.flatnonzero(changed & (self.cause[active] == lens) & (facet >= 0))
            way = self.since[active[met], None] * piece.direction[met, :2]
            self.normal[active[met]] = normals_at(face, facet[met], piece.starts[face.array][met] + way)

    def _skip_middle(self, active: Rows) -> Bools:
        """Take rays through the solid middle of a thick body, with side walls alone; return which."""
        body, beam = self.body, self.beam
        plain = all(face.whole or np.isfinite(face.land) for face in self.faces)
        if not (body.separate and plain and len(active)):
            return np.zeros(len(active), dtype=bool)
        z, direction = beam.z[active], beam.direction[active]
        low, high = (body.front.high - z) / direction[:, 2], (body.back.low - z) / direction[:, 2]
        skipped = (low <= self.entered[active]) & (self.entered[active] < high)
        for t in (self.entered[active], high):
            skipped &= well_inside(body, self.xy[active] + t[:, None] * direction[:, :2])
        rows, far = active[skipped], high[skipped]
        over = beam.local[rows] + far[:, None] * beam.direction[rows, :2]
        for g in self.grids:
            _, _, cell = cell_in(self.layout, beam.array, g.array, beam.cell[rows], over)
            g.steps[rows] = cell - g.cell[rows]
            self.facet[g.array][rows] = NOT_LOOKED_UP
        self.entered[rows], self.since[rows], self.cause[rows] = far, far, WALL
        return skipped
