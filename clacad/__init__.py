"""clacad: design, make and verify generalized confocal lenslet arrays.

One design file goes in; exact solids, watertight meshes and a ray-traced proof come out.
Public names resolve lazily (PEP 562): importing clacad loads neither a CAD kernel nor a compiler.

>>> import clacad
>>> design = clacad.load("designs/paper-base.toml")        # doctest: +SKIP
>>> window = clacad.prescribe(design)                      # doctest: +SKIP
"""

from __future__ import annotations

from importlib import import_module
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
    "verify": "clacad.verify",
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
