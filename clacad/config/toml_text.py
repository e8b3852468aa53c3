"""Parser from the text of a file to nested dictionaries, where every syntax error is described and located,
and the files that it names.

Design files and scene files are read in the same way; `what` is the word that messages use for the file.
"""

from __future__ import annotations

import json
import os
import re
import tomllib
from dataclasses import replace
from errno import EFBIG, ENOENT
from typing import Any, Final, NoReturn

from clacad.base.text import DEEPEST, beyond_64_bits, did_you_mean, near, plain
from clacad.base.untrusted_files import BUDGETS, read_regular
from clacad.config.mistakes import DesignError, Mistake, Place, design_error, find, syntax_place, too_large
from clacad.config.value_kinds import kind_of

LARGEST_FILE: Final = BUDGETS["design"].bytes
MOST_MARKS: Final = BUDGETS["design"].items or 0


def read_text(name: str, what: str = "design") -> str:
    """Read a UTF-8 text of at most 1 MB and 200,000 lines and keys; a larger file is refused unread.

    Raises DesignError: With one mistake: no such file; a pipe, device or folder in place of a file; not
        UTF-8.
    Raises DesignTooLarge.
    """
    try:
        raw = read_regular(name, LARGEST_FILE)
    except OSError as problem:
        if problem.errno == EFBIG:
            why = f"the file is too large for a {what}"
            raise too_large("CL100", why, path=name, allowed="up to 1 MB") from None
        why = (problem.strerror or str(problem)).lower()
        hint = _nearest_file(name) if problem.errno == ENOENT else ""
        raise design_error("CL100", f"cannot read the {what}: {why}", path=name, hint=hint) from problem
    except ValueError:
        raise design_error(
            "CL100", f"cannot read the {what}: the name holds a zero byte", path=name.replace("\0", "?")
        ) from None
    if sum(map(raw.count, (b"\n", b"=", b":"))) > MOST_MARKS:
        why = f"too many lines and keys for a {what}"
        raise too_large("CL100", why, path=name, allowed=f"up to {MOST_MARKS:,}")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        line = raw.count(b"\n", 0, problem.start) + 1
        column = problem.start - raw.rfind(b"\n", 0, problem.start)
        raise design_error(
            "CL100",
            "the file is not UTF-8 text",
            path=name,
            line=line,
            column=column,
            found=f"byte 0x{raw[problem.start]:02x}",
            hint="save it as UTF-8",
        ) from problem


def _nearest_file(name: str) -> str:
    folder, base = os.path.split(name)
    try:
        listed = sorted(
            entry
            for entry in os.listdir(folder or ".")
            if entry.endswith((".toml", ".json")) and entry != base
        )
    except (OSError, ValueError):
        return ""
    found = near(base, listed) or near(base + ".toml", listed)
    return did_you_mean([os.path.join(folder, name) for name in found])


def parse(text: str, name: str, what: str = "design") -> dict[str, Any]:
    """Parse TOML (JSON, if the name ends in .json) into nested dictionaries.

    Raises DesignError: With one mistake: the first syntax error, nesting beyond 64 levels, a duplicate JSON
        key.
    """
    is_json = name.lower().endswith(".json")
    _refuse_deep_keys(text, name)
    try:
        data = json.loads(text) if is_json else tomllib.loads(text)
    except RecursionError:
        raise design_error("CL100", f"nested more than {DEEPEST} deep", path=name) from None
    except ValueError as problem:
        slip = re.sub(
            r"exceeds the limit.*integer string conversion.*",
            "a whole number of thousands of digits",
            str(problem),
            flags=re.I,
        )
        slip = re.sub(r" \(at .*\)$|: line [0-9]+ column.*$", "", slip)[:200]
        slip = re.sub(r"\('(.*)',\)", r"[\1]", slip)
        _refuse_syntax(
            f"not {'JSON' if is_json else 'TOML'}: {slip[:1].lower()}{slip[1:]}",
            name,
            text,
            syntax_place(problem, text),
        )
    if not isinstance(data, dict):
        raise design_error("CL104", f"a {what} is a table, not {kind_of(data)}", path=name, line=1, column=1)
    if too_deep(data):
        raise design_error("CL100", f"nested more than {DEEPEST} deep", path=name)
    twins = find(text, name).twins if is_json else []
    if twins:
        _refuse_syntax(f"not a {what}: a key that is there twice", name, text, twins[0])
    return data


