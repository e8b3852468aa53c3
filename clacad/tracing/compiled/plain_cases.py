"""Rays that the compiled rungs "law" and "thin" decide: those that pass every border at a safe distance.

A ray closer than that to a border, or to being turned back, is left to the numpy path, so the rounding of
either path does not matter.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf

import numpy as np

from clacad.base.compiled import exact
from clacad.base.types import Floats, Rows
from clacad.optics.rays import Rays
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.cells import in_zone, kept
from clacad.tracing.compiled.chunk import blank_row
from clacad.tracing.compiled.packing import Packed
from clacad.tracing.compiled.records import Outcome
from clacad.tracing.compiled.straight_path import arrive, hold_in_zone
from clacad.tracing.compiled.straight_path_slots import CI, CJ, GOOD, HALF, X, Y
from clacad.tracing.compiled.threads import in_arrays, over_threads
from clacad.tracing.ledger import Ledger

NEAR = 2.0**-30
"""Share of a cell, or cosine, within which nothing is decided: a million times the rounding error of either
path.
"""

FAR = 2.0**40
"""Cells from the start to the sheet beyond which nothing is decided: rounding could hide whether a ray misses
the sheet.
"""


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
def arrive_well_inside(sheet: Packed, s: Floats, m: int) -> None:
    """Require that rays on a reference plane lie inside a kept cell, and not near its borders."""
    arrive(sheet.lattice, sheet.rows, s, m, 0.0)
    hold_in_zone(sheet.lattice, s, m, near(sheet.lattice), 0.0, 0.0)


@exact
def surely_beside(sheet: Packed, s: Floats, k: int) -> bool:
    """Whether ray k is over a cell that is not kept, and far from its borders."""
    lat, x, y = sheet.lattice, s[X, k], s[Y, k]
    inside = in_zone(lat, x, y, CLEAR * lat[slot.REACH])
    return inside and not kept(lat, sheet.rows, s[CI, k], s[CJ, k])


@exact
def surely_unmet(sheet: Packed, s: Floats, k: int, sane: float, carried: float) -> bool:
    """Whether launched ray k, whose direction is `sane` > 0, misses the sheet laterally or started behind
    it.
    """
    reach = sheet.lattice[slot.REACH]
    if not (sane > 0.0 and abs(carried) < FAR * reach and abs(s[X, k]) + abs(s[Y, k]) < inf):
        return False
    return carried < -CLEAR * reach or surely_beside(sheet, s, k)


@exact
def miss(s: Floats, block: Rows, start: Floats, ray: Floats, out: Outcome) -> None:
    """Reset the undecided rows of a block to the launched rays; rays that miss or cannot be launched become
    decided.
    """
    for k in range(len(block)):
        if s[GOOD, k] == 0.0:
            launchable = blank_row(block[k], start, ray, out)
            if not launchable or s[MISS, k] > 0.0:
                s[GOOD, k] = 1.0
