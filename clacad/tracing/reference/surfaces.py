"""Rung "surfaces" in numpy: exact Snell at the exact surfaces, a block of rays at a time; rung "mesh" by a
mesh's tiles.

Almost every ray stays in one cell from the plane below an array to the plane above it. `in_cell` traces these
rays straight through and checks the conditions that make this right: steeper than any lens, in the cell at
both planes and at every hit, on the part of the lens that is the face. Rays that fail one of them are traced
again by the complete walk of `clacad.tracing.reference.walk`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from clacad.base.types import Bools, Floats, Ints, Rows
from clacad.optics.ledger import Ledger
from clacad.optics.rays import Fate
from clacad.optics.surface import ULP
from clacad.tracing.facets.tiles import TiledFace
from clacad.tracing.layout import BodyPlan, FacePlan, Layout, lenses, sheet_position
from clacad.tracing.reference import launch as honeycomb
from clacad.tracing.reference.face import height, in_zone, on_line, well_inside
from clacad.tracing.reference.facets import meet_face
from clacad.tracing.reference.launch import Beam, launch, on_to, sheet_xy, to_array
from clacad.tracing.reference.walk import walk

BLOCK = 8192
"""Rays at a time: the temporaries of one block stay in the second-level cache."""

BEHIND = 8 * ULP
"""Share of a ray's travel by which the first face may seem to lie behind its start: rounding."""


def trace_surfaces(layout: Layout, ledger: Ledger, rows: Rows, media: Sequence[float]) -> None:
    """Trace the launched rays `rows` (k,) and write their rows of the ledger.

    media : refractive index before the first face and behind each
    """
    waiting: list[tuple[Beam, Floats]] = []
    for first in range(0, len(rows), BLOCK):
        chosen = rows[first : first + BLOCK]
        first_body = layout.bodies[0]
        beam, carried = launch(layout, first_body, ledger.position, ledger.direction, chosen)
        if len(beam) == 0:
            continue
        beam = to_array(layout, beam, first_body.arrays[0])
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            straight = in_cell(layout, media, beam, carried)
        straight.enter(layout, ledger)
        rest = np.flatnonzero(~straight.good)
        waiting += [(beam.take(rest), carried[rest])] if len(rest) else []
        if sum(len(kept) for _, kept in waiting) >= BLOCK:
            _walk(layout, ledger, media, waiting)
            waiting = []
    if waiting:
        _walk(layout, ledger, media, waiting)


def _walk(layout: Layout, ledger: Ledger, media: Sequence[float], waiting: list[tuple[Beam, Floats]]) -> None:
    """Walk the rays of several blocks together: few rays cost as much as many."""
    beams, carried = zip(*waiting, strict=True)
    walk(layout, ledger, media, Beam.joined(beams), np.concatenate(carried))


