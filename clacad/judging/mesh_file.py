"""Judge one mesh file: its wholeness, its agreement with the design, and the light through its triangles.

Stored vertex normals of a file, compared with the normals of the design's own faces; renderers shade with
them.

Parts that are repeated in a file: their places compared with the lattice, and their facets over the chosen
cells.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.text import mrad_text
from clacad.base.types import Bools, Floats, Ints, Progress
from clacad.checks.check import Check, other
from clacad.checks.file_kinds import FILE_NORMALS, PLACEMENT
from clacad.formats.mesh.compare_instances import PartPlaces, RowPlaces, Standing, owner, standing
from clacad.formats.mesh.file_mesh import FileMesh, Part, kinds
from clacad.formats.mesh.measure import MOST_KINDS, Measure, joined, measure, measure_repeated
from clacad.judging import mesh_wholeness
from clacad.judging.cell_triangles import CellFacets, Gatherer, lost_in_mesh, with_holes
from clacad.judging.delivery import Inspection
from clacad.judging.face_deviation import Deviation, deviations
from clacad.judging.mesh_light import MeshEvidence, checks_of_light, lit_cells
from clacad.judging.mesh_shape import chord_volume, shape_check, volume_check
from clacad.optics.law.orientation import angle_between
from clacad.sheet.feasibility import body_range
from clacad.sheet.window import Face, Window, lens_height_and_normal
from clacad.tracing.facets.telescopelet import on_land

if TYPE_CHECKING:
    from clacad.design import Design


STEEPER = 2.0
"""Rms error of stored normals over the slope error of their facets, beyond which they are wrong."""

ROOM = 1e-6
"""Radians by which rounding to float32, or to six digits, may turn a normal."""


def normals_check(window: Window, gathered: CellFacets, off: Sequence[Deviation], name: str) -> Check | None:
    """Judge the normals stored in a file over the chosen cells; None where the file has none.

    gathered : With the facets' stored normals.
    off : Of these cells.
    name : File name, the subject of the check.
    """
    if not gathered.stored:
        return None
    source = other(f"{STEEPER:g} × slope error of its facets")
    common: dict[str, Any] = {"where": "file", "subject": name, "unit": "rad", "limit_source": source}
    if gathered.odd:
        text = f"{gathered.odd} of {gathered.stored} facets have a stored normal that is no unit vector"
        return FILE_NORMALS.check("fail", text, None, **common)
    if gathered.inward:
        text = f"the stored normals of {gathered.inward} of {gathered.stored} facets point inward"
        return FILE_NORMALS.check("fail", text, None, **common)
    worst, limit, text = -1.0, 0.0, "no lens face has stored normals"
    for cell, index in enumerate(gathered.cells):
        if gathered.source(cell) != cell:
            continue
        for face, (body, side) in enumerate((b, s) for b in range(len(window.bodies)) for s in (0, 1)):
            rms = _rms(window, gathered, body, side, cell)
            room = STEEPER * float(np.nan_to_num(off[cell].slope_rms[face])) + ROOM
            if rms is not None and rms / room > worst / (limit or 1.0):
                label = f"{window.bodies[body].name} {('front', 'back')[side]}, cell {index}"
                worst, limit = rms, room
                text = f"stored normals are up to {mrad_text(rms)} rms off the exact faces ({label})"
    if worst < 0.0:
        return FILE_NORMALS.check("not run", text, **{**common, "required": False})
    return FILE_NORMALS.check("pass" if worst <= limit else "fail", text, worst, limit, **common)


def _rms(window: Window, gathered: CellFacets, body: int, side: int, cell: int) -> float | None:
    """Rms angle (radians) between stored and exact normals of one side of a body over a chosen cell."""
    normals = gathered.corner_normals(body, side, cell)
    if normals is None or not len(normals):
        return None
    window, index = gathered.alike(window, cell)
    piece = window.bodies[body]
    face = (piece.front, piece.back)[side]
    local = gathered.corners(body, side, cell) - [*window.centres(owner(piece, face), index), 0.0]
    angle = angle_between(exact_normals(window, face, local), normals)
    angle = angle[np.isfinite(angle)]
    return float(np.sqrt(np.mean(angle**2))) if len(angle) else None


def exact_normals(window: Window, face: Face, local: Floats) -> Floats:
    """Outward unit normals (k, 3, 3) of the design at corners of facets, cell frame; NaN without a lens."""
    out = np.zeros_like(local)
    out[..., 2] = -face.side
    if face.array is None:
        return out
    _, normal = lens_height_and_normal(face, local[..., 0].ravel(), local[..., 1].ravel())
    flat = on_land(window, face, local)
    return np.where(flat[:, None, None], out, normal.reshape(local.shape) * -face.side)


TOUCHING = 1e-6
"""Overlap, over the pitch, by which a box must enter a cell to have facets there; identical cells touch."""

MOST_LOOKS = 64
"""Places of one part that are examined one by one; if more lie over the chosen cells they are wrong."""


def placement_check(design: Design, found: Standing, name: str) -> Check:
    """Judge whether every instance of a repeated cell lies on a cell of its array, each cell once."""
    missing, doubled, outside = found.faults
    return PLACEMENT.check(
        "pass" if found.sound else "fail",
        found.words,
        found.worst,
        found.limit,
        unit=design.unit,
        subject=name,
        limit_source=other("rounding of the places to float32"),
        detail={
            "instances": found.count,
            "worst_cell": found.worst_cell,
            "missing": missing,
            "doubled": doubled,
            "outside": outside,
            "cells_missing": found.missing,
            "cells_doubled": found.doubled,
        },
    )


def look_at_places(gatherer: Gatherer, places: PartPlaces | RowPlaces, factor: float, limit: float) -> None:
    """Gather the facets of a repeated object over the chosen cells, and compare it with the design where it
    is worst.

    factor : Design units per file unit.
    limit : design units. Displacement from the lattice up to which a place is a copy of another.
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


