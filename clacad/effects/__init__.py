"""Physical effects beyond refraction, one file an effect, and the planner that chooses among them.

Geometry (cells, offset, vignetting, fates, a baffle) belongs to the tracer's rungs and is always simulated.
Importing this package loads no effect; accessing an effect's name loads that one. To add an effect, write its
module with a `DECLARED` and name the module in `NAMES`.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clacad.effects.engine.effect import Declaration

NAMES = (
    "ghosts",
    "walls",
    "fresnel",
    "absorption",
    "dispersion",
    "reflections",
    "tir_paths",
    "diffraction",
    "scatter",
    "polarisation",
    "depth_of_field",
    "facets",
)
"""Effects in the order in which plans list them and passes of one kind run."""

_HOME = {
    "Effect": "engine.effect",
    "trace_with": "engine.passes",
    "Setting": "engine.effect",
    "LightRays": "engine.homogeneous_light",
    "light_reaching_camera": "engine.camera_light",
    "Plan": "engine.plan",
    "plan_effects": "engine.plan",
    "plan_sheets": "engine.plan",
}

__all__ = sorted(["NAMES", *_HOME])


@cache
def declared(name: str) -> Declaration:
    """Declaration of an effect; its module is imported on first use. Raises ValueError: An unknown name."""
    if name not in NAMES:
        raise ValueError(f"no effect is called {name!r}; known are {', '.join(NAMES)}")
    found: Declaration = import_module(f"clacad.effects.{name}").DECLARED
    return found


def declared_all(names: Iterable[str]) -> tuple[Declaration, ...]:
    """Declarations of several effects, in the order of the names."""
    return tuple(declared(name) for name in names)


def __getattr__(name: str) -> Any:
    """Import a public name from its module when it is first used."""
    if name not in _HOME:
        raise AttributeError(f"module 'clacad.effects' has no attribute {name!r}")
    return getattr(import_module(f"clacad.effects.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
