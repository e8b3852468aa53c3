"""Tables the commands print."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import isinf
from typing import Any

from clacad.cli.console import size, table
from clacad.rates import span_text

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
        name = f"{check.id} ({check.subject})" if check.subject else check.id
        lines.append([MARKS[check.state], name, number(check.value), limit_text(check), check.sentence])
    return table(lines)


def verdicts_text(verdicts: Iterable[Any]) -> str:
    """One line a file: what it is for, what is said of it, and light through it against the limit."""
    lines = []
    for one in verdicts:
        light = (
            ""
            if one.rms is None or one.limit is None
            else f"{1e3 * one.rms:.3g} of {1e3 * one.limit:.3g} mrad rms"
        )
        lines.append([one.name, one.role.value, one.word, light])
    return table(lines)


def limit_text(check: Any) -> str:
    """The limit as text, with its sense."""
    if check.limit is None:
        return ""
    if isinstance(check.limit, float) and isinf(check.limit):
        return "no limit"
    return f"{check.relation} {number(check.limit)} {check.unit}".rstrip()


def number(value: Any) -> str:
    """A number as a person reads it."""
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(value)


def forecast_text(rows: Iterable[dict[str, Any]]) -> str:
    """What the files would cost: facets, bytes, seconds, memory; or why an export would be refused."""
    lines = [["format", "facets", "bytes", "processor", "memory", ""]]
    for row in rows:
        if row.get("refused"):
            lines.append([row["format"], f"refused: {row['refused']}"])
            continue
        low, high = row["seconds"]
        grid = "" if row["quads"] is None else f"{row['quads']} quads a cell side"
        lines.append(
            [
                row["format"],
                "" if row["facets"] is None else f"{row['facets']:,}",
                ("" if row["exact"] else "about ") + size(row["bytes"]),
                span_text(low, high),
                f"up to {size(row['memory'][1])}",
                grid,
            ]
        )
    return table(lines)


def files_text(files: Iterable[Any]) -> str:
    """The files of a manifest: name, bytes, hash, what was compared with the design."""
    lines = [
        [entry["name"], size(entry["bytes"]), entry["sha256"][:16], "agrees: " + ", ".join(entry["checks"])]
        for entry in files
    ]
    return table(lines)


def check_text(
    title: str, derived: Iterable[Sequence[str]], checks: Iterable[Any], forecast: Iterable[dict[str, Any]]
) -> str:
    """All of `clacad check`."""
    checks = list(checks)
    failed = [check.id for check in checks if check.state == "fail"]
    verdict = f"FAIL: {', '.join(dict.fromkeys(failed))}" if failed else "the design rules hold"
    blocks = (
        derived_text(derived), "design rules", checks_text(checks), "what an export would cost", forecast_text(forecast),
    )  # fmt: skip
    return "\n".join((title, *blocks, verdict))
