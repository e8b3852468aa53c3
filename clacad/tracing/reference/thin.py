"""Rung "thin": ideal lenslets with cells. Offset, vignetting and ghosts appear; aberrations do not.

The lens of a cell is the plane patch through its centre, normal to its axis, cut by the cell's column. In the
lens frame a ray of slope t that meets it at x leaves with slope t − x/f, per meridian. Where neighbouring
patches step, a ray may slip between them: it goes on straight, as LAND. A patch is met only once, because a
thin lens has no thickness.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clacad.base.types import Bools, Floats, Ints, Pair2, Rows
from clacad.base.vectors import to_sheet, to_surface
from clacad.optics.ledger import Ledger, RayColumns
from clacad.optics.rays import NO_CELL, Fate
from clacad.sheet.cell_places import CellPlacement, LensPlaces, VertexChange, extreme_cells
from clacad.sheet.face_order import lined_array
from clacad.sheet.lattice import Circle, Outline, half_sizes
from clacad.sheet.pattern import less_steps
from clacad.sheet.plate import Plate
from clacad.tracing.layout import Box, Layout, array_numbers, sheet_position
from clacad.tracing.reference import launch as honeycomb
from clacad.tracing.reference.column import along_normal
from clacad.tracing.reference.face import in_zone, on_line
from clacad.tracing.reference.launch import Beam, box_span, launch, sheet_xy, to_array

BLOCK = 8192


@dataclass(frozen=True, eq=False)
class ThinPatch:
    """The thin lens of one array.

    array : 0, 1, or 2 and 3 of field lenses
    vertex : (3,) lengths. Lens centre: x, y from the cell's centre, z from `level`.
    rotation : (3, 3), lens → sheet
    power : (1/f_x, 1/f_y)
    level, low, high, box : Space that the patches and the surrounding land occupy, see `Extent`.
    centre : (x, y). Of the window's outline, sheet frame.
    change : Offset of the lens of each cell from `vertex`, and its size.
    """

    array: int
    vertex: tuple[float, float, float]
    rotation: Floats
    power: tuple[float, float]
    level: float
    low: float
    high: float
    box: Box
    centre: tuple[float, float]
    change: VertexChange | None = None

    @property
    def blind(self) -> int:
        """As `Face.blind`, of a field lens."""
        own_axes = self.change is not None and self.change.rotation is not None
        if self.array < 2 or own_axes or 0.0 not in self.power or self.power == (0.0, 0.0):
            return 0
        flat = self.power.index(0.0)
        return 1 + int(abs(self.rotation[1, flat]) > abs(self.rotation[0, flat]))

    def lenses(self, layout: Layout, cell: Ints) -> LensPlaces:
        """Positions and sizes of the lenses of cells (m, 2)."""
        if self.change is None:
            return LensPlaces(self.vertex)
        return self.change.places(self.vertex, layout.lattice, cell)

    def over(
        self, layout: Layout, cell: Ints, local: Floats, z: Floats, direction: Floats
    ) -> tuple[Floats, Floats]:
        """Distance (m,) of points of the cell frame over the patch's plane, along the lens axis, and the
        component (m,) of directions along it.
        """
        places = self.lenses(layout, cell)
        a, b, c = self._axis(places)
        (vx, vy, vz), (x, y, w) = places.apex, direction.T
        off = (local[:, 0] - vx) * a + (local[:, 1] - vy) * b + (z - vz) * c
        return np.asarray(off), np.asarray(x * a + y * b + w * c)

    def _axis(self, places: LensPlaces) -> Floats:
        """Axes of lenses: three numbers, or (3, m)."""
        turn = places.axes(self.rotation)
        assert turn is not None
        return turn[:, 2] if turn.ndim == 2 else turn[:, :, 2].T

    def bend(self, layout: Layout, cell: Ints, local: Floats, z: Floats, direction: Floats) -> Floats:
        """Unit directions (m, 3) behind the lens of rays that meet it at the given points of their cells."""
        places = self.lenses(layout, cell)
        vx, vy, vz = places.apex
        turn = places.axes(self.rotation)
        p, q, _ = to_surface(turn, np.column_stack([local[:, 0] - vx, local[:, 1] - vy, z - vz])).T
        size, size_y = places.focal((1.0, 1.0))
        p, q = p / size, q / size_y
        x, y, along = to_surface(turn, direction).T
        lens = np.stack([x - p * self.power[0] * along, y - q * self.power[1] * along, along], axis=-1)
        out = to_sheet(turn, lens)
        return np.asarray(out / np.linalg.norm(out, axis=1)[:, None])


@dataclass(frozen=True, eq=False)
class Met(RayColumns):
    """What rays met in one array: a patch, a gap between two, nothing.

    beam : At the point met, in its cell.
    distance : (m,) lengths
    lens, land, `beside` : (m,) bool
        On the optical zone of a patch; between patches, on seam or border; outside the sheet.
    solid : (m,) bool. Land with material: opaque land stops light there, a gap does not.
    """

    beam: Beam
    distance: Floats
    lens: Bools
    land: Bools
    beside: Bools
    solid: Bools


def trace_thin(layout: Layout, ledger: Ledger, rows: Rows) -> None:
    """Trace rays through the window's thin pair and write their rows (k,)."""
    layout = thin_layout(layout)
    patches = thin_patches(layout)
    for first in range(0, len(rows), BLOCK):
        with np.errstate(all="ignore"):
            _trace_block(layout, patches, ledger, rows[first : first + BLOCK])


