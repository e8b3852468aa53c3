"""The complete walk of rays through the sheet: every fate and event, body by body.

`clacad.tracing.reference.column` finds the first thing a ray meets; this module refracts or ends the ray
there. Nothing is assumed about slopes, steps, displacements or directions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Bools, Floats, Ints, Rows
from clacad.optics.ledger import ABOVE, ASIDE, BACK, BACK_LAND, FRONT, FRONT_LAND, Ledger, RayColumns
from clacad.optics.rays import NO_CELL, Fate
from clacad.optics.surface import ULP, refract
from clacad.tracing.layout import BodyPlan, FacePlan, Layout, lenses, sheet_position
from clacad.tracing.reference import launch as honeycomb
from clacad.tracing.reference.column import Event
from clacad.tracing.reference.face import Hit, cross, cross_at, cross_land, in_footprint, on_line
from clacad.tracing.reference.facets import change
from clacad.tracing.reference.launch import Beam, box_span, on_to, sheet_xy, to_array

BEHIND = 8 * ULP
"""Share of a ray's travel by which the first face may seem to lie behind its start: rounding error."""

SAME = 1e-6
"""Share of a cell by which two roots of one crossing may differ: far above rounding, far below two
crossings."""


@dataclass(frozen=True, eq=False)
class Walkers(RayColumns):
    """Rays in the walk and their record so far.

    path : (m,) lengths. Optical path from the start.
    position : (m, 3) sheet frame. Last point met; the start before that.
    first, last, odd : (m, 2) ints
        Cell of the first structured face met, of the latest, and of the first that differed.
    second : (m,) bool. A face of array 1 has been met.
    ghost, land : (m,) bool. Lens faces of different telescopelets were crossed; land or a hole was crossed.
    surface : (m,) ints. Last face met.
    """

    beam: Beam
    path: Floats
    position: Floats
    first: Ints
    last: Ints
    odd: Ints
    second: Bools
    ghost: Bools
    land: Bools
    surface: Ints

    @classmethod
    def unmet(cls, beam: Beam, position: Floats) -> Walkers:
        """Rays that have met nothing."""
        none, no = np.full((len(beam), 2), NO_CELL, dtype=np.int64), np.zeros(len(beam), dtype=bool)
        return cls(beam, np.zeros(len(beam)), position, none, none, none, no, no, no, none[:, 0])

    def __len__(self) -> int:
        return len(self.path)


@dataclass(frozen=True, eq=False)
class BodyWalk:
    """Data of a walk at one body; `media`: refractive indices before, inside and behind it."""

    layout: Layout
    ledger: Ledger
    number: int
    media: tuple[float, float, float]

    @property
    def body(self) -> BodyPlan:
        """The body walked through."""
        return self.layout.bodies[self.number]

    @property
    def joined_behind(self) -> bool:
        """Whether the next body is joined to this one."""
        return self.number + 1 < len(self.layout.bodies) and self.layout.bodies[self.number + 1].joined

    def stops(self, surface: Ints, position: Floats) -> Bools:
        """Which points (m, 3) of surfaces (m,) lie on an opaque line."""
        line = surface == self.layout.window.land.lined
        return np.asarray(line & on_line(self.layout, position[:, :2]) if line.any() else line)

    def sheet(self, array: int, cell: Ints, local: Floats, z: Floats) -> Floats:
        """Sheet-frame points (m, 3)."""
        return sheet_position(self.layout, array, cell, local, z + self.body.level)


def walk(layout: Layout, ledger: Ledger, media: Sequence[float], beam: Beam, carried: Floats) -> None:
    """Trace rays from the launch plane to their end and write their rows.

    media : refractive index before the first face and behind each
    beam, carried
        From `launch`: m rays on the first body's reference plane, and their distances (m,) from the start.
    """
    walkers = Walkers.unmet(beam, ledger.position[beam.rows])
    with np.errstate(all="ignore"):
        for b, body in enumerate(layout.bodies):
            here = BodyWalk(layout, ledger, b, (media[2 * b], media[2 * b + 1], media[2 * b + 2]))
            left = walkers
            if b and not body.joined:
                walkers, left, carried = _cross_gap(here, walkers)
            walkers = _through_body(here, walkers, left, carried)
            if not len(walkers):
                return
    _finish(here, walkers)


