"""Plain technical English: words that comments and docstrings of the package and its tests do not use, and their replacements."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest
from package_source import messages
from plain_words import ADDRESSED, ANY, LEFT_OUT

TESTS = Path(__file__).parent
PACKAGE = TESTS.parent / "clacad"


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
    if not ANY.search(text := path.read_text(encoding="utf-8")):
        return []
    return [
        f"{path.relative_to(TESTS.parent)}:{number}: {match[0]!r}: write {instead}"
        for number, line in prose(text)
        if ANY.search(line)
        for pattern, instead in LEFT_OUT.items()
        for match in re.finditer(rf"\b(?:{pattern})\b", quoted.sub("", line), re.IGNORECASE)
    ]


def in_messages(path: Path) -> list[str]:
    """Places of left-out words in texts of several words that are no docstrings."""
    if not ANY.search(path.read_text(encoding="utf-8")):
        return []
    return [
        f"{path.relative_to(PACKAGE)}:{node.lineno}: {match[0]!r}: write {instead}"
        for node in messages(path)
        if " " in node.value and ANY.search(node.value)
        for pattern, instead in LEFT_OUT.items()
        for match in re.finditer(rf"\b(?:{pattern})\b", node.value, re.IGNORECASE)
        if not re.fullmatch(ADDRESSED, match[0], re.IGNORECASE)
    ]


def page_prose(path: Path) -> Iterator[tuple[int, str]]:
    """Lines of comments and of texts that readers see, of scripts, shaders and templates, with their numbers.

    Names in tags, in attributes of scripts and in expressions of templates are code. A string of a script is read
    where it has several words.
    """
    text = path.read_text(encoding="utf-8")
    blank = lambda match: re.sub(r"[^\n]", " ", match[0])  # noqa: E731
    if path.suffix == ".j2":
        kept = re.sub(
            r"<(style|script)\b.*?</\1>|\{\{.*?\}\}|\{%.*?%\}|<(?!!--)[^>]*>", blank, text, flags=re.S
        )
        kept += "\n" + "\n".join(re.findall(r"(?:aria-label|title|alt)=\"([^\"{]*)\"", text))
    elif path.suffix in (".js", ".glsl"):
        token = re.compile(r"/\*.*?\*/|//[^\n]*|\"(?:[^\"\\\n]|\\.)*\"", re.S)
        kept, end = "", 0
        for match in token.finditer(text):
            read = match[0] if " " in match[0] or match[0].startswith("/") else ""
            kept += re.sub(r"[^\n]", " ", text[end : match.start()]) + read
            end = match.end()
    else:
        kept = text
    yield from enumerate(kept.split("\n"), 1)


PAGES = sorted(path for kind in ("js", "glsl", "j2", "typ", "css") for path in PACKAGE.rglob(f"*.{kind}"))


@pytest.mark.parametrize("path", PAGES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_scripts_shaders_and_templates_use_plain_words(path: Path) -> None:
    assert [] == [
        f"{path.relative_to(PACKAGE)}:{number}: {match[0]!r}: write {instead}"
        for number, line in page_prose(path)
        for pattern, instead in LEFT_OUT.items()
        for match in re.finditer(rf"\b(?:{pattern})\b", line, re.IGNORECASE)
    ]


def test_words_of_a_page_are_found_and_its_code_is_not(tmp_path: Path) -> None:
    script, template = tmp_path / "page.js", tmp_path / "page.html.j2"
    script.write_text('told("what stands"); // whatever\nsay("said");\n/* beside\n it */')
    template.write_text('<p class="said">It {{ told }} stands</p>\n<b title="beside it">\n')
    words = {
        path.suffix: [line.split() for _, line in page_prose(path) if line.split()]
        for path in (script, template)
    }
    assert words[".js"] == [['"what', 'stands"', "//", "whatever"], ["/*", "beside"], ["it", "*/"]]
    assert words[".j2"] == [["It", "stands"], ["beside", "it"]]


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