def thin_layout(layout: Layout) -> Layout:
    """Same window with the cells of array 2 and of field lenses at the positions of the thin pair."""
    pair = layout.window.thin
    field = tuple(pair.field_place(lens, layout.lattice)[0] for lens in pair.field)
    window = replace(layout.window, placements=(CellPlacement(), pair.second, *field))
    return replace(layout, window=window, **array_numbers(layout.lattice, window.placements))


def thin_patches(layout: Layout) -> tuple[ThinPatch, ...]:
    """The arrays of patches of a `thin_layout` in the order of the light.

    Lens 1's centre lies in its cell's centre at z = 0, lens 2's at the pair's offset, a field lens's in its
    cell's centre.
    """
    pair = layout.window.thin
    second = (pair.offset[0] - pair.shift[0], pair.offset[1] - pair.shift[1], pair.offset[2])
    return (
        _patch(layout, 0, (0.0, 0.0, 0.0), pair.focal_length[0], pair.change_1),
        *(
            _patch(
                layout,
                2 + k,
                (0.0, 0.0, float(pair.field_centre(lens)[2])),
                lens.focal_length,
                pair.field_place(lens, layout.lattice)[1],
            )
            for k, lens in enumerate(pair.field)
        ),
        _patch(layout, 1, second, pair.focal_length[1], pair.change),
    )


def _patch(
    layout: Layout,
    array: int,
    vertex: tuple[float, float, float],
    focal_length: Pair2,
    change: VertexChange | None = None,
) -> ThinPatch:
    """Thin lens of an array whose `vertex` and focal lengths are in lengths, with its patches' space."""
    pair, place = layout.window.thin, layout.window.placements[array]
    centre = (0.0, 0.0) if layout.window.one_outline else place.shift
    axis = pair.rotation[:, 2]
    tile = layout.lattices[array].tile() - np.array(vertex[:2])
    heights = -(tile @ axis[:2]) / axis[2]
    if change is not None:  # a plane has no size
        leans = change.rotation is not None and bool(change.rotation[..., :2, 2].any())
        cells = layout.lattice.cells() if leans else extreme_cells(change, layout.lattice)
        places = change.places((0.0, 0.0, 0.0), layout.lattice, cells)
        axis = axis[None] if places.rotation is None else places.rotation[..., 2]
        across = tile - np.stack(places.apex[:2], axis=-1)[:, None]
        heights = np.reshape(places.apex[2], (-1, 1)) - (across * axis[:, None, :2]).sum(axis=2) / axis[:, 2:]
    pad = 1e-9 * layout.lattice.circumradius
    f_x, f_y = focal_length
    return ThinPatch(
        array=array,
        vertex=(vertex[0], vertex[1], 0.0),
        rotation=pair.rotation,
        power=(1.0 / f_x, 1.0 / f_y),
        level=vertex[2],
        low=float(heights.min()) - pad,
        high=float(heights.max()) + pad,
        box=_box(place.extent(layout.lattice), layout.window.outline, centre),
        centre=centre,
        change=change,
    )