def toml_value(text: str) -> Any:
    """Read one value in TOML syntax; a leading 0 before the decimal point may be left out.

    Raises ValueError: The text is no value, or holds an integer of more than 64 bits, which TOML does not
        have.
    """
    try:
        text = re.sub(r"^([+-]?)[.](?=[0-9])", r"\g<1>0.", text)
        value = tomllib.loads(f"value = {text}")["value"]
    except RecursionError:
        raise ValueError("nested too deep") from None
    if beyond_64_bits(value):
        raise ValueError("a whole number of more than 64 bits")
    return value


def top_keys(name: str) -> frozenset[str]:
    """Keys and sections at the top of a file; empty where it cannot be read: its reader reports why."""
    try:
        return frozenset(parse(read_text(name), name))
    except DesignError:
        return frozenset()


def _refuse_syntax(message: str, name: str, text: str, place: Place) -> NoReturn:
    line = re.split("\r\n|\n", text)[place.line - 1]
    mistake = Mistake("CL101", message, path=name, line=place.line, column=place.column, width=place.width)
    raise DesignError([replace(mistake, source_line=line, hint=_syntax_hint(line))])


def _syntax_hint(line: str) -> str:
    """Hint for the three most common errors in TOML: a unit or a word without quotes, a decimal comma."""
    _, equals, value = line.partition("=")
    value = value.split("#")[0].strip()
    if not equals or not value:
        return ""
    if re.fullmatch(r"[+-]?[0-9]+,[0-9]+", value):
        return f"write {value.replace(',', '.')}: the decimal sign is a point"
    if re.fullmatch(r"[+-]?[0-9.]+(e[+-]?[0-9]+)? ?[^\s\d\[\]\"',]+", value) or re.fullmatch(
        r"[A-Za-z][\w -]*", value
    ):
        return f'write "{value}" in quotes'
    return ""


def _refuse_deep_keys(text: str, name: str) -> None:
    """Refuse dotted keys of more than 64 parts before parsing, whose time grows as their square."""
    for number, line in enumerate(text.split("\n"), 1):
        if line.count(".", 0, 100_000) > DEEPEST and re.match(r"\s*\[*\s*(?:[^.=#\"'\[\]]*\.){65}", line):
            raise design_error(
                "CL100",
                f"a key nested more than {DEEPEST} deep",
                path=name,
                line=number,
                column=1,
                source_line=line,
            )


def too_deep(data: Any) -> bool:
    """Whether tables and lists are nested more than 64 levels deep."""
    level, depth = [data], 0
    while level:
        depth += 1
        if depth > DEEPEST:
            return True
        level = [
            item
            for part in level
            if isinstance(part, dict | list)
            for item in (part.values() if isinstance(part, dict) else part)
        ]
    return False


def given_table(data: object, what: str = "design") -> dict[str, Any]:
    """Nested dictionaries as a file of that kind would give them.

    Raises DesignError: The data are no dictionary, or nested more than 64 levels deep.
    """
    given = plain(data, float)
    if not isinstance(given, dict):
        raise design_error("CL104", f"a {what} is a table, not {kind_of(given)}")
    if too_deep(given):
        raise design_error("CL100", f"nested more than {DEEPEST} deep")
    return given


def folder_of(path: str) -> str:
    """Folder to which file names in the file at `path` are relative."""
    return os.path.dirname(path) or "."


def outside(folder: str, name: str, levels: int = 0, whose: str = "design") -> str:
    """Return why a name is refused ("" if it is allowed): relative, inside the folder or `levels` above it.

    Links are resolved first, so that none leads out.

    levels : Number of parent folders that may be reached.
    whose : Kind of the file that contains the name, for the message.
    """
    if os.path.isabs(name) or "\0" in name or (len(name) > 1 and name[1] == ":"):
        return "is not a relative path"
    home = os.path.realpath(os.path.join(folder, *[os.pardir] * levels))
    real = os.path.realpath(os.path.join(folder, name))
    if os.path.commonpath([home, real]) != home:
        parents = ("", " and its parent", " and its parent folders")[min(levels, 2)]
        return f"lies outside the {whose}'s folder{parents}"
    return ""