# -- one body ----------------------------------------------------------------------------------


def _through_body(here: BodyWalk, walkers: Walkers, left: Walkers, gap: Floats) -> Walkers:
    """Enter, cross and leave one body; rays that end are written, the others returned."""
    entering, passing = (
        _past_joint(here, walkers) if here.body.joined else _approach(here, walkers, left, gap)
    )
    if len(entering):
        event = change(here.layout, here.body, entering.beam, inside=True)
        out = np.isin(event.kind, (BACK, BACK_LAND))
        stuck = np.flatnonzero(~out)
        _end_at(here, entering.take(stuck), event.take(stuck), here.media[1])
        entering = _forwards(here, _refract(here, entering, event, np.flatnonzero(out), 1))
        if not here.joined_behind:
            entering = _depart(here, entering)
    return _joined(entering, passing)


def _past_joint(here: BodyWalk, walkers: Walkers) -> tuple[Walkers, Walkers]:
    """Rays on the joint before a body, seen from the body: all of them are inside."""
    beam = walkers.beam
    beam = replace(beam, z=beam.z - (here.body.level - here.layout.bodies[here.number - 1].level))
    here.ledger.record(2 * here.number, beam.rows, walkers.position, beam.direction)
    walkers = replace(walkers, beam=to_array(here.layout, beam, here.body.arrays[0]))
    return walkers, walkers.take(np.zeros(len(walkers), dtype=bool))


def _approach(here: BodyWalk, walkers: Walkers, left: Walkers, gap: Floats) -> tuple[Walkers, Walkers]:
    """From the reference plane to the first face: those that enter, and those that pass through a hole."""
    body, layout = here.body, here.layout
    event = change(layout, body, walkers.beam, inside=False)
    travelled = gap + event.distance
    missed = event.kind == ASIDE
    if here.number == 0:
        missed |= travelled < -BEHIND * (np.abs(gap) + np.abs(event.distance))
    risen = event.kind == ABOVE
    over = sheet_xy(layout, walkers.beam) + event.distance[:, None] * walkers.beam.direction[:, :2]
    beyond = to_array(layout, _advanced(walkers.beam, event.distance), body.arrays[0])
    hole = risen & in_footprint(body, over, layout.lattice.contains(beyond.cell))
    missed |= risen & ~hole
    if here.number and layout.window.baffle is not None:
        blocked = _stop_at_baffle(here, walkers, left, event, gap)
        missed &= ~blocked
    else:
        blocked = np.zeros(len(walkers), dtype=bool)
    _miss(here, walkers.take(missed))
    going = ~(missed | blocked)
    path = walkers.path + gap
    walkers = replace(walkers, path=path)
    enters = going & np.isin(event.kind, (FRONT, FRONT_LAND))
    ends = np.flatnonzero(going & ~enters & ~hole)
    _end_at(here, walkers.take(ends), event.take(ends), 1.0)
    entering = _refract(here, walkers, event, np.flatnonzero(enters), 0)
    return entering, _pass_hole(here, walkers, np.flatnonzero(going & hole), event)