def _box(box: Box, outline: Outline | None, centre: Pair2) -> Box:
    """Least box around a box and the sheet's outline."""
    if outline is None:
        return box
    if isinstance(outline, Plate):
        x0, x1, y0, y1 = outline.box
    else:
        hx, hy = half_sizes(outline)
        x0, x1, y0, y1 = centre[0] - hx, centre[0] + hx, centre[1] - hy, centre[1] + hy
    return min(box[0], x0), max(box[1], x1), min(box[2], y0), max(box[3], y1)


@dataclass(frozen=True, eq=False)
class Passed(RayColumns):
    """m rays that passed lens 1, and possibly a field lens.

    one : At lens 1.
    beam : Behind the last lens.
    path : (m,) lengths
    land : (m,) bool. Land was passed.
    odd : (m, 2) ints. Cell of the first field lens that differs from lens 1's cell; else lens 1's.
    """

    one: Met
    beam: Beam
    path: Floats
    land: Bools
    odd: Ints


def _trace_block(layout: Layout, patches: tuple[ThinPatch, ...], ledger: Ledger, rows: Rows) -> None:
    """Trace the rays `rows` (k,) through all arrays and write their rows of the ledger."""
    first, *fields, second = patches
    beam, carried = launch(layout, first, ledger.position, ledger.direction, rows)
    one = _meet(layout, first, beam)
    path = carried + one.distance
    on = ~one.beside & (path >= 0.0)
    one, path = one.take(on), path[on]
    here, out = _go_on(layout, ledger, first, one, path)
    one, path, out = one.take(here), path[here], out[here]
    gone = Passed(one, replace(one.beam, direction=out), path, one.land, one.beam.cell)
    last = first
    for patch in fields:
        gone, last = _through_field(layout, ledger, gone, last, patch), patch
    start, one, path = gone.beam, gone.one, gone.path
    two, length = _carried(layout, start, last, second)
    passes = ~two.beside
    if layout.window.baffle is not None:
        passes &= ~_stopped(layout, ledger, gone, last, two, length)
    else:
        _pass_beside(layout, ledger, one, two)
    _leave(layout, ledger, second, gone.take(passes), two.take(passes), (path + length)[passes])


def _carried(layout: Layout, start: Beam, left: ThinPatch, entered: ThinPatch) -> tuple[Met, Floats]:
    """What rays (m) meet in the next array, and the distance (m,) from where they left the last one."""
    out = start.direction
    gap = (entered.level + entered.low - left.level - start.z) / out[:, 2]
    local = start.local + gap[:, None] * out[:, :2]
    at_plane = replace(start, local=local, z=np.full(len(gap), entered.low))
    met = _meet(layout, entered, to_array(layout, at_plane, entered.array))
    return met, gap + met.distance


def _stopped(
    layout: Layout, ledger: Ledger, gone: Passed, left: ThinPatch, met: Met, length: Floats
) -> Bools:
    """End rays that a honeycomb stops before the array they meet, `length` (m,) on; return which (m,)."""
    start = gone.beam
    share = honeycomb.reach(
        layout, (start.array, met.beam.array), start.local, met.beam.local, met.beam.cell - gone.one.beam.cell
    )
    stopped = np.isfinite(share) | met.beside
    run = np.where(np.isfinite(share * length), share * length, 0.0)[stopped]
    at = _position(layout, left, start)[stopped] + run[:, None] * start.direction[stopped]
    stray = start.direction[stopped]
    _end(layout, ledger, gone.one.take(stopped), Fate.VIGNETTED, at, stray, gone.path[stopped] + run, 0)
    return stopped


