"""Judgement of files against a design: each file by its kind, its bytes, its shape and the light through
it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from clacad.base.types import Progress
from clacad.exporting.formats.table import CELL_TABLE
from clacad.exporting.roles import Role
from clacad.prescription.prescribe import prescribe
from clacad.sheet.window import Window
from clacad.storage.errors import UnreadableFile
from clacad.storage.reading import Overheard
from clacad.verification.check_kinds.file_light import FAITHFUL_DELTA, FAITHFUL_ETA, FAITHFUL_RMS
from clacad.verification.check_kinds.files import CLOSED, READABLE, SHAPE, VOLUME, unreadable
from clacad.verification.checks import Check
from clacad.verification.file_report import FileReport
from clacad.verification.files.copied_table import table_check
from clacad.verification.files.delivery import judge_other, no_optics, whole_delivery
from clacad.verification.files.find_files import Delivery, Subject, integrity, same_design
from clacad.verification.files.inspection import Inspection
from clacad.verification.files.map_file import judge_map, kind_of_map
from clacad.verification.files.mesh_file import judge_mesh
from clacad.verification.files.step_file import judge_solid, lies_elsewhere
from clacad.verification.files.unit_and_cells import MISREAD, held_bodies, unit_of, written_window
from clacad.verification.returned.judge_part import judge_placed
from clacad.verification.returned.registration import place
from clacad.verification.returned.turned_step_file import judge_turned

if TYPE_CHECKING:
    from clacad.design import Design


def judge_files(
    design: Design, delivery: Delivery, cells: tuple[int, int] | None, rays: int, progress: Progress
) -> tuple[list[Check], list[FileReport]]:
    """Judge every file of a delivery, and the delivery as a whole.

    Parameters
    ----------
    design : Design
    delivery : Delivery
    cells : (a, b) or None
        Cells the files hold, where no manifest gives them.
    rays : int
        Ray count of the main bundle.
    progress : callable
        (stage, done 0 … 1).
    """
    checks: list[Check] = []
    judged: list[FileReport] = []
    if delivery.manifest is not None:
        checks.append(same_design(design, delivery.manifest))
    window = written_window(design, delivery.manifest, cells)
    for subject in delivery.subjects:
        if subject.missing:
            checks.append(integrity(subject))
            judged.append(FileReport(subject, "missing"))
            continue
        asked = Inspection(design, subject.name, rays, progress, subject.role, subject.entry)
        more, one = _judge_hashed(asked, subject, window)
        checks += [integrity(one.subject), *more]
        judged.append(one)
    whole = prescribe(design) if window is None else window
    checks += whole_delivery(whole, [(one.subject, one.judged_as, one.present) for one in judged])
    return checks, judged


Judged = tuple[list[Check], FileReport]


def _judge_hashed(asked: Inspection, subject: Subject, window: Window | None) -> Judged:
    """Judge one file and hash it; a mesh is hashed while it is read, from the bytes that are judged."""
    if not subject.is_mesh:
        return _judge_one(asked, subject.hashed(), window)
    heard = Overheard(subject.path)
    checks, one = _judge_one(asked, subject, window, heard)
    return checks, replace(one, subject=one.subject.hashed(heard))


def _judge_one(
    asked: Inspection, subject: Subject, window: Window | None, heard: Overheard | None = None
) -> Judged:
    """Judge one file by its kind.

    window : with the cells of the file according to the caller; None where they are unknown
    heard : hash that is updated with the bytes of a mesh as they are read
    """
    whole = prescribe(asked.design) if window is None else window
    if subject.format == CELL_TABLE:
        return [table_check(asked.design, subject)], FileReport(
            subject, "the table of cells", role=Role.OTHER
        )
    if subject.entry and (reason := no_optics(whole, subject)) is not None:
        asked.progress(f"reading {subject.name}", 0.0)
        return judge_other(subject, reason), FileReport(subject, reason.note, role=Role.OTHER)
    if subject.is_solid:
        return _judge_solids(asked, subject, window, whole)
    if subject.is_mesh:
        return _judge_triangles(asked, subject, window, heard)
    kind = kind_of_map(subject)
    if kind is not None:
        asked.progress(f"reading {subject.name}", 0.0)
        return judge_map(asked, whole, subject, kind), FileReport(subject, "judged by the numbers in it")
    check = READABLE.not_run(
        f"{subject.path.suffix or 'this'} is no format that can be judged", subject=subject.name
    )
    return [check], FileReport(subject, "unknown format")


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
