"""The least versions that pyproject.toml promises, as constraints for pip: one "name==version" a line.

Use: python tests/lowest_versions.py > lowest.txt, then pip install -c lowest.txt .
"""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

PROJECT = Path(__file__).parents[1] / "pyproject.toml"


def lowest(project: Path = PROJECT) -> Iterator[str]:
    """Constraints of all direct requirements, those of the extras too, each once, by name."""
    asked = tomllib.loads(project.read_text(encoding="utf-8"))["project"]
    extras = asked.get("optional-dependencies", {}).values()
    found: dict[str, str] = {}
    for requirement in [*asked["dependencies"], *(one for extra in extras for one in extra)]:
        bound = re.fullmatch(r"([A-Za-z0-9_.-]+)(?:\[[^]]*\])?>=([0-9][0-9a-z.]*)(?:,<[0-9.]+)?", requirement)
        if bound is None:
            raise ValueError(f"{project.name}: {requirement!r} has no lower bound of the form NAME>=VERSION")
        name, version = bound.groups()
        if found.setdefault(name, version) != version:
            raise ValueError(f"{project.name}: {name} has two lower bounds, {found[name]} and {version}")
    for name in sorted(found):
        yield f"{name}=={found[name]}"


if __name__ == "__main__":
    sys.stdout.write("".join(f"{line}\n" for line in lowest()))
