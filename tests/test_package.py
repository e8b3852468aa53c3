"""The package as a whole: public names, regardless of earlier imports."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from types import ModuleType

import pytest
from package_source import nodes
from public_api import public_api

import clacad

RECORD = Path(__file__).parent / "data" / "public_api.txt"

AT_0_1_0 = """
Biconic Body Design DesignError Face Fate Fit Interface Law Lattice Material Mesh Quadric Rays TraceResult Window
accuracy export load plan_effects prescribe render render_movie solids tessellate trace trace_sequence verify
""".split()
"""Top-level names of the first version: none may go."""


@pytest.mark.parametrize("name", clacad.__all__)
def test_every_public_name_resolves_to_a_function_or_a_class(name):
    value = getattr(clacad, name)
    assert callable(value)
    assert not isinstance(value, ModuleType)
    assert value.__doc__


def test_the_names_of_the_first_version_are_all_there():
    assert set(AT_0_1_0) <= set(clacad.__all__)


def test_the_public_api_is_the_recorded_one():
    """A change shows in the record's difference: python tests/public_api.py > tests/data/public_api.txt."""
    assert public_api() == RECORD.read_text(encoding="utf-8")


def test_a_verb_stays_a_verb_after_its_module_was_imported():
    code = """
import clacad, clacad.tracing.trace, clacad.exporting.run, clacad.verification
import clacad.tracing.compiled.column as column
from clacad.optics.sequence import trace_sequence
assert column.__name__ == 'clacad.tracing.compiled.column'
assert type(clacad) is type(column)
assert clacad.trace is not None and callable(clacad.trace) and callable(clacad.export) and callable(clacad.verify)
from clacad import trace
assert trace is clacad.trace
"""
    subprocess.run([sys.executable, "-c", code], check=True)


USER = """
import clacad

design = clacad.load("slab", ["lattice.count = [3, 3]"])
window: clacad.Window = clacad.prescribe(design)
result: clacad.TraceResult = clacad.trace(window, clacad.Rays((0.0, 0.0, -1.0), (0.01, 0.0, 1.0)))
exits: list[float] = result.direction[:, 0].tolist()
words: str = clacad.verify(design).verdict()
share: float = clacad.stack([design, design], 1.0).share
clacad.trace(design, "rays")
clacad.tracee
"""
"""A program of a user; its last two lines are mistakes."""


@pytest.mark.slow
def test_a_type_checker_knows_every_public_name_in_the_program_of_a_user(tmp_path):
    """No argument and no result is Any; values of JSON, shapes of arrays and solids of build123d are."""
    reveal = "".join(f"reveal_type(clacad.{name})\n" for name in clacad.__all__)
    (tmp_path / "user.py").write_text(USER + reveal, encoding="utf-8")
    root = Path(__file__).parents[1]
    checker = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", root / ".mypy_cache", "user.py"]
    env = {**os.environ, "MYPYPATH": str(root)}
    done = subprocess.run(checker, cwd=tmp_path, env=env, capture_output=True, text=True, check=False)
    errors = re.findall(r"user.py:(\d+): error: .*\[(.*)\]", done.stdout)
    lines = [str(k) for k, line in enumerate(USER.splitlines(), 1) if re.match(r"clacad\.trace", line)]
    assert errors == [(lines[0], "arg-type")] * 2 + [(lines[1], "attr-defined")]
    types = dict(zip(clacad.__all__, re.findall(r'note: Revealed type is "(.*)"', done.stdout), strict=True))
    untyped = {name for name, kind in types.items() if re.search(r"(: |-> |^|list\[)Any\b", kind)}
    assert untyped == {"solids"}


def test_a_name_that_does_not_exist_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'tracee'"):
        clacad.tracee  # noqa: B018


def test_every_module_imports_in_a_clean_checkout():
    root = Path(clacad.__file__).parent
    for path in sorted(root.rglob("*.py")):
        parts = path.relative_to(root.parent).with_suffix("").parts
        if parts[-1] == "__main__":
            continue
        import_module(".".join(parts[:-1] if parts[-1] == "__init__" else parts))


def documented(text: str) -> set[str]:
    """Names that a class's docstring lists: under Parameters and Attributes, or as lines "name : meaning"."""
    lines, found, within = text.splitlines(), set(), False
    for line, below in pairwise([*lines, ""]):
        if below.startswith("---"):
            within = line in ("Parameters", "Attributes")
        elif line[:1].isalpha() and (within or re.match(r"\w+(, \w+)* : ", line)):
            for part in re.split(r", (?=\w+ :)", line):
                found |= {name for name in re.split(r",\s*", part.split(" :")[0]) if name.isidentifier()}
    return found


def test_what_a_class_documents_it_has():
    """A docstring that lists what is no field, property or argument sends its reader after nothing."""
    for path in sorted((Path(__file__).parents[1] / "clacad").rglob("*.py")):
        for node in nodes(path):
            if not isinstance(node, ast.ClassDef):
                continue
            inner = list(ast.walk(node))
            has = {n.target.id for n in node.body if isinstance(n, ast.AnnAssign)}
            has |= {n.name for n in node.body if isinstance(n, ast.FunctionDef)}
            has |= {n.attr for n in inner if isinstance(n, ast.Attribute) and isinstance(n.ctx, ast.Store)}
            has |= {a.arg for n in node.body if isinstance(n, ast.FunctionDef) and n.name == "__init__"
                    for a in n.args.args + n.args.kwonlyargs}  # fmt: skip
            assert documented(ast.get_docstring(node) or "") <= has, f"{path.name}: {node.name}"
