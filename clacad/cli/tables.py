"""Tables the commands print."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from clacad.cli.console import size, table

MARKS = {"pass": "ok", "fail": "FAIL", "warn": "warn", "not run": "not run"}


def derived_text(rows: Iterable[Sequence[str]]) -> str:
    """Rows of derived numbers, one block for each thing they are about."""
    blocks: dict[str, list[list[str]]] = {}
    for about, name, value, unit in rows:
        blocks.setdefault(about, []).append([name, value, unit])
    return "\n".join(f"{about}\n{table(lines)}" for about, lines in blocks.items())


def checks_text(checks: Iterable[Any]) -> str:
    """One line a check: state, id, value against limit, and the sentence where it did not pass."""
    lines = []
    for check in checks:
        lines.append([MARKS[check.state], check.id, number(check.value), limit_text(check), check.unit, check.sentence])
    return table(lines)


def limit_text(check: Any) -> str:
    """The limit as text, with its sense."""
    return "" if check.limit is None else f"(limit {number(check.limit)})"


def number(value: Any) -> str:
    """A number as a person reads it."""
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(value)


def forecast_text(rows: Iterable[dict[str, Any]]) -> str:
    """What the files would cost: facets, bytes, seconds, memory."""
    lines = [["format", "setting", "facets", "bytes", "seconds", "memory"]]
    for row in rows:
        facets = row.get("triangles")
        lines.append(
            [
                str(row["format"]),
                str(row.get("setting", "")),
                "" if facets is None else f"{facets:,}",
                size(row["bytes"]),
                f"{row['seconds']:.2g}",
                size(row["memory"]),
            ]
        )
    return table(lines)
