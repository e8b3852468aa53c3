"""clacad: design, make and verify generalized confocal lenslet arrays.

One design file goes in; exact solids, watertight meshes and a ray-traced proof come out.
Public names resolve lazily (PEP 562): importing clacad loads neither a CAD kernel nor a compiler.

>>> import clacad
>>> design = clacad.load("designs/paper-base.toml")        # doctest: +SKIP
>>> window = clacad.prescribe(design)                      # doctest: +SKIP
"""

import sys

if (
    getattr(sys, "argv", [])[:1] == ["-m"] and not sys.flags.safe_path
):  # some `python -m` looks for its module
    if sys.orig_argv[-len(sys.argv)].removeprefix("-m") == "clacad":
        # The current folder is first on the path: a json.py left there would be run. Before this not even
        # __future__ may be imported. Should the package itself lie in that folder, it goes last.
        _here = sys.path.pop(0)
        if _here not in sys.path and __file__.startswith((f"{_here}/clacad", f"{_here}\\clacad")):
            sys.path.append(_here)

from importlib import import_module

TYPE_CHECKING = False  # as type checkers read it; the module typing would be half of what the package loads
if TYPE_CHECKING:
    from typing import Any

__version__ = "0.1.0"

_HOME = {
    "Law": "clacad.optics.law",
    "Fit": "clacad.optics.law",
    "Quadric": "clacad.optics.surface",
    "Biconic": "clacad.optics.surface",
    "Fate": "clacad.optics.rays",
    "Rays": "clacad.optics.rays",
    "TraceResult": "clacad.optics.rays",
    "Lattice": "clacad.sheet.lattice",
    "Material": "clacad.optics.material.material",
    "Design": "clacad.design",
    "DesignError": "clacad.design",
    "load": "clacad.design",
    "Face": "clacad.sheet.window",
    "Body": "clacad.sheet.window",
    "Window": "clacad.sheet.window",
    "prescribe": "clacad.prescription.prescribe",
    "tessellate": "clacad.mesh",
    "Mesh": "clacad.mesh",
    "to_trimesh": "clacad.mesh",
    "Interface": "clacad.optics.sequence",
    "trace": "clacad.effects.trace",
    "Tracer": "clacad.effects.trace",
    "trace_sequence": "clacad.optics.sequence",
    "measure_light": "clacad.tracing.worst_cell",
    "export": "clacad.exporting.run",
    "design_for": "clacad.advice",
    "Wish": "clacad.advice",
    "solids": "clacad.solid.solids",
    "verify": "clacad.verification",
    "advise": "clacad.advice",
    "fix": "clacad.advice",
    "accuracy": "clacad.verification.accuracy.accuracy_table",
    "render": "clacad.rendering",
    "render_movie": "clacad.rendering",
    "plan_effects": "clacad.effects",
    "optimise": "clacad.optimising",
    "write_before_and_after": "clacad.report.better_faces",
    "explore": "clacad.explorer",
    "image": "clacad.imaging",
    "stack": "clacad.stacking",
    "Stack": "clacad.sheet.stack",
    "trace_stack": "clacad.tracing.through_stack",
    "wave": "clacad.waves",
    "plot": "clacad.report.notebook",
    "as_html": "clacad.report.notebook",
}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> "Any":
    """Import a public name from its home module when it is first used."""
    if name not in _HOME:
        raise AttributeError(f"module 'clacad' has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
