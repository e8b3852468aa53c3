"""A STEP file that does not lie as the design does: meshed, registered and judged as any part that came back."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from clacad.export.errors import ExportError
from clacad.feasibility import feasibility
from clacad.prescription import prescribe
from clacad.sheet import Window
from clacad.verify.checks import Check, not_run
from clacad.verify.files import Subject
from clacad.verify.gather import Progress
from clacad.verify.meshlight import MeshEvidence
from clacad.verify.registration import Placed, place
from clacad.verify.returned import judge_returned
from clacad.verify.solidfile import judge_solid, lies_elsewhere

if TYPE_CHECKING:
    from clacad.design import Design

__all__ = ["judge_turned", "lies_elsewhere"]

FINE = 400.0
"""Facets are made this many times flatter than the flatter lens is high."""

SECONDS = 600.0
MILLIMETRE = 1e-3
KEPT = ("readable", "closed", "solids")
"""What the kernel says of a file wherever the part lies in it."""


def judge_turned(
    design: Design, window: Window | None, subject: Subject, checks: Sequence[Check], rays: int, progress: Progress
) -> tuple[list[Check], MeshEvidence | None, Placed | None]:  # fmt: skip
    """Find the part in a STEP file without a manifest, and judge it by triangles whose corners lie on its faces.

    checks : what `clacad.verify.solidfile.judge_solid` found; what depends on the pose is replaced.

    Raises
    ------
    CannotRegister
    """
    from clacad.export.readers import read_mesh
    from clacad.export.worker import Worker

    kept = [check for check in checks if check.id in KEPT]
    whole = prescribe(design) if window is None else window
    sag = min(lens.sag for lens in feasibility(whole).lenses) * design.unit_m / MILLIMETRE
    progress("meshing the solids", 0.0)
    with tempfile.TemporaryDirectory(prefix="clacad-") as folder:
        target = Path(folder) / "part.stl"
        try:
            with Worker() as worker:
                worker.run(
                    "clacad.export.step_facets:facets", str(subject.path), str(target), sag / FINE, timeout=SECONDS,
                    progress=progress,
                )  # fmt: skip
        except (ExportError, OSError) as error:
            why = f"its solids cannot be meshed: {error}"
            return [*kept, not_run("pose", why, where="file", subject=subject.name)], None, None
        mesh = replace(read_mesh(target), format="step", unit=MILLIMETRE)
        placed = place(design, subject, mesh, window)
        if (
            placed.pose.untouched and placed.whole
        ):  # the file's own frame after all: judged as exactly as it can be
            exact, _ = judge_solid(design, placed.window, subject.path, {}, progress, rays)
            return [*exact[:1], *placed.checks, *exact[1:]], None, placed
        found, evidence = judge_returned(design, placed, subject.name, rays, progress)
    return [*kept, *placed.checks, *(c for c in found if c.id not in KEPT)], evidence, placed
