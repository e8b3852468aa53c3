"""Light through a map: the heights of one cell of a face as a bicubic surface, the other faces as designed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clacad.base.types import Floats
from clacad.exporting.formats.file_kind import FaceFile, FileKind, Samples
from clacad.formats.maps.sag import structured_faces
from clacad.sheet.representative_cells import central_cell
from clacad.sheet.window import Face, Window
from clacad.storage.errors import ExportError
from clacad.tracing.sampled_face import sampled_face
from clacad.tracing.triangles.telescopelet_facets import AnyFace, ExactFace, FacetBody, trace_facets
from clacad.verification.check_kinds.file_light import THROUGH_FILE
from clacad.verification.checks import Check
from clacad.verification.files.inspection import Inspection
from clacad.verification.files.law_through_file import light_checks, measure_light
from clacad.verification.files.mesh_light import lit_cells, seen_cell

RAYS, POINT_RAYS = 8192, 1024
"""Most rays of the main bundle, and of each field point."""


def map_light(asked: Inspection, window: Window, path: Path, kind: FileKind, label: str) -> list[Check]:
    """Trace the rays of the checks through the heights of a map, grid or point file.

    Parameters
    ----------
    `asked` : Inspection
    window : Window
    path : Path
    kind : FileKind
        From `clacad.verification.files.map_file.kind_of_map`; one without heights gives no check.
    label : str
        Name of the face.
    """
    samples = kind.reading.samples
    if samples is None:
        return []
    body, face = next((b, f) for b, f, name in structured_faces(window) if name == label)
    cell = central_cell(window) if window.uniform else lit_cells(window, asked.design.check.field)[0]
    one = seen_cell(window, cell)
    like = next(f for _, f, name in structured_faces(one.like) if name == label)
    try:
        held = samples(FaceFile(window, body, face, label, path), cell)
        through = _bodies(one.like, like, cell, held)
    except (ExportError, OSError, ValueError) as error:
        why = f"no light can be sent through it: {error}"
        return [kind.not_run(why, **asked.common) for kind in THROUGH_FILE]
    seen = measure_light(
        asked.design,
        one.like,
        lambda lit: trace_facets(through, one.placed(lit).rays),
        min(asked.rays, RAYS),
        POINT_RAYS,
        cell if window.uniform else None,
        one.send,
    )
    what = f"bicubic surface ({kind.word}, {label}; the other faces as designed)"
    return light_checks(asked, seen, what)


def _bodies(window: Window, sampled: Face, cell: tuple[int, int], held: Samples) -> tuple[FacetBody, ...]:
    """Telescopelet of a cell: one face as sampled, the others as designed."""
    bodies = []
    for body in window.bodies:
        faces: list[AnyFace] = []
        for face in (body.front, body.back):
            place = np.array([*_centre(window, face, cell), 0.0])
            if face is sampled:
                faces.append(sampled_face(window, face, place, held.points, held.step))
            else:
                faces.append(ExactFace(face, place, window))
        bodies.append(FacetBody(faces[0], faces[1], body.index))
    return tuple(bodies)


def _centre(window: Window, face: Face, cell: tuple[int, int]) -> Floats:
    """Middle (2,) of a cell, in the grid of the face's own array."""
    return window.centres(face.array or 0, np.array(cell, dtype=np.int64))
