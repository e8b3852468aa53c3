"""The first thing rays meet among the facets of a mesh's own tiles: pieces that lie over one facet of every
tiling.

The twin of `clacad.tracing.triangles.compiled_tiles.first_facet_change`. In a piece both faces of a body are
planes. A piece ends where a ray crosses an edge of a facet, a border of the cell, or an edge of the plate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clacad.base.types import Bools, Floats, Ints, Rows
from clacad.sheet.pattern import less_steps
from clacad.sheet.plate_edges import next_crossing
from clacad.tracing.layout import BodyPlan, Layout
from clacad.tracing.reference.column import (
    ABOVE,
    ASIDE,
    BACK,
    BACK_LAND,
    FRONT,
    FRONT_LAND,
    WALL,
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
from clacad.tracing.reference.face import in_footprint, well_inside
from clacad.tracing.reference.facets import facets_over, normals_at
from clacad.tracing.reference.launch import Beam, box_span, cell_in, sheet_xy
from clacad.tracing.triangles.tiles import LAND, VOID, TiledFace

NOT_LOOKED_UP, NONE = -2, -1
"""State of the facet that a ray is in: not yet looked up; none exists."""

NO_STEP = -2
"""In place of a crossed border: an edge of a facet or of the plate, which leads to no other cell."""


def change(layout: Layout, body: BodyPlan, beam: Beam, inside: bool) -> Event:
    """Find where each ray first enters or leaves the body's material, on its facets if it has them: see
    `column.first_change`.
    """
    if isinstance(body.front, TiledFace) and isinstance(body.back, TiledFace):
        return _FacetSearch.begun(layout, body, (body.front, body.back), beam, inside).found()
    return first_change(layout, body, beam, inside)


@dataclass(frozen=True, eq=False)
class _FacetSearch:
    """m rays on their way through the facets of one body; columns (m,) are changed in place.

    limit, above, aside : distance until they are above the body or out of its box
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
        """First face in the cells of an array."""
        return next(face for face in self.faces if face.array == array)

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
        """Distance at which rays leave the first of their facets; border and its cell, or edge of the facet
        and its array.
        """
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
        """Height of a face at the starts, its rise along the rays, NaN for none, (k,) each, and the kind of
        crossing.
        """
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
        """Take rays through the solid middle of a thick body, where only side walls can be met; return which
        rays.
        """
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
