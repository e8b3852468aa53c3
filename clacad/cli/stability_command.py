"""`clacad accuracy --hard`: the stability table, measured with the installed arithmetic."""

from __future__ import annotations

from clacad.cli.console import show_json, show_text


def show_hard(*, json: bool, quiet: bool) -> int:
    """Measure the hard cases and print the table; exit 1 where a row exceeds what is allowed."""
    from clacad.verification.stability import as_dict, as_text, stability_table

    rows = stability_table()
    if json:
        show_json(as_dict(rows))
    else:
        show_text(as_text(rows), quiet=quiet)
    return 0 if all(row.holds for row in rows) else 1
