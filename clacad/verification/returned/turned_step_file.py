"""A STEP file in another pose than the design: meshed to find its pose, then judged by light through its
faces.

The triangles give the pose, the shape cell by cell, and the damage. They are not part of the file: light is
traced
through the file's own faces, in the design's frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.units import MILLIMETRE, millimetres
from clacad.exporting.formats.step import WORD as STEP
from clacad.exporting.reading_worker import longest_wait, reading_worker
from clacad.prescription.prescribe import prescribe
from clacad.sheet.feasibility import feasibility
from clacad.sheet.window import Window
from clacad.storage.atomic import scratch_folder
from clacad.storage.errors import ExportError
from clacad.verification.check_kinds.file_light import (
    FAITHFUL_DELTA,
    FAITHFUL_ETA,
    FAITHFUL_RMS,
    THROUGH_FILE,
)
from clacad.verification.check_kinds.files import CLOSED, POSE, READABLE, SCALE, SOLIDS
from clacad.verification.checks import Check, State
from clacad.verification.files.find_files import Subject
from clacad.verification.files.inspection import Inspection
from clacad.verification.files.mesh_light import MeshEvidence
from clacad.verification.files.step_file import hole_words, judge_solid
from clacad.verification.limit_sources import other
from clacad.verification.returned.judge_part import judge_returned
from clacad.verification.returned.registration import Placed, place

if TYPE_CHECKING:
    from clacad.formats.mesh.file_mesh import FileMesh

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

    Parameters
    ----------
    `asked`, subject
    window : with the cells that the file holds according to the caller, or None
    checks, facts : from `judge_solid`; of the checks those that depend on the pose are replaced

    Raises
    ------
    CannotRegister
    """
    kept = [check for check in checks if check.kind in KEPT]
    whole = prescribe(asked.design) if window is None else window
    asked.progress("meshing the solids", 0.0)
    with scratch_folder() as folder:
        try:
            mesh = _meshed(asked, subject, folder / "part.stl", _deflection(whole, facts))
        except (ExportError, OSError) as error:
            return (
                [*kept, POSE.not_run(f"its solids cannot be meshed: {error}", **asked.common)],
                None,
                None,
            )
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
    """Triangles of a file's solids, at most `deflection` (mm) off its faces, written by a worker to
    `target`.
    """
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
