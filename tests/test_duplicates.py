"""Duplicated code: every run of six lines that is the same in two places is a missing function."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
RUN = 6
"""Number of consecutive code lines, the same to the letter, that make a double."""


def code_lines(path: Path) -> list[tuple[int, str]]:
    """Number and stripped text of each line that does something: no blank, comment, import, bracket, field or argument."""
    text = path.read_text(encoding="utf-8")
    said = {
        number
        for node in ast.walk(ast.parse(text))
        if isinstance(node, (ast.Import, ast.ImportFrom, ast.arg))
        or (isinstance(node, ast.AnnAssign) and node.value is None)
        for number in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    lines = ((number, line.strip()) for number, line in enumerate(text.splitlines(), 1))
    return [(n, line) for n, line in lines if n not in said and re.match(r"[^#]*\w", line)]


def doubles(sources: dict[str, list[tuple[int, str]]]) -> dict[tuple[str, str], list[str]]:
    """Pairs of files (one twice, where it repeats itself) that share a run: where the shared lines begin."""
    places = defaultdict(list)
    for name, lines in sources.items():
        for at in range(len(lines) - RUN + 1):
            places[tuple(line for _, line in lines[at : at + RUN])].append((name, lines[at][0]))
    found = defaultdict(list)
    for where in places.values():
        for i, (first, line) in enumerate(where):
            for second, other in where[i + 1 :]:
                found[first, second].append(f"{first}:{line} = {second}:{other}")
    return dict(found)


def sources() -> dict[str, list[tuple[int, str]]]:
    """Code lines of the package and its tests."""
    paths = [path for room in ("clacad", "tests") for path in sorted((ROOT / room).rglob("*.py"))]
    return {path.relative_to(ROOT).as_posix(): code_lines(path) for path in paths}


@pytest.mark.slow
def test_no_run_of_six_lines_stands_twice():
    places = [place for found in doubles(sources()).values() for place in found]
    assert not places, "these lines need one home:\n" + "\n".join(places)


def test_a_run_that_stands_twice_is_found_whatever_stands_between_its_lines(tmp_path):
    body = "".join(f"    a{n} = {n}\n" for n in range(RUN - 1))
    (tmp_path / "one.py").write_text(f"def one():\n    import os\n{body}    last = 1\n")
    (tmp_path / "other.py").write_text(
        f"def two():\n    b = (\n        2\n    )\n\n    # why\n{body}\n    last = 1\n"
    )
    (tmp_path / "short.py").write_text(f"def three():\n{body}")
    read = {path.name: code_lines(path) for path in sorted(tmp_path.glob("*.py"))}
    assert doubles(read) == {("one.py", "other.py"): ["one.py:3 = other.py:7"]}
