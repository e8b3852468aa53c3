"""Judgement of files against a design: each file by its kind, its bytes, its shape and its light."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.types import Progress
from clacad.base.units import MILLIMETRE, millimetres
from clacad.checks.check import Check, State, other
from clacad.checks.file_kinds import (
    CLOSED,
    FAITHFUL_DELTA,
    FAITHFUL_ETA,
    FAITHFUL_RMS,
    POSE,
    READABLE,
    SCALE,
    SHAPE,
    SOLIDS,
    THROUGH_FILE,
    VOLUME,
    unreadable,
)
from clacad.exporting.formats.height_maps import CELL_TABLE
from clacad.exporting.formats.registry import kind_ending, kind_of, longest_wait, reading_worker
from clacad.exporting.formats.step import WORD as STEP
from clacad.exporting.formats.workshop import kind_named
from clacad.exporting.roles import Role
from clacad.judging.delivery import Delivery, Inspection, Subject, integrity, same_design, table_check
from clacad.judging.judge_part import judge_placed, judge_returned
from clacad.judging.map_file import judge_map, judge_points, judge_scaled, kind_of_map, named_uncompensated
from clacad.judging.mesh_file import judge_mesh
from clacad.judging.mesh_light import MeshEvidence
from clacad.judging.registration import Placed, place
from clacad.judging.step_file import hole_words, judge_solid, lies_elsewhere
from clacad.judging.unit_and_cells import MISREAD, held_bodies, unit_of, written_window
from clacad.judging.without_optics import judge_other, no_optics, whole_delivery
from clacad.prescription.prescribe import prescribe
from clacad.sheet.feasibility import feasibility
from clacad.sheet.window import Window
from clacad.storage.atomic import scratch_folder
from clacad.storage.errors import ExportError, UnreadableFile
from clacad.storage.reading import Overheard

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.exporting.formats.format import FileKind
    from clacad.formats.mesh.file_mesh import FileMesh


@dataclass(frozen=True, eq=False)
class FileReport:
    """A judged file with its identity and the evidence gathered on it.

    window : Window with the cells of the file; None where they are the design's.
    present : names of the bodies in it, or None for all
    role : Role as judged, where it differs from the declared one.
    """

    subject: Subject
    note: str = ""
    mesh: MeshEvidence | None = None
    solid: Mapping[str, Any] | None = None
    window: Window | None = None
    present: tuple[str, ...] | None = None
    role: Role | None = None

    @property
    def judged_as(self) -> Role:
        """Role under which the file was judged."""
        return self.subject.role if self.role is None else self.role


FINE = 400.0
"""Sag of the flatter lens over the deflection of the facets."""

COARSE = 1e-6
"""Least deflection of facets, over the diagonal of the part's bounding box."""

SIZE = 1e-5
"""Relative error of size after registration."""

THROUGH = (*THROUGH_FILE, FAITHFUL_RMS, FAITHFUL_ETA, FAITHFUL_DELTA)
"""Checks by light through the faces, not through the triangles."""
KEPT = (READABLE, CLOSED, SOLIDS)
"""Checks of OCC that do not depend on the pose of the part."""


def judge_turned(
    asked: Inspection,
    window: Window | None,
    subject: Subject,
    checks: Sequence[Check],
    facts: Mapping[str, Any],
) -> tuple[list[Check], MeshEvidence | None, Placed | None]:
    """Find the pose of a STEP file without a manifest, and judge it by triangles whose corners lie on its
    faces.

    `asked`, subject
    window : with the cells that the file holds according to the caller, or None
    checks, facts : from `judge_solid`; of the checks those that depend on the pose are replaced

    Raises CannotRegister.
    """
    kept = [check for check in checks if check.kind in KEPT]
    whole = prescribe(asked.design) if window is None else window
    asked.progress("meshing the solids", 0.0)
    with scratch_folder() as folder:
        try:
            mesh = _meshed(asked, subject, folder / "part.stl", _deflection(whole, facts))
        except (ExportError, OSError) as error:
            lost = POSE.not_run(f"its solids cannot be meshed: {error}", **asked.common)
            return [*kept, lost], None, None
        placed = place(asked.design, subject, mesh, window)
        if placed.pose.untouched and placed.whole:  # in its own frame: judged as exact faces
            exact, _ = judge_solid(replace(asked, stated={}), placed.window, subject.path)
            return [*exact[:1], *placed.checks, *exact[1:]], None, placed
        found, evidence = judge_returned(asked, placed)
        found = [_exact_scale(check) for check in found if check.kind not in THROUGH]
        found += _through_faces(asked, placed, subject, Path(folder) / "part.brep")
    kept = [_with_holes(check, placed, facts) for check in kept]
    return [*kept, *placed.checks, *(c for c in found if c.kind not in KEPT)], evidence, placed


def _meshed(asked: Inspection, subject: Subject, target: Path, deflection: float) -> FileMesh:
    """Triangles of a file's solids, at most `deflection` (mm) off its faces; a worker writes `target`."""
    from clacad.formats.mesh.readers import read_mesh

    with reading_worker(subject.path) as worker:
        worker.run(
            "clacad.formats.step.read_back:facets",
            str(subject.path),
            str(target),
            deflection,
            timeout=longest_wait(subject.path),
            progress=asked.progress,
        )
    return replace(read_mesh(target), format=STEP, unit=MILLIMETRE)


