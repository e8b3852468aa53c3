"""Judge one mesh file: its wholeness, its agreement with the design, and the light through its triangles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clacad.base.types import Floats, Progress
from clacad.exporting.compare_instances import Standing, standing
from clacad.exporting.measure_instances import joined, measure_repeated
from clacad.formats.mesh.closed_stream import Measure, measure
from clacad.formats.mesh.file_mesh import FileMesh
from clacad.sheet.feasibility import body_range
from clacad.sheet.window import Window
from clacad.verification.checks import Check
from clacad.verification.files.cell_triangles import Gatherer
from clacad.verification.files.facet_deviation import deviations
from clacad.verification.files.inspection import Inspection
from clacad.verification.files.mesh_light import MeshEvidence, checks_of_light, lit_cells
from clacad.verification.files.mesh_shape import chord_volume, shape_check, volume_check
from clacad.verification.files.mesh_wholeness import (
    COUNTED_FACETS,
    PieceCount,
    closed_check,
    counted_on_the_way,
    holding,
    part_counts,
    pieces_check,
    scale_check,
)
from clacad.verification.files.repeated_parts import look_at_places, placement_check
from clacad.verification.files.stored_normals import normals_check


def judge_mesh(
    asked: Inspection, window: Window, mesh: FileMesh, factor: float, present: Sequence[str] | None = None
) -> tuple[list[Check], MeshEvidence]:
    """Measure a mesh file in one pass and judge it.

    Parameters
    ----------
    `asked` : Inspection
    window : Window
        With the cells that were written.
    mesh : FileMesh
    factor : float
        Design units per file unit.
    present : names of the bodies in the file, or None for all
        Other bodies are taken from the design for the light.
    """
    design, name = asked.design, asked.name
    held = held_part(window, present)
    gatherer = Gatherer(window, lit_cells(window, design.check.field), _bevel(window, asked.stated))
    places = standing(mesh, window, factor)
    counted = counted_on_the_way(mesh) if places is None else None
    found = _measured(mesh, factor, _Lookers(gatherer, counted), places, asked.progress)
    gathered = gatherer.result
    counts = part_counts(mesh)
    pieces = pieces_check(held, found, mesh, name, asked.stated, counts, counted)
    shells = int(pieces[0].value) if found.closed and isinstance(pieces[0].value, float) else None
    holds = holding(mesh, shells)
    checks = [
        closed_check(found, gathered, mesh, name, holds, counts),
        scale_check(design, held, found, name),
        *pieces,
    ]
    if places is not None:
        checks.append(placement_check(design, places, name))
    reach = max(abs(z) for z in window.z_range)
    checks.append(volume_check(asked, held, reach, chord_volume(window, gathered, 0), found, gathered))
    off = deviations(window, gathered, present)
    checks.append(shape_check(asked, window, gathered, off, present))
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
    counted: PieceCount | None


def _measured(
    mesh: FileMesh, factor: float, lookers: _Lookers, places: Standing | None, progress: Progress
) -> Measure:
    """Measure a file and gather its facets: parts that represent cells once, others at each place."""
    cells = set() if places is None else {id(part) for p in places.places for part in p.parts}
    repeated = measure_repeated(replace(mesh, parts=tuple(p for p in mesh.parts if id(p) in cells)), factor)
    if places is not None and repeated.imbalance != (0, 0) and mesh.facet_count <= COUNTED_FACETS:
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
