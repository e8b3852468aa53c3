"""Judge maps, point clouds, grids, tables and masks: every number in them is compared with the design's own
faces.

The format of a file is that of its manifest, else that of its suffix. A file without a manifest may hold any
of the design's structured faces: the best-fitting one is named.

Light through a map: the heights of one cell of a face as a bicubic surface, the other faces as designed.
"""

from __future__ import annotations

import csv
from dataclasses import replace
from math import inf

import numpy as np

from clacad.base.types import Floats
from clacad.checks.check import Check, other
from clacad.checks.file_kinds import READABLE, SHAPE, THROUGH_FILE, unreadable
from clacad.exporting.formats import registry
from clacad.exporting.formats.file_kind import FaceFile, FileKind, Reading
from clacad.exporting.limits import refuse_no_cell
from clacad.exporting.roles import Role
from clacad.formats.maps.sag import structured_faces
from clacad.judging.delivery import Inspection, Subject
from clacad.judging.file_light import light_checks, measure_light
from clacad.judging.mesh_light import lit_cells, seen_cell
from clacad.light.measure import Send
from clacad.sheet.like_cell import named_cell
from clacad.sheet.representative_cells import central_cell
from clacad.sheet.window import Face, Window
from clacad.storage.errors import BadRequest, ExportError, UnreadableFile
from clacad.tracing.facets.telescopelet import AnyFace, ExactFace, FacetBody, sampled_face, trace_facets
from clacad.tracing.worst_cell import SeenCell

RAYS, POINT_RAYS = 8192, 1024
"""Most rays of the main bundle, and of each field point."""


def map_light(asked: Inspection, window: Window, subject: Subject, kind: FileKind, label: str) -> list[Check]:
    """Trace the rays of the checks through the heights of a map, grid or point file.

    kind : From `clacad.judging.map_file.kind_of_map`; one without heights gives no check.
    label : Name of the face.
    """
    samples = kind.reading.samples
    if samples is None:
        return []
    cell = subject.cell
    described = window if cell is None else named_cell(window, cell)
    body, face = next((b, f) for b, f, name in structured_faces(described) if name == label)
    one = lit_cell(asked, window) if cell is None or window.uniform else seen_cell(window, cell)
    cell = one.index
    like = next(f for _, f, name in structured_faces(one.like) if name == label)
    try:
        held = samples(FaceFile(described, body, face, label, subject.path), cell)
        through = made_bodies(one.like, like, cell, held.points, held.step)
    except (ExportError, OSError, ValueError) as error:
        why = f"no light can be sent through it: {error}"
        return [kind.not_run(why, **asked.common) for kind in THROUGH_FILE]
    what = f"bicubic surface ({kind.word}, {label}; the other faces as designed)"
    return light_of_cell(asked, one, lambda lit: trace_facets(through, one.placed(lit).rays), what)


def lit_cell(asked: Inspection, window: Window) -> SeenCell:
    """The cell through which light is sent: of a uniform sheet the central one, of others the worst."""
    cell = central_cell(window) if window.uniform else lit_cells(window, asked.design.check.field)[0]
    return seen_cell(window, cell)


def light_of_cell(asked: Inspection, one: SeenCell, send: Send, what: str) -> list[Check]:
    """Checks of light through one cell of a file: of a uniform sheet any, of others that cell is named.

    send : Through the file, as `measure_light` takes it.
    what : Surface that light meets, for the sentences.
    """
    lit, named = (one.index, ()) if one.window.uniform else (None, (one.index,))
    seen = measure_light(asked.design, one.like, send, min(asked.rays, RAYS), POINT_RAYS, lit, one.send)
    return light_checks(asked, seen, what, cells=named)


def made_bodies(
    window: Window, sampled: Face, cell: tuple[int, int], points: Floats, step: Floats
) -> tuple[FacetBody, ...]:
    """Telescopelet of a cell: one face as at points (m, 3), `step` (2,) apart; the others as designed."""
    bodies = []
    for body in window.bodies:
        faces: list[AnyFace] = []
        for face in (body.front, body.back):
            place = np.array([*_centre(window, face, cell), 0.0])
            if face is sampled:
                faces.append(sampled_face(window, face, place, points, step))
            else:
                faces.append(ExactFace(face, place, window))
        bodies.append(FacetBody(faces[0], faces[1], body))
    return tuple(bodies)


def _centre(window: Window, face: Face, cell: tuple[int, int]) -> Floats:
    """Middle (2,) of a cell, in the grid of the face's own array."""
    return window.centres(face.array or 0, np.array(cell, dtype=np.int64))


DAMAGED = (
    ExportError,
    OSError,
    ValueError,
    LookupError,
    TypeError,
    ArithmeticError,
    RecursionError,
    MemoryError,
    csv.Error,
)
"""Exceptions that the readers of numbers raise for bytes of another format."""


def kind_of_map(subject: Subject) -> FileKind | None:
    """Kind of a file that is judged by the numbers in it, or None."""
    kind = registry.kind_of(subject.format) if subject.entry else registry.kind_ending(subject.name)
    return kind if kind is not None and kind.family == "map" else None


def judge_map(asked: Inspection, window: Window, subject: Subject, kind: FileKind) -> list[Check]:
    """Compare a file with the design's faces, number by number, and trace light through its heights.

    window : With the cells that were written.
    kind : From `kind_of_map`.

    Returns: readable, shape, and those of light where the file holds heights.
    """
    common = asked.common
    reading = kind.reading
    try:
        worst, room, what, label = _compared(described(window, subject), subject, reading)
    except DAMAGED as error:
        return [unreadable(error, **common), SHAPE.not_run("the file cannot be read", **common)]
    sentence = (
        f"{what}: up to {worst:.3g} off the design's" if worst < inf else f"{what}: other than the design's"
    )
    found = READABLE.check("pass", f"{kind.word}, {what}", **common)
    source = other("rounding of the format")
    shape = SHAPE.judge(worst, room, sentence, unit=reading.unit, limit_source=source, **common)
    light = map_light(asked, window, subject, kind, label) if label else ()
    obeys = bool(light) and all(check.state == "pass" for check in light)
    if subject.role is Role.SCAN and shape.state == "fail" and obeys:  # a measured surface is never exact
        shape = replace(shape, state="warn")
    return [found, shape, *light]


def described(window: Window, subject: Subject) -> Window:
    """Sheet that a file describes: the uniform equivalent of the one cell that its manifest entry names.

    Raises UnreadableFile: The sheet has no such cell.
    """
    if subject.cell is None:
        return window
    try:
        refuse_no_cell(window, subject.cell)
    except BadRequest as error:
        raise UnreadableFile(f"{subject.name}: {error}") from error
    return named_cell(window, subject.cell)


def _compared(window: Window, subject: Subject, reading: Reading) -> tuple[float, float, str, str]:
    """Misfit, and the name of its face ("" for the whole window)."""
    if reading.sheet is not None:
        return *reading.sheet(window, subject.path), ""
    best: tuple[float, float, str, str] | None = None
    refusal: ExportError | None = None
    for body, face, label in structured_faces(window):
        if reading.face and (f".{label}." in subject.name or not _labelled(window, subject.name)):
            try:
                one = reading.face(FaceFile(window, body, face, label, subject.path))
            except ExportError as error:
                refusal = error
                continue
            if best is None or one[0] < best[0]:
                best = (*one, label)
    if best is None:
        raise refusal or UnreadableFile(f"{subject.name}: no face of the design is of its kind")
    return best


def _labelled(window: Window, name: str) -> bool:
    """Whether a file's name contains the name of a face."""
    return any(f".{label}." in name for _, _, label in structured_faces(window))
