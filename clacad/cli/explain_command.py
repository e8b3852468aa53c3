"""`clacad explain`, `clacad doctor`, `clacad schema`: help with words, with the installation, for editors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from clacad.base.text import short_size_text
from clacad.cli.command import Command, commands, flag, option
from clacad.cli.console import Brief, Console, facts, show_json, table

if TYPE_CHECKING:
    from clacad.doctor import Diagnosis
    from clacad.explain.design_mistakes import Entry


@dataclass(frozen=True, kw_only=True)
class Explain:
    """What a code, a check or a word means, why it matters, what to do."""

    code: str | None = option("CODE", "A code (CL337), a check (wall) or a word (eta); default: list all.")


def explain(request: Explain, console: Console) -> int:
    """Print one explanation, or the list of all."""
    from clacad.explain.look_up import entries
    from clacad.explain.look_up import explain as look_up

    own = _command_entries()
    if request.code is None:
        known = list(entries(own).values())
        console.show(
            lambda: [asdict(entry) for entry in known], lambda: _list_text(known), lambda: _list_brief(known)
        )
    else:
        entry = look_up(request.code, own)
        console.show(lambda: asdict(entry), lambda: _entry_text(entry))
    return 0


def _command_entries() -> list[Entry]:
    """Entries of the commands, from the registry."""
    from clacad.explain.design_mistakes import Entry

    return [
        Entry(
            "",
            one.word,
            f"command {one.word}",
            one.sentence,
            "",
            "",
            f"see clacad {one.word} --help",
            "command",
        )
        for one in commands()
    ]


def _list_text(known: Sequence[Entry]) -> str:
    return table([[e.code or "word", e.title, e.name if e.code else ""] for e in known], indent="")


def _list_brief(known: Sequence[Entry]) -> Brief:
    """Names of each kind of entry: codes of mistakes, checks, words, materials and others."""
    groups: dict[str, list[str]] = {}
    for entry in known:
        groups.setdefault(entry.kind, []).append(entry.name.removeprefix(f"{entry.kind} ") or entry.code)
    rows = [
        (f"{kind}{'es' if kind[-1] == 's' else 's'}", str(len(names)), ", ".join(names))
        for kind, names in groups.items()
    ]
    head = f"clacad explain NAME explains one of {len(known)} names"
    return Brief(head, (facts(rows),))


def _entry_text(entry: Entry) -> str:
    lines = [" ".join(part for part in (entry.code, entry.title) if part), f"  {entry.means}"]
    named = (("why", entry.why), ("formula", entry.formula), ("what to do", entry.do))
    return "\n".join([*lines, *(f"  {name}: {text}" for name, text in named if text)])


# -- doctor --------------------------------------------------------------------------------------------------

MARKS = {"ok": "ok", "warn": "warn", "fail": "FAIL", "absent": "-"}


@dataclass(frozen=True, kw_only=True)
class Doctor:
    """What this installation can do: packages, kernel, memory, disk, caches."""

    folder: Path = option("DIR", "Folder whose disk is tried.", Path("."))


def doctor(request: Doctor, console: Console) -> int:
    """Print the findings; exit 1 when something fails."""
    from clacad.doctor import examine, sound

    findings = examine(request.folder)
    passed = sound(findings)
    console.show(
        lambda: {"format": 1, "passed": passed, "findings": [finding.to_dict() for finding in findings]},
        lambda: _findings_text(findings),
        lambda: _findings_brief(findings),
    )
    return 0 if passed else 1


def _verdict(findings: Sequence[Diagnosis]) -> str:
    failed = [finding.name for finding in findings if finding.state == "fail"]
    return f"FAIL: {', '.join(failed)}" if failed else "everything clacad needs is here"


def _findings_brief(findings: Sequence[Diagnosis]) -> Brief:
    """The verdict; what fails, warns or is absent."""
    word = _verdict(findings)
    wrong = sorted(
        (one for one in findings if one.state != "ok"),
        key=lambda one: ("fail", "warn", "absent").index(one.state),
    )
    rows = ((one.name, MARKS[one.state], one.sentence) for one in wrong)
    good = f"{word}: {len(findings) - len(wrong)} of {len(findings)} findings are ok"
    return Brief(word, (facts(rows),), (), good)


def _findings_text(findings: Sequence[Diagnosis]) -> str:
    """One block a topic, one line a finding."""
    topics: dict[str, list[list[str]]] = {}
    for finding in findings:
        row = [MARKS[finding.state], finding.name, _value_text(finding), finding.sentence]
        topics.setdefault(finding.topic, []).append(row)
    blocks = (f"{topic}\n{table(rows)}" for topic, rows in topics.items())
    return "\n".join([*blocks, _verdict(findings)])


def _value_text(finding: Diagnosis) -> str:
    """Bytes and seconds with their unit."""
    value = finding.value
    if value is None:
        return "-"
    if isinstance(value, str) or finding.topic in ("threads", "rates"):
        return str(value)
    if finding.topic == "kernel":
        return f"{value:.3g} s"
    return short_size_text(value) + ("/s" if finding.name == "writing" else "")


# -- schema --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Schema:
    """Print the JSON Schema of design files, or of scene files, so that editors complete keys."""

    scene: bool = flag("--scene", "Of scene files instead of design files.")


def schema(request: Schema, console: Console) -> int:
    """Print the JSON Schema."""
    if request.scene:
        from clacad.scene.sections import scene_schema as made
    else:
        from clacad.design import json_schema as made
    show_json(made())
    return 0


COMMANDS = (
    Command("explain", "help", Explain, explain),
    Command("doctor", "help", Doctor, doctor),
    Command("schema", "make", Schema, schema),
)
