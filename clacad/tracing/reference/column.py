"""The first thing a ray meets in a body: stretch by stretch, column by column.

The borders of its cells cut a body into columns. Inside a column a ray is divided where it crosses a lens's
surface, a land's level, an optical zone's border or the outline. Each stretch between is either all material
or all air, decided by the heights at its middle. The first stretch that differs from the ray's present state
determines what was met: the crossing at its start.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Bools, Floats, Ints, Rows
from clacad.optics.ledger import ABOVE, ASIDE, BACK, BACK_LAND, FRONT, FRONT_LAND, WALL, RayColumns
from clacad.sheet.pattern import less_steps
from clacad.sheet.plate_edges import next_crossing
from clacad.tracing.layout import BodyPlan, FacePlan, Layout, lenses
from clacad.tracing.reference.face import height, in_footprint, in_zone, lens_roots
from clacad.tracing.reference.launch import Beam, box_span, cell_in, sheet_xy

Kinds = NDArray[np.int8]


@dataclass(frozen=True, eq=False)
class Event(RayColumns):
    """The first change of state along m rays.

    kind : (m,) ints. FRONT, BACK (a lens or plane face), FRONT_LAND, BACK_LAND, WALL, ABOVE (rose past the
        body) or ASIDE (left the box round its footprint).
    distance : (m,) lengths
    cells, starts : one (m, 2) array for each of the body's arrays
        The cell where it happened and the ray's starting point seen from there.
    normal : (m, 3) or None. Of facets: towards +z, of any length; (0, 0, 1) where none was met.
    """

    kind: Kinds
    distance: Floats
    cells: dict[int, Ints]
    starts: dict[int, Floats]
    normal: Floats | None = None


class RaysInArray(NamedTuple):
    """Rays in the cells of one array: base cell, local start, and whole steps walked since."""

    array: int
    cell: Ints
    local: Floats
    steps: Ints


class RaysInColumn(NamedTuple):
    """Rays inside one column: for each array present cell, start seen from it, and whether it is kept."""

    starts: dict[int, Floats]
    kept: dict[int, Bools]
    cells: dict[int, Ints]
    z: Floats
    direction: Floats
    xy: Floats


def first_change(layout: Layout, body: BodyPlan, beam: Beam, inside: bool) -> Event:
    """Find where each ray first enters the body's material, or leaves it.

    beam : starts; heights over the body's level
    inside : whether the rays start in the material; rays in air are followed until above the body
    """
    m, xy = len(beam), sheet_xy(layout, beam)
    grids = [grid_of(layout, beam, array) for array in body.arrays]
    aside = np.maximum(box_span(layout, body, xy, beam.direction)[1], 0.0)
    above = np.full(m, np.inf) if inside else (body.high - beam.z) / beam.direction[:, 2]
    kind = np.full(m, ASIDE, dtype=np.int8)
    since, cause = np.zeros(m), np.full(m, WALL, dtype=np.int8)
    active = np.flatnonzero(~(above <= 0.0))
    kind[above <= 0.0] = ABOVE
    limit = np.minimum(aside, above)
    for _ in range(_most_columns(layout, body)):
        if not len(active):
            break
        piece = piece_of(layout, grids, beam, xy, active)
        border, across = next_border(layout, piece)
        if body.plate is not None:  # its edges end a piece too, but lead to no other column
            after = since[active] + layout.tiny
            edge = next_crossing(body.plate.edges, piece.xy, piece.direction[:, :2], after)
            border, across = np.minimum(border, edge), np.where(edge < border, -1, across)
        end = np.minimum(border, limit[active])
        since[active], cause[active], changed = _scan(
            layout, body, piece, since[active], cause[active], end, inside
        )
        risen = ~changed & (above[active] <= end)
        gone = ~changed & ~risen & (aside[active] <= end)
        kind[active[changed]] = cause[active[changed]]
        kind[active[risen]], since[active[risen]] = ABOVE, above[active[risen]]
        since[active[gone]] = aside[active[gone]]
        on = ~(changed | risen | gone)
        active = active[on]
        step_on(layout, grids, active, across[on])
    cells = {g.array: g.cell + g.steps for g in grids}
    starts = {g.array: less_steps(layout.lattices[g.array], g.local, g.steps) for g in grids}
    return Event(kind, since, cells, starts)


def _most_columns(layout: Layout, body: BodyPlan) -> int:
    """Upper bound of the number of columns that a straight line crosses inside the body's box."""
    across = 2.0 * float(layout.widths.min())
    width, depth = body.box[1] - body.box[0], body.box[3] - body.box[2]
    edges = 0 if body.plate is None else 2 * len(body.plate.edges)
    return 64 + edges + 4 * len(body.arrays) * int((width + depth) / across + 4)


