"""The whole verification of a design, and of the files made from it."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.base.text import plain
from clacad.base.types import Progress
from clacad.exporting.roles import Role
from clacad.prescription.prescribe import prescribe
from clacad.sheet.feasibility import Feasibility, describe, feasibility
from clacad.sheet.window import Window
from clacad.storage.errors import UnreadableFile
from clacad.tracing.trace import trace
from clacad.verification import checks as judging
from clacad.verification.checks import Check, not_run
from clacad.verification.design.design_rules import design_checks
from clacad.verification.files.delivery import judge_other, no_optics, whole_delivery
from clacad.verification.files.find_files import (
    Delivery,
    Subject,
    declared_roles,
    find_files,
    held_bodies,
    integrity,
    same_design,
    unit_of,
    written_window,
)
from clacad.verification.files.map_file import format_of, judge_map
from clacad.verification.files.mesh_file import judge_mesh
from clacad.verification.files.mesh_light import MeshEvidence
from clacad.verification.files.step_file import judge_solid
from clacad.verification.light.direction_curves import Meridian, meridians
from clacad.verification.light.facet_convergence import Convergence, converge, convergence_check
from clacad.verification.light.law_checks import (
    Optics,
    confocality_check,
    law_checks,
    measure,
    throughput_check,
)
from clacad.verification.returned.judge_part import judge_placed
from clacad.verification.returned.registration import place
from clacad.verification.returned.turned_step_file import judge_turned, lies_elsewhere
from clacad.verification.verdict import GOOD, FileVerdict, Word, file_verdict, settled, word_of, wrong

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.verification.evidence import Evidence

FORMAT = 1
NAMED = 4
"""Files that a verdict names; of more it gives the number."""


@dataclass(frozen=True, eq=False)
class FileReport:
    """One file that was judged: what it is, and the evidence gathered on it.

    window : Window or None
        With the cells of the file; None where they are the design's.
    present : names of the bodies in it, or None for all
    role : Role or None
        As it was judged, where that is not what it was handed in as.
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
        """What it was judged as."""
        return self.subject.role if self.role is None else self.role


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
    delivered : bool
        Whether files were to be judged; a delivery without any passes nothing.
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
    delivered: bool = False

    def with_evidence(self, progress: Progress | None = None) -> Report:
        """The same report with what its page shows beside the checks; itself where it has that."""
        if self.evidence is not None:
            return self
        from clacad.verification.evidence import gather_evidence

        return replace(self, evidence=gather_evidence(self, progress if progress is not None else _silent))

    @cached_property
    def verdicts(self) -> tuple[FileVerdict, ...]:
        """What is said of each file, in the order they were judged."""
        return tuple(_verdict_of(one, self.checks) for one in self.files)

    @cached_property
    def word(self) -> Word:
        """Passed as optical master, shape only, failed, not judged; of a design alone: passed or failed."""
        if self.delivered:
            return word_of(self.verdicts, self.checks)
        return "passed" if judging.passed(self.checks) else "failed"

    @property
    def passed(self) -> bool:
        """Whether the exit status is 0: nothing failed, everything required ran, and every file is what it is said to be.

        A delivery of declared previews alone passes so too, and its word is still *shape only*.
        """
        if self.word == "shape only":
            return all(settled(one) for one in self.verdicts if one.word == "shape only")
        return self.word in GOOD

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
        checks = f"{counts['pass'] + counts['warn']} checks" + (
            f", {counts['warn']} with a warning" if counts["warn"] else ""
        )
        if self.word == "failed":
            return self._failed()
        told = [one for one in self.verdicts if one.word == self.word and one.role is not Role.OTHER]
        if self.word == "shape only":
            return f"shape only: {told[0].name} {told[0].sentence}{self._remedy(told[0])}"
        if self.word == "not judged":
            lacking = wrong(c for c in self.checks if c.id == "delivery")
            return "not judged: " + (
                lacking[0].sentence if lacking else "none of the files carries light of the law"
            )
        if self.word == "passed":
            return f"passed: {checks}"
        shapes = [one.name for one in self.verdicts if one.word == "shape only"]
        rest = f"; shape only, as declared: {_listed(shapes)}" if shapes else ""
        return f"{self.word}: {_listed([one.name for one in told])} ({checks}){rest}"

    def _failed(self) -> str:
        failed = [c for c in self.checks if c.state == "fail"]
        missing = [c for c in self.checks if c.state == "not run" and c.required]
        parts = []
        if failed:
            parts.append("failed: " + ", ".join(dict.fromkeys(c.id for c in failed)))
        if missing:
            parts.append("did not run: " + ", ".join(dict.fromkeys(c.id for c in missing)))
        return "; ".join(parts)

    def _remedy(self, one: FileVerdict) -> str:
        """What would be a master: so many quads, or the STEP."""
        if settled(one):
            return "; declared as a preview"
        masters = next((c.detail.get("masters") for c in self.checks if c.id == "convergence"), None)
        kind = one.name.rpartition(".")[2].lower()
        quads = (masters or {}).get(kind, {}).get("quads")
        return f"; cut it in {quads} quads, or send the STEP" if quads else "; cut it finer, or send the STEP"

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready content: no times, no host, no paths."""
        return {
            "format": FORMAT,
            "passed": self.passed,
            "word": self.word,
            "verdict": self.verdict(),
            "file_verdicts": [_verdict_row(one) for one in self.verdicts],
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


def _listed(names: Sequence[str]) -> str:
    """Some names, and how many more there are."""
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED + 1 else ""
    return ", ".join(names[:NAMED] if more else names) + more


def _verdict_of(one: FileReport, checks: Sequence[Check]) -> FileVerdict:
    subject = one.subject
    mine = [c for c in checks if c.subject == subject.name]
    quads = subject.entry.get("quads")
    cut = f"in {quads} quads a cell" if isinstance(quads, int) and subject.is_mesh else ""
    return file_verdict(subject.name, one.judged_as, subject.declared, subject.is_mesh, mine, cut)


def _verdict_row(one: FileVerdict) -> dict[str, Any]:
    row = {
        "name": one.name, "role": one.role.value, "declared": one.declared, "word": one.word, "law_rms": one.rms,
        "limit": one.limit, "sentence": one.sentence,
    }  # fmt: skip
    return dict(plain(row))


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
    role: str | Mapping[str, str] | None = None,
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
    role : "master", "preview", "scan", a mapping or None
        What the files are for: one word for all, or a mapping from formats ("stl") or file names to words. None: as the
        manifest says; a file without one is judged as a master.

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
    UnknownRole
        A role that is none, or that is declared for no file.
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
        delivery = find_files(Path(files), declared_roles(role))
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
        delivered=files is not None,
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
    whole = prescribe(design) if window is None else window
    return [
        *checks,
        *whole_delivery(whole, [(one.subject, one.judged_as, one.present) for one in judged]),
    ], judged


def _judge_one(
    design: Design, window: Window | None, subject: Subject, rays: int, progress: Progress
) -> tuple[list[Check], FileReport]:
    whole = prescribe(design) if window is None else window
    if subject.entry and (reason := no_optics(whole, subject)) is not None:
        progress(f"reading {subject.name}", 0.0)
        return judge_other(subject, reason), FileReport(subject, reason.note, role=Role.OTHER)
    if subject.is_solid:
        return _judge_faces(design, window, whole, subject, rays, progress)
    if subject.is_mesh:
        return _judge_triangles(design, window, subject, rays, progress)
    format = format_of(subject)
    if format is not None:
        progress(f"reading {subject.name}", 0.0)
        note = "judged by the numbers in it"
        return judge_map(design, whole, subject, format, rays), FileReport(subject, note)
    check = not_run(
        "readable", f"{subject.path.suffix or 'this'} is no format that can be judged", subject=subject.name
    )
    return [check], FileReport(subject, "unknown format")


def _judge_faces(
    design: Design, window: Window | None, whole: Window, subject: Subject, rays: int, progress: Progress
) -> tuple[list[Check], FileReport]:
    """Judge a STEP or BREP file."""
    found, facts = judge_solid(design, whole, subject.path, subject.entry, progress, rays, subject.role)
    stands = facts.get("placement", {"lenses": None})
    if not subject.entry and (lies_elsewhere(found) or stands["lenses"] == 0):
        found, evidence, placed = judge_turned(design, window, subject, found, rays, progress, facts)
        if placed is not None:
            return found, FileReport(
                subject, placed.note, evidence, facts, window=placed.window, present=placed.present
            )
    held = tuple(name for name in stands.get("bodies", ()) if not subject.entry)
    return found, FileReport(subject, solid=facts, present=held or None)


def _judge_triangles(
    design: Design, window: Window | None, subject: Subject, rays: int, progress: Progress
) -> tuple[list[Check], FileReport]:
    from clacad.formats.mesh.readers import read_mesh

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
                subject.role,
            )
        else:
            progress("finding where the part lies", 0.0)
            placed = place(design, subject, mesh, window)
            window, present, note = placed.window, placed.present, placed.note
            found, evidence = judge_placed(design, placed, subject.name, rays, progress, subject.role)
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
    role = Role(evidence.facts.get("role", subject.role))
    return [readable, *found], FileReport(subject, note, evidence, window=window, present=present, role=role)
