"""What a report says, as rows of text: one source for the page and for the paper version."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from clacad.base.digits import plainly, shown
from clacad.base.text import plain
from clacad.base.units import millimetres
from clacad.report.fabrication import Line, fabrication, orientation
from clacad.sheet.feasibility import describe
from clacad.verification.limit_sources import Origin

if TYPE_CHECKING:
    from clacad.base.types import Progress
    from clacad.report.parts_in_3d import Parts
    from clacad.report.view_through_sheet import Look
    from clacad.verification import Check, Report
    from clacad.verification.evidence import Evidence

WORDS = {"pass": "pass", "fail": "FAIL", "warn": "warning", "not run": "not run"}
SIGNS = {"<=": "≤", ">=": "≥", "=": "=", "in": "in"}
_CSS = {
    "passed as optical master": "pass",
    "passed as scan": "pass",
    "shape only": "warn",
    "not judged": "not-run",
}
"""Class of a file's verdict on the page."""

STATES = {"on": "simulated", "forced": "simulated, as asked", "off": "left out", "without": "left out, as asked",
          "unknown": "left out, not bounded"}  # fmt: skip


def number(value: float | str | None, unit: str = "") -> str:
    """A value as the page shows it."""
    return plainly(value, unit)[0]


def row(check: Check) -> dict[str, Any]:
    """A check as text."""
    value, limit, unit, note = shown(check.value, check.limit, check.relation, check.unit, check.state)
    return {
        "state": check.state, "word": WORDS[check.state], "css": check.state.replace(" ", "-"), "id": check.id,
        "code": check.code, "subject": check.subject, "value": value,
        "limit": "" if check.limit is None else f"{SIGNS.get(check.relation, check.relation)} {limit}{note}",
        "unit": unit, "sentence": check.sentence, "where": check.where,
        "bundle": check.bundle, "source": check.limit_source.heading,
    }  # fmt: skip