@dataclass(frozen=True, eq=False)
class StraightTrace:
    """A block of rays after the straight trace.

    good : (m,) bool. The trace holds; the other rays need the walk.
    beam : On the last face, after it.
    cells : list of (m, 2) ints. Cell of each structured face, in the order of the light.
    optical_path : (m,)
    hits : list of Beam, one a face. On the face, after refraction.
    """

    good: Bools
    beam: Beam
    cells: list[Ints]
    optical_path: Floats
    hits: list[Beam]

    def enter(self, layout: Layout, ledger: Ledger) -> None:
        """Write the rays whose trace holds."""
        kept = np.flatnonzero(self.good)
        rows = self.beam.rows[kept]
        first = self.cells[0][kept]
        order = self.cells[-1][kept] - first
        for other in self.cells[1:-1]:
            differs = other[kept] - first
            order = np.where((order == 0).all(axis=1, keepdims=True), differs, order)
        ghost = (order != 0).any(axis=1)
        fate = np.where(ghost, np.uint8(Fate.GHOST), np.uint8(Fate.ALIVE)).astype(np.uint8)
        if len(ledger.hits):
            for k, hit in enumerate(self.hits):
                ledger.record(k, rows, _sheet(layout, k // 2, hit.take(kept)), hit.direction[kept])
        end = self.beam.take(kept)
        position = _sheet(layout, len(layout.bodies) - 1, end)
        ledger.end(rows, fate, position, end.direction, self.optical_path[kept], 2 * len(layout.bodies) - 1)
        ledger.cell[rows] = first
        ledger.order[rows] = order


def in_cell(layout: Layout, media: Sequence[float], beam: Beam, carried: Floats) -> StraightTrace:
    """Trace m rays straight through the faces of the cells they are over, and mark where this is valid.

    `carried` (m,): distance of the beam from the start.
    """
    good = np.ones(len(beam), dtype=bool)
    path = np.zeros(len(beam))
    cells: list[Ints] = []
    hits: list[Beam] = []
    left = beam
    gap = carried
    for b, body in enumerate(layout.bodies):
        around = (media[2 * b], media[2 * b + 1], media[2 * b + 2])
        if body.joined:  # the rays are on the joint already
            beam, gap = (
                replace(beam, z=beam.z - (body.level - layout.bodies[b - 1].level)),
                np.zeros(len(beam)),
            )
        elif b:
            left = beam
            beam, gap = on_to(layout, beam, layout.bodies[b - 1], body)
        through = _columns if body.columnar else _sheets
        beam, lengths, ok, crossed, seen = through(layout, body, around, beam)
        good &= ok
        before = gap + lengths[0]
        if b == 0:
            good &= before >= -BEHIND * (np.abs(gap) + np.abs(lengths[0]))
        elif not body.joined and layout.window.baffle is not None:
            arrays, order = (left.array, seen[0].array), seen[0].cell - left.cell
            good &= np.isinf(honeycomb.reach(layout, arrays, left.local, seen[0].local, order))
        path = path + before + around[1] * lengths[1]
        cells += crossed
        hits += seen
    if (lined := layout.window.land.lined) >= 0:
        good &= ~on_line(layout, _sheet(layout, lined // 2, hits[lined])[:, :2])
    return StraightTrace(good, beam, cells, path, hits)


Media = tuple[float, float, float]
"""Refractive indices before a body, inside and behind it."""

Through = tuple[Beam, tuple[Floats, Floats], Bools, list[Ints], list[Beam]]


def _columns(layout: Layout, body: BodyPlan, media: Media, beam: Beam) -> Through:
    """Through a body whose two faces share an array: one cell from the plane below to the plane above."""
    front, back = body.front, body.back
    good = layout.lattice.contains(beam.cell) & _steeper(beam.direction, front.slope)
    first, ok = np.zeros(len(beam)), np.ones(len(beam), dtype=bool)
    if not body.joined:
        beam, first, ok = _through(layout, front, beam, *media[:2])
    good &= ok & _steeper(beam.direction, max(front.slope, back.slope))
    by_heights = not (body.covered or isinstance(front, TiledFace))  # a facet exists only where it is met
    if by_heights:
        good &= height(back, beam.local, lenses(layout, back, beam.cell)) >= beam.z
    seen = [beam]
    beam, second, ok = _through(layout, back, beam, *media[1:])
    good &= ok & _steeper(beam.direction, back.slope)
    if by_heights:
        good &= height(front, beam.local, lenses(layout, front, beam.cell)) <= beam.z
    good &= in_zone(layout, _at(beam, body.high), 0.0, beam.array)
    seen.append(beam)
    return beam, (first, second), good, [beam.cell, beam.cell], seen


def _sheets(layout: Layout, body: BodyPlan, media: Media, beam: Beam) -> Through:
    """Trace through a body whose faces are in different arrays: each structured face has its own cell and two
    planes.

    Between those planes a ray must stay in the optical zone: a lenslet with a seam is an island with walls.
    """
    if not body.covered:
        return beam, (beam.z, beam.z), np.zeros(len(beam), dtype=bool), [beam.cell], [beam, beam]
    good = np.ones(len(beam), dtype=bool)
    crossed, seen, lengths = [], [], []
    for face, (n1, n2) in ((body.front, media[:2]), (body.back, media[1:])):
        if face is body.front and body.joined:
            crossed += [beam.cell] * (face.array is not None)
            lengths.append(np.zeros(len(beam)))
            seen.append(beam)
            continue
        z = beam.z
        structured = face.array is not None
        if structured:
            local = _at(beam, face.low)
            before = (face.low - z) / beam.direction[:, 2]
            beam = to_array(
                layout, replace(beam, local=local, z=np.full(len(beam), face.low)), face.array or 0
            )
            good &= layout.lattice.contains(beam.cell) & _steeper(beam.direction, face.slope)
            good &= in_zone(layout, beam.local, layout.margin, beam.array)
            crossed.append(beam.cell)
        else:
            before = np.zeros(len(beam))
        beam, length, ok = _through(layout, face, beam, n1, n2, within=structured)
        good &= ok & well_inside(body, sheet_xy(layout, beam))
        if structured:
            good &= _steeper(beam.direction, face.slope) & in_zone(
                layout, _at(beam, face.high), layout.margin, beam.array
            )
        lengths.append(before + length)
        seen.append(beam)
    return beam, (lengths[0], lengths[1]), good, crossed, seen


def _through(
    layout: Layout, face: FacePlan, beam: Beam, n1: float, n2: float, within: bool = True
) -> tuple[Beam, Floats, Bools]:
    """Cross one face; return which rays met the lens itself, upright, in the cell's optical zone."""
    hit = meet_face(face, beam.local, beam.z, beam.direction, n1, n2, lenses(layout, face, beam.cell))
    good = hit.upright & (hit.direction[:, 2] > 0.0)
    if within:
        good &= in_zone(layout, hit.local, layout.margin, beam.array)
    if not (face.whole or np.isnan(face.land) or isinstance(face, TiledFace)):
        good &= (hit.z - face.land) * face.land_side <= 0.0
    return replace(beam, local=hit.local, z=hit.z, direction=hit.direction), hit.distance, good


def _at(beam: Beam, z: float) -> Floats:
    """Local x, y of rays where they cross the plane z, still relative to their cell."""
    return np.asarray(beam.local + ((z - beam.z) / beam.direction[:, 2])[:, None] * beam.direction[:, :2])


def _steeper(direction: Floats, slope: float) -> Bools:
    """Whether rays climb faster than a face of that slope, so that they cross it at most once."""
    lateral = direction[:, 0] ** 2 + direction[:, 1] ** 2
    return np.asarray(direction[:, 2] ** 2 >= slope * slope * lateral)


def _sheet(layout: Layout, body: int, beam: Beam) -> Floats:
    return sheet_position(layout, beam.array, beam.cell, beam.local, beam.z + layout.bodies[body].level)
