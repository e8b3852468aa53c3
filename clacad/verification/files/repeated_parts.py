"""Parts that are repeated in a file: their places compared with the lattice, and their facets over the chosen cells."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Bools, Floats, Ints
from clacad.exporting.compare_instances import PartPlaces, RowPlaces, Standing
from clacad.exporting.measure_instances import MOST_KINDS
from clacad.formats.mesh.file_mesh import Part, kinds
from clacad.verification.check_kinds.files import PLACEMENT
from clacad.verification.checks import Check
from clacad.verification.files.cell_triangles import Gatherer
from clacad.verification.limit_sources import other

if TYPE_CHECKING:
    from clacad.design import Design


TOUCHING = 1e-6
"""Overlap, over the pitch, by which a box must enter a cell to have facets there; identical cells touch at borders."""

MOST_LOOKS = 64
"""Places of one part that are examined one by one; where more lie over the chosen cells the places are wrong."""


def placement_check(design: Design, found: Standing, name: str) -> Check:
    """Judge whether every instance of a repeated cell lies on a cell of its array, each cell once."""
    missing, doubled, outside = found.faults
    return PLACEMENT.check(
        "pass" if found.sound else "fail", found.words, found.worst, found.limit, unit=design.unit,
        subject=name, limit_source=other("rounding of the places to float32"),
        detail={
            "instances": found.count, "worst_cell": found.worst_cell, "missing": missing, "doubled": doubled,
            "outside": outside, "cells_missing": found.missing, "cells_doubled": found.doubled,
        },
    )  # fmt: skip


def look_at_places(gatherer: Gatherer, places: PartPlaces | RowPlaces, factor: float, limit: float) -> None:
    """Gather the facets of a repeated object over the chosen cells, and compare it with the design where it is worst.

    Parameters
    ----------
    gatherer : Gatherer
    places : PartPlaces or RowPlaces
    factor : float
        Design units per file unit.
    limit : float, design units
        Displacement from the lattice up to which a place is a copy of another.
    """
    if isinstance(places, RowPlaces):
        for part in places.parts:
            _look_at_rows(gatherer, part, places, factor)
        return
    for part in places.parts:
        for number, (_, rows) in enumerate(kinds(part)):
            if number == MOST_KINDS:
                break
            _look_at_kind(gatherer, part, places, rows, factor, limit)


def _look_at_rows(gatherer: Gatherer, part: Part, places: RowPlaces, factor: float) -> None:
    """Gather a part in rows: all its places are copies of the one over the first chosen cell."""
    over = [places.over(cell) for cell in gatherer.result.cells]
    spots = part.placed_at(np.array(over, dtype=np.int64))
    for corners, normals in part.pairs_at(spots[0]):
        gatherer.look(corners * factor, normals, places.count)
    for number in sorted(range(1, len(over)), key=over.__getitem__):
        _repeat(gatherer, 0, number, (spots[number, 3] - spots[0, 3]) * factor)


def _look_at_kind(
    gatherer: Gatherer, part: Part, places: PartPlaces, rows: Ints, factor: float, limit: float
) -> None:
    """Gather the places `rows` at which a part has one orientation."""
    over = _over(gatherer, places, rows)
    sound = places.off[rows] <= limit
    first, near = _to_look_at(gatherer, part, places, rows, factor, over, sound)
    _look(gatherer, part, first, factor, len(rows))
    copies = np.flatnonzero(sound & (over >= 0)) if places.one_cell else np.zeros(0, dtype=np.int64)
    cell = int(over[rows == first][0])
    for k in copies.tolist():
        if over[k] != cell:
            shift = (part.placements[rows[k], 3] - part.placements[first, 3]) * factor
            _repeat(gatherer, cell, int(over[k]), shift)
    for row in near[:MOST_LOOKS]:
        _look(gatherer, part, row, factor, 0)
    worst = int(rows[np.argmax(places.off[rows])])
    if places.off[worst] > limit and worst != first and worst not in near:
        for corners, _ in part.pairs_at(part.placements[worst]):
            gatherer.hold(corners * factor)


def _to_look_at(
    gatherer: Gatherer, part: Part, places: PartPlaces, rows: Ints, factor: float, over: Ints, sound: Bools
) -> tuple[int, list[int]]:
    """The place at which a part is counted, and other places to examine for facets over chosen cells."""
    near = _near(gatherer, part, rows, factor)
    good = np.flatnonzero(sound & (over >= 0))
    if places.one_cell and len(good):
        first = int(rows[good[np.argmin(over[good])]])
        known = set(rows[sound].tolist())  # copies, or over cells that were not chosen
        return first, [row for row in near.tolist() if row not in known]
    first = int(near[0]) if len(near) else int(rows[0])
    return first, [row for row in near.tolist() if row != first]


def _look(gatherer: Gatherer, part: Part, row: int, factor: float, times: int) -> None:
    for corners, normals in part.pairs_at(part.placements[row]):
        gatherer.look(corners * factor, normals, times)


def _repeat(gatherer: Gatherer, source: int, cell: int, shift: Floats) -> None:
    """Give a chosen cell the shifted facets of another cell, for the faces that no copy has given it yet."""
    found = gatherer.result
    for body, side, number in list(found.facets):
        if number == source and (body, side, cell) not in found.repeats:
            found.repeats[body, side, cell] = [(source, shift)]


def _over(gatherer: Gatherer, places: PartPlaces, rows: Ints) -> Ints:
    """Number (k,) of the chosen cell under each place of an object; −1 for other cells."""
    index = next(iter(places.cells.values()))[0] + places.step[rows]
    found = np.full(len(rows), -1, dtype=np.int64)
    for number, cell in enumerate(gatherer.result.cells):
        found[(index == cell).all(axis=1)] = number
    return found


def _near(gatherer: Gatherer, part: Part, rows: Ints, factor: float) -> Ints:
    """Places among `rows` whose box extends over a chosen cell, those of the first chosen cell first."""
    window = gatherer.window
    low, high = part.own_box()
    ends = np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )
    turned = (ends @ part.placements[rows[0], :3])[:, :2] * factor
    place = part.placements[rows, 3, :2] * factor
    least, most = place + turned.min(axis=0), place + turned.max(axis=0)
    tile = window.lattice.tile()
    room = TOUCHING * min(window.lattice.pitch)
    first, last = tile.min(axis=0) + room, tile.max(axis=0) - room
    middles = window.lattice.centres(np.array(gatherer.result.cells, dtype=np.int64))
    found: dict[int, None] = {}
    for middle in middles:
        for shift in _shifts(window.shifts):
            over = (most > middle + shift + first).all(axis=1) & (least < middle + shift + last).all(axis=1)
            found |= dict.fromkeys(np.flatnonzero(over).tolist())
    return rows[list(found)]


def _shifts(shifts: Iterable[tuple[float, float]]) -> list[Floats]:
    return [np.asarray(shift) for shift in dict.fromkeys(tuple(s) for s in shifts)]
