"""Pages a person reads: README, CONTRIBUTING and CHANGELOG name files and modules that exist."""

from __future__ import annotations

import doctest
import re
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

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
    for page in ("README.md", "CONTRIBUTING.md"):
        words = set(re.findall(r"\w+", (ROOT / page).read_text(encoding="utf-8")))
        assert rooms <= words, page


def python_of_the_readme() -> str:
    """The block of README.md that shows the Python interface."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"## Python\n\n```python\n(.*?)```", text, re.S)
    return block


def test_the_first_ray_of_the_readme_obeys_the_law_as_its_comment_says(monkeypatch, capsys):
    """The lines up to the first that builds something else; the angle to the law is within three times the sheet's rms."""
    monkeypatch.chdir(ROOT)
    names: dict[str, Any] = {}
    exec(python_of_the_readme().partition("longer = ")[0], names)
    assert "ALIVE" in capsys.readouterr().out
    asked = names["design"].law.refract(names["rays"].direction)
    assert float(angle_between(names["result"].direction, asked)[0]) < 3.0 * 2.65e-3


def with_examples() -> list[str]:
    """Modules of the package whose docstrings show calls."""
    files = [path for path in PACKAGE.rglob("*.py") if ">>> " in path.read_text(encoding="utf-8")]
    return sorted(".".join(path.relative_to(ROOT).with_suffix("").parts) for path in files)


@pytest.mark.parametrize("module", with_examples())
def test_every_example_in_a_docstring_prints_what_it_says(module, monkeypatch):
    monkeypatch.chdir(ROOT)
    found = doctest.testmod(
        import_module(module), optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    )
    assert found.attempted > 0
    assert found.failed == 0


@pytest.mark.slow
def test_the_python_of_the_readme_runs_as_it_stands(tmp_path, monkeypatch):
    """In a folder with the designs; what the main job writes is left out of the last line."""
    block = python_of_the_readme()
    assert block.count('files="exports/paper"') == 1
    (tmp_path / "designs").symlink_to(ROOT / "designs")
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(block.replace(', files="exports/paper"', ""), names)
    assert 0.05 < names["pair"].share < 1.0
    assert names["better"].after[1].law_rms < 0.5 * names["better"].before[1].law_rms
    assert {"result", "pair", "found", "better", "parts", "passing", "report"} <= set(names)
    assert {"page.html", "sliders.html"} <= {path.name for path in tmp_path.iterdir()}
