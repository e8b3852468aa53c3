"""One module declares an effect: nothing else in the package knows its name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from package_source import literals

import clacad
from clacad import effects as registry
from clacad.cli import main
from clacad.effects import NAMES, declared
from clacad.explain.look_up import named_things

PACKAGE = Path(clacad.__file__).parent
DESIGNS = PACKAGE.parent / "designs"

OTHER_MEANINGS = {"ghosts", "walls", "facets", "diffraction", "scatter"}
"""Words that are keys of reports and tables too."""

TOY = '''"""Sunglasses: a grey filter behind the sheet.

*Model.* Flux × 1/4 of every ray.
*Law.* The same for every direction.
*On when* a quarter of the light is more than what matters.
"""

from clacad.effects.engine.effect import Bound
from clacad.effects.engine.effect import Declaration, Effect, When

NAME = "sunglasses"


def effect(window, setting):
    """One multiplication."""

    def apply(block, crossing):
        block.result.flux[:] *= 0.25

    return Effect(NAME, When.EXIT, apply=apply)


def bound(situation):
    """Three quarters of the light."""
    return Bound(0.0, 0.75, "a grey filter takes three quarters of the light", 1.0)


DECLARED = Declaration(NAME, effect, bound)
'''


@pytest.fixture
def sunglasses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "sunglasses.py").write_text(TOY, encoding="utf-8")
    monkeypatch.setattr(clacad.effects, "__path__", [*clacad.effects.__path__, str(tmp_path)])
    monkeypatch.setattr(registry, "NAMES", (*NAMES, "sunglasses"))
    return "sunglasses"


@pytest.mark.daily_cases("depth_of_field", "polarisation", "tir_paths")
@pytest.mark.parametrize("name", [name for name in NAMES if name not in OTHER_MEANINGS])
def test_the_name_of_an_effect_is_written_in_its_module_and_in_the_list_alone(name: str) -> None:
    found = {path.relative_to(PACKAGE).as_posix() for path in PACKAGE.rglob("*.py") if name in literals(path)}
    assert found == {f"effects/{name}.py", "effects/__init__.py"}


@pytest.mark.parametrize("name", NAMES)
def test_each_module_declares_the_effect_of_its_name(name: str) -> None:
    assert declared(name).name == name
    assert set(declared(name).includes) <= set(NAMES)


def test_an_effect_that_is_one_module_is_traced_planned_explained_and_offered(
    sunglasses: str, capsys: pytest.CaptureFixture[str]
) -> None:
    design = clacad.load(DESIGNS / "slab.toml").with_cells((4, 4))
    window = clacad.prescribe(design)
    rays = clacad.Rays(np.array([[0.02, 0.03, -1.0]]), np.array([[0.0, 0.0, 1.0]]))
    bare, filtered = clacad.trace(window, rays), clacad.trace(window, rays, effects=[sunglasses])
    assert filtered.flux.tolist() == (0.25 * bare.flux).tolist()
    plan = clacad.effects.plan_effects(window)
    assert plan.row(sunglasses).why == "a grey filter takes three quarters of the light"
    assert plan.row(sunglasses).state == "on"
    assert any("Sunglasses" in entry.title for entry in named_things())
    assert main(["effects", str(DESIGNS / "scenes" / "effects-narrow.toml"), "--force", "sunglass"]) == 2
    assert sunglasses in capsys.readouterr().err
