"""README and documentation: short, linked, and every command and example in them is one that the program takes."""

from __future__ import annotations

import ast
import inspect
import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from plain_words import ADDRESSED, LEFT_OUT

import clacad
from clacad.cli.command import Common, find, parameters, scan
from clacad.design.sections import ROOT as TOP
from clacad.design.sections import SECTIONS
from clacad.scene import Scene

ROOT = Path(__file__).parents[1]
WRITTEN = {"reference", "tutorials", "_made", "_build"}
"""Folders of docs that hold generated pages."""

READ = {"bash", "console", "toml", "python", "include", "literalinclude", "toctree"}
"""Languages of blocks that a test runs or parses, and directives that the build resolves."""

PAGES = [
    ROOT / "README.md",
    *(
        p
        for p in sorted((ROOT / "docs").rglob("*.md"))
        if p.relative_to(ROOT / "docs").parts[0] not in WRITTEN
    ),
]


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def blocks(page: Path, *languages: str) -> list[str]:
    """Fenced blocks of a page in one of the languages."""
    text = page.read_text(encoding="utf-8")
    return [body for language, body in re.findall(r"```(\w+)\n(.*?)```", text, re.S) if language in languages]


def console(page: Path) -> list[list[str]]:
    """Words of every command in a page's consoles; the program without its folder."""
    lines = [
        line for body in blocks(page, "console", "bash") for line in body.replace("\\\n", " ").splitlines()
    ]
    parts = [part for line in lines for part in re.split(r"&&|;", line.removeprefix("$ "))]
    words = [shlex.split(part, comments=True) for part in parts]
    return [[one[0].removeprefix(".venv/bin/"), *one[1:]] for one in words if one]


def calls(page: Path) -> list[list[str]]:
    """Words of every call of clacad in a page's consoles."""
    return [words[1:] for words in console(page) if words[0] == "clacad"]


def test_the_readme_fits_and_leads_with_the_commands():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 130
    assert len(text.encode()) <= 8000
    first_screen = "\n".join(text.splitlines()[:50])
    assert {"<!-- window -->", "<!-- main -->", "<!-- test -->"} <= set(
        re.findall(r"<!-- \w+ -->", first_screen)
    )
    wish = '.venv/bin/clacad new window --for "eta=-1, circle=60 mm, viewing=400 mm, material=PMMA"'
    assert wish in "\n".join(text.splitlines()[:24])


def test_the_changelog_begins_with_the_version_of_the_package():
    """The version is written once, in clacad/__init__.py; pyproject.toml reads it there."""
    first = re.search(r"(?m)^## (\S+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"))
    assert first is not None
    assert first[1] == clacad.__version__


def test_commands_of_the_readme_run_in_a_fresh_clone():
    """Every command is that of the environment that the same block, or the first one, makes."""
    for body in blocks(ROOT / "README.md", "bash"):
        starts = [re.split(r"&&|;", line) for line in body.splitlines()]
        words = [part.split()[0] for line in starts for part in line if part.strip()]
        assert words[0] == "python3"
        assert all(word.startswith(".venv/bin/") for word in words[1:])


