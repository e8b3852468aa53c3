"""clacad: design, make and verify generalized confocal lenslet arrays.

One design file goes in; exact solids, watertight meshes and a ray-traced proof come out.
Public names resolve lazily (PEP 562): importing clacad loads neither a CAD kernel nor a compiler.

>>> import clacad
>>> design = clacad.load("designs/paper-base.toml")        # doctest: +SKIP
>>> window = clacad.prescribe(design)                      # doctest: +SKIP
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType

TYPE_CHECKING = False  # as type checkers read it; the module typing would be half of what the package loads
if TYPE_CHECKING:
    from typing import Any

__version__ = "0.1.0"

_HOME = {
    "Law": "clacad.law",
    "Fit": "clacad.law",
    "Quadric": "clacad.surface",
    "Biconic": "clacad.surface",
    "Fate": "clacad.rays",
    "Rays": "clacad.rays",
    "TraceResult": "clacad.rays",
    "Lattice": "clacad.lattice",
    "Material": "clacad.material",
    "Design": "clacad.design",
    "DesignError": "clacad.design",
    "load": "clacad.design",
    "Face": "clacad.sheet",
    "Body": "clacad.sheet",
    "Window": "clacad.sheet",
    "prescribe": "clacad.prescription",
    "tessellate": "clacad.mesh",
    "Mesh": "clacad.mesh",
    "Interface": "clacad.trace",
    "trace": "clacad.trace",
    "trace_sequence": "clacad.trace",
    "export": "clacad.export",
    "solids": "clacad.brep",
    "verify": "clacad.verify",
    "accuracy": "clacad.accuracy",
    "render": "clacad.render",
    "render_movie": "clacad.render",
    "plan_effects": "clacad.effects",
}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    """Import a public name from its home module when it is first used."""
    if name not in _HOME:
        raise AttributeError(f"module 'clacad' has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])


class _Package(ModuleType):
    """The package, whose public functions keep their names though their homes are called alike.

    Importing `clacad.trace` (the package) would bind it over `clacad.trace` (the function). The verb is what
    a user means; the module stays reachable as ``from clacad.trace import ...``.
    """

    def __setattr__(self, name: str, value: Any) -> None:
        if not (name in _HOME and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
