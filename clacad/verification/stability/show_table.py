"""The stability table as text, markdown and plain data."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import isfinite, isinf
from typing import Any

from clacad.base.text import plain
from clacad.verification.stability.measure_cases import Row

HEAD = ("kind", "case", "quantity", "condition", "textbook", "clacad", "allowed")


def as_dict(rows: Sequence[Row]) -> dict[str, Any]:
    """Rows and verdict as JSON can hold them; infinite numbers become words."""
    found = {
        "unit": "ulp = 2**-52",
        "rows": [
            {
                "kind": row.kind,
                "case": row.name,
                "why": row.why,
                "quantity": row.quantity,
                "condition": row.condition,
                "textbook": row.textbook,
                "clacad": row.error,
                "recorded": row.recorded,
                "allowed": row.allowed,
                "holds": row.holds,
            }
            for row in rows
        ],
        "passed": all(row.holds for row in rows),
        "worst": worst_shares(rows),
    }
    return dict(plain(found, lambda _: "inf"))


def as_text(rows: Sequence[Row]) -> str:
    """One aligned line per row, and the verdict."""
    lines = [HEAD, *(_cells(row) for row in rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(HEAD))]
    text = [
        "  ".join(
            cell.ljust(w) if k < 3 else cell.rjust(w)
            for k, (cell, w) in enumerate(zip(line, widths, strict=True))
        )
        + ("" if number == 0 or rows[number - 1].holds else "  FAIL")
        for number, line in enumerate(lines)
    ]
    return "\n".join([*text, "", *_verdict(rows)])


def as_markdown(rows: Sequence[Row]) -> str:
    """A table for the documentation, with each case's sentence."""
    lines = ["| " + " | ".join((*HEAD, "why it is hard")) + " |", "|---|---|---|--:|--:|--:|--:|---|"]
    lines += [
        "| " + " | ".join(c.replace("|", "\\|") for c in (*_cells(row), row.why)) + " |" for row in rows
    ]
    return "\n".join([*lines, "", *_verdict(rows)]) + "\n"


def worst_shares(rows: Iterable[Row]) -> dict[str, float]:
    """Largest error over condition (at least 1) of each quantity, in ulp."""
    worst: dict[str, float] = {}
    for row in rows:
        if isfinite(row.condition):
            share = row.error / max(1.0, row.condition)
            worst[row.quantity] = max(worst.get(row.quantity, 0.0), share)
    return worst


def _verdict(rows: Sequence[Row]) -> list[str]:
    shares = ", ".join(
        f"{quantity} {_number(worst)}" for quantity, worst in sorted(worst_shares(rows).items())
    )
    failed = sum(not row.holds for row in rows)
    return [
        f"Largest error over condition, in ulp: {shares}.",
        f"{len(rows)} rows, {'all within what is allowed' if not failed else f'{failed} FAILED'}.",
    ]


def _cells(row: Row) -> tuple[str, ...]:
    return (
        row.kind,
        row.name,
        row.quantity,
        _number(row.condition),
        row.textbook if isinstance(row.textbook, str) else _number(row.textbook),
        _number(row.error),
        _number(row.allowed),
    )


def _number(value: float) -> str:
    if isinf(value):
        return "wrong" if value > 0 else "-inf"
    return "0" if value == 0 else f"{value:.2g}"
