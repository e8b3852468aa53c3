"""Judge one mesh file: is it whole, is it the design, and does light through its triangles do what it should?"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.export.closed import measure
from clacad.export.filemesh import FileMesh
from clacad.export.roles import Role
from clacad.feasibility import body_range
from clacad.sheet import Window
from clacad.trace.facets import Floats
from clacad.verify.checks import Check
from clacad.verify.deviation import FEWER, POINTS, deviation
from clacad.verify.gather import Gatherer, Progress, chosen_cells, telescopelet
from clacad.verify.meshlight import MeshEvidence, light_checks
from clacad.verify.meshshape import chord_volume, shape_check, volume_check
from clacad.verify.wholeness import closed_check, pieces_check, scale_check

if TYPE_CHECKING:
    from clacad.design import Design


def judge_mesh(
    design: Design, window: Window, mesh: FileMesh, factor: float, name: str, stated: Mapping[str, Any], rays: int,
    progress: Progress, present: Sequence[str] | None = None, role: Role = Role.MASTER,
) -> tuple[list[Check], MeshEvidence]:  # fmt: skip
    """Measure a mesh file in one pass and judge it.

    Parameters
    ----------
    design : Design
    window : Window
        With the cells that were written.
    mesh : FileMesh
    factor : float
        Design units per file unit.
    name : str
        File name, the subject of the checks.
    stated : mapping
        Entry of the manifest; empty without one.
    rays : int
    progress : callable
        (stage, done 0 … 1).
    present : names of the bodies in the file, or None for all
        Light meets the others as the design has them.
    role : Role
        What the file is for.
    """
    held = held_part(window, present)
    bevel = (
        float(stated.get("saddle_bevel", 0.0)) * (1.0 if stated.get("unit") == "m" else 1e-3) / window.unit
    )
    gatherer = Gatherer(window, chosen_cells(window), bevel)
    found = measure(_looked_at(mesh, factor, gatherer, progress), origin=np.zeros(3))
    gathered = gatherer.result
    checks = [closed_check(found, gathered, mesh, name), scale_check(design, held, found, name)]
    checks += pieces_check(held, found, mesh, name, stated)
    reach = max(abs(z) for z in window.z_range)
    checks.append(volume_check(held, reach, chord_volume(window, gathered, 0), found, gathered, name, stated))
    off = [
        deviation(window, telescopelet(window, gathered, k, present), FEWER if k else POINTS)
        for k in range(len(gathered.cells))
    ]
    checks.append(shape_check(design, window, gathered, off, name, stated, present))
    light, evidence = light_checks(design, window, gathered, off, found, name, rays, progress, present, role)
    return checks + light, evidence


def held_part(window: Window, present: Sequence[str] | None) -> Window:
    """The window reduced to the bodies a file holds, its height range too."""
    if present is None or set(present) == {body.name for body in window.bodies}:
        return window
    bodies = tuple(b for b in window.bodies if b.name in present)
    low, high = zip(*(body_range(window, body) for body in bodies), strict=True)
    return replace(window, bodies=bodies, z_range=(min(low), max(high)))


def _looked_at(mesh: FileMesh, factor: float, gatherer: Gatherer, progress: Progress) -> Iterator[Floats]:
    total, done = max(1, mesh.facet_count), 0
    for chunk in mesh.chunks():
        corners = chunk * factor
        gatherer.look(corners)
        done += len(corners)
        progress("reading triangles", done / total)
        yield corners