def _through_field(layout: Layout, ledger: Ledger, gone: Passed, left: ThinPatch, patch: ThinPatch) -> Passed:
    """Refract rays at a field lens; rays that pass outside it are missed."""
    met, length = _carried(layout, gone.beam, left, patch)
    if layout.window.baffle is not None:
        on = ~_stopped(layout, ledger, gone, left, met, length)
    else:
        _pass_beside(layout, ledger, gone.one, met)
        on = ~met.beside
    gone, met, path = gone.take(on), met.take(on), (gone.path + length)[on]
    here, out = _go_on(layout, ledger, patch, met, path)
    gone, met = gone.take(here), met.take(here)
    own = gone.one.beam.cell
    cell = met.beam.cell
    blind = 0 if layout.lattice.hexagonal else patch.blind
    if blind:  # the cells are one cylinder along that index
        cell = cell.copy()
        cell[:, blind - 1] = own[:, blind - 1]
    fresh = (gone.odd == own).all(axis=1, keepdims=True)
    return Passed(
        gone.one,
        replace(met.beam, direction=out[here]),
        path[here],
        gone.land | met.land,
        np.where(fresh, cell, gone.odd),
    )


def _pass_beside(layout: Layout, ledger: Ledger, one: Met, met: Met) -> None:
    """Reset the rays that pass outside an array to their launched state; the cell of lens 1 stays known."""
    beside = one.beam.rows[met.beside]
    ledger.miss(beside)
    ledger.cell[beside] = _named(layout, one.beam)[met.beside]


def _go_on(layout: Layout, ledger: Ledger, patch: ThinPatch, met: Met, path: Floats) -> tuple[Bools, Floats]:
    """Refract at a patch; end what is opaque or turned back. Returns who goes on and all directions."""
    beam = met.beam
    at = _position(layout, patch, beam)
    bent = patch.bend(layout, beam.cell, beam.local, beam.z, beam.direction)
    out = np.where(met.lens[:, None], bent, beam.direction)
    opaque = _stops(layout, patch, met)
    climb = patch.over(layout, beam.cell, beam.local, beam.z, beam.direction)[1]
    backward = ~opaque & (~(out[:, 2] > 0.0) | ~(climb > 0.0))
    stopped = opaque | backward
    if patch.array < 2:
        ledger.record(patch.array, beam.rows, at, np.where(stopped[:, None], beam.direction, out))
    for ended, fate in ((opaque, Fate.VIGNETTED), (backward, Fate.BACKWARD)):
        if patch.array != 1:
            _end(layout, ledger, met.take(ended), fate, at[ended], beam.direction[ended], path[ended], 0)
    return ~stopped, out


def _stops(layout: Layout, patch: ThinPatch, met: Met) -> Bools:
    """Which rays (m,) end at opaque land or on the opaque line of a face of the array."""
    opaque = met.land & met.solid & layout.window.land.opaque
    if lined_array(layout.window) != patch.array:
        return opaque
    return opaque | (met.lens | met.solid) & on_line(layout, _position(layout, patch, met.beam)[:, :2])


def _leave(layout: Layout, ledger: Ledger, patch: ThinPatch, gone: Passed, two: Met, path: Floats) -> None:
    """Refract at lens 2 and write the rays."""
    one = gone.one
    goes, out = _go_on(layout, ledger, patch, two, path)
    rows = two.beam.rows
    first, last = _named(layout, one.beam), _named(layout, two.beam)
    ghost = (first != last).any(axis=1)
    order, astray = last - first, gone.odd - one.beam.cell
    order = np.where((order == 0).all(axis=1, keepdims=True), astray, order)
    ghost |= (astray != 0).any(axis=1)
    land = gone.land | two.land
    fate = np.select([land, ghost], [Fate.LAND, Fate.GHOST], Fate.ALIVE)
    opaque = _stops(layout, patch, two)
    fate = np.select([opaque, ~goes], [Fate.VIGNETTED, Fate.BACKWARD], fate).astype(np.uint8)
    direction = np.where(goes[:, None], out, two.beam.direction)
    ledger.end(rows, fate, _position(layout, patch, two.beam), direction, path, 1)
    ledger.cell[rows] = first
    known = (first != NO_CELL).all(axis=1) & (last != NO_CELL).all(axis=1)
    ledger.order[rows] = np.where(known[:, None], order, NO_CELL)


