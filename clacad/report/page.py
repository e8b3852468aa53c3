"""Fill the page: every text escaped, nothing loaded from anywhere."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.feasibility import describe
from clacad.report import figures
from clacad.verify.asked import asked_and_built

if TYPE_CHECKING:
    from clacad.verify import Check, Report

WORDS = {"pass": "pass", "fail": "FAIL", "warn": "warning", "not run": "not run"}


def page(report: Report, mark: str) -> str:
    """The whole report as one HTML text that needs no network.

    Parameters
    ----------
    report : Report
    mark : str
        Comment by which the page is known again.
    """
    from jinja2 import Environment, StrictUndefined
    from markupsafe import Markup

    template = (Path(__file__).parent / "page.html.j2").read_text(encoding="utf-8")
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    drawn = {
        name: Markup(draw(report))  # our own drawings: no text of a design is in them but escaped file names
        for name, draw in (
            ("section", figures.section), ("transfer", figures.transfer), ("transmission", figures.transmission),
            ("residual", figures.residual_map), ("spots", figures.spots), ("convergence", figures.convergence),
            ("budget", figures.budget),
        )
    }  # fmt: skip
    return environment.from_string(template).render(
        mark=Markup(mark),
        report=report,
        design=report.design,
        verdict=report.verdict(),
        counts=report.counts(),
        groups=_groups(report),
        failures=[
            _row(c) for c in report.checks if c.state == "fail" or (c.state == "not run" and c.required)
        ],
        asked=asked_and_built(report),
        derived=_grouped(report),
        budget=[(name, f"{1e3 * value:.4g}", what) for name, value, what in figures.budget_rows(report)],
        figure=drawn,
        command=_command(report),
    )


def _groups(report: Report) -> list[tuple[str, list[dict[str, Any]]]]:
    """Checks by what they are about: light, geometry, each file, refinement; what did not pass comes first."""
    groups: dict[str, list[Check]] = {}
    for check in report.checks:
        if check.where == "file":
            title = check.subject
        elif check.where == "mesh":
            title = "Refinement of facets"
        else:
            title = (
                "Geometry and process"
                if check.where.startswith(("geometry", "thin"))
                else "Light, through the exact surfaces"
            )
        groups.setdefault(title, []).append(check)
    order = {"fail": 0, "not run": 1, "warn": 2, "pass": 3}
    return [
        (
            title,
            [
                _row(c)
                for c in sorted(found, key=lambda c: order[c.state] if c.required else max(2, order[c.state]))
            ],
        )
        for title, found in groups.items()
    ]


def _row(check: Check) -> dict[str, Any]:
    return {
        "state": check.state, "word": WORDS[check.state], "css": check.state.replace(" ", "-"), "id": check.id,
        "code": check.code, "subject": check.subject, "value": number(check.value, check.unit),
        "limit": "" if check.limit is None else f"{SIGNS.get(check.relation, check.relation)} {number(check.limit, check.unit)}",
        "unit": UNITS.get(check.unit, check.unit), "sentence": check.sentence, "where": check.where,
        "bundle": check.bundle, "source": check.source,
    }  # fmt: skip


SIGNS = {"<=": "≤", ">=": "≥", "=": "=", "in": "in"}
UNITS = {"rad": "mrad"}
"""Angles are shown in mrad."""


def number(value: float | str | None, unit: str = "") -> str:
    """A value as the page shows it."""
    if value is None:
        return "–"
    if isinstance(value, str):
        return value
    if value in (float("inf"), float("-inf")):
        return "none"
    return f"{1e3 * value:.4g}" if unit == "rad" else f"{value:.5g}"


def _grouped(report: Report) -> list[tuple[str, list[tuple[str, str, str]]]]:
    groups: dict[str, list[tuple[str, str, str]]] = {}
    for about, name, value, unit in describe(report.window, report.facts):
        groups.setdefault(about, []).append((name, value, unit))
    return list(groups.items())


def _command(report: Report) -> str:
    files = " --files FOLDER" if report.files else ""
    return f"clacad verify DESIGN.toml{files} -o REPORT"
