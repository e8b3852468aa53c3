"""Content of a report as rows of text: one source for the page and for the paper version.

Drawings of the part are the views of `formats.drawing` with the measured light, as SVG.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

from clacad.base.text import bound, mrad_text, plain, shown
from clacad.checks.check import Origin
from clacad.exporting.drawing import views
from clacad.exporting.drawing.canvas import allowances, orientation
from clacad.report.rows import FabricationLine, LightRows, fabrication, fabrication_dict
from clacad.sheet.feasibility import FactRow, describe
from clacad.sheet.feasibility.as_rows import cells_text

if TYPE_CHECKING:
    from clacad.base.types import Progress
    from clacad.report.pictures import Look, Parts
    from clacad.sheet.window import Window
    from clacad.verification import Check, Report
    from clacad.verification.evidence import Evidence


def assembly(sheet: Window) -> str:
    """The whole sheet from the side, cut through a row of cells."""
    return views.assembly(sheet).svg()


def plan(sheet: Window) -> str:
    """The sheet seen along the light."""
    return views.plan(sheet).svg()


def telescopelet(report: Report) -> str:
    """One telescopelet cut along x, with rays and the focal plane where they were measured."""
    from clacad.report.figures import ray_fan

    light = None
    if report.evidence is not None and report.evidence.foci is not None:
        focus = report.evidence.foci[0].lens1.focus[0] * report.window.thin.rotation[2, 2]
        light = views.DrawnLight(ray_fan(report.window), float(focus))
    return views.telescopelet(report.window, report.facts, light, allowances(report.design)).svg()


def lens_detail(report: Report, array: int) -> str:
    """One lens over its cell, enlarged."""
    return views.lens_detail(report.window, report.facts, array, allowances(report.design)).svg()


WORDS = {"pass": "pass", "fail": "FAIL", "warn": "warning", "not run": "not run"}
SIGNS = {"<=": "≤", ">=": "≥", "=": "=", "in": "in"}
_CSS = {
    "passed as optical master": "pass",
    "passed as scan": "pass",
    "passed as tooling": "pass",
    "shape only": "warn",
    "not judged": "not-run",
}
"""Class of a file's verdict on the page."""


def row(check: Check) -> dict[str, Any]:
    """A check as text."""
    value, limit, unit, note = shown(check.value, check.limit, check.relation, check.unit, check.state)
    return {
        "state": check.state,
        "word": WORDS[check.state],
        "css": check.state.replace(" ", "-"),
        "id": check.id,
        "code": check.code,
        "subject": check.subject,
        "value": value,
        "limit": (
            "" if check.limit is None else bound(SIGNS.get(check.relation, check.relation), limit) + note
        ),
        "unit": unit,
        "sentence": check.sentence,
        "where": check.where,
        "bundle": check.bundle,
        "source": check.limit_source.heading,
    }


@dataclass(frozen=True, eq=False)
class CheckRows:
    """Checks, verdicts and judged files of a report as rows of text."""

    report: Report

    @property
    def verdicts(self) -> list[dict[str, str]]:
        """Verdict of each file, and its content for a workshop: the first screen has one line a file."""
        holds = {file["name"]: file["size"] for file in self.files}
        return [
            {
                "name": one.name,
                "role": (
                    one.role.value
                    + ("" if one.declared or one.role.value != "shape-preview" else " (not declared)")
                ),
                "word": one.word,
                "css": _CSS.get(one.word, "fail"),
                "holds": holds.get(one.name, ""),
                "rms": "–" if one.rms is None else mrad_text(one.rms, 3, unit=""),
                "limit": "–" if one.limit is None else mrad_text(one.limit, 3, unit=""),
                "sentence": one.sentence,
            }
            for one in self.report.verdicts
        ]

    @property
    def failures(self) -> list[dict[str, Any]]:
        """Checks that keep the report from passing."""
        return [
            row(c) for c in self.report.checks if c.state == "fail" or (c.state == "not run" and c.required)
        ]

    @property
    def groups(self) -> list[tuple[str, list[dict[str, Any]]]]:
        """All checks, by subject."""
        return _grouped(self.report.checks)

    @property
    def folded(self) -> tuple[Any, Any]:
        """Checks that did not pass, and those that did, which the page folds; by subject."""
        checks = self.report.checks
        passed = [c for c in checks if c.state == "pass"]
        return _grouped([c for c in checks if c.state != "pass"]), _grouped(passed)

    @property
    def process(self) -> str:
        """Source of the limits of the process profile; "" without a profile."""
        found = {c.source for c in self.report.checks if c.limit_source.origin is Origin.PROFILE}
        return "; ".join(sorted(text[0].upper() + text[1:] for text in found))

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
            found.append(
                {
                    "name": one.subject.name,
                    "note": one.note,
                    "format": one.subject.format,
                    "size": size,
                    "bytes": f"{one.subject.bytes:,}",
                    "sha256": one.subject.sha256,
                }
            )
        return found

    @property
    def versions(self) -> str:
        """Versions the numbers depend on."""
        return ", ".join(f"{name} {version}" for name, version in self.report.versions.items())