def _end(
    layout: Layout,
    ledger: Ledger,
    met: Met,
    fate: Fate,
    at: Floats,
    direction: Floats,
    path: Floats,
    surface: int,
) -> None:
    rows = met.beam.rows
    ledger.record(surface + 1, rows, at, direction)
    ledger.end(rows, fate, at, direction, path, surface)
    ledger.cell[rows] = _named(layout, met.beam)


def _meet(layout: Layout, patch: ThinPatch, beam: Beam) -> Met:
    """Find the patch, or the gap between patches, that rays pass through on their way up."""
    m = len(beam)
    span = (patch.high - beam.z) / beam.direction[:, 2]
    steps, since = np.zeros_like(beam.cell), np.zeros(m)
    at, slipped, found = np.maximum(span, 0.0), np.zeros(m, dtype=bool), np.zeros(m, dtype=bool)
    leave = box_span(layout, patch, sheet_xy(layout, beam), beam.direction)[1]
    active = np.flatnonzero((leave >= 0.0) & (span >= 0.0))
    own, borders = layout.lattices[patch.array], np.array(layout.lattice.steps)
    while len(active):
        local = less_steps(own, beam.local[active], steps[active])
        ray, cell = beam.direction[active], beam.cell[active] + steps[active]
        kept = layout.lattice.contains(cell)
        end, across = _next_border(layout, patch.array, local, ray)
        over, climb = patch.over(layout, cell, local, beam.z[active], ray)
        rise = -over
        crossing = rise / climb
        above = since[active] * climb >= rise  # already over this patch where the column begins
        slips = kept & above & (since[active] > 0.0)
        hits = kept & ~slips & (climb > 0.0) & (crossing <= end)
        at[active[slips]] = since[active[slips]]
        at[active[hits]] = crossing[hits]
        slipped[active[slips]] = True
        found[active[hits | slips]] = True
        done = hits | slips | (end >= span[active]) | (end >= leave[active])
        on = ~done
        steps[active[on]] += borders[across[on]]
        since[active[on]] = np.maximum(end[on], since[active[on]])
        active = active[on]
    local = less_steps(own, beam.local, steps) + at[:, None] * beam.direction[:, :2]
    end_beam = replace(beam, cell=beam.cell + steps, local=local, z=beam.z + at * beam.direction[:, 2])
    zone = in_zone(layout, local, layout.margin, patch.array)
    lens = found & ~slipped & zone
    xy = sheet_xy(layout, end_beam)
    border = ~found & _in_outline(layout, patch, xy)
    land = (found & ~lens) | border
    return Met(end_beam, at, lens, land, ~(lens | land), land & ~slipped)


def _next_border(layout: Layout, array: int, local: Floats, ray: Floats) -> tuple[Floats, Ints]:
    nearest, across = np.full(len(local), np.inf), np.zeros(len(local), dtype=np.int64)
    for n, half in enumerate(layout.widths[array]):
        here, speed = along_normal(layout, array, n, local), along_normal(layout, array, n, ray)
        t = np.where(speed == 0.0, np.inf, (np.copysign(half, speed) - here) / speed)
        closer = t < nearest
        nearest = np.where(closer, t, nearest)
        across = np.where(closer, n + len(layout.halves) * (speed < 0.0), across)
    return nearest, across


def _in_outline(layout: Layout, patch: ThinPatch, xy: Floats) -> Bools:
    """Which points lie on the border land inside the window's outline."""
    outline = layout.window.outline
    if outline is None:
        return np.zeros(len(xy), dtype=bool)
    if isinstance(outline, Plate):
        return outline.inside(xy)
    (x, y), (hx, hy) = (xy - np.asarray(patch.centre)).T, half_sizes(outline)
    inside = np.hypot(x, y) <= hx if isinstance(outline, Circle) else (np.abs(x) <= hx) & (np.abs(y) <= hy)
    return np.asarray(inside)


def _named(layout: Layout, beam: Beam) -> Ints:
    """Cells (m, 2) as results name them: NO_CELL where there is no kept cell."""
    kept = layout.lattice.contains(beam.cell)
    return np.where(kept[:, None], beam.cell, NO_CELL)


def _position(layout: Layout, patch: ThinPatch, beam: Beam) -> Floats:
    return sheet_position(layout, patch.array, beam.cell, beam.local, beam.z + patch.level)
