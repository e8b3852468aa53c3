"""Rung "thin" compiled: blocks of rays that clearly meet both lenses; the rest is left to numpy.

The twin of `clacad.tracing.reference.thin`. A ray is plain if it is launched over a kept cell and meets the
patches of that cell's column and of the one below which it arrives, each on its lens. It must cross no border
on the way and go on forwards. Ghosts are plain, too. Each condition is a number that must be positive; the
row GOOD keeps the least of them, as on the straight path through surfaces.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from clacad.base.compiled import exact, inlined, least, owning
from clacad.base.types import Floats, Rows
from clacad.optics.ledger import Ledger
from clacad.optics.rays import Rays
from clacad.optics.sequence import UNIT
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.array_cells import from_own_lens, into_array, to_own_lens
from clacad.tracing.compiled.block import (
    BEHIND_START,
    BLOCK,
    CI,
    CI0,
    CJ,
    CJ0,
    DX,
    DY,
    DZ,
    GOOD,
    LEFT_X,
    LEFT_Y,
    PATH,
    ROOT,
    SCRATCH,
    X,
    Y,
    Z,
    copy_row,
    hold_in_zone,
    lane,
    lanes,
    load_block,
    queue_undecided,
    store_block,
)
from clacad.tracing.compiled.launch import launch_block
from clacad.tracing.compiled.law_rung import (
    CLEAR,
    FAR,
    MISS,
    NEAR,
    arrive_well_inside,
    miss,
    near,
    rows_left,
    surely_beside,
    surely_unmet,
)
from clacad.tracing.compiled.packing import OwnCells, Packed, pack_array_1, pack_own
from clacad.tracing.compiled.records import Outcome
from clacad.tracing.layout import Layout, prepared
from clacad.tracing.reference.thin import thin_layout, thin_patches

CENTRE_X, CENTRE_Y, POWER_X, POWER_Y, R0, FLAT, LENS_NUMBERS = 0, 1, 2, 3, 4, 13, 14
"""Columns of a lens's row: centre from its cell's centre, 1/f in each meridian, rotation row by row, whether
all lenses lie in one plane without surrounding land.
"""

STEEPEST = 1e-3
"""Least cosine to the sheet's normal of a ray that is called MISSED here."""

ORDERS = 64.0
"""Largest ghost order decided here: beyond it the last bit of a direction changes many bits of a position."""


def trace_thin_plain(layout: Layout, rays: Rays, ledger: Ledger, threads: int) -> Rows:
    """Write the rows of rays (n) that clearly pass both lenses; return the other rows (k,)."""
    sheet, lenses = thin_pair(layout)
    return rows_left(thin_chunk, sheet, lenses, rays, ledger, threads)


def thin_pair(layout: Layout) -> tuple[Packed, Floats]:
    """The lenses (2, LENS_NUMBERS), and a sheet whose two bodies enclose them; kept with the layout."""
    kept: tuple[Packed, Floats] | None = prepared(layout).get("thin pair")
    if kept is not None:
        return kept
    thin = thin_layout(layout)
    lenses, bodies = np.zeros((2, LENS_NUMBERS)), np.zeros((2, slot.BODY_NUMBERS))
    patches = thin_patches(thin)
    for patch, lens, body in zip(patches, lenses, bodies, strict=True):
        lens[: POWER_Y + 1] = *patch.vertex[:2], *patch.power
        lens[R0:FLAT] = patch.rotation.ravel()
        even = patch.high - patch.low < 0.1 * CLEAR * STEEPEST * layout.lattice.circumradius
        lens[FLAT] = float(even and layout.window.outline is None)
        body[slot.LEVEL], body[slot.BODY_LOW] = patch.level, patch.low
    changes = [patch.change for patch in patches]
    own = any(changes) or any(place.own for place in thin.window.placements)
    whole = pack_own(thin, changes) if own else pack_array_1(thin)
    sheet = whole._replace(faces=np.zeros((2, slot.FACE_NUMBERS)), bodies=bodies, media=np.ones(5))
    prepared(layout)["thin pair"] = sheet, lenses
    return sheet, lenses


