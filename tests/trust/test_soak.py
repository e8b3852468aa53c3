"""Random valid designs export and verify; tests/benchmarks/soak_designs.py is the long form, soak.json its record."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import pytest

SCRIPT = Path(__file__).parents[1] / "benchmarks" / "soak_designs.py"


@pytest.fixture(scope="module")
def soak() -> ModuleType:
    import sys

    spec = importlib.util.spec_from_file_location("soak_designs", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look there for their annotations
    spec.loader.exec_module(module)
    return module


def test_the_recorded_soak_has_500_valid_designs_and_no_failure(soak: ModuleType) -> None:
    kept = json.loads(soak.RECORD.read_text())
    assert kept["valid"] >= 500
    assert kept["passed"] == kept["valid"]
    assert kept["failed"] == {}


@pytest.mark.slow
@pytest.mark.parametrize("number", [1, 218])
def test_a_random_design_is_exported_and_verified(soak: ModuleType, tmp_path: Path, number: int) -> None:
    assert soak.judge(number, tmp_path) == ("passed", "")


@pytest.mark.long
def test_forty_random_designs_are_exported_and_verified(soak: ModuleType) -> None:
    tally = soak.Tally(next=10_000)
    soak.soak(tally, 40, float("inf"), None)
    assert tally.failed == {}
    assert tally.passed == 40
