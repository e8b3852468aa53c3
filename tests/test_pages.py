"""Pages a person reads: README, CONTRIBUTING and CHANGELOG name files and modules that exist."""

from __future__ import annotations

import doctest
import inspect
import re
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

import clacad
from clacad.optics.law import angle_between

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "clacad"

MADE = ("exports/paper", "report/report.html", "/NAME.py")
"""What a reader makes: the main job's folder, a file of a name of one's own."""


def named(page: str) -> set[str]:
    """Paths a page names: between backticks, in links, and in its commands."""
    text = (ROOT / page).read_text(encoding="utf-8")
    blocks = re.findall(r"```.*?```", text, re.S)
    found = set(re.findall(r"`([\w./<>-]+)`", re.sub(r"```.*?```", "", text, flags=re.S)))
    found |= set(re.findall(r"\]\(([^)#:]+)\)", text))
    found |= {word for block in blocks for word in re.findall(r"(?:tests|designs|clacad)/[\w./-]+", block)}
    paths = {one for one in found if "/" in one or one.endswith((".py", ".md"))}
    return {one.rstrip("/.") for one in paths if not any(made in one for made in MADE)}


def there(path: str) -> bool:
    """Whether a path is one of the repository, of the package, or a room within a room."""
    return any((base / path).exists() for base in (ROOT, PACKAGE)) or any(
        one.is_dir() for one in PACKAGE.glob(f"*/{path}")
    )


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md", "exports/README.md"])
def test_every_path_a_page_names_exists(page):
    assert named(page)
    assert [path for path in sorted(named(page)) if not there(path)] == []


def test_every_room_is_on_the_map_of_the_house():
    rooms = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    words = set(re.findall(r"\w+", (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")))
    assert rooms <= words


def python_of_the_readme() -> str:
    """The block of the README that shows the Python interface."""
    return python_of("README.md")


def python_of(page: str) -> str:
    """The one block of Python of a page."""
    (block,) = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.S)
    return block


def test_the_first_ray_of_the_readme_obeys_the_law_as_its_comment_says(monkeypatch, capsys):
    """The angle to the law is within three times the sheet's rms."""
    monkeypatch.chdir(ROOT)
    names: dict[str, Any] = {}
    exec(python_of_the_readme(), names)
    assert "ALIVE" in capsys.readouterr().out
    asked = names["design"].law.refract(names["rays"].direction)
    assert float(angle_between(names["result"].direction, asked)[0]) < 3.0 * 2.65e-3


SECONDS_LONG = {
    "advise",
    "design_for",
    "fix",
    "accuracy",
    "write_before_and_after",
    "export",
    "measure",
    "verify",
}
"""Public functions whose examples search, trace or write for seconds; other tests call each of them."""


def with_examples() -> list[Any]:
    """Modules of the package whose docstrings show calls."""
    files = [path for path in PACKAGE.rglob("*.py") if ">>> " in path.read_text(encoding="utf-8")]
    names = sorted(".".join(path.relative_to(ROOT).with_suffix("").parts) for path in files)
    slow = {getattr(clacad, name).__module__ for name in SECONDS_LONG}
    return [pytest.param(name, marks=[pytest.mark.slow] * (name in slow)) for name in names]


@pytest.mark.parametrize(
    "name", [name for name in clacad.__all__ if inspect.isfunction(getattr(clacad, name))]
)
def test_every_public_function_has_an_example_and_a_first_paragraph_of_its_own(name):
    """The first paragraph begins with a verb and is a whole sentence."""
    first, *rest = (inspect.getdoc(getattr(clacad, name)) or "").split("\n\n")
    assert re.match(r"[A-Z][a-z]+ .*[a-z]", first)
    assert first.endswith((".", "?"))
    assert any(re.match(r"Examples\n-+\n", part) for part in rest)
    assert any(re.search(r"(?m)^>>> .*\b" + name + r"\(", part) for part in rest), name


@pytest.mark.parametrize("name", clacad.__all__)
def test_no_word_of_a_public_docstring_is_read_as_a_link(name):
    """A word that ends in _ is a link to nowhere for the documentation, unless it is code."""
    value = getattr(clacad, name)
    own = vars(value).values() if inspect.isclass(value) else ()
    texts = [inspect.getdoc(one) or "" for one in (value, *own) if inspect.isroutine(one) or one is value]
    words = [
        word for text in texts for word in re.findall(r"\w_(?=[\s.,;:)]|$)", re.sub(r"`[^`]*`", "", text))
    ]
    assert words == []


@pytest.mark.parametrize("module", with_examples())
def test_every_example_in_a_docstring_prints_what_it_says(module, monkeypatch):
    monkeypatch.chdir(ROOT)
    found = doctest.testmod(
        import_module(module), optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    )
    assert found.attempted > 0
    assert found.failed == 0


@pytest.mark.slow
def test_the_python_of_the_documentation_runs_as_it_is(tmp_path, monkeypatch):
    """In a folder with the designs; what the main job writes is left out of the last line."""
    block = python_of("docs/how-to/python.md")
    assert block.count('files="exports/paper"') == 1
    (tmp_path / "designs").symlink_to(ROOT / "designs")
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(block.replace(', files="exports/paper"', ""), names)
    assert 0.05 < names["pair"].share < 1.0
    assert names["better"].after[1].law_rms < 0.5 * names["better"].before[1].law_rms
    assert {"result", "pair", "found", "better", "parts", "passing", "report"} <= set(names)
    assert {"page.html", "sliders.html"} <= {path.name for path in tmp_path.iterdir()}
