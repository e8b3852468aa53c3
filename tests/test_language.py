"""Plain technical English: words that comments and docstrings of the package and its tests do not use, and their replacements."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest
from package_source import syntax

TESTS = Path(__file__).parent
PACKAGE = TESTS.parent / "clacad"

LEFT_OUT = {
    r"tells?|told|says?|said": "reports, returns, prints, records, gives; states (of a file or a person)",
    r"stands?(?!-alone)|stood|standing": "is, lies at, is located at, is mounted; represents",
    r"beside": "next to, with, compared with, in addition to",
    r"held (?:against|to)": "compared with, checked against",
    r"asks?|asked(?! questions)": "requests, requested, specified",
    r"so many|so manieth": "count of, number of, every n-th",
    r"shall": "must, will",
    r"a hair": "tolerance, rounding error",
    r"anew": "again, from scratch",
    r"for ever": "forever, until the process ends",
    r"whatever|whoever": "regardless of, any",
    r"lessens?": "reduces",
    r"hangs? on": "depends on",
    r"cells differ|differing cells": "non-uniform sheet",
    r"equal cells": "uniform sheet, identical cells",
    r"strangers?(?:'s)?": "untrusted file",
    r"came back|comes back": "was measured, is returned",
    r"stand-ins?": "substitute, representative cell",
    r"overheard": "hash while reading",
    r"worked out|works out": "computed, derived",
    r"one and the other": "both, all, each",
}
"""Words, as regular expressions → what is written instead."""

ADDRESSED = r"asks?|says?"
"""Words that a message may use, as in "ask to overwrite" and "the manifest says"."""


def prose(text: str) -> Iterator[tuple[int, str]]:
    """Lines of comments and docstrings (strings that are statements), with their numbers."""
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string
    for node in ast.walk(ast.parse(text)):
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ):
            for k, line in enumerate(node.value.value.split("\n")):
                yield node.lineno + k, line


def found(path: Path) -> list[str]:
    """Places of words that are left out, with what to write."""
    quoted = re.compile(r"`[^`]*`|\"[^\"]*\"")
    return [
        f"{path.relative_to(TESTS.parent)}:{number}: {match[0]!r}: write {instead}"
        for number, line in prose(path.read_text(encoding="utf-8"))
        for pattern, instead in LEFT_OUT.items()
        for match in re.finditer(rf"\b(?:{pattern})\b", quoted.sub("", line), re.IGNORECASE)
    ]


def in_messages(path: Path) -> list[str]:
    """Places of left-out words in texts of several words that are no docstrings."""
    tree = syntax(path)
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    return [
        f"{path.relative_to(PACKAGE)}:{node.lineno}: {match[0]!r}: write {instead}"
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value
        if id(node) not in docstrings
        for pattern, instead in LEFT_OUT.items()
        for match in re.finditer(rf"\b(?:{pattern})\b", node.value, re.IGNORECASE)
        if not re.fullmatch(ADDRESSED, match[0], re.IGNORECASE)
    ]


def rooms(root: Path) -> list[Path]:
    """Folders and single files of a folder that hold Python code, less the file of the left-out words itself."""
    paths = {root / path.relative_to(root).parts[0] for path in root.rglob("*.py")}
    return sorted(paths - {Path(__file__)})


@pytest.mark.parametrize(
    "room", [*rooms(PACKAGE), *rooms(TESTS)], ids=lambda p: str(p.relative_to(TESTS.parent))
)
def test_comments_and_docstrings_use_plain_words(room: Path) -> None:
    paths = sorted(room.rglob("*.py")) if room.is_dir() else [room]
    assert [] == [words for path in paths for words in found(path)]


def test_messages_use_plain_words() -> None:
    assert [] == [words for path in sorted(PACKAGE.rglob("*.py")) for words in in_messages(path)]


def test_the_words_are_found_in_comments_and_docstrings_alone(tmp_path: Path) -> None:
    text = 'def f():\n    """What stands\n    beside it."""\n    return "whatever"  # asked for\n'
    lines = [(number, line.strip()) for number, line in prose(text)]
    assert lines == [(4, "# asked for"), (2, "What stands"), (3, "beside it.")]