@owning
def thin_chunk(
    sheet: Packed, lenses: Floats, chosen: Rows, start: Floats, ray: Floats, out: Outcome, left: Rows
) -> int:
    """Trace the rays `chosen` of `start` and `ray` (n, 3) and write their rows.

    left : (len(chosen),). Receives the rows that are not decided here; their count is returned.
    """
    s, carried, count = np.zeros((SCRATCH, BLOCK)), np.empty(BLOCK), 0
    for first in range(0, len(chosen), BLOCK):
        block = chosen[first : first + BLOCK]
        m = len(block)
        load_block(block, start, ray, s)
        for given, kept in ((DX, LEFT_X), (DY, LEFT_Y), (DZ, ROOT)):
            copy_row(s[given], s[kept], m)
        launch_block(sheet.lattice, sheet.bodies[0], s, m)
        copy_row(lane(s, PATH), carried, m)
        _unit(s, m)
        _through(sheet, lenses, s, m, carried)
        store_block(sheet, s, block, 1, out)
        miss(s, block, start, ray, out)
        _name_cells(s, block, out)
        count = queue_undecided(s, block, left, count)
    return count


@exact
def _unit(s: Floats, m: int) -> None:
    """Divide the given directions, LEFT_X, LEFT_Y and ROOT, by their lengths: rounded once, as in numpy."""
    dx, dy, dz, given_x, given_y, given_z = lanes(s, (DX, DY, DZ, LEFT_X, LEFT_Y, ROOT))
    for i in range(m):
        u, v, w = given_x[i], given_y[i], given_z[i]
        square = u * u + v * v + w * w
        length = 1.0 if abs(square - 1.0) <= UNIT else sqrt(square)
        dx[i], dy[i], dz[i] = u / length, v / length, w / length


@exact
def _through(sheet: Packed, lenses: Floats, s: Floats, m: int, carried: Floats) -> None:
    """Trace launched rays through both lenses; heights are over the level of the current array."""
    lat = sheet.lattice
    margin = near(lat) + max(lat[slot.MARGIN], 0.5 * max(lat[slot.BAFFLE], 0.0))
    for array in range(2):
        if array:
            _carry_over(sheet, s, m)
            lat = sheet.lattices[1]
            if lenses[1, FLAT] != 0.0 and lat[slot.BAFFLE] == slot.NO_BAFFLE:
                _miss_second(sheet, s, m)
        else:
            copy_row(lane(s, CI), lane(s, CI0), m)
            copy_row(lane(s, CJ), lane(s, CJ0), m)
            _miss_first(sheet, lenses, s, m, carried)
        arrive_well_inside(sheet, array, s, m)
        _through_lens(sheet.own, sheet, lenses[array], array, s, m)
        hold_in_zone(lat, s, m, margin, 0.0, 0.0)
        if array == 0:
            _ahead(s, m, carried, FAR * lat[slot.REACH])
    _not_far_off(s, m, 0.5 if lat[slot.BAFFLE] != slot.NO_BAFFLE else ORDERS + 0.5)


@inlined
def _through_lens(own: OwnCells | None, sheet: Packed, lens: Floats, array: int, s: Floats, m: int) -> None:
    """Meet the lens of the cell and be refracted there."""
    offset = (-lens[CENTRE_X], -lens[CENTRE_Y], 0.0)
    if own is not None:
        to_own_lens(sheet, own, array, s, m, offset)
    _meet(lens, s, m)
    _bend(lens, s, m)
    if own is not None:
        from_own_lens(own, array, s, m, offset)


@exact
def _miss_first(sheet: Packed, lenses: Floats, s: Floats, m: int, carried: Floats) -> None:
    """Mark launched rays that certainly miss lens 1; LEFT_X is where rays between the lenses are counted."""
    flat = lenses[0, FLAT] != 0.0
    for i in range(m):
        sane = least(s[GOOD, i], s[DZ, i] - STEEPEST)
        s[MISS, i] = 1.0 if flat and surely_unmet(sheet, s, i, sane, carried[i]) else 0.0
        s[LEFT_X, i] = 0.0


@exact
def _miss_second(sheet: Packed, s: Floats, m: int) -> None:
    """Mark rays that passed lens 1 and certainly miss lens 2."""
    for i in range(m):
        if s[GOOD, i] > 0.0 and s[DZ, i] > STEEPEST and surely_beside(sheet, 1, s, i):
            s[MISS, i], s[LEFT_X, i], s[LEFT_Y, i], s[ROOT, i] = 1.0, 1.0, s[CI0, i], s[CJ0, i]