@dataclass(frozen=True, eq=False)
class Content:
    """A report and the pictures of it, as rows of text.

    report : Report
        With its evidence.
    look : Look
    parts : Parts
    timings : bool
        Whether seconds of this run may be shown; without them the same input gives the same bytes.
    """

    report: Report
    look: Look
    parts: Parts
    timings: bool = False

    @property
    def evidence(self) -> Evidence:
        """What was measured beside the checks."""
        assert self.report.evidence is not None, "made from a report with evidence"
        return self.report.evidence

    @property
    def head(self) -> tuple[str, str]:
        """The word of the verdict as the page's head shows it, and its class: passed, shape, failed."""
        word = self.report.word
        css = "passed" if word.startswith("passed") else "shape" if word == "shape only" else "failed"
        return word[0].upper() + word[1:], css

    @property
    def verdicts(self) -> list[dict[str, str]]:
        """What is said of each file, and what a workshop finds in it: the first screen holds one line a file."""
        holds = {file["name"]: file["size"] for file in self.files}
        return [
            {
                "name": one.name, "role": one.role.value + ("" if one.declared or one.role.value != "shape-preview" else " (not declared)"),
                "word": one.word, "css": _CSS.get(one.word, "fail"),
                "holds": holds.get(one.name, ""),
                "rms": "–" if one.rms is None else f"{1e3 * one.rms:.3g}",
                "limit": "–" if one.limit is None else f"{1e3 * one.limit:.3g}", "sentence": one.sentence,
            }
            for one in self.report.verdicts
        ]  # fmt: skip

    @property
    def failures(self) -> list[dict[str, Any]]:
        """Checks that keep the report from passing."""
        return [
            row(c) for c in self.report.checks if c.state == "fail" or (c.state == "not run" and c.required)
        ]

    @property
    def groups(self) -> list[tuple[str, list[dict[str, Any]]]]:
        """Checks by what they are about: light, geometry, each file, refinement; what did not pass comes first."""
        groups: dict[str, list[Check]] = {}
        for check in self.report.checks:
            groups.setdefault(_title(check), []).append(check)
        order = {"fail": 0, "not run": 1, "warn": 2, "pass": 3}
        return [
            (title, [row(c) for c in sorted(
                found, key=lambda c: order[c.state] if c.required else max(2, order[c.state]))])
            for title, found in groups.items()
        ]  # fmt: skip

    @property
    def process(self) -> str:
        """What the limits of the process profile are founded on; "" where none was asked."""
        found = {c.source for c in self.report.checks if c.limit_source.origin is Origin.PROFILE}
        return "; ".join(sorted(text[0].upper() + text[1:] for text in found))

    @cached_property
    def fabrication(self) -> list[tuple[str, list[Line]]]:
        """Lines of the fabrication table by what they are about."""
        groups: dict[str, list[Line]] = {}
        for line in fabrication(self.report):
            groups.setdefault(line.about, []).append(line)
        return list(groups.items())

    @property
    def orientation(self) -> list[str]:
        """How the part must be held."""
        return orientation(self.report.window)

    @property
    def files(self) -> list[dict[str, str]]:
        """The files that were judged."""
        found = []
        for one in self.report.files:
            size = ""
            if one.mesh is not None:
                size = one.mesh.facts.get("holds", {}).get("words", f"{one.mesh.measure.facets:,} triangles")
            elif one.solid:
                size = str(one.solid.get("holds_words", ""))
            found.append({
                "name": one.subject.name, "note": one.note, "format": one.subject.format, "size": size,
                "bytes": f"{one.subject.bytes:,}", "sha256": one.subject.sha256,
            })  # fmt: skip
        return found

    @property
    def derived(self) -> list[tuple[str, list[tuple[str, str, str, str]]]]:
        """Derived numbers by what they are about: name, value, unit, what it means."""
        groups: dict[str, list[tuple[str, str, str, str]]] = {}
        for about, name, value, unit, means in describe(self.report.window, self.report.facts):
            groups.setdefault(about, []).append((name, value, unit, means))
        return list(groups.items())

    @property
    def asked(self) -> list[tuple[str, str, str]]:
        """What was asked, and what was built or measured."""
        from clacad.verification.asked_and_built import asked_and_built

        return asked_and_built(self.report)

    @property
    def budget(self) -> list[tuple[str, str, str]]:
        """Contributions to the direction error, mrad."""
        from clacad.report.figures import budget_rows

        return [(name, f"{1e3 * value:.4g}", what) for name, value, what in budget_rows(self.report)]

    @property
    def attributions(self) -> list[dict[str, Any]]:
        """Errors told apart, mrad."""
        return [
            {
                "about": found.about, "cell": f"{found.cell[0]}, {found.cell[1]}", "bundle": found.bundle,
                "used": f"{found.used} of {found.rays}", "rms": f"{1e3 * found.rms:.4g}",
                "parts": [
                    (p.name, f"{1e3 * p.rms:.3g}", f"{1e3 * p.half:.3g}", f"{1e3 * p.worst:.3g}", f"{1e3 * p.share:+.3g}",
                     p.meaning) for p in found.parts
                ],
            }
            for found in self.evidence.attributions
        ]  # fmt: skip

    @property
    def foci(self) -> list[tuple[str, str, str, str, str, str]]:
        """Foci of both lenses in both meridians, mm."""
        if self.evidence.foci is None:
            return []
        mm = millimetres(self.report.window.unit)
        return [
            (name, number(f.lens1.focus[0] * mm), number(f.lens2.focus[0] * mm), number(f.gap * mm),
             f"{abs(f.gap) / f.distance:.2g}", ", ".join(number(v * mm) for v in f.length))
            if f.gap == f.gap
            else (name, "no power", "no power", "–", "–", "–")
            for name, f in zip("xy", self.evidence.foci, strict=True)
        ]  # fmt: skip

    @property
    def ladder(self) -> list[tuple[str, str, str, str, str, str]]:
        """Rungs: name, setting, model error, law error, share in another fate, microseconds a ray."""
        found = self.evidence.ladder
        return [
            (r.rung, r.setting, f"{1e3 * r.model_rms:.3g}", f"{1e3 * r.law_rms:.4g}", f"{100 * r.disagree:.2g}",
             f"{1e6 * r.seconds / r.rays:.3g}" if self.timings else f"{us:.2g}")
            for r, us in zip(found.rows, found.forecast, strict=True)
        ]  # fmt: skip

    @property
    def effects(self) -> list[tuple[str, str, str, str, str, str]]:
        """Effects: name, state, why, angle, radiance, cost."""
        plan = self.evidence.plan
        if plan is None:
            return []
        return [
            (r.effect, STATES[r.state], r.why, f"{1e3 * r.angle:.3g}" if r.angle else "",
             f"{100 * r.radiance:.3g}" if r.radiance else "", f"×{r.cost:.3g}")
            for r in plan.rows
        ]  # fmt: skip

    @property
    def effects_sentence(self) -> str:
        """What is simulated and what is left out, in one sentence."""
        plan = self.evidence.plan
        if plan is None:
            return "The effects could not be planned: a wavelength lies outside the material's data."
        left = [
            f"{r.effect} ≤ {1e3 * r.angle:.2g} mrad"
            if r.angle
            else f"{r.effect} ≤ {100 * r.radiance:.2g} % of the light"
            for r in plan.rows
            if not r.on and r.known and (r.angle or r.radiance) and r.effect != "facets"
        ]
        unknown = [r.effect for r in plan.rows if not r.on and not r.known]
        text = f"A picture would simulate: {', '.join(plan.names) or 'nothing beyond refraction'}; left out: "
        text += ", ".join(left) or "nothing that changes anything"
        return text + (f"; not bounded: {', '.join(unknown)}." if unknown else ".")

    @property
    def command(self) -> str:
        """The command that makes this report again."""
        files = " --files FOLDER" if self.report.files else ""
        timings = " --timings" if self.timings else ""
        return (
            f"clacad verify DESIGN.toml{files} --rays {len(self.report.optics.main.rays)}{timings} -o REPORT"
        )

    @property
    def versions(self) -> str:
        """Versions the numbers depend on."""
        return ", ".join(f"{name} {version}" for name, version in self.report.versions.items())

    def numbers(self) -> dict[str, Any]:
        """Everything the page says as numbers: what goes into report.json."""
        from clacad.report.fabrication import fabrication_dict

        found = self.report.to_dict() | {"fabrication": plain(fabrication_dict(self.report))}
        found["budget"] = [list(one) for one in self._budget_numbers()]
        if self.timings:
            found["timings"] = self.evidence.ladder.measured()
        return found

    def _budget_numbers(self) -> list[tuple[str, float, str]]:
        from clacad.report.figures import budget_rows

        return budget_rows(self.report)


def _title(check: Check) -> str:
    if check.where == "file":
        return check.subject
    if check.where == "mesh":
        return "Refinement of facets"
    if check.where.startswith(("geometry", "thin")):
        return "Geometry and process"
    return "Light, through the exact surfaces"


def content(report: Report, progress: Progress, timings: bool = False) -> Content:
    """Gather what the page of a report shows: evidence, a picture, the parts."""
    from clacad.report.parts_in_3d import parts
    from clacad.report.view_through_sheet import look

    full = report.with_evidence(progress)
    seen = look(report.design, report.window, progress)
    progress("meshing the parts to look at", 0.0)
    return Content(full, seen, parts(report.window), timings)


def data_uri(png: bytes) -> str:
    """A PNG as an address that holds it."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")