def _deflection(window: Window, facts: Mapping[str, Any]) -> float:
    """Largest distance (mm) of facets from a part's faces: a small part of the flatter lens's sag.

    A lower limit follows from the part's size: facets of a part in another unit could fill the memory.
    """
    low, high = facts.get("box", ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    sag = min(lens.sag for lens in feasibility(window).lenses) * millimetres(window.unit)
    return max(sag / FINE, COARSE * float(np.linalg.norm(np.subtract(high, low))))


def _through_faces(asked: Inspection, placed: Placed, subject: Subject, target: Path) -> list[Check]:
    """Place the shape in the design's frame, and trace light through its own faces."""
    pose = placed.pose
    try:
        with reading_worker(subject.path) as worker:
            worker.run(
                "clacad.formats.step.read_back:set_down",
                str(subject.path),
                str(target),
                pose.turn.tolist(),
                (pose.move * millimetres(asked.design.unit_m)).tolist(),
                timeout=longest_wait(subject.path),
                progress=asked.progress,
            )
    except (ExportError, OSError) as error:
        why = f"no light can be sent through its faces: {error}"
        return [kind.not_run(why, **asked.common) for kind in THROUGH]
    exact, _ = judge_solid(replace(asked, stated={}), placed.window, target)
    return [check for check in exact if check.kind in THROUGH]


def _exact_scale(check: Check) -> Check:
    """Mark the scale check of a file of solids, which states its size exactly: no mould shrinkage."""
    if check.kind is not SCALE or not isinstance(check.value, float):
        return check
    state: State = "pass" if check.value <= SIZE else "fail"
    return replace(check, state=state, limit=SIZE, limit_source=other("a file of solids states its size"))


def _with_holes(check: Check, placed: Placed, facts: Mapping[str, Any]) -> Check:
    """Name the holes that OCC finds, in the design's frame."""
    if check.kind is not CLOSED:
        return check
    pose = placed.pose
    onto = None if pose.untouched else lambda at: pose.onto_design(at)
    words = hole_words(placed.window, facts.get("holes", ()), onto)
    return replace(check, sentence=f"{check.sentence}; {words}") if words else check


def judge_files(
    design: Design,
    whole: Window,
    delivery: Delivery,
    cells: tuple[int, int] | None,
    rays: int,
    progress: Progress,
) -> tuple[list[Check], list[FileReport]]:
    """Judge every file of a delivery, and the delivery as a whole.

    whole : Of the design.
    cells : (a, b) or None. Cells the files hold, where no manifest gives them.
    rays : Ray count of the main bundle.
    progress : (stage, done 0 … 1).
    """
    checks: list[Check] = []
    judged: list[FileReport] = []
    if delivery.manifest is not None:
        checks.append(same_design(design, delivery.manifest))
    window = written_window(design, whole, delivery.manifest, cells)
    whole = whole if window is None else window
    for subject in delivery.subjects:
        if subject.missing:
            checks.append(integrity(subject))
            judged.append(FileReport(subject, "missing"))
            continue
        asked = Inspection(design, subject.name, rays, progress, subject.role, subject.entry)
        more, one = _judge_hashed(asked, subject, window, whole)
        checks += [integrity(one.subject), *more]
        judged.append(one)
    checks += whole_delivery(whole, [(one.subject, one.judged_as, one.present) for one in judged])
    return checks, judged


Judged = tuple[list[Check], FileReport]


def _judge_hashed(asked: Inspection, subject: Subject, window: Window | None, whole: Window) -> Judged:
    """Judge one file and hash it; a mesh is hashed while it is read, from the bytes that are judged."""
    if not subject.is_mesh:
        return _judge_one(asked, subject.hashed(), window, whole)
    heard = Overheard(subject.path)
    checks, one = _judge_one(asked, subject, window, whole, heard)
    return checks, replace(one, subject=one.subject.hashed(heard))


def _judge_one(
    asked: Inspection, subject: Subject, window: Window | None, whole: Window, heard: Overheard | None = None
) -> Judged:
    """Judge one file by its kind.

    window : with the cells of the file according to the caller; None where they are unknown
    whole : the same, or that of the design where they are unknown
    heard : hash that is updated with the bytes of a mesh as they are read
    """
    if subject.format == CELL_TABLE:
        return [table_check(asked.design, subject)], FileReport(
            subject, "the table of cells", role=Role.OTHER
        )
    if subject.role is Role.TOOLING and (kind := _tooling_kind(subject)) is not None:
        return _judge_tooling(asked, subject, kind, window, whole)
    if subject.entry and (reason := no_optics(whole, subject)) is not None:
        asked.progress(f"reading {subject.name}", 0.0)
        return judge_other(asked, whole, subject, reason), FileReport(subject, reason.note, role=Role.OTHER)
    if subject.is_solid:
        return _judge_solids(asked, subject, window, whole)
    if subject.is_mesh:
        return _judge_triangles(asked, subject, window, heard)
    kind = kind_of_map(subject)
    if kind is not None:
        asked.progress(f"reading {subject.name}", 0.0)
        note, part = "judged by the numbers in it", subject.cell is not None and not whole.uniform
        one = FileReport(subject, f"{note}, of one cell" if part else note, present=() if part else None)
        if subject.role is Role.TOOLING:  # tables next to tooling: no light goes through them
            from clacad.exporting.compensation import compensation_of

            one, whole = replace(one, role=Role.OTHER), compensation_of(asked.design).window(whole)
        return judge_map(asked, whole, subject, kind), one
    check = READABLE.not_run(
        f"{subject.path.suffix or 'this'} is no format that can be judged", subject=subject.name
    )
    return [check], FileReport(subject, "unknown format")


def _tooling_kind(subject: Subject) -> FileKind | None:
    """Kind of a file that makes the part, by its manifest or its name; None for one without a face in it."""
    word = kind_named(subject.name) if not subject.entry else ""
    kind = kind_of(word) if word else subject.kind or kind_ending(subject.name)
    if kind is None or kind.family == "other":
        return None
    held = kind.family != "map" or kind.reading.points is not None or kind.reading.samples is not None
    return kind if held else None


def _judge_tooling(
    asked: Inspection, subject: Subject, kind: FileKind, window: Window | None, whole: Window
) -> Judged:
    """Judge a file that makes the part: as the file that it should be, and by the part that it makes."""
    from clacad.exporting.compensation import compensation_of

    compensation, note = compensation_of(asked.design), "tooling: judged by the part that it makes"
    if kind.reading.points is not None:
        asked.progress(f"reading {subject.name}", 0.0)
        found = judge_points(asked, whole, subject, kind, compensation)
        return found, FileReport(subject, note, role=Role.TOOLING)
    plain, master = replace(subject, role=Role.MASTER), replace(asked, role=Role.MASTER)
    scaled = compensation.window(whole)
    checks, one = _judge_one(master, plain, scaled, scaled)
    more = judge_scaled(asked, whole, compensation, checks)
    if any(check.kind is SHAPE and check.state == "fail" for check in more):
        bare, _ = _judge_one(master, plain, whole, whole)
        more = named_uncompensated(more, bare, compensation)
    return more, replace(one, subject=subject, note=note, role=Role.TOOLING, mesh=None)


def _judge_solids(asked: Inspection, subject: Subject, window: Window | None, whole: Window) -> Judged:
    """Judge a STEP or BREP file, in any pose of its solids."""
    found, facts = judge_solid(asked, whole, subject.path)
    stands = facts.get("placement", {"lenses": None})
    if not subject.entry and (lies_elsewhere(found) or stands["lenses"] == 0):
        found, evidence, placed = judge_turned(asked, window, subject, found, facts)
        if placed is not None:
            return found, FileReport(
                subject, placed.note, evidence, facts, window=placed.window, present=placed.present
            )
    held = tuple(name for name in stands.get("bodies", ()) if not subject.entry)
    return found, FileReport(subject, solid=facts, present=held or None)


def _judge_triangles(
    asked: Inspection, subject: Subject, window: Window | None, heard: Overheard | None
) -> Judged:
    """Judge a mesh file in the pose of its manifest, or in the registered pose."""
    from clacad.formats.mesh.readers import read_mesh

    note, odd = "", False
    asked.progress(f"reading {subject.name}", 0.0)
    try:
        mesh = read_mesh(subject.path, heard)
        metres = unit_of(subject, mesh) if subject.entry else None
        if window is not None and metres is not None:
            present = held_bodies(window, subject, 0.0)[0]
            found, evidence = judge_mesh(asked, window, mesh, metres / asked.design.unit_m, present)
        else:
            asked.progress("finding where the part lies", 0.0)
            placed = place(asked.design, subject, mesh, window)
            window, present, note = placed.window, placed.present, placed.note
            odd = placed.pose.unit == MISREAD
            found, evidence = judge_placed(asked, placed)
    except UnreadableFile as error:
        return _unreadable(asked, error), FileReport(subject)
    missing = [body.name for body in window.bodies if body.name not in present]
    if missing:
        held = f"it holds {', '.join(present)}; {', '.join(missing)} taken from the design"
        note = f"{note}; {held}" if note else held
    note += ": it is 25.4 times as large as the design" if odd else ""
    sentence = f"{mesh.format}, {mesh.facet_count} facets" + (f"; {note}" if note else "")
    readable = READABLE.check("warn" if odd else "pass", sentence, **asked.common)
    role = Role(evidence.facts.get("role", asked.role))
    return [readable, *found], FileReport(subject, note, evidence, window=window, present=present, role=role)


def _unreadable(asked: Inspection, error: UnreadableFile) -> list[Check]:
    """Checks of a mesh file that cannot be read."""
    later = (CLOSED, VOLUME, SHAPE, FAITHFUL_RMS, FAITHFUL_ETA, FAITHFUL_DELTA)
    return [
        unreadable(error, **asked.common),
        *(kind.not_run("the file cannot be read", **asked.common) for kind in later),
    ]
