"""The result of a verification: one object gives the page, the JSON and the exit status."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import degrees
from typing import TYPE_CHECKING, Any

from clacad.base.interactive import Tabular, shown_progress
from clacad.base.text import plain, table
from clacad.base.types import Progress
from clacad.checks import check as judging
from clacad.checks.check import RAYS_NEEDED, Check, check_columns, short_table, wrong
from clacad.checks.file_kinds import CONVERGENCE, DELIVERY
from clacad.exporting.roles import Role
from clacad.light.measure import Light
from clacad.sheet.feasibility import Feasibility, describe, feasibility
from clacad.sheet.window import Window
from clacad.tracing.worst_cell import worst_cell
from clacad.verification.light.through_window import Meridian, Optics
from clacad.verification.verdict import GOOD, FileVerdict, Word, file_verdict, settled, word_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from clacad.design import Design
    from clacad.judging.judge_files import FileReport
    from clacad.making.light_as_made import JudgedAsMade
    from clacad.measuring.measured import Measured
    from clacad.verification.evidence import Evidence
    from clacad.verification.light.facet_convergence import Convergence

FORMAT = 1
NAMED = 4
"""Files that a verdict names; for more it gives the number."""


@dataclass(frozen=True, eq=False)
class Report(Tabular):
    """Result of a verification.

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
        Contents of the page in addition to its checks; None until `with_evidence`.
    delivered : bool
        Whether files were delivered for judgement; a delivery without any file does not pass.
    measured : Measured or None
        The part by its height maps, or by the mesh of a scan.
    made : JudgedAsMade or None
        The sheet as its process makes it.
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
    measured: Measured | None = None
    made: JudgedAsMade | None = None

    def __repr__(self) -> str:
        """Short table: checks that did not pass, files, and the verdict last."""
        files = table([one.row() for one in self.verdicts])
        parts = (self.design.name, short_table(self.checks), files, self.verdict())
        return "\n".join(part for part in parts if part)

    def to_columns(self) -> dict[str, Any]:
        """One row for each check."""
        return check_columns(self.checks)

    def _repr_html_(self) -> str:
        from clacad import as_html  # through the top-level package: the renderer's room lies below this one

        return str(as_html(self))

    def plot(self) -> Figure:
        """Draw a section with rays, and exit slope against incident slope; see `clacad.plot`."""
        from clacad import plot

        drawn: Figure = plot(self)
        return drawn

    def with_evidence(self, progress: Progress | None = None) -> Report:
        """Report with the additional contents of its page; itself if it has them."""
        if self.evidence is not None:
            return self
        from clacad.verification.evidence import gather_evidence

        evidence = gather_evidence(self.design, self.window, self.files, shown_progress(progress))
        return replace(self, evidence=evidence)

    @cached_property
    def verdicts(self) -> tuple[FileVerdict, ...]:
        """Verdict on each file, in the order of judgement."""
        if self.measured is None:
            return tuple(_verdict_of(one, self.checks) for one in self.files)
        own = {check.kind for check in self.measured.checks}
        rest = [check for check in self.checks if check.kind not in own]
        part = _measured_verdict(self.measured)
        worse = [one for one in (_verdict_of(file, rest) for file in self.files) if one.word not in GOOD]
        return tuple(replace(one, rms=part.rms, limit=part.limit) for one in worse) or (part,)

    @cached_property
    def word(self) -> Word:
        """Passed as optical master, shape only, failed, not judged; of a design alone: passed or failed."""
        if self.delivered:
            return word_of(self.verdicts, self.checks)
        return "passed" if judging.passed(self.checks) else "failed"

    @property
    def passed(self) -> bool:
        """Whether the exit status is 0: nothing failed, everything required ran, every file has its declared
        purpose.

        A delivery of declared previews alone also passes, and its word is still *shape only*.
        """
        if self.word == "shape only":
            return all(settled(one) for one in self.verdicts if one.word == "shape only")
        return self.word in GOOD

    @property
    def exit_status(self) -> int:
        """0 if passed; 3 if the only failure is a file that exceeds its reader's limits; else 1."""
        if self.passed:
            return 0
        refused = {c.subject for c in self.checks if c.detail.get("over_budget")}
        return 3 if refused and not wrong(c for c in self.checks if c.subject not in refused) else 1

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
            return _failed(self.checks)
        told = [one for one in self.verdicts if one.word == self.word and one.role is not Role.OTHER]
        if self.word == "shape only":
            return f"shape only: {told[0].name} {told[0].sentence}{self._remedy(told[0])}"
        if self.word == "not judged":
            lacking = wrong(c for c in self.checks if c.kind is DELIVERY or RAYS_NEEDED in c.detail)
            return "not judged: " + (
                lacking[0].sentence if lacking else "none of the files carries light of the law"
            )
        if self.word == "cannot say":
            return f"cannot say: {told[0].sentence}"
        if self.word == "passed":
            return f"passed: {checks}"
        shapes = [one.name for one in self.verdicts if one.word == "shape only"]
        rest = f"; shape only, as declared: {_listed(shapes)}" if shapes else ""
        return f"{self.word}: {_listed([one.name for one in told])} ({checks}){rest}"

    def _remedy(self, one: FileVerdict) -> str:
        """Text of the change that gives a master: a number of quads, or the STEP."""
        if settled(one):
            return "; declared as a preview"
        found = CONVERGENCE.first(self.checks)
        masters = None if found is None else found.detail.get("masters")
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
                "form": self.window.form,
                "unit_m": self.window.unit,
                "count": list(self.window.lattice.count),
                "recipe": plain(dict(self.window.recipe)),
                "residual": plain(dict(self.window.residual)),
            },
            "derived": [list(row) for row in describe(self.window, self.facts)],
            "checks": [check.to_dict() for check in self.checks],
            "field": [
                _field_row(*pair) for pair in zip(self.optics.points, self.optics.closed_form, strict=True)
            ],
            "transfer": [_curve_row(c) for c in self.curves],
            "files": [_file_row(f) for f in self.files],
            "notes": list(self.design.notes),
            "versions": dict(self.versions),
            **({} if self.evidence is None else self.evidence.to_dict()),
            **({} if self.made is None else {"as_made": self.made.to_dict()}),
            **({} if self.measured is None else {"measured": self.measured.to_dict()}),
        }

    def to_json(self) -> str:
        """Same numbers as the page, keys sorted: the same bytes for the same design, files and versions."""
        return (
            json.dumps(self.to_dict(), indent=1, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n"
        )


def of_worst_cell(report: Report) -> tuple[Report, str]:
    """Report of a non-uniform sheet as that of its worst cell's uniform equivalent, with a note; else ""."""
    if report.window.uniform:
        return report, ""
    seen = worst_cell(report.window, report.design.check.field)
    words = (
        "Every cell of this sheet differs. Numbers and drawings are those of the uniform equivalent of"
        f" {seen.words}; the count of cells, outer sizes, volumes, plan, side"
        " view and the viewer's share are of the whole sheet"
    )
    facts = feasibility(seen.buildable, *report.design.viewing_places).with_steps_of(report.facts)
    return replace(report, window=seen.buildable, facts=facts), words


def _failed(checks: Sequence[Check]) -> str:
    """Text of the checks that failed, and of those that were required and did not run."""
    states = (
        ("failed: ", [c for c in checks if c.state == "fail"]),
        ("did not run: ", [c for c in checks if c.state == "not run" and c.required]),
    )
    return "; ".join(
        words + ", ".join(dict.fromkeys(c.id for c in found)) for words, found in states if found
    )


def _listed(names: Sequence[str]) -> str:
    """Text of some names, and the number of the others."""
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED + 1 else ""
    return ", ".join(names[:NAMED] if more else names) + more


def _verdict_of(one: FileReport, checks: Sequence[Check]) -> FileVerdict:
    subject = one.subject
    mine = [c for c in checks if c.subject == subject.name]
    quads = subject.entry.get("quads")
    cut = f"in {quads} quads a cell" if isinstance(quads, int) and subject.is_mesh else ""
    return file_verdict(subject.name, one.judged_as, subject.declared, subject.is_mesh, mine, cut)


def _measured_verdict(found: Measured) -> FileVerdict:
    """Verdict on a part by its maps."""
    words: dict[str, Word] = {"pass": "passed as scan", "fail": "failed", "cannot say": "cannot say"}
    word, limit = words[found.verdict], found.design.check.law_rms
    sentence = found.summary.partition(": ")[2]
    return FileVerdict(found.subject, Role.SCAN, True, word, found.light.rms, limit, sentence)


def _verdict_row(one: FileVerdict) -> dict[str, Any]:
    row = {
        "name": one.name,
        "role": one.role.value,
        "declared": one.declared,
        "word": one.word,
        "law_rms": one.rms,
        "limit": one.limit,
        "sentence": one.sentence,
    }
    return dict(plain(row))


def _field_row(point: Light, closed_form: float) -> dict[str, Any]:
    row = {
        "direction": point.lit.middle,
        "expected": point.expected[0],
        "bias": point.bias,
        "spread": point.spread,
        "rms": point.rms,
        "worst": point.worst,
        "share": point.share,
        "closed_form": closed_form,
        "counts": point.seen.counts(),
    }
    return dict(plain(row))


def _curve_row(curve: Meridian) -> dict[str, Any]:
    names = ("slope", "law", "mean", "spread", "alive", "closed_form", "ghost")
    return dict(plain({name: getattr(curve, name) for name in names}))


def _file_row(found: FileReport) -> dict[str, Any]:
    subject = found.subject
    row: dict[str, Any] = {
        "name": subject.name,
        "format": subject.format,
        "bytes": subject.bytes,
        "sha256": subject.sha256,
        "note": found.note,
        "stated": dict(subject.entry),
    }
    if found.mesh is not None:
        row["triangles"] = found.mesh.measure.facets
    if found.solid:
        row["solids"] = found.solid.get("kernel_solids", found.solid.get("solids"))
    return dict(plain(row))


def asked_and_built(report: Report, sheet: Window) -> list[tuple[str, str, str]]:
    """Return what was requested and what was built and measured, as rows for a person: name, requested,
    built or measured.

    sheet : the whole sheet, of which `report.window` may be the uniform equivalent of one cell.
    """
    design, window, law, fit = report.design, report.window, report.design.law, report.optics.narrow.fitted
    dark = "not measured"
    index = f"from material {design.pair.material}" if design.pair.index is None else f"{design.pair.index:g}"
    own = "" if not window.many_sizes else ", cells of the table taken by their own"
    eta, delta = (
        (dark, dark) if fit is None else (_pair(fit.eta_x, fit.eta_y), _pair(fit.delta_x, fit.delta_y))
    )
    angles = ", ".join(f"{a:g}" for a in design.law_spec.euler_degrees)
    recipe = "given" if design.pair.given else design.pair.confocal
    return [
        ("η x, y", _pair(law.eta_x, law.eta_y) + own, eta),
        ("δ x, y", _pair(law.delta_x, law.delta_y), delta),
        (
            "φ, θ, ψ (deg)",
            f"{angles} ({design.law_spec.euler_axes} axes)",
            "held in the fit; see the check tilt",
        ),
        ("form, recipe", f"{design.pair.form}, {recipe}", window.form),
        ("cells", " × ".join(str(n) for n in design.lattice.count), str(sheet.lattice.cell_count)),
        ("refractive index", index, ", ".join(f"{body.index:.6g}" for body in window.bodies)),
        ("wavelength (nm)", f"{1e9 * design.pair.wavelength:g}", f"{1e9 * report.facts.wavelength:g}"),
        ("cone of test rays (deg)", f"{degrees(design.check.field):g}", str(report.optics.main.lit)),
    ]


def _pair(*values: float) -> str:
    return ", ".join(f"{v:.6g}" for v in values)