def _refract(here: BodyWalk, walkers: Walkers, event: Event, rows: Rows, side: int) -> Walkers:
    """Refract the rays `rows` at the front (side 0) or back (1) they met; write those that end there."""
    body = here.body
    face, (n1, n2) = (body.front, body.back)[side], here.media[side : side + 2]
    walkers, event = walkers.take(rows), event.take(rows)
    if not len(rows):
        return walkers
    on_lens = np.isin(event.kind, (FRONT, BACK))
    beam, distance, out = _cross_face(here, face, walkers.beam, event, on_lens, n1, n2)
    walkers = replace(
        walkers,
        beam=beam,
        path=walkers.path + n1 * distance,
        position=here.sheet(beam.array, beam.cell, beam.local, beam.z),
        surface=np.full(len(rows), 2 * here.number + side, dtype=np.int64),
    )
    if face.array is not None or not on_lens.all():
        walkers = note_cell(here.layout, walkers, face, on_lens)
    opaque = ~on_lens & here.layout.window.land.opaque | here.stops(walkers.surface, walkers.position)
    total = ~opaque & ~np.isfinite(out[:, 0])
    after = np.where((opaque | total)[:, None], beam.direction, out)
    here.ledger.record(2 * here.number + side, beam.rows, walkers.position, after)
    _end(here, walkers.take(opaque), Fate.VIGNETTED)
    _end(here, walkers.take(total), Fate.TIR)
    on = ~(opaque | total)
    walkers = walkers.take(on)
    return replace(walkers, beam=replace(walkers.beam, direction=out[on]))


def _cross_face(
    here: BodyWalk, face: FacePlan, beam: Beam, event: Event, on_lens: Bools, n1: float, n2: float
) -> tuple[Beam, Floats, Floats]:
    """Beams on the face, distances travelled and directions behind it, for lens and land alike."""
    array = here.body.arrays[0] if face.array is None else face.array
    start = event.starts[array]
    flat = cross_land(beam.direction, n1, n2)
    land = start + event.distance[:, None] * beam.direction[:, :2]
    level = face.land if np.isfinite(face.land) else 0.0
    if event.normal is not None:
        root = (beam.direction * event.normal).sum(axis=1)
        bent, _ = refract(beam.direction, event.normal, root, n1, n2)
        z = np.where(on_lens, beam.z + event.distance * beam.direction[:, 2], level)
        on_face = Beam(beam.rows, array, event.cells[array], land, z, beam.direction)
        return on_face, event.distance, np.where(on_lens[:, None], bent, flat)
    places = lenses(here.layout, face, event.cells[array])
    hit = cross(face, start, beam.z, beam.direction, n1, n2, places)
    other = on_lens & ~(np.abs(hit.distance - event.distance) <= SAME * here.layout.halves.max())
    if other.any():
        hit = _where(
            other, cross_at(face, start, beam.z, beam.direction, event.distance, n1, n2, places), hit
        )
    local = np.where(on_lens[:, None], hit.local, land)
    z = np.where(on_lens, hit.z, level)
    distance = np.where(on_lens, hit.distance, event.distance)
    out = np.where(on_lens[:, None], hit.direction, flat)
    return Beam(beam.rows, array, event.cells[array], local, z, beam.direction), distance, out


def _where(chosen: Bools, one: Hit, other: Hit) -> Hit:
    """Select rows of `one` where chosen, else of `other`."""
    column = chosen[:, None]
    return Hit(
        local=np.where(column, one.local, other.local),
        z=np.where(chosen, one.z, other.z),
        distance=np.where(chosen, one.distance, other.distance),
        direction=np.where(column, one.direction, other.direction),
        upright=np.where(chosen, one.upright, other.upright),
    )


def _forwards(here: BodyWalk, walkers: Walkers) -> Walkers:
    """End rays that a back face turned back; return the others."""
    backward = ~(walkers.beam.direction[:, 2] > 0.0)
    _end(here, walkers.take(backward), Fate.BACKWARD)
    return walkers.take(~backward)


def _depart(here: BodyWalk, walkers: Walkers) -> Walkers:
    """Follow rays that left the back face until they are clear of the body."""
    if not len(walkers):
        return walkers
    event = change(here.layout, here.body, walkers.beam, inside=False)
    clear = np.isin(event.kind, (ABOVE, ASIDE))
    back = np.flatnonzero(~clear)
    _end_at(here, walkers.take(back), event.take(back), 1.0)
    return walkers.take(clear)