def judge_mesh(
    asked: Inspection, window: Window, mesh: FileMesh, factor: float, present: Sequence[str] | None = None
) -> tuple[list[Check], MeshEvidence]:
    """Measure a mesh file in one pass and judge it.

    window : With the cells that were written.
    factor : Design units per file unit.
    present : names of the bodies in the file, or None for all
        Other bodies are taken from the design for the light.
    """
    design, name = asked.design, asked.name
    held = held_part(window, present)
    gatherer = Gatherer(window, lit_cells(window, design.check.field), _bevel(window, asked.stated))
    places = standing(mesh, window, factor)
    counted = mesh_wholeness.counted_on_the_way(mesh) if places is None else None
    found = _measured(mesh, factor, _Lookers(gatherer, counted), places, asked.progress)
    gathered = gatherer.result
    counts = mesh_wholeness.part_counts(mesh)
    wrong = mesh_wholeness.misnamed(held, mesh_wholeness.named_objects(held, mesh, factor), "object")
    pieces = mesh_wholeness.pieces_check(held, found, mesh, name, asked.stated, counts, counted, wrong)
    shells = int(pieces[0].value) if found.closed and isinstance(pieces[0].value, float) else None
    holds = mesh_wholeness.holding(mesh, shells)
    checks = [
        mesh_wholeness.closed_check(found, gathered, mesh, name, holds, counts, held),
        mesh_wholeness.scale_check(design, held, found, name),
        *pieces,
    ]
    if places is not None:
        checks.append(placement_check(design, places, name))
    reach = max(abs(z) for z in window.z_range)
    checks.append(volume_check(asked, held, reach, chord_volume(window, gathered, 0), found, gathered))
    off = deviations(window, gathered, present)
    shape = shape_check(asked, window, gathered, off, present)
    lost = [] if gathered.bored is None else lost_in_mesh(window, gathered.bored, present)
    checks.append(with_holes(shape, lost, design.unit))
    stored = normals_check(window, gathered, off, name)
    checks += [] if stored is None else [stored]
    light, evidence = checks_of_light(asked, window, gathered, off, found, present)
    return checks + light, replace(evidence, facts={**evidence.facts, "holds": holds})


def _bevel(window: Window, stated: Mapping[str, Any]) -> float:
    """Bevel at saddles (length) that a manifest states, 0 without."""
    metres = 1.0 if stated.get("unit") == "m" else 1e-3
    return float(stated.get("saddle_bevel", 0.0)) * metres / window.unit


def held_part(window: Window, present: Sequence[str] | None) -> Window:
    """The window reduced to the bodies a file holds, with its height range."""
    if present is None or set(present) == {body.name for body in window.bodies}:
        return window
    bodies = tuple(b for b in window.bodies if b.name in present)
    low, high = zip(*(body_range(window, body) for body in bodies), strict=True)
    return replace(window, bodies=bodies, z_range=(min(low), max(high)))


@dataclass(frozen=True, slots=True)
class _Lookers:
    """The consumers of a file's facets during measurement."""

    gatherer: Gatherer
    counted: mesh_wholeness.PieceCount | None


def _measured(
    mesh: FileMesh, factor: float, lookers: _Lookers, places: Standing | None, progress: Progress
) -> Measure:
    """Measure a file and gather its facets: parts that represent cells once, others at each place."""
    cells = set() if places is None else {id(part) for p in places.places for part in p.parts}
    repeated = measure_repeated(replace(mesh, parts=tuple(p for p in mesh.parts if id(p) in cells)), factor)
    if (
        places is not None
        and repeated.imbalance != (0, 0)
        and mesh.facet_count <= mesh_wholeness.COUNTED_FACETS
    ):
        places, cells, repeated = (
            None,
            set(),
            measure(()),
        )  # open when taken alone; neighbouring parts may close them
    rest = replace(mesh, parts=tuple(part for part in mesh.parts if id(part) not in cells))
    found = measure(_looked_at(rest, factor, lookers, progress), origin=np.zeros(3))
    for one in () if places is None else places.places:
        look_at_places(lookers.gatherer, one, factor, places.limit if places is not None else 0.0)
    return joined([one for one in (found, repeated) if one.facets])


def _looked_at(mesh: FileMesh, factor: float, lookers: _Lookers, progress: Progress) -> Iterator[Floats]:
    total, done = max(1, mesh.facet_count), 0
    for chunk, normals in mesh.pairs():
        corners = chunk * factor
        lookers.gatherer.look(corners, normals)
        if lookers.counted is not None:
            lookers.counted.add(chunk)
        done += len(corners)
        progress("reading triangles", done / total)
        yield corners
