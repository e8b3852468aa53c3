"""The whole verification of a design, and of the files made from it."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.export.errors import UnreadableFile
from clacad.feasibility import Feasibility, describe, feasibility
from clacad.prescription import prescribe
from clacad.sheet import Window
from clacad.trace import trace
from clacad.verify import checks as judging
from clacad.verify.checks import Check, not_run, plain
from clacad.verify.convergence import Convergence, converge, convergence_check
from clacad.verify.curves import Meridian, meridians
from clacad.verify.files import (
    Delivery,
    Subject,
    find_files,
    held_bodies,
    integrity,
    same_design,
    unit_of,
    written_window,
)
from clacad.verify.gather import Progress
from clacad.verify.geometry import design_checks
from clacad.verify.mapfile import format_of, judge_map
from clacad.verify.meshfile import judge_mesh
from clacad.verify.meshlight import MeshEvidence
from clacad.verify.optics import Optics, confocality_check, law_checks, measure, throughput_check
from clacad.verify.registration import place
from clacad.verify.returned import judge_placed
from clacad.verify.solidfile import judge_solid
from clacad.verify.turnedsolid import judge_turned, lies_elsewhere

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.verify.evidence import Evidence

FORMAT = 1


@dataclass(frozen=True, eq=False)
class FileReport:
    """One file that was judged: what it is, and the evidence gathered on it.

    window : Window or None
        With the cells of the file; None where they are the design's.
    present : names of the bodies in it, or None for all
    """

    subject: Subject
    note: str = ""
    mesh: MeshEvidence | None = None
    solid: Mapping[str, Any] | None = None
    window: Window | None = None
    present: tuple[str, ...] | None = None


@dataclass(frozen=True, eq=False)
class Report:
    """What a verification found.

    Attributes
    ----------
    design : Design
    window : Window
    facts : Feasibility
    checks : tuple of Check
        In the order of the report.
    optics : Optics
        Through the exact surfaces.
    curves : (Meridian, Meridian)
        Transfer, transmission and residual along lens x and lens y.
    convergence : Convergence or None
    files : tuple of FileReport
    versions : mapping
    evidence : Evidence or None
        What the page shows beside its checks; None until `with_evidence`.
    """

    design: Design
    window: Window
    facts: Feasibility
    checks: tuple[Check, ...]
    optics: Optics
    curves: tuple[Meridian, Meridian]
    convergence: Convergence | None = None
    files: tuple[FileReport, ...] = ()
    versions: Mapping[str, str] = field(default_factory=dict)
    evidence: Evidence | None = None

    def with_evidence(self, progress: Progress | None = None) -> Report:
        """The same report with what its page shows beside the checks; itself where it has that."""
        if self.evidence is not None:
            return self
        from clacad.verify.evidence import gather_evidence

        return replace(self, evidence=gather_evidence(self, progress if progress is not None else _silent))

    @property
    def passed(self) -> bool:
        """Whether nothing failed and everything required ran."""
        return judging.passed(self.checks)

    @property
    def exit_status(self) -> int:
        """0 if passed, else 1."""
        return 0 if self.passed else 1

    def counts(self) -> dict[str, int]:
        """Number of checks in each state."""
        return {
            state: sum(c.state == state for c in self.checks) for state in ("pass", "fail", "warn", "not run")
        }

    def verdict(self) -> str:
        """One sentence for the head of the page and the last line of the command."""
        counts = self.counts()
        failed = [c for c in self.checks if c.state == "fail"]
        missing = [c for c in self.checks if c.state == "not run" and c.required]
        if self.passed:
            warned = f", {counts['warn']} with a warning" if counts["warn"] else ""
            return f"passed: {counts['pass'] + counts['warn']} checks{warned}"
        parts = []
        if failed:
            parts.append("failed: " + ", ".join(dict.fromkeys(c.id for c in failed)))
        if missing:
            parts.append("did not run: " + ", ".join(dict.fromkeys(c.id for c in missing)))
        return "; ".join(parts)

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready content: no times, no host, no paths."""
        return {
            "format": FORMAT,
            "passed": self.passed,
            "verdict": self.verdict(),
            "counts": self.counts(),
            "design": {"name": self.design.name, "sha256": self.design.sha256, "toml": self.design.toml},
            "window": {
                "form": self.window.form, "unit_m": self.window.unit, "count": list(self.window.lattice.count),
                "recipe": plain(dict(self.window.recipe)), "residual": plain(dict(self.window.residual)),
            },
            "derived": [list(row) for row in describe(self.window, self.facts)],
            "checks": [check.to_dict() for check in self.checks],
            "field": [_field_row(p) for p in self.optics.points],
            "transfer": [_curve_row(c) for c in self.curves],
            "files": [_file_row(f) for f in self.files],
            "notes": list(self.design.notes),
            "versions": dict(self.versions),
            **({} if self.evidence is None else self.evidence.to_dict()),
        }  # fmt: skip

    def to_json(self) -> str:
        """Same numbers as the page, keys sorted: the same bytes for the same design, files and versions."""
        return (
            json.dumps(self.to_dict(), indent=1, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n"
        )


def _field_row(point: Any) -> dict[str, Any]:
    row = {
        "direction": point.direction, "expected": point.expected, "bias": point.bias, "spread": point.spread,
        "rms": point.rms, "worst": point.worst, "share": point.share, "closed_form": point.closed_form,
        "counts": point.counts,
    }  # fmt: skip
    return dict(plain(row))


def _curve_row(curve: Meridian) -> dict[str, Any]:
    row = {
        "slope": curve.slope, "law": curve.law, "mean": curve.mean, "spread": curve.spread, "alive": curve.alive,
        "closed_form": curve.closed_form, "ghost": curve.ghost,
    }  # fmt: skip
    return dict(plain(row))


def _file_row(found: FileReport) -> dict[str, Any]:
    subject = found.subject
    row: dict[str, Any] = {
        "name": subject.name, "format": subject.format, "bytes": subject.bytes, "sha256": subject.sha256,
        "note": found.note, "stated": dict(subject.entry),
    }  # fmt: skip
    if found.mesh is not None:
        row["triangles"] = found.mesh.measure.facets
    if found.solid:
        row["solids"] = found.solid.get("kernel_solids", found.solid.get("solids"))
    return dict(plain(row))


def verify(
    design: Design,
    files: str | os.PathLike[str] | None = None,
    cells: tuple[int, int] | None = None,
    rays: int = 65536,
    progress: Progress | None = None,
) -> Report:
    """Verify a design, and the files that were made from it.

    Parameters
    ----------
    design : Design
        What is asked, and the limits.
    files : path or None
        A folder with a manifest, or one file: a mesh (STL, 3MF, PLY, GLB, OBJ), a solid (STEP, BREP), or a map, points,
        a table, a mask or layers as an export names them; None judges the design alone.
    cells : (a, b) or None
        Cells the files hold, where no manifest says.
    rays : int
        Rays of the main bundle.
    progress : callable or None
        Called with a stage's name and the part done, 0 … 1.

    Returns
    -------
    Report

    Raises
    ------
    DesignError
        The design cannot be built.
    FileNotFoundError
        `files` names nothing that can be judged.
    CannotRegister
        A file's unit or cells cannot be told.
    """
    report = progress if progress is not None else _silent
    report("building the window", 0.0)
    window = prescribe(design)
    facts = feasibility(window)
    report("tracing the exact surfaces", 0.0)
    found, optics = judge_window(design, window, facts, rays)
    report("tracing the field of view", 0.0)
    curves = meridians(window, lambda lit: trace(window, lit.rays))
    convergence = None
    judged: list[FileReport] = []
    if files is not None:
        delivery = find_files(Path(files))
        file_checks, judged = _judge_files(design, delivery, cells, rays, report)
        found = [*found, *file_checks]
        if any(f.subject.is_mesh for f in judged):
            convergence, check = _convergence(design, window, report)
            found = [*found, check]
    report("done", 1.0)
    return Report(
        design,
        window,
        facts,
        judging.accepted(found, design),
        optics,
        curves,
        convergence,
        tuple(judged),
        versions(),
    )


def judge_window(design: Design, window: Window, facts: Feasibility, rays: int) -> tuple[list[Check], Optics]:
    """Judge a window by what its design asks: light through the exact surfaces, and the design rules.

    The window need not come from that design; what it does is measured, not believed.
    """
    optics = measure(design, window, lambda lit: trace(window, lit.rays), rays)
    found = law_checks(design, optics)
    found += [throughput_check(design, window, optics), confocality_check(design, window)]
    return [*found, *design_checks(design, window, facts)], optics


def _silent(_stage: str, _done: float) -> None:
    return


def versions() -> dict[str, str]:
    """Versions the numbers depend on."""
    import numpy as np

    from clacad import __version__

    return {"clacad": __version__, "numpy": np.__version__}


def _convergence(design: Design, window: Window, progress: Progress) -> tuple[Convergence | None, Check]:
    try:
        found = converge(design, window, progress)
    except ValueError as error:  # too little light gets through one telescopelet to fit a law
        return None, convergence_check(None, str(error))
    return found, convergence_check(found)


def _judge_files(
    design: Design, delivery: Delivery, cells: tuple[int, int] | None, rays: int, progress: Progress
) -> tuple[list[Check], list[FileReport]]:
    checks: list[Check] = []
    judged: list[FileReport] = []
    if delivery.manifest is not None:
        checks.append(same_design(design, delivery.manifest))
    window = written_window(design, delivery.manifest, cells)
    for subject in delivery.subjects:
        checks.append(integrity(subject))
        if not subject.sha256:
            judged.append(FileReport(subject, "missing"))
            continue
        more, one = _judge_one(design, window, subject, rays, progress)
        checks += more
        judged.append(one)
    return checks, judged


def _judge_one(
    design: Design, window: Window | None, subject: Subject, rays: int, progress: Progress
) -> tuple[list[Check], FileReport]:
    whole = prescribe(design) if window is None else window
    if subject.entry and not {body.name for body in whole.bodies} >= set(subject.entry.get("bodies", ())):
        return [], FileReport(subject, "no part of the optics; judged by its bytes alone")
    if subject.is_solid:
        found, facts = judge_solid(design, whole, subject.path, subject.entry, progress, rays)
        if not subject.entry and lies_elsewhere(found):
            found, evidence, placed = judge_turned(design, window, subject, found, rays, progress, facts)
            if placed is not None:
                return found, FileReport(
                    subject, placed.note, evidence, facts, window=placed.window, present=placed.present
                )
        return found, FileReport(subject, solid=facts)
    if subject.is_mesh:
        return _judge_triangles(design, window, subject, rays, progress)
    format = format_of(subject)
    if format is not None:
        progress(f"reading {subject.name}", 0.0)
        return judge_map(whole, subject, format), FileReport(subject, "judged by the numbers in it")
    if subject.entry:
        return [], FileReport(subject, "judged by its bytes alone")
    check = not_run(
        "readable", f"{subject.path.suffix or 'this'} is no format that can be judged", subject=subject.name
    )
    return [check], FileReport(subject, "unknown format")


def _judge_triangles(
    design: Design, window: Window | None, subject: Subject, rays: int, progress: Progress
) -> tuple[list[Check], FileReport]:
    from clacad.export.readers import read_mesh

    common: dict[str, Any] = {"where": "file", "subject": subject.name}
    try:
        mesh = read_mesh(subject.path)
        note = ""
        metres = unit_of(subject, mesh) if subject.entry else None
        if window is not None and metres is not None:
            present = held_bodies(window, subject, 0.0)[0]
            found, evidence = judge_mesh(
                design,
                window,
                mesh,
                metres / design.unit_m,
                subject.name,
                subject.entry,
                rays,
                progress,
                present,
            )
        else:
            progress("finding where the part lies", 0.0)
            placed = place(design, subject, mesh, window)
            window, present, note = placed.window, placed.present, placed.note
            found, evidence = judge_placed(design, placed, subject.name, rays, progress)
    except UnreadableFile as error:
        failed = [Check("readable", "fail", f"it cannot be read: {error}", **common)]
        later = ("closed", "volume", "shape", "faithful_rms", "faithful_eta", "faithful_delta")
        return failed + [not_run(name, "the file cannot be read", **common) for name in later], FileReport(
            subject
        )
    missing = [body.name for body in window.bodies if body.name not in present]
    if missing:
        note = "; ".join(
            [
                *([note] if note else []),
                f"it holds {', '.join(present)}; {', '.join(missing)} taken from the design",
            ]
        )
    odd = "mm / 25.4" in note  # nobody's unit: millimetres that were taken for inches on the way
    note += ": it is 25.4 times as large as the design" if odd else ""
    readable = Check(
        "readable",
        "warn" if odd else "pass",
        f"{mesh.format}, {mesh.facet_count} facets" + (f"; {note}" if note else ""),
        **common,
    )
    return [readable, *found], FileReport(subject, note, evidence, window=window, present=present)