def _pass_hole(here: BodyWalk, walkers: Walkers, rows: Rows, event: Event) -> Walkers:
    """Put rays that rose past the body over its footprint without meeting it on its highest level."""
    walkers, distance = walkers.take(rows), event.distance[rows]
    for face in (here.body.front, here.body.back):
        if face.array is None or not len(rows):
            continue
        beam = to_array(here.layout, _advanced(walkers.beam, distance), face.array)
        walkers = replace(walkers, beam=beam, path=walkers.path + distance)
        walkers = note_cell(here.layout, walkers, face, np.zeros(len(rows), dtype=bool))
        distance = np.zeros(len(rows))
    beam = walkers.beam
    return replace(walkers, position=here.sheet(beam.array, beam.cell, beam.local, beam.z))


def _advanced(beam: Beam, distance: Floats) -> Beam:
    step = distance[:, None] * beam.direction
    return replace(beam, local=beam.local + step[:, :2], z=beam.z + step[:, 2])


def note_cell(layout: Layout, walkers: Walkers, face: FacePlan, on_lens: Bools) -> Walkers:
    """Enter the cell of a structured face, or of land or a hole, in the ray's record."""
    kept = layout.lattice.contains(walkers.beam.cell)
    cell = np.where(kept[:, None], walkers.beam.cell, NO_CELL)
    unmet = (walkers.first == NO_CELL).all(axis=1, keepdims=True)
    first = np.where(unmet, cell, walkers.first)
    if face.blind:  # the cells are one cylinder along that index
        cell = cell.copy()
        cell[kept, face.blind - 1] = first[kept, face.blind - 1]
    differs = (cell != first).any(axis=1)
    fresh = differs & (walkers.odd == first).all(axis=1)
    odd = np.where(unmet, first, np.where(fresh[:, None], cell, walkers.odd))
    return replace(
        walkers,
        first=first,
        last=cell,
        odd=odd,
        second=walkers.second | (face.array == 1),
        ghost=walkers.ghost | (differs & on_lens),
        land=walkers.land | ~on_lens,
    )


# -- between bodies ----------------------------------------------------------------------------


def _cross_gap(here: BodyWalk, walkers: Walkers) -> tuple[Walkers, Walkers, Floats]:
    """Carry rays to the next body's reference plane, or to where they come alongside it above that plane."""
    layout, body = here.layout, here.body
    left = walkers
    beam, gap = on_to(layout, walkers.beam, layout.bodies[here.number - 1], body)
    enter, leave = box_span(layout, body, sheet_xy(layout, beam), beam.direction)
    span = (body.high - body.low) / beam.direction[:, 2]
    reaches = (enter <= leave) & (leave >= 0.0) & (enter <= span) & np.isfinite(gap)
    if here.layout.window.baffle is not None:
        # rays that pass outside array 2 have already met the honeycomb
        stray = np.flatnonzero(~reaches)
        _vignette(here, left.take(stray), gap[stray], np.zeros(len(stray)))
    else:
        _miss(here, left.take(~reaches))
    late = np.where(enter > 0.0, enter, 0.0)[reaches]
    beam = to_array(layout, _advanced(beam.take(reaches), late), beam.array)
    return replace(walkers.take(reaches), beam=beam), left.take(reaches), gap[reaches] + late


def _stop_at_baffle(here: BodyWalk, walkers: Walkers, left: Walkers, event: Event, gap: Floats) -> Bools:
    """End rays that the honeycomb between the arrays stops; return which."""
    array = here.body.arrays[0]
    met = event.starts[array] + event.distance[:, None] * walkers.beam.direction[:, :2]
    order = event.cells[array] - left.beam.cell
    share = honeycomb.reach(here.layout, (left.beam.array, array), left.beam.local, met, order)
    blocked = np.isfinite(share)
    rows = np.flatnonzero(blocked)
    _vignette(here, left.take(rows), (gap + event.distance)[rows], share[rows])
    return blocked


