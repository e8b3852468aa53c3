"""A STEP file that does not lie as the design does: meshed to find how it lies, then judged by light through its faces.

Triangles made here tell the pose, the shape cell by cell and what is damaged. They are no part of the file: light is sent
through the file's own faces, set down as the design lies.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.units import MILLIMETRE, millimetres
from clacad.prescription.prescribe import prescribe
from clacad.sheet.feasibility import feasibility
from clacad.sheet.window import Window
from clacad.storage.atomic import scratch_folder
from clacad.storage.errors import ExportError
from clacad.verification.checks import Check, State, not_run
from clacad.verification.files.find_files import Subject
from clacad.verification.files.inspection import Inspection
from clacad.verification.files.law_through_file import IDS
from clacad.verification.files.mesh_light import MeshEvidence
from clacad.verification.files.reading_worker import longest_wait, reading_worker
from clacad.verification.files.step_file import hole_words, judge_solid
from clacad.verification.limit_sources import other
from clacad.verification.returned.judge_part import judge_returned
from clacad.verification.returned.registration import Placed, place

if TYPE_CHECKING:
    from clacad.formats.mesh.file_mesh import FileMesh

FINE = 400.0
"""Facets are made this many times flatter than the flatter lens is high."""

COARSE = 1e-6
"""Facets need be no flatter than this part of the diagonal of the box round the part."""

SCALE = 1e-5
"""Relative error of size that registration leaves."""

THROUGH = (*IDS, "faithful_rms", "faithful_eta", "faithful_delta")
"""What light says: through the faces, not through triangles made here."""
KEPT = ("readable", "closed", "solids")
"""What OCC says of a file wherever the part lies in it."""


def judge_turned(
    asked: Inspection,
    window: Window | None,
    subject: Subject,
    checks: Sequence[Check],
    facts: Mapping[str, Any],
) -> tuple[list[Check], MeshEvidence | None, Placed | None]:
    """Find the part in a STEP file without a manifest, and judge it by triangles whose corners lie on its faces.

    Parameters
    ----------
    asked, subject
    window : with the cells that someone says the file holds, or None
    checks, facts : from `judge_solid`; of the checks those that depend on the pose are replaced

    Raises
    ------
    CannotRegister
    """
    kept = [check for check in checks if check.id in KEPT]
    whole = prescribe(asked.design) if window is None else window
    asked.progress("meshing the solids", 0.0)
    with scratch_folder() as folder:
        try:
            mesh = _meshed(asked, subject, folder / "part.stl", _deflection(whole, facts))
        except (ExportError, OSError) as error:
            return (
                [*kept, not_run("pose", f"its solids cannot be meshed: {error}", **asked.common)],
                None,
                None,
            )
        placed = place(asked.design, subject, mesh, window)
        if placed.pose.untouched and placed.whole:  # its own frame after all: judged as exactly as it can be
            exact, _ = judge_solid(replace(asked, stated={}), placed.window, subject.path)
            return [*exact[:1], *placed.checks, *exact[1:]], None, placed
        found, evidence = judge_returned(asked, placed)
        found = [_exact_scale(check) for check in found if check.id not in THROUGH]
        found += _through_faces(asked, placed, subject, Path(folder) / "part.brep")
    kept = [_with_holes(check, placed, facts) for check in kept]
    return [*kept, *placed.checks, *(c for c in found if c.id not in KEPT)], evidence, placed


def _meshed(asked: Inspection, subject: Subject, target: Path, deflection: float) -> FileMesh:
    """The solids of a file as triangles, at most `deflection` (mm) off its faces, by a worker that writes them to `target`."""
    from clacad.formats.mesh.readers import read_mesh

    with reading_worker(subject.path) as worker:
        worker.run(
            "clacad.formats.step.step_triangles:facets", str(subject.path), str(target), deflection, timeout=longest_wait(subject.path),
            progress=asked.progress,
        )  # fmt: skip
    return replace(read_mesh(target), format="step", unit=MILLIMETRE)


def _deflection(window: Window, facts: Mapping[str, Any]) -> float:
    """Largest distance (mm) of facets from a part's faces: fine beside the flatter lens, but not beside a part that is no
    such sheet at all (one in another unit, say), whose facets would fill the memory.
    """
    low, high = facts.get("box", ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    sag = min(lens.sag for lens in feasibility(window).lenses) * millimetres(window.unit)
    return max(sag / FINE, COARSE * float(np.linalg.norm(np.subtract(high, low))))


def _through_faces(asked: Inspection, placed: Placed, subject: Subject, target: Path) -> list[Check]:
    """Set the shape down as the design lies, and send light through its own faces."""
    pose = placed.pose
    try:
        with reading_worker(subject.path) as worker:
            worker.run(
                "clacad.formats.step.step_triangles:set_down", str(subject.path), str(target), pose.turn.tolist(),
                (pose.move * millimetres(asked.design.unit_m)).tolist(), timeout=longest_wait(subject.path), progress=asked.progress,
            )  # fmt: skip
    except (ExportError, OSError) as error:
        why = f"no light can be sent through its faces: {error}"
        return [not_run(name, why, **asked.common) for name in THROUGH]
    exact, _ = judge_solid(replace(asked, stated={}), placed.window, target)
    return [check for check in exact if check.id in THROUGH]


def _exact_scale(check: Check) -> Check:
    """A file of solids states its size exactly: nothing of it shrank in a mould."""
    if check.id != "scale" or not isinstance(check.value, float):
        return check
    state: State = "pass" if check.value <= SCALE else "fail"
    return replace(check, state=state, limit=SCALE, limit_source=other("a file of solids states its size"))


def _with_holes(check: Check, placed: Placed, facts: Mapping[str, Any]) -> Check:
    """Name the holes that OCC finds, in the design's frame."""
    if check.id != "closed":
        return check
    pose = placed.pose
    onto = None if pose.untouched else lambda at: pose.onto_design(at)
    words = hole_words(placed.window, facts.get("holes", ()), onto)
    return replace(check, sentence=f"{check.sentence}; {words}") if words else check
