"""The package as a whole: public names, whatever was imported before them."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module
from types import ModuleType

import pytest

import clacad


@pytest.mark.parametrize("name", clacad.__all__)
def test_every_public_name_resolves_to_a_function_or_a_class(name):
    value = getattr(clacad, name)
    assert callable(value)
    assert not isinstance(value, ModuleType)
    assert value.__doc__


def test_a_verb_stays_a_verb_after_its_module_was_imported():
    code = """
import clacad, clacad.trace, clacad.export, clacad.verify
from clacad.trace import trace_sequence
assert clacad.trace is not None and callable(clacad.trace) and callable(clacad.export) and callable(clacad.verify)
from clacad import trace
assert trace is clacad.trace
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_name_that_does_not_exist_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'tracee'"):
        clacad.tracee  # noqa: B018


def test_every_module_imports_in_a_clean_checkout():
    from pathlib import Path

    root = Path(clacad.__file__).parent
    for path in sorted(root.rglob("*.py")):
        parts = path.relative_to(root.parent).with_suffix("").parts
        if parts[-1] == "__main__":
            continue
        import_module(".".join(parts[:-1] if parts[-1] == "__init__" else parts))