@dataclass(frozen=True, eq=False)
class Content:
    """A report and the pictures of it, as rows of text.

    report : With its evidence.
    timings : Whether seconds of this run may be shown; without them the same input gives the same bytes.
    whole : The non-uniform sheet, where `report.window` is its uniform equivalent; None: `report.window`.
    of_one_cell : Sentence about it; "" for a uniform sheet.
    of_viewer : bytes or None
        The view of the viewer of the check `viewed` as PNG; None for a viewer behind the sheet.
    """

    report: Report
    look: Look
    parts: Parts
    timings: bool = False
    whole: Window | None = None
    of_one_cell: str = ""
    of_viewer: bytes | None = None

    @property
    def evidence(self) -> Evidence:
        """Measurements in addition to the checks."""
        assert self.report.evidence is not None, "made from a report with evidence"
        return self.report.evidence

    @property
    def head(self) -> tuple[str, str]:
        """The word of the verdict as the page's head shows it, and its class: passed, shape, failed."""
        word = self.report.word
        css = "passed" if word.startswith("passed") else "shape" if word == "shape only" else "failed"
        return word[0].upper() + word[1:], css

    @property
    def checked(self) -> CheckRows:
        """Checks, verdicts and judged files."""
        return CheckRows(self.report)

    @property
    def sheet(self) -> Window:
        """The whole sheet."""
        return self.report.window if self.whole is None else self.whole

    @property
    def cells(self) -> str:
        """How many cells the whole sheet has."""
        return cells_text(self.sheet.lattice).replace(" x ", " × ")

    @property
    def viewer(self) -> str:
        """What the viewer gets of the whole sheet, in a line; "" where that was not checked."""
        from clacad.verification.light.viewed import headline

        return headline(self.report.checks)

    @cached_property
    def fabrication_lines(self) -> tuple[FabricationLine, ...]:
        """Lines of the fabrication table."""
        return fabrication(self.report, self.sheet)

    @property
    def fabrication(self) -> list[tuple[str, list[FabricationLine]]]:
        """Lines of the fabrication table by what they are about."""
        groups: dict[str, list[FabricationLine]] = {}
        for line in self.fabrication_lines:
            groups.setdefault(line.about, []).append(line)
        return list(groups.items())

    @property
    def orientation(self) -> list[str]:
        """How the part must be held."""
        return orientation(self.report.window)

    @property
    def described(self) -> tuple[FactRow, ...]:
        """Derived numbers, those of the whole sheet among them."""
        return describe(self.report.window, self.report.facts, self.sheet)

    @property
    def derived(self) -> list[tuple[str, list[tuple[str, str, str, str]]]]:
        """Derived numbers by what they are about: name, value, unit, what it means."""
        groups: dict[str, list[tuple[str, str, str, str]]] = {}
        for about, name, value, unit, means in self.described:
            groups.setdefault(about, []).append((name, value, unit, means))
        return list(groups.items())

    @property
    def asked(self) -> list[tuple[str, str, str]]:
        """Requested numbers, and those built or measured."""
        from clacad.verification.verification_report import asked_and_built

        return asked_and_built(self.report, self.sheet)

    @property
    def light(self) -> LightRows:
        """What light does, in numbers: budget, foci, rungs, effects."""
        return LightRows(self.report, self.evidence, self.timings)

    @property
    def command(self) -> str:
        """The command that makes this report again."""
        files = " --files FOLDER" if self.report.files else ""
        timings = " --timings" if self.timings else ""
        return (
            f"clacad verify DESIGN.toml{files} --rays {len(self.report.optics.main.lit.rays)}{timings} -o"
            " REPORT"
        )


def numbers(content: Content) -> dict[str, Any]:
    """All numbers of the page: the content of report.json."""
    from clacad.report.figures import budget_rows

    report = content.report
    found = report.to_dict() | {
        "fabrication": plain(fabrication_dict(content.fabrication_lines, report.window, content.sheet)),
        "derived": [list(row) for row in content.described],
    }
    found["budget"] = [list(one) for one in budget_rows(report)]
    if content.timings:
        found["timings"] = content.evidence.ladder.measured()
    return found


def _grouped(checks: Sequence[Check]) -> list[tuple[str, list[dict[str, Any]]]]:
    """Rows of checks by subject: light, geometry, each file, refinement; what did not pass comes first."""
    order = {"fail": 0, "not run": 1, "warn": 2, "pass": 3}
    groups: dict[str, list[Check]] = {}
    for check in checks:
        groups.setdefault(_title(check), []).append(check)
    return [
        (
            title,
            [
                row(c)
                for c in sorted(found, key=lambda c: order[c.state] if c.required else max(2, order[c.state]))
            ],
        )
        for title, found in groups.items()
    ]


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
    from clacad.report.pictures import look, parts, seen_by_viewer
    from clacad.verification.verification_report import of_worst_cell

    shown, words = of_worst_cell(report)
    full = replace(report, window=shown.window, evidence=shown.with_evidence(progress).evidence)
    seen = look(report.design, report.window, progress)
    progress("meshing the parts to look at", 0.0)
    viewer = seen_by_viewer(report.design, report.window)
    return Content(full, seen, parts(shown.window), timings, report.window, words, viewer)


def data_uri(png: bytes) -> str:
    """A PNG as an address that holds it."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")
