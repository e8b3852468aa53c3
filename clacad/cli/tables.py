"""Tables the commands print."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from clacad.base.text import DIGITS, bound, count_text, mrad_text, short_size_text, shown, span_text
from clacad.cli.console import Entry, table

MARKS = {"pass": "ok", "fail": "FAIL", "warn": "warn", "not run": "not run"}


def derived_text(rows: Iterable[Sequence[str]]) -> str:
    """Rows of derived numbers, one block for each thing they are about."""
    blocks: dict[str, list[list[str]]] = {}
    for about, name, value, unit, means in rows:
        blocks.setdefault(about, []).append([name, value, unit, means])
    return "\n".join(f"{about}\n{table(lines)}" for about, lines in blocks.items())


def checks_text(checks: Iterable[Any]) -> str:
    """One line a check: state, id, value against limit, and the sentence where it did not pass."""
    lines = []
    for check in checks:
        name = f"{check.id} ({check.subject})" if check.subject else check.id
        value, limit = against(check)
        lines.append([MARKS[check.state], name, value, limit, check.sentence])
    return table(lines)


def problems(checks: Iterable[Any], hints: Callable[[Any], Sequence[Any]] = lambda check: ()) -> list[Entry]:
    """Entries of the checks that fail or warn, failures first, each with a hint or the remedy of its kind.

    A remedy is printed once.
    """
    order = {"fail": "FAIL", "not run": "not run", "warn": "warning"}
    shown_checks = [one for one in checks if one.state in order and (one.required or one.state != "not run")]
    found, printed = [], set()
    for check in sorted(shown_checks, key=lambda check: list(order).index(check.state)):
        value, limit = against(check, 4)
        name = f"{check.id} ({check.subject})" if check.subject else check.id
        bounds = f"{value}, limit {limit}" if limit else value
        remedy = str(next(iter(hints(check)), check.kind.do))
        below = "" if remedy in printed else f"\n           remedy: {remedy}"
        printed.add(remedy)
        text = f"  {order[check.state]:7}  {name}: {'; '.join(filter(None, (bounds, check.sentence)))}"
        found.append((name, text + below))
    return found


def counted(checks: Sequence[Any]) -> str:
    """Number of checks that pass and warn: "checks passed: 32, warnings: 1"."""
    good, warned = (sum(check.state == state for check in checks) for state in ("pass", "warn"))
    return f"checks passed: {good}" + (f", warnings: {warned}" if warned else "")


def against(check: Any, count: int = DIGITS) -> tuple[str, str]:
    """Value, and limit with its sense, of a check, in as many digits as the comparison needs."""
    value, limit, unit, note = shown(check.value, check.limit, check.relation, check.unit, check.state, count)
    value = "-" if check.value is None else value
    if check.limit is None:
        return value, ""
    return value, bound(check.relation, limit, unit) + note


def forecast_text(rows: Iterable[dict[str, Any]]) -> str:
    """Forecast of the files: facets, bytes, seconds, memory, role; or the reason of a refusal."""
    lines = [["format", "facets", "bytes", "processor", "memory", ""]]
    told = []
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
                ("" if row["exact"] else "about ") + short_size_text(row["bytes"]),
                span_text(low, high),
                f"up to {short_size_text(row['memory'][1])}",
                "; ".join(word for word in (grid, row.get("note", "")) if word),
            ]
        )
        if "role" in row:
            words = role_text(row, row.get("law_rms_limit"), row.get("facets"), row.get("stored"))
            told.append([row["format"], words])
    return table(lines) + ("\n" + table(told) if told else "")


def files_text(files: Iterable[Any], limit: float | None = None) -> str:
    """The files of a manifest: name, bytes, hash, comparisons with the design, role."""
    files = list(files)
    lines = [
        [
            entry["name"],
            short_size_text(entry["bytes"]),
            entry["sha256"][:16],
            "agrees: " + ", ".join(entry["checks"]),
        ]
        for entry in files
    ]
    roles = [
        [entry["name"], role_text(entry, limit, entry.get("triangles"), entry.get("triangles_stored"))]
        for entry in files
        if "role" in entry
    ]
    found = [[entry["name"], holds_text(entry)] for entry in files if holds_text(entry)]
    lacking = [[entry["name"], sentence] for entry in files for sentence in entry.get("left_out", ())]
    told = "\nwhat a workshop finds in them\n" + table(found) if found else ""
    text = table(lines) + told + ("\nwhat they are for\n" + table(roles) if roles else "")
    return text + ("\nwhat they do not hold\n" + table(lacking) if lacking else "")


def holds_text(entry: Mapping[str, Any]) -> str:
    """Solids or objects in a file of a manifest, and the option that changes their number; "" for none."""
    from clacad.exporting.formats import step
    from clacad.exporting.formats.format import cell_words
    from clacad.formats.step.part21 import FUSED_CELLS
    from clacad.judging.without_optics import is_fixture

    if words := cell_words(entry):
        return words
    instanced = entry.get("mode") == "instanced"
    if entry["format"] == step.WORD and "solids" in entry:
        solids, faces = int(entry["solids"]), int(entry["faces"])
        words = f"{count_text(solids, 'solid', ',')} with {faces:,} faces"
        if instanced:
            part = "sector of cells" if entry.get("own_cells") else "cell"
            return (
                f"{words}: one {part} repeated, its solids touch; the default above {FUSED_CELLS:,} cells "
                "(--fused: one a connected piece)"
            )
        if entry.get("own_cells"):
            return f"{words}, one a connected piece; no cell is repeated, for they differ"
        if all(is_fixture(name) or name.endswith(".marked") for name in entry["bodies"]):
            return f"{words}, one a connected piece"
        return (
            f"{words}, one a connected piece; the default up to {FUSED_CELLS:,} cells "
            "(--step instanced repeats one cell)"
        )
    if "objects" not in entry:
        return ""
    objects, bodies = int(entry["objects"]), " and ".join(map(str, entry["bodies"]))
    words = f"{count_text(objects, 'object', 'd')} ({bodies})"
    if not instanced:
        return f"{words}, one mesh each"
    return f"{words}, each one cell repeated {int(entry['instances']):,} times (--fused: one mesh each)"


def role_text(entry: Mapping[str, Any], limit: float | None, facets: int | None, stored: int | None) -> str:
    """A file's role, the forecast of its light, the grid of a master, and the facets in a slicer."""
    role = str(entry["role"]).replace("-", " ")
    parts = [f"{role} (declared)" if entry.get("role_declared") else role]
    if "forecast_law_rms" in entry:
        rms = entry["forecast_law_rms"]
        bound = "" if limit is None else f" (limit {mrad_text(limit, 3, unit='')})"
        parts.append(
            "too little light gets through to measure the law"
            if rms is None
            else f"light through it misses the law by {mrad_text(rms, 3)} rms{bound}"
        )
    others = [key for key in entry.get("forecast_beyond", ()) if key != "law_rms"]
    if others:
        parts.append(f"beyond the limit of {', '.join(others)}")
    if "master_quads" in entry:
        parts.append(_master_text(entry))
    if stored is not None and facets is not None and facets > stored:
        parts.append(f"{stored:,} facets stored, {facets:.2g} when a slicer expands them")
    return "; ".join(parts)


