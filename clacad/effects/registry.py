"""The effects by name, in the order in which plans list them and passes of one kind run.

To add an effect, write its module with a `DECLARED` and name the module here.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING

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


@cache
def declared(name: str) -> Declaration:
    """Declaration of an effect; its module is imported on first use.

    Raises
    ------
    ValueError
        An unknown name.
    """
    if name not in NAMES:
        raise ValueError(f"no effect is called {name!r}; known are {', '.join(NAMES)}")
    found: Declaration = import_module(f"clacad.effects.{name}").DECLARED
    return found


def declared_all(names: Iterable[str]) -> tuple[Declaration, ...]:
    """Declarations of several effects, in the order of the names."""
    return tuple(declared(name) for name in names)
