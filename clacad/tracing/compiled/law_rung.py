"""Rung "law" compiled: blocks of rays that cross the sheet well inside a cell; the rest is left to numpy.

The twin of `reference.launch.trace_law`. Directions are computed in the order of `Law.refract`, so they agree
to the last bit. Its scaling by powers of two is left out: only directions and laws of insane size need it.

Rungs "law" and "thin" decide the rays that pass every border at a safe distance. A ray closer than that to a
border, or to being turned back, is left to the numpy path, so the rounding of either path does not matter.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf, sqrt

import numpy as np

from clacad.base.compiled import exact, inlined, least, less_product, owning, pair_sum, two_product
from clacad.base.types import Floats, Rows
from clacad.light.compiled_sums import DELTA_X, DELTA_Y, ETA_X, ETA_Y, R0
from clacad.light.sums import LARGE, ordinary
from clacad.optics.law import law_numbers
from clacad.optics.ledger import Ledger
from clacad.optics.rays import Rays
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.array_cells import (
    centre_of,
    gradient_of,
    grid_of,
    place_in_row,
    tabled,
)
from clacad.tracing.compiled.block import (
    BLOCK,
    CI,
    CI0,
    CJ,
    CJ0,
    DX,
    DY,
    DZ,
    GOOD,
    GZ,
    HALF,
    LEFT_X,
    LEFT_Y,
    PATH,
    ROOT,
    SCRATCH,
    STEEP,
    X,
    Y,
    arrive,
    blank_row,
    copy_row,
    hold_in_zone,
    lane,
    lanes,
    load_block,
    queue_undecided,
    store_block,
)
from clacad.tracing.compiled.cells import in_zone, kept
from clacad.tracing.compiled.launch import launch_block
from clacad.tracing.compiled.packing import OwnCells, Packed, own_laws, pack_array_1
from clacad.tracing.compiled.records import Outcome
from clacad.tracing.compiled.threads import in_arrays, over_threads
from clacad.tracing.layout import Layout

Rows3 = tuple[int, int, int]
BEFORE, BEHIND = (DX, DY, DZ), (LEFT_X, LEFT_Y, ROOT)
"""Rows of a block with the directions before and behind the sheet."""

NEAR = 2.0**-30
"""Share of a cell, or cosine, where nothing is decided: a million times the rounding of either path."""

FAR = 2.0**40
"""Cells from the start to the sheet beyond which nothing is decided: rounding could hide a miss."""


def rows_left(
    kernel: Callable[..., int], sheet: Packed, optics: Floats, rays: Rays, ledger: Ledger, threads: int
) -> Rows:
    """Trace rays by a kernel that writes the rows it decides; return the other rows (k,).

    kernel : `law_rung.law_chunk` or `thin.thin_chunk`, which reads `sheet` and `optics`
    """
    position, direction, out = in_arrays(rays, ledger)

    def one(chosen: Rows) -> Rows:
        left = np.empty_like(chosen)
        return left[: kernel(sheet, optics, chosen, position, direction, out, left)]

    rows = np.arange(len(rays))
    return np.concatenate([rows[:0], *over_threads(one, rows, threads)])


CLEAR = 1e-4
"""Share of a cell by which a ray must clear the sheet, or start behind it, to be called MISSED here."""

MISS = HALF
"""Row of a block that is positive where a ray certainly misses."""


@exact
def near(lat: Floats) -> float:
    """Distance from borders within which nothing is decided."""
    return float(NEAR * lat[slot.REACH])


@exact
def arrive_well_inside(sheet: Packed, array: int, s: Floats, m: int) -> None:
    """Require that rays on a reference plane lie inside a kept cell of an array, and not near its borders."""
    lat = sheet.lattices[array]
    arrive(lat, sheet.rows, s, m, 0.0)
    hold_in_zone(lat, s, m, near(lat), 0.0, 0.0)


@exact
def surely_beside(sheet: Packed, array: int, s: Floats, k: int) -> bool:
    """Whether ray k is over a cell of an array that is not kept, and far from its borders."""
    lat, x, y = sheet.lattices[array], s[X, k], s[Y, k]
    inside = in_zone(lat, x, y, CLEAR * lat[slot.REACH])
    return inside and not kept(lat, sheet.rows, s[CI, k], s[CJ, k])


@exact
def surely_unmet(sheet: Packed, s: Floats, k: int, sane: float, carried: float) -> bool:
    """Whether launched ray k, whose direction is `sane` > 0, misses the sheet sideways or started behind."""
    reach = sheet.lattice[slot.REACH]
    if not (sane > 0.0 and abs(carried) < FAR * reach and abs(s[X, k]) + abs(s[Y, k]) < inf):
        return False
    return carried < -CLEAR * reach or surely_beside(sheet, 0, s, k)


@exact
def miss(s: Floats, block: Rows, start: Floats, ray: Floats, out: Outcome) -> None:
    """Reset undecided rows to the launched rays; rays that miss or cannot be launched become decided."""
    for k in range(len(block)):
        if s[GOOD, k] == 0.0:
            launchable = blank_row(block[k], start, ray, out)
            if not launchable or s[MISS, k] > 0.0:
                s[GOOD, k] = 1.0


SANE = STEEP
"""Row of a block that is positive where a direction is of ordinary size and goes forwards."""


def trace_law_plain(layout: Layout, rays: Rays, ledger: Ledger, threads: int) -> Rows:
    """Write the rows of rays (n) that clearly cross a kept cell in z = 0; return the other rows (k,)."""
    law, sheet = law_numbers(layout.window.law), sheet_plane(layout)
    if not ordinary(law) or (sheet.own is not None and not _ordinary(sheet.own)):
        return np.arange(len(rays))
    return rows_left(law_chunk, sheet, law, rays, ledger, threads)


def _ordinary(own: OwnCells) -> bool:
    """Whether compiled code can hold the numbers of all laws; see `light.sums.ordinary`."""
    largest = max(np.abs(one).max(initial=0.0) for one in own if one is not None)
    least = 1.0 if own.frame is None else np.abs(own.frame[..., : slot.LIFT]).min()
    return bool(largest < LARGE and least > 1.0 / LARGE)


def sheet_plane(layout: Layout) -> Packed:
    """The sheet plane z = 0 as a body of no thickness with one face; `own` has laws that differ."""
    laws = layout.window.cell_laws
    sheet = pack_array_1(layout)
    if laws is not None:
        sheet = sheet._replace(own=own_laws(laws, layout.lattice))
    return sheet._replace(
        faces=np.zeros((1, slot.FACE_NUMBERS)), bodies=np.zeros((1, slot.BODY_NUMBERS)), media=np.ones(3)
    )


@owning
def law_chunk(
    sheet: Packed, law: Floats, chosen: Rows, start: Floats, ray: Floats, out: Outcome, left: Rows
) -> int:
    """Trace the rays `chosen` of `start` and `ray` (n, 3) and write their rows.

    law : see `law_numbers`
    left : (len(chosen),). Receives the rows that are not decided here; their count is returned.
    """
    s, count = np.zeros((SCRATCH, BLOCK)), 0
    for first in range(0, len(chosen), BLOCK):
        block = chosen[first : first + BLOCK]
        m = len(block)
        load_block(block, start, ray, s)
        if sheet.own is None:
            _refract(None, None, sheet, law, s, m, BEFORE)
        else:
            for before, behind in zip(BEFORE, BEHIND):
                copy_row(lane(s, before), lane(s, behind), m)
        launch_block(sheet.lattice, sheet.bodies[0], s, m)
        copy_row(lane(s, GOOD), lane(s, SANE), m)
        arrive_well_inside(sheet, 0, s, m)
        _refract_in_cells(sheet.own, sheet, law, s, m)
        _cross(sheet, s, m)
        store_block(sheet, s, block, 0, out)
        miss(s, block, start, ray, out)
        count = queue_undecided(s, block, left, count)
    return count


@inlined
def _refract_in_cells(own: OwnCells | None, sheet: Packed, law: Floats, s: Floats, m: int) -> None:
    """Refract rays by the laws of their cells, where these differ."""
    if own is not None:
        _refract(own, own.frame, sheet, law, s, m, BEHIND)


@exact
def _refract(
    own: OwnCells | None,
    frames: Floats | None,
    sheet: Packed,
    law: Floats,
    s: Floats,
    m: int,
    given: Rows3,
) -> None:
    """Put the directions behind the sheet into LEFT_X, LEFT_Y, ROOT, and their margin into GZ.

    own, frames : None, or the laws of cells and their axes, for rays in kept cells only
    given : rows of the directions before the sheet
    """
    dx, dy, dz = lanes(s, given)
    out_x, out_y, out_z, sure = lanes(s, (LEFT_X, LEFT_Y, ROOT, GZ))
    eta_x, eta_y, delta_x, delta_y = law[ETA_X], law[ETA_Y], law[DELTA_X], law[DELTA_Y]
    a, b, c = law[R0], law[R0 + 1], law[R0 + 2]
    d, e, f = law[R0 + 3], law[R0 + 4], law[R0 + 5]
    g, h, k = law[R0 + 6], law[R0 + 7], law[R0 + 8]
    for i in range(m):
        if own is not None:
            if not s[GOOD, i] > 0.0:
                continue
            delta_x, delta_y = _delta_of_cell(own, sheet, law, s[CI, i], s[CJ, i])
            if frames is not None:
                turn = frames[0, place_in_row(sheet.lattice, s[CI, i], s[CJ, i]), int(s[CJ, i])]
                eta_x, eta_y = turn[slot.FIRST], turn[slot.SECOND]
                a, b, c = turn[slot.AXES], turn[slot.AXES + 1], turn[slot.AXES + 2]
                d, e, f = turn[slot.AXES + 3], turn[slot.AXES + 4], turn[slot.AXES + 5]
                g, h, k = turn[slot.AXES + 6], turn[slot.AXES + 7], turn[slot.AXES + 8]
        u, v, w = dx[i], dy[i], dz[i]
        x, y, z = (a * u + d * v) + g * w, (b * u + e * v) + h * w, (c * u + f * v) + k * w
        sure[i] = z - NEAR * (abs(u) + abs(v) + abs(w))
        x, y = less_product(x, delta_x, z) / eta_x, less_product(y, delta_y, z) / eta_y
        u, v, w = (a * x + b * y) + c * z, (d * x + e * y) + f * z, (g * x + h * y) + k * z
        length = sqrt(u * u + v * v + w * w)
        out_x[i], out_y[i], out_z[i] = u / length, v / length, w / length


@exact
def _delta_of_cell(own: OwnCells, sheet: Packed, law: Floats, i: float, j: float) -> tuple[float, float]:
    """δ of a kept cell; see `CellLaws`."""
    if own.change[0, slot.TABLE] >= 0.0:
        return tabled(sheet, own, 0, i, j)
    x, y = centre_of(grid_of(sheet.lattice), i, j)
    xx, xy, yx, yy = gradient_of(own, 0)
    return _linear(xx, x, xy, y, law[DELTA_X]), _linear(yx, x, yy, y, law[DELTA_Y])


@exact
def _linear(a: float, x: float, b: float, y: float, start: float) -> float:
    """Value of a x + b y + start, rounded once (`VaryingLaw.deltas`)."""
    h, low = two_product(a, x)
    g, rest = two_product(b, y)
    h, low = pair_sum(h, low, g, rest)
    h, low = pair_sum(h, low, start, 0.0)
    return h + low


@exact
def _cross(sheet: Packed, s: Floats, m: int) -> None:
    """Refract rays that start before the plane; rays that are turned back, or nearly so, are not good."""
    x, y, dx, dy, dz, good, path = lanes(s, (X, Y, DX, DY, DZ, GOOD, PATH))
    out_x, out_y, out_z, sure = lanes(s, (LEFT_X, LEFT_Y, ROOT, GZ))
    copy_row(lane(s, CI), lane(s, CI0), m)
    copy_row(lane(s, CJ), lane(s, CJ0), m)
    far = FAR * sheet.lattice[slot.REACH]
    for i in range(m):
        dx[i], dy[i], dz[i] = out_x[i], out_y[i], out_z[i]
        certain = least(least(good[i], sure[i]), out_z[i] - NEAR)
        met = (path[i] >= 0.0) & (path[i] < far) & (abs(x[i]) + abs(y[i]) < inf)
        good[i] = certain if met else 0.0
    for i in range(m):
        if not good[i] > 0.0:
            s[MISS, i] = 1.0 if surely_unmet(sheet, s, i, s[SANE, i], path[i]) else 0.0
