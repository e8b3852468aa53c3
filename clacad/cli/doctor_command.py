"""`clacad doctor`: what this installation can do."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from clacad.cli.console import show_json, show_text, size, table

if TYPE_CHECKING:
    from clacad.doctor import Diagnosis

MARKS = {"ok": "ok", "warn": "warn", "fail": "FAIL", "absent": "-"}


def show_findings(folder: Path, *, json: bool, quiet: bool) -> int:
    """Print what was found; exit 1 when something fails."""
    from clacad.doctor import examine, sound

    findings = examine(folder)
    if json:
        document = [finding.to_dict() for finding in findings]
        show_json({"format": 1, "passed": sound(findings), "findings": document})
    else:
        show_text(findings_text(findings), quiet=quiet)
    return 0 if sound(findings) else 1


def findings_text(findings: tuple[Diagnosis, ...]) -> str:
    """One block a topic, one line a finding."""
    topics: dict[str, list[list[str]]] = {}
    for finding in findings:
        row = [MARKS[finding.state], finding.name, value_text(finding), finding.sentence]
        topics.setdefault(finding.topic, []).append(row)
    failed = [finding.name for finding in findings if finding.state == "fail"]
    verdict = f"FAIL: {', '.join(failed)}" if failed else "everything clacad needs is here"
    return "\n".join([*(f"{topic}\n{table(rows)}" for topic, rows in topics.items()), verdict])


def value_text(finding: Diagnosis) -> str:
    """Bytes and seconds with their unit."""
    value = finding.value
    if value is None:
        return "-"
    if isinstance(value, str) or finding.topic in ("threads", "rates"):
        return str(value)
    if finding.topic == "kernel":
        return f"{value:.3g} s"
    return size(value) + ("/s" if finding.name == "writing" else "")
