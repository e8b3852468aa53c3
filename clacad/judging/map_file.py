"""Judge maps, point clouds, grids, tables and masks: every number in them is compared with the design's own
faces.

The format of a file is that of its manifest, else that of its suffix. A file without a manifest may hold any
of the design's structured faces: the best-fitting one is named.

Light through a map: the heights of one cell of a face as a bicubic surface, the other faces as designed.

Judge files that make the part and are not the part: inserts, tool points, dose maps, compensated files.

The file must be what the process turns into the part, and light must obey the law through the part that the
process makes of it. Where the file is something else, the check of shape names what: not compensated, not
turned, mirrored, scaled the wrong way.

Light: deviations of the file over one cell are fitted by Legendre polynomials to degree 8; the process makes
of that form the face through which rays are traced (`tracing.facets.made_surface`). Light that meets what a
nose or spot rounds there is lost. Steps are texture, which rays do not see. Facets of an insert are traced as
the part has them.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats
from clacad.checks.check import Check, other
from clacad.checks.file_kinds import READABLE, SHAPE, THROUGH_FILE, unreadable
from clacad.design.process import process_of
from clacad.exporting.formats import registry
from clacad.exporting.formats.format import FaceFile, FileKind, Reading
from clacad.exporting.formats.workshop import TOOL_POINTS, insert_file, is_insert, surface_misfit
from clacad.exporting.limits import refuse_no_cell
from clacad.exporting.roles import Role
from clacad.formats.maps.sag import structured_faces
from clacad.judging.delivery import Inspection, Subject
from clacad.judging.file_light import light_checks, measure_light, softened
from clacad.judging.mesh_light import lit_cells, seen_cell
from clacad.light.measure import Send
from clacad.optics.fit import legendre
from clacad.sheet.like_cell import named_cell
from clacad.sheet.representative_cells import central_cell
from clacad.sheet.shrunk import TURN, growth
from clacad.sheet.window import Face, Window
from clacad.storage.errors import BadRequest, ExportError, UnreadableFile
from clacad.tracing.facets.made_surface import MadeSurface, made_surface
from clacad.tracing.facets.telescopelet import (
    AnyFace,
    ExactFace,
    FacetBody,
    GraphFace,
    facet_face,
    on_land,
    sampled_face,
    trace_facets,
)
from clacad.tracing.worst_cell import SeenCell

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.exporting.compensation import Compensation
    from clacad.exporting.formats.format import FileKind
    from clacad.judging.delivery import Inspection, Subject


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
        through = made_bodies(
            one.like, like, cell, partial(sampled_face, one.like, like, samples=held.points, step=held.step)
        )
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
    window: Window, made: Face, cell: tuple[int, int], shape: Callable[[Floats], AnyFace]
) -> tuple[FacetBody, ...]:
    """Telescopelet of a cell: one face as `shape` makes it about its middle (3,); the others as designed."""
    bodies = []
    for body in window.bodies:
        faces: list[AnyFace] = []
        for face in (body.front, body.back):
            place = np.array([*_centre(window, face, cell), 0.0])
            faces.append(shape(place) if face is made else ExactFace(face, place, window))
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


DEGREE = 8
"""Highest total degree of the fitted form."""

CUT_FROM = (
    "facets of an insert are judged by their shape: where they are too coarse, cut from the STEP or the map"
)
"""Added to the checks of light through the facets of an insert."""

CLOSE = 20.0
"""Deviation, over the room, up to which a wrong file counts as explained."""


def judge_points(
    asked: Inspection, window: Window, subject: Subject, kind: FileKind, compensation: Compensation
) -> list[Check]:
    """Judge a file of one face by its points: readable, shape, and light through the part that it makes.

    window : The part, with the cells that were written.
    """
    common = asked.common
    try:
        number, of, points = _read(window, subject, kind, compensation)
        worst, room = _worst(of, points), kind.reading.room * min(of.window.lattice.pitch)
        fixed = kind.reading.face(of) if kind.reading.face is not None else None
    except DAMAGED as error:
        return [unreadable(error, **common), SHAPE.not_run("the file cannot be read", **common)]
    if fixed is not None and not is_insert(kind.word):
        worst, room = fixed[0] / of.scale, fixed[1] / of.scale
    what = f"{len(points):,} points of {of.label}" if fixed is None else fixed[2]
    sentence = f"{what}: up to {worst * of.scale:.3g} mm off what makes the part"
    if not worst <= room and (reason := _reason(of, points, compensation, CLOSE * room)):
        sentence += f"; {reason}"
    source = other("rounding of the format")
    shape = SHAPE.judge(worst * of.scale, room * of.scale, sentence, unit="mm", limit_source=source, **common)
    found = READABLE.check("pass", f"{kind.word}, {len(points):,} points of {of.label}", **common)
    try:
        facets = None if kind.reading.facets is None else kind.reading.facets(of)
        light = _light(asked, window, window.faces[number], of, (points, facets), compensation)
    except (ExportError, ValueError, ArithmeticError) as error:
        why = f"no light can be sent through the part that it makes: {error}"
        light = [one.not_run(why, **common) for one in THROUGH_FILE]
    return [found, shape, *light]


def _read(
    window: Window, subject: Subject, kind: FileKind, compensation: Compensation
) -> tuple[int, FaceFile, Floats]:
    """Number of the face of a file among those of the part, the file with its own window, and its points."""
    scaled = compensation.window(window)
    named = [one for one in structured_faces(scaled) if f".{one[2]}." in subject.name]
    best: tuple[float, int, FaceFile, Floats] | None = None
    for body, face, label in named or structured_faces(scaled):
        number = scaled.number_of(face)
        of = FaceFile(scaled, body, face, label, subject.path)
        if is_insert(kind.word) or kind.word == TOOL_POINTS and compensation.cut_as_insert:
            of = insert_file(of)
        assert kind.reading.points is not None
        points = kind.reading.points(of)
        off = _worst(of, points)
        if best is None or off < best[0]:
            best = (off, number, of, points)
    if best is None:
        raise ValueError("the design has no face with lenses")
    return best[1:]


def _worst(of: FaceFile, points: Floats) -> float:
    """Largest distance of points from their face; infinite where none lies on a cell."""
    off = surface_misfit(of, points)
    return float(np.nanmax(np.abs(off))) if np.isfinite(off).any() else np.inf


def _reason(of: FaceFile, points: Floats, compensation: Compensation, room: float) -> str:
    """What a wrong file is instead; "" where nothing that is tried explains it."""
    return next(
        (words for words, moved in _instead(of, points, compensation) if _worst(of, moved) <= room), ""
    )


def _instead(of: FaceFile, points: Floats, compensation: Compensation) -> Iterator[tuple[str, Floats]]:
    """Words for a mistake, and the points as they would be without it."""
    size = np.array(growth(compensation.shrinkage))
    apex = np.array([0.0, 0.0, of.face.vertex[2]])
    shrinks = "it is not compensated for the shrinkage of the process"
    wrong = "it is scaled by 1 - s where 1/(1 - s) is needed"
    turned = (
        "it is not turned: the cavity is turned by 180 degrees about x, so that it looks out of the steel"
    )
    mirrored = "it is mirrored in z and not turned by 180 degrees about x"
    upside = np.array([1.0, 1.0, -1.0])
    scales = [(1.0, ""), *([(size, shrinks), (size * size, wrong)] if (size != 1.0).any() else [])]
    for way, said in ((np.ones(3), ""), (np.diag(TURN), turned), (upside, mirrored)):
        for factor, more in scales:
            words = " and ".join(word for word in (said, more) if word)
            if words:
                yield words, (points - apex) * way * factor + apex


# -- light ---------------------------------------------------------------------------------------------


def _light(
    asked: Inspection,
    window: Window,
    face: Face,
    of: FaceFile,
    held: tuple[Floats, Floats | None],
    compensation: Compensation,
) -> list[Check]:
    """Checks of light through the part that the process makes of a file of one face.

    held : Points (m, 3) of the file, and its facets (t, 3, 3) where it has any.
    """
    one = lit_cell(asked, window)
    like = one.like.faces[window.number_of(face)]
    points, facets = held

    def checks(what: str, shape: Callable[[Floats], AnyFace]) -> list[Check]:
        through = made_bodies(one.like, like, one.index, shape)
        what = f"{what} ({of.label}; the rest as designed)"
        return light_of_cell(asked, one, lambda lit: trace_facets(through, one.placed(lit).rays), what)

    insert = of.window.bodies[0].name == of.label  # the steel is named after its face
    made = _made(asked.design, one.like, like, compensation, insert)
    if facets is None:
        off = replace(
            made, off=_off(of, points, one.index, insert and like.side < 0, -1.0 if insert else -like.side)
        )

        def form(place: Floats) -> AnyFace:
            return GraphFace(like, place, one.like, off, off.rounded, (1.0, 1.0))

        return checks("form of the part that it makes, clear of roundings", form)
    local = _made_facets(like, of, facets, one.index, compensation)

    def as_facets(place: Floats) -> AnyFace:
        there = local + place
        aside = on_land(one.like, like, there) | made.rounded(*local[..., :2].mean(axis=1).T)
        return facet_face(there, place + [0.0, 0.0, like.vertex[2]], aside)

    found = checks("facets of the part that it makes", as_facets)
    return [replace(softened(check), sentence=f"{check.sentence}; {CUT_FROM}") for check in found]


def _made_facets(
    face: Face, of: FaceFile, facets: Floats, cell: tuple[int, int], compensation: Compensation
) -> Floats:
    """Facets (t, 3, 3) of the part over a cell, cell frame, that those of an insert mould."""
    turned, grow = face.side < 0, np.array(growth(compensation.shrinkage))
    middle, lattice = _cell_of_file(of, cell, turned), of.window.lattice_of(of.face.array or 0)
    index, _, _ = of.window.locate(of.face.array or 0, middle[:1], middle[1:])
    local = facets - np.array([*middle, of.window.in_cell(of.face, index[0]).vertex[2]])
    local = local[(lattice.past_borders(*local[..., :2].mean(axis=1).T) <= 0.0).all(axis=0)]
    x, y, height = np.moveaxis(local, 2, 0)
    half = np.abs(lattice.tile()).max(axis=0)
    sunk = compensation.sink * (
        1.0 - (1.0 - (x / half[0]) ** 2) * (1.0 - (y / half[1]) ** 2)
    )  # from the apex
    z = face.vertex[2] - face.side * (sunk - height) / grow[2]
    points = np.stack([x / grow[0], (-y if turned else y) / grow[1], z], axis=-1)
    return points[:, ::-1]  # the part is where the steel is not


def _made(
    design: Design, window: Window, face: Face, compensation: Compensation, insert: bool = False
) -> MadeSurface:
    """The face that the process makes of a compensated file, or of an insert; `window`: of the part, uniform.

    What a dose makes of depths is in its own calibration.
    """
    process = replace(process_of(design), gamma=1.0, curve=None)
    process = replace(process, name="moulding") if insert else process
    scaled = compensation.plain.window(window)  # forms of a correction make the process that of the model
    return made_surface(scaled, scaled.faces[window.number_of(face)], process, None)


def _off(
    of: FaceFile, points: Floats, cell: tuple[int, int], turned: bool, way: float
) -> Callable[[Floats, Floats], Floats]:
    """Outward deviation of the form of a file over a cell, over places of the part before it shrinks."""
    fit = _form(of, points, _cell_of_file(of, cell, turned))
    return lambda x, y: way * fit(x, -y if turned else y)


def _cell_of_file(of: FaceFile, cell: tuple[int, int], turned: bool) -> Floats:
    """Middle (2,) of a cell in the file; of a turned one the cell on the other side of the x axis."""
    middle = of.window.centres(of.face.array or 0, np.array(cell, dtype=np.int64))
    if not turned:
        return middle
    shift = np.array(of.window.placements[of.face.array or 0].shift)
    return np.asarray((middle - shift) * [1.0, -1.0] + shift)


def _form(of: FaceFile, points: Floats, middle: Floats) -> Form:
    """Deviation of a file from its face over a cell, as Legendre polynomials.

    Raises ValueError: Too few points lie over the cell.
    """
    half = np.abs(of.window.lattice_of(of.face.array or 0).tile()).max(axis=0)
    local = (points[:, :2] - middle) / half
    off = surface_misfit(of, points)
    inside = (np.abs(local) <= 1.0 + 1e-9).all(axis=1) & np.isfinite(off)
    if inside.sum() < 24:
        raise ValueError(f"{inside.sum()} points lie over a cell; 24 and more give a form")
    degree = min(DEGREE, int(np.sqrt(inside.sum() / 2.0)) - 1)
    base = legendre(local[inside, 0], local[inside, 1], (degree + 1) * (degree + 2) // 2)
    return Form(half, np.linalg.lstsq(base, off[inside], rcond=None)[0])


@dataclass(frozen=True, eq=False)
class Form:
    """A form over a cell: coefficients (k,) of Legendre polynomials of u and v over half the cell (2,)."""

    half: Floats
    weights: Floats

    def __call__(self, u: Floats, v: Floats) -> Floats:
        """Height (n,) over places of the cell."""
        return np.asarray(legendre(u / self.half[0], v / self.half[1], len(self.weights)) @ self.weights)


# -- files of the whole part ---------------------------------------------------------------------------


def judge_scaled(
    asked: Inspection, window: Window, compensation: Compensation, checks: Sequence[Check]
) -> list[Check]:
    """Checks of a compensated file of the part, from those of the file as it is.

    A part that is the file at another size has the same light. Of any other the light is that through the
    faces that the process makes of the file's, where the shape of the file is right.

    checks : Against the sheet as files hold it.
    """
    dark = [check for check in checks if check.where != "file" or check.kind not in THROUGH_FILE]
    process = process_of(asked.design)
    if compensation.uniform and not (process.nose or process.spot):
        return list(checks)
    shape = SHAPE.first(checks)
    if shape is None or shape.state != "pass":
        why = "the file is not what the process makes the part of"
        return [*dark, *(one.not_run(why, **asked.common) for one in THROUGH_FILE)]
    one = lit_cell(asked, window)
    what = "faces as the process makes them of it"

    def as_made(face: Face) -> AnyFace:
        place = np.array([*_centre(one.like, face, one.index), 0.0])
        if face.array is None:
            return ExactFace(face, place, one.like)
        made = _made(asked.design, one.like, face, compensation)
        return GraphFace(face, place, one.like, made, made.rounded, (1.0, 1.0))

    try:
        through = tuple(FacetBody(as_made(body.front), as_made(body.back), body) for body in one.like.bodies)
    except ExportError as error:
        why = f"no light can be sent through the part that it makes: {error}"
        return [*dark, *(kind.not_run(why, **asked.common) for kind in THROUGH_FILE)]
    return [*dark, *light_of_cell(asked, one, lambda lit: trace_facets(through, one.placed(lit).rays), what)]


def named_uncompensated(
    checks: Sequence[Check], bare: Sequence[Check], compensation: Compensation
) -> list[Check]:
    """The checks, of which that of shape names a file that is the part itself.

    bare : Checks of the file against the part.
    """
    shape = SHAPE.first(bare)
    if shape is None or shape.state != "pass":
        return list(checks)
    shrinkage = ", ".join(f"{100 * s:g}" for s in compensation.shrinkage)
    words = f"it is the part itself, not compensated for the process ({shrinkage} % of shrinkage)"
    return [
        replace(check, sentence=f"{check.sentence}; {words}") if check.kind is SHAPE else check
        for check in checks
    ]