def _vignette(here: BodyWalk, left: Walkers, length: Floats, share: Floats) -> None:
    """End rays on the honeycomb, `share` of the way across the gap."""
    run = np.where(np.isfinite(length), share * length, 0.0)
    position = left.position + run[:, None] * left.beam.direction
    left = replace(left, position=position, path=left.path + run)
    _record_end(here, left)
    _end(here, left, Fate.VIGNETTED)


# -- ends --------------------------------------------------------------------------------------


def _end_at(here: BodyWalk, walkers: Walkers, event: Event, index: float) -> None:
    """End rays at a wall, or at a face met from its wrong side, where no sequence of faces continues."""
    if not len(walkers):
        return
    array = here.body.arrays[0]
    local = event.starts[array] + event.distance[:, None] * walkers.beam.direction[:, :2]
    z = walkers.beam.z + event.distance * walkers.beam.direction[:, 2]
    wrong = np.select(
        [np.isin(event.kind, (FRONT, FRONT_LAND)), np.isin(event.kind, (BACK, BACK_LAND))],
        [2 * here.number, 2 * here.number + 1],
        walkers.surface,
    )
    position = here.sheet(array, event.cells[array], local, z)
    walkers = replace(walkers, position=position, path=walkers.path + index * event.distance)
    _record_end(here, walkers)
    line = (event.kind <= BACK_LAND) & here.stops(wrong, position)
    walkers = replace(walkers, surface=wrong)
    _end(here, walkers.take(line), Fate.VIGNETTED)
    _end(here, walkers.take(~line), Fate.WALL)


def _end(here: BodyWalk, walkers: Walkers, fate: Fate) -> None:
    if len(walkers):
        _write(here, walkers, np.full(len(walkers), fate, dtype=np.uint8))


def _finish(here: BodyWalk, walkers: Walkers) -> None:
    """Write rays that crossed every body."""
    _record_end(here, walkers)
    fate = np.where(walkers.land, Fate.LAND, np.where(walkers.ghost, Fate.GHOST, Fate.ALIVE))
    _write(here, walkers, fate.astype(np.uint8))


def _write(here: BodyWalk, walkers: Walkers, fate: NDArray[np.uint8]) -> None:
    ledger, rows = here.ledger, walkers.beam.rows
    ledger.end(rows, fate, walkers.position, walkers.beam.direction, walkers.path, walkers.surface)
    ledger.cell[rows] = walkers.first
    ledger.order[rows] = order_of(walkers)


def _record_end(here: BodyWalk, walkers: Walkers) -> None:
    """Repeat the last point at every face that was not met."""
    for face in range(len(here.ledger.hits)):
        on = walkers.surface < face
        position, direction = walkers.position[on], walkers.beam.direction[on]
        here.ledger.record(face, walkers.beam.rows[on], position, direction)


def order_of(walkers: Walkers) -> Ints:
    """Cell of lens 2 minus cell 1; if these agree but a face between differs, that difference."""
    both = walkers.second & (walkers.first != NO_CELL).all(axis=1) & (walkers.last != NO_CELL).all(axis=1)
    order = walkers.last - walkers.first
    same = (order == 0).all(axis=1) & (walkers.odd != NO_CELL).all(axis=1)
    order = np.where(same[:, None], walkers.odd - walkers.first, order)
    return np.where(both[:, None], order, NO_CELL)


def _miss(here: BodyWalk, walkers: Walkers) -> None:
    """Reset rays to their launched state; the cell of lens 1 stays known if one was met."""
    rows = walkers.beam.rows
    here.ledger.miss(rows)
    here.ledger.cell[rows] = walkers.first


def _joined(a: Walkers, b: Walkers) -> Walkers:
    """Join two groups, each in its own cells of the same array."""
    if not len(a):
        return b
    if not len(b):
        return a
    return Walkers.joined([a, b])