def _master_text(entry: Mapping[str, Any]) -> str:
    if entry["master_quads"] is None:
        return "no number of quads up to 1024 makes it a master"
    if entry.get("quads") is not None and entry["quads"] >= entry["master_quads"]:
        return "fine enough for a master"
    return (
        f"a master needs {entry['master_quads']} quads a cell side, about "
        f"{short_size_text(entry['master_bytes'])}"
    )


def check_text(
    title: str, derived: Iterable[Sequence[str]], checks: Iterable[Any], forecast: Iterable[dict[str, Any]]
) -> str:
    """Derived numbers, checks and forecasts of `clacad check`; the verdict is printed below."""
    from clacad.checks.light_kinds import RESIDUAL
    from clacad.verification.light.viewed import headline

    checks = list(checks)
    light = [check for check in checks if check.where.startswith("surfaces") and check.kind is not RESIDUAL]
    rules = [check for check in checks if check not in light]
    blocks = (
        derived_text(derived),
        "design rules",
        checks_text(rules),
        "light through one cell",
        checks_text(light),
        "what an export would cost",
        forecast_text(forecast),
    )
    first = headline(checks)
    return "\n".join((title, *([f"  {first}"] if first else []), *blocks))


def advice_text(advice: Any) -> str:
    """Changes that mend each failed or warned check, the best first, and changes without cost."""
    lines: list[str] = []
    for check, hints in advice.hints:
        name = f"{check.id} ({check.subject})" if check.subject else check.id
        if hints:
            told = "\n".join(f"    {hint}" for hint in hints)
        else:
            told = "    no key that was tried mends it alone"
        said = next((k for k, line in enumerate(lines) if line.endswith(f"\n{told}")), None)
        if said is None:
            lines.append(f"  {name}\n{told}")
        else:  # keys that mend several checks are printed once
            names, _, _ = lines[said].partition("\n")
            lines[said] = f"{names}, {name}\n{told}"
    told_first = ["what would mend it, each tried", *lines] if lines else []
    free = [] if advice.sharper is None else [f"what would cost nothing, tried\n    {advice.sharper}"]
    return "\n".join([*told_first, *free])