def test_a_release_of_the_changelog_takes_at_most_10_kb_under_the_usual_headings():
    releases = re.split(r"(?m)^## ", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"))[1:]
    assert all(len(one.encode()) <= 10_000 for one in releases)
    usual = {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
    assert all(set(re.findall(r"(?m)^### (.*)", one)) <= usual for one in releases)
    assert len((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").splitlines()) <= 80


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_command_line_is_one_that_the_program_reads(page):
    for words in calls(page):
        command = find(words[0])
        assert command is not None, words
        given = scan([*parameters(command.request), *parameters(Common)], words[1:], command.word)
        assert given.common() is not None
        assert given.request(command.request) is not None


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CONTRIBUTING.md"], ids=name_of)
def test_every_other_command_line_is_of_a_known_program_with_files_and_extras_that_exist(page):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for program, *words in console(page):
        assert program in {"clacad", "python3", "python", "pip", "pytest", "ruff", "mypy"}, program
        if program in {"python3", "python"}:
            assert words[:2] in (["-m", "venv"], ["-m", "sphinx"])
        extras = re.findall(r"\.\[(\w+)\]", " ".join(words)) if program == "pip" else []
        assert set(extras) <= set(project["optional-dependencies"])
        paths = [word for word in words if word.startswith("tests/")] if program == "pytest" else []
        assert all((ROOT / path).exists() for path in paths), paths


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_link_of_a_page_leads_somewhere(page):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.S)
    for target in re.findall(r"\]\(([^)#\s]+)", text):
        if "://" not in target and "_made/" not in target:
            assert (page.parent / target).exists(), target
    for target in re.findall(r"\{doc\}`([^`<]+)`", text):
        there = (page.parent / f"{target}.md").resolve()
        generated = there.parent.name == "reference" and there.name in {"python.md", *_generated()}
        assert there.exists() or generated or (there.parent.name == "tutorials" and _tutorial(there.stem)), (
            target
        )


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub and the build name them."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.S)
    heads = re.findall(r"^#+ (.*)$", text, re.M)
    return {re.sub(r"[^\w\- ]", "", head.lower()).strip().replace(" ", "-") for head in heads}


OTHER_PAGES = [ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted(ROOT.glob("exports/*.md"))]


@pytest.mark.parametrize("page", [*PAGES, *OTHER_PAGES], ids=name_of)
def test_every_file_picture_and_anchor_that_a_page_names_exists(page):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.S)
    for file, anchor in re.findall(r"\]\(([^)#\s]*)#?([^)\s]*)\)", text):
        there = page.parent / file if file else page
        if "://" in file or "_made/" in file:
            continue
        assert there.exists(), file
        assert not anchor or there.suffix != ".md" or anchor in anchors(there), f"{file}#{anchor}"


def _generated() -> set[str]:
    text = (ROOT / "docs/pages.py").read_text(encoding="utf-8")
    (table,) = re.findall(r"^REFERENCE:.*?\n\}", text, re.S | re.M)
    return {f"{name}.md" for name in re.findall(r'"([\w-]+)":', table)}


def _tutorial(stem: str) -> bool:
    return (ROOT / "designs/tutorials" / f"{stem}.py").exists()


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_design_file_of_a_page_is_toml_and_whole_ones_are_built(page):
    for body in blocks(page, "toml"):
        data = tomllib.loads(body)
        if "camera" in data:  # a scene
            assert Scene.from_dict(data, folder=str(ROOT)).sheets
        elif "format" in data:
            assert clacad.prescribe(clacad.Design.from_dict(data)).lattice.cell_count > 0


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_key_in_a_design_file_of_a_page_is_one_that_the_reader_knows(page):
    for body in blocks(page, "toml"):
        for key, value in {} if "[camera]" in body else tomllib.loads(body).items():
            assert key in SECTIONS or key in TOP, key
            assert not isinstance(value, dict) or set(value) <= set(SECTIONS[key]), (key, set(value))


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_call_of_clacad_in_python_code_of_a_page_fits_the_function(page):
    for body in blocks(page, "python"):
        for node in ast.walk(ast.parse(body)):
            if (
                isinstance(node, ast.Attribute)
                and isinstance(node.value, ast.Name)
                and node.value.id == "clacad"
            ):
                assert node.attr in clacad.__all__, node.attr
            if isinstance(node, ast.Call) and ast.unparse(node.func).startswith("clacad."):
                function = getattr(clacad, ast.unparse(node.func).split(".")[1])
                given = {word.arg: None for word in node.keywords if word.arg}
                inspect.signature(function).bind(*node.args, **given)


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_block_of_a_page_is_of_a_language_that_is_run_or_parsed(page):
    text = page.read_text(encoding="utf-8")
    opened = re.findall(r"(?m)^`{3,}(.*)$", text)[::2]
    assert {word.split("}")[0].strip("{ ").split()[0] for word in opened} <= READ


def runs(page: Path) -> list[object]:
    """Blocks of Python of a page, as cases of a test."""
    return [pytest.param(body, id=f"{name_of(page)}-{k}") for k, body in enumerate(blocks(page, "python"))]


@pytest.mark.slow
@pytest.mark.parametrize("body", [case for page in PAGES for case in runs(page)])
def test_python_code_of_a_page_runs_from_first_to_last_line(body, tmp_path):
    (tmp_path / "designs").symlink_to(ROOT / "designs")
    made = [sys.executable, "-m", "clacad", "export", "designs/paper-a-covered.toml", "-o", "exports/paper"]
    env = {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg"}
    for call in ([*made, "--format", "step"], [sys.executable, "-c", body]):
        done = subprocess.run(call, cwd=tmp_path, env=env, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]


TEMPLATES = sorted((ROOT / "clacad").rglob("*.html.j2"))
"""Texts of reports and of the explorer."""

OF_THE_PAGE = r"\{[{%].*?[%}]\}|<style.*?</style>|<[^>]*>"
"""What no reader of a page made from a template sees."""


@pytest.mark.parametrize(
    "page", [*PAGES, *(ROOT / name for name in ("CHANGELOG.md", "CONTRIBUTING.md")), *TEMPLATES], ids=name_of
)
def test_a_page_has_none_of_the_words_that_need_a_second_reading(page):
    text = page.read_text(encoding="utf-8")
    if page in TEMPLATES:
        text = re.sub(OF_THE_PAGE, "", text, flags=re.S)
    quoted = re.compile(r"`[^`]*`|\"[^\"]*\"")
    assert [] == [
        f"{number}: {match[0]!r}: write {instead}"
        for number, line in enumerate(text.splitlines(), 1)
        for pattern, instead in LEFT_OUT.items()
        for match in re.finditer(rf"\b(?:{pattern})\b", quoted.sub("", line), re.IGNORECASE)
        if not re.fullmatch(ADDRESSED, match[0], re.IGNORECASE)
    ]


@pytest.mark.slow
def test_the_window_of_the_readme_is_found_made_and_proved(tmp_path):
    (body,) = [one for one in blocks(ROOT / "README.md", "bash") if "clacad new window" in one]
    install = "python3 -m venv .venv && .venv/bin/pip install -q . && "
    assert body.startswith(install)
    script = body.removeprefix(install).replace(".venv/bin/clacad ", f"{sys.executable} -m clacad ")
    done = subprocess.run(
        ["bash", "-eu", "-c", script], cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    assert (tmp_path / "exports/window/report/report.html").exists()
