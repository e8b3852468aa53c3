"""`clacad explain`: what a code, a check or a word means and what to do about it."""

from __future__ import annotations

from dataclasses import asdict

from clacad.cli.console import show_json, show_text, table


def show_explanation(asked: str | None, *, json: bool, quiet: bool) -> int:
    """Print one explanation, or the list of all."""
    from clacad.explain.look_up import entries, explain

    if asked is None:
        known = list(entries().values())
        if json:
            show_json([asdict(entry) for entry in known])
        else:
            show_text(
                table([[e.code or "word", e.title, e.name if e.code else ""] for e in known], indent=""),
                quiet=quiet,
            )
        return 0
    entry = explain(asked)
    if json:
        show_json(asdict(entry))
        return 0
    lines = [" ".join(part for part in (entry.code, entry.title) if part), f"  {entry.means}"]
    for name, text in (("why", entry.why), ("formula", entry.formula), ("what to do", entry.do)):
        if text:
            lines.append(f"  {name}: {text}")
    show_text("\n".join(lines), quiet=quiet)
    return 0
