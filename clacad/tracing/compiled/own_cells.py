"""Packed numbers of a non-uniform sheet: positions of every array's cells, and the lens in each.

Non-uniform sheets use the general kernels, compiled for these numbers; uniform sheets load nothing from this
module.
"""

from __future__ import annotations

import numpy as np

from clacad.base.types import Floats
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.packing import OwnCells, Packed, lattice_row, pack_array_1
from clacad.tracing.compiled.records import MOST_ARRAYS
from clacad.tracing.layout import FacePlan, Layout, prepared


def pack_own(layout: Layout) -> Packed:
    """Pack the layout of a non-uniform sheet, with indices of the design's wavelength; kept with it."""
    made: Packed | None = prepared(layout).get("packed_own")
    if made is None:
        sheet = pack_array_1(layout)
        bodies = sheet.bodies.copy()
        bodies[:, slot.QUICK] = 0.0  # the short cut of the walk assumes one lens for all cells
        made = prepared(layout)["packed_own"] = sheet._replace(
            bodies=bodies, lattices=_lattices(layout), own=_own_cells(layout)
        )
    return made


def _lattices(layout: Layout) -> Floats:
    """Numbers of every array, one row each; rows of missing arrays repeat the last array."""
    last = len(layout.lattices) - 1
    return np.array([_lattice_row(layout, min(array, last)) for array in range(MOST_ARRAYS)])


def _own_cells(layout: Layout) -> OwnCells:
    tables: list[Floats] = []
    change = [_change(face, tables) for body in layout.bodies for face in (body.front, body.back)]
    table = np.array(tables) if tables else np.zeros((0, 1, 1, 2))
    return OwnCells(np.array(change), np.ascontiguousarray(table))


def _lattice_row(layout: Layout, array: int) -> Floats:
    lattice, row = layout.lattices[array], lattice_row(layout)
    row[slot.PITCH], row[slot.ROW] = lattice.pitch[0], lattice.row_height
    row[slot.X0], row[slot.Y0] = lattice.first_centre
    row[slot.HALF : slot.HALF + len(layout.halves)] = layout.widths[array]
    row[slot.REACH] = lattice.circumradius
    return row


def _change(face: FacePlan, tables: list[Floats]) -> list[float]:
    """Row of `OwnCells.change`; the table of the face is appended to `tables`."""
    if face.change is None:
        return [0.0, 0.0, 0.0, 0.0, 0.0, -1.0]
    which = -1.0
    if face.change.table is not None:
        which = float(len(tables))
        tables.append(face.change.table)
    return [1.0, *np.ravel(face.change.gradient).tolist(), which]