def grid_of(layout: Layout, beam: Beam, array: int) -> RaysInArray:
    """Rays at their start, in the cells of one array."""
    if array == beam.array:
        return RaysInArray(array, beam.cell, beam.local, np.zeros_like(beam.cell))
    _, local, cell = cell_in(layout, beam.array, array, beam.cell, beam.local)
    return RaysInArray(array, cell, local, np.zeros_like(cell))


def piece_of(layout: Layout, grids: list[RaysInArray], beam: Beam, xy: Floats, active: Rows) -> RaysInColumn:
    """The rays `active` (k,) in their present columns."""
    starts = {g.array: less_steps(layout.lattices[g.array], g.local[active], g.steps[active]) for g in grids}
    cells = {g.array: g.cell[active] + g.steps[active] for g in grids}
    kept = {array: layout.lattice.contains(cell) for array, cell in cells.items()}
    return RaysInColumn(starts, kept, cells, beam.z[active], beam.direction[active], xy[active])


def next_border(layout: Layout, piece: RaysInColumn) -> tuple[Floats, Ints]:
    """Distance to the next border of a column, and its number: array, direction and sense combined."""
    k = len(piece.z)
    nearest, across = np.full(k, np.inf), np.zeros(k, dtype=np.int64)
    count = len(layout.halves)
    for array, start in piece.starts.items():
        for n in range(count):
            here, speed = (
                along_normal(layout, array, n, start),
                along_normal(layout, array, n, piece.direction),
            )
            t = (np.copysign(layout.widths[array, n], speed) - here) / speed
            t = np.where(speed == 0.0, np.inf, t)
            closer = t < nearest
            nearest = np.where(closer, t, nearest)
            across = np.where(closer, array * 2 * count + n + count * (speed < 0.0), across)
    return nearest, across


def along_normal(layout: Layout, array: int, n: int, rows: Floats) -> Floats:
    """Component (k,) of vectors (k, ≥ 2) along the normal of border n of a cell of an array."""
    ux, uy = layout.normals[array, n]
    return np.asarray(ux * rows[:, 0] + uy * rows[:, 1])


def step_on(layout: Layout, grids: list[RaysInArray], active: Rows, across: Ints) -> None:
    """Move rays into the next column."""
    borders = np.array(layout.lattice.steps)
    for g in grids:
        own = across // len(borders) == g.array
        g.steps[active[own]] += borders[across[own] % len(borders)]


def _scan(
    layout: Layout,
    body: BodyPlan,
    piece: RaysInColumn,
    since: Floats,
    cause: Kinds,
    end: Floats,
    inside: bool,
) -> tuple[Floats, Kinds, Bools]:
    """Go through the stretches of a column; see `first_stretch`."""
    times, causes = _divisions(layout, body, piece)
    kinds = np.broadcast_to(causes[:, None], times.shape)
    span = np.maximum(since - layout.tiny, 0.0), end

    def solid(pick: Rows, t: Floats) -> Bools:
        return _solid(layout, body, piece, pick, t)

    return first_stretch(layout.tiny, (times, kinds), span, (since, cause), inside, solid)


def first_stretch(
    tiny: float,
    divisions: tuple[Floats, Kinds],
    span: tuple[Floats, Floats],
    known: tuple[Floats, Kinds],
    inside: bool,
    solid: Callable[[Rows, Floats], Bools],
) -> tuple[Floats, Kinds, Bools]:
    """Go through stretches of k rays; return the last division passed, its cause, and who changed state.

    Stretches shorter than `tiny` are joined to the next one, because rounding alone would decide there. Where
    a border and a face are that close, the face is reported.

    divisions : (c, k) distances, and what each is
    span : (k,) distances from and up to which divisions count
    known : (k,) distance since when the present state is known, and the cause of that state
    inside : the present state: in the material
    solid : whether rays (p,) among the k lie in the material at distances (p,)
    """
    (times, causes), (earliest, end), (since, cause) = divisions, span, known
    times = np.where((times >= earliest) & (times < end), np.maximum(times, since), np.inf)
    turn = np.argsort(times, axis=0, kind="stable")
    times, causes = np.take_along_axis(times, turn, axis=0), np.take_along_axis(causes, turn, axis=0)
    changed = np.zeros(len(end), dtype=bool)
    for c in range(len(times) + 1):
        to = np.minimum(times[c], end) if c < len(times) else end
        why = np.full(len(end), WALL, dtype=np.int8)
        if c < len(times):
            why = np.where(times[c] < end, causes[c], why)
        wide = ~changed & (to - since > tiny)
        pick = np.flatnonzero(wide)
        if len(pick):
            changed[pick[solid(pick, 0.5 * (since[pick] + to[pick])) != inside]] = True
        moved = wide & ~changed
        named = moved | (~changed & (to < end) & (why != WALL))
        cause = np.where(named, why, cause)
        since = np.where(moved, to, since)
    return since, cause, changed


