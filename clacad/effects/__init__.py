"""Physical effects beyond refraction, one file an effect, and the planner that chooses among them.

Geometry (cells, offset, vignetting, fates, a baffle) belongs to the tracer's rungs and is always simulated.
Importing this package loads no effect; accessing an effect's name loads that one.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_HOME = {
    "NAMES": "registry",
    "Effect": "engine.effect",
    "trace_with": "engine.passes",
    "Setting": "engine.effect",
    "LightRays": "engine.homogeneous_light",
    "light_reaching_camera": "engine.camera_light",
    "Plan": "engine.plan",
    "plan_effects": "engine.plan",
    "plan_sheets": "engine.plan",
}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    """Import a public name from its module when it is first used."""
    if name not in _HOME:
        raise AttributeError(f"module 'clacad.effects' has no attribute {name!r}")
    return getattr(import_module(f"clacad.effects.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