@exact
def _name_cells(s: Floats, block: Rows, out: Outcome) -> None:
    """Keep the cell of lens 1 for rays that passed lens 1 and missed lens 2."""
    for k in range(len(block)):
        if s[LEFT_X, k] > 0.0:
            out.cell[block[k], 0], out.cell[block[k], 1] = np.int32(s[LEFT_Y, k]), np.int32(s[ROOT, k])


@exact
def _carry_over(sheet: Packed, s: Floats, m: int) -> None:
    """Carry rays to the reference plane of array 2 and into its cells."""
    x, y, z, dx, dy, dz, path, ci, cj = lanes(s, (X, Y, Z, DX, DY, DZ, PATH, CI, CJ))
    one, two = sheet.bodies[0], sheet.bodies[1]
    level = two[slot.LEVEL] + two[slot.BODY_LOW] - one[slot.LEVEL]
    for i in range(m):
        t = (level - z[i]) / dz[i]
        ci[i], cj[i], x[i], y[i] = into_array(
            sheet, sheet.own, 0, 1, ci[i], cj[i], x[i] + t * dx[i], y[i] + t * dy[i]
        )
        z[i] = two[slot.BODY_LOW]
        path[i] += t


@exact
def _meet(lens: Floats, s: Floats, m: int) -> None:
    """Carry rays to the lens of their cell; rays must climb to it."""
    x, y, z, dx, dy, dz, path, good = lanes(s, (X, Y, Z, DX, DY, DZ, PATH, GOOD))
    cx, cy, a, b, c = lens[CENTRE_X], lens[CENTRE_Y], lens[R0 + 2], lens[R0 + 5], lens[R0 + 8]
    for i in range(m):
        climb = dx[i] * a + dy[i] * b + dz[i] * c
        t = -((x[i] - cx) * a + (y[i] - cy) * b + z[i] * c) / climb
        x[i], y[i], z[i] = x[i] + t * dx[i], y[i] + t * dy[i], z[i] + t * dz[i]
        path[i] += t
        good[i] = least(good[i], climb - NEAR)


@exact
def _bend(lens: Floats, s: Floats, m: int) -> None:
    """Refract rays at a lens: slope t at x becomes t − x/f in each meridian; rays must go on forwards."""
    x, y, z, dx, dy, dz, good = lanes(s, (X, Y, Z, DX, DY, DZ, GOOD))
    cx, cy, power_x, power_y = lens[CENTRE_X], lens[CENTRE_Y], lens[POWER_X], lens[POWER_Y]
    a, b, c = lens[R0], lens[R0 + 1], lens[R0 + 2]
    d, e, f = lens[R0 + 3], lens[R0 + 4], lens[R0 + 5]
    g, h, k = lens[R0 + 6], lens[R0 + 7], lens[R0 + 8]
    for i in range(m):
        u, v, w = dx[i], dy[i], dz[i]
        along = c * u + f * v + k * w
        px, py, pz = x[i] - cx, y[i] - cy, z[i]
        p = (a * u + d * v + g * w) - (a * px + d * py + g * pz) * power_x * along
        q = (b * u + e * v + h * w) - (b * px + e * py + h * pz) * power_y * along
        u, v, w = a * p + b * q + c * along, d * p + e * q + f * along, g * p + h * q + k * along
        length = sqrt(u * u + v * v + w * w)
        dx[i], dy[i], dz[i] = u / length, v / length, w / length
        good[i] = least(good[i], w / length - NEAR)


@exact
def _ahead(s: Floats, m: int, carried: Floats, far: float) -> None:
    """Require that the first lens lies neither behind the start nor too far from it."""
    path, good = lanes(s, (PATH, GOOD))
    for i in range(m):
        gone = abs(carried[i])
        slack = BEHIND_START * (gone + abs(path[i] - carried[i]))
        good[i] = least(good[i], least(path[i] + slack, far - gone))


@exact
def _not_far_off(s: Floats, m: int, most: float) -> None:
    """Require that the cells met are fewer than `most` steps apart in each direction."""
    ci, cj, ci0, cj0, good = lanes(s, (CI, CJ, CI0, CJ0, GOOD))
    for i in range(m):
        good[i] = least(good[i], least(most - abs(ci[i] - ci0[i]), most - abs(cj[i] - cj0[i])))
