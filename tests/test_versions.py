"""Versions in pyproject.toml agree with its constraints."""

from __future__ import annotations

import tomllib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest
from lowest_versions import lowest
from packaging.requirements import Requirement
from packaging.version import Version

ASKED = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
REQUIREMENTS = [
    Requirement(one)
    for one in [
        *ASKED["dependencies"],
        *(one for extra in ASKED["optional-dependencies"].values() for one in extra),
    ]
]


def test_every_requirement_has_one_constraint_the_least_version_it_allows():
    held = dict(line.split("==") for line in lowest())
    assert held.keys() == {one.name for one in REQUIREMENTS}
    for one in REQUIREMENTS:
        [bound] = [part.version for part in one.specifier if part.operator == ">="]
        assert held[one.name] == bound
        assert one.specifier.contains(bound)


@pytest.mark.parametrize("text", ["numpy", "numpy>2", "numpy==2.1"])
def test_a_requirement_without_a_lower_bound_is_refused(tmp_path, text):
    project = tmp_path / "pyproject.toml"
    project.write_text(f'[project]\ndependencies = ["{text}"]\n')
    with pytest.raises(ValueError, match="no lower bound"):
        list(lowest(project))


def test_two_bounds_for_one_package_are_refused(tmp_path):
    project = tmp_path / "pyproject.toml"
    project.write_text('[project]\ndependencies = ["a>=1"]\noptional-dependencies = {x = ["a>=2"]}\n')
    with pytest.raises(ValueError, match="a has two lower bounds, 1 and 2"):
        list(lowest(project))


def test_no_bound_is_above_what_is_installed():
    for one in REQUIREMENTS:
        try:
            here = version(one.name)
        except PackageNotFoundError:
            continue
        assert one.specifier.contains(Version(here)), one