def _divisions(layout: Layout, body: BodyPlan, piece: RaysInColumn) -> tuple[Floats, Kinds]:
    """Distances (c, k) that divide rays into stretches, and the cause of each (c,)."""
    times: list[Floats] = []
    causes: list[int] = []
    for face, lens, land in ((body.front, FRONT, FRONT_LAND), (body.back, BACK, BACK_LAND)):
        if face.array is None:
            times.append((face.vertex[2] - piece.z) / piece.direction[:, 2])
            causes.append(lens)
        else:
            places = lenses(layout, face, piece.cells[face.array])
            times += lens_roots(face, piece.starts[face.array], piece.z, piece.direction, places)
            causes += [lens, lens]
        if not np.isnan(face.land):
            times.append((face.land - piece.z) / piece.direction[:, 2])
            causes.append(land)
    if layout.margin > 0.0:
        for array, start in piece.starts.items():
            times += _zone_borders(layout, array, start, piece.direction)
    times += outline_crossings(body, piece)
    causes += [WALL] * (len(times) - len(causes))
    return np.array([np.where(np.isfinite(t), t, np.inf) for t in times]), np.array(causes, dtype=np.int8)


def _zone_borders(layout: Layout, array: int, start: Floats, direction: Floats) -> list[Floats]:
    out = []
    for n, half in enumerate(layout.widths[array]):
        here, speed = along_normal(layout, array, n, start), along_normal(layout, array, n, direction)
        out += [(edge - here) / speed for edge in (half - layout.margin, layout.margin - half)]
    return out


def outline_crossings(body: BodyPlan, piece: RaysInColumn) -> list[Floats]:
    """Distances (k,) at which rays cross the outline, one or several."""
    shape, half_x, half_y = body.outline
    if shape in ("none", "plate"):
        return []
    point, ray = piece.xy - np.asarray(body.centre), piece.direction[:, :2]
    if shape == "rectangle":
        return [
            (edge - point[:, i]) / ray[:, i]
            for i, half in ((0, half_x), (1, half_y))
            for edge in (half, -half)
        ]
    a, b = (ray * ray).sum(axis=1), (point * ray).sum(axis=1)
    c = (point * point).sum(axis=1) - half_x * half_x
    q = -(b + np.copysign(np.sqrt(b * b - a * c), b))
    return [c / q, q / a]


def _solid(layout: Layout, body: BodyPlan, piece: RaysInColumn, pick: Rows, t: Floats) -> Bools:
    """Whether the points at distance t of the picked rays lie in the material."""
    direction = piece.direction[pick]
    z = piece.z[pick] + t * direction[:, 2]
    step = t[:, None] * direction[:, :2]
    points = {array: start[pick] + step for array, start in piece.starts.items()}
    kept = {array: mask[pick] for array, mask in piece.kept.items()}
    cells = {array: cell[pick] for array, cell in piece.cells.items()}
    front = _lens_over(layout, body.front, points, cells, kept)
    back = _lens_over(layout, body.back, points, cells, kept)
    bottom, top = (
        (np.fmin if face.land_side > 0 else np.fmax)(lens, face.land)
        for lens, face in ((front, body.front), (back, body.back))
    )
    if body.columnar:
        rimless = ~(front <= back)
        bottom = np.where(rimless, body.front.land, bottom)
        top = np.where(rimless, body.back.land, top)
    over = in_footprint(body, piece.xy[pick] + step, kept[body.arrays[0]])
    return np.asarray(over & (bottom <= z) & (z <= top))


def _lens_over(
    layout: Layout, face: FacePlan, points: dict[int, Floats], cells: dict[int, Ints], kept: dict[int, Bools]
) -> Floats:
    """Height of a face's lens, NaN outside its optical zone and outside the kept cells."""
    if face.array is None:
        return np.full(len(next(iter(points.values()))), face.vertex[2])
    local = points[face.array]
    places = lenses(layout, face, cells[face.array])
    lens = np.where(kept[face.array], height(face, local, places), np.nan)
    if layout.margin > 0.0:
        lens = np.where(in_zone(layout, local, layout.margin, face.array), lens, np.nan)
    return lens
